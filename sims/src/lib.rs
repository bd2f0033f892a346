//! Scenes as scripts: commands before each tick, and a seed.
//!
//! Knows neither engine nor network, so a script runs in one process or remote. Invariant: name, number of bodies and
//! seed determine every bit of every command on every platform.
#![forbid(unsafe_code)]

mod asteroids;
mod ball_pit;
mod catalogue;
mod cubes;
mod free_fall;
mod ragdolls;
mod script;
mod standing;
mod tumbler;
mod zoo;

pub use asteroids::{Asteroids, Spin};
pub use ball_pit::{BallPit, Crowd};
pub use catalogue::{NAMES, by_name, default_bodies};
pub use cubes::Cubes;
pub use free_fall::{FreeFall, Rain};
pub use ragdolls::Ragdolls;
pub use script::{Controller, Script};
pub use standing::{Dominoes, Rest, Stack};
pub use tumbler::Tumbler;
pub use zoo::Zoo;
