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
//!
//! What another body holds is said in that body's frame in place of the world's: see [`Track`] and [`carried`].
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

mod body;
mod class;
mod correction;
mod dense;
mod divergence;
mod exact;
mod flow;
mod gate;
mod held;
mod inertia;
mod lattice;
mod motion;
mod packed;
mod predictor;
mod push;
mod quartet;
mod settling;
mod tick;
mod tolerance;
mod track;
mod tumble;
mod units;

pub use body::BodyId;
pub use class::Class;
pub use correction::Correction;
pub use dense::DenseTrack;
pub use divergence::Divergence;
pub use flow::{Damping, FlowTable, HORIZON, Integrator};
pub use gate::{Case, Gate};
pub use held::{carried, seen_from};
pub use inertia::{Inertia, InvalidInertia};
pub use lattice::{
    COARSENESS_LIMIT, FINE_STEPS, Grid, POSITION_LIMIT, RESIDUAL_LIMIT, Residual, Snapped,
    TURN_LIMIT, VELOCITY_LIMIT, VelocityResidual,
};
pub use motion::{InvalidMotion, Motion, Pose, Twist, UNIT_LENGTH_SLACK};
pub use packed::PackedRotation;
pub use predictor::{Conditions, Predictor, REST_ASTRAY};
pub use push::{DOUBLINGS_LIMIT, PUSH_LIMIT, PUSH_TICKS, Push};
pub use quartet::{Correcting, Quartet};
pub use settling::Settling;
pub use tick::{Rate, Tick, Ticks};
pub use tolerance::{InvalidTolerance, LengthBound, Tolerance, TurnBound};
pub use track::{Anchor, Track, Verbatim};
pub use tumble::Cursor;
pub use units::{Metres, MetresPerSecond, Radians, Seconds};
