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

use super::body::pose;
use super::motors::{self, JointMotors};

/// The joints.
#[derive(Clone, Debug, Default)]
pub(super) struct RapierJoints {
    handles: BTreeMap<JointId, ImpulseJointHandle>,
    /// The joints that can break.
    strengths: BTreeMap<JointId, JointStrength>,
    /// By the parts of a handle.
    motors: BTreeMap<(u32, u32), JointMotors>,
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
        // Motors are solved first, so that the joint has the last word.
        let motors = JointMotors::add(world, bodies, joint);
        let handle = world.insert_impulse_joint(first, second, generic(joint));
        self.handles.insert(id, handle);
        if let Some(motors) = motors {
            self.motors.insert(handle.into_raw_parts(), motors);
        }
        if let Some(strength) = joint.strength {
            self.strengths.insert(id, strength);
        }
    }

    /// Removes a joint, if it is there.
    pub(super) fn remove(&mut self, world: &mut PhysicsWorld, id: JointId) {
        self.strengths.remove(&id);
        if let Some(handle) = self.handles.remove(&id) {
            world.remove_impulse_joint(handle);
            if let Some(motors) = self.motors.remove(&handle.into_raw_parts()) {
                motors.remove(world);
            }
        }
    }

    /// Lays the motors anew for the next step.
    pub(super) fn aim(&mut self, world: &mut PhysicsWorld) {
        // A body takes its joints with it.
        let holds = |(index, generation): &(u32, u32)| {
            let handle = ImpulseJointHandle::from_raw_parts(*index, *generation);
            world.impulse_joints.get(handle).is_some()
        };
        self.motors.retain(|handle, _| holds(handle));
        if !self.motors.is_empty() {
            motors::aim(world, &mut self.motors);
        }
    }

    /// Adds the joints whose load in the last step was above their strength.
    ///
    /// `substep`: seconds in which a joint's impulses act.
    pub(super) fn overloaded(&self, world: &PhysicsWorld, substep: f32, out: &mut Vec<JointId>) {
        let is_overloaded = |(id, strength): (&JointId, &JointStrength)| {
            let handle = *self.handles.get(id)?;
            let joint = world.impulse_joints.get(handle)?;
            let motors = self.motors.get(&handle.into_raw_parts());
            let pushed = motors.map_or([0.0; 6], |motors| motors.impulses(world));
            let own = joint.impulses;
            let [x, y, z, about_x, about_y, about_z] =
                [0, 1, 2, 3, 4, 5].map(|axis| own[axis] + pushed[axis]);
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
        self.motors.clear();
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
        to.varint(self.motors.len() as u64);
        for ((index, generation), motors) in &self.motors {
            to.varint(u64::from(*index));
            to.varint(u64::from(*generation));
            motors.encode(to);
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
        for _ in 0..from.varint()? {
            let handle = (from.varint32()?, from.varint32()?);
            joints.motors.insert(handle, JointMotors::decode(from)?);
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
    builder.build()
}
