//! A model as bodies and joints of a scene, and the commands that make them.
//!
//! A body's origin becomes its centre of mass and its axes the principal ones, so that its moments lie along them;
//! shapes and joints move along. Numbers outside the protocol's limits are brought inside and noted.

use std::f32::consts::{PI, TAU};

use glam::{DQuat, DVec3, Quat, Vec3};
use rhumb_protocol::limits::{
    BODIES_MAX, EXTENT_MAX, FORCE_MAX, FRICTION_MAX, GYRATION_MAX, GYRATION_MIN, JOINTS_MAX,
    MASS_MAX, MASS_MIN, PARTS_MAX, RATE_MAX, SHAPES_MAX, STIFFNESS_MAX, SUBSTEPS_MAX,
};
use rhumb_protocol::scene::{
    BodyBuilder, BodyDesc, Command, Compound, Invalid, Joint, JointFrame, JointId, JointKind,
    JointLimits, LockedAxes, Mass, Material, Motor, Part, SceneConfig, Shape, ShapeId,
};
use rhumb_reckoning::{BodyId, Rate};

use crate::inertia::{Inertia, Pose};
use crate::model::{Drive, FileUp, LoadOptions, Model, ModelBody, ModelJoint, UpAxis};
use crate::overlap;
use crate::report::{Effect, LoadError, Place, Problem, Report};
use crate::solid::{Placement, Subject};

/// A body of a loaded scene.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedBody {
    /// Its name in the file.
    pub name: String,
    /// The body, at its start.
    pub builder: BodyBuilder,
    /// Tick before whose step it is added; zero for most.
    pub tick: u64,
    /// Origin of the file's frame of it, from its centre of mass and in its axes, metres.
    pub frame_position: Vec3,
    /// Rotation of the file's frame of it: frame → body.
    pub frame_rotation: Quat,
}

/// A joint of a loaded scene.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedJoint {
    /// Its name in the file.
    pub name: String,
    /// Places of its bodies among those of the scene.
    pub bodies: [usize; 2],
    /// The joint; its ids of bodies mean nothing.
    pub joint: Joint,
}

/// A file as bodies and joints, ready to be added to any scene.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedScene {
    /// Its name in the file.
    pub name: String,
    /// The configuration that the file asks for, in lockstep; what it leaves open is the default.
    pub config: SceneConfig,
    /// The bodies, holding ones before held ones.
    pub bodies: Vec<LoadedBody>,
    /// The joints.
    pub joints: Vec<LoadedJoint>,
    /// The parts of the file that the scene has not, or has changed.
    pub report: Report,
}

/// First ids that are free in a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FreeIds {
    /// Index of a body.
    pub body: u32,
    /// Number of a shape.
    pub shape: u32,
    /// Number of a joint.
    pub joint: u32,
}

impl LoadedScene {
    /// The commands that make the scene: equal shapes once, then bodies, then joints, with ids from these upward.
    /// Bodies of later ticks are among them.
    ///
    /// # Errors
    ///
    /// [`LoadError`] for a body that no scene accepts, and for more shapes than a scene has.
    pub fn commands(&self, first: FreeIds) -> Result<Vec<Command>, LoadError> {
        let mut commands = Vec::new();
        let mut shapes: Vec<&Shape> = Vec::new();
        for (place, body) in self.bodies.iter().enumerate() {
            let shape = body.builder.shape();
            let known = shapes.iter().position(|known| *known == shape);
            let number = known.unwrap_or(shapes.len());
            let id = ShapeId(first.shape + number as u32);
            if known.is_none() {
                shapes.push(shape);
                if shapes.len() > SHAPES_MAX as usize {
                    return Err(too_many("shapes", shapes.len(), SHAPES_MAX));
                }
                let shape = shape.clone();
                commands.push(Command::AddShape { id, shape });
            }
            let index = BodyId::new(first.body + place as u32, 0);
            let motion = body.builder.state();
            let motion =
                motion.map_err(|invalid| refused(&Place::of(&self.name), &body.name, invalid))?;
            let desc = body.builder.desc(index, id);
            commands.push(Command::AddBody { desc, motion });
        }
        for (place, one) in self.joints.iter().enumerate() {
            let bodies = one
                .bodies
                .map(|place| BodyId::new(first.body + place as u32, 0));
            let joint = Box::new(Joint {
                bodies,
                ..one.joint
            });
            let id = JointId(first.joint + place as u32);
            commands.push(Command::AddJoint { id, joint });
        }
        Ok(commands)
    }
}

