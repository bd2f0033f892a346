//! Messages of a server on the control stream, and its answers.
//!
//! Codec only: `session` decides which message is allowed now.
//! Answers are results of queries, and inspection, which is for benchmarks and operators; no client needs it.

use alloc::vec::Vec;
use core::fmt;

use glam::Vec3;
use rhumb_reckoning::Tick;

use super::cell::CellNews;
use super::identity::{Extensions, SessionState};
use super::request::{AuthorityError, AuthorityGrant, Denial, StreamChoice, TierChangeCause};
use super::scene_event::SceneEvent;
use super::{Framed, frame, put};
use crate::endpoint::Instant;
use crate::limits::{EVENTS_PER_TICK_MAX, EXTENSION_BYTES_MAX, QUERY_COST_MAX};
use crate::packet::{LargestPacket, StreamId};
use crate::scene::{
    Answer, BodyEvent, Cell, CommandError, IdRange, Invalid, Quantity, Rule, SceneConfig,
};
use crate::stream::StreamStart;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, OPTIONAL, Wire};

/// The answer to `Hello`.
#[derive(Clone, Debug, PartialEq)]
pub struct Welcome {
    /// The version of the connection from here on.
    pub version: u16,
    /// The configuration of the scene that `Hello` named, if it exists.
    pub scene: Option<SceneConfig>,
    /// Extensions by number.
    pub extensions: Extensions,
}

/// The answer to `Join`: the start of the stream. The scene's shapes and bodies follow as scene events that do not
/// count, up to `SnapshotEnd`.
#[derive(Clone, Debug, PartialEq)]
pub struct Joined {
    /// The joined stream.
    pub choice: StreamChoice,
    /// The configuration of the scene.
    pub config: SceneConfig,
    /// The start of the stream.
    pub start: StreamStart,
    /// Body indices granted to this member.
    pub granted: IdRange,
    /// Extensions by number.
    pub extensions: Extensions,
}

/// One message of a server.
#[derive(Clone, Debug, PartialEq)]
pub enum ServerMessage {
    /// See [`Welcome`].
    Welcome(Welcome),
    /// The scene was created.
    Created,
    /// See [`Joined`].
    Joined(Joined),
    /// The snapshot is complete.
    SnapshotEnd,
    /// The client is no longer a member.
    Left,
    /// The scene was deleted, by this client or another one.
    Deleted,
    /// More body indices.
    Reserved(IdRange),
    /// A request about the whole scene was denied; requests are answered in order.
    Denied(Denial),
    /// All commands up to this number were applied or refused.
    Applied {
        /// Number of the last command.
        through: u64,
        /// The newest tick: the commands act in the step after it (PROTOCOL 4.6).
        tick: Tick,
    },
    /// One command was refused.
    Refused {
        /// Its number.
        number: u64,
        /// The reason.
        error: CommandError,
    },
    /// A change sent to all members.
    SceneEvent(SceneEvent),
    /// The answer to `Ping`.
    Pong {
        /// The moment in the client's `Ping`.
        sent: Instant,
        /// The newest tick.
        tick: Tick,
        /// Nanoseconds since that tick was reached.
        since_tick_ns: u64,
    },
    /// The answer to `Inspect`.
    Inspection(Inspection),
    /// The answer to `TakeAuthority`.
    AuthorityGrant(AuthorityGrant),
    /// `TakeAuthority` was refused and the former authority stays; or authority has ended.
    AuthorityDenied(AuthorityError),
    /// The server changes the member's stream because of its link; a snapshot of the new stream follows.
    TierChanged {
        /// The new stream.
        to: StreamChoice,
        /// The reason.
        cause: TierChangeCause,
    },
    /// The answer to `Query`.
    QueryResult(QueryResult),
    /// The events of bodies in one tick.
    TickEvents(TickEvents),
    /// The state from which the session of this join resumes; sent before `Joined`.
    Session(SessionState),
    /// The scene up to this tick, and this number of commands of the session, survive the server's crash.
    Durable {
        /// Commands of the session from its first on.
        commands: u64,
        /// The tick.
        tick: Tick,
    },
    /// Another server has the scene from now on, and this one closes.
    Moved {
        /// Its address in text (PROTOCOL 12), without a scene.
        address: Vec<u8>,
    },
    /// News of a cell that the member takes.
    OfCell {
        /// The cell.
        cell: Cell,
        /// The news.
        news: CellNews,
    },
}

