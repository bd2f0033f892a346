//! Errors of joining, of an open client or one that feeds, and of `main`.
//!
//! Requests that the server refused are an error of the next call that reports them. Invariant: at most
//! [`REFUSALS_KEPT`] of them are kept, the oldest ones; of the others only the number is known.

use std::error::Error;
use std::fmt;
#[cfg(feature = "quic")]
use std::io;
#[cfg(feature = "quic")]
use std::path::PathBuf;
use std::time::Duration;

use glam::Vec3;
#[cfg(feature = "quic")]
use rhumb_link::ConnectError;
use rhumb_link::TransportCode;
use rhumb_protocol::Ending;
use rhumb_protocol::message::{Denial, InvalidToken};
use rhumb_protocol::scene::{IdOutOfRange, InvalidSceneName, SceneName};
use rhumb_protocol::session::{CloseCode, Misuse};
use rhumb_reckoning::{BodyId, Tick};
use rhumb_view::{AddError, InvalidTicks, RefusedRequest};

/// Reason why a client did not join its scene.
#[derive(Debug)]
pub enum OpenError {
    /// The address is not a host and port that can be resolved.
    #[cfg(feature = "quic")]
    Address {
        /// The address, as the caller wrote it.
        server: String,
        /// The resolver's error.
        cause: io::Error,
    },
    /// Nothing answers at a Unix socket.
    #[cfg(feature = "quic")]
    Socket {
        /// The socket.
        path: PathBuf,
        /// The system's error.
        cause: io::Error,
    },
    /// The connection was not established.
    #[cfg(feature = "quic")]
    Connect(ConnectError),
    /// The text is not a valid scene name.
    SceneName {
        /// The text, as the caller wrote it.
        scene: String,
        /// The rule that it breaks.
        cause: InvalidSceneName,
    },
    /// The delay or the lead of the options.
    Ticks(InvalidTicks),
    /// The text cannot be a token.
    Token(InvalidToken),
    /// The server has no such feed.
    Feed(FeedError),
    /// The server denied the request.
    Denied {
        /// The scene of the request.
        scene: SceneName,
        /// The reason.
        denial: Denial,
    },
    /// The system gives no random bytes for the key of a session.
    #[cfg(feature = "quic")]
    Random(io::Error),
    /// The connection ended, or the server did not answer in time.
    Client(ClientError),
}

/// Reason why a call on an open client failed.
#[derive(Debug)]
pub enum ClientError {
    /// The caller's own mistake; nothing was sent.
    Misuse(Misuse),
    /// The shape of a dynamic body has its centre of mass elsewhere than at its origin, about which the server would turn
    /// it: metres in the axes of the body. Nothing was sent.
    OffCentre(Vec3),
    /// An id that no scene can have; nothing was sent.
    Id(IdOutOfRange),
    /// A pipeline depth beyond its limit; nothing was sent.
    Ticks(InvalidTicks),
    /// The connection is over.
    Ended(Ending),
    /// The server did not answer within the timeout. The call may be repeated; nothing is lost.
    Timeout {
        /// The missing answer.
        awaited: &'static str,
        /// Duration of the wait.
        timeout: Duration,
    },
    /// The server denied a request.
    Denied(Denial),
    /// The server refused requests of this client since the last call that reported some, and changed nothing for them.
    /// The call did what it says all the same, and the next one continues.
    Refused(RefusedRequests),
    /// All shape numbers of the scene are in use.
    TooManyShapes,
    /// States that are not fed, or a client that feeds no scene; nothing was handed over.
    Feed(FeedError),
    /// Another member deleted the scene.
    SceneDeleted,
    /// The scene's engine failed; it stands still after this tick.
    SceneFaulted(Tick),
}

impl fmt::Display for OpenError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            #[cfg(feature = "quic")]
            Self::Address { server, cause } => {
                write!(
                    f,
                    "{server:?} is not a host and port that can be reached: {cause}"
                )
            }
            #[cfg(feature = "quic")]
            Self::Socket { path, cause } => {
                write!(
                    f,
                    "no server can be reached at the socket {}: {cause}",
                    path.display()
                )
            }
            #[cfg(feature = "quic")]
            Self::Connect(cause) => cause.fmt(f),
            Self::SceneName { scene, cause } => {
                write!(f, "{scene:?} cannot name a scene: {cause}")
            }
            Self::Ticks(cause) => cause.fmt(f),
            Self::Token(cause) => cause.fmt(f),
            Self::Feed(cause) => cause.fmt(f),
            Self::Denied { scene, denial } => write!(f, "scene {scene}: {denial}"),
            #[cfg(feature = "quic")]
            Self::Random(cause) => cause.fmt(f),
            Self::Client(cause) => cause.fmt(f),
        }
    }
}

impl Error for OpenError {}

