//! The connection's state at both ends: allowed messages, codes, events.
//!
//! Close codes of the protocol and of the transport are numbers with names; each end decides when to close with them.
//! Misuse is caused by the application alone, never by bytes of a peer.
//!
//! Events are what a client session reports to its application, in the order in which it received them.

mod client;
mod replica;
mod server;
mod upstream;

use alloc::vec::Vec;
use core::fmt;

use rhumb_reckoning::{BodyId, Tick};

use crate::endpoint::{Ending, Instant, Span};
use crate::limits::{
    AUTHORITY_BODIES_MAX, CELLS_PER_MEMBER_MAX, HITS_MAX, QUERY_COST_MAX, RESERVE_MAX,
};
use crate::message::{
    AuthorityError, Denial, FaultCause, Inspection, QueryResult, RemovalCause, SessionState,
    StreamChoice, TierChangeCause, Welcome,
};
use crate::scene::{BodyEvent, Cell, CommandError, IdRange, Invalid};
use crate::wire::Malformed;

pub use client::{CellState, ClientSession, StandingEvents};
pub use replica::Replica;
pub use server::ServerSession;
pub use upstream::UpstreamReceiver;

/// The code with which one end closes the connection (PROTOCOL 3.4).
///
/// An unknown code is kept as it is. Codes from 0x100 on belong to the transport.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CloseCode(pub u32);

impl CloseCode {
    /// Nothing is wrong; the client has finished.
    pub const DONE: Self = Self(0);
    /// Bytes on the control stream do not follow the protocol.
    pub const MALFORMED: Self = Self(1);
    /// A message is not allowed in this state.
    pub const VIOLATION: Self = Self(2);
    /// The two ends have no version in common.
    pub const VERSION: Self = Self(3);
    /// A limit of the protocol was exceeded.
    pub const LIMIT: Self = Self(4);
    /// A critical extension is unknown.
    pub const EXTENSION: Self = Self(5);
    /// The scene does not answer and is quarantined: it is lost, and its name is free again when its step has ended.
    pub const SCENE_QUARANTINED: Self = Self(6);
    /// The server, or a scene that a client comes back to, has no place now.
    pub const BUSY: Self = Self(7);
    /// The client sent no `Hello` in time.
    pub const HELLO_LATE: Self = Self(8);
    /// The process of the scene has ended, and the scene is restored from what is durable: a later attempt finds it.
    pub const SCENE_RESTORING: Self = Self(9);
    /// The process of the scene has ended, and nothing of the scene was durable: it is lost, and its name is free.
    pub const SCENE_LOST: Self = Self(10);
    /// Another server has the scene, and the last `Welcome` said where.
    pub const SCENE_ELSEWHERE: Self = Self(11);
    /// The server requires a token, and the client's hello has none.
    pub const TOKEN_MISSING: Self = Self(16);
    /// The token is not one of this server: its form, its signature or its audience is wrong.
    pub const TOKEN_INVALID: Self = Self(17);
    /// The token has expired.
    pub const TOKEN_EXPIRED: Self = Self(18);
    /// The token does not name the scene of the connection.
    pub const TOKEN_SCENE: Self = Self(19);
    /// Another connection has taken the session up.
    pub const SESSION_TAKEN: Self = Self(32);
}

impl From<Malformed> for CloseCode {
    fn from(_: Malformed) -> Self {
        Self::MALFORMED
    }
}

impl fmt::Display for CloseCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match *self {
            Self::DONE => "done",
            Self::MALFORMED => "bytes that are not of the protocol",
            Self::VIOLATION => "a message that is not allowed in this state",
            Self::VERSION => "no version in common",
            Self::LIMIT => "a limit of the protocol was exceeded",
            Self::EXTENSION => "an extension that must be known is not",
            Self::SCENE_QUARANTINED => "the scene does not answer and is quarantined",
            Self::BUSY => "there is no place now; a later attempt may find one",
            Self::HELLO_LATE => "no hello in time",
            Self::SCENE_RESTORING => "the scene is restored after its process ended",
            Self::SCENE_LOST => "the scene is lost with its process",
            Self::SCENE_ELSEWHERE => "another server has the scene",
            Self::TOKEN_MISSING => "the server requires a token",
            Self::TOKEN_INVALID => "the token is not one of this server",
            Self::TOKEN_EXPIRED => "the token has expired",
            Self::TOKEN_SCENE => "the token does not name the scene",
            Self::SESSION_TAKEN => "another connection has taken the session up",
            Self(code) => return write!(f, "unknown close code {code}"),
        })
    }
}

