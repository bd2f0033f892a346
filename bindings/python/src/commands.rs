//! Commands of rows of bodies, with rows of numbers.

use pyo3::prelude::*;
use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::rhumb_client::scene::{Command, JumpFrom};

use crate::arguments::{bodies, optional_rows, rows};

/// A pose for each body; an identity where there is no rotation.
pub(crate) fn set_poses(
    body: &Bound<'_, PyAny>,
    position: &Bound<'_, PyAny>,
    rotation: Option<&Bound<'_, PyAny>>,
) -> PyResult<Vec<Command>> {
    let ids = bodies(body)?.ids;
    let at = rows::<3>(position, ids.len(), "position")?;
    let identity = Quat::IDENTITY.to_array();
    let turned = optional_rows(rotation, ids.len(), "rotation", identity)?;
    let set = |(place, id)| Command::SetPose {
        id,
        position: Vec3::from_array(at[place]),
        rotation: Quat::from_array(turned[place]),
    };
    Ok(ids.into_iter().enumerate().map(set).collect())
}

/// Velocities for each body; no spin where there is none.
pub(crate) fn set_velocities(
    body: &Bound<'_, PyAny>,
    linear: &Bound<'_, PyAny>,
    angular: Option<&Bound<'_, PyAny>>,
) -> PyResult<Vec<Command>> {
    let ids = bodies(body)?.ids;
    let linear = rows::<3>(linear, ids.len(), "linear")?;
    let angular = optional_rows(angular, ids.len(), "angular", [0.0; 3])?;
    let set = |(place, id)| Command::SetVelocity {
        id,
        linear: Vec3::from_array(linear[place]),
        angular: Vec3::from_array(angular[place]),
    };
    Ok(ids.into_iter().enumerate().map(set).collect())
}

/// A jump of each character, in the air too if it may begin anywhere.
pub(crate) fn jumps(body: &Bound<'_, PyAny>, speed: f32, anywhere: bool) -> PyResult<Vec<Command>> {
    let from = match anywhere {
        true => JumpFrom::Anywhere,
        false => JumpFrom::Ground,
    };
    let jump = |id| Command::Jump { id, speed, from };
    Ok(bodies(body)?.ids.into_iter().map(jump).collect())
}
