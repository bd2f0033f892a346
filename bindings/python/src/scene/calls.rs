//! Calls of a scene that the methods of Python share.

use std::sync::TryLockError;

use numpy::IntoPyArray;
use pyo3::prelude::*;
use rhumb_bindings::rhumb_client::BodyId;
use rhumb_bindings::rhumb_client::glam::Vec3;
use rhumb_bindings::rhumb_client::scene::{Command, Locomotion};
use rhumb_bindings::{BindingError, Coordinates, RemoteScene};

use super::PyScene;
use crate::arguments::{Bodies, bodies, rows};
use crate::errors::exception;
use crate::locomotion::set;
use crate::open_scene::OpenScene;

impl PyScene {
    /// Calls with the scene. A second thread does not wait.
    pub(super) fn with<R>(
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

    pub(super) fn locked<R>(
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

    /// Queues a command for each body, made of its row of numbers.
    pub(super) fn push(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        numbers: &Bound<'_, PyAny>,
        name: &'static str,
        command: impl Fn(BodyId, Vec3) -> Command,
    ) -> PyResult<Option<u64>> {
        let Bodies { ids, .. } = bodies(body)?;
        let vectors = rows::<3>(numbers, ids.len(), name)?;
        let command = |(id, vector): (BodyId, [f32; 3])| command(id, vector.into());
        let commands = ids.into_iter().zip(vectors).map(command).collect();
        self.all(py, commands)
    }

    /// Queues commands.
    pub(super) fn all(&self, py: Python<'_>, commands: Vec<Command>) -> PyResult<Option<u64>> {
        self.with(py, |opened| opened.scene.command(commands))
    }

    /// Queues a command.
    pub(super) fn one(&self, py: Python<'_>, command: Command) -> PyResult<Option<u64>> {
        self.all(py, vec![command])
    }

    /// Queues a command for each body.
    pub(super) fn each(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        command: impl Fn(BodyId) -> Command,
    ) -> PyResult<Option<u64>> {
        let commands = bodies(body)?.ids.into_iter().map(command).collect();
        self.all(py, commands)
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

    /// Queues that each body gets a locomotion in the scene's coordinates.
    pub(super) fn moved(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        locomotion: impl FnOnce(Coordinates) -> Locomotion,
    ) -> PyResult<Option<u64>> {
        let ids = bodies(body)?.ids;
        self.with(py, |opened| {
            let locomotion = locomotion(opened.scene.coordinates());
            opened.scene.command(set(&ids, &locomotion))
        })
    }
}
