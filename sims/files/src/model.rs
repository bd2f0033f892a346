//! The model that readers make of a file before it becomes commands.
//!
//! Frames are those of the file. Invariant: a body's index is above that of the body that holds it.
//!
//! An engine cannot carry a force through a body of no mass: a body whose file gives no mass and moments gets some, and that
//! is noted.

use std::collections::BTreeMap;
use std::rc::Rc;

use glam::{DMat3, DVec3, Quat, Vec3};
use rhumb_protocol::limits::{GYRATION_MIN, MASS_MIN};
use rhumb_protocol::scene::{CollisionGroups, JointKind};

use crate::inertia::{Inertia, Pose};
use crate::mesh::TriangleMesh;
use crate::report::{Effect, Place, Report};

/// The motion of the root of a robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Base {
    /// A root called `world`, or one without mass, is fixed; others are free.
    #[default]
    AsFile,
    /// It is fixed.
    Fixed,
    /// It moves freely.
    Free,
}

/// The world's axis that points up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UpAxis {
    /// The axis of the file: z of robots, y of glTF and JSON scenes. Gravity points the other way.
    #[default]
    AsFile,
    /// y: the scene is turned where its file has another.
    Y,
}

/// The axis of a file that points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FileUp {
    Y,
    Z,
}

/// Contacts between the parts of one robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OwnContacts {
    /// As programs do that read such files: not those of a URDF, those of MJCF by its bits and exclusions.
    #[default]
    AsFile,
    /// All that no joint connects.
    All,
}

/// The options of reading a file.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadOptions {
    /// Fixes the root of a robot, or leaves it free.
    pub base: Base,
    /// The world's axis that points up.
    pub up: UpAxis,
    /// Lets parts of one robot touch each other, or not.
    pub own_contacts: OwnContacts,
    /// The position at which the root or the world of the file is added, metres; in the world's axes.
    pub position: Vec3,
    /// File's axes → world.
    pub rotation: Quat,
    /// Folders that are searched for `package://` names, first ones first. The folders above the file are searched
    /// after them.
    pub packages: Vec<String>,
    /// Density of bodies whose file gives shapes but no mass, kg/m³.
    pub density: f32,
    /// Number of the collision group, below 32, that the parts of a robot share: robots of one scene with different
    /// numbers touch each other.
    pub group: u8,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            base: Base::AsFile,
            up: UpAxis::AsFile,
            own_contacts: OwnContacts::AsFile,
            position: Vec3::ZERO,
            rotation: Quat::IDENTITY,
            packages: Vec::new(),
            density: 1_000.0,
            group: 1,
        }
    }
}

/// A file as it was read.
#[derive(Clone, Debug)]
pub(crate) struct Model {
    pub(crate) name: String,
    pub(crate) up: FileUp,
    /// m/s², in the file's axes.
    pub(crate) gravity: DVec3,
    /// Seconds of a step, where the file says it.
    pub(crate) step: Option<f64>,
    pub(crate) bodies: Vec<ModelBody>,
    pub(crate) joints: Vec<ModelJoint>,
}

/// A body: one link, or several that nothing moves against each other.
#[derive(Clone, Debug)]
pub(crate) struct ModelBody {
    pub(crate) name: String,
    pub(crate) place: Place,
    /// Frame → the file's world.
    pub(crate) pose: Pose,
    pub(crate) fixed: bool,
    /// In the frame.
    pub(crate) inertia: Inertia,
    pub(crate) solids: Vec<Placed>,
    pub(crate) groups: CollisionGroups,
    /// Coefficient, where the file says it.
    pub(crate) friction: Option<f64>,
    /// Factor on gravity.
    pub(crate) gravity_scale: f64,
}

/// A solid of a body.
#[derive(Clone, Debug)]
pub(crate) struct Placed {
    /// Solid → the body's frame.
    pub(crate) pose: Pose,
    pub(crate) solid: Solid,
    pub(crate) name: String,
}

/// A solid, in metres; long axes along z.
#[derive(Clone, Debug)]
pub(crate) enum Solid {
    Ball {
        radius: f64,
    },
    Cuboid {
        half: DVec3,
    },
    Cylinder {
        half: f64,
        radius: f64,
    },
    Capsule {
        half: f64,
        radius: f64,
    },
    Ellipsoid {
        half: DVec3,
    },
    /// Its hull.
    Hull(Rc<TriangleMesh>),
    /// Its triangles where the body is fixed, else its hull.
    Mesh(Rc<TriangleMesh>),
    /// Everything below z = 0.
    Plane,
}

