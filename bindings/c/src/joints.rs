//! Joints as flat structs of C.

use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::rhumb_client::scene::{
    Command, Joint, JointFrame, JointId, JointLimits, JointStrength, LockedAxes, Motor,
};
use rhumb_bindings::{BindingError, JointFreedom, JointParams, parse_packed_id};

use crate::border::{RhumbCode, guard, one_of, value, write};
use crate::descriptions::RhumbBody;
use crate::kinds::JOINT_KINDS;
use crate::scene::{RhumbScene, send};

/// Frame of a joint in one of its bodies.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbJointFrame {
    /// From the origin of the body's shape, along its axes, in the scene's unit of length.
    pub anchor: [f32; 3],
    /// Unit quaternion x, y, z, w: frame to body.
    pub rotation: [f32; 4],
}

/// A joint of two bodies. Begin with `rhumb_joint_desc_init`.
///
/// Arrays of six have translations along x, y and z of the frames first, then rotations about them. Bits of a set of axes
/// have the same order.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbJointDesc {
    /// A `RhumbJointKind`.
    pub kind: u32,
    /// Not zero: the two bodies also collide with each other.
    pub collide: u8,
    /// Not zero: the joint breaks at `break_force` or `break_torque`.
    pub has_strength: u8,
    /// The first body.
    pub first: RhumbBody,
    /// The second body, another one.
    pub second: RhumbBody,
    /// Frame in the first body.
    pub first_frame: RhumbJointFrame,
    /// Frame in the second body.
    pub second_frame: RhumbJointFrame,
    /// Of a generic joint: bits of the axes without motion.
    pub locked_axes: u32,
    /// Bits of the axes that `least` and `most` limit.
    pub limited_axes: u32,
    /// Bits of the axes with a motor.
    pub motor_axes: u32,
    /// Units of length, or radians.
    pub least: [f32; 6],
    /// Units of length, or radians.
    pub most: [f32; 6],
    /// Position that the motor drives to: units of length, or radians.
    pub motor_position: [f32; 6],
    /// Velocity that the motor drives to: units of length per second, or rad/s.
    pub motor_velocity: [f32; 6],
    /// Acceleration for what the position lacks, 1/s²; zero for a motor that drives the velocity alone.
    pub motor_stiffness: [f32; 6],
    /// Acceleration for what the velocity lacks, 1/s.
    pub motor_damping: [f32; 6],
    /// Greatest force or torque of the motor.
    pub motor_force: [f32; 6],
    /// Of a rope: most distance of the anchors. Of a spring: the distance at which it does not pull.
    pub length: f32,
    /// Of a spring: N/m.
    pub stiffness: f32,
    /// Of a spring: N s/m.
    pub damping: f32,
    /// Force at which the joint breaks, kg times units of length per s².
    pub break_force: f32,
    /// Torque at which the joint breaks, kg times units of length² per s².
    pub break_torque: f32,
}

/// Makes a plain description: a fixed joint of no bodies at their centres, without limits and motors, that never breaks.
///
/// # Safety
///
/// `desc` points to memory for a `RhumbJointDesc`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_joint_desc_init(desc: *mut RhumbJointDesc) -> RhumbCode {
    // SAFETY: the caller promises the memory.
    guard(|| unsafe { write(desc, RhumbJointDesc::PLAIN, "desc") })
}

/// Queues the addition of a joint under a number of the application's, below 65,536, that no joint of the scene has.
///
/// `last` may be null; otherwise it receives the number of the command, which events name.
///
/// # Safety
///
/// `desc` points to a description; `last` is null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_add_joint(
    scene: RhumbScene,
    joint: u32,
    desc: *const RhumbJointDesc,
    last: *mut u64,
) -> RhumbCode {
    // SAFETY: the caller promises the description and the memory.
    guard(|| unsafe {
        let (id, joint) = (JointId(joint), Box::new(value(desc, "desc")?.joint()?));
        send(scene, Command::AddJoint { id, joint }, last)
    })
}

/// Queues the replacement of a joint, its limits and motors among others. The description is whole.
///
/// # Safety
///
/// As `rhumb_scene_add_joint`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_change_joint(
    scene: RhumbScene,
    joint: u32,
    desc: *const RhumbJointDesc,
    last: *mut u64,
) -> RhumbCode {
    // SAFETY: the caller promises the description and the memory.
    guard(|| unsafe {
        let (id, joint) = (JointId(joint), Box::new(value(desc, "desc")?.joint()?));
        send(scene, Command::ChangeJoint { id, joint }, last)
    })
}

/// Queues the removal of a joint. A joint goes with either of its bodies too.
///
/// # Safety
///
/// `last` is null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_remove_joint(
    scene: RhumbScene,
    joint: u32,
    last: *mut u64,
) -> RhumbCode {
    let id = JointId(joint);
    // SAFETY: the caller promises the memory.
    guard(|| unsafe { send(scene, Command::RemoveJoint { id }, last) })
}

