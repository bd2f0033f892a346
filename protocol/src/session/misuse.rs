//! Calls that cannot be, by the application's own mistake.
//!
//! Never caused by what a peer says.

use core::fmt;

use crate::limits::RESERVE_MAX;
use crate::scene::Invalid;

/// A call that cannot be, by the application's own mistake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Misuse {
    /// The conversation is not where this can be asked.
    NotNow,
    /// A number that no engine should be given.
    Invalid(Invalid),
    /// So many body indices cannot be asked for at once.
    Indices(u32),
}

impl fmt::Display for Misuse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotNow => f.write_str("not possible in this state of the connection"),
            Self::Invalid(invalid) => invalid.fmt(f),
            Self::Indices(count) => write!(
                f,
                "{count} body indices cannot be asked for at once: 1 to {RESERVE_MAX}"
            ),
        }
    }
}

impl core::error::Error for Misuse {}
