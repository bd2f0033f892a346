//! The bound of a replica's error for one body.
//!
//! Only the type; the subscriber determines the bound.

use core::fmt;

use rhumb_reckoning::{Metres, Tick};

/// The distance between a body's predicted and true pose, at the newest tick of the stream's watermark.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ErrorBound {
    /// Every point of the body is within this distance of its true place.
    ///
    /// This includes a body at its exact rest pose: it may have woken since and moved less than the tolerance.
    Within(Metres),
    /// A packet that may contain an update of the body is missing. The tolerance held at `since`.
    Unknown {
        /// The newest tick up to which the stream was complete.
        since: Tick,
    },
}

impl fmt::Display for ErrorBound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Within(distance) => write!(f, "within {} m", distance.metres()),
            Self::Unknown { since } => write!(f, "not known since {since}"),
        }
    }
}
