//! Joints of MJCF: one, several in a body, springs and limits.
//!
//! Several joints of a body whose axes are at right angles and meet are one joint; others are a chain of light bodies
//! that share the mass of the one they hold.

use glam::{DMat3, DQuat, DVec3};
use rhumb_protocol::scene::{CollisionGroups, JointKind, JointLimits, LockedAxes};

use super::classes::{Compiler, truth};
use crate::inertia::{Pose, along_x};
use crate::model::{Drive, Model, ModelBody, ModelJoint};
use crate::report::{Effect, LoadError, Report};
use crate::xml::Element;

/// A hinge or slide as the file has it, or a ball.
#[derive(Clone, Debug)]
pub(crate) struct Hinge {
    pub(crate) element: Element,
    kind: Kind,
    /// In the file's world.
    anchor: DVec3,
    axis: DVec3,
    limits: Option<[f64; 2]>,
    drive: Drive,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Hinge,
    Slide,
    Ball,
    Free,
}

impl Hinge {
    /// Reads a joint, with its class's attributes, of a body that is here.
    pub(crate) fn read(
        element: Element,
        compiler: &Compiler,
        body: &Pose,
        report: &mut Report,
    ) -> Result<Self, LoadError> {
        let kind = match element.text("type") {
            _ if element.name == "freejoint" => Kind::Free,
            None | Some("hinge") => Kind::Hinge,
            Some("slide") => Kind::Slide,
            Some("ball") => Kind::Ball,
            Some("free") => Kind::Free,
            Some(_) => return Err(element.unknown_word("type")),
        };
        let along = element.vector("axis")?.unwrap_or(DVec3::Z);
        let unit = match kind {
            Kind::Hinge => compiler.angle,
            _ => 1.0,
        };
        let rest = element.number("ref")?.unwrap_or(0.0) * unit;
        let spring = element.number("springref")?.unwrap_or(0.0) * unit;
        let range = element.array::<2>("range", "2")?;
        let is_limited = truth(&element, "limited")?;
        let is_limited = is_limited.unwrap_or(compiler.autolimits && range.is_some());
        let limits = range.filter(|_| is_limited && kind != Kind::Free);
        // The start is at the reference, which counts as zero here.
        let limits = limits.map(|range| range.map(|limit| limit * unit - rest));
        let first = |name| -> Result<f64, LoadError> {
            let numbers = element.numbers(name)?.unwrap_or_default();
            Ok(numbers.first().copied().unwrap_or(0.0).max(0.0))
        };
        let drive = Drive {
            stiffness: first("stiffness")?,
            rest: spring - rest,
            damping: first("damping")?,
            friction: first("frictionloss")?,
            armature: first("armature")?,
            timed: element
                .array::<2>("springdamper", "2")?
                .filter(|[seconds, ratio]| *seconds > 0.0 && *ratio > 0.0),
            ..Drive::default()
        };
        note_settings(&element, kind, report);
        note_powers(&element, report)?;
        Ok(Self {
            kind,
            anchor: body.point(element.vector("pos")?.unwrap_or_default()),
            axis: body.rotation * along.try_normalize().unwrap_or(DVec3::Z),
            limits,
            drive: match drive.stiffness > 0.0 || drive.timed.is_some() {
                true => drive,
                false => Drive { rest: 0.0, ..drive },
            },
            element,
        })
    }

    pub(crate) fn is_free(&self) -> bool {
        self.kind == Kind::Free
    }

    fn name(&self) -> String {
        self.element.text("name").unwrap_or("joint").to_owned()
    }
}

/// Settings that a joint takes from the file, or that say nothing of physics.
const KNOWN: [&str; 16] = [
    "name",
    "class",
    "type",
    "pos",
    "axis",
    "range",
    "limited",
    "ref",
    "springref",
    "stiffness",
    "damping",
    "frictionloss",
    "armature",
    "springdamper",
    "group",
    "user",
];

