//! Messages of a client: the first ones, and requests of a member.
//!
//! Names only: the server decides who may take authority over bodies; `session` encodes the motion.
//!
//! Codec only: `session` decides which message is allowed now.

use alloc::vec::Vec;
use core::fmt;

use rhumb_reckoning::{BodyId, BodyState, Predictor, Tick, Tolerance, Track};

use super::cell::CellRequest;
use super::choice::{ResyncCause, StreamChoice, TierPolicy};
use super::identity::{Extensions, SessionRequest};
use super::{Framed, MAGIC, frame, put};
use crate::endpoint::Instant;
use crate::limits::{AUTHORITY_BODIES_MAX, DATAGRAM_BYTES_MAX, RESERVE_MAX, VERSIONS_MAX};
use crate::packet::{LargestPacket, StreamId};
use crate::scene::query::{decode_queries, encode_queries};
use crate::scene::{Cell, Command, Query, SceneConfig, SceneName};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, OPTIONAL, Wire};

/// One message of a client. A connection is about one scene, which its `Hello` names.
#[derive(Clone, Debug, PartialEq)]
pub enum ClientMessage {
    /// The first message: supported versions, newest first, and the scene of the connection.
    Hello {
        /// At least one.
        versions: Vec<u16>,
        /// The scene of this connection.
        scene: SceneName,
        /// Extensions by number.
        extensions: Extensions,
    },
    /// Creates the scene.
    Create(SceneConfig),
    /// Becomes a member and subscribes to a stream.
    Join(StreamChoice),
    /// Ends the membership.
    Leave,
    /// Ends the scene for all members.
    Delete,
    /// Requests more body indices.
    Reserve {
        /// The number of indices; at least one.
        count: u32,
    },
    /// A command. The first of a membership has number 0, the next 1, and so on.
    Command(Command),
    /// Steps a lockstep scene until it has reached a tick.
    Advance {
        /// The tick.
        to: Tick,
    },
    /// Requests a new snapshot.
    Resync(ResyncCause),
    /// Requests the server's time.
    Ping {
        /// The client's own moment, which the answer repeats.
        sent: Instant,
    },
    /// Requests the state of the scene.
    Inspect,
    /// Subscribes to another stream; the former one continues until the snapshot is complete.
    Subscribe(StreamChoice),
    /// Confirms that the client has caught up with its new stream and no longer needs the former one.
    Subscribed(StreamId),
    /// Requests authority over these kinematic bodies.
    TakeAuthority(TakeAuthority),
    /// An upstream packet that must precede an advance.
    Upstream(Vec<u8>),
    /// Sets the tiers that the server may change to when the link is congested.
    TierPolicy(TierPolicy),
    /// Asks where bodies are. The first of a membership has number 0, the next 1, and so on.
    Query(Vec<Query>),
    /// Names the session of the next join, to begin it or to take it up.
    Session(SessionRequest),
    /// The next join takes the scene by cells, if it is divided.
    JoinCells,
    /// A request about one cell.
    OfCell {
        /// The cell.
        cell: Cell,
        /// The request.
        request: CellRequest,
    },
}

/// Type bytes.
mod kind {
    pub(super) const HELLO: u8 = 1;
    pub(super) const CREATE: u8 = 2;
    pub(super) const JOIN: u8 = 3;
    pub(super) const LEAVE: u8 = 4;
    pub(super) const DELETE: u8 = 5;
    pub(super) const RESERVE: u8 = 6;
    pub(super) const COMMAND: u8 = 7;
    pub(super) const ADVANCE: u8 = 8;
    pub(super) const RESYNC: u8 = 9;
    pub(super) const PING: u8 = 10;
    pub(super) const INSPECT: u8 = 11;
    pub(super) const SUBSCRIBE: u8 = 12;
    pub(super) const SUBSCRIBED: u8 = 13;
    pub(super) const TAKE_AUTHORITY: u8 = 14;
    pub(super) const UPSTREAM: u8 = 15;
    pub(super) const TIER_POLICY: u8 = 16;
    pub(super) const QUERY: u8 = 17;
    pub(super) const SESSION: u8 = 32;
    pub(super) const JOIN_CELLS: u8 = 128;
    pub(super) const OF_CELL: u8 = 129;
}

