//! Calls that cannot be, by the application's own mistake.
//!
//! Never caused by what a peer says.

use core::fmt;

use rhumb_reckoning::BodyId;

use crate::limits::{AUTHORITY_BODIES_MAX, RESERVE_MAX};
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
    /// So many bodies cannot be driven by one member.
    TooManyAuthorityBodies(usize),
    /// The body is not one that this member drives or asked to drive.
    NoAuthority(BodyId),
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
            Self::TooManyAuthorityBodies(count) => {
                write!(
                    f,
                    "{count} bodies cannot be driven by one member: {AUTHORITY_BODIES_MAX} at most"
                )
            }
            Self::NoAuthority(id) => write!(f, "{id} is not driven by this member"),
        }
    }
}

impl core::error::Error for Misuse {}
