//! Cases of sine and cosine, and of the quaternions of turns.
//!
//! Every quadrant, the limit of the angle, turns of no angle. The functions are no part of the interface: their file is
//! compiled in.

use glam::{DQuat, DVec3};

use self::exact::{turn_about, turn_by};
use crate::document::CaseJson;

#[expect(dead_code, reason = "the cases need only some of it")]
#[path = "../../../src/exact.rs"]
mod exact;

/// The whole section.
pub(super) fn turns() -> Vec<CaseJson> {
    let (mut cases, most) = (Vec::new(), 1.0e6_f64);
    let quarter = core::f64::consts::FRAC_PI_2;
    let mut angles = vec![
        0.0,
        0.5,
        1.0,
        3.0,
        1e-8,
        f64::MIN_POSITIVE,
        most,
        most.next_down(),
        most.next_up(),
        999_999.5,
        1e300,
        f64::INFINITY,
    ];
    for quarters in 1..=8 {
        let angle = f64::from(quarters) * quarter;
        angles.extend([angle, angle.next_up(), angle + 0.3]);
        // Halfway between two quarters the other one is the nearest.
        let half = angle - quarter / 2.0;
        angles.extend([half.next_down(), half, half.next_up()]);
    }
    for angle in angles {
        // Of an axis of length one, sine and cosine.
        cases.push(about(DVec3::X, 1.0, angle));
        cases.push(about(DVec3::X, 1.0, -angle));
    }
    cases.push(about(DVec3::X, 1.0, f64::NAN));
    let axis = DVec3::new(1.5, -0.25, 0.7);
    cases.push(about(axis, axis.length(), 0.7));
    cases.push(about(axis, 3.0, -1.9));
    let tiny = DVec3::new(1e-170, 0.0, -1e-170);
    for vector in [
        DVec3::ZERO,
        -DVec3::ZERO,
        // The squares are zero, and so is the length.
        tiny,
        DVec3::new(0.0, 1e-150, 0.0),
        DVec3::new(0.1, 0.2, -0.3),
        DVec3::new(0.0, -3.0, 0.0),
        DVec3::new(2.0e6, 0.0, 0.0),
        DVec3::new(0.0, 0.0, -2_000_000.5),
    ] {
        let case = CaseJson::new().doubles("vector", &vector.to_array());
        cases.push(rotation(case, turn_by(vector)));
    }
    cases
}

fn about(axis: DVec3, length: f64, half_angle: f64) -> CaseJson {
    let case = CaseJson::new()
        .doubles("axis", &axis.to_array())
        .doubles("length", &[length])
        .doubles("half_angle", &[half_angle]);
    rotation(case, turn_about(axis, length, half_angle))
}

fn rotation(case: CaseJson, rotation: DQuat) -> CaseJson {
    case.doubles("rotation", &rotation.to_array())
}
