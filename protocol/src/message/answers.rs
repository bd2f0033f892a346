//! Answers to requests about a scene: query results, and inspection.
//!
//! Inspection is for benchmarks and operators; no client needs it.

use alloc::vec::Vec;
use core::fmt;

use rhumb_reckoning::Tick;

use crate::limits::QUERY_COST_MAX;
use crate::scene::{Answer, Invalid, Quantity, Rule};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, OPTIONAL, Wire};

/// The answers to all queries of one message.
#[derive(Clone, Debug, PartialEq)]
pub struct QueryResult {
    /// Number of the message: the first of a membership has number 0.
    pub number: u64,
    /// The tick whose scene was asked.
    pub tick: Tick,
    /// An answer for each query, in their order.
    pub answers: Result<Vec<Answer>, QueryError>,
}

/// Reason why none of a message's queries was answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum QueryError {
    /// A number is not allowed.
    Invalid(Invalid),
    /// The scene's engine has failed.
    SceneFaulted,
    /// The scene is late, or the member asks more than its share: the same queries may be answered a moment later.
    Overloaded,
    /// The engine cannot evaluate one of them.
    Unanswerable,
    /// A reason of a later version; the code is from [`OPTIONAL`] on.
    Other(u8),
}

impl fmt::Display for QueryError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Invalid(invalid) => invalid.fmt(f),
            Self::SceneFaulted => f.write_str("the scene has faulted and answers no queries"),
            Self::Overloaded => f.write_str("the scene has no time for queries now"),
            Self::Unanswerable => f.write_str("the engine cannot evaluate one of the queries"),
            Self::Other(code) => write!(f, "the server gave an unknown reason, number {code}"),
        }
    }
}

impl core::error::Error for QueryError {}

impl Wire for QueryResult {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.number);
        to.varint(self.tick.value());
        match &self.answers {
            Ok(answers) => {
                to.u8(0);
                to.varint(answers.len() as u64);
                for answer in answers {
                    answer.encode(to);
                }
            }
            Err(error) => error.encode(to),
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let number = from.count()?;
        let tick = Tick::new(from.count()?);
        let answers = if from.rest().first() == Some(&0) {
            from.u8()?;
            let count = from.varint_to(u64::from(QUERY_COST_MAX))?;
            let mut answers = Vec::new();
            for _ in 0..count {
                answers.push(Answer::decode(from)?);
            }
            Ok(answers)
        } else {
            Err(QueryError::decode(from)?)
        };
        Ok(Self {
            number,
            tick,
            answers,
        })
    }
}

impl Wire for QueryError {
    fn encode(&self, to: &mut Writer) {
        match *self {
            Self::Invalid(invalid) => {
                to.u8(match invalid.rule {
                    Rule::NotFinite => 1,
                    Rule::OutOfRange => 2,
                });
                to.u8(invalid.quantity.code());
            }
            Self::SceneFaulted => to.u8(3),
            Self::Overloaded => to.u8(4),
            Self::Unanswerable => to.u8(5),
            Self::Other(code) => to.u8(code),
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let quantity =
            |from: &mut Reader<'_>| Quantity::from_code(from.u8()?).ok_or(Malformed::UnknownCode);
        Ok(match from.u8()? {
            1 => Self::Invalid(Invalid::not_finite(quantity(from)?)),
            2 => Self::Invalid(Invalid::out_of_range(quantity(from)?)),
            3 => Self::SceneFaulted,
            4 => Self::Overloaded,
            5 => Self::Unanswerable,
            code @ OPTIONAL.. => Self::Other(code),
            _ => return Err(Malformed::UnknownCode),
        })
    }
}

/// Wall-clock time of each stage of the ticks so far, in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StageTimes {
    /// Engine step, sum over all ticks.
    pub step_total: u64,
    /// The median step of the last ticks.
    pub step_median: u64,
    /// The 99th percentile of the last steps.
    pub step_p99: u64,
    /// Observing moved bodies, sum over all ticks.
    pub observe_total: u64,
    /// Choosing, encoding and handing over updates, sum over all ticks.
    pub publish_total: u64,
}

/// The state of a scene at a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Inspection {
    /// The tick.
    pub tick: Tick,
    /// Digest of all observations of the scene.
    pub truth: u64,
    /// Number of bodies.
    pub bodies: u32,
    /// Number of awake bodies.
    pub awake: u32,
    /// Updates sent so far in the stream of the requesting member.
    pub updates: u64,
    /// Packets of that stream.
    pub packets: u64,
    /// Their bytes.
    pub packet_bytes: u64,
    /// Snapshots that members of that stream requested because a checksum differed.
    pub mismatches: u64,
    /// Bodies over budget in that stream, counted at every tick.
    pub over_budget: u64,
    /// Time of the tick's stages.
    pub times: StageTimes,
}

impl Wire for Inspection {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.tick.value());
        to.raw(&self.truth.to_le_bytes());
        to.varint(u64::from(self.bodies));
        to.varint(u64::from(self.awake));
        let times = &self.times;
        for value in [
            self.updates,
            self.packets,
            self.packet_bytes,
            self.mismatches,
            self.over_budget,
            times.step_total,
            times.step_median,
            times.step_p99,
            times.observe_total,
            times.publish_total,
        ] {
            to.varint(value);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let tick = Tick::new(from.count()?);
        let mut truth = 0;
        for place in 0..8 {
            truth |= u64::from(from.u8()?) << (8 * place);
        }
        Ok(Self {
            tick,
            truth,
            bodies: from.varint32()?,
            awake: from.varint32()?,
            updates: from.varint()?,
            packets: from.varint()?,
            packet_bytes: from.varint()?,
            mismatches: from.varint()?,
            over_budget: from.varint()?,
            times: StageTimes {
                step_total: from.varint()?,
                step_median: from.varint()?,
                step_p99: from.varint()?,
                observe_total: from.varint()?,
                publish_total: from.varint()?,
            },
        })
    }
}
