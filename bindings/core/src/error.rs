//! Errors of all bindings, and their kinds.
//!
//! A language reports the kind in its own way, and the sentence as it is.

use std::fmt;

#[cfg(feature = "serve")]
use rhumb_client::CheckpointError;
use rhumb_client::scene::Invalid;
use rhumb_client::{
    BodyId, ClientError, FingerprintError, InvalidMotion, InvalidTolerance, Misuse, OpenError,
    QueryError,
};

use crate::records::{InvalidPackedId, RefusalRecord, packed_id, with_words};

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
    /// The server refused requests of earlier calls. The call did what it says.
    Refused {
        /// The oldest of them: at least one.
        kept: Vec<RefusalRecord>,
        /// The number of further ones.
        left_out: u64,
    },
    /// The view does not have the body.
    NotInView(BodyId),
    /// A body is given two states at once.
    Twice(BodyId),
    /// A state of a body is not allowed.
    Motion(InvalidMotion),
    /// The text is no fingerprint.
    Fingerprint(FingerprintError),
    /// A word is the id of no body.
    Body(InvalidPackedId),
    /// An argument is wrong.
    Argument {
        /// Its name.
        argument: &'static str,
        /// The rule that it breaks.
        needed: &'static str,
    },
    /// The value of an argument is wrong.
    Value {
        /// Its name.
        argument: &'static str,
        /// The value, as the caller wrote it.
        found: String,
        /// The rule that it breaks: the rest of "it must be".
        needed: String,
    },
    /// A file cannot be loaded.
    #[cfg(feature = "files")]
    File(Box<rhumb_scene_files::LoadError>),
    /// A server in this process did not start.
    #[cfg(feature = "serve")]
    Serve(Box<rhumb_server::RunError>),
    /// A scene cannot be saved, or not be restored.
    #[cfg(feature = "serve")]
    Checkpoint(CheckpointError),
    /// A server in this process stopped by itself, for this reason.
    ServerEnded(String),
    /// This build has no page; the text says what to do.
    NoPage(&'static str),
    /// The scene's client knows its server by its address alone, and so not its page.
    PageElsewhere,
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

/// Limit of refusals in one error, the client's own.
const REFUSALS_KEPT: usize = 1_024;

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
    /// The value of an argument breaks a rule, the rest of "it must be".
    #[must_use]
    pub fn value(
        argument: &'static str,
        found: impl fmt::Display,
        needed: impl fmt::Display,
    ) -> Self {
        Self::Value {
            argument,
            found: found.to_string(),
            needed: needed.to_string(),
        }
    }

    /// A word that is none of several.
    #[must_use]
    pub fn word<'a>(
        argument: &'static str,
        found: &str,
        words: impl IntoIterator<Item = &'a str>,
    ) -> Self {
        let words: Vec<_> = words.into_iter().map(|word| format!("{word:?}")).collect();
        let needed = match words.split_last() {
            Some((last, others)) if !others.is_empty() => {
                format!("{} or {last}", others.join(", "))
            }
            _ => words.concat(),
        };
        Self::value(argument, format_args!("{found:?}"), needed)
    }

    /// The refusals of two calls as those of one. Any other error stays as it is.
    #[must_use]
    pub fn and_later(self, later: Self) -> Self {
        match (self, later) {
            (
                Self::Refused {
                    mut kept,
                    mut left_out,
                },
                Self::Refused {
                    kept: more,
                    left_out: further,
                },
            ) => {
                let room = REFUSALS_KEPT.saturating_sub(kept.len());
                left_out += further + more.len().saturating_sub(room) as u64;
                kept.extend(more.into_iter().take(room));
                Self::Refused { kept, left_out }
            }
            (earlier, _) => earlier,
        }
    }

    /// The kind of the error.
    #[must_use]
    pub const fn kind(&self) -> ErrorKind {
        match self {
            Self::Open(error) => match error {
                OpenError::Address { .. } | OpenError::Connect(_) | OpenError::Socket { .. } => {
                    ErrorKind::Connect
                }
                OpenError::SceneName { .. }
                | OpenError::Ticks(_)
                | OpenError::Token(_)
                | OpenError::Feed(_) => ErrorKind::Invalid,
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
            Self::Refused { .. } => ErrorKind::Refused,
            Self::Invalid(_)
            | Self::Tolerance(_)
            | Self::NotInView(_)
            | Self::Twice(_)
            | Self::Value { .. }
            | Self::Motion(_)
            | Self::Fingerprint(_)
            | Self::Body(_)
            | Self::Argument { .. } => ErrorKind::Invalid,
            #[cfg(feature = "files")]
            Self::File(_) => ErrorKind::Invalid,
            #[cfg(feature = "serve")]
            Self::Serve(_) => ErrorKind::Connect,
            #[cfg(feature = "serve")]
            Self::Checkpoint(error) => checkpoint_kind(error),
            Self::ServerEnded(_) => ErrorKind::Ended,
            Self::NoPage(_) | Self::PageElsewhere => ErrorKind::Denied,
            Self::Null(_) => ErrorKind::Null,
            Self::TooSmall { .. } => ErrorKind::TooSmall,
            Self::Closed => ErrorKind::Closed,
            Self::Busy => ErrorKind::Busy,
            Self::Fault(_) => ErrorKind::Fault,
        }
    }
}

