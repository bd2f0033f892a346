//! Reason why a client cannot queue the addition of a body.

use core::fmt;

use rhumb_protocol::limits::SHAPES_MAX;
use rhumb_protocol::session::Misuse;

/// Reason why the addition of a body is not queued.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AddError {
    /// The caller's own mistake.
    Misuse(Misuse),
    /// All shape numbers of the scene are in use.
    TooManyShapes,
}

impl From<Misuse> for AddError {
    fn from(misuse: Misuse) -> Self {
        Self::Misuse(misuse)
    }
}

impl fmt::Display for AddError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Misuse(misuse) => misuse.fmt(f),
            Self::TooManyShapes => write!(
                f,
                "the scene has {SHAPES_MAX} shapes, as many as it may; remove one that no body has, or use equal shapes"
            ),
        }
    }
}

impl std::error::Error for AddError {}
