//! Checks a recorded run against the accuracy promise.
//!
//! The check is independent of the recorder. A trace is a file of `rhumb-bench`: the engine's states at every tick,
//! and the poses that each client's copy displayed. Errors are recomputed from both. An error beyond the tolerance
//! must be recorded as a breach, and its cause must be the network or the budget. A body that has slept for a second
//! must be displayed at its rest pose, unless its stream still misses data.

mod grid;
mod judge;
mod messages;
mod run_metadata;

use std::collections::BTreeMap;
use std::path::Path;

use mcap::{MessageStream, Summary};
use prost::Message as _;

use super::case::Case;
use super::outcome::{CaseOutcome, Closing, Stop, Verdict};
use super::run::Tried;
use judge::{TracedCopy, TracedTruth};
use messages::{Breach, Poses, States, TickStats};
use run_metadata::RunMetadata;

/// The part of a file that belongs to one load.
#[derive(Default)]
struct Load {
    states: Vec<States>,
    runs: BTreeMap<String, TracedCopy>,
}

/// A verdict for each run of a trace.
///
/// # Errors
///
/// The way in which the file is malformed.
pub fn judge(path: &Path) -> Result<Vec<Tried>, Box<dyn std::error::Error>> {
    let bytes = std::fs::read(path)?;
    let mut loads = runs_of(&bytes)?;
    for message in MessageStream::new(&bytes)? {
        let message = message?;
        let mut parts = message.channel.topic.trim_start_matches('/').split('/');
        let (Some(load), Some(name), Some(what)) = (parts.next(), parts.next(), parts.next())
        else {
            continue;
        };
        let Some(load) = loads.get_mut(load) else {
            continue;
        };
        if (name, what) == ("truth", "state") {
            load.states.push(States::decode(&*message.data)?);
            continue;
        }
        let Some(run) = load.runs.get_mut(name) else {
            continue;
        };
        match what {
            "stats" => run.add_frame(&TickStats::decode(&*message.data)?),
            "seen" => run.add_poses(Poses::decode(&*message.data)?),
            "breaches" => run.add_breach(&Breach::decode(&*message.data)?),
            _ => {}
        }
    }
    let mut tried = Vec::new();
    for (prefix, load) in loads {
        let mut truth = TracedTruth::default();
        let mut runs = load.runs;
        for states in &load.states {
            truth.step(states);
            for run in runs.values_mut() {
                run.follow(&truth, states.tick);
            }
        }
        tried.extend(
            runs.into_iter()
                .map(|(name, run)| verdict(&prefix, &name, &run, &truth)),
        );
    }
    Ok(tried)
}

/// The runs that have a copy, by load and name.
fn runs_of(bytes: &[u8]) -> Result<BTreeMap<String, Load>, Box<dyn std::error::Error>> {
    let summary =
        Summary::read(bytes)?.ok_or("the trace has no summary: its recording was interrupted")?;
    let mut loads: BTreeMap<String, Load> = BTreeMap::new();
    for index in &summary.metadata_indexes {
        if !index.name.starts_with("rhumb.run.") {
            continue;
        }
        let metadata = mcap::read::metadata(bytes, index)?;
        let config: RunMetadata = metadata.metadata;
        let sent = |name: &str| config.get(name).cloned().unwrap_or_default();
        if sent("mode") == "integrated" {
            continue;
        }
        let load = loads.entry(sent("load")).or_default();
        let run =
            TracedCopy::of(&config).map_err(|why| format!("run {:?}: {why}", sent("name")))?;
        load.runs.insert(sent("name"), run);
    }
    if loads.is_empty() {
        return Err("the trace contains no client run".into());
    }
    Ok(loads)
}

/// The result of a run, in the form of a case.
fn verdict(load: &str, name: &str, run: &TracedCopy, truth: &TracedTruth) -> Tried {
    let case =
        Case::decoder(&format!("trace.{load}.{name}"), &run.name()).cites("PROTOCOL 6.3-7, 6.3-9");
    let play = run.judge(truth);
    let (verdict, why) = match &play {
        Ok(()) => (Verdict::Pass, String::new()),
        Err(stop) => (stop.verdict(), Stop::why(stop).to_owned()),
    };
    let outcome = CaseOutcome {
        verdict,
        why,
        closing: Closing::NotJudged,
        took: std::time::Duration::ZERO,
        trace: Vec::new(),
    };
    Tried { case, outcome }
}
