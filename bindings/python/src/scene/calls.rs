//! Calls of a scene that the methods of Python share.

use std::sync::TryLockError;

use numpy::IntoPyArray;
use pyo3::prelude::*;
use rhumb_bindings::rhumb_client::BodyId;
use rhumb_bindings::rhumb_client::scene::Command;
use rhumb_bindings::{BindingError, Coordinates, RemoteScene};

use super::PyScene;
use crate::arguments::{Bodies, bodies};
use crate::errors::exception;
use crate::open_scene::OpenScene;

impl PyScene {
    /// Calls with the scene. A second thread does not wait.
    pub(crate) fn with<R>(
        &self,
        py: Python<'_>,
        call: impl FnOnce(&mut OpenScene) -> Result<R, BindingError>,
    ) -> PyResult<R> {
        self.locked(call).map_err(|error| exception(py, &error))
    }

    /// The same without the interpreter's lock, for a call that waits.
    pub(super) fn waiting<R: Send>(
        &self,
        py: Python<'_>,
        call: impl FnOnce(&mut OpenScene) -> Result<R, BindingError> + Send,
    ) -> PyResult<R> {
        let result = py.detach(|| self.locked(call));
        result.map_err(|error| exception(py, &error))
    }

    pub(crate) fn locked<R>(
        &self,
        call: impl FnOnce(&mut OpenScene) -> Result<R, BindingError>,
    ) -> Result<R, BindingError> {
        let mut opened = self.opened.try_lock().map_err(|error| match error {
            TryLockError::WouldBlock => BindingError::Busy,
            TryLockError::Poisoned(_) => {
                BindingError::Fault("an earlier call of this scene panicked".into())
            }
        })?;
        call(opened.as_mut().ok_or(BindingError::Closed)?)
    }

    /// Queues a command.
    pub(super) fn one(&self, py: Python<'_>, command: Command) -> PyResult<Option<u64>> {
        self.with(py, |opened| opened.scene.command(vec![command]))
    }

    /// Queues a command for each body of a row, which has its place in it.
    pub(super) fn each(
        &self,
        py: Python<'_>,
        ids: &[BodyId],
        command: impl Fn(BodyId, usize) -> Command,
    ) -> PyResult<Option<u64>> {
        let each = ids.iter().enumerate();
        let commands = each.map(|(place, id)| command(*id, place)).collect();
        self.with(py, |opened| opened.scene.command(commands))
    }

    /// Queues a command for each body, with a value in the scene's coordinates.
    pub(super) fn each_in(
        &self,
        py: Python<'_>,
        ids: &[BodyId],
        command: impl Fn(BodyId, Coordinates) -> Command,
    ) -> PyResult<Option<u64>> {
        self.with(py, |opened| {
            let coordinates = opened.scene.coordinates();
            let commands = ids.iter().map(|id| command(*id, coordinates));
            opened.scene.command(commands.collect())
        })
    }

    /// A bound of one body as a number, of a row of bodies as an array.
    pub(super) fn bounds(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        bound: impl Fn(&RemoteScene, BodyId) -> Result<f32, BindingError>,
    ) -> PyResult<Py<PyAny>> {
        let Bodies { ids, is_single } = bodies(body)?;
        let bounds = self.with(py, |opened| {
            let bounds = ids.iter().map(|id| bound(&opened.scene, *id));
            bounds.collect::<Result<Vec<_>, _>>()
        })?;
        match (is_single, bounds.as_slice()) {
            (true, [bound]) => Ok(bound.into_pyobject(py)?.into_any().unbind()),
            _ => Ok(bounds.into_pyarray(py).into_any().unbind()),
        }
    }
}