impl ClientMessage {
    /// Appends the message, framed.
    pub fn encode(&self, to: &mut Vec<u8>) {
        let mut body = Writer::new();
        let kind = self.encode_body(&mut body);
        frame(kind, &body.into_bytes(), to);
    }

    /// Appends the body of the message; returns its type.
    fn encode_body(&self, body: &mut Writer) -> u8 {
        match self {
            Self::Hello {
                versions,
                scene,
                extensions,
            } => {
                body.raw(&MAGIC);
                body.varint(versions.len() as u64);
                for version in versions {
                    body.u16(*version);
                }
                scene.encode(body);
                extensions.encode(body);
                kind::HELLO
            }
            Self::Create(config) => put(config, kind::CREATE, body),
            Self::Join(choice) => put(choice, kind::JOIN, body),
            Self::Leave => kind::LEAVE,
            Self::Delete => kind::DELETE,
            Self::Reserve { count } => {
                body.varint(u64::from(*count));
                kind::RESERVE
            }
            Self::Command(command) => put(command, kind::COMMAND, body),
            Self::Advance { to: tick } => {
                body.varint(tick.value());
                kind::ADVANCE
            }
            Self::Resync(cause) => put(cause, kind::RESYNC, body),
            Self::Ping { sent } => {
                body.varint(sent.as_nanos());
                kind::PING
            }
            Self::Inspect => kind::INSPECT,
            Self::Subscribe(choice) => put(choice, kind::SUBSCRIBE, body),
            Self::Subscribed(stream) => put(stream, kind::SUBSCRIBED, body),
            Self::TakeAuthority(request) => put(request, kind::TAKE_AUTHORITY, body),
            Self::Upstream(packet) => {
                body.raw(packet);
                kind::UPSTREAM
            }
            Self::TierPolicy(tier_policy) => put(tier_policy, kind::TIER_POLICY, body),
            Self::Query(queries) => {
                encode_queries(queries, body);
                kind::QUERY
            }
            Self::Session(request) => put(request, kind::SESSION, body),
            Self::JoinCells => kind::JOIN_CELLS,
            Self::OfCell { cell, request } => {
                cell.encode(body);
                put(request, kind::OF_CELL, body)
            }
        }
    }

    /// Decodes a message; `None` for an unknown type that may be ignored.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when the bytes are not a message of this version.
    pub fn decode(framed: &Framed) -> Result<Option<Self>, Malformed> {
        let mut from = Reader::new(&framed.body);
        let message = match framed.kind {
            kind::HELLO => decode_hello(&mut from)?,
            kind::CREATE => Self::Create(SceneConfig::decode(&mut from)?),
            kind::JOIN => Self::Join(StreamChoice::decode(&mut from)?),
            kind::LEAVE => Self::Leave,
            kind::DELETE => Self::Delete,
            kind::RESERVE => match from.varint_to(u64::from(RESERVE_MAX))? as u32 {
                0 => return Err(Malformed::OutOfRange),
                count => Self::Reserve { count },
            },
            kind::COMMAND => match Command::decode(&mut from) {
                // Only such a command is refused, so that the rest of it must be valid.
                Err(Malformed::Motion(invalid)) => {
                    from.finish()?;
                    return Err(Malformed::Motion(invalid));
                }
                command => Self::Command(command?),
            },
            kind::ADVANCE => Self::Advance {
                to: Tick::new(from.count()?),
            },
            kind::RESYNC => Self::Resync(ResyncCause::decode(&mut from)?),
            kind::PING => Self::Ping {
                sent: Instant::from_nanos(from.varint()?),
            },
            kind::INSPECT => Self::Inspect,
            kind::SUBSCRIBE => Self::Subscribe(StreamChoice::decode(&mut from)?),
            kind::SUBSCRIBED => Self::Subscribed(StreamId::decode(&mut from)?),
            kind::TAKE_AUTHORITY => Self::TakeAuthority(TakeAuthority::decode(&mut from)?),
            kind::UPSTREAM if framed.body.len() > DATAGRAM_BYTES_MAX => {
                return Err(Malformed::TooLong);
            }
            kind::UPSTREAM => Self::Upstream(from.raw(framed.body.len())?.to_vec()),
            kind::TIER_POLICY => Self::TierPolicy(TierPolicy::decode(&mut from)?),
            kind::QUERY => Self::Query(decode_queries(&mut from)?),
            kind::SESSION => Self::Session(SessionRequest::decode(&mut from)?),
            kind::JOIN_CELLS => Self::JoinCells,
            kind::OF_CELL => Self::OfCell {
                cell: Cell::decode(&mut from)?,
                request: CellRequest::decode(&mut from)?,
            },
            kind if kind >= OPTIONAL => return Ok(None),
            _ => return Err(Malformed::UnknownCode),
        };
        from.finish()?;
        Ok(Some(message))
    }
}