impl RhumbJointFrame {
    const PLAIN: Self = Self {
        anchor: [0.0; 3],
        rotation: [0.0, 0.0, 0.0, 1.0],
    };

    const fn frame(&self) -> JointFrame {
        JointFrame {
            anchor: Vec3::from_array(self.anchor),
            rotation: Quat::from_array(self.rotation),
        }
    }
}

impl RhumbJointDesc {
    const PLAIN: Self = Self {
        kind: 0,
        collide: 0,
        has_strength: 0,
        first: RhumbBody(0),
        second: RhumbBody(0),
        first_frame: RhumbJointFrame::PLAIN,
        second_frame: RhumbJointFrame::PLAIN,
        locked_axes: 0,
        limited_axes: 0,
        motor_axes: 0,
        least: [0.0; 6],
        most: [0.0; 6],
        motor_position: [0.0; 6],
        motor_velocity: [0.0; 6],
        motor_stiffness: [0.0; 6],
        motor_damping: [0.0; 6],
        // Any force.
        motor_force: [Motor::with_velocity(0.0, 0.0).force; 6],
        length: 1.0,
        stiffness: 0.0,
        damping: 0.0,
        break_force: 0.0,
        break_torque: 0.0,
    };

    fn joint(&self) -> Result<Joint, BindingError> {
        let kind: JointFreedom = one_of(&JOINT_KINDS, self.kind, "desc.kind")?;
        let bodies = [
            parse_packed_id(self.first.0)?,
            parse_packed_id(self.second.0)?,
        ];
        let limited = axes(self.limited_axes, "desc.limited_axes")?;
        let driven = axes(self.motor_axes, "desc.motor_axes")?;
        let params = JointParams {
            frames: [self.first_frame.frame(), self.second_frame.frame()],
            locked: axes(self.locked_axes, "desc.locked_axes")?,
            limits: std::array::from_fn(|axis| {
                limited.locks(axis).then_some(JointLimits {
                    least: self.least[axis],
                    most: self.most[axis],
                })
            }),
            motors: std::array::from_fn(|axis| {
                driven.locks(axis).then_some(Motor {
                    position: self.motor_position[axis],
                    velocity: self.motor_velocity[axis],
                    stiffness: self.motor_stiffness[axis],
                    damping: self.motor_damping[axis],
                    force: self.motor_force[axis],
                })
            }),
            length: self.length,
            stiffness: self.stiffness,
            damping: self.damping,
            collide: self.collide != 0,
            strength: (self.has_strength != 0).then_some(JointStrength {
                force: self.break_force,
                torque: self.break_torque,
            }),
            ..JointParams::new(kind, bodies)
        };
        params.joint()
    }
}

/// A set of axes.
fn axes(bits: u32, argument: &'static str) -> Result<LockedAxes, BindingError> {
    let set = u8::try_from(bits).ok().and_then(LockedAxes::new);
    set.ok_or_else(|| BindingError::value(argument, bits, "six bits: 0 to 63"))
}

#[cfg(test)]
mod tests {
    use rhumb_bindings::rhumb_client::scene::JointKind;

    use super::*;
    use crate::kinds::RhumbJointKind;

    const HINGE: RhumbJointDesc = RhumbJointDesc {
        kind: RhumbJointKind::Revolute as u32,
        first: RhumbBody(1),
        second: RhumbBody(2),
        ..RhumbJointDesc::PLAIN
    };

    fn error(desc: RhumbJointDesc) -> String {
        desc.joint().expect_err("the joint is wrong").to_string()
    }

    #[test]
    fn limits_and_motors_are_read_where_their_bits_are() {
        let mut desc = RhumbJointDesc {
            limited_axes: 0b1000,
            motor_axes: 0b1000,
            ..HINGE
        };
        (desc.least[3], desc.most[3]) = (-0.5, 1.0);
        desc.motor_velocity[3] = 2.0;
        // Without their bits, these mean nothing.
        (desc.least[4], desc.motor_velocity[0]) = (1.0, 1.0);
        let joint = desc.joint().unwrap();
        let limits = JointLimits {
            least: -0.5,
            most: 1.0,
        };
        assert_eq!(joint.kind, JointKind::Revolute(Some(limits)));
        let motors = joint.motors.map(|motor| motor.map(|motor| motor.velocity));
        assert_eq!(motors, [None, None, None, Some(2.0), None, None]);
    }

    #[test]
    fn unknown_kinds_bodies_and_bits_are_errors() {
        assert!(
            error(RhumbJointDesc { kind: 7, ..HINGE })
                .starts_with("desc.kind is 7, and must be 0 to 6")
        );
        assert_eq!(error(RhumbJointDesc::PLAIN), "0x0 is the id of no body");
        let bits = RhumbJointDesc {
            limited_axes: 64,
            ..HINGE
        };
        assert!(error(bits).starts_with("desc.limited_axes is "));
        let locked = RhumbJointDesc {
            limited_axes: 1,
            ..HINGE
        };
        assert!(error(locked).starts_with("limits is of axis "));
    }
}
