//! An actor as its client has it, and the body that it is in the scene.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyKind, Material, ShapeId};
use rhumb_reckoning::BodyId;

use super::form::{Frame, Part};

/// An actor.
#[derive(Clone, Debug)]
pub(super) struct Actor {
    pub(super) kind: BodyKind,
    /// Where it was created, or is to be; where it is, its body says.
    pub(super) position: Vec3,
    pub(super) rotation: Quat,
    pub(super) linear: Vec3,
    pub(super) angular: Vec3,
    pub(super) gravity: f32,
    /// Whether its collisions are to be reported.
    pub(super) reports: bool,
    /// Whether a joint to the world keeps it from turning: an avatar.
    pub(super) upright: bool,
    pub(super) parts: Vec<Part>,
    pub(super) target_motion: TargetMotion,
    /// The mass that the client was told, if it asked.
    pub(super) told_mass: Option<f32>,
    pub(super) body: Option<ActorBody>,
}

/// What was said of an actor's motion since the last frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct TargetMotion {
    pub(super) position: Option<Vec3>,
    pub(super) rotation: Option<Quat>,
    pub(super) linear: Option<Vec3>,
    pub(super) angular: Option<Vec3>,
}

/// What an actor is in the scene.
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
            told_mass: None,
            body: None,
        }
    }

    /// Takes what is requested_authority of its motion for what it is.
    pub(super) fn fulfil(&mut self) {
        let target_motion = std::mem::take(&mut self.target_motion);
        self.position = target_motion.position.unwrap_or(self.position);
        self.rotation = target_motion.rotation.unwrap_or(self.rotation);
        self.linear = target_motion.linear.unwrap_or(self.linear);
        self.angular = target_motion.angular.unwrap_or(self.angular);
    }

    /// Takes a shape off it, if it has one of this name.
    ///
    /// The published plug-in keeps the name of an avatar's shape in one place for all avatars: what it takes off an avatar that
    /// does not have it is the one shape that the avatar has.
    pub(super) fn detach(&mut self, name: u32) {
        let before = self.parts.len();
        self.parts.retain(|part| part.name != name);
        if self.parts.len() == before && self.upright && before == 1 {
            self.parts.clear();
        }
    }
}
