//! An actor of an APP client, and its body in the scene.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyKind, Material, ShapeId};
use rhumb_reckoning::BodyId;

use super::body_properties::{ActorPart, Frame};

/// An actor.
#[derive(Clone, Debug)]
pub(super) struct Actor {
    pub(super) kind: BodyKind,
    /// Position at its creation or a requested one; the present position is the body's.
    pub(super) position: Vec3,
    pub(super) rotation: Quat,
    pub(super) linear: Vec3,
    pub(super) angular: Vec3,
    pub(super) gravity: f32,
    /// True if its collisions are reported.
    pub(super) reports: bool,
    /// True if a joint to the world prevents rotation: an avatar.
    pub(super) upright: bool,
    pub(super) parts: Vec<ActorPart>,
    pub(super) target_motion: TargetMotion,
    /// The mass that was sent to the client, if it requested it.
    pub(super) reported_mass: Option<f32>,
    pub(super) body: Option<ActorBody>,
}

/// Motion that was set since the last frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct TargetMotion {
    pub(super) position: Option<Vec3>,
    pub(super) rotation: Option<Quat>,
    pub(super) linear: Option<Vec3>,
    pub(super) angular: Option<Vec3>,
}

/// Body of an actor in the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ActorBody {
    pub(super) id: BodyId,
    pub(super) shape: ShapeId,
    pub(super) frame: Frame,
    pub(super) material: Option<Material>,
    pub(super) gravity: f32,
    pub(super) upright: bool,
}

impl Actor {
    pub(super) const fn new(kind: BodyKind, position: Vec3, rotation: Quat) -> Self {
        Self {
            kind,
            position,
            rotation,
            linear: Vec3::ZERO,
            angular: Vec3::ZERO,
            gravity: 1.0,
            reports: false,
            upright: false,
            parts: Vec::new(),
            target_motion: TargetMotion {
                position: None,
                rotation: None,
                linear: None,
                angular: None,
            },
            reported_mass: None,
            body: None,
        }
    }

    /// Takes the requested motion as the present one.
    pub(super) fn fulfil(&mut self) {
        let target_motion = std::mem::take(&mut self.target_motion);
        self.position = target_motion.position.unwrap_or(self.position);
        self.rotation = target_motion.rotation.unwrap_or(self.rotation);
        self.linear = target_motion.linear.unwrap_or(self.linear);
        self.angular = target_motion.angular.unwrap_or(self.angular);
    }

    /// Detaches a shape by its name, if the actor has it.
    ///
    /// The published plug-in stores one shape name for all avatars: if an avatar lacks the named shape, its only shape
    /// is meant.
    pub(super) fn detach(&mut self, name: u32) {
        let before = self.parts.len();
        self.parts.retain(|part| part.name != name);
        if self.parts.len() == before && self.upright && before == 1 {
            self.parts.clear();
        }
    }
}
