//! What can go wrong for a client, named so that its user knows what to do.

use std::fmt;
use std::io;
use std::time::Duration;

use rhumb_protocol::Ending;
use rhumb_protocol::limits::SHAPES_MAX;
use rhumb_protocol::message::Denial;
use rhumb_protocol::scene::{InvalidSceneName, SceneName};
use rhumb_protocol::session::{CloseCode, Misuse};
use rhumb_reckoning::Tick;
use rhumb_transport::{ConnectError, TransportCode};

/// Why a client did not come into its scene.
#[derive(Debug)]
pub enum OpenError {
    /// The server's name is not that of a host and port.
    Address {
        /// As it was given.
        server: String,
        /// What the resolver says.
        cause: io::Error,
    },
    /// No connection.
    Connect(ConnectError),
    /// The text cannot name a scene.
    SceneName {
        /// As it was given.
        scene: String,
        /// What names a scene.
        cause: InvalidSceneName,
    },
    /// The server turned the request down.
    Denied {
        /// Which scene it was about.
        scene: SceneName,
        /// Why.
        denial: Denial,
    },
    /// The connection ended, or the server did not answer in time.
    Client(ClientError),
}

/// Why a call on an open client failed.
#[derive(Debug)]
pub enum ClientError {
    /// The caller's own mistake; nothing was sent.
    Misuse(Misuse),
    /// The connection is over.
    Ended(Ending),
    /// The server did not answer within the patience. The call may be repeated; nothing is lost.
    Timeout {
        /// What was awaited.
        awaited: &'static str,
        /// For how long.
        patience: Duration,
    },
    /// The server turned a request down.
    Denied(Denial),
    /// The scene has no number left for another shape.
    TooManyShapes,
    /// Another member deleted the scene.
    SceneDeleted,
    /// The scene's engine failed; it stands still after this tick.
    SceneFaulted(Tick),
}

impl fmt::Display for OpenError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Address { server, cause } => {
                write!(
                    f,
                    "{server:?} is not a host and port that can be reached: {cause}"
                )
            }
            Self::Connect(cause) => cause.fmt(f),
            Self::SceneName { scene, cause } => {
                write!(f, "{scene:?} cannot name a scene: {cause}")
            }
            Self::Denied { scene, denial } => write!(f, "scene {scene}: {denial}"),
            Self::Client(cause) => cause.fmt(f),
        }
    }
}

impl std::error::Error for OpenError {}

impl fmt::Display for ClientError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Misuse(misuse) => misuse.fmt(f),
            Self::Ended(Ending::Closed(code)) => {
                f.write_str("the connection was closed: ")?;
                match *code {
                    TransportCode::FIRST.. => TransportCode(*code).fmt(f),
                    code => CloseCode(code).fmt(f),
                }
            }
            Self::Ended(Ending::TimedOut) => f.write_str("the server was not heard any more"),
            Self::Ended(Ending::Broken) => f.write_str("the connection broke"),
            Self::Timeout { awaited, patience } => {
                write!(f, "the server gave no {awaited} within {patience:?}")
            }
            Self::Denied(denial) => denial.fmt(f),
            Self::TooManyShapes => write!(
                f,
                "the scene has {SHAPES_MAX} shapes, as many as it may; remove one that no body has, or use equal shapes"
            ),
            Self::SceneDeleted => f.write_str("another member deleted the scene"),
            Self::SceneFaulted(tick) => {
                write!(f, "the scene's engine failed; it stands still after {tick}")
            }
        }
    }
}

impl std::error::Error for ClientError {}

impl From<Misuse> for ClientError {
    fn from(misuse: Misuse) -> Self {
        Self::Misuse(misuse)
    }
}

impl From<ClientError> for OpenError {
    fn from(error: ClientError) -> Self {
        Self::Client(error)
    }
}

impl From<ConnectError> for OpenError {
    fn from(error: ConnectError) -> Self {
        Self::Connect(error)
    }
}
