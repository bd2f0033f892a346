//! Common scenes of the server cases: configurations, a floor, a ball.
//!
//! Bodies are named by their index in the range granted to a member, so that cases do not depend on a server's choice
//! of ranges.

use core::num::NonZeroU32;

use glam::{Quat, Vec3};
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, IdRange, SceneConfig, Shape, ShapeId};
use rhumb_reckoning::{BodyId, BodyState, Integrator, Rate, Tolerance};

use crate::outcome::Stop;

/// Gravity of the scenes, downwards, in m/s².
pub(super) const G: f32 = 9.81;
/// The shape of balls, after [`ball_shape`].
pub(super) const BALL: ShapeId = ShapeId(1);
/// The shape of floors, after [`floor_shape`].
pub(super) const FLOOR: ShapeId = ShapeId(2);
/// Radius of the ball, in metres.
pub(super) const RADIUS: f32 = 0.5;
/// A stream with a tolerance of five centimetres.
pub(super) const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);

/// A stream with a tolerance of five millimetres.
pub(super) const EXACT: StreamChoice = StreamChoice::Within(Tolerance::EXACT);

/// A lockstep scene at sixty ticks per second.
pub(super) fn lockstep() -> SceneConfig {
    SceneConfig {
        integrator: Integrator {
            rate: Rate::new(60, 1).expect("both are positive"),
            substeps: NonZeroU32::MIN,
        },
        gravity: Vec3::new(0.0, -G, 0.0),
        ..SceneConfig::default()
    }
}

/// The same without gravity.
pub(super) fn weightless(config: SceneConfig) -> SceneConfig {
    SceneConfig {
        gravity: Vec3::ZERO,
        ..config
    }
}

/// The command that adds the ball's shape.
pub(super) fn ball_shape() -> Command {
    Command::AddShape {
        id: BALL,
        shape: Shape::Ball { radius: RADIUS },
    }
}

/// The command that adds the floor's shape.
pub(super) fn floor_shape() -> Command {
    Command::AddShape {
        id: FLOOR,
        shape: Shape::Cuboid {
            half_extents: Vec3::new(50.0, 1.0, 50.0),
        },
    }
}

/// The body with this index in the granted range.
///
/// # Errors
///
/// [`Stop::Fail`] when the range is smaller than the protocol requires.
pub(super) fn body(granted: IdRange, place: u32) -> Result<BodyId, Stop> {
    let too_few = || Stop::Fail(format!("{granted:?} has fewer than GRANT indices"));
    granted.id(place).ok_or_else(too_few)
}

/// Adds a ball at a position with a velocity.
pub(super) fn ball(id: BodyId, at: Vec3, linear: Vec3) -> Command {
    Command::AddBody {
        desc: BodyDesc::plain(id, BodyKind::Dynamic, BALL),
        motion: moving(at, linear),
    }
}

/// Adds the floor; its top is at height zero.
pub(super) fn floor(id: BodyId) -> Command {
    Command::AddBody {
        desc: BodyDesc::plain(id, BodyKind::Fixed, FLOOR),
        motion: moving(Vec3::new(0.0, -1.0, 0.0), Vec3::ZERO),
    }
}

/// A state with this position and velocity, without rotation.
pub(super) fn moving(position: Vec3, linear: Vec3) -> BodyState {
    turning(position, Quat::IDENTITY, linear, Vec3::ZERO)
}

/// A state with this pose and these velocities.
pub(super) fn turning(position: Vec3, rotation: Quat, linear: Vec3, angular: Vec3) -> BodyState {
    BodyState::new(
        position.to_array(),
        rotation.to_array(),
        linear.to_array(),
        angular.to_array(),
    )
    .expect("cases use finite numbers")
}
