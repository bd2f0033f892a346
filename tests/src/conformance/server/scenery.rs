//! The scenes that cases of servers play in: config, a floor, a ball.
//!
//! Bodies are named by their place in what a member was granted, so that no server's way of granting matters.

use core::num::NonZeroU32;

use glam::{Quat, Vec3};
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, IdRange, Material, PublishSchedule, SceneConfig, Shape, ShapeId,
    Stepping,
};
use rhumb_reckoning::{BodyId, BodyState, Damping, Integrator, Rate, Tolerance};

use crate::conformance::outcome::Stop;

/// Metres a second a second, downwards.
pub(super) const G: f32 = 9.81;
/// The shape of balls, once there is one.
pub(super) const BALL: ShapeId = ShapeId(1);
/// The shape of floors, once there is one.
pub(super) const FLOOR: ShapeId = ShapeId(2);
/// Metres: the ball's.
pub(super) const RADIUS: f32 = 0.5;
/// A stream within five centimetres.
pub(super) const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);

/// A stream within five millimetres.
pub(super) const EXACT: StreamChoice = StreamChoice::Within(Tolerance::EXACT);

/// A scene at sixty ticks a second that steps when members say so.
pub(super) fn lockstep() -> SceneConfig {
    SceneConfig {
        integrator: Integrator {
            rate: Rate::new(60, 1).expect("neither is zero"),
            substeps: NonZeroU32::MIN,
        },
        gravity: Vec3::new(0.0, -G, 0.0),
        stepping: Stepping::Lockstep,
        material: Material {
            friction: 0.5,
            restitution: 0.0,
            density: 1_000.0,
        },
        damping: Damping {
            linear: 0.0,
            angular: 0.0,
        },
        sleep: None,
        publish_schedule: PublishSchedule::EACH_TICK,
    }
}

/// The same without gravity.
pub(super) fn weightless(config: SceneConfig) -> SceneConfig {
    SceneConfig {
        gravity: Vec3::ZERO,
        ..config
    }
}

/// Makes the ball's shape known.
pub(super) fn ball_shape() -> Command {
    Command::AddShape {
        id: BALL,
        shape: Shape::Ball { radius: RADIUS },
    }
}

/// Makes the floor's shape known.
pub(super) fn floor_shape() -> Command {
    Command::AddShape {
        id: FLOOR,
        shape: Shape::Cuboid {
            half_extents: Vec3::new(50.0, 1.0, 50.0),
        },
    }
}

/// The body at a place of what was granted.
///
/// # Errors
///
/// [`Stop::Fail`] when less was granted than the protocol says.
pub(super) fn body(granted: IdRange, place: u32) -> Result<BodyId, Stop> {
    let too_few = || Stop::Fail(format!("{granted:?} is not so many indices as GRANT has"));
    granted.id(place).ok_or_else(too_few)
}

/// Puts a ball somewhere, moving so.
pub(super) fn ball(id: BodyId, at: Vec3, linear: Vec3) -> Command {
    Command::AddBody {
        desc: BodyDesc::plain(id, BodyKind::Dynamic, BALL),
        motion: moving(at, linear),
    }
}

/// Puts the floor so that its top is at a height of zero.
pub(super) fn floor(id: BodyId) -> Command {
    Command::AddBody {
        desc: BodyDesc::plain(id, BodyKind::Static, FLOOR),
        motion: moving(Vec3::new(0.0, -1.0, 0.0), Vec3::ZERO),
    }
}

/// Somewhere, unturned, moving so.
pub(super) fn moving(position: Vec3, linear: Vec3) -> BodyState {
    turning(position, Quat::IDENTITY, linear, Vec3::ZERO)
}

/// Somewhere, turned and moving so.
pub(super) fn turning(position: Vec3, rotation: Quat, linear: Vec3, angular: Vec3) -> BodyState {
    BodyState::new(
        position.to_array(),
        rotation.to_array(),
        linear.to_array(),
        angular.to_array(),
    )
    .expect("cases place bodies at finite poses")
}