impl fmt::Display for ClientError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Misuse(misuse) => misuse.fmt(f),
            Self::OffCentre(centre) => write!(
                f,
                "the centre of mass of the body's shape is at {centre} m, and must be its origin: add the body that `BodyBuilder::centred` makes, whose pose is that of the centre, or give it moments of inertia of its own"
            ),
            Self::Id(cause) => cause.fmt(f),
            Self::Ticks(cause) => cause.fmt(f),
            Self::Ended(Ending::Closed(code)) => {
                f.write_str("the connection was closed: ")?;
                match *code {
                    TransportCode::FIRST.. => TransportCode(*code).fmt(f),
                    code => CloseCode(code).fmt(f),
                }
            }
            Self::Ended(Ending::TimedOut) => f.write_str(
                "the connection timed out: nothing arrived for ten seconds; a client that joined with a time within which to resume continues",
            ),
            Self::Ended(Ending::Broken) => f.write_str(
                "the connection broke: the server ended, or this process stood still for ten seconds; a client that joined with a time within which to resume continues",
            ),
            Self::Timeout { awaited, timeout } => {
                write!(f, "the server gave no {awaited} within {timeout:?}")
            }
            Self::Denied(denial) => denial.fmt(f),
            Self::Refused(refused) => refused.fmt(f),
            Self::TooManyShapes => AddError::TooManyShapes.fmt(f),
            Self::Feed(cause) => cause.fmt(f),
            Self::SceneDeleted => f.write_str("the scene was deleted"),
            Self::SceneFaulted(tick) => {
                write!(f, "the scene's engine failed; it stands still after {tick}")
            }
        }
    }
}

impl Error for ClientError {}

impl From<Misuse> for ClientError {
    fn from(misuse: Misuse) -> Self {
        Self::Misuse(misuse)
    }
}

impl From<FeedError> for ClientError {
    fn from(cause: FeedError) -> Self {
        Self::Feed(cause)
    }
}

impl From<IdOutOfRange> for ClientError {
    fn from(cause: IdOutOfRange) -> Self {
        Self::Id(cause)
    }
}

impl From<InvalidTicks> for ClientError {
    fn from(cause: InvalidTicks) -> Self {
        Self::Ticks(cause)
    }
}

impl From<AddError> for ClientError {
    fn from(error: AddError) -> Self {
        match error {
            AddError::Misuse(misuse) => Self::Misuse(misuse),
            AddError::TooManyShapes => Self::TooManyShapes,
        }
    }
}

impl From<ClientError> for OpenError {
    fn from(error: ClientError) -> Self {
        Self::Client(error)
    }
}

#[cfg(feature = "quic")]
impl From<ConnectError> for OpenError {
    fn from(error: ConnectError) -> Self {
        Self::Connect(error)
    }
}

/// Limit of refusals that no call has reported yet. Far more than an application reads, and some 50 KiB.
const REFUSALS_KEPT: usize = 1_024;

/// Requests that the server refused: at least one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RefusedRequests {
    kept: Box<[RefusedRequest]>,
    left_out: u64,
}

impl RefusedRequests {
    /// The first 1,024 of them, the oldest first.
    #[must_use]
    pub fn refusals(&self) -> &[RefusedRequest] {
        &self.kept
    }

    /// The number of further ones, of which nothing else is kept. They are events as well.
    #[must_use]
    pub const fn left_out(&self) -> u64 {
        self.left_out
    }

    /// The oldest one.
    ///
    /// # Panics
    ///
    /// Never: there is at least one.
    #[must_use]
    pub fn first(&self) -> &RefusedRequest {
        self.kept.first().expect("there is at least one refusal")
    }
}

impl fmt::Display for RefusedRequests {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.first().fmt(f)?;
        match self.kept.len() as u64 - 1 + self.left_out {
            0 => Ok(()),
            more => write!(f, " (and {more} more refusals)"),
        }
    }
}

/// Refusals that no call has reported yet.
#[derive(Debug, Default)]
pub(crate) struct Unreported {
    kept: Vec<RefusedRequest>,
    left_out: u64,
}

impl Unreported {
    /// Adds a refusal.
    pub(crate) fn add(&mut self, refusal: RefusedRequest) {
        if self.kept.len() < REFUSALS_KEPT {
            self.kept.push(refusal);
        } else {
            self.left_out += 1;
        }
    }

    /// Takes all refusals; `None` if there are none.
    pub(crate) fn take(&mut self) -> Option<RefusedRequests> {
        let Self { kept, left_out } = std::mem::take(self);
        (!kept.is_empty()).then(|| RefusedRequests {
            kept: kept.into(),
            left_out,
        })
    }
}

/// Any error, for `main`: its `Debug` is its sentence, followed by those of its causes.
///
/// ```
/// fn main() -> Result<(), rhumb_client::MainError> {
///     let address = std::env::args().nth(1).unwrap_or_default();
/// #   let address = "1";
///     let count: u32 = address.parse()?;
///     (count > 0).then_some(()).ok_or("the number is missing")?;
///     Ok(())
/// }
/// ```
pub struct MainError(Box<dyn Error + Send + Sync>);

impl<E: Into<Box<dyn Error + Send + Sync>>> From<E> for MainError {
    fn from(error: E) -> Self {
        Self(error.into())
    }
}