fn too_many(what: &'static str, found: usize, most: u32) -> LoadError {
    LoadError {
        place: Place::of("the scene"),
        problem: Problem::TooMany {
            what,
            found,
            most: most as usize,
        },
    }
}

fn refused(place: &Place, name: &str, invalid: Invalid) -> LoadError {
    LoadError {
        place: place.clone(),
        problem: Problem::Refused {
            name: name.to_owned(),
            invalid: Box::new(invalid),
        },
    }
}

/// Makes bodies and joints of a model.
pub(crate) fn assemble(
    model: &Model,
    options: &LoadOptions,
    mut report: Report,
) -> Result<LoadedScene, LoadError> {
    if model.bodies.len() > BODIES_MAX as usize {
        return Err(too_many("bodies", model.bodies.len(), BODIES_MAX));
    }
    let up = match (options.up, model.up) {
        (UpAxis::AsFile, _) | (UpAxis::Y, FileUp::Y) => DQuat::IDENTITY,
        (UpAxis::Y, FileUp::Z) => DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2),
    };
    let world = Pose::new(
        options.position.as_dvec3(),
        options.rotation.as_dquat() * up,
    );
    let world = Pose::new(world.position, world.rotation.normalize());
    let mut scene = LoadedScene {
        name: model.name.clone(),
        config: config(model, up, &mut report),
        bodies: Vec::with_capacity(model.bodies.len()),
        joints: Vec::with_capacity(model.joints.len()),
        report: Report::default(),
    };
    let mut centres = Vec::with_capacity(model.bodies.len());
    for body in &model.bodies {
        let (moments, axes) = body.inertia.principal();
        let centre = match body.fixed {
            true => Pose::IDENTITY,
            false => Pose::new(body.inertia.centre, axes),
        };
        let loaded = self::body(body, [&world, &centre], moments, &mut report, options)?;
        scene.bodies.push(loaded);
        centres.push(world.of(&body.pose).of(&centre));
    }
    let held = held_masses(model);
    for joint in &model.joints {
        let [holding, own] = joint.bodies;
        let moved = if model.bodies[own].fixed {
            holding
        } else {
            own
        };
        let effective = Effective {
            held: held[moved],
            frame: joint.frame,
        };
        let places = joint.bodies.map(|place| &centres[place]);
        let frame = world.of(&joint.frame);
        let loaded = self::joint(joint, places, &frame, &effective, &mut report)?;
        let brake = brake(joint, &loaded);
        scene.joints.push(loaded);
        scene.joints.extend(brake);
    }
    if scene.joints.len() > JOINTS_MAX as usize {
        return Err(too_many("joints", scene.joints.len(), JOINTS_MAX));
    }
    overlap::note(model, &mut report);
    scene.report = report;
    Ok(scene)
}

/// The configuration that a file asks for.
fn config(model: &Model, up: DQuat, report: &mut Report) -> SceneConfig {
    let gravity = up * model.gravity;
    // A component below this is the rounding of a turn; gravity has none along that axis.
    let rest = gravity.length() * 1e-12;
    let gravity = DVec3::select(
        gravity.abs().cmpgt(DVec3::splat(rest)),
        gravity,
        DVec3::ZERO,
    );
    let mut config = SceneConfig {
        gravity: gravity.as_vec3(),
        ..SceneConfig::default()
    };
    match model.step.map(|step| (step, rate(step))) {
        None => {}
        Some((_, Some(rate))) => {
            config.integrator.rate = rate;
            // Chains of joints need more than one pass in a step; the file's own engine has a hundred.
            if model.joints.is_empty() {
                config.integrator.substeps = std::num::NonZeroU32::MIN;
            }
        }
        Some((step, None)) => {
            let substeps = fine_substeps(step, &mut config);
            report.add(
                &Place::of(&model.name),
                "step".to_owned(),
                match substeps {
                    None => format!("{step} s, now 60 steps a second of four substeps"),
                    Some(count) => format!("{step} s, now 1000 steps a second of {count} substeps"),
                },
                Effect::Changed,
                "a scene takes at most 1,000 steps a second, a whole number in some seconds, of 16 substeps",
            );
        }
    }
    config
}

/// For a step below a millisecond: a thousand ticks a second, of as many substeps as there were steps, up to the most.
fn fine_substeps(step: f64, config: &mut SceneConfig) -> Option<u32> {
    let in_tick = 1.0 / (step * f64::from(RATE_MAX));
    let rate = Rate::new(RATE_MAX, 1).filter(|_| in_tick > 1.0)?;
    // The quotient is rounded.
    let substeps = (in_tick - 1e-6).ceil().min(f64::from(SUBSTEPS_MAX)) as u32;
    config.integrator.rate = rate;
    config.integrator.substeps = std::num::NonZeroU32::new(substeps)?;
    Some(substeps)
}

