//! The history of a stream by tick, for the check of a client's reports.
//!
//! The history comes from an undisturbed copy. Each report is checked once.

use std::collections::{BTreeMap, BTreeSet};

use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::session::Replica;
use serde_json::Value;

use crate::outcome::{CaseResult, Stop};

/// Index and generation of a body.
type Name = (u32, u16);

/// The bits of the thirteen doubles of a motion.
type Bits = [u64; 13];

/// The state of a copy at a tick.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct CopyState {
    /// The checksum over all tracks.
    sum: u64,
    /// The motion of each body, and whether it moves.
    bodies: BTreeMap<Name, (Bits, bool)>,
}

impl CopyState {
    fn of(copy: &Replica) -> Self {
        let stream = copy.stream();
        let tick = stream.complete();
        let bodies = copy.bodies().filter_map(|desc| {
            let track = stream.track(desc.id)?;
            let motion = stream.predicted_motion(desc.id, tick)?;
            let bits = motion.parts().map(f64::to_bits);
            let name = (desc.id.index(), desc.id.generation());
            Some((name, (bits, !track.is_exact_rest())))
        });
        Self {
            sum: stream.state_checksum(),
            bodies: bodies.collect(),
        }
    }

    /// True if a client reports this checksum and these moving bodies.
    fn is(&self, reported: &ReportedState) -> bool {
        let moving = self.bodies.iter().filter(|(_, (_, moves))| *moves);
        let moving = moving.map(|(name, (bits, _))| (name, bits));
        Some(self.sum) == reported.sum && moving.eq(&reported.moving)
    }

    /// The state in the form of a report, its moving bodies only.
    fn text(&self) -> String {
        let moving = self.bodies.iter().filter(|(_, (_, moves))| *moves);
        let bodies = moving.map(|((index, generation), (bits, _))| {
            let digits = bits.map(|bits| format!("{bits:016x}")).concat();
            format!("\"{index}:{generation}\":\"{digits}\"")
        });
        let bodies: Vec<_> = bodies.collect();
        format!("\"{:016x}\" {{{}}}", self.sum, bodies.join(","))
    }

    /// True if each reported body has its motion of this state and no moving body is missing; checksums are not
    /// compared. A new body may have been placed after the tick: it is reported if its scene event came before the next
    /// tick, else not.
    fn is_body_by_body(&self, reported: &ReportedState, is_new: &dyn Fn(&Name) -> bool) -> bool {
        let is_ours = |(name, motion): (&Name, &Bits)| {
            let ours = self.bodies.get(name);
            ours.map_or_else(|| is_new(name), |(ours, _)| motion == ours)
        };
        let is_reported = |(name, (motion, _)): (&Name, &(Bits, bool))| {
            reported.moving.contains_key(name) || is_at_rest(motion)
        };
        reported.moving.iter().all(is_ours) && self.bodies.iter().all(is_reported)
    }
}

/// The state that a client reports: the checksum and the moving bodies.
struct ReportedState {
    /// `None` if it is no number of sixteen digits, which equals no checksum.
    sum: Option<u64>,
    moving: BTreeMap<Name, Bits>,
}

impl ReportedState {
    /// `None` if it has another form than [`copy_line`](crate::testee::copy_line) writes.
    fn read(reported: &Value) -> Option<Self> {
        let body = |(name, motion): (&String, &Value)| {
            let (index, generation) = name.split_once(':')?;
            let parts: Name = (index.parse().ok()?, generation.parse().ok()?);
            let is_plain = format!("{}:{}", parts.0, parts.1) == *name;
            let digits = motion.as_str()?.as_bytes();
            let (numbers, []) = digits.as_chunks::<16>() else {
                return None;
            };
            let bits: Vec<u64> = numbers.iter().map(number).collect::<Option<_>>()?;
            is_plain.then_some((parts, bits.try_into().ok()?))
        };
        let sum = reported["checksum"].as_str().map(str::as_bytes);
        let moving = reported["moving"].as_object()?.iter().map(body);
        Some(Self {
            sum: sum.and_then(|digits| number(digits.try_into().ok()?)),
            moving: moving.collect::<Option<_>>()?,
        })
    }
}

