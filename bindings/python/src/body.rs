//! Fields that all bodies of a call share, as keywords of Python.

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rhumb_bindings::BodyParams;
use rhumb_bindings::rhumb_client::scene::{BodyKind, CollisionGroups, LockedAxes, Material};
use rhumb_bindings::rhumb_client::{Damping, ToleranceScale};

use crate::arguments::one_of;
use crate::errors::wrong;
use crate::shape::PyShape;

const KINDS: [(&str, BodyKind); 3] = [
    ("dynamic", BodyKind::Dynamic),
    ("fixed", BodyKind::Static),
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
                let locked = LockedAxes::new(value.extract()?);
                body.locked_axes = locked.ok_or_else(|| wrong(py, "locked_axes", "six bits"))?;
            }
            "groups" => {
                let (members, touches) = value.extract()?;
                body.groups = CollisionGroups { members, touches };
            }
            "tolerance_exponent" => {
                let scale = ToleranceScale::new(value.extract()?);
                body.tolerance_scale =
                    scale.ok_or_else(|| wrong(py, "tolerance_exponent", "-3 to 3"))?;
            }
            "sensor" => body.sensor = value.extract()?,
            "swept" => body.swept = value.extract()?,
            _ => {
                let text = format!("{key} is no keyword of a body");
                return Err(PyTypeError::new_err(text));
            }
        }
    }
    Ok(body)
}
