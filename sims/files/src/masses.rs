//! Masses and moments for bodies whose file gives none.
//!
//! An engine cannot carry a force through a body of no mass. What is given here is noted.

use glam::{DMat3, DVec3};

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
    if own.mass > 0.0 && own.tensor != DMat3::ZERO {
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
