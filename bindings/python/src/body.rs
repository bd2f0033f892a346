//! Bodies to add: fields that all of a call share, and rows of their states.

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rhumb_bindings::BodyParams;
use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::rhumb_client::scene::{BodyKind, CollisionGroups, LockedAxes, Material};
use rhumb_bindings::rhumb_client::{Damping, ToleranceScale};

use crate::arguments::{one_of, optional_rows, points, sleep};
use crate::errors::wrong_value;
use crate::shape::PyShape;

const KINDS: [(&str, BodyKind); 3] = [
    ("dynamic", BodyKind::Dynamic),
    ("fixed", BodyKind::Fixed),
    ("kinematic", BodyKind::Kinematic),
];

/// A body at the origin with the fields of keywords.
pub(crate) fn plain_body(
    shape: &Bound<'_, PyShape>,
    kind: &str,
    keywords: Option<&Bound<'_, PyDict>>,
) -> PyResult<BodyParams> {
    let py = shape.py();
    let kind = one_of(py, &KINDS, kind, "kind")?;
    let mut body = BodyParams::new(kind, shape.get().shape.clone());
    let Some(keywords) = keywords else {
        return Ok(body);
    };
    for (key, value) in keywords {
        let key: String = key.extract()?;
        match key.as_str() {
            "mass" => body.mass = value.extract()?,
            "moments" => {
                let numbers: Option<(f32, f32, f32)> = value.extract()?;
                body.moments = numbers.map(Vec3::from);
            }
            "material" => {
                let numbers: Option<(f32, f32, f32)> = value.extract()?;
                body.material = numbers.map(|(friction, restitution, density)| Material {
                    friction,
                    restitution,
                    density,
                });
            }
            "damping" => {
                let numbers: Option<(f32, f32)> = value.extract()?;
                body.damping = numbers.map(|(linear, angular)| Damping { linear, angular });
            }
            "gravity_scale" => body.gravity_scale = value.extract()?,
            "locked_axes" => {
                let bits = value.extract()?;
                let needed = "six bits: 0 to 63";
                body.locked_axes = LockedAxes::new(bits)
                    .ok_or_else(|| wrong_value(py, "locked_axes", bits, needed))?;
            }
            "groups" => {
                let (members, touches) = value.extract()?;
                body.groups = CollisionGroups { members, touches };
            }
            "tolerance_exponent" => {
                let exponent = value.extract()?;
                body.tolerance_scale = ToleranceScale::new(exponent)
                    .ok_or_else(|| wrong_value(py, "tolerance_exponent", exponent, "-3 to 3"))?;
            }
            "sensor" => body.sensor = value.extract()?,
            "swept" => body.swept = value.extract()?,
            "gyroscopic" => body.gyroscopic = value.extract()?,
            "sleep" => body.sleep = sleep(&value)?,
            _ => {
                let text = format!("{key} is no keyword of a body");
                return Err(PyTypeError::new_err(text));
            }
        }
    }
    Ok(body)
}

/// A body like a plain one for each row of positions. Rotations and velocities, linear then angular, may be left out.
pub(crate) fn bodies_at(
    plain: &BodyParams,
    positions: &Bound<'_, PyAny>,
    rotations: Option<&Bound<'_, PyAny>>,
    [linear, angular]: [Option<&Bound<'_, PyAny>>; 2],
) -> PyResult<Vec<BodyParams>> {
    let positions = points(positions, "positions")?;
    let count = positions.len();
    let vectors = |argument, name| optional_rows(argument, count, name, [0.0; 3]);
    let linear = vectors(linear, "linear_velocities")?;
    let angular = vectors(angular, "angular_velocities")?;
    let turned = optional_rows(rotations, count, "rotations", [0.0, 0.0, 0.0, 1.0])?;
    let bodies = positions.into_iter().enumerate();
    let bodies = bodies.map(|(place, position)| BodyParams {
        position,
        rotation: Quat::from_array(turned[place]),
        linear_velocity: Vec3::from_array(linear[place]),
        angular_velocity: Vec3::from_array(angular[place]),
        ..plain.clone()
    });
    Ok(bodies.collect())
}
