//! Joints by Box3D's C interface.

use box3d_sys as sys;
use glam::Vec3;

use super::{NativeBody, Placement, World, from_vector, transform};

/// A joint of a world.
#[derive(Clone, Copy, Debug)]
pub(in crate::engine) struct NativeJoint(sys::b3JointId);

/// Free motions of a joint.
pub(in crate::engine) enum JointShape {
    Weld,
    Ball,
    /// The turn about the z axis, between two angles.
    Hinge(Option<[f32; 2]>),
    /// The displacement along the x axis, between two lengths.
    Slider(Option<[f32; 2]>),
    /// Anchors at most so far apart, metres.
    Rope(f32),
}

impl World {
    /// Joins two bodies by a frame in each, and wakes them; `None` if one of them is gone.
    pub(in crate::engine) fn join(
        &mut self,
        bodies: [NativeBody; 2],
        frames: [Placement; 2],
        (shape, collide): (&JointShape, bool),
    ) -> Option<NativeJoint> {
        let [Some(first), Some(second)] = bodies.map(|body| self.live(body)) else {
            return None;
        };
        let placed = |base: &mut sys::b3JointDef| {
            (base.bodyIdA, base.bodyIdB) = (first, second);
            let [one, other] = frames.map(transform);
            (base.localFrameA, base.localFrameB) = (one, other);
            base.collideConnected = collide;
        };
        // SAFETY: both bodies are of this world; the rest are plain values.
        let id = unsafe {
            match *shape {
                JointShape::Weld => {
                    let mut def = sys::b3DefaultWeldJointDef();
                    placed(&mut def.base);
                    sys::b3CreateWeldJoint(self.id, &raw const def)
                }
                JointShape::Ball => {
                    let mut def = sys::b3DefaultSphericalJointDef();
                    placed(&mut def.base);
                    sys::b3CreateSphericalJoint(self.id, &raw const def)
                }
                JointShape::Hinge(limits) => {
                    let mut def = sys::b3DefaultRevoluteJointDef();
                    placed(&mut def.base);
                    def.enableLimit = limits.is_some();
                    [def.lowerAngle, def.upperAngle] = limits.unwrap_or_default();
                    sys::b3CreateRevoluteJoint(self.id, &raw const def)
                }
                JointShape::Slider(limits) => {
                    let mut def = sys::b3DefaultPrismaticJointDef();
                    placed(&mut def.base);
                    def.enableLimit = limits.is_some();
                    [def.lowerTranslation, def.upperTranslation] = limits.unwrap_or_default();
                    sys::b3CreatePrismaticJoint(self.id, &raw const def)
                }
                JointShape::Rope(length) => {
                    let mut def = sys::b3DefaultDistanceJointDef();
                    placed(&mut def.base);
                    // A spring without stiffness leaves the distance free below the limit.
                    (def.enableSpring, def.hertz, def.length) = (true, 0.0, length);
                    (def.enableLimit, def.minLength, def.maxLength) = (true, 0.0, length);
                    sys::b3CreateDistanceJoint(self.id, &raw const def)
                }
            }
        };
        // SAFETY: the id is Box3D's own.
        unsafe {
            if !sys::b3Joint_IsValid(id) {
                return None;
            }
            sys::b3Joint_WakeBodies(id);
        }
        Some(NativeJoint(id))
    }

    /// Removes a joint, if it is there, and wakes its bodies.
    pub(in crate::engine) fn part(&mut self, joint: NativeJoint) {
        if let Some(id) = self.live_joint(joint) {
            // SAFETY: the joint is of this world.
            unsafe { sys::b3DestroyJoint(id, true) };
        }
    }

    /// The force and the torque that a joint bore in the last step: N, N·m.
    pub(in crate::engine) fn load(&self, joint: NativeJoint) -> Option<(Vec3, Vec3)> {
        let id = self.live_joint(joint)?;
        // SAFETY: the joint is of this world.
        let (force, torque) = unsafe {
            (
                sys::b3Joint_GetConstraintForce(id),
                sys::b3Joint_GetConstraintTorque(id),
            )
        };
        Some((from_vector(force), from_vector(torque)))
    }

    fn live_joint(&self, NativeJoint(id): NativeJoint) -> Option<sys::b3JointId> {
        // SAFETY: Box3D takes any id here.
        (self.has(id.world0) && unsafe { sys::b3Joint_IsValid(id) }).then_some(id)
    }
}
