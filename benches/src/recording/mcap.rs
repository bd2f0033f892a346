//! Reads the truth from a `trace.mcap`.
//!
//! The trace holds poses and shapes. Config and inertias come from the named scene, run with its number of bodies and
//! seed. Only the first load of the trace is read.

use std::collections::BTreeMap;

use ::mcap::sans_io::{LinearReaderOptions, MessageReadEvent, MessageReader};
use ::mcap::{McapError, McapResult};
use rhumb_reckoning::Tick;
use rhumb_server::Digest;
use rhumb_trace::read_states;

use super::error::RecordingError;
use super::recorded::{Recording, ScriptOrigin};
use crate::record::Truth;

/// Reads the first load of a trace.
///
/// # Errors
///
/// [`RecordingError`] if the bytes are no trace, or its scene is unknown.
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
    let value = |name: &str| run.get(name).map(String::as_str).unwrap_or_default();
    let name = value("scene").to_owned();
    let unknown = || RecordingError::UnknownScene { name: name.clone() };
    let (bodies, seed) = (value("bodies").parse(), value("seed").parse());
    let (Ok(bodies), Ok(seed)) = (bodies, seed) else {
        return Err(unknown());
    };
    let mut script = rhumb_sims::by_name(&name, bodies, seed).ok_or_else(unknown)?;
    Ok(Recording {
        played: Some(ScriptOrigin { bodies, seed }),
        ..Recording::of_play(&mut *script, truth(bytes, load)?)
    })
}

/// Metadata records by name.
fn metadata(bytes: &[u8]) -> Result<BTreeMap<String, BTreeMap<String, String>>, RecordingError> {
    let summary = ::mcap::Summary::read(bytes)?.ok_or(RecordingError::NotARecording)?;
    let mut records = BTreeMap::new();
    for index in &summary.metadata_indexes {
        let end = index.offset.checked_add(index.length);
        if end.is_none_or(|end| end > bytes.len() as u64) {
            return Err(McapError::BadIndex.into());
        }
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
    for message in Messages::of(bytes) {
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

/// Longest accepted record. A damaged file may state any length and must not cause an allocation of that size.
const RECORD_BYTES_MAX: usize = 64 << 20;

/// The messages of a file, in order.
struct Messages<'a> {
    reader: MessageReader,
    rest: &'a [u8],
}

impl<'a> Messages<'a> {
    fn of(bytes: &'a [u8]) -> Self {
        let options = LinearReaderOptions::default().with_record_length_limit(RECORD_BYTES_MAX);
        Self {
            reader: MessageReader::new_with_options(options),
            rest: bytes,
        }
    }
}

impl Iterator for Messages<'_> {
    type Item = McapResult<::mcap::Message<'static>>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            match self.reader.next_event()? {
                Ok(MessageReadEvent::ReadRequest(wanted)) => {
                    let (read, rest) = self.rest.split_at(wanted.min(self.rest.len()));
                    self.reader.insert(read.len()).copy_from_slice(read);
                    self.reader.notify_read(read.len());
                    self.rest = rest;
                }
                Ok(MessageReadEvent::Message(message)) => return Some(Ok(message)),
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::io::Cursor;

    use ::mcap::records::op;
    use ::mcap::{MessageStream, Summary, WriteOptions};

    use super::*;

    /// The same trace without compression, so that a test can corrupt bytes inside its chunks.
    fn unpacked() -> Vec<u8> {
        let path = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../tests/data/traces/free_fall.mcap"
        );
        let packed = fs::read(path).expect("the repository contains a trace");
        let options = WriteOptions::new().compression(None);
        let mut writer = options
            .create(Cursor::new(Vec::new()))
            .expect("writing to memory succeeds");
        for message in MessageStream::new(&packed).expect("it is a trace") {
            writer
                .write(&message.expect("the trace is intact"))
                .expect("writing to memory succeeds");
        }
        let summary = Summary::read(&packed)
            .expect("the trace is intact")
            .expect("it has a summary");
        for index in &summary.metadata_indexes {
            let record = ::mcap::read::metadata(&packed, index).expect("the trace is intact");
            writer
                .write_metadata(&record)
                .expect("writing to memory succeeds");
        }
        writer.finish().expect("writing to memory succeeds");
        writer.into_inner().into_inner()
    }

    #[test]
    fn metadata_offsets_outside_the_file_are_refused() {
        let whole = unpacked();
        let summary = Summary::read(&whole).expect("the trace is intact");
        let index = &summary.expect("it has a summary").metadata_indexes[0];
        let entry = [index.offset.to_le_bytes(), index.length.to_le_bytes()].concat();
        let at = whole.windows(16).position(|bytes| bytes == entry);
        let at = at.expect("the summary holds the entry");
        for place in [at, at + 8] {
            let mut spoiled = whole.clone();
            spoiled[place..place + 8].copy_from_slice(&[0xff; 8]);
            assert!(
                matches!(read(&spoiled), Err(RecordingError::Mcap(_))),
                "{place}"
            );
        }
    }

    #[test]
    fn an_oversized_record_is_refused_without_allocating_its_length() {
        let whole = unpacked();
        assert!(read(&whole).is_ok());
        // Magic; the header's code, length and body; the chunk's code and length, and 40 bytes before its first record.
        let header = u64::from_le_bytes(whole[9..17].try_into().expect("eight bytes"));
        let at = 8 + 9 + header as usize + 9 + 40;
        assert_eq!(whole[at], op::SCHEMA);
        for length in [u64::MAX, 1 << 62, (RECORD_BYTES_MAX as u64) + 1] {
            let mut spoiled = whole.clone();
            spoiled[at + 1..at + 9].copy_from_slice(&length.to_le_bytes());
            assert!(
                matches!(read(&spoiled), Err(RecordingError::Mcap(_))),
                "{length}"
            );
        }
    }
}