/// Settings of joints, which a body without one cannot have.
const OF_JOINTS: [&str; 5] = [
    "stiffness",
    "damping",
    "frictionloss",
    "armature",
    "springdamper",
];

/// Notes settings that a joint has not.
fn note_settings(element: &Element, kind: Kind, report: &mut Report) {
    for (name, value) in &element.attributes {
        let is_zero = value
            .split_whitespace()
            .all(|part| part.parse::<f64>() == Ok(0.0));
        if kind == Kind::Free && OF_JOINTS.contains(&name.as_str()) && !is_zero {
            let why = "a body that moves freely has no joint here";
            report.again(&element.place(), format!("joint {name}"), Effect::Left, why);
        } else if !KNOWN.contains(&name.as_str()) {
            let why = "a joint has no such setting";
            report.again(&element.place(), format!("joint {name}"), Effect::Left, why);
        }
    }
}

/// Notes forces that grow with more than the first power.
fn note_powers(element: &Element, report: &mut Report) -> Result<(), LoadError> {
    for name in ["stiffness", "damping"] {
        let numbers = element.numbers(name)?.unwrap_or_default();
        if numbers.iter().skip(1).any(|number| *number != 0.0) {
            let why = "springs and damping of a scene grow with the first power alone";
            let subject = format!("joint {name} of higher powers");
            report.again(&element.place(), subject, Effect::Left, why);
        }
    }
    Ok(())
}

fn limits_of([least, most]: [f64; 2]) -> JointLimits {
    let (least, most) = (least.min(most) as f32, most.max(least) as f32);
    JointLimits { least, most }
}

/// Adds the joints between a body and the one that holds it.
pub(crate) fn connect(
    model: &mut Model,
    bodies: [usize; 2],
    hinges: &[Hinge],
    collide: bool,
    report: &mut Report,
) {
    match hinges {
        [] => {}
        [one] => {
            let joint = single(one, bodies, collide, report);
            model.joints.push(joint);
        }
        several => match together(several, bodies, collide, report) {
            Some(joint) => model.joints.push(joint),
            None => chain(model, bodies, several, collide, report),
        },
    }
}

fn single(one: &Hinge, bodies: [usize; 2], collide: bool, report: &mut Report) -> ModelJoint {
    let mut drives = [None; 6];
    let limits = one.limits.map(limits_of);
    let kind = match one.kind {
        Kind::Slide => {
            drives[0] = Some(one.drive);
            JointKind::Prismatic(limits)
        }
        Kind::Hinge => {
            drives[3] = Some(one.drive);
            JointKind::Revolute(limits)
        }
        Kind::Ball | Kind::Free => {
            if one.limits.is_some() {
                let why = "the limit of a ball joint is a cone there, and three ranges here";
                let place = one.element.place();
                report.add(
                    &place,
                    one.element.title(),
                    String::new(),
                    Effect::Left,
                    why,
                );
            }
            drives[3..].fill(Some(one.drive));
            JointKind::Spherical(None)
        }
    };
    ModelJoint {
        name: one.name(),
        place: one.element.place(),
        bodies,
        frame: Pose::new(one.anchor, along_x(one.axis)),
        start: Pose::IDENTITY,
        kind,
        drives,
        collide,
        holds: true,
    }
}

/// Axes and anchors closer than this are the same, metres and sines.
const NEAR: f64 = 1e-6;

