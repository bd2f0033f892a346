//! Messages of a client: the first ones, and requests of a member.
//!
//! Codec only: `session` decides which message is allowed now.

use alloc::vec::Vec;

use rhumb_reckoning::Tick;

use super::cell::CellRequest;
use super::identity::{Extensions, SessionRequest};
use super::request::{ResyncCause, StreamChoice, TakeAuthority, TierPolicy};
use super::{Framed, MAGIC, frame, put};
use crate::endpoint::Instant;
use crate::limits::{DATAGRAM_BYTES_MAX, RESERVE_MAX, VERSIONS_MAX};
use crate::packet::StreamId;
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
