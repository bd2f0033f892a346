//! Edges: members of a scene that another server steps (PROTOCOL 14).
//!
//! An [`Edge`] is a member of each scene that its own members name, once for each tier, and forwards the packets that
//! it receives as they are. Joins, losses and changes of tier it answers from its subscriber. Requests that act on
//! the scene go to its owner over a connection of each member that may act, and so do the answers. Like a scene it is sans-IO:
//! a driver hands it what arrives from members ([`rhumb_protocol::Endpoint`]) and from the owner ([`Edge::owner`]), and
//! moments.
#![forbid(unsafe_code)]

mod client;
mod edge;
mod mirror;
mod owners;
mod voice;

pub use edge::{Edge, EdgeSettings, OwnerSide};
pub use owners::{Dial, MIRRORS_MAX, SharedPacket, SharedStream};
