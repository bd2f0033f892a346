//! Masses and moments for bodies whose file gives none.
//!
//! An engine cannot carry a force through a body of no mass. What is given here is noted.

use glam::{DMat3, DVec3};
use rhumb_protocol::limits::{GYRATION_MIN, MASS_MIN};

use crate::inertia::{Inertia, Pose};
use crate::model::{ModelBody, ModelJoint};
use crate::report::{Effect, Report};

/// Gives every body that moves a mass and moments. `density`: of shapes, kg/m³.
pub(crate) fn settle(
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
pub(crate) fn scale(bodies: &mut [ModelBody], joints: &mut [ModelJoint], report: &mut Report) {
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
pub(crate) fn bound(bodies: &mut [ModelBody], [mass, moment]: [f64; 2], total: Option<f64>) {
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

/// Adds the rotors of joints to the moments of the bodies that turn with them. Then they resist the joint, as they should;
/// they also resist a turn of both bodies together, which is noted.
pub(crate) fn add_armatures(bodies: &mut [ModelBody], joints: &[ModelJoint], report: &mut Report) {
    for joint in joints.iter().filter(|joint| joint.holds) {
        let mut has_rotor = false;
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
            let body = &mut bodies[joint.bodies[1]];
            let along = joint.frame.rotation * DVec3::AXES[axis - 3];
            let along = body.pose.rotation.conjugate() * along;
            let rotor = DMat3::from_cols(along * along.x, along * along.y, along * along.z);
            body.inertia.tensor += rotor * armature;
            has_rotor = true;
            let why = "it is part of the moments of the body that the joint turns, whatever else turns that body";
            report.again(&joint.place, subject, Effect::Approximated, why);
        }
        let body = &mut bodies[joint.bodies[1]];
        if has_rotor && make_solid(&mut body.inertia) {
            let why =
                "no solid has a moment above the sum of the others: an armature raises those too";
            let subject = "moments with an armature".to_owned();
            report.again(&body.place, subject, Effect::Changed, why);
        }
    }
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