fn decode_hello(from: &mut Reader<'_>) -> Result<ClientMessage, Malformed> {
    if from.raw(MAGIC.len())? != MAGIC {
        return Err(Malformed::UnknownCode);
    }
    let count = from.varint()?;
    if count == 0 || count > VERSIONS_MAX as u64 {
        return Err(Malformed::TooLong);
    }
    let mut versions = Vec::new();
    for _ in 0..count {
        versions.push(from.u16()?);
    }
    Ok(ClientMessage::Hello {
        versions,
        scene: SceneName::decode(from)?,
        extensions: Extensions::decode(from)?,
    })
}

/// A member's request for authority over bodies, in place of its former ones.
#[derive(Clone, Debug, PartialEq)]
pub struct TakeAuthority {
    /// Bound on the distance of the server's bodies from the member's.
    pub tolerance: Tolerance,
    /// The largest packet of the upstream.
    pub largest_packet: LargestPacket,
    /// Kinematic bodies in rising order, each once; an empty list ends the authority.
    pub bodies: Vec<BodyId>,
}

/// A member's grant of authority: the start of its upstream.
#[derive(Clone, Debug, PartialEq)]
pub struct AuthorityGrant {
    /// Name of the upstream.
    pub stream: StreamId,
    /// The newest tick of the scene.
    pub tick: Tick,
    /// The bodies and their states at that tick. A body's place is its index in the stream.
    pub bodies: Vec<(BodyId, BodyState)>,
}

/// Reason of a refused or ended authority.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum AuthorityError {
    /// The scene has no such body.
    UnknownBody(BodyId),
    /// The body's index was granted to another member, which is still there.
    NotYours(BodyId),
    /// The body is fixed, or the engine moves it.
    NotKinematic(BodyId),
    /// Another member has authority over it.
    HeldByAnother(BodyId),
    /// The scene's engine has failed.
    SceneFaulted,
    /// The upstream has lost sync; the member has no authority until it requests it again.
    LostSync,
    /// The client's role does not include authority, or a body belongs to another client.
    NotAllowed,
    /// A reason of a later version; the code is from [`OPTIONAL`] on.
    Other(u8),
}

impl AuthorityGrant {
    /// The track of a body of this stream before its first update, at both ends.
    #[must_use]
    pub fn first_track(&self, motion: BodyState) -> Track {
        if motion == motion.stilled() {
            return Track::resting(self.tick, motion);
        }
        Track {
            predictor: Predictor::Uniform,
            anchor: rhumb_reckoning::Anchor::Exact(motion),
            ..Track::resting(self.tick, motion)
        }
    }
}

