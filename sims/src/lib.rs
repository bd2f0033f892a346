//! Scenes as scripts: commands before each tick, and a seed.
//!
//! Knows neither engine nor network, so a script runs in one process or remote. Invariant: name, number of bodies and
//! seed determine every bit of every command on every platform.
#![forbid(unsafe_code)]

mod asteroids;
mod ball_pit;
mod builder;
mod catalogue;
mod cluster;
mod controller;
mod crowd;
mod cubes;
mod defaults;
mod dominoes;
mod free_fall;
mod ragdolls;
mod rain;
mod rest;
mod rng;
mod rock;
mod script;
mod stack;
mod tumbler;
mod zoo;

pub use asteroids::{Asteroids, Spin};
pub use ball_pit::BallPit;
pub use catalogue::{NAMES, by_name, default_bodies};
pub use controller::Controller;
pub use crowd::Crowd;
pub use cubes::Cubes;
pub use dominoes::Dominoes;
pub use free_fall::FreeFall;
pub use ragdolls::Ragdolls;
pub use rain::Rain;
pub use rest::Rest;
pub use script::Script;
pub use stack::Stack;
pub use tumbler::Tumbler;
pub use zoo::Zoo;
