//! Shapes as solids, and queries over a set of bodies.
//!
//! No engine and no stream here. The server's engine and a client's copy answer queries by the same code, so equal
//! poses give equal answers.
#![forbid(unsafe_code)]

mod queries;
mod solid;

pub use queries::{PlacedBodies, SearchedBodies, answer, deepest, nearest_hit};
pub use solid::{
    Dispatcher, Grounds, SolidPart, UnitMass, add_parts, cast_ray, parts, pose, simple_part,
};