impl AuthorityError {
    /// Its name in languages without enumerations.
    #[must_use]
    pub const fn word(&self) -> &'static str {
        match self {
            Self::UnknownBody(_) => "unknown body",
            Self::NotYours(_) => "not yours",
            Self::NotKinematic(_) => "not kinematic",
            Self::HeldByAnother(_) => "held by another",
            Self::SceneFaulted => "scene faulted",
            Self::LostSync => "lost sync",
            Self::NotAllowed => "not allowed",
            Self::Other(_) => "other",
        }
    }

    /// The body that it names.
    #[must_use]
    pub const fn body(&self) -> Option<BodyId> {
        match *self {
            Self::UnknownBody(id)
            | Self::NotYours(id)
            | Self::NotKinematic(id)
            | Self::HeldByAnother(id) => Some(id),
            _ => None,
        }
    }
}

impl fmt::Display for AuthorityError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownBody(id) => write!(f, "the scene has no {id}"),
            Self::NotYours(id) => write!(f, "{id} was granted to another member"),
            Self::NotKinematic(id) => write!(f, "{id} is not kinematic and takes no authority"),
            Self::HeldByAnother(id) => write!(f, "another member has authority over {id}"),
            Self::SceneFaulted => f.write_str("the scene's engine has failed"),
            Self::LostSync => f.write_str("the upstream has lost sync"),
            Self::NotAllowed => f.write_str(
                "the client may not take authority, or not over what belongs to another client",
            ),
            Self::Other(code) => write!(f, "the server gave an unknown reason, number {code}"),
        }
    }
}

impl core::error::Error for AuthorityError {}

fn decode_count(from: &mut Reader<'_>) -> Result<usize, Malformed> {
    Ok(from.varint_to(AUTHORITY_BODIES_MAX as u64)? as usize)
}

/// Appends bodies under one member's authority, in rising order.
pub(super) fn encode_bodies(bodies: &[BodyId], to: &mut Writer) {
    to.varint(bodies.len() as u64);
    for id in bodies {
        id.encode(to);
    }
}

pub(super) fn decode_bodies(from: &mut Reader<'_>) -> Result<Vec<BodyId>, Malformed> {
    let mut bodies: Vec<BodyId> = Vec::new();
    for _ in 0..decode_count(from)? {
        let id = BodyId::decode(from)?;
        if bodies.last().is_some_and(|last| *last >= id) {
            return Err(Malformed::NotCanonical);
        }
        bodies.push(id);
    }
    Ok(bodies)
}

impl Wire for TakeAuthority {
    fn encode(&self, to: &mut Writer) {
        StreamChoice::Within(self.tolerance).encode(to);
        self.largest_packet.encode(to);
        encode_bodies(&self.bodies, to);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let StreamChoice::Within(tolerance) = StreamChoice::decode(from)? else {
            return Err(Malformed::UnknownCode);
        };
        Ok(Self {
            tolerance,
            largest_packet: LargestPacket::decode(from)?,
            bodies: decode_bodies(from)?,
        })
    }
}