/// A close code of the transport (PROTOCOL 3.4).
///
/// Codes from 0x100 on belong to the transport, those below to the protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TransportCode(pub u32);

impl TransportCode {
    /// The least of these codes.
    pub const FIRST: u32 = 0x100;
    /// The end left without a reason.
    pub const LEFT: Self = Self(0x100);
    /// The server is stopping; another attempt later may find it again.
    pub const GOING_AWAY: Self = Self(0x101);
    /// More control bytes wait for this peer than the bound allows: the peer reads too slowly.
    pub const CONTROL_OVERFLOW: Self = Self(0x102);
    /// The client opened no control stream in time, or broke it.
    pub const NO_CONTROL_STREAM: Self = Self(0x103);
    /// The peer's datagrams are disabled or too small for the protocol.
    pub const NO_DATAGRAMS: Self = Self(0x104);
}

impl fmt::Display for TransportCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::LEFT => f.write_str("left"),
            Self::GOING_AWAY => f.write_str("server going away"),
            Self::CONTROL_OVERFLOW => f.write_str("control lane too slow"),
            Self::NO_CONTROL_STREAM => f.write_str("no control stream"),
            Self::NO_DATAGRAMS => f.write_str("datagrams absent or too small"),
            Self(code) => write!(f, "close code {code:#x}"),
        }
    }
}

/// A call that the application may not make, or whose arguments are out of range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Misuse {
    /// The connection is in a state that does not allow this call.
    NotNow,
    /// A number is not finite or out of range.
    Invalid(Invalid),
    /// This number of body indices cannot be reserved in one request.
    Indices(u32),
    /// One member cannot have authority over this number of bodies.
    TooManyAuthorityBodies(usize),
    /// This member neither has nor requested authority over the body.
    NoAuthority(BodyId),
    /// The state of a body has a number that is not finite or out of range.
    State(BodyId, Invalid),
    /// The server has not answered an earlier request for authority.
    AuthorityUnanswered,
    /// A dynamic body needs a shape with volume.
    NoInside,
    /// A joint cannot join a body to itself.
    JoinedToItself(BodyId),
    /// A query asks for more bodies than it may find.
    Hits(u8),
    /// One message cannot have queries of this cost: there is none, or too many.
    QueryCost(u32),
    /// The scene was not joined by cells, or its server does not divide it.
    NotDivided,
    /// One member cannot take so many cells.
    TooManyCells,
    /// A place of a cell is beyond those of any grid.
    CellPlace(Cell),
}

impl fmt::Display for Misuse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotNow => f.write_str("not possible in this state of the connection"),
            Self::Invalid(invalid) => invalid.fmt(f),
            Self::State(id, invalid) => write!(f, "state of {id}: {invalid}"),
            Self::AuthorityUnanswered => f.write_str(
                "an earlier request for authority is unanswered: wait for the event that answers it, and ask then",
            ),
            Self::Indices(count) => write!(
                f,
                "{count} body indices cannot be reserved at once; the range is 1 to {RESERVE_MAX}"
            ),
            Self::TooManyAuthorityBodies(count) => {
                write!(
                    f,
                    "one member cannot have authority over {count} bodies; at most {AUTHORITY_BODIES_MAX}"
                )
            }
            Self::Hits(hits) => {
                write!(f, "a query finds 1 to {HITS_MAX} bodies, and not {hits}")
            }
            Self::QueryCost(cost) => write!(
                f,
                "the queries of one call cost {cost} together, and must cost 1 to {QUERY_COST_MAX}: ask in several calls"
            ),
            Self::NotDivided => f.write_str(
                "the scene is not divided into cells for this member: its server has no grid, or the join did not ask for cells",
            ),
            Self::TooManyCells => write!(
                f,
                "one member takes at most {CELLS_PER_MEMBER_MAX} cells: take those of a smaller distance"
            ),
            Self::CellPlace(cell) => write!(
                f,
                "{cell} is in no world: a place is at most {} from 0",
                Cell::PLACE_MAX
            ),
            Self::NoInside => f.write_str(
                "a dynamic body needs a shape with volume; height fields, meshes, half-spaces and compounds with one of them are for fixed and kinematic bodies",
            ),
            Self::JoinedToItself(id) => write!(f, "a joint cannot join {id} to itself"),
            Self::NoAuthority(id) => write!(f, "this member has no authority over {id}"),
        }
    }
}

impl core::error::Error for Misuse {}