#[cfg(feature = "serve")]
const fn checkpoint_kind(error: &CheckpointError) -> ErrorKind {
    match error {
        CheckpointError::SceneName { .. }
        | CheckpointError::Damaged
        | CheckpointError::Version { .. }
        | CheckpointError::Differs { .. } => ErrorKind::Invalid,
        CheckpointError::Faulted => ErrorKind::SceneGone,
        CheckpointError::NoAnswer(_) => ErrorKind::Timeout,
        CheckpointError::NoSuchScene(_)
        | CheckpointError::SceneExists(_)
        | CheckpointError::Changed
        | CheckpointError::NoImage
        | CheckpointError::Fed
        | CheckpointError::NotAdmitted(_)
        | CheckpointError::NoServer => ErrorKind::Denied,
    }
}

const fn client_kind(error: &ClientError) -> ErrorKind {
    match error {
        ClientError::Misuse(Misuse::NotNow) => ErrorKind::Denied,
        ClientError::Misuse(_)
        | ClientError::Id(_)
        | ClientError::Ticks(_)
        | ClientError::Feed(_)
        | ClientError::OffCentre(_) => ErrorKind::Invalid,
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
            Self::Client(cause) => f.write_str(&with_words(&cause.to_string())),
            Self::Query(cause) => cause.fmt(f),
            Self::Invalid(cause) => cause.fmt(f),
            Self::Tolerance(cause) => cause.fmt(f),
            Self::Refused { kept, left_out } => {
                let Some((first, more)) = kept.split_first() else {
                    return Ok(());
                };
                first.fmt(f)?;
                match more.len() as u64 + left_out {
                    0 => Ok(()),
                    more => write!(f, " (and {more} more refusals)"),
                }
            }
            Self::NotInView(id) => write!(
                f,
                "body {} is not in the view: it is not there yet, was removed, or never was; ask first whether the view has it",
                packed_id(*id)
            ),
            Self::Twice(id) => write!(
                f,
                "body {} is given twice, and has one state at a time: give each body once",
                packed_id(*id)
            ),
            Self::Value {
                argument,
                found,
                needed,
            } => write!(f, "{argument} is {found}, and must be {needed}"),
            Self::Motion(cause) => cause.fmt(f),
            Self::Fingerprint(cause) => cause.fmt(f),
            Self::Body(cause) => cause.fmt(f),
            Self::Argument { argument, needed } => write!(f, "{argument} must be {needed}"),
            #[cfg(feature = "files")]
            Self::File(cause) => cause.fmt(f),
            #[cfg(feature = "serve")]
            Self::Serve(cause) => cause.fmt(f),
            #[cfg(feature = "serve")]
            Self::Checkpoint(cause) => cause.fmt(f),
            Self::ServerEnded(reason) => write!(f, "the server has stopped: {reason}"),
            Self::NoPage(reason) => write!(f, "this build has no page: {reason}"),
            Self::PageElsewhere => f.write_str(
                "the scene's server is not this scene's own: the page of a scene that a program serves is known to that scene alone, and \
                 rhumb-server prints the page's address if it is started with --view ADDRESS",
            ),
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

#[cfg(feature = "files")]
impl From<Box<rhumb_scene_files::LoadError>> for BindingError {
    fn from(error: Box<rhumb_scene_files::LoadError>) -> Self {
        Self::File(error)
    }
}

#[cfg(feature = "serve")]
impl From<rhumb_server::RunError> for BindingError {
    fn from(error: rhumb_server::RunError) -> Self {
        Self::Serve(Box::new(error))
    }
}

#[cfg(feature = "serve")]
impl From<CheckpointError> for BindingError {
    fn from(error: CheckpointError) -> Self {
        Self::Checkpoint(error)
    }
}

impl From<ClientError> for BindingError {
    fn from(error: ClientError) -> Self {
        match error {
            ClientError::Refused(refused) => Self::Refused {
                kept: refused.refusals().iter().map(RefusalRecord::new).collect(),
                left_out: refused.left_out(),
            },
            error => Self::Client(error),
        }
    }
}

impl From<Invalid> for BindingError {
    fn from(invalid: Invalid) -> Self {
        Self::Invalid(invalid)
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

impl From<InvalidPackedId> for BindingError {
    fn from(invalid: InvalidPackedId) -> Self {
        Self::Body(invalid)
    }
}