impl Wire for AuthorityGrant {
    fn encode(&self, to: &mut Writer) {
        self.stream.encode(to);
        to.varint(self.tick.value());
        to.varint(self.bodies.len() as u64);
        for (id, motion) in &self.bodies {
            id.encode(to);
            motion.encode(to);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let stream = StreamId::decode(from)?;
        let tick = Tick::new(from.count()?);
        let mut bodies: Vec<(BodyId, BodyState)> = Vec::new();
        for _ in 0..decode_count(from)? {
            let id = BodyId::decode(from)?;
            if bodies.last().is_some_and(|(last, _)| *last >= id) {
                return Err(Malformed::NotCanonical);
            }
            bodies.push((id, BodyState::decode(from)?));
        }
        Ok(Self {
            stream,
            tick,
            bodies,
        })
    }
}

impl Wire for AuthorityError {
    fn encode(&self, to: &mut Writer) {
        let mut named = |code, id: BodyId| {
            to.u8(code);
            id.encode(to);
        };
        match *self {
            Self::UnknownBody(id) => named(0, id),
            Self::NotYours(id) => named(1, id),
            Self::NotKinematic(id) => named(2, id),
            Self::HeldByAnother(id) => named(3, id),
            Self::SceneFaulted => to.u8(4),
            Self::LostSync => to.u8(5),
            Self::NotAllowed => to.u8(16),
            Self::Other(code) => to.u8(code),
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(match from.u8()? {
            0 => Self::UnknownBody(BodyId::decode(from)?),
            1 => Self::NotYours(BodyId::decode(from)?),
            2 => Self::NotKinematic(BodyId::decode(from)?),
            3 => Self::HeldByAnother(BodyId::decode(from)?),
            4 => Self::SceneFaulted,
            5 => Self::LostSync,
            16 => Self::NotAllowed,
            code @ OPTIONAL.. => Self::Other(code),
            _ => return Err(Malformed::UnknownCode),
        })
    }
}

// The longest motion with the longest id, as often as allowed, fits a message.
const _: () =
    assert!(AUTHORITY_BODIES_MAX * (3 + 3 + 1 + 13 * 4) + 16 < crate::limits::MESSAGE_BYTES_MAX);

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks that a value round-trips through these bytes, and that every truncation is refused.
    fn round_trips<T: Wire + PartialEq + fmt::Debug>(value: &T, bytes: &[u8]) {
        let mut writer = Writer::new();
        value.encode(&mut writer);
        assert_eq!(writer.into_bytes(), bytes);
        let mut reader = Reader::new(bytes);
        assert_eq!(T::decode(&mut reader).as_ref(), Ok(value));
        assert_eq!(reader.finish(), Ok(()));
        for cut in 0..bytes.len() {
            let mut reader = Reader::new(&bytes[..cut]);
            assert_eq!(T::decode(&mut reader), Err(Malformed::Truncated));
        }
    }

    #[test]
    fn authority_messages_round_trip() {
        let (one, other) = (BodyId::new(3, 0), BodyId::new(300, 2));
        let request = TakeAuthority {
            tolerance: Tolerance::NORMAL,
            largest_packet: LargestPacket::DEFAULT,
            bodies: alloc::vec![one, other],
        };
        round_trips(&request, &[0, 0xd0, 0x86, 3, 0xcc, 8, 2, 3, 0, 0xac, 2, 2]);
        let at = |x| BodyState::new([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        let driving = AuthorityGrant {
            stream: StreamId(7),
            tick: Tick::new(300),
            bodies: alloc::vec![(one, at(1.0).unwrap())],
        };
        let bytes = [
            7, 0xac, 2, 1, 3, 0, 0, 0, 0, 0x80, 0x3f, 0, 0, 0, 0, 0, 0, 0, 0,
        ];
        round_trips(&driving, &bytes);
        round_trips(&AuthorityError::HeldByAnother(other), &[3, 0xac, 2, 2]);
        round_trips(&AuthorityError::LostSync, &[5]);
    }

    #[test]
    fn bodies_that_do_not_rise_are_refused() {
        for bytes in [
            &[0, 0xd0, 0x86, 3, 0xcc, 8, 2, 3, 0, 3, 0][..],
            &[0, 0xd0, 0x86, 3, 0xcc, 8, 2, 4, 0, 3, 9],
        ] {
            let refused = TakeAuthority::decode(&mut Reader::new(bytes));
            assert_eq!(refused, Err(Malformed::NotCanonical));
        }
    }

    #[test]
    fn a_full_stream_gives_no_authority_tolerance() {
        let refused = TakeAuthority::decode(&mut Reader::new(&[1, 0]));
        assert_eq!(refused, Err(Malformed::UnknownCode));
    }

    #[test]
    fn a_body_without_velocity_is_predicted_to_rest() {
        let driving = AuthorityGrant {
            stream: StreamId(0),
            tick: Tick::new(5),
            bodies: Vec::new(),
        };
        let motion = |speed| BodyState::new([1.0; 3], [0.0, 0.0, 0.0, 1.0], [speed; 3], [0.0; 3]);
        assert!(driving.first_track(motion(0.0).unwrap()).is_exact_rest());
        let moving = driving.first_track(motion(2.0).unwrap());
        assert_eq!(moving.predictor, Predictor::Uniform);
        assert_eq!(moving.origin, Tick::new(5));
    }
}