/// The rate of a step, seconds: a whole number of steps in a second, or in up to 1,001 of them.
pub(crate) fn rate(step: f64) -> Option<Rate> {
    let per_second = 1.0 / step;
    if !(per_second <= f64::from(RATE_MAX) + 1e-6 && step <= 1.0) {
        return None;
    }
    let whole = |seconds: u32| {
        let ticks = (f64::from(seconds) * per_second).round();
        let off = ticks * step - f64::from(seconds);
        (off.abs() < 1e-9 * f64::from(seconds)).then(|| Rate::new(ticks as u32, seconds))?
    };
    (1..=1_001).find_map(whole)
}

/// Mass of each body with all that it holds, in the file's world.
fn held_masses(model: &Model) -> Vec<Inertia> {
    let own = model
        .bodies
        .iter()
        .map(|body| body.inertia.moved(&body.pose));
    let mut held: Vec<_> = own.collect();
    for joint in model.joints.iter().rev().filter(|joint| joint.holds) {
        let [holding, own] = joint.bodies;
        held[holding] = held[holding].plus(&held[own]);
    }
    held
}

fn body(
    body: &ModelBody,
    [world, centre]: [&Pose; 2],
    moments: DVec3,
    report: &mut Report,
    options: &LoadOptions,
) -> Result<LoadedBody, LoadError> {
    let shape = shape(body, &centre.inverse(), report)?;
    let mut builder = match body.fixed {
        true => BodyDesc::fixed(shape),
        false => BodyDesc::dynamic(shape).mass_of(mass(body, moments, report)),
    };
    builder = builder
        .collision_groups(body.groups)
        .gravity_scale(body.gravity_scale as f32);
    if let Some(friction) = body.friction {
        builder = builder.material(Material {
            friction: friction.clamp(0.0, f64::from(FRICTION_MAX)) as f32,
            restitution: 0.0,
            density: options.density,
        });
    }
    let place = world.of(&body.pose).of(centre);
    let frame = centre.inverse();
    let builder = builder
        .position(place.position.as_vec3())
        .rotation(turn(place.rotation));
    builder
        .check()
        .map_err(|invalid| refused(&body.place, &body.name, invalid))?;
    Ok(LoadedBody {
        name: body.name.clone(),
        builder,
        tick: 0,
        frame_position: frame.position.as_vec3(),
        frame_rotation: turn(frame.rotation),
    })
}

/// A rotation in f32, of unit length there too; the identity for one that differs by rounding.
fn turn(rotation: DQuat) -> Quat {
    let rotation = if rotation.w < 0.0 {
        -rotation
    } else {
        rotation
    };
    if rotation.x.abs().max(rotation.y.abs()).max(rotation.z.abs()) < 1e-9 {
        return Quat::IDENTITY;
    }
    rotation.as_quat().normalize()
}

/// The solids of a body as one shape. `axes`: frame → axes of the body.
fn shape(body: &ModelBody, axes: &Pose, report: &mut Report) -> Result<Shape, LoadError> {
    let mut parts = Vec::new();
    for placed in &body.solids {
        let subject = Subject {
            place: &body.place,
            name: &placed.name,
            fixed: body.fixed,
        };
        match placed.solid.shape(&axes.of(&placed.pose), &subject, report) {
            Some(Ok(placement)) => parts.push(placement),
            Some(Err(invalid)) => return Err(refused(&body.place, &placed.name, invalid)),
            None => {}
        }
    }
    if parts.len() > PARTS_MAX {
        return Err(LoadError {
            place: body.place.clone(),
            problem: Problem::TooMany {
                what: "shapes of a body",
                found: parts.len(),
                most: PARTS_MAX,
            },
        });
    }
    if let [Placement { pose, shape }] = parts.as_slice()
        && pose.position.length() < 1e-9
        && turn(pose.rotation) == Quat::IDENTITY
    {
        return Ok(shape.clone());
    }
    let part = |Placement { pose, shape }| Part {
        position: pose.position.as_vec3(),
        rotation: turn(pose.rotation),
        shape,
    };
    let compound = Compound::new(parts.into_iter().map(part).collect());
    let compound = compound.map_err(|invalid| refused(&body.place, &body.name, invalid))?;
    Ok(Shape::Compound(compound))
}

