//! Bodies to add: fields that all of a call share, and rows of their states.

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::rhumb_client::scene::{BodyKind, CollisionGroups, LockedAxes, Material};
use rhumb_bindings::rhumb_client::{Damping, ToleranceScale};
use rhumb_bindings::{BodyParams, StateRecord};

use crate::arguments::{bodies, one_of, optional_rows, points, rows, sleep};
use crate::errors::wrong_value;
use crate::number::{flag, real, reals, whole, within};
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
            "mass" => body.mass = optional(&value, "mass", real)?,
            "moments" => body.moments = optional(&value, "moments", reals)?.map(Vec3::from_array),
            "material" => {
                let numbers = optional(&value, "material", reals)?;
                body.material = numbers.map(|[friction, restitution, density]| Material {
                    friction,
                    restitution,
                    density,
                });
            }
            "damping" => {
                let numbers = optional(&value, "damping", reals)?;
                body.damping = numbers.map(|[linear, angular]| Damping { linear, angular });
            }
            "gravity_scale" => body.gravity_scale = real(&value, "gravity_scale")?,
            "locked_axes" => {
                let bits = whole::locked_axes(&value)?;
                let needed = "six bits: 0 to 63";
                body.locked_axes = LockedAxes::new(bits)
                    .ok_or_else(|| wrong_value(py, "locked_axes", bits, needed))?;
            }
            "groups" => {
                let needed = "two numbers of 32 bits: 0 to 4294967295";
                let (members, touches) = within(&value, "groups", value.extract(), needed)?;
                body.groups = CollisionGroups { members, touches };
            }
            "tolerance_exponent" => {
                let needed = "-3 to 3";
                let exponent = within(&value, "tolerance_exponent", value.extract(), needed)?;
                body.tolerance_scale = ToleranceScale::new(exponent)
                    .ok_or_else(|| wrong_value(py, "tolerance_exponent", exponent, needed))?;
            }
            "sensor" => body.sensor = flag(&value, "sensor")?,
            "swept" => body.swept = flag(&value, "swept")?,
            "gyroscopic" => body.gyroscopic = flag(&value, "gyroscopic")?,
            "sleep" => body.sleep = sleep(&value)?,
            _ => {
                let text = format!("{key} is no keyword of a body");
                return Err(PyTypeError::new_err(text));
            }
        }
    }
    Ok(body)
}

/// The value of a keyword that may be `None`.
fn optional<T>(
    value: &Bound<'_, PyAny>,
    name: &'static str,
    read: impl FnOnce(&Bound<'_, PyAny>, &'static str) -> PyResult<T>,
) -> PyResult<Option<T>> {
    match value.is_none() {
        true => Ok(None),
        false => read(value, name).map(Some),
    }
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

/// A state for each body: positions, and rotations, velocities and spins if there are any.
pub(crate) fn states(
    body: &Bound<'_, PyAny>,
    position: &Bound<'_, PyAny>,
    [rotation, linear, angular]: [Option<&Bound<'_, PyAny>>; 3],
) -> PyResult<Vec<StateRecord>> {
    let ids = bodies(body)?.ids;
    let count = ids.len();
    let at = rows::<3>(position, count, "position")?;
    let turned = optional_rows(rotation, count, "rotation", Quat::IDENTITY.to_array())?;
    let linear = optional_rows(linear, count, "linear", [0.0; 3])?;
    let angular = optional_rows(angular, count, "angular", [0.0; 3])?;
    let state = |(place, body)| StateRecord {
        body,
        position: Vec3::from_array(at[place]),
        rotation: Quat::from_array(turned[place]),
        linear_velocity: Vec3::from_array(linear[place]),
        angular_velocity: Vec3::from_array(angular[place]),
    };
    Ok(ids.into_iter().enumerate().map(state).collect())
}
