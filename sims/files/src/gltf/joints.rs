//! Joints of KHR_physics_rigid_bodies, from limits and drives of axes.
//!
//! The extension has no kinds of joints: limits take motions away, one by one. The motions that are left tell the kind: none,
//! one turn, one displacement, all turns, or any others. The frame in the second body moves in that of the first.

use std::f64::consts::TAU;

use glam::{DMat3, DQuat, DVec3};
use rhumb_protocol::scene::{JointKind, JointLimits, LockedAxes};

use super::document::{Document, JointDrive, JointLimit, NodeJoint, PhysicsJoint};
use crate::inertia::Pose;
use crate::model::{Drive, ModelBody, ModelJoint};
use crate::report::{Effect, Place, Problem, Report};

/// A node that was visited.
#[derive(Clone, Copy, Debug)]
struct Visited {
    /// Its axes → the file's world.
    pose: Pose,
    /// The body that moves it; `None`: nothing does.
    body: Option<usize>,
}

/// A joint that a node has.
struct OfNode<'a> {
    node: usize,
    name: String,
    joint: &'a NodeJoint,
}

/// The nodes that were visited, and the joints that they have.
pub(super) struct Joints<'a> {
    /// By number of the node.
    visited: Vec<Option<Visited>>,
    of_nodes: Vec<OfNode<'a>>,
}

impl<'a> Joints<'a> {
    /// Without a visit to any of so many nodes.
    pub(super) fn new(nodes: usize) -> Self {
        Self {
            visited: vec![None; nodes],
            of_nodes: Vec::new(),
        }
    }

    /// Notes a node with its place, the body that moves it, and its joint.
    pub(super) fn visit(
        &mut self,
        (node, name): (usize, &str),
        pose: Pose,
        body: Option<usize>,
        joint: Option<&'a NodeJoint>,
    ) {
        self.visited[node] = Some(Visited { pose, body });
        self.of_nodes.extend(joint.map(|joint| OfNode {
            node,
            name: name.to_owned(),
            joint,
        }));
    }

    /// Makes the joints. `world` makes a body that does not move.
    pub(super) fn made(
        self,
        document: &Document,
        bodies: &mut Vec<ModelBody>,
        world: impl Fn() -> ModelBody,
        noted: (&Place, &mut Report),
    ) -> Result<Vec<ModelJoint>, Problem> {
        let mut made = Vec::new();
        let mut still = None;
        let (place, report) = noted;
        let mut joiner = Joiner {
            document,
            place,
            report,
        };
        for one in &self.of_nodes {
            let Some((ends, joint)) = joiner.described(one, &self.visited)? else {
                continue;
            };
            let bodies = ends.map(|end| {
                end.body.unwrap_or_else(|| {
                    *still.get_or_insert_with(|| {
                        bodies.push(world());
                        bodies.len() - 1
                    })
                })
            });
            made.push(ModelJoint { bodies, ..joint });
        }
        Ok(made)
    }
}

/// Distance of two numbers that counts as none, metres or radians.
const NEAR: f64 = 1e-6;

/// The motions of an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Axis {
    Free,
    Within(JointLimits),
    Locked,
}

/// The motions that a joint leaves: displacements along x, y and z, then turns about them.
#[derive(Debug)]
struct Motions([Axis; 6]);

impl Motions {
    /// The axes that are not locked.
    fn free(&self) -> Vec<usize> {
        let axes = self.0.iter().enumerate();
        let free = axes.filter(|(_, axis)| **axis != Axis::Locked);
        free.map(|(axis, _)| axis).collect()
    }

    fn limits(&self, axis: usize) -> Option<JointLimits> {
        match self.0[axis] {
            Axis::Within(limits) => Some(limits),
            _ => None,
        }
    }

    /// The kind of joint, and the axis of the file that becomes its x.
    fn kind(&self) -> (JointKind, usize) {
        match *self.free() {
            [] => (JointKind::Fixed, 0),
            [axis] if axis < 3 => (JointKind::Prismatic(self.limits(axis)), axis),
            [axis] => (JointKind::Revolute(self.limits(axis)), axis - 3),
            [3, 4, 5] if (3..6).all(|axis| self.0[axis] == Axis::Free) => {
                (JointKind::Spherical(None), 0)
            }
            _ => {
                let limits = [0, 1, 2, 3, 4, 5].map(|axis| self.limits(axis));
                (JointKind::Generic(self.locked(), limits), 0)
            }
        }
    }

    fn locked(&self) -> LockedAxes {
        let axes = self.0.iter().zip(LockedAxes::EACH);
        let locked = axes.filter(|(axis, _)| **axis == Axis::Locked);
        let bits = locked.fold(0, |bits, (_, one)| bits | one.bits());
        LockedAxes::new(bits).unwrap_or(LockedAxes::NONE)
    }