/// An answer of the server or a change of the scene.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The server accepted the connection. The message carries the scene's config, if the scene exists.
    Welcomed(Welcome),
    /// The scene was created.
    Created,
    /// The replica is complete. The application may assign these body indices.
    Joined(IdRange),
    /// From now on the replica follows this stream, chosen by the application or by the server's tier policy.
    SubscriptionChanged(StreamChoice),
    /// The server moves the member to this stream because of its link; `SubscriptionChanged` follows once the replica
    /// is complete.
    TierChanged {
        /// The new stream.
        to: StreamChoice,
        /// The reason for the change.
        cause: TierChangeCause,
    },
    /// The membership ended.
    Left,
    /// The scene was deleted.
    Deleted,
    /// The application may assign these further body indices.
    Reserved(IdRange),
    /// The server denied a request about the scene.
    Denied(Denial),
    /// All commands up to this number were applied or refused.
    Applied {
        /// The number of the last command among them.
        through: u64,
        /// The newest tick: the commands act in the step after it.
        tick: Tick,
    },
    /// One command was refused.
    Refused {
        /// The number that `command` returned.
        number: u64,
        /// The reason for the refusal.
        error: CommandError,
    },
    /// The connection ended; the client tries to resume the session over another one.
    Interrupted(Ending),
    /// The session is resumed over another connection: the replica is complete again, and commands that were not done
    /// are sent again, and authority over bodies is requested again. A scene that was restored may continue at an
    /// earlier tick than the last one sent.
    Resumed(SessionState),
    /// The server no longer knows the session: which of its commands were done is unknown. The connection
    /// ends.
    SessionLost(SessionState),
    /// The scene up to this tick, and this number of commands of the session, survive a crash of the server.
    Durable {
        /// Commands of the session from its first on.
        commands: u64,
        /// The tick.
        tick: Tick,
    },
    /// A body was placed in the scene, or its description was replaced.
    BodyPlaced(BodyId),
    /// A body was removed from the scene.
    BodyRemoved {
        /// The removed body.
        id: BodyId,
        /// The reason for the removal.
        cause: RemovalCause,
    },
    /// A checksum differs from that of the replica: a fault of the server or of this client. The session requests a new
    /// snapshot.
    ChecksumMismatch,
    /// The physics engine failed. The scene does not step past this tick.
    SceneFaulted {
        /// The tick.
        tick: Tick,
        /// The reason why the scene was not restored.
        cause: FaultCause,
    },
    /// The physics engine failed, and the scene continues from this tick without the commands that it failed on. A
    /// `Refused` with `EngineFailed` names each of them to its member, also one that was applied before. It comes after the
    /// events of bodies up to this tick; the server tells anew which pairs touch and which bodies are in sensors.
    SceneRestored(Tick),
    /// The server receives nothing from the member with authority over this body. Its pose is a guess, and its error
    /// bound is unknown, from a tick on.
    PublisherSilent {
        /// The body.
        id: BodyId,
        /// The tick.
        since: Tick,
    },
    /// The server receives from that member again, or its authority has ended: from this tick on the body has an error
    /// bound.
    PublisherActive {
        /// The body.
        id: BodyId,
        /// The tick.
        tick: Tick,
    },
    /// The application has authority over these bodies and no others from now on, in rising order.
    AuthorityGrant(Vec<BodyId>),
    /// The server denied the requested authority. Authority granted earlier stays, but not from one connection of a
    /// session to the next.
    AuthorityDenied(AuthorityError),
    /// The answers to the queries of one call, with the number that the call returned.
    QueryResult(QueryResult),
    /// Something happened to a body that reports events. The replica is complete up to this tick or a later one.
    Body {
        /// The tick in which it happened.
        tick: Tick,
        /// The event.
        event: BodyEvent,
    },
    /// Events of bodies were not sent or not kept, in this tick or before it: a tick had too many of them, or the client was
    /// too far behind. The events that follow tell anew which pairs touch and which bodies are in sensors.
    EventsMissed {
        /// The tick.
        tick: Tick,
        /// Their number.
        count: u64,
        /// Pairs that touch, or of a body in a sensor, that the events that follow leave out: a client knows
        /// [`STANDING_PAIRS_MAX`](crate::limits::STANDING_PAIRS_MAX). Counted as they began.
        untold: u64,
    },
    /// A description of the scene's state.
    Inspected(Inspection),
    /// A sample of the server's clock, referred to the middle of a round trip.
    ClockSeen {
        /// The client's time of the sample.
        at: Instant,
        /// The newest tick of the scene at that time.
        tick: Tick,
        /// Time between that tick and the sample.
        since_tick: Span,
        /// The round trip of the ping that took the sample.
        round_trip: Span,
    },
    /// The connection ended.
    Ended(Ending),
}