/// Type bytes.
mod kind {
    pub(super) const WELCOME: u8 = 1;
    pub(super) const CREATED: u8 = 2;
    pub(super) const JOINED: u8 = 3;
    pub(super) const SNAPSHOT_END: u8 = 4;
    pub(super) const LEFT: u8 = 5;
    pub(super) const DELETED: u8 = 6;
    pub(super) const RESERVED: u8 = 7;
    pub(super) const DENIED: u8 = 8;
    pub(super) const APPLIED: u8 = 9;
    pub(super) const REFUSED: u8 = 10;
    pub(super) const SCENE_EVENT: u8 = 11;
    pub(super) const PONG: u8 = 12;
    pub(super) const INSPECTION: u8 = 13;
    pub(super) const AUTHORITY_GRANT: u8 = 14;
    pub(super) const AUTHORITY_DENIED: u8 = 15;
    pub(super) const TIER_CHANGED: u8 = 16;
    pub(super) const QUERY_RESULT: u8 = 17;
    pub(super) const TICK_EVENTS: u8 = 18;
    pub(super) const SESSION: u8 = 32;
    pub(super) const DURABLE: u8 = 33;
    pub(super) const MOVED: u8 = 128;
    pub(super) const OF_CELL: u8 = 129;
}

impl Wire for Welcome {
    fn encode(&self, to: &mut Writer) {
        to.u16(self.version);
        to.u8(u8::from(self.scene.is_some()));
        if let Some(config) = &self.scene {
            config.encode(to);
        }
        self.extensions.encode(to);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let version = from.u16()?;
        let scene = match from.u8()? {
            0 => None,
            1 => Some(SceneConfig::decode(from)?),
            _ => return Err(Malformed::UnknownCode),
        };
        Ok(Self {
            version,
            scene,
            extensions: Extensions::decode(from)?,
        })
    }
}

impl Wire for Joined {
    fn encode(&self, to: &mut Writer) {
        self.choice.encode(to);
        self.config.encode(to);
        let start = &self.start;
        start.stream.encode(to);
        start.largest_packet.encode(to);
        to.f32s(&start.gravity.to_array());
        to.varint(start.tick.value());
        to.varint(start.next);
        to.varint(start.scene_events);
        self.granted.encode(to);
        self.extensions.encode(to);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let choice = StreamChoice::decode(from)?;
        let config = SceneConfig::decode(from)?;
        let stream = StreamId::decode(from)?;
        let largest_packet = LargestPacket::decode(from)?;
        let gravity = Vec3::from_array(from.f32s()?);
        if !gravity.is_finite() {
            return Err(Malformed::NotFinite);
        }
        let start = StreamStart {
            stream,
            largest_packet,
            tolerance: choice.tolerance(),
            integrator: config.integrator,
            publish_interval: config.publish_schedule.publish_interval,
            gravity,
            tick: Tick::new(from.count()?),
            next: from.count()?,
            scene_events: from.count()?,
        };
        Ok(Self {
            choice,
            config,
            start,
            granted: IdRange::decode(from)?,
            extensions: Extensions::decode(from)?,
        })
    }
}

impl ServerMessage {
    /// Appends the message, framed.
    pub fn encode(&self, to: &mut Vec<u8>) {
        let mut body = Writer::new();
        let kind = match self {
            Self::Welcome(welcome) => put(welcome, kind::WELCOME, &mut body),
            Self::Created => kind::CREATED,
            Self::Joined(joined) => put(joined, kind::JOINED, &mut body),
            Self::SnapshotEnd => kind::SNAPSHOT_END,
            Self::Left => kind::LEFT,
            Self::Deleted => kind::DELETED,
            Self::Reserved(range) => put(range, kind::RESERVED, &mut body),
            Self::Denied(denial) => put(denial, kind::DENIED, &mut body),
            Self::Applied { through, tick } => {
                body.varint(*through);
                body.varint(tick.value());
                kind::APPLIED
            }
            Self::Refused { number, error } => {
                body.varint(*number);
                error.encode(&mut body);
                kind::REFUSED
            }
            Self::SceneEvent(scene_event) => put(scene_event, kind::SCENE_EVENT, &mut body),
            Self::Pong {
                sent,
                tick,
                since_tick_ns,
            } => {
                body.varint(sent.as_nanos());
                body.varint(tick.value());
                body.varint(*since_tick_ns);
                kind::PONG
            }
            Self::Inspection(inspection) => put(inspection, kind::INSPECTION, &mut body),
            Self::AuthorityGrant(grant) => put(grant, kind::AUTHORITY_GRANT, &mut body),
            Self::AuthorityDenied(error) => put(error, kind::AUTHORITY_DENIED, &mut body),
            Self::TierChanged { to: choice, cause } => {
                choice.encode(&mut body);
                cause.encode(&mut body);
                kind::TIER_CHANGED
            }
            Self::QueryResult(result) => put(result, kind::QUERY_RESULT, &mut body),
            Self::TickEvents(events) => put(events, kind::TICK_EVENTS, &mut body),
            Self::Session(state) => put(state, kind::SESSION, &mut body),
            Self::Durable { commands, tick } => {
                body.varint(*commands);
                body.varint(tick.value());
                kind::DURABLE
            }
            Self::Moved { address } => {
                body.sized(address);
                kind::MOVED
            }
            Self::OfCell { cell, news } => {
                cell.encode(&mut body);
                put(news, kind::OF_CELL, &mut body)
            }
        };
        frame(kind, &body.into_bytes(), to);
    }

