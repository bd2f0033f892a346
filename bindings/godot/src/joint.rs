//! Joints of a scene, as resources.

use godot::global::Error;
use godot::prelude::*;
use rhumb_bindings::{JointFreedom, JointParams};
use rhumb_client::scene::{
    Command, JointFrame, JointId, JointLimits, JointStrength, LockedAxes, Motor,
};

use crate::body::BodyNode;
use crate::conversion::{quat, vec3};
use crate::scene::SceneNode;

/// The motions that a joint leaves free.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, GodotConvert, Var, Export)]
#[godot(via = i64)]
pub(crate) enum NodeFreedom {
    /// Nothing.
    #[default]
    Fixed,
    /// Every turn.
    Spherical,
    /// The turn about x of its frames.
    Revolute,
    /// The displacement along x of its frames.
    Prismatic,
    /// Everything, but the anchors are at most `length` apart.
    Rope,
    /// Everything; a spring pulls the anchors.
    Spring,
    /// Every axis that `locked_axes` does not name.
    Generic,
}

/// A joint of two bodies, for `add_joint` and `change_joint` of a `RhumbScene`.
///
/// Axes are 0 to 2 along x, y and z of its frames, and 3 to 5 about them.
#[derive(GodotClass)]
#[class(init, base = Resource, rename = RhumbJoint)]
pub(crate) struct JointResource {
    /// The motions that it leaves free.
    #[export]
    kind: NodeFreedom,
    /// From the origin of the first body's node, in its axes, metres.
    #[export]
    first_anchor: Vector3,
    /// From the origin of the second body's node, in its axes, metres.
    #[export]
    second_anchor: Vector3,
    /// Frame to the first body.
    #[export]
    first_rotation: Quaternion,
    /// Frame to the second body.
    #[export]
    second_rotation: Quaternion,
    /// Of a generic joint: bits of the axes without motion.
    #[export]
    locked_axes: u8,
    /// Of a rope or a spring, metres.
    #[export]
    #[init(val = 1.0)]
    length: f32,
    /// Of a spring, N/m.
    #[export]
    stiffness: f32,
    /// Of a spring, N·s/m.
    #[export]
    damping: f32,
    /// The two bodies also collide with each other.
    #[export]
    collide: bool,
    /// Force at which it breaks, N; it never does if this is zero.
    #[export]
    break_force: f32,
    /// Torque at which it breaks, N·m.
    #[export]
    break_torque: f32,
    limits: [Option<JointLimits>; 6],
    motors: [Option<Motor>; 6],
}

#[godot_api]
impl JointResource {
    /// Limits an axis that the joint leaves free: metres, or radians from -2π to 2π.
    #[func]
    fn limit(&mut self, axis: i64, least: f32, most: f32) -> Error {
        let limits = JointLimits { least, most };
        self.set("limit", axis, |joint, axis| {
            joint.limits[axis] = Some(limits);
        })
    }

    /// Drives an axis: metres or radians, and the same per second. `stiffness`: acceleration for what the position lacks,
    /// 1/s²; zero for a motor that drives the velocity alone. `damping`: acceleration for what the velocity lacks, 1/s.
    /// `force`: greatest force or torque, any without it.
    #[func]
    fn motor(
        &mut self,
        axis: i64,
        position: f32,
        velocity: f32,
        stiffness: f32,
        damping: f32,
        #[opt(default = 1e9)] force: f32,
    ) -> Error {
        let motor = Motor {
            position,
            velocity,
            stiffness,
            damping,
            force,
        };
        self.set("motor", axis, |joint, axis| {
            joint.motors[axis] = Some(motor);
        })
    }
}

impl JointResource {
    fn set(&mut self, call: &str, axis: i64, set: impl FnOnce(&mut Self, usize)) -> Error {
        let Some(axis) = usize::try_from(axis).ok().filter(|axis| *axis < 6) else {
            godot_error!("{call}: axis is {axis}, and must be 0 to 5");
            return Error::ERR_INVALID_PARAMETER;
        };
        set(self, axis);
        Error::OK
    }

    /// The joint of two nodes; an error is logged.
    fn of(&self, call: &str, [first, second]: [&Gd<BodyNode>; 2]) -> Option<JointParams> {
        let ids = [first, second].map(|node| node.bind().id());
        let [Some(first_id), Some(second_id)] = ids else {
            godot_error!("{call}: both nodes must stand for bodies of the scene");
            return None;
        };
        let frame = |node: &Gd<BodyNode>, anchor, rotation| JointFrame {
            anchor: vec3(anchor) - node.bind().origin(),
            rotation: quat(rotation),
        };
        let freedom = match self.kind {
            NodeFreedom::Fixed => JointFreedom::Fixed,
            NodeFreedom::Spherical => JointFreedom::Spherical,
            NodeFreedom::Revolute => JointFreedom::Revolute,
            NodeFreedom::Prismatic => JointFreedom::Prismatic,
            NodeFreedom::Rope => JointFreedom::Rope,
            NodeFreedom::Spring => JointFreedom::Spring,
            NodeFreedom::Generic => JointFreedom::Generic,
        };
        let Some(locked) = LockedAxes::new(self.locked_axes) else {
            godot_error!(
                "{call}: locked_axes is {}, and must be 0 to 63",
                self.locked_axes
            );
            return None;
        };
        Some(JointParams {
            frames: [
                frame(first, self.first_anchor, self.first_rotation),
                frame(second, self.second_anchor, self.second_rotation),
            ],
            locked,
            limits: self.limits,
            motors: self.motors,
            length: self.length,
            stiffness: self.stiffness,
            damping: self.damping,
            collide: self.collide,
            strength: (self.break_force > 0.0).then_some(JointStrength {
                force: self.break_force,
                torque: self.break_torque,
            }),
            ..JointParams::new(freedom, [first_id, second_id])
        })
    }
}

#[godot_api(secondary)]
impl SceneNode {
    /// Adds a joint of two bodies under a number below 65,536 that no joint of the scene has.
    #[func]
    fn add_joint(
        &self,
        number: u32,
        first: Gd<BodyNode>,
        second: Gd<BodyNode>,
        joint: Gd<JointResource>,
    ) -> Error {
        self.joint("add_joint", [&first, &second], &joint, |joint| {
            Command::AddJoint {
                id: JointId(number),
                joint,
            }
        })
    }

    /// Replaces a joint, its limits and motors among others.
    #[func]
    fn change_joint(
        &self,
        number: u32,
        first: Gd<BodyNode>,
        second: Gd<BodyNode>,
        joint: Gd<JointResource>,
    ) -> Error {
        self.joint("change_joint", [&first, &second], &joint, |joint| {
            Command::ChangeJoint {
                id: JointId(number),
                joint,
            }
        })
    }

    /// Removes a joint. It goes with either of its bodies too.
    #[func]
    fn remove_joint(&self, number: u32) -> Error {
        let id = JointId(number);
        self.command("remove_joint", Command::RemoveJoint { id })
    }
}

impl SceneNode {
    fn joint(
        &self,
        call: &str,
        bodies: [&Gd<BodyNode>; 2],
        joint: &Gd<JointResource>,
        command: impl FnOnce(Box<rhumb_client::scene::Joint>) -> Command,
    ) -> Error {
        let Some(params) = joint.bind().of(call, bodies) else {
            return Error::ERR_INVALID_PARAMETER;
        };
        match params.joint() {
            Ok(joint) => self.command(call, command(Box::new(joint))),
            Err(error) => {
                godot_error!("{call}: {error}");
                Error::ERR_INVALID_PARAMETER
            }
        }
    }
}
