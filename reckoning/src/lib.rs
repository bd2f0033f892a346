//! The nouns of remote rigid-body physics, and belief: laws, error, repair.
//!
//! No bytes, no packets, no clock, no socket, no engine. What a publisher and a subscriber must compute alike is
//! written in `exact` and used from there.
//!
//! | quantity | unit | frame |
//! |---|---|---|
//! | position | metre | world, right-handed, centre of mass |
//! | rotation | unit quaternion (x, y, z, w) | body → world |
//! | linear velocity | metre per second | world, of the centre of mass |
//! | angular velocity | radian per second | about world axes |
//! | gravity, acceleration | metre per second squared | world |
//! | time | tick, a step of the scene's fixed length | the scene's own |
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

mod body;
mod correction;
mod divergence;
mod exact;
mod flow;
mod lattice;
mod motion;
mod predictor;
mod tick;
mod tolerance;
mod track;
mod units;

pub use body::BodyId;
pub use correction::Correction;
pub use divergence::Divergence;
pub use flow::{Damping, FlowTable, HORIZON, Integrator};
pub use lattice::{
    Grid, POSITION_LIMIT, PackedRotation, Residual, Snapped, TURN_LIMIT, VELOCITY_LIMIT,
};
pub use motion::{InvalidMotion, Motion, Pose, Twist, UNIT_LENGTH_SLACK};
pub use predictor::Predictor;
pub use tick::{Rate, Tick, Ticks};
pub use tolerance::{InvalidTolerance, Tolerance};
pub use track::{Anchor, Track, Verbatim};
pub use units::{Metres, MetresPerSecond, Radians, Seconds};