/// A joint.
#[derive(Clone, Debug)]
pub(crate) struct ModelJoint {
    pub(crate) name: String,
    pub(crate) place: Place,
    /// The holding one, and the held one.
    pub(crate) bodies: [usize; 2],
    /// Frame in the holding body → the file's world.
    pub(crate) frame: Pose,
    /// The frame in the held body, in that in the holding one: not the identity where the file starts a joint elsewhere.
    pub(crate) start: Pose,
    pub(crate) kind: JointKind,
    pub(crate) drives: [Option<Drive>; 6],
    pub(crate) collide: bool,
    /// False for a loop's closing joint.
    pub(crate) holds: bool,
}

/// Forces of an axis: passive ones, or those of a motor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Drive {
    /// N/m or N·m/rad.
    pub(crate) stiffness: f64,
    /// The rest of the spring, metres or radians.
    pub(crate) rest: f64,
    /// N·s/m or N·m·s/rad.
    pub(crate) damping: f64,
    /// Dry friction, N or N·m.
    pub(crate) friction: f64,
    /// Inertia of a rotor that turns with the axis, kg or kg·m².
    pub(crate) armature: f64,
    /// Time constant, seconds, and damping ratio of the spring, in place of stiffness and damping.
    pub(crate) timed: Option<[f64; 2]>,
    /// True if stiffness and damping are for each kg, or kg·m², that the axis moves.
    pub(crate) for_each_mass: bool,
    /// The velocity to which damping leads, m/s or rad/s.
    pub(crate) velocity: f64,
    /// The most that it pushes, N or N·m; `None`: what springs and damping can.
    pub(crate) most: Option<f64>,
}

impl Drive {
    /// True if it pushes.
    pub(crate) fn pushes(&self) -> bool {
        self.stiffness > 0.0 || self.damping > 0.0 || self.friction > 0.0 || self.timed.is_some()
    }

    /// True if dry friction is its only force.
    pub(crate) fn only_rubs(&self) -> bool {
        self.damping <= 0.0 && self.stiffness <= 0.0 && self.timed.is_none()
    }

    /// A multiple of its forces and of its rotor.
    pub(crate) fn times(self, factor: f64) -> Self {
        let of_forces = if self.for_each_mass { 1.0 } else { factor };
        Self {
            stiffness: self.stiffness * of_forces,
            damping: self.damping * of_forces,
            friction: self.friction * factor,
            armature: self.armature * factor,
            most: self.most.map(|most| most * factor),
            ..self
        }
    }

    /// The same for an inertia, kg or kg·m², that it moves: with stiffness and damping in N or N·m.
    pub(crate) fn of_inertia(self, inertia: f64) -> Self {
        match self.timed {
            None if self.for_each_mass => Self {
                stiffness: self.stiffness * inertia,
                damping: self.damping * inertia,
                ..self
            },
            None => self,
            Some([seconds, ratio]) => Self {
                stiffness: inertia / (seconds * ratio).powi(2).max(1e-15),
                damping: 2.0 * inertia / seconds.max(1e-15),
                ..self
            },
        }
    }
}

/// Gives every body that moves a mass and moments. `density`: of shapes, kg/m³.
pub(crate) fn settle_masses(
    bodies: &mut [ModelBody],
    joints: &[ModelJoint],
    density: f64,
    report: &mut Report,
) {
    let mut holding = vec![None; bodies.len()];
    for joint in joints.iter().filter(|joint| joint.holds) {
        holding[joint.bodies[1]] = Some(joint.bodies[0]);
    }
    // The inertia that each body holds, in its own frame.
    let mut held: Vec<_> = bodies.iter().map(|_| Inertia::NONE).collect();
    for place in (0..bodies.len()).rev() {
        if !bodies[place].fixed {
            give_mass(&mut bodies[place], &held[place], density, report);
        }
        let body = &bodies[place];
        if let Some(parent) = holding[place] {
            let to_parent = bodies[parent].pose.inverse().of(&body.pose);
            let whole = body.inertia.plus(&held[place]).moved(&to_parent);
            held[parent] = held[parent].plus(&whole);
        }
    }
}

