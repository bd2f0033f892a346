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

mod exact;
mod free_motion;
mod motion;
mod prediction_x4;
mod predictor;
mod prefilter;
mod quantiser;
mod tolerance;
mod track;
mod units;

pub use free_motion::{
    Damping, Inertia, Integrator, InvalidInertia, RotationCursor, StepCoefficientTable,
    TRACK_AGE_MAX, precessed,
};
pub use motion::{
    BodyId, Correction, Divergence, InvalidMotion, Motion, Pose, Twist, UNIT_LENGTH_SLACK,
    attached_motion, relative_to,
};
pub use prediction_x4::{CorrectedX4, LaneCorrection, PredictionX4, StartsX4, UnpackedStart};
pub use predictor::{
    ACCELERATION_EXPONENT_MAX, ACCELERATION_LIMIT, ACCELERATION_TICKS, Conditions,
    ConstantAcceleration, Predictor, REST_DIVERGENCE_TICKS, UnforcedMotion,
};
pub use prefilter::{
    ErrorPrefilter, PrefilterBatch, PrefilterBody, PrefilterInput, PrefilterTrack,
};
pub use quantiser::{
    FINE_STEPS, Grid, POSITION_LIMIT, PackedRotation, QuantisedState, RESIDUAL_LIMIT, Residual,
    TURN_LIMIT, VELOCITY_EXPONENT_MAX, VELOCITY_LIMIT, VelocityResidual,
};
pub use tolerance::{InvalidTolerance, LengthBound, Tolerance, ToleranceScale, TurnBound};
pub use track::{Anchor, BodyState, DenseTrack, RestCorrection, Track};
pub use units::{Metres, MetresPerSecond, Radians, Rate, Seconds, Tick, Ticks};
