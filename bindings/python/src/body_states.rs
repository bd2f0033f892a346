//! States of bodies that the application moves, of rows of numbers.

use pyo3::prelude::*;
use rhumb_bindings::StateRecord;
use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};

use crate::arguments::{bodies, optional_rows, rows};

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
