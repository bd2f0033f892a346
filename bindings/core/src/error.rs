//! Errors of all bindings, and their kinds.
//!
//! A language reports the kind in its own way, and the sentence as it is.

use std::fmt;

use rhumb_client::scene::Invalid;
use rhumb_client::{
    ClientError, FingerprintError, InvalidMotion, InvalidTolerance, Misuse, OpenError, QueryError,
};

use crate::body_word::InvalidBodyWord;

/// Reason why a call of a binding failed.
#[derive(Debug)]
pub enum BindingError {
    /// The client did not connect or did not join.
    Open(OpenError),
    /// A call on a joined client failed.
    Client(ClientError),
    /// The server did not answer the queries.
    Query(QueryError),
    /// A number is not allowed.
    Invalid(Invalid),
    /// A tolerance is not allowed.
    Tolerance(InvalidTolerance),
    /// A state of a body is not allowed.
    Motion(InvalidMotion),
    /// The text is no fingerprint.
    Fingerprint(FingerprintError),
    /// A word is the id of no body.
    Body(InvalidBodyWord),
    /// An argument is wrong.
    Argument {
        /// Its name.
        argument: &'static str,
        /// The rule that it breaks.
        needed: &'static str,
    },
    /// An argument that must not be null is null.
    Null(&'static str),
    /// A caller's buffer is too small.
    TooSmall {
        /// Elements that it has.
        capacity: usize,
        /// Elements that it needs.
        needed: usize,
    },
    /// The connection or scene is closed, or was never open.
    Closed,
    /// Another thread is inside a call of the same connection or scene.
    Busy,
    /// A fault of this library: the call panicked. The scene can only be closed.
    Fault(String),
}

/// Kinds of errors that a caller may want to tell apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorKind {
    /// The caller's mistake; nothing was sent.
    Invalid,
    /// A null pointer.
    Null,
    /// The caller's buffer is too small; nothing was written.
    TooSmall,
    /// Closed, or never opened.
    Closed,
    /// Another thread is inside a call.
    Busy,
    /// The server was not reached, or is not the one that is trusted.
    Connect,
    /// The server denied the request.
    Denied,
    /// The server refused requests of earlier calls; the call did what it says all the same.
    Refused,
    /// The server did not answer in time. The call may be repeated.
    Timeout,
    /// The connection is over.
    Ended,
    /// The scene was deleted, or its engine failed.
    SceneGone,
    /// A fault of this library.
    Fault,
}

impl BindingError {
    /// The kind of the error.
    #[must_use]
    pub const fn kind(&self) -> ErrorKind {
        match self {
            Self::Open(error) => match error {
                OpenError::Address { .. } | OpenError::Connect(_) | OpenError::Socket { .. } => {
                    ErrorKind::Connect
                }
                OpenError::SceneName { .. } | OpenError::Ticks(_) | OpenError::Token(_) => {
                    ErrorKind::Invalid
                }
                OpenError::Denied { .. } => ErrorKind::Denied,
                OpenError::Random(_) => ErrorKind::Fault,
                OpenError::Client(error) => client_kind(error),
            },
            Self::Client(error) => client_kind(error),
            Self::Query(error) => match error {
                QueryError::Invalid(_) => ErrorKind::Invalid,
                QueryError::SceneFaulted => ErrorKind::SceneGone,
                QueryError::Overloaded | QueryError::Unanswerable | QueryError::Other(_) => {
                    ErrorKind::Denied
                }
            },
            Self::Invalid(_)
            | Self::Tolerance(_)
            | Self::Motion(_)
            | Self::Fingerprint(_)
            | Self::Body(_)
            | Self::Argument { .. } => ErrorKind::Invalid,
            Self::Null(_) => ErrorKind::Null,
            Self::TooSmall { .. } => ErrorKind::TooSmall,
            Self::Closed => ErrorKind::Closed,
            Self::Busy => ErrorKind::Busy,
            Self::Fault(_) => ErrorKind::Fault,
        }
    }
}

const fn client_kind(error: &ClientError) -> ErrorKind {
    match error {
        ClientError::Misuse(Misuse::NotNow) => ErrorKind::Denied,
        ClientError::Misuse(_) | ClientError::Id(_) => ErrorKind::Invalid,
        ClientError::Refused(_) => ErrorKind::Refused,
        ClientError::Ended(_) => ErrorKind::Ended,
        ClientError::Timeout { .. } => ErrorKind::Timeout,
        ClientError::Denied(_) | ClientError::TooManyShapes => ErrorKind::Denied,
        ClientError::SceneDeleted | ClientError::SceneFaulted(_) => ErrorKind::SceneGone,
    }
}

impl fmt::Display for BindingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Open(cause) => cause.fmt(f),
            Self::Client(cause) => cause.fmt(f),
            Self::Query(cause) => cause.fmt(f),
            Self::Invalid(cause) => cause.fmt(f),
            Self::Tolerance(cause) => cause.fmt(f),
            Self::Motion(cause) => cause.fmt(f),
            Self::Fingerprint(cause) => cause.fmt(f),
            Self::Body(cause) => cause.fmt(f),
            Self::Argument { argument, needed } => write!(f, "{argument} must be {needed}"),
            Self::Null(argument) => write!(f, "{argument} must not be null"),
            Self::TooSmall { capacity, needed } => {
                write!(f, "the buffer has {capacity} elements and needs {needed}")
            }
            Self::Closed => f.write_str("it is closed, or was never open"),
            Self::Busy => f.write_str(
                "another thread is inside a call of it; one thread at a time may use a scene",
            ),
            Self::Fault(text) => write!(f, "a fault of this library: {text}"),
        }
    }
}

impl std::error::Error for BindingError {}

impl From<OpenError> for BindingError {
    fn from(error: OpenError) -> Self {
        Self::Open(error)
    }
}

impl From<ClientError> for BindingError {
    fn from(error: ClientError) -> Self {
        Self::Client(error)
    }
}

impl From<Invalid> for BindingError {
    fn from(invalid: Invalid) -> Self {
        Self::Invalid(invalid)
    }
}

impl From<InvalidTolerance> for BindingError {
    fn from(invalid: InvalidTolerance) -> Self {
        Self::Tolerance(invalid)
    }
}

impl From<InvalidMotion> for BindingError {
    fn from(invalid: InvalidMotion) -> Self {
        Self::Motion(invalid)
    }
}

impl From<FingerprintError> for BindingError {
    fn from(error: FingerprintError) -> Self {
        Self::Fingerprint(error)
    }
}

impl From<InvalidBodyWord> for BindingError {
    fn from(invalid: InvalidBodyWord) -> Self {
        Self::Body(invalid)
    }
}
