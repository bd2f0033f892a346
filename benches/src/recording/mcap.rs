//! The truth in a `trace.mcap` of ours.
//!
//! The trace holds poses and shapes; the rest comes from the scene that it names, run with its numbers of bodies and seed.
//! The first load of the trace is taken.

use std::collections::BTreeMap;

use rhumb_reckoning::Tick;
use rhumb_server::Digest;

use super::{Recording, RecordingError};
use crate::record::Truth;
use crate::trace::read_states;

/// Reads the first load of a trace.
///
/// # Errors
///
/// [`RecordingError`] if the bytes are no trace of ours, or of a scene that is not known here.
pub fn read(bytes: &[u8]) -> Result<Recording, RecordingError> {
    let records = metadata(bytes)?;
    let loads = records
        .get("rhumb.experiment")
        .and_then(|record| record.get("loads"));
    let load = loads.and_then(|loads| loads.split_whitespace().next());
    let load = load.ok_or(RecordingError::NotARecording)?;
    let run = records
        .iter()
        .find(|(name, record)| {
            name.starts_with("rhumb.run.") && record.get("load").is_some_and(|of| of == load)
        })
        .map(|(_, record)| record)
        .ok_or(RecordingError::NoTruth)?;
    let said = |name: &str| run.get(name).map(String::as_str).unwrap_or_default();
    let name = said("scene").to_owned();
    let unknown = || RecordingError::UnknownScene { name: name.clone() };
    let (bodies, seed) = (said("bodies").parse(), said("seed").parse());
    let (Ok(bodies), Ok(seed)) = (bodies, seed) else {
        return Err(unknown());
    };
    let mut script = rhumb_sims::by_name(&name, bodies, seed).ok_or_else(unknown)?;
    Ok(Recording::of_play(&mut *script, truth(bytes, load)?))
}

/// Metadata records by name.
fn metadata(bytes: &[u8]) -> Result<BTreeMap<String, BTreeMap<String, String>>, RecordingError> {
    let summary = ::mcap::Summary::read(bytes)?.ok_or(RecordingError::NotARecording)?;
    let mut records = BTreeMap::new();
    for index in &summary.metadata_indexes {
        let record = ::mcap::read::metadata(bytes, index)?;
        records.insert(record.name, record.metadata);
    }
    Ok(records)
}

/// Every tick of a load.
fn truth(bytes: &[u8], load: &str) -> Result<Truth, RecordingError> {
    let topic = format!("/{load}/truth/state");
    let mut truth = Truth::default();
    let mut digest = Digest::START;
    let mut due = Tick::ZERO;
    for message in ::mcap::MessageStream::new(bytes)? {
        let message = message?;
        if message.channel.topic != topic {
            continue;
        }
        let states = read_states(&message.data).map_err(RecordingError::Message)?;
        let states = states.ok_or(RecordingError::Number { tick: due })?;
        if states.tick != due {
            return Err(RecordingError::NoTruth);
        }
        truth.placed.extend(states.placed);
        truth.removed.extend(states.removed);
        if due > Tick::ZERO {
            digest.fold_tick(due, &states.observed);
            truth.ticks.push(states.observed);
        }
        due = due.next();
    }
    truth.digest = digest.value();
    if truth.ticks.is_empty() {
        return Err(RecordingError::NoTruth);
    }
    Ok(truth)
}
