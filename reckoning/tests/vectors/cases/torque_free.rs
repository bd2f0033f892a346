//! Cases of moments of inertia, and of torque-free rotation.

use rhumb_reckoning::{BodyState, Conditions, Inertia, Predictor, Ticks};

use super::flight::{
    GRAVITIES, accelerations, body_state, given_starts, gravity, tables, with_predictor,
};
use super::rng::thirteen;
use crate::document::CaseJson;

/// Moments, and the quaternion principal axes → body.
fn given() -> Vec<([f32; 3], [f32; 4])> {
    let own = Inertia::OWN_AXES;
    let askew = [0.182_57, 0.365_15, 0.547_72, 0.730_3];
    let (least, most) = (f32::MIN_POSITIVE, f32::MAX);
    vec![
        // A slab, a rod, a plate; equal moments; a hull with axes of its own; a needle at the edge of the accepted
        // range.
        ([1.0, 2.0, 2.9], own),
        ([0.7, 0.1, 0.7], own),
        ([1.0, 1.0, 2.0], [0.5, -0.5, 0.5, 0.5]),
        ([3.0, 3.0, 3.0], own),
        ([412.7, 395.1, 601.3], askew),
        ([1.0, 1.0 / 16_777_216.0, 1.0], own),
        ([least, least * 2.0, least * 3.0], own),
        ([most, most / 3.0, most / 2.0], [0.0, 0.0, 0.0, 1.000_999]),
        // Equal up to rounding, and just not.
        ([1.0, 1.0 + 8.0 * f32::EPSILON, 1.0], own),
        ([1.0, 1.0 + 9.0 * f32::EPSILON, 1.0], own),
        // Refused: zero, negative, subnormal, infinite, too far apart, not of unit length.
        ([1.0, 0.0, 1.0], own),
        ([1.0, 1.0, -1.0], own),
        ([least / 2.0, least, least], own),
        ([1.0, f32::INFINITY, 1.0], own),
        ([1.0, 5.9e-8, 1.0], own),
        ([1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 1.002]),
        ([1.0, 2.0, 3.0], [0.0; 4]),
    ]
}

pub(super) fn inertias() -> Vec<CaseJson> {
    let case = |(moments, frame): ([f32; 3], [f32; 4])| {
        let case = CaseJson::new()
            .singles("moments", &moments)
            .singles("frame", &frame);
        match Inertia::new(moments, frame) {
            Ok(inertia) => case.integer("equal", inertia.is_isotropic()),
            Err(_) => case.nothing("equal"),
        }
    };
    // The greatest difference of equal moments, exactly.
    let edge = ([1.0, 1.0 - 8.0 * f32::EPSILON, 1.0], Inertia::OWN_AXES);
    given().into_iter().chain([edge]).map(case).collect()
}

/// Every start with every inertia, over the edges of time and common times.
pub(super) fn torque_free_rotations() -> Vec<CaseJson> {
    let tables = tables();
    let starts: Vec<BodyState> = given_starts().iter().filter_map(body_state).collect();
    let taken: Vec<Inertia> = given()
        .into_iter()
        .filter_map(|(moments, frame)| Inertia::new(moments, frame).ok())
        .collect();
    let mut cases = Vec::new();
    for (start, motion) in starts.iter().enumerate() {
        for (inertia, moments) in taken.iter().enumerate() {
            let number = start * taken.len() + inertia;
            let elapsed = match number % 9 {
                0 => 0,
                1 => 1,
                2 => 1_024,
                other => (other * other * 17) as u32 % 350,
            };
            let (table, pull) = (number * 7 % tables.len(), number % GRAVITIES.len());
            let acceleration = accelerations()[number % accelerations().len()];
            let predictors = [Predictor::TorqueFree, Predictor::BallisticTorqueFree];
            let predictor = match number % 5 {
                4 => Predictor::Accelerated(acceleration),
                other => predictors[other % 2],
            };
            let conditions = Conditions {
                gravity: gravity(GRAVITIES[pull]),
                flow: &tables[table],
                inertia: Some(moments),
            };
            let end = predictor.predict(&motion.motion(), Ticks::new(elapsed), &conditions);
            cases.push(
                with_predictor(CaseJson::new(), predictor)
                    .integer("integrator", table as i64)
                    .integer("initial_state", start as i64)
                    .integer("gravity", pull as i64)
                    .integer("inertia", inertia as i64)
                    .integer("elapsed", elapsed)
                    .doubles("end", &thirteen(&end)),
            );
        }
    }
    cases
}
