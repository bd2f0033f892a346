//! Scenes as scripts: commands before each tick, and a seed.
//!
//! Knows neither engine nor network, so that one script runs in one process or remote. Invariant: a name, a number of
//! bodies and a seed fix every bit of every command on every platform.
#![forbid(unsafe_code)]

mod ball_pit;
mod chance;
mod cluster;
mod free_fall;
mod script;
mod zoo;

pub use ball_pit::BallPit;
pub use free_fall::FreeFall;
pub use script::{NAMES, Script, by_name};
pub use zoo::Zoo;