/// Mass and moments within their limits, with notes.
fn mass(body: &ModelBody, moments: DVec3, report: &mut Report) -> Mass {
    let mut note = |value: String, why| {
        let subject = format!("inertia of {}", body.name);
        report.add(&body.place, subject, value, Effect::Changed, why);
    };
    let own = body.inertia.mass;
    let mass = own.clamp(f64::from(MASS_MIN), f64::from(MASS_MAX));
    if mass != own {
        note(
            format!("{own} kg, now {mass} kg"),
            "a body has 0.001 kg to 1,000,000 kg",
        );
    }
    let least = mass * f64::from(GYRATION_MIN) * 1.000_001;
    let most = mass * f64::from(GYRATION_MAX) * 0.999_999;
    let within = moments.clamp(DVec3::splat(least), DVec3::splat(most));
    if within != moments {
        let value = format!("{moments} kg m², now {within} kg m²");
        note(
            value,
            "a moment of inertia is at least 1e-6 m² for each kilogram",
        );
    }
    let sum = within.element_sum();
    let triangle = within.min(DVec3::splat(sum) - within);
    if (within - triangle).max_element() > sum * 1e-6 {
        let value = format!("{within} kg m², now {triangle} kg m²");
        note(
            value,
            "no solid has a moment of inertia above the sum of the two others",
        );
    }
    Mass {
        mass: mass as f32,
        moments: Some(triangle.max(DVec3::splat(least)).as_vec3()),
    }
}

/// The inertias that a motor of a joint accelerates.
struct Effective {
    held: Inertia,
    frame: Pose,
}

impl Effective {
    /// kg or kg·m² of an axis.
    fn of(&self, axis: usize) -> f64 {
        let direction = self.frame.rotation * DVec3::AXES[axis % 3];
        let inertia = match axis < 3 {
            true => self.held.mass,
            false => self.held.about_axis(self.frame.position, direction),
        };
        inertia.max(1e-9)
    }
}

fn joint(
    joint: &ModelJoint,
    centres: [&Pose; 2],
    frame: &Pose,
    effective: &Effective,
    report: &mut Report,
) -> Result<LoadedJoint, LoadError> {
    let frame_in = |centre: &Pose, frame: &Pose| {
        let own = centre.inverse().of(frame);
        JointFrame {
            anchor: own.position.as_vec3(),
            rotation: turn(own.rotation),
        }
    };
    let frames = [
        frame_in(centres[0], frame),
        frame_in(centres[1], &frame.of(&joint.start)),
    ];
    let kind = bounded(joint, report);
    let mut made = Joint::plain(kind, [BodyId::new(0, 0); 2], frames);
    made.collide = joint.collide;
    let limits = kind.limits();
    for (axis, drive) in joint.drives.iter().enumerate() {
        if let Some(drive) = drive.filter(Drive::pushes) {
            let inertia = effective.of(axis);
            let drive = drive.of_inertia(inertia);
            let reach = reach(limits[axis], &drive, axis < 3);
            let motor = motor(&drive, reach, inertia, joint, report);
            let reach = match (axis < 3, limits[axis].is_some()) {
                (true, _) => f32::MAX,
                (false, true) => TAU,
                (false, false) => PI,
            };
            let position = motor.position.clamp(-reach, reach);
            made.motors[axis] = Some(Motor { position, ..motor });
        }
    }
    made.check()
        .map_err(|invalid| refused(&joint.place, &joint.name, invalid))?;
    Ok(LoadedJoint {
        name: joint.name.clone(),
        bodies: joint.bodies,
        joint: made,
    })
}

/// A joint that holds nothing and has the dry friction of axes whose motor is a spring or damping already.
fn brake(joint: &ModelJoint, loaded: &LoadedJoint) -> Option<LoadedJoint> {
    let kind = JointKind::Generic(LockedAxes::NONE, [None; 6]);
    let mut made = Joint::plain(kind, loaded.joint.bodies, loaded.joint.frames);
    made.collide = loaded.joint.collide;
    for (motor, drive) in made.motors.iter_mut().zip(&joint.drives) {
        let both = drive.filter(|drive| drive.friction > 0.0 && !drive.only_rubs());
        *motor = both.map(|drive| friction(&drive));
    }
    made.motors
        .iter()
        .any(Option::is_some)
        .then(|| LoadedJoint {
            name: format!("{} friction", loaded.name),
            bodies: loaded.bodies,
            joint: made,
        })
}

/// A brake that no force below the friction moves.
fn friction(drive: &Drive) -> Motor {
    let force = drive.friction.min(f64::from(FORCE_MAX)) as f32;
    Motor {
        force,
        ..Motor::with_velocity(0.0, FRICTION_RATE)
    }
}

