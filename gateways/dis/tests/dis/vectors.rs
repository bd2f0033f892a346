//! The dead-reckoning models against reference values of 50 digits.
//!
//! `data/dis_drm.json` says its conventions. They were computed by a matrix exponential and an integrator, none of them
//! this crate's. Displacements are compared, since a geocentric position has steps of a nanometre.

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

use glam::{DMat3, DQuat, DVec3};
use rhumb_dis::dead_reckoning::{Euler, Model, Motion, reckon};
use serde_json::Value;

const VECTORS: &str = include_str!("../data/dis_drm.json");

fn numbers<const N: usize>(value: &Value) -> [f64; N] {
    let list = value.as_array().expect("a list of numbers");
    let numbers: Vec<f64> = list.iter().filter_map(Value::as_f64).collect();
    numbers.try_into().expect("the list has its length")
}

fn vector(value: &Value) -> DVec3 {
    DVec3::from(numbers::<3>(value))
}

/// In the file the scalar part comes first.
fn quaternion(value: &Value) -> DQuat {
    let [w, x, y, z] = numbers(value);
    DQuat::from_xyzw(x, y, z, w)
}

/// Distance of two unit quaternions up to their sign.
fn apart(a: DQuat, b: DQuat) -> f64 {
    (a - b).length().min((a + b).length())
}

fn within(what: &str, off: f64, limit: f64) -> Result<(), String> {
    if off <= limit {
        Ok(())
    } else {
        Err(format!("{what} is off by {off:e}, {limit:e} at most"))
    }
}

fn check(case: &Value) -> Result<(), String> {
    let [psi, theta, phi] = numbers(&case["euler0"]);
    let orientation = Euler { psi, theta, phi }.to_quaternion();
    let number = case["drm"]
        .as_u64()
        .and_then(|number| u8::try_from(number).ok());
    let model = number.and_then(Model::of).ok_or("no model")?;
    let motion = Motion {
        velocity: vector(&case["v0"]),
        acceleration: vector(&case["a0"]),
        orientation,
        spin: vector(&case["omega"]),
    };
    let found = reckon(model, &motion, case["dt"].as_f64().ok_or("no time")?);
    let expect = &case["expect"];
    let start = apart(orientation, quaternion(&case["quat0"]));
    within("the first rotation", start, 1e-13)?;
    let displacement = vector(&expect["dp"]);
    let limit = 1e-11 * (1.0 + displacement.length());
    let off = (found.displacement - displacement).length();
    within("the displacement", off, limit)?;
    let position = vector(&case["p0"]) + found.displacement;
    let expected = vector(&expect["p"]);
    let ulps = 2.0 * f64::EPSILON * expected.length();
    within("the position", (position - expected).length(), limit + ulps)?;
    let velocity = vector(&expect["v"]);
    let limit = 1e-12 * (1.0 + velocity.length());
    within("the velocity", (found.velocity - velocity).length(), limit)?;
    check_rotation(found.orientation, expect)
}

fn check_rotation(found: DQuat, expect: &Value) -> Result<(), String> {
    let off = apart(found, quaternion(&expect["quat"]));
    within("the rotation", off, 1e-13)?;
    let rows = expect["R_w2b"].as_array().ok_or("no matrix")?;
    let [a, b, c] = [0, 1, 2].map(|row| vector(&rows[row]));
    // Rows of world → entity are columns of entity → world.
    let matrix = DMat3::from_quat(found) - DMat3::from_cols(a, b, c);
    let off = matrix.to_cols_array().map(f64::abs);
    within("the matrix", off.into_iter().fold(0.0, f64::max), 1e-12)?;
    let angles = Euler::from_quaternion(found);
    let off = apart(angles.to_quaternion(), found);
    within("the rotation of the angles", off, 1e-13)?;
    if expect["euler_well_conditioned"].as_bool() == Some(true) {
        let found = [angles.psi, angles.theta, angles.phi];
        let pairs = found.into_iter().zip(numbers::<3>(&expect["euler"]));
        let turns = pairs.map(|(a, b)| ((a - b + PI).rem_euclid(TAU) - PI).abs());
        within("an angle", turns.fold(0.0, f64::max), 1e-9)?;
    }
    Ok(())
}

#[test]
fn all_models_agree_with_values_of_fifty_digits() {
    let file: Value = serde_json::from_str(VECTORS).expect("the file is JSON");
    let cases = file["cases"].as_array().expect("the file has cases");
    let mut count = BTreeMap::<u64, usize>::new();
    let mut failures = Vec::new();
    for case in cases {
        *count
            .entry(case["drm"].as_u64().unwrap_or_default())
            .or_default() += 1;
        if let Err(error) = check(case) {
            failures.push(format!(
                "{} {} {}: {error}",
                case["id"], case["name"], case["label"]
            ));
        }
    }
    assert!(
        failures.is_empty(),
        "{} of {} fail:\n{}",
        failures.len(),
        cases.len(),
        failures.join("\n")
    );
    assert!(
        (1..=9).all(|model| count.get(&model).is_some_and(|cases| *cases >= 12)),
        "{count:?}"
    );
}
