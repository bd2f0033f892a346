//! Integrator, gravity, materials, damping and states that the scenes share.

use core::num::NonZeroU32;

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{Material, SceneConfig};
use rhumb_reckoning::{BodyState, Damping, Integrator, Rate};

/// Integrator of all scenes: 60 Hz, four substeps.
pub(crate) const INTEGRATOR: Integrator = Integrator {
    rate: Rate::HZ_60,
    substeps: NonZeroU32::new(4).expect("four is not zero"),
};

/// Earth's gravity, along y, m/s².
pub(crate) const GRAVITY: Vec3 = Vec3::new(0.0, -9.806_65, 0.0);

/// A material without bounce; density in kg/m³.
pub(crate) const fn surface(friction: f32, density: f32) -> Material {
    Material {
        friction,
        restitution: 0.0,
        density,
    }
}

/// A scene whose bodies are slowed a little, by 0.05 1/s.
pub(crate) fn damped(material: Material) -> SceneConfig {
    SceneConfig {
        material,
        damping: Damping {
            linear: 0.05,
            angular: 0.05,
        },
        ..SceneConfig::default()
    }
}

/// A body state; the script guarantees finite parts and a unit quaternion.
pub(crate) fn motion(position: Vec3, rotation: Quat, linear: Vec3, angular: Vec3) -> BodyState {
    BodyState::new(
        position.to_array(),
        rotation.to_array(),
        linear.to_array(),
        angular.to_array(),
    )
    .expect("scripts place bodies at finite poses")
}

/// A state at rest.
pub(crate) fn still(position: Vec3) -> BodyState {
    motion(position, Quat::IDENTITY, Vec3::ZERO, Vec3::ZERO)
}
