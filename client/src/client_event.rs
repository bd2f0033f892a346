//! What happened in the scene or to a request.
//!
//! And how the connection is doing. Said to whoever asks; nothing is decided here.

use rhumb_protocol::message::{
    AuthorityError, Denial, RemovalCause, StreamChoice, TierChangeCause,
};
use rhumb_protocol::scene::{CommandError, IdRange};
use rhumb_protocol::stream::{PublisherStatistics, SubscriberStatistics};
use rhumb_reckoning::{BodyId, Tick};
use rhumb_transport::WireStatistics;

/// Something that happened in the scene or to a command.
#[derive(Clone, Debug, PartialEq)]
pub enum ClientEvent {
    /// Commands up to this number were applied or refused, before the step that leaves this tick.
    Applied {
        /// The last one's number.
        through: u64,
        /// The tick.
        tick: Tick,
    },
    /// A command was refused; nothing of it was applied.
    Refused {
        /// Its number.
        number: u64,
        /// Why.
        error: CommandError,
    },
    /// A body came into the scene.
    BodyPlaced(BodyId),
    /// A body left the scene.
    BodyRemoved {
        /// Which.
        id: BodyId,
        /// Why.
        cause: RemovalCause,
    },
    /// The copy of a body was not what the server had said, and was made right. That is a fault of one of the two ends.
    Amended(BodyId),
    /// More body indices were granted.
    Reserved(IdRange),
    /// A request was turned down.
    Denied(Denial),
    /// The copy is by another stream from now on.
    SubscriptionChanged(StreamChoice),
    /// The server is moving this client to another stream because of its link; `SubscriptionChanged` tells when the copy is by it.
    TierChanged {
        /// Which stream.
        to: StreamChoice,
        /// Why.
        cause: TierChangeCause,
    },
    /// These bodies, in rising order, are this client's to drive from now on, and no others.
    AuthorityGrant(Vec<BodyId>),
    /// The bodies that this client asked to drive are not its to drive; those that it drove before still are.
    AuthorityDenied(AuthorityError),
}

/// How the connection and the stream are doing.
#[derive(Clone, Copy, Debug)]
pub struct Statistics {
    /// What crossed the wire.
    pub wire: WireStatistics,
    /// What the stream said.
    pub stream: SubscriberStatistics,
    /// What was said of the bodies that this client drives, since they were granted.
    pub driven: PublisherStatistics,
    /// The newest tick that the stream watermark_tick for.
    pub watermark_tick: Tick,
    /// The newest tick at which every body is within its tolerance.
    pub complete: Tick,
    /// How many ticks the view lies behind the server's clock, where that is known.
    pub behind_ticks: Option<f64>,
}
