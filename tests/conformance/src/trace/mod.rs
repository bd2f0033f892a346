//! Checks a recorded run against the accuracy promise.
//!
//! The check is independent of the recorder. A trace is a file of `rhumb-bench`: the engine's states at every tick,
//! and the poses that each client's copy displayed. Errors are recomputed from both. An error beyond the tolerance must
//! be recorded as a breach, and its cause must be the network or the budget. A body that has slept for a second must be
//! displayed at its rest pose, unless its stream still misses data. A server's recording has the states alone, which are
//! judged as such.

mod grid;
mod judge;
mod messages;
mod recorded;
mod run_metadata;

use std::collections::BTreeMap;
use std::path::Path;

use prost::Message as _;
use rhumb_trace::{FileContents, FileEnd};

use super::case::Case;
use super::outcome::{CaseOutcome, CaseResult, Closing, Stop, Verdict};
use super::run::Tried;
use judge::{TracedCopy, TracedTruth};
use messages::{Breach, Poses, States, TickStats};
use run_metadata::RunMetadata;

/// The part of a file that belongs to one load of a trace, or to one scene of a recording.
#[derive(Default)]
struct Load {
    states: Vec<States>,
    runs: BTreeMap<String, TracedCopy>,
}

/// The verdicts on a file, and a sentence on what of it was not there to be judged.
pub struct Judged {
    /// The verdicts.
    pub tried: Vec<Tried>,
    /// The sentence, for a file that ends early.
    pub note: Option<String>,
}

/// A verdict for each run of a trace, and for each scene of a server's recording; of one load alone if it is named.
///
/// # Errors
///
/// The way in which the file is malformed.
pub fn judge(path: &Path, chosen: Option<&str>) -> Result<Judged, Box<dyn std::error::Error>> {
    let bytes = std::fs::read(path)?;
    let outline = FileContents::read(&bytes, &|_| false)?;
    outline.check_begun(bytes.len())?;
    let mut loads = loads_of(&outline, chosen)?;
    let contents = FileContents::read(&bytes, &|channel| {
        let wanted = ["state", "stats", "seen", "breaches"];
        parts(&loads, &channel.topic).is_some_and(|(.., what)| wanted.contains(&what))
    })?;
    for message in &contents.messages {
        // The last moment of a file that ends early may be there in parts.
        if contents.end == FileEnd::Early && message.log_ns == contents.last_ns {
            continue;
        }
        let topic = contents.topic(message);
        let Some((load, name, what)) = parts(&loads, topic) else {
            continue;
        };
        let (load, name, what) = (load.to_owned(), name.to_owned(), what.to_owned());
        if let Some(load) = loads.get_mut(&load) {
            load.add(&name, &what, &message.bytes)?;
        }
    }
    let mut tried = Vec::new();
    for (prefix, load) in loads {
        tried.extend(load.judge(&prefix));
    }
    Ok(Judged {
        tried,
        note: contents.note(),
    })
}

/// Load, run and kind of a topic of one of these loads.
fn parts<'a>(
    loads: &BTreeMap<String, Load>,
    topic: &'a str,
) -> Option<(&'a str, &'a str, &'a str)> {
    let topic = topic.trim_start_matches('/');
    // The name of a scene may have slashes.
    let (rest, what) = topic.rsplit_once('/')?;
    let (load, name) = rest.rsplit_once('/')?;
    loads.contains_key(load).then_some((load, name, what))
}

impl Load {
    fn add(&mut self, name: &str, what: &str, bytes: &[u8]) -> Result<(), prost::DecodeError> {
        if (name, what) == ("truth", "state") {
            self.states.push(States::decode(bytes)?);
            return Ok(());
        }
        let Some(run) = self.runs.get_mut(name) else {
            return Ok(());
        };
        match what {
            "stats" => run.add_frame(&TickStats::decode(bytes)?),
            "seen" => run.add_poses(Poses::decode(bytes)?),
            "breaches" => run.add_breach(&Breach::decode(bytes)?),
            _ => {}
        }
        Ok(())
    }

    fn judge(self, prefix: &str) -> Vec<Tried> {
        let mut runs = self.runs;
        if runs.is_empty() {
            let id = format!("trace.{prefix}.states");
            let name = format!("{prefix}, recorded without a client's copy, can be read");
            return vec![verdict(
                Case::decoder(&id, &name),
                &recorded::judge(&self.states),
            )];
        }
        let mut truth = TracedTruth::default();
        for states in &self.states {
            truth.step(states);
            for run in runs.values_mut() {
                run.follow(&truth, states.tick);
            }
        }
        let judged = runs.into_iter().map(|(name, run)| {
            let case = Case::decoder(&format!("trace.{prefix}.{name}"), &run.name());
            verdict(case.cites("PROTOCOL 6.3-7, 6.3-9"), &run.judge(&truth))
        });
        judged.collect()
    }
}

/// The loads of a file, or the chosen one, with the runs that have a copy.
fn loads_of(
    outline: &FileContents,
    chosen: Option<&str>,
) -> Result<BTreeMap<String, Load>, Box<dyn std::error::Error>> {
    let mut loads: BTreeMap<String, Load> = BTreeMap::new();
    for channel in outline.channels.values() {
        let load = channel
            .topic
            .trim_start_matches('/')
            .strip_suffix("/truth/state");
        if let Some(load) = load.filter(|_| channel.schema == "rhumb.States") {
            loads.entry(load.to_owned()).or_default();
        }
    }
    for (name, config) in &outline.metadata {
        if !name.starts_with("rhumb.run.") {
            continue;
        }
        let config: &RunMetadata = config;
        let sent = |name: &str| config.get(name).cloned().unwrap_or_default();
        if sent("mode") == "integrated" {
            continue;
        }
        let run = TracedCopy::of(config).map_err(|why| format!("run {:?}: {why}", sent("name")))?;
        loads
            .entry(sent("load"))
            .or_default()
            .runs
            .insert(sent("name"), run);
    }
    if loads.is_empty() {
        return Err(
            "the file has no states: it is no trace of rhumb-bench and no recording of a server"
                .into(),
        );
    }
    let Some(chosen) = chosen else {
        return Ok(loads);
    };
    match loads.remove_entry(chosen) {
        Some(load) => Ok([load].into()),
        None => {
            let names: Vec<_> = loads.into_keys().collect();
            Err(format!(
                "there is no load {chosen:?}; there are {}",
                names.join(", ")
            )
            .into())
        }
    }
}

/// A result in the form of a case's.
fn verdict(case: Case, play: &CaseResult) -> Tried {
    let (verdict, why) = match play {
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