/// A mass for a body that has none, and moments for one that has none.
fn give_mass(body: &mut ModelBody, held: &Inertia, density: f64, report: &mut Report) {
    let own = body.inertia;
    // Moments that put all mass within a millimetre are written where a program wants some.
    let diagonal = DVec3::new(
        own.tensor.x_axis.x,
        own.tensor.y_axis.y,
        own.tensor.z_axis.z,
    );
    let has_moments = diagonal.max_element() >= own.mass * f64::from(GYRATION_MIN);
    if own.mass > 0.0 && has_moments {
        return;
    }
    let solids = body.solids.iter().filter_map(|placed| {
        let inertia = placed.solid.inertia(density)?;
        Some(inertia.moved(&placed.pose))
    });
    let solids = solids.fold(Inertia::NONE, |sum, one| sum.plus(&one));
    let ball = |mass: f64| DVec3::splat(mass * 0.4 * 0.01);
    let (inertia, why) = match (own.mass > 0.0, solids.mass > 0.0) {
        (true, true) => {
            let shaped = solids.times(own.mass / solids.mass);
            let centre = own.centre;
            let own = Inertia { centre, ..shaped };
            (own, "moments of inertia are those of its shapes")
        }
        (true, false) => {
            let tensor = DMat3::from_diagonal(ball(own.mass));
            let own = Inertia { tensor, ..own };
            (own, "moments of inertia are those of a ball of 0.1 m")
        }
        (false, true) => (
            solids,
            "mass is that of its shapes at the density of the options",
        ),
        (false, false) if held.mass > 0.0 => {
            let centre = DVec3::ZERO;
            let share = Inertia { centre, ..*held }.times(0.01);
            (
                share,
                "no body is without mass: it has a hundredth of what it holds",
            )
        }
        (false, false) => (
            Inertia::diagonal(0.1, ball(0.1)),
            "no body is without mass: it has 0.1 kg",
        ),
    };
    let value = format!("mass {} kg, now {} kg", own.mass, inertia.mass);
    body.inertia = inertia;
    let subject = format!("body \"{}\"", body.name);
    report.add(&body.place, subject, value, Effect::Changed, why);
}

/// Scales a file whose every body is lighter than the least body of a scene, so that the lightest has that mass: the motion
/// of its parts stays as it was.
pub(crate) fn scale_masses(
    bodies: &mut [ModelBody],
    joints: &mut [ModelJoint],
    report: &mut Report,
) {
    let own = bodies.iter().filter(|body| !body.fixed);
    let masses = own.map(|body| body.inertia.mass);
    let (least, most) = masses.fold((f64::MAX, 0.0_f64), |(least, most), mass| {
        (least.min(mass), most.max(mass))
    });
    let bound = f64::from(MASS_MIN);
    let (Some(first), true) = (bodies.first(), least > 0.0 && most > 0.0 && most < bound) else {
        return;
    };
    // No body gets heavier than a thousand kilograms.
    let factor = (bound / least).min(1_000.0 / most);
    report.add(
        &first.place,
        "masses".to_owned(),
        format!("{least} kg to {most} kg, now {factor} times as much"),
        Effect::Changed,
        "a body has at least 0.001 kg: all masses and forces of joints are multiplied alike",
    );
    for body in bodies {
        body.inertia = body.inertia.times(factor);
    }
    for drive in joints.iter_mut().flat_map(|joint| &mut joint.drives) {
        *drive = drive.map(|drive| drive.times(factor));
    }
}

/// Raises masses and moments to their least ones, kg and kg·m², and scales all to a whole mass, kg, where one is given.
pub(crate) fn bound_masses(bodies: &mut [ModelBody], [mass, moment]: [f64; 2], total: Option<f64>) {
    for body in bodies.iter_mut().filter(|body| !body.fixed) {
        body.inertia.mass = body.inertia.mass.max(mass);
        if moment > 0.0 {
            let (moments, axes) = body.inertia.principal();
            let own = Inertia::diagonal(1.0, moments.max(DVec3::splat(moment)));
            body.inertia.tensor = own.moved(&Pose::new(DVec3::ZERO, axes)).tensor;
        }
    }
    if let Some(total) = total {
        let sum: f64 = bodies.iter().map(|body| body.inertia.mass).sum();
        for body in bodies {
            body.inertia = body.inertia.times(total / sum.max(1e-12));
        }
    }
}

