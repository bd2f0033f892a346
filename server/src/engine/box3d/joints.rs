//! Joints of a Box3D world, by id.
//!
//! Fixed, spherical, revolute and prismatic joints and ropes. A joint leaves the world with either of its bodies, so that
//! some may be stale.

use std::collections::BTreeMap;
use std::f32::consts::{FRAC_PI_2, PI};

use glam::Quat;
use rhumb_protocol::scene::{Joint, JointId, JointKind, JointLimits, JointStrength};

use super::native::{JointShape, NativeBody, NativeJoint, World};

/// Largest angle of a limit that Box3D allows, radians.
const ANGLE_MAX: f32 = 0.99 * PI;

/// True if Box3D has such a joint: springs, motors, limits of balls and free combinations of axes are not its own.
pub(super) fn supports(joint: &Joint) -> bool {
    joint.motors.iter().all(Option::is_none) && shape(&joint.kind).is_some()
}

/// The joints.
#[derive(Default)]
pub(super) struct Box3dJoints(BTreeMap<JointId, PresentJoint>);

struct PresentJoint {
    joint: NativeJoint,
    strength: Option<JointStrength>,
}

impl Box3dJoints {
    /// Joins two bodies, in place of an earlier joint of the id, and wakes them.
    pub(super) fn add(
        &mut self,
        world: &mut World,
        bodies: [NativeBody; 2],
        (id, joint): (JointId, &Joint),
    ) {
        self.remove(world, id);
        let Some(shape) = shape(&joint.kind) else {
            return;
        };
        // Box3D turns about the frame's z axis, the protocol about its x axis.
        let turn = match shape {
            JointShape::Hinge(_) => Quat::from_rotation_y(FRAC_PI_2),
            _ => Quat::IDENTITY,
        };
        let frames = joint
            .frames
            .map(|frame| (frame.anchor, frame.rotation * turn));
        if let Some(native) = world.join(bodies, frames, (&shape, joint.collide)) {
            let strength = joint.strength;
            let present = PresentJoint {
                joint: native,
                strength,
            };
            self.0.insert(id, present);
        }
    }

    /// Removes a joint, if it is there, and wakes its bodies.
    pub(super) fn remove(&mut self, world: &mut World, id: JointId) {
        if let Some(present) = self.0.remove(&id) {
            world.part(present.joint);
        }
    }

    /// Adds the joints whose load in the last step was above their strength, in the order of ids.
    pub(super) fn overloaded(&self, world: &World, out: &mut Vec<JointId>) {
        let is_overloaded = |(id, present): (&JointId, &PresentJoint)| {
            let strength = present.strength?;
            let (force, torque) = world.load(present.joint)?;
            let is_over = force.length() > strength.force || torque.length() > strength.torque;
            is_over.then_some(*id)
        };
        out.extend(self.0.iter().filter_map(is_overloaded));
    }
}

/// A kind of joint as Box3D has it.
fn shape(kind: &JointKind) -> Option<JointShape> {
    let range = |limits: JointLimits| [limits.least, limits.most];
    Some(match *kind {
        JointKind::Fixed => JointShape::Weld,
        JointKind::Spherical(None) => JointShape::Ball,
        // Box3D measures a hinge within half a turn of its first frame.
        JointKind::Revolute(Some(limits)) if range(limits).iter().any(|at| at.abs() > PI) => {
            return None;
        }
        JointKind::Revolute(limits) => {
            let angles = |limits| range(limits).map(|angle| angle.clamp(-ANGLE_MAX, ANGLE_MAX));
            JointShape::Hinge(limits.map(angles))
        }
        JointKind::Prismatic(limits) => JointShape::Slider(limits.map(range)),
        JointKind::Rope(length) => JointShape::Rope(length),
        JointKind::Spherical(Some(_)) | JointKind::Spring(_) | JointKind::Generic(..) => {
            return None;
        }
    })
}
