//! The history of a stream by tick, for the check of a client's reports.
//!
//! The history comes from an undisturbed copy. Each report is checked once.

use std::collections::{BTreeMap, BTreeSet};

use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::session::Replica;
use serde_json::Value;

use crate::outcome::{CaseResult, Stop};
use crate::testee::{bits, moving};

/// The state of a copy at a tick.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct CopyState {
    /// The checksum over all tracks, as text.
    sum: String,
    /// The moving bodies, as text.
    moving: String,
    /// The motion of each body, resting bodies included.
    all: BTreeMap<String, String>,
}

/// The history of a stream by tick.
#[derive(Debug, Default)]
pub(super) struct StreamHistory {
    held: BTreeMap<u64, BTreeSet<CopyState>>,
    /// Ticks that were complete between two looks only: several datagrams waited for one scene event.
    skipped: BTreeSet<u64>,
    judged: usize,
}

impl StreamHistory {
    /// Stores the state of the copy at its complete tick.
    pub(super) fn keep(&mut self, copy: &Replica) {
        let tick = copy.stream().complete();
        self.held
            .entry(tick.value())
            .or_default()
            .insert(state_of(copy));
    }

    /// The same in a scene in lockstep, whose stream completes every tick.
    pub(super) fn keep_in_lockstep(&mut self, copy: &Replica) {
        let complete = copy.stream().complete().value();
        if let Some((&newest, _)) = self.held.last_key_value() {
            self.skipped.extend(newest + 1..complete);
        }
        self.keep(copy);
    }

    /// Clears the history: another stream follows.
    pub(super) fn forget(&mut self) {
        self.held.clear();
        self.skipped.clear();
    }

    /// Marks all reports so far as not to be checked.
    pub(super) fn pass_over(&mut self, reported: &[Value]) {
        self.judged = reported.len();
    }

    /// Checks the client's reports since the last call against the history of the stream, which has this choice.
    pub(super) fn judge(&mut self, reported: &[Value], choice: Option<StreamChoice>) -> CaseResult {
        for reported in reported[self.judged..]
            .iter()
            .filter(|reported| reported["is"] == "tick")
        {
            let tick = reported["tick"].as_u64().unwrap_or(u64::MAX);
            if self.skipped.contains(&tick) {
                continue;
            }
            let Some(states) = self.held.get(&tick) else {
                return Stop::fail(format!(
                    "the client reports {tick} as complete, but the stream never was"
                ));
            };
            let (sum, known) = reported_state(reported);
            let later = || self.held.range(tick..).flat_map(|(_, states)| states);
            let is_known = |name: &str| later().any(|state| state.all.contains_key(name));
            // A full stream has no checksums, and the checksum of a copy includes bodies that were placed after the
            // tick.
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
                "at {tick} the client reports {sum} {known}; the stream has {ours:?}"
            ));
        }
        self.judged = reported.len();
        Ok(())
    }
}

/// True if the client's last report of a tick equals the present state of the copy.
pub(super) fn is_alike(copy: &Replica, reported: &[Value]) -> bool {
    let tick = copy.stream().complete().value();
    let last = reported
        .iter()
        .rev()
        .find(|reported| reported["is"] == "tick");
    let ours = state_of(copy);
    last.is_some_and(|reported| {
        reported["tick"] == tick && reported_state(reported) == (ours.sum, ours.moving)
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

/// The checksum and the moving bodies, as text.
fn reported_state(reported: &Value) -> (String, String) {
    let sum = reported["checksum"].as_str().unwrap_or_default().to_owned();
    (sum, as_text(&reported["moving"]))
}

/// True if each reported body has its motion of the history and no moving body is missing; checksums are not compared.
/// A new body may have been placed after the tick: it is reported if its scene event came before the next tick, else
/// not.
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
    let is_reported =
        |(name, motion): (&String, &String)| reported.contains_key(name) || is_at_rest(motion);
    reported.iter().all(is_ours) && state.all.iter().all(is_reported)
}

/// True if both velocities of a motion are zero.
fn is_at_rest(motion: &str) -> bool {
    let velocities = motion.get(7 * 16..).unwrap_or_default().as_bytes();
    let is_zero = |number: &[u8]| matches!(number, [b'0' | b'8', rest @ ..] if rest.iter().all(|digit| *digit == b'0'));
    velocities.chunks(16).all(is_zero)
}

/// The moving bodies as text: sorted by index, without spaces.
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

    /// The state of a stream at a tick with these bodies and speeds.
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
        assert!(same(json!({"1:0": motion(0.5)})), "the other body rests");
        assert!(
            !same(json!({"2:0": motion(0.0)})),
            "a moving body is missing"
        );
        assert!(!same(json!({"1:0": motion(0.25)})), "its motion differs");
        assert!(
            !same(json!({"1:0": motion(0.5), "3:0": motion(0.0)})),
            "the body is unknown"
        );
        assert!(
            !same(json!({})) && !same(Value::Null),
            "nothing is reported"
        );
        let with_new = json!({"1:0": motion(0.5), "4:0": motion(0.0)});
        assert!(same(with_new), "placed after this tick");
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
            StreamHistory {
                held,
                ..StreamHistory::default()
            }
            .judge(&[reported], None)
        };
        assert!(
            judged(0, json!({})).is_ok(),
            "some bodies are placed by then"
        );
        let stranger = json!({"2:0": motion(0.0)});
        assert!(judged(0, stranger).is_err(), "the body is unknown");
        assert!(judged(1, json!({})).is_err(), "all bodies are placed");
        assert!(judged(3, json!({})).is_err(), "no such tick");
    }
}
