//! What a client's application should know: answers, and what happened.
//!
//! Said by the session in the order in which it was heard; nothing is decided here.

use alloc::vec::Vec;

use rhumb_reckoning::{BodyId, Tick};

use crate::endpoint::Ending;
use crate::message::{
    AuthorityError, Denial, Inspection, RemovalCause, StreamChoice, TierChangeCause, Welcome,
};
use crate::scene::{CommandError, IdRange};
use crate::time::{Instant, Span};

/// What a client's application should know.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The server answered; the scene has these config, if it exists.
    Welcomed(Welcome),
    /// The scene was created.
    Created,
    /// The copy is whole; these body indices are the application's to give out.
    Joined(IdRange),
    /// The copy is by the stream that was chosen, or that the server moved the member to, from now on.
    SubscriptionChanged(StreamChoice),
    /// The server is moving the member to this stream for its link's sake; `SubscriptionChanged` tells when the copy is by it.
    TierChanged {
        /// Which stream.
        to: StreamChoice,
        /// Why.
        cause: TierChangeCause,
    },
    /// No longer a member.
    Left,
    /// The scene is gone.
    Deleted,
    /// More body indices.
    Reserved(IdRange),
    /// A request about the scene was turned down.
    Denied(Denial),
    /// Commands up to this number were applied or refused.
    Applied {
        /// The last one's number.
        through: u64,
        /// Before this tick's step.
        tick: Tick,
    },
    /// One command was refused.
    Refused {
        /// Its number.
        number: u64,
        /// Why.
        error: CommandError,
    },
    /// A body came.
    BodyPlaced(BodyId),
    /// A body went.
    BodyRemoved {
        /// Which.
        id: BodyId,
        /// Why.
        cause: RemovalCause,
    },
    /// A checksum differs from that of the copy: a fault of the server or of this client. The session requests a new
    /// snapshot.
    ChecksumMismatch,
    /// The engine failed; the scene stands still after this tick.
    SceneFaulted(Tick),
    /// These bodies, in rising order, are the application's to drive from now on, and no others.
    AuthorityGrant(Vec<BodyId>),
    /// What was asked to be driven is not; what was driven before goes on.
    AuthorityDenied(AuthorityError),
    /// How the scene is.
    Inspected(Inspection),
    /// Where the server's clock stood at a moment, by the middle of a round trip.
    ClockSeen {
        /// The client's moment.
        at: Instant,
        /// The newest tick then.
        tick: Tick,
        /// How long before.
        since_tick: Span,
        /// How long the question took.
        round_trip: Span,
    },
    /// The connection is over.
    Ended(Ending),
}
