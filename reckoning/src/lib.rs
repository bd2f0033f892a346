//! Types of remote rigid-body physics, and the prediction of motions.
//!
//! No bytes, packets, clock, socket or engine. Arithmetic that publisher and subscriber must compute alike is in
//! `exact`.
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
//! The state of an attached body is in its parent's frame instead of the world's: see [`Track`] and
//! [`attached_motion`].
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

mod acceleration;
mod attached;
mod body;
mod correction;
mod dense;
mod divergence;
mod exact;
mod flow;
mod inertia;
mod motion;
mod packed;
mod prediction_x4;
mod predictor;
mod prefilter;
mod quantiser;
mod rest_correction;
mod tick;
mod tolerance;
mod tolerance_scale;
mod torque_free_rotation;
mod track;
mod units;

pub use acceleration::{
    ACCELERATION_EXPONENT_MAX, ACCELERATION_LIMIT, ACCELERATION_TICKS, ConstantAcceleration,
};
pub use attached::{attached_motion, relative_to};
pub use body::BodyId;
pub use correction::Correction;
pub use dense::DenseTrack;
pub use divergence::Divergence;
pub use flow::{Damping, Integrator, StepCoefficientTable, TRACK_AGE_MAX};
pub use inertia::{Inertia, InvalidInertia};
pub use motion::{InvalidMotion, Motion, Pose, Twist, UNIT_LENGTH_SLACK};
pub use packed::PackedRotation;
pub use prediction_x4::{LaneCorrection, PredictionX4};
pub use predictor::{Conditions, Predictor, REST_DIVERGENCE_TICKS, UnforcedMotion};
pub use prefilter::{ErrorPrefilter, PrefilterInput};
pub use quantiser::{
    FINE_STEPS, Grid, POSITION_LIMIT, QuantisedState, RESIDUAL_LIMIT, Residual, TURN_LIMIT,
    VELOCITY_EXPONENT_MAX, VELOCITY_LIMIT, VelocityResidual,
};
pub use rest_correction::RestCorrection;
pub use tick::{Rate, Tick, Ticks};
pub use tolerance::{InvalidTolerance, LengthBound, Tolerance, TurnBound};
pub use tolerance_scale::ToleranceScale;
pub use torque_free_rotation::{RotationCursor, precessed};
pub use track::{Anchor, BodyState, Track};
pub use units::{Metres, MetresPerSecond, Radians, Seconds};
