//! The bound of a replica's error for one body.
//!
//! Only the type; the subscriber determines the bound.

use core::fmt;

use rhumb_reckoning::{Metres, Tick};

/// The distance between a body's copied and true pose at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ErrorBound {
    /// Every point of the body is within this distance of its true place.
    ///
    /// This includes a body at its exact rest pose: it may have woken since and moved less than the tolerance.
    Within(Metres),
    /// Nothing finite is known: a packet that may contain an update of the body is missing, or what the server knows of
    /// the moment has not arrived. A body may be anywhere then, because a command may have placed it there.
    Unknown {
        /// The newest tick up to which the stream was complete.
        since: Tick,
    },
}

impl ErrorBound {
    /// The bound as a length; infinite if it is not known.
    #[must_use]
    pub const fn metres(&self) -> f64 {
        match self {
            Self::Within(distance) => distance.metres(),
            Self::Unknown { .. } => f64::INFINITY,
        }
    }
}

impl fmt::Display for ErrorBound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Within(distance) => write!(f, "within {} m", distance.metres()),
            Self::Unknown { since } => write!(f, "not known since {since}"),
        }
    }
}