    /// True if several turns are left and one of them is limited.
    fn bounds_turns(&self) -> bool {
        let turns: Vec<_> = self.free().into_iter().filter(|axis| *axis > 2).collect();
        turns.len() > 1 && turns.iter().any(|axis| self.limits(*axis).is_some())
    }
}

/// The turn that makes an axis of the file x, and those after it y and z.
fn with_first(axis: usize) -> DQuat {
    let axes = [axis, (axis + 1) % 3, (axis + 2) % 3].map(|axis| DVec3::AXES[axis]);
    DQuat::from_mat3(&DMat3::from_cols(axes[0], axes[1], axes[2])).normalize()
}

struct Joiner<'a> {
    document: &'a Document,
    place: &'a Place,
    report: &'a mut Report,
}

impl Joiner<'_> {
    fn note(&mut self, subject: &str, effect: Effect, why: &'static str) {
        self.report
            .again(self.place, subject.to_owned(), effect, why);
    }

    /// The two ends of a node's joint, and the joint, whose bodies are still to be filled in.
    fn described(
        &mut self,
        one: &OfNode<'_>,
        visited: &[Option<Visited>],
    ) -> Result<Option<([Visited; 2], ModelJoint)>, Problem> {
        let name = format!("joint of {}", one.name);
        let document = self.document;
        let physics = document.extensions.physics.as_ref();
        let all = physics.map_or(&[][..], |physics| &physics.physics_joints);
        let missing = |what: &str, number: Option<usize>, count: usize| {
            let named = number.map_or_else(|| "none".to_owned(), |number| number.to_string());
            Problem::Mesh(format!(
                "the {name} names {what} {named}, and there are {count}"
            ))
        };
        let number = one.joint.joint;
        let described = number.and_then(|number| all.get(number));
        let described = described.ok_or_else(|| missing("joint", number, all.len()))?;
        let other = one.joint.connected_node;
        let second = other.and_then(|other| visited.get(other));
        let second = second.ok_or_else(|| missing("node", other, visited.len()))?;
        let (Some(first), Some(second)) = (visited[one.node], *second) else {
            let why = "its other node is in another scene of the file";
            self.note("joint", Effect::Left, why);
            return Ok(None);
        };
        if first.body == second.body {
            let why = "it joins a body with itself, or two that do not move";
            self.note("joint", Effect::Left, why);
            return Ok(None);
        }
        let motions = self.motions(&name, described)?;
        if motions.free().len() == 6 && described.drives.is_empty() {
            let why = "it leaves all motions and drives none";
            self.note("joint", Effect::Left, why);
            return Ok(None);
        }
        let (kind, axis) = motions.kind();
        if motions.bounds_turns() {
            let why = "limits of several turns bound parts of the whole turn";
            self.note("joint", Effect::Approximated, why);
        }
        let turned = Pose::new(DVec3::ZERO, with_first(axis));
        let frames = [first.pose, second.pose].map(|pose| pose.of(&turned));
        let joint = ModelJoint {
            name: one.name.clone(),
            place: self.place.clone(),
            bodies: [0; 2],
            frame: frames[0],
            start: frames[0].inverse().of(&frames[1]),
            drives: self.drives(&name, (&kind, axis, &motions.free()), described)?,
            kind,
            collide: one.joint.enable_collision,
            holds: false,
        };
        Ok(Some(([first, second], joint)))
    }

    fn motions(&mut self, name: &str, described: &PhysicsJoint) -> Result<Motions, Problem> {
        let mut motions = Motions([Axis::Free; 6]);
        for limit in &described.limits {
            let senseless = |rule| Problem::Senseless {
                name: name.to_owned(),
                rule,
            };
            limit.check().map_err(senseless)?;
            let axes = limit.axes();
            let soft = [
                (limit.stiffness, "joint limit stiffness"),
                (limit.damping, "joint limit damping"),
            ];
            for (_, subject) in soft.into_iter().filter(|(number, _)| number.is_some()) {
                self.note(subject, Effect::Changed, "limits are hard");
            }
            let locks = limit.max.is_some_and(|max| max.abs() < NEAR)
                && limit.min.is_none_or(|min| min.abs() < NEAR)
                && (limit.min.is_some() || axes.len() > 1);
            match *axes {
                _ if locks => axes.iter().for_each(|axis| motions.0[*axis] = Axis::Locked),
                [axis] => match limit.range(axis) {
                    Some(range) if motions.0[axis] == Axis::Free => {
                        motions.0[axis] = Axis::Within(range);
                    }
                    Some(_) => {
                        let why = "an axis has one limit";
                        self.note("joint limit", Effect::Left, why);
                    }
                    None => {
                        let why = "a limit of a turn has two ends, less than a whole turn apart";
                        self.note("joint limit", Effect::Left, why);
                    }
                },
                _ => {
                    let why = "limits of two or three axes lock them, or are not read";
                    self.note("joint limit", Effect::Left, why);
                }
            }
        }
        Ok(motions)
    }

    /// The drives of a joint whose x is this axis of the file, and which leaves these motions.
    fn drives(
        &mut self,
        name: &str,
        (kind, axis, free): (&JointKind, usize, &[usize]),
        described: &PhysicsJoint,
    ) -> Result<[Option<Drive>; 6], Problem> {
        let place = |of: usize| match kind {
            JointKind::Prismatic(_) => (of == axis).then_some(0),
            JointKind::Revolute(_) => (of == axis + 3).then_some(3),
            _ => free.contains(&of).then_some(of),
        };
        let mut drives = [None; 6];
        for drive in &described.drives {
            let senseless = |rule| Problem::Senseless {
                name: name.to_owned(),
                rule,
            };
            drive.check().map_err(senseless)?;
            match place(drive.axis()) {
                Some(place) if drives[place].is_none() => drives[place] = Some(drive.drive()),
                _ => {
                    let why = "each axis that is free has one drive";
                    self.note("joint drive", Effect::Left, why);
                }
            }
        }
        Ok(drives)
    }
}

