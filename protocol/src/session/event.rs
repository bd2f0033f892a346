//! Events that a client session reports to its application.
//!
//! The session reports them in the order in which it received them. Nothing is decided here.

use alloc::vec::Vec;

use rhumb_reckoning::{BodyId, Tick};

use crate::endpoint::{Ending, Instant, Span};
use crate::message::{
    AuthorityError, Denial, FaultCause, Inspection, QueryResult, RemovalCause, SessionState,
    StreamChoice, TierChangeCause, Welcome,
};
use crate::scene::{BodyEvent, CommandError, IdRange};

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
    /// `Refused` with `EngineFailed` names each of them to its member, also one that was applied before.
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
    /// Events of bodies were not sent or not kept, in this tick or before it: a tick had too many of them, the
    /// client was too far behind, the scene was restored before
    /// they were read, or more pairs stand than a client knows.
    EventsMissed {
        /// The tick.
        tick: Tick,
        /// Their number.
        count: u64,
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
