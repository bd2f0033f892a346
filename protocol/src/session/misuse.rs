//! Calls that the application may not make in the present state.
//!
//! Caused by the application alone, never by bytes of a peer.

use core::fmt;

use rhumb_reckoning::BodyId;

use crate::limits::{AUTHORITY_BODIES_MAX, HITS_MAX, QUERY_COST_MAX, RESERVE_MAX};
use crate::scene::Invalid;

/// A call that the application may not make, or whose arguments are out of range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Misuse {
    /// The connection is in a state that does not allow this call.
    NotNow,
    /// A number is not finite or out of range.
    Invalid(Invalid),
    /// This number of body indices cannot be reserved in one request.
    Indices(u32),
    /// One member cannot have authority over this number of bodies.
    TooManyAuthorityBodies(usize),
    /// This member neither has nor requested authority over the body.
    NoAuthority(BodyId),
    /// A dynamic body needs a shape with volume.
    NoInside,
    /// A joint cannot join a body to itself.
    JoinedToItself(BodyId),
    /// No query finds so many bodies.
    Hits(u8),
    /// One message cannot have queries of this cost: there is none, or too many.
    QueryCost(u32),
}

impl fmt::Display for Misuse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotNow => f.write_str("not possible in this state of the connection"),
            Self::Invalid(invalid) => invalid.fmt(f),
            Self::Indices(count) => write!(
                f,
                "{count} body indices cannot be reserved at once; the range is 1 to {RESERVE_MAX}"
            ),
            Self::TooManyAuthorityBodies(count) => {
                write!(
                    f,
                    "one member cannot have authority over {count} bodies; at most {AUTHORITY_BODIES_MAX}"
                )
            }
            Self::Hits(hits) => {
                write!(f, "a query finds 1 to {HITS_MAX} bodies, and not {hits}")
            }
            Self::QueryCost(cost) => write!(
                f,
                "the queries of one call cost {cost} together, and must cost 1 to {QUERY_COST_MAX}: ask in several calls"
            ),
            Self::NoInside => f.write_str(
                "a dynamic body needs a shape with volume; height fields, meshes, half-spaces and compounds with one of them are for fixed and kinematic bodies",
            ),
            Self::JoinedToItself(id) => write!(f, "a joint cannot join {id} to itself"),
            Self::NoAuthority(id) => write!(f, "this member has no authority over {id}"),
        }
    }
}

impl core::error::Error for Misuse {}