/// A number of sixteen hexadecimal digits, small letters among them.
fn number(digits: &[u8; 16]) -> Option<u64> {
    digits.iter().try_fold(0, |number, digit| {
        let value = match digit {
            b'0'..=b'9' => digit - b'0',
            b'a'..=b'f' => digit - b'a' + 10,
            _ => return None,
        };
        Some(number << 4 | u64::from(value))
    })
}

/// True if both velocities of a motion are zero.
fn is_at_rest(motion: &Bits) -> bool {
    motion[7..].iter().all(|bits| f64::from_bits(*bits) == 0.0)
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
            .insert(CopyState::of(copy));
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
            let Some(known) = ReportedState::read(reported) else {
                return Stop::fail(format!("at {tick} the client reports no state: {reported}"));
            };
            let later = || self.held.range(tick..).flat_map(|(_, states)| states);
            let is_known = |name: &Name| later().any(|state| state.bodies.contains_key(name));
            // A full stream has no checksums, and the checksum of a copy includes bodies that were placed after the
            // tick.
            let counts_others = |state: &CopyState| {
                let is_new = |name: &Name| !state.bodies.contains_key(name);
                choice == Some(StreamChoice::Full)
                    || later().any(|later| later.bodies.keys().any(is_new))
            };
            let is_same = |state: &CopyState| {
                state.is(&known) || counts_others(state) && state.is_body_by_body(&known, &is_known)
            };
            if states.iter().any(is_same) {
                continue;
            }
            let ours = states.first().map(CopyState::text);
            return Stop::fail(format!(
                "at {tick} the client reports {reported}; the stream has {ours:?}"
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
    let is_same = |reported: &Value| {
        let reported = ReportedState::read(reported);
        reported.is_some_and(|reported| CopyState::of(copy).is(&reported))
    };
    last.is_some_and(|reported| reported["tick"] == tick && is_same(reported))
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
    fn state(sum: u64, bodies: &[(Name, f64)]) -> CopyState {
        let bodies = bodies.iter().map(|(name, speed)| {
            let read = ReportedState::read(&report(json!({"0:0": motion(*speed)})));
            (*name, (read.unwrap().moving[&(0, 0)], false))
        });
        CopyState {
            sum,
            bodies: bodies.collect(),
        }
    }

    fn report(moving: Value) -> Value {
        json!({"is": "tick", "tick": 0, "checksum": "000000000000000c", "moving": moving})
    }

    #[test]
    fn a_full_stream_reports_each_moving_body_exactly() {
        let is_new = |name: &Name| *name == (4, 0);
        let state = state(0, &[((1, 0), 0.5), ((2, 0), 0.0)]);
        let same = |moving: Value| {
            let reported = ReportedState::read(&report(moving));
            reported.is_some_and(|reported| state.is_body_by_body(&reported, &is_new))
        };
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
    fn a_report_has_sixteen_small_digits_a_number() {
        let is_read = |moving: Value| ReportedState::read(&report(moving)).is_some();
        assert!(is_read(json!({"7:1": motion(0.5)})));
        let changed = [
            motion(0.5).to_uppercase(),
            motion(0.5) + "0",
            motion(0.5)[16..].to_owned(),
            motion(0.5).replace('3', "+"),
        ];
        for motion in changed {
            assert!(!is_read(json!({"7:1": motion})), "{motion}");
        }
        for name in ["7", "+7:1", "07:1", "7:1:0"] {
            assert!(!is_read(json!({name: motion(0.5)})), "{name}");
        }
        assert!(!is_read(json!({"7:1": 0.5})));
    }

    #[test]
    fn a_checksum_counts_only_bodies_placed_up_to_its_tick() {
        let (few, many) = (state(0xa, &[]), state(0xb, &[((1, 0), 0.0)]));
        let held = BTreeMap::from([
            (0, BTreeSet::from([few])),
            (1, BTreeSet::from([many.clone()])),
            (2, BTreeSet::from([many])),
        ]);
        let judged = |tick: u64, moving: Value| {
            let mut reported = report(moving);
            reported["tick"] = json!(tick);
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