/// Several joints as one, where their axes allow it.
fn together(
    hinges: &[Hinge],
    bodies: [usize; 2],
    collide: bool,
    report: &mut Report,
) -> Option<ModelJoint> {
    let first = hinges.first()?;
    if hinges
        .iter()
        .any(|one| matches!(one.kind, Kind::Ball | Kind::Free))
    {
        return None;
    }
    let turns: Vec<_> = hinges
        .iter()
        .filter(|one| one.kind == Kind::Hinge)
        .collect();
    let anchor = turns.first().map_or(first.anchor, |one| one.anchor);
    if turns
        .iter()
        .any(|one| (one.anchor - anchor).length() > NEAR)
    {
        return None;
    }
    let axes = axes(hinges)?;
    let mut locked = LockedAxes::EACH
        .into_iter()
        .fold(0, |all, one| all | one.bits());
    let (mut limits, mut drives) = ([None; 6], [None; 6]);
    for one in hinges {
        let along = (0..3).max_by(|a, b| {
            let fit = |axis: &usize| axes.col(*axis).dot(one.axis).abs();
            fit(a).total_cmp(&fit(b))
        })?;
        let place = along + if one.kind == Kind::Hinge { 3 } else { 0 };
        if locked & LockedAxes::EACH[place].bits() == 0 {
            return None;
        }
        locked &= !LockedAxes::EACH[place].bits();
        let sign = axes.col(along).dot(one.axis).signum();
        limits[place] = one
            .limits
            .map(|range| limits_of(range.map(|limit| limit * sign)));
        let rest = one.drive.rest * sign;
        drives[place] = Some(Drive { rest, ..one.drive });
    }
    if turns.len() > 1 {
        let why = "turns of one body about axes that meet are one joint, whose limits bound parts of the whole turn";
        let place = first.element.place();
        report.again(
            &place,
            "joints of one body".to_owned(),
            Effect::Approximated,
            why,
        );
    }
    Some(ModelJoint {
        name: first.name(),
        place: first.element.place(),
        bodies,
        frame: Pose::new(anchor, DQuat::from_mat3(&axes).normalize()),
        start: Pose::IDENTITY,
        kind: JointKind::Generic(LockedAxes::new(locked)?, limits),
        drives,
        collide,
        holds: true,
    })
}

/// Axes at right angles of which every joint's axis is one; `None` where there are none.
fn axes(hinges: &[Hinge]) -> Option<DMat3> {
    let x = hinges.first()?.axis;
    let is_across = |one: &&Hinge| one.axis.cross(x).length() > NEAR;
    let y = match hinges.iter().find(is_across) {
        Some(one) => one.axis,
        None => x.any_orthonormal_vector(),
    };
    if x.dot(y).abs() > NEAR {
        return None;
    }
    let axes = DMat3::from_cols(x, y, x.cross(y));
    let fits = |one: &Hinge| (0..3).any(|at| axes.col(at).cross(one.axis).length() <= NEAR);
    hinges.iter().all(fits).then_some(axes)
}

/// Share of a body's mass that each light body of a chain takes.
const CHAIN_SHARE: f64 = 0.1;

/// One joint after the other, with light bodies between them. Mass, centre and moments stay the same together.
fn chain(
    model: &mut Model,
    [holding, held]: [usize; 2],
    hinges: &[Hinge],
    collide: bool,
    report: &mut Report,
) {
    let own = model.bodies[held].clone();
    let share = own.inertia.times(CHAIN_SHARE);
    let rest = 1.0 - CHAIN_SHARE * (hinges.len() - 1) as f64;
    let whole = model.bodies.len() - 1;
    debug_assert_eq!(whole, held, "a body is joined when it is added");
    model.bodies.pop();
    let mut from = holding;
    let (last, between) = hinges.split_last().unwrap_or((&hinges[0], &[]));
    for one in between {
        let place = model.bodies.len();
        model.bodies.push(ModelBody {
            name: format!("{} before {}", own.name, one.name()),
            inertia: share,
            solids: Vec::new(),
            groups: CollisionGroups::ALL,
            friction: None,
            ..own.clone()
        });
        model
            .joints
            .push(single(one, [from, place], collide, report));
        from = place;
    }
    let place = model.bodies.len();
    let inertia = own.inertia.times(rest.max(CHAIN_SHARE));
    model.bodies.push(ModelBody { inertia, ..own });
    model
        .joints
        .push(single(last, [from, place], collide, report));
    let why = "joints of one body whose axes are not at right angles through one point are a chain: each light body of it has a tenth of the mass";
    let subject = "joints of one body".to_owned();
    report.again(&last.element.place(), subject, Effect::Approximated, why);
}
