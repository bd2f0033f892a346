//! Joints of a Rapier world, by id.
//!
//! Impulse joints only. Rapier removes a joint with either of its bodies, so some handles may be stale.

use std::collections::BTreeMap;

use glam::Vec3;
use rapier3d::prelude::{
    GenericJoint, GenericJointBuilder, ImpulseJointHandle, JointAxesMask, JointAxis, MotorModel,
    PhysicsWorld, RigidBodyHandle,
};
use rhumb_protocol::scene::{Joint, JointFrame, JointId, JointKind, JointStrength};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};

use super::rapier_body::pose;

/// The joints.
#[derive(Clone, Debug, Default)]
pub(super) struct RapierJoints {
    handles: BTreeMap<JointId, ImpulseJointHandle>,
    /// The joints that can break.
    strengths: BTreeMap<JointId, JointStrength>,
}

impl RapierJoints {
    /// Joins two bodies, in place of an earlier joint of the id.
    pub(super) fn add(
        &mut self,
        world: &mut PhysicsWorld,
        bodies: [RigidBodyHandle; 2],
        (id, joint): (JointId, &Joint),
    ) {
        self.remove(world, id);
        let [first, second] = bodies;
        let handle = world.insert_impulse_joint(first, second, generic(joint));
        self.handles.insert(id, handle);
        if let Some(strength) = joint.strength {
            self.strengths.insert(id, strength);
        }
    }

    /// Removes a joint, if it is there.
    pub(super) fn remove(&mut self, world: &mut PhysicsWorld, id: JointId) {
        self.strengths.remove(&id);
        if let Some(handle) = self.handles.remove(&id) {
            world.remove_impulse_joint(handle);
        }
    }

    /// Adds the joints whose load in the last step was above their strength.
    ///
    /// `substep`: seconds in which a joint's impulses act.
    pub(super) fn overloaded(&self, world: &PhysicsWorld, substep: f32, out: &mut Vec<JointId>) {
        let is_overloaded = |(id, strength): (&JointId, &JointStrength)| {
            let joint = world.impulse_joints.get(*self.handles.get(id)?)?;
            let [x, y, z, about_x, about_y, about_z] = joint.impulses;
            let force = Vec3::new(x, y, z).length() / substep;
            let torque = Vec3::new(about_x, about_y, about_z).length() / substep;
            (force > strength.force || torque > strength.torque).then_some(*id)
        };
        out.extend(self.strengths.iter().filter_map(is_overloaded));
    }

    /// Forgets all joints of a world that is gone.
    pub(super) fn clear(&mut self) {
        self.handles.clear();
        self.strengths.clear();
    }
}

impl Wire for RapierJoints {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.handles.len() as u64);
        for (id, handle) in &self.handles {
            id.encode(to);
            let (index, generation) = handle.into_raw_parts();
            to.varint(u64::from(index));
            to.varint(u64::from(generation));
        }
        to.varint(self.strengths.len() as u64);
        for (id, strength) in &self.strengths {
            id.encode(to);
            to.f32s(&[strength.force, strength.torque]);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let mut joints = Self::default();
        for _ in 0..from.varint()? {
            let id = JointId::decode(from)?;
            let (index, generation) = (from.varint32()?, from.varint32()?);
            let handle = ImpulseJointHandle::from_raw_parts(index, generation);
            joints.handles.insert(id, handle);
        }
        for _ in 0..from.varint()? {
            let id = JointId::decode(from)?;
            let [force, torque] = from.f32s()?;
            joints.strengths.insert(id, JointStrength { force, torque });
        }
        Ok(joints)
    }
}

/// The axes in the order of the protocol.
const AXES: [JointAxis; 6] = [
    JointAxis::LinX,
    JointAxis::LinY,
    JointAxis::LinZ,
    JointAxis::AngX,
    JointAxis::AngY,
    JointAxis::AngZ,
];

fn generic(joint: &Joint) -> GenericJoint {
    let [first, second] = joint
        .frames
        .map(|JointFrame { anchor, rotation }| pose(anchor, rotation));
    let locked = JointAxesMask::from_bits_truncate(joint.kind.locked().bits());
    let mut builder = GenericJointBuilder::new(locked)
        .local_frame1(first)
        .local_frame2(second)
        .contacts_enabled(joint.collide);
    match joint.kind {
        JointKind::Rope(length) => {
            builder = builder
                .coupled_axes(JointAxesMask::LIN_AXES)
                .limits(JointAxis::LinX, [0.0, length]);
        }
        JointKind::Spring(spring) => {
            builder = builder
                .coupled_axes(JointAxesMask::LIN_AXES)
                .motor_position(
                    JointAxis::LinX,
                    spring.length,
                    spring.stiffness,
                    spring.damping,
                )
                .motor_model(JointAxis::LinX, MotorModel::ForceBased);
        }
        _ => {}
    }
    for (axis, limits) in AXES.into_iter().zip(joint.kind.limits()) {
        if let Some(limits) = limits {
            builder = builder.limits(axis, [limits.least, limits.most]);
        }
    }
    for (axis, motor) in AXES.into_iter().zip(&joint.motors) {
        if let Some(motor) = motor {
            builder = builder
                .set_motor(
                    axis,
                    motor.position,
                    motor.velocity,
                    motor.stiffness,
                    motor.damping,
                )
                .motor_max_force(axis, motor.force);
        }
    }
    builder.build()
}
