//! What a stream was at each tick, and whether what a client tells was so.
//!
//! Kept of a copy to which nothing was done. Nothing is judged twice.

use std::collections::{BTreeMap, BTreeSet};

use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::session::Replica;
use serde_json::Value;

use crate::conformance::outcome::{CaseResult, Stop};
use crate::testee::{bits, moving};

/// What a copy is at a tick.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct CopyState {
    /// The sum over all tracks, as it is written.
    sum: String,
    /// What moves, as it is written.
    moving: String,
    /// The motion of each body, also of those that rest.
    all: BTreeMap<String, String>,
}

/// What a stream was at each tick.
#[derive(Debug, Default)]
pub(super) struct StreamHistory {
    held: BTreeMap<u64, BTreeSet<CopyState>>,
    judged: usize,
}

impl StreamHistory {
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

    /// What was reported so far is nobody's matter.
    pub(super) fn pass_over(&mut self, reported: &[Value]) {
        self.judged = reported.len();
    }

    /// Holds what the client reported since the last time against the stream, which is of this choice.
    pub(super) fn judge(&mut self, reported: &[Value], choice: Option<StreamChoice>) -> CaseResult {
        for reported in reported[self.judged..]
            .iter()
            .filter(|reported| reported["is"] == "tick")
        {
            let tick = reported["tick"].as_u64().unwrap_or(u64::MAX);
            let Some(states) = self.held.get(&tick) else {
                return Stop::fail(format!(
                    "the client tells of {tick} as complete, which the stream never was"
                ));
            };
            let (sum, known) = told_state(reported);
            let later = || self.held.range(tick..).flat_map(|(_, states)| states);
            let is_known = |name: &str| later().any(|state| state.all.contains_key(name));
            // A full stream has no sums, and the sum of a copy counts whoever was placed behind the tick.
            let counts_others = |state: &CopyState| {
                let is_new = |name: &String| !state.all.contains_key(name);
                choice == Some(StreamChoice::Full)
                    || later().any(|later| later.all.keys().any(is_new))
            };
            let is_same = |state: &CopyState| {
                let is_alike = state.sum == sum && state.moving == known;
                is_alike || counts_others(state) && is_same_body_by_body(reported, state, &is_known)
            };
            if states.iter().any(is_same) {
                continue;
            }
            let ours = states
                .first()
                .map(|state| format!("{} {}", state.sum, state.moving));
            return Stop::fail(format!(
                "at {tick} the client holds {sum} {known}; the stream sent {ours:?}"
            ));
        }
        self.judged = reported.len();
        Ok(())
    }
}

/// Whether the client's last line of a tick tells what the copy is now.
pub(super) fn is_alike(copy: &Replica, reported: &[Value]) -> bool {
    let tick = copy.stream().complete().value();
    let last = reported
        .iter()
        .rev()
        .find(|reported| reported["is"] == "tick");
    let ours = state_of(copy);
    last.is_some_and(|reported| {
        reported["tick"] == tick && told_state(reported) == (ours.sum, ours.moving)
    })
}

fn state_of(copy: &Replica) -> CopyState {
    let stream = copy.stream();
    let tick = stream.complete();
    let all = copy.bodies().filter_map(|desc| {
        let (index, generation) = (desc.id.index(), desc.id.generation());
        let motion = stream.predicted_motion(desc.id, tick)?;
        Some((format!("{index}:{generation}"), bits(&motion)))
    });
    CopyState {
        sum: format!("{:016x}", stream.state_checksum()),
        moving: format!("{{{}}}", moving(copy, tick)),
        all: all.collect(),
    }
}

/// The sum and what moves, as we write them.
fn told_state(reported: &Value) -> (String, String) {
    let sum = reported["checksum"].as_str().unwrap_or_default().to_owned();
    (sum, as_text(&reported["moving"]))
}

/// Whether each body that is reported of is where it is, and none is left out that moves, whatever the sum. One that is new was
/// placed behind the tick: whoever heard of it before the next tick tells of it, and whoever heard of that first does not.
fn is_same_body_by_body(
    reported: &Value,
    state: &CopyState,
    is_new: &dyn Fn(&str) -> bool,
) -> bool {
    let Some(reported) = reported["moving"].as_object() else {
        return false;
    };
    let is_ours = |(name, motion): (&String, &Value)| {
        let ours = state.all.get(name);
        ours.map_or_else(|| is_new(name), |ours| motion == ours)
    };
    let is_told = |(name, motion): (&String, &String)| reported.contains_key(name) || lies(motion);
    reported.iter().all(is_ours) && state.all.iter().all(is_told)
}

/// Whether both velocities of a motion are zero.
fn lies(motion: &str) -> bool {
    let velocities = motion.get(7 * 16..).unwrap_or_default().as_bytes();
    let is_zero = |number: &[u8]| matches!(number, [b'0' | b'8', rest @ ..] if rest.iter().all(|digit| *digit == b'0'));
    velocities.chunks(16).all(is_zero)
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

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn motion(speed: f64) -> String {
        let numbers = [
            1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0, speed, 0.0, 0.0, 0.0, -0.0, 0.0,
        ];
        let digits = numbers.map(|number: f64| format!("{:016x}", number.to_bits()));
        digits.concat()
    }

    /// A stream at a tick, and who is there and moves so fast.
    fn state(sum: &str, bodies: &[(&str, f64)]) -> CopyState {
        let all = bodies.iter();
        CopyState {
            sum: sum.to_owned(),
            moving: "{}".to_owned(),
            all: all
                .map(|(name, speed)| ((*name).to_owned(), motion(*speed)))
                .collect(),
        }
    }

    #[test]
    fn a_full_stream_reports_each_moving_body_exactly() {
        let is_new = |name: &str| name == "4:0";
        let state = state("", &[("1:0", 0.5), ("2:0", 0.0)]);
        let same =
            |moving: Value| is_same_body_by_body(&json!({"moving": moving}), &state, &is_new);
        assert!(same(json!({"1:0": motion(0.5), "2:0": motion(0.0)})));
        assert!(same(json!({"1:0": motion(0.5)})), "the other one lies");
        assert!(
            !same(json!({"2:0": motion(0.0)})),
            "one that moves is left out"
        );
        assert!(!same(json!({"1:0": motion(0.25)})), "it moves otherwise");
        assert!(
            !same(json!({"1:0": motion(0.5), "3:0": motion(0.0)})),
            "nobody knows it"
        );
        assert!(
            !same(json!({})) && !same(Value::Null),
            "nothing is reported"
        );
        let with_new = json!({"1:0": motion(0.5), "4:0": motion(0.0)});
        assert!(same(with_new), "placed behind this tick");
    }

    #[test]
    fn a_checksum_counts_only_bodies_placed_up_to_its_tick() {
        let (few, many) = (state("a", &[]), state("b", &[("1:0", 0.0)]));
        let held = BTreeMap::from([
            (0, BTreeSet::from([few])),
            (1, BTreeSet::from([many.clone()])),
            (2, BTreeSet::from([many])),
        ]);
        let judged = |tick: u64, moving: Value| {
            let reported = json!({"is": "tick", "tick": tick, "checksum": "c", "moving": moving});
            let held = held.clone();
            StreamHistory { held, judged: 0 }.judge(&[reported], None)
        };
        assert!(judged(0, json!({})).is_ok(), "some were placed by then");
        let stranger = json!({"2:0": motion(0.0)});
        assert!(judged(0, stranger).is_err(), "nobody knows it");
        assert!(judged(1, json!({})).is_err(), "all were there");
        assert!(judged(3, json!({})).is_err(), "no such tick");
    }
}