impl fmt::Debug for MainError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)?;
        let mut cause = self.0.source();
        while let Some(error) = cause {
            write!(f, "\n  because: {error}")?;
            cause = error.source();
        }
        Ok(())
    }
}

impl fmt::Display for MainError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

/// Reason why states are not taken. Nothing was handed over.
#[derive(Clone, Debug, PartialEq)]
pub enum FeedError {
    /// The client does not own a fed scene.
    NotOwner,
    /// The server runs elsewhere, or by a driver of its own.
    NoServer,
    /// Another client feeds a scene of this name.
    Taken(SceneName),
    /// The connection is one for feeding another scene.
    OtherScene(SceneName),
    /// The client that feeds a scene would join one that is there.
    Joins,
    /// The scene steps by what its owner feeds.
    StepsByFeed,
    /// The states are of a tick that was fed already, or before it.
    TickNotLater {
        /// Theirs.
        tick: Tick,
        /// The newest one that was fed.
        newest: Tick,
    },
    /// The states are of a tick too long after the newest one.
    TicksApart {
        /// Theirs.
        tick: Tick,
        /// The newest one that was fed.
        newest: Tick,
        /// The most ticks from one to the next.
        most: u64,
    },
    /// The scene has no such body.
    UnknownBody {
        /// The place among the states.
        place: usize,
        /// The body.
        body: BodyId,
    },
    /// A body has two states.
    Twice(BodyId),
    /// A number beyond its limit.
    OutOfRange(OutOfRange),
    /// The request was accepted or refused before.
    Answered,
}

/// A number of a fed state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum FedQuantity {
    /// A coordinate, m.
    Position,
    /// A component of a linear velocity, m/s.
    Linear,
    /// A component of an angular velocity, rad/s.
    Angular,
}

/// A number of a fed state beyond its limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutOfRange {
    /// The place among the states, and the body.
    pub state: (usize, BodyId),
    /// The quantity.
    pub quantity: FedQuantity,
    /// Its value.
    pub value: f32,
    /// The greatest one that is allowed, of either sign.
    pub most: f32,
}

impl fmt::Display for FeedError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotOwner => f.write_str(
                "this client does not feed its scene: join over the connection that `feed` of a server in this process returns",
            ),
            Self::NoServer => f.write_str(
                "the server takes no fed scenes: only one in this process without a driver of its own does",
            ),
            Self::Taken(name) => write!(f, "another client feeds the scene {name}"),
            Self::OtherScene(name) => {
                write!(f, "the connection is for feeding the scene {name}: join that one")
            }
            Self::Joins => f.write_str(
                "the client that feeds a scene makes it, and a scene that is there has an engine already: join with the condition to create it",
            ),
            Self::Answered => f.write_str("the request has an answer already: answer each once"),
            Self::StepsByFeed => f.write_str(
                "the scene steps by what this client feeds: feed the states of the next tick instead of advancing",
            ),
            Self::TickNotLater { tick, newest } => write!(
                f,
                "the states are of {tick}, and those of {newest} were fed before: each tick must be later than the one before"
            ),
            Self::TicksApart { tick, newest, most } => write!(
                f,
                "the states are of {tick}, and the newest fed ones of {newest}: the next may be {most} ticks later at most, so feed more often, or count from 1"
            ),
            Self::UnknownBody { place, body } => write!(
                f,
                "state {place} is of {body}, which is not in the scene: add it first, and feed no body that was removed"
            ),
            Self::Twice(body) => write!(f, "{body} has two states: feed each body once a tick"),
            Self::OutOfRange(wrong) => wrong.fmt(f),
        }
    }
}

impl fmt::Display for OutOfRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (place, body) = self.state;
        let Self { value, most, .. } = self;
        let (name, unit, advice) = match self.quantity {
            FedQuantity::Position => ("position", "m", "remove the body that left the world"),
            FedQuantity::Linear => (
                "linear velocity",
                "m/s",
                "leave velocities out if the engine's are of no use",
            ),
            FedQuantity::Angular => (
                "angular velocity",
                "rad/s",
                "leave velocities out if the engine's are of no use",
            ),
        };
        write!(
            f,
            "state {place}, of {body}, has a {name} of {value} {unit} along an axis, and {most} {unit} is the most: {advice}"
        )
    }
}

impl Error for FeedError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug)]
    struct Outer(ClientError);

    impl fmt::Display for Outer {
        fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("the run ended")
        }
    }

    impl Error for Outer {
        fn source(&self) -> Option<&(dyn Error + 'static)> {
            Some(&self.0)
        }
    }

    #[test]
    fn what_main_prints_is_the_sentence_and_its_causes() {
        let error = MainError::from(ClientError::SceneDeleted);
        assert_eq!(format!("{error:?}"), "the scene was deleted");
        let error = MainError::from(Outer(ClientError::SceneDeleted));
        let text = "the run ended\n  because: the scene was deleted";
        assert_eq!(format!("{error:?}"), text);
        assert_eq!(format!("{:?}", MainError::from("no address")), "no address");
    }
}
