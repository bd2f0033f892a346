//! Scenes and their commands, run in this process.
//!
//! One executable holds all tests: each further one would link the engine again.

mod attacks;
mod baking;
#[cfg(feature = "box3d")]
mod box3d;
mod checkpoints;
mod crowding;
mod endings;
mod filling;
mod links;
mod motion;
mod order;
mod pushes;
mod refusals;
mod sheets;
mod torque_free;
mod truth;
