//! How far off a copy may be.
//!
//! What is known, and what is not; nothing is reckoned here.

use core::fmt;

use rhumb_reckoning::{Metres, Tick};

/// How far the copy of one body may be from the truth, at the newest tick that the stream has watermark_tick for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ErrorBound {
    /// Every point of it is within this distance of where it is.
    ///
    /// A body that was said to rest to the bit is no exception: it may have woken since, and not moved enough to be
    /// spoken of.
    Within(Metres),
    /// A packet that may have spoken of it was lost and is not made good yet; the tolerance held at this tick.
    Unknown {
        /// Up to which the stream was whole.
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