impl JointLimit {
    /// Checks what the extension fixes; the error is the broken rule.
    fn check(&self) -> Result<(), &'static str> {
        let named = self.linear_axes.as_ref().or(self.angular_axes.as_ref());
        let axes = named.map_or(&[][..], Vec::as_slice);
        let is_repeated = |place: usize| axes[..place].contains(&axes[place]);
        let not_negative = |number: Option<f64>| number.is_none_or(|number| number >= 0.0);
        let rules = [
            (
                self.linear_axes.is_some() != self.angular_axes.is_some(),
                "a limit has linearAxes or angularAxes, one of both",
            ),
            (
                axes.iter().all(|axis| *axis < 3),
                "the axes of a limit are 0, 1 and 2",
            ),
            (
                !axes.is_empty() && !(0..axes.len()).any(is_repeated),
                "a limit has one to three axes, each once",
            ),
            (
                self.min.zip(self.max).is_none_or(|(min, max)| min <= max),
                "the min of a limit is at most its max",
            ),
            (
                not_negative(self.stiffness) && not_negative(self.damping),
                "stiffness and damping of a limit are at least 0",
            ),
        ];
        let broken = rules.into_iter().find(|(holds, _)| !holds);
        broken.map_or(Ok(()), |(_, rule)| Err(rule))
    }

    /// Its axes, once checked: displacements from 0, turns from 3.
    fn axes(&self) -> Vec<usize> {
        let [ways, turns] =
            [&self.linear_axes, &self.angular_axes].map(|axes| axes.iter().flatten());
        ways.copied().chain(turns.map(|axis| axis + 3)).collect()
    }

    /// Its range on one axis; `None` where a joint cannot have it.
    fn range(&self, axis: usize) -> Option<JointLimits> {
        let is_way = axis < 3;
        let end = |end: Option<f64>, otherwise: f64| end.or(is_way.then_some(otherwise));
        // A displacement without an end has one beyond the world, which is cut later.
        let least = end(self.min, f64::from(f32::MIN))?;
        let most = end(self.max, f64::from(f32::MAX))?;
        (is_way || most - least < TAU).then_some(JointLimits {
            least: least as f32,
            most: most as f32,
        })
    }
}

impl JointDrive {
    /// Checks what the extension fixes; the error is the broken rule.
    fn check(&self) -> Result<(), &'static str> {
        let rules = [
            (
                matches!(&*self.kind, "linear" | "angular"),
                "the type of a drive is linear or angular",
            ),
            (
                matches!(&*self.mode, "force" | "acceleration"),
                "the mode of a drive is force or acceleration",
            ),
            (
                self.axis.is_some_and(|axis| axis < 3),
                "the axis of a drive is 0, 1 or 2",
            ),
            (
                self.stiffness >= 0.0 && self.damping >= 0.0,
                "stiffness and damping of a drive are at least 0",
            ),
            (
                self.max_force.is_none_or(|most| most >= 0.0),
                "maxForce of a drive is at least 0",
            ),
        ];
        let broken = rules.into_iter().find(|(holds, _)| !holds);
        broken.map_or(Ok(()), |(_, rule)| Err(rule))
    }

    /// Displacements from 0, turns from 3.
    fn axis(&self) -> usize {
        let axis = self.axis.unwrap_or(usize::MAX);
        match self.kind.as_str() {
            "angular" => axis.saturating_add(3),
            _ => axis,
        }
    }

    fn drive(&self) -> Drive {
        Drive {
            stiffness: self.stiffness,
            rest: self.position_target.unwrap_or(0.0),
            damping: self.damping,
            for_each_mass: self.mode == "acceleration",
            velocity: self.velocity_target.unwrap_or(0.0),
            most: Some(self.max_force.unwrap_or(f64::INFINITY)),
            ..Drive::default()
        }
    }
}