/// Speed up to which damping grows, m/s or rad/s.
const DAMPED_SPEED: f64 = 10.0;

/// The farthest that an axis can be from the rest of its spring: metres or radians.
fn reach(limits: Option<JointLimits>, drive: &Drive, is_way: bool) -> f64 {
    let free = if is_way { 1.0 } else { f64::from(PI) };
    limits.map_or(free, |limits| {
        let ends = [limits.least, limits.most].map(|end| (f64::from(end) - drive.rest).abs());
        ends[0].max(ends[1])
    })
}

/// Springs, damping and friction of an axis as a motor. It pushes no more than they can: a motor that may push without bound
/// drives a chain of light bodies apart.
fn motor(
    drive: &Drive,
    reach: f64,
    inertia: f64,
    joint: &ModelJoint,
    report: &mut Report,
) -> Motor {
    let subject = || format!("joint \"{}\"", joint.name);
    let most = f64::from(STIFFNESS_MAX);
    if !drive.for_each_mass && (drive.damping > 0.0 || drive.stiffness > 0.0) {
        let why = "damping and stiffness of joints are forces there and accelerations here: \
            they are right for the pose of the start and a holding body that stands still, and grow up to 10 rad/s or m/s";
        report.again(
            &joint.place,
            "damping of joints".to_owned(),
            Effect::Approximated,
            why,
        );
    }
    if drive.only_rubs() {
        return friction(drive);
    }
    let rates = [drive.stiffness, drive.damping].map(|force| force / inertia);
    let [stiffness, damping] = rates.map(|rate| rate.clamp(0.0, most) as f32);
    if rates.iter().any(|rate| *rate > most) {
        let value = format!("{} and {} for 1 kg or kg m²", rates[0], rates[1]);
        let why = "stiffness and damping for the mass that they move are at most 1,000,000";
        report.add(&joint.place, subject(), value, Effect::Changed, why);
    }
    let passive = drive.stiffness * reach + drive.damping * DAMPED_SPEED;
    let most = drive.most.unwrap_or(passive);
    let force = most.min(f64::from(FORCE_MAX)) as f32;
    let velocity = drive.velocity as f32;
    let sprung = Motor::at_position(drive.rest as f32, stiffness, damping);
    Motor {
        velocity,
        force,
        ..sprung
    }
}

/// The rate at which dry friction stops an axis, 1/s: within a substep or two.
const FRICTION_RATE: f32 = 1_000.0;

/// The kind of a joint, with limits that a joint can have.
fn bounded(joint: &ModelJoint, report: &mut Report) -> JointKind {
    let mut limits_of = |limits: JointLimits| {
        let value = format!("{} to {} rad", limits.least, limits.most);
        let name = format!("joint \"{}\" limits", joint.name);
        let mut left =
            |why| report.add(&joint.place, name.clone(), value.clone(), Effect::Left, why);
        if limits.most - limits.least >= TAU {
            left("limits a whole turn apart or more hold nothing here: the joint turns freely");
            return None;
        }
        if limits.least < -TAU || limits.most > TAU {
            left("limits of a turn lie within two turns: the joint turns freely");
            return None;
        }
        if limits.least > 0.0 || limits.most < 0.0 {
            let why = "the file starts the joint outside its limits, which pull it in";
            report.add(
                &joint.place,
                name.clone(),
                value.clone(),
                Effect::Approximated,
                why,
            );
        }
        Some(limits)
    };
    match joint.kind {
        JointKind::Revolute(limits) => JointKind::Revolute(limits.and_then(&mut limits_of)),
        JointKind::Prismatic(limits) => JointKind::Prismatic(limits.and_then(within_extents)),
        JointKind::Generic(locked, mut limits) => {
            for (axis, limits) in limits.iter_mut().enumerate() {
                *limits = match axis < 3 {
                    true => limits.take().and_then(within_extents),
                    false => limits.take().and_then(&mut limits_of),
                };
            }
            JointKind::Generic(locked, limits)
        }
        kind => kind,
    }
}

/// Limits of a displacement, within the greatest extent; `None` for those that both lie beyond.
fn within_extents(limits: JointLimits) -> Option<JointLimits> {
    let is_bound = limits.least > -EXTENT_MAX || limits.most < EXTENT_MAX;
    is_bound.then(|| JointLimits {
        least: limits.least.clamp(-EXTENT_MAX, EXTENT_MAX),
        most: limits.most.clamp(-EXTENT_MAX, EXTENT_MAX),
    })
}