/// Armatures of the bodies that three or more joints hold to one body, together: at most so many times its least moment.
///
/// Measured with balls of three to eight legs, spun and dropped, of 0.3 kg and 1.6 kg: 10 times and less are calm at any
/// number of legs; some of 15 times, and all of four legs of 50 times, gain speed until they fly apart. One and two legs
/// are calm at 2,000 times.
const ARMATURES_MAX: f64 = 8.0;
/// Joints with armatures on one body that an engine solves whatever they are.
const ARMATURES_FREE: usize = 2;

/// Adds the rotors of joints to the moments of the bodies that turn with them. Then they resist the joint, as they should;
/// they also resist a turn of both bodies together, which is noted. Many rotors on a light body are reduced.
pub(crate) fn add_armatures(bodies: &mut [ModelBody], joints: &[ModelJoint], report: &mut Report) {
    let mut by_holder: BTreeMap<usize, Vec<(&ModelJoint, DMat3, f64)>> = BTreeMap::new();
    for joint in joints.iter().filter(|joint| joint.holds) {
        let (mut rotors, mut sum) = (DMat3::ZERO, 0.0);
        for (axis, drive) in joint.drives.iter().enumerate() {
            let Some(armature) = drive.map(|drive| drive.armature).filter(|own| *own > 0.0) else {
                continue;
            };
            let subject = "joint armature".to_owned();
            if axis < 3 {
                let why = "the armature of a slide would weigh in a body here";
                report.again(&joint.place, subject, Effect::Left, why);
                continue;
            }
            let along = joint.frame.rotation * DVec3::AXES[axis - 3];
            let along = bodies[joint.bodies[1]].pose.rotation.conjugate() * along;
            let rotor = DMat3::from_cols(along * along.x, along * along.y, along * along.z);
            rotors += rotor * armature;
            sum += armature;
            let why = "it is part of the moments of the body that the joint turns, whatever else turns that body";
            report.again(&joint.place, subject, Effect::Approximated, why);
        }
        if sum > 0.0 {
            let of_holder = by_holder.entry(joint.bodies[0]).or_default();
            of_holder.push((joint, rotors, sum));
        }
    }
    // A body has its own rotor before those of the bodies that it holds are compared with it.
    for (holder, rotors) in by_holder {
        let share = carried(&bodies[holder], &rotors, report);
        for (joint, rotor, _) in rotors {
            let body = &mut bodies[joint.bodies[1]];
            body.inertia.tensor += rotor * share;
            if make_solid(&mut body.inertia) {
                let why = "no solid has a moment above the sum of the others: an armature raises those too";
                let subject = "moments with an armature".to_owned();
                report.again(&body.place, subject, Effect::Changed, why);
            }
        }
    }
}

/// The share of its rotors that a body of this moment carries.
fn carried(holder: &ModelBody, rotors: &[(&ModelJoint, DMat3, f64)], report: &mut Report) -> f64 {
    let (moments, _) = holder.inertia.principal();
    let most = moments.min_element() * ARMATURES_MAX;
    let sum: f64 = rotors.iter().map(|(_, _, sum)| sum).sum();
    if holder.fixed || rotors.len() <= ARMATURES_FREE || sum <= most {
        return 1.0;
    }
    let share = most / sum;
    for (joint, _, own) in rotors {
        let why = "the armatures of three or more joints on one body are at most eight times its least moment \
            together: more would drive its parts apart";
        let now = (own * share) as f32;
        let value = format!("{own} kg m², now {now} kg m²");
        let subject = format!("joint \"{}\" armature", joint.name);
        report.add(&joint.place, subject, value, Effect::Changed, why);
    }
    share
}

/// Raises the two lesser moments where the third is above their sum, as that of no solid is. True if it did.
fn make_solid(inertia: &mut Inertia) -> bool {
    let (moments, axes) = inertia.principal();
    let lack = 2.0 * moments.max_element() - moments.element_sum();
    // Less than this is the rounding of a sum.
    let is_short = lack > 1e-9 * moments.max_element();
    if is_short {
        let raised = moments + DVec3::splat(lack * 0.5);
        let greatest = moments.cmpge(DVec3::splat(moments.max_element()));
        let own = Inertia::diagonal(1.0, DVec3::select(greatest, moments, raised));
        inertia.tensor = own.moved(&Pose::new(DVec3::ZERO, axes)).tensor;
    }
    is_short
}