    /// Decodes a message; `None` for an unknown type that may be ignored.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when the bytes are not a message of this version.
    pub fn decode(framed: &Framed) -> Result<Option<Self>, Malformed> {
        let mut from = Reader::new(&framed.body);
        let message = match framed.kind {
            kind::WELCOME => Self::Welcome(Welcome::decode(&mut from)?),
            kind::CREATED => Self::Created,
            kind::JOINED => Self::Joined(Joined::decode(&mut from)?),
            kind::SNAPSHOT_END => Self::SnapshotEnd,
            kind::LEFT => Self::Left,
            kind::DELETED => Self::Deleted,
            kind::RESERVED => Self::Reserved(IdRange::decode(&mut from)?),
            kind::DENIED => Self::Denied(Denial::decode(&mut from)?),
            kind::APPLIED => Self::Applied {
                through: from.count()?,
                tick: Tick::new(from.count()?),
            },
            kind::REFUSED => Self::Refused {
                number: from.count()?,
                error: CommandError::decode(&mut from)?,
            },
            kind::SCENE_EVENT => Self::SceneEvent(SceneEvent::decode(&mut from)?),
            kind::PONG => Self::Pong {
                sent: Instant::from_nanos(from.varint()?),
                tick: Tick::new(from.count()?),
                since_tick_ns: from.varint()?,
            },
            kind::INSPECTION => Self::Inspection(Inspection::decode(&mut from)?),
            kind::AUTHORITY_GRANT => Self::AuthorityGrant(AuthorityGrant::decode(&mut from)?),
            kind::AUTHORITY_DENIED => Self::AuthorityDenied(AuthorityError::decode(&mut from)?),
            kind::TIER_CHANGED => Self::TierChanged {
                to: StreamChoice::decode(&mut from)?,
                cause: TierChangeCause::decode(&mut from)?,
            },
            kind::QUERY_RESULT => Self::QueryResult(QueryResult::decode(&mut from)?),
            kind::TICK_EVENTS => Self::TickEvents(TickEvents::decode(&mut from)?),
            kind::SESSION => Self::Session(SessionState::decode(&mut from)?),
            kind::DURABLE => Self::Durable {
                commands: from.count()?,
                tick: Tick::new(from.count()?),
            },
            kind::MOVED => Self::Moved {
                address: from.sized(EXTENSION_BYTES_MAX)?.to_vec(),
            },
            kind::OF_CELL => Self::OfCell {
                cell: Cell::decode(&mut from)?,
                news: CellNews::decode(&mut from)?,
            },
            kind if kind >= OPTIONAL => return Ok(None),
            _ => return Err(Malformed::UnknownCode),
        };
        from.finish()?;
        Ok(Some(message))
    }
}

/// The events of bodies in the step to a tick.
#[derive(Clone, Debug, PartialEq)]
pub struct TickEvents {
    /// The tick.
    pub tick: Tick,
    /// Number of events that were not sent since the last message of this kind: a tick had too many of them, or the
    /// client read too slowly.
    pub missed: u64,
    /// The events, in the order of their kinds, and each kind in the order of ids.
    pub events: Vec<BodyEvent>,
}

impl Wire for TickEvents {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.tick.value());
        to.varint(self.missed);
        to.varint(self.events.len() as u64);
        for event in &self.events {
            event.encode(to);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let tick = Tick::new(from.count()?);
        let missed = from.count()?;
        let count = from.varint_to(EVENTS_PER_TICK_MAX as u64)?;
        let mut events = Vec::new();
        for _ in 0..count {
            events.push(BodyEvent::decode(from)?);
        }
        Ok(Self {
            tick,
            missed,
            events,
        })
    }
}

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
