//! What a stream was at each tick, and whether what a client tells was so.
//!
//! Kept of a copy to which nothing was done. Nothing is judged twice.

use std::collections::{BTreeMap, BTreeSet};

use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::session::Replica;
use serde_json::Value;

use crate::conformance::outcome::{Play, Stop};
use crate::testee::moving;

/// A sum over all tracks, and what moves, both as they are written.
type State = (String, String);

/// What a stream was at each tick.
#[derive(Debug, Default)]
pub(super) struct Memory {
    held: BTreeMap<u64, BTreeSet<State>>,
    judged: usize,
}

impl Memory {
    /// Keeps what the copy is at its complete tick.
    pub(super) fn keep(&mut self, copy: &Replica) {
        let tick = copy.stream().complete();
        self.held
            .entry(tick.value())
            .or_default()
            .insert(state_of(copy));
    }

    /// Another stream is kept from now on.
    pub(super) fn forget(&mut self) {
        self.held.clear();
    }

    /// What was told so far is nobody's matter.
    pub(super) fn pass_over(&mut self, told: &[Value]) {
        self.judged = told.len();
    }

    /// Holds what the client told since the last time against the stream, which is of this choice.
    pub(super) fn judge(&mut self, told: &[Value], choice: Option<StreamChoice>) -> Play {
        for told in told[self.judged..]
            .iter()
            .filter(|told| told["is"] == "tick")
        {
            let tick = told["tick"].as_u64().unwrap_or(u64::MAX);
            let Some(states) = self.held.get(&tick) else {
                return Stop::fail(format!(
                    "the client tells of {tick} as complete, which the stream never was"
                ));
            };
            let (sum, known) = told_state(told);
            let in_full = choice == Some(StreamChoice::Full) && is_same_in_full(told, states);
            if in_full || states.contains(&(sum.clone(), known.clone())) {
                continue;
            }
            let ours = states
                .first()
                .map(|(sum, moving)| format!("{sum} {moving}"));
            return Stop::fail(format!(
                "at {tick} the client holds {sum} {known}; the stream said {ours:?}"
            ));
        }
        self.judged = told.len();
        Ok(())
    }
}

/// Whether the client's last line of a tick tells what the copy is now.
pub(super) fn is_alike(copy: &Replica, told: &[Value]) -> bool {
    let tick = copy.stream().complete().value();
    let last = told.iter().rev().find(|told| told["is"] == "tick");
    last.is_some_and(|told| told["tick"] == tick && told_state(told) == state_of(copy))
}

fn state_of(copy: &Replica) -> State {
    let tick = copy.stream().complete();
    let sum = format!("{:016x}", copy.stream().agreement());
    (sum, format!("{{{}}}", moving(copy, tick)))
}

fn told_state(told: &Value) -> State {
    let sum = told["sum"].as_str().unwrap_or_default().to_owned();
    (sum, as_text(&told["moving"]))
}

/// Of a full stream, which has no sums and says anew of bodies that rest: whether each body of both moves alike.
fn is_same_in_full(told: &Value, states: &BTreeSet<State>) -> bool {
    let told = told["moving"].as_object();
    states.iter().any(|(_, moving)| {
        let ours: Value = serde_json::from_str(moving).unwrap_or_default();
        let (told, ours) = (told.into_iter().flatten(), ours.as_object());
        let mut both = told.filter_map(|(name, motion)| Some((motion, ours?.get(name)?)));
        both.all(|(motion, ours)| motion == ours)
    })
}

/// What moves, as we write it: by index, without spaces.
fn as_text(moving: &Value) -> String {
    let number = |part: Option<&str>| part.and_then(|part| part.parse::<u32>().ok());
    let mut rows: Vec<_> = moving.as_object().into_iter().flatten().collect();
    rows.sort_by_key(|(name, _)| {
        let mut parts = name.split(':');
        (number(parts.next()), number(parts.next()))
    });
    let rows: Vec<_> = rows
        .into_iter()
        .map(|(name, motion)| format!("\"{name}\":{motion}"))
        .collect();
    format!("{{{}}}", rows.join(","))
}
