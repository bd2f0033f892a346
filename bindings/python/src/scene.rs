//! Scenes: bodies, commands, time, arrays, events, queries.

use std::sync::{Mutex, TryLockError};

use numpy::{IntoPyArray, PyArray1, PyArrayDyn};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rhumb_bindings::rhumb_client::glam::Vec3;
use rhumb_bindings::rhumb_client::scene::{ActiveEvents, Command, JointId, Locomotion};
use rhumb_bindings::rhumb_client::{BodyId, PipelineDepth, Tick};
use rhumb_bindings::{BindingError, Coordinates, RemoteScene, body_word};

use crate::arguments::{Bodies, bodies, rows, seconds, single, vector};
use crate::body::{bodies_at, plain_body};
use crate::body_states::states;
use crate::commands::{jumps, set_poses, set_velocities};
use crate::errors::{exception, wrong};
use crate::event::PyEvent;
use crate::joint::PyJoint;
use crate::locomotion::{PyCharacter, PyWheel, PyWheelInput, set};
use crate::open_scene::OpenScene;
use crate::query::{PyHit, PyQuery};
use crate::shape::PyShape;
use crate::statistics::dictionary;
use crate::view_array::floats;

/// A client of one scene.
#[pyclass(frozen, name = "Scene", module = "rhumb")]
pub(crate) struct PyScene {
    /// `None` once it is closed.
    opened: Mutex<Option<OpenScene>>,
}

impl PyScene {
    pub(crate) const fn new(scene: RemoteScene) -> Self {
        Self {
            opened: Mutex::new(Some(OpenScene::new(scene))),
        }
    }

    /// Calls with the scene. A second thread does not wait.
    fn with<R>(
        &self,
        py: Python<'_>,
        call: impl FnOnce(&mut OpenScene) -> Result<R, BindingError>,
    ) -> PyResult<R> {
        self.locked(call).map_err(|error| exception(py, &error))
    }

    /// The same without the interpreter's lock, for a call that waits.
    fn waiting<R: Send>(
        &self,
        py: Python<'_>,
        call: impl FnOnce(&mut OpenScene) -> Result<R, BindingError> + Send,
    ) -> PyResult<R> {
        let result = py.detach(|| self.locked(call));
        result.map_err(|error| exception(py, &error))
    }

    fn locked<R>(
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
    fn push(
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
    fn all(&self, py: Python<'_>, commands: Vec<Command>) -> PyResult<Option<u64>> {
        self.with(py, |opened| opened.scene.command(commands))
    }

    /// Queues a command.
    fn one(&self, py: Python<'_>, command: Command) -> PyResult<Option<u64>> {
        self.all(py, vec![command])
    }

    /// Queues a command for each body.
    fn each(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        command: impl Fn(BodyId) -> Command,
    ) -> PyResult<Option<u64>> {
        let commands = bodies(body)?.ids.into_iter().map(command).collect();
        self.all(py, commands)
    }

    /// A bound of one body as a number, of a row of bodies as an array.
    fn bounds(
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
    fn moved(
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

#[pymethods]
impl PyScene {
    #[pyo3(signature = (
        shape, position = None, kind = "dynamic", *, rotation = None, linear_velocity = None,
        angular_velocity = None, **keywords,
    ))]
    // Named parameters are the interface of Python.
    #[expect(clippy::too_many_arguments)]
    fn add_body(
        &self,
        py: Python<'_>,
        shape: &Bound<'_, PyShape>,
        position: Option<&Bound<'_, PyAny>>,
        kind: &str,
        rotation: Option<&Bound<'_, PyAny>>,
        linear_velocity: Option<&Bound<'_, PyAny>>,
        angular_velocity: Option<&Bound<'_, PyAny>>,
        keywords: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<u64> {
        let mut body = plain_body(shape, kind, keywords)?;
        let vector = |argument: Option<&Bound<'_, PyAny>>, name| {
            argument.map_or(Ok(Vec3::ZERO), |argument| vector(argument, name))
        };
        body.position = vector(position, "position")?;
        body.linear_velocity = vector(linear_velocity, "linear_velocity")?;
        body.angular_velocity = vector(angular_velocity, "angular_velocity")?;
        if let Some(rotation) = rotation {
            body.rotation = crate::arguments::rotation(rotation, "rotation")?;
        }
        let ids = self.waiting(py, |opened| opened.scene.add_bodies(&[body]))?;
        let id = ids.first().copied();
        id.map(body_word)
            .ok_or_else(|| exception(py, &BindingError::Fault("no id for a body".into())))
    }

    #[pyo3(signature = (
        shape, positions, kind = "dynamic", *, rotations = None, linear_velocities = None,
        angular_velocities = None, **keywords,
    ))]
    // Named parameters are the interface of Python.
    #[expect(clippy::too_many_arguments)]
    fn add_bodies<'py>(
        &self,
        py: Python<'py>,
        shape: &Bound<'py, PyShape>,
        positions: &Bound<'py, PyAny>,
        kind: &str,
        rotations: Option<&Bound<'py, PyAny>>,
        linear_velocities: Option<&Bound<'py, PyAny>>,
        angular_velocities: Option<&Bound<'py, PyAny>>,
        keywords: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyArray1<u64>>> {
        let plain = plain_body(shape, kind, keywords)?;
        let velocities = [linear_velocities, angular_velocities];
        let all = bodies_at(&plain, positions, rotations, velocities)?;
        let ids = self.waiting(py, |opened| opened.scene.add_bodies(&all))?;
        let words: Vec<u64> = ids.into_iter().map(body_word).collect();
        Ok(words.into_pyarray(py))
    }

    fn remove(&self, py: Python<'_>, body: &Bound<'_, PyAny>) -> PyResult<Option<u64>> {
        self.each(py, body, |id| Command::RemoveBody { id })
    }

    #[pyo3(signature = (body, position, rotation = None))]
    fn set_pose(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        position: &Bound<'_, PyAny>,
        rotation: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Option<u64>> {
        self.all(py, set_poses(body, position, rotation)?)
    }

    #[pyo3(signature = (body, linear, angular = None))]
    fn set_velocity(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        linear: &Bound<'_, PyAny>,
        angular: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Option<u64>> {
        self.all(py, set_velocities(body, linear, angular)?)
    }

    #[pyo3(signature = (body, force, point = None))]
    fn apply_force(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        force: &Bound<'_, PyAny>,
        point: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Option<u64>> {
        let point = point.map(|point| vector(point, "point")).transpose()?;
        self.push(py, body, force, "force", |id, force| match point {
            Some(point) => Command::ForceAt { id, force, point },
            None => Command::Force { id, force },
        })
    }

    fn apply_torque(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        torque: &Bound<'_, PyAny>,
    ) -> PyResult<Option<u64>> {
        self.push(py, body, torque, "torque", |id, torque| Command::Torque {
            id,
            torque,
        })
    }

    #[pyo3(signature = (body, impulse, point = None))]
    fn apply_impulse(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        impulse: &Bound<'_, PyAny>,
        point: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Option<u64>> {
        let point = point.map(|point| vector(point, "point")).transpose()?;
        self.push(py, body, impulse, "impulse", |id, impulse| match point {
            Some(point) => Command::ImpulseAt { id, impulse, point },
            None => Command::Impulse { id, impulse },
        })
    }

    fn apply_torque_impulse(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        impulse: &Bound<'_, PyAny>,
    ) -> PyResult<Option<u64>> {
        self.push(py, body, impulse, "impulse", |id, impulse| {
            Command::TorqueImpulse { id, impulse }
        })
    }

    fn set_gravity(&self, py: Python<'_>, gravity: &Bound<'_, PyAny>) -> PyResult<Option<u64>> {
        let gravity = vector(gravity, "gravity")?;
        self.one(py, Command::SetGravity { gravity })
    }

    fn sleep(&self, py: Python<'_>, body: &Bound<'_, PyAny>) -> PyResult<Option<u64>> {
        self.each(py, body, |id| Command::Sleep { id })
    }

    fn wake(&self, py: Python<'_>, body: &Bound<'_, PyAny>) -> PyResult<Option<u64>> {
        self.each(py, body, |id| Command::Wake { id })
    }

    #[pyo3(signature = (body, *, contacts = false, force = None, sensors = false, sleep = false))]
    fn report_events(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        contacts: bool,
        force: Option<f32>,
        sensors: bool,
        sleep: bool,
    ) -> PyResult<Option<u64>> {
        let events = ActiveEvents {
            contacts,
            force,
            sensors,
            sleep,
        };
        self.each(py, body, |id| Command::SetEvents { id, events })
    }

    fn add_joint(
        &self,
        py: Python<'_>,
        id: u32,
        joint: &Bound<'_, PyJoint>,
    ) -> PyResult<Option<u64>> {
        self.one(py, joint.get().addition(id))
    }

    fn change_joint(
        &self,
        py: Python<'_>,
        id: u32,
        joint: &Bound<'_, PyJoint>,
    ) -> PyResult<Option<u64>> {
        self.one(py, joint.get().change(id))
    }

    fn remove_joint(&self, py: Python<'_>, id: u32) -> PyResult<Option<u64>> {
        self.one(py, Command::RemoveJoint { id: JointId(id) })
    }

    fn set_character(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        character: &Bound<'_, PyCharacter>,
    ) -> PyResult<Option<u64>> {
        self.moved(py, body, |coordinates| {
            character.get().locomotion(coordinates)
        })
    }

    fn set_vehicle(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        wheels: Vec<PyRef<'_, PyWheel>>,
    ) -> PyResult<Option<u64>> {
        self.moved(py, body, |coordinates| {
            PyWheel::locomotion(&wheels, coordinates)
        })
    }

    fn clear_locomotion(&self, py: Python<'_>, body: &Bound<'_, PyAny>) -> PyResult<Option<u64>> {
        self.moved(py, body, |_| Locomotion::None)
    }

    #[pyo3(signature = (body, speed, *, anywhere = false))]
    fn jump(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        speed: f32,
        anywhere: bool,
    ) -> PyResult<Option<u64>> {
        self.all(py, jumps(body, speed, anywhere)?)
    }

    fn set_wheels(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        inputs: Vec<PyRef<'_, PyWheelInput>>,
    ) -> PyResult<Option<u64>> {
        self.all(py, PyWheelInput::commands(&bodies(body)?.ids, &inputs))
    }

    #[pyo3(signature = (body, tolerance = 0.02))]
    fn take_authority(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        tolerance: f64,
    ) -> PyResult<()> {
        let ids = bodies(body)?.ids;
        self.with(py, |opened| opened.scene.take_authority(&ids, tolerance))
    }

    #[pyo3(signature = (body, position, rotation = None, linear = None, angular = None))]
    fn publish(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        position: &Bound<'_, PyAny>,
        rotation: Option<&Bound<'_, PyAny>>,
        linear: Option<&Bound<'_, PyAny>>,
        angular: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Option<u64>> {
        let states = states(body, position, [rotation, linear, angular])?;
        let tick = self.with(py, |opened| opened.scene.publish(&states))?;
        Ok(tick.map(Tick::value))
    }

    fn remove_unused_shapes(&self, py: Python<'_>) -> PyResult<usize> {
        self.with(py, |opened| opened.scene.remove_unused_shapes())
    }

    fn flush(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |opened| {
            opened.scene.flush();
            Ok(())
        })
    }

    #[pyo3(signature = (ticks = 1, depth = 0))]
    fn advance(&self, py: Python<'_>, ticks: u32, depth: u32) -> PyResult<u64> {
        if ticks == 0 {
            return Err(wrong(py, "ticks", "at least 1"));
        }
        let depth = PipelineDepth::new(depth);
        let mut shown = 0;
        for _ in 0..ticks {
            // Between two ticks, Python may raise what a signal asks for.
            py.check_signals()?;
            shown = self.waiting(py, |opened| {
                opened.expire();
                Ok(opened.scene.advance(depth)?.value())
            })?;
        }
        Ok(shown)
    }

    #[pyo3(signature = (depth = 0))]
    fn wait(&self, py: Python<'_>, depth: u32) -> PyResult<u64> {
        self.waiting(py, |opened| {
            opened.expire();
            Ok(opened.scene.wait(PipelineDepth::new(depth))?.value())
        })
    }

    fn poll(&self, py: Python<'_>) -> PyResult<(u64, f64)> {
        self.waiting(py, |opened| {
            opened.expire();
            let time = opened.scene.poll()?;
            Ok((time.tick.value(), time.fraction))
        })
    }

    fn idle(&self, py: Python<'_>, duration: f64) -> PyResult<()> {
        let duration = seconds(py, duration, "duration")?;
        self.waiting(py, |opened| opened.scene.idle(duration))
    }

    #[getter]
    fn time(&self, py: Python<'_>) -> PyResult<(u64, f64)> {
        self.with(py, |opened| {
            let time = opened.scene.time();
            Ok((time.tick.value(), time.fraction))
        })
    }

    #[getter]
    fn bodies<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<u64>>> {
        self.with(py, |opened| {
            Ok(opened.bodies.get(py, None, opened.scene.bodies()))
        })?
    }

    #[getter]
    fn positions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.with(py, |opened| {
            let values = floats(opened.scene.positions());
            Ok(opened.positions.get(py, Some(3), values))
        })?
    }

    #[getter]
    fn rotations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.with(py, |opened| {
            let values = floats(opened.scene.rotations());
            Ok(opened.rotations.get(py, Some(4), values))
        })?
    }

    #[getter]
    fn linear_velocities<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.with(py, |opened| {
            let values = floats(opened.scene.linear_velocities());
            Ok(opened.linear.get(py, Some(3), values))
        })?
    }

    #[getter]
    fn angular_velocities<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.with(py, |opened| {
            let values = floats(opened.scene.angular_velocities());
            Ok(opened.angular.get(py, Some(3), values))
        })?
    }

    #[getter]
    fn resting<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<bool>>> {
        self.with(py, |opened| {
            Ok(opened.resting.get(py, None, opened.scene.resting()))
        })?
    }

    #[getter]
    fn changed<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<u32>>> {
        self.with(py, |opened| {
            Ok(opened.changed.get(py, None, opened.scene.changed()))
        })?
    }

    #[getter]
    fn removed<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<u64>>> {
        self.with(py, |opened| {
            Ok(opened.removed.get(py, None, opened.scene.removed()))
        })?
    }

    fn place(&self, py: Python<'_>, body: &Bound<'_, PyAny>) -> PyResult<usize> {
        let id = single(body)?;
        self.with(py, |opened| opened.scene.place(id))
    }

    fn __contains__(&self, py: Python<'_>, body: &Bound<'_, PyAny>) -> PyResult<bool> {
        let id = single(body)?;
        self.with(py, |opened| Ok(opened.scene.place(id).is_ok()))
    }

    fn places<'py>(
        &self,
        py: Python<'py>,
        body: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray1<usize>>> {
        let ids = bodies(body)?.ids;
        let places = self.with(py, |opened| {
            let places = ids.iter().map(|id| opened.scene.place(*id));
            places.collect::<Result<Vec<_>, _>>()
        })?;
        Ok(places.into_pyarray(py))
    }

    fn error_bound(&self, py: Python<'_>, body: &Bound<'_, PyAny>) -> PyResult<Py<PyAny>> {
        self.bounds(py, body, RemoteScene::error_bound)
    }

    #[getter]
    fn error_bounds<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f32>>> {
        self.with(py, |opened| Ok(opened.scene.error_bounds().to_vec()))
            .map(|bounds| bounds.into_pyarray(py))
    }

    fn tick_error_bound(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        tick: u64,
    ) -> PyResult<Py<PyAny>> {
        let tick = Tick::new(tick);
        self.bounds(py, body, |scene, id| scene.tick_error_bound(id, tick))
    }

    fn set_lead_ticks(&self, py: Python<'_>, ticks: f64) -> PyResult<()> {
        self.with(py, |opened| opened.scene.set_lead_ticks(ticks))
    }

    fn events(&self, py: Python<'_>) -> PyResult<Vec<PyEvent>> {
        self.with(py, |opened| {
            let events = std::iter::from_fn(|| opened.scene.poll_event());
            Ok(events.map(PyEvent::new).collect())
        })
    }

    fn query(
        &self,
        py: Python<'_>,
        queries: Vec<PyRef<'_, PyQuery>>,
    ) -> PyResult<(u64, Vec<Vec<PyHit>>)> {
        let queries: Vec<_> = queries.iter().map(|query| query.query.clone()).collect();
        let count = queries.len();
        let (tick, records) = self.waiting(py, |opened| opened.scene.query(queries))?;
        Ok((tick.value(), PyHit::of_each(count, &records)))
    }

    #[getter]
    fn statistics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let now = self.with(py, |opened| Ok(opened.scene.statistics()))?;
        dictionary(py, &now)
    }

    fn delete(&self, py: Python<'_>) -> PyResult<()> {
        self.waiting(py, |opened| opened.scene.delete())
    }

    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let opened = match self.opened.try_lock() {
            Ok(mut opened) => opened.take(),
            // Half of a change may be there, and is only dropped.
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner().take(),
            Err(TryLockError::WouldBlock) => return Err(exception(py, &BindingError::Busy)),
        };
        if let Some(OpenScene { scene, .. }) = opened {
            py.detach(|| scene.close());
        }
        Ok(())
    }

    #[getter]
    fn closed(&self) -> bool {
        // A scene that is in use by another thread is open.
        (self.opened.try_lock()).is_ok_and(|opened| opened.is_none())
    }

    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        self.with(py, |opened| Ok(opened.scene.count()))
    }

    const fn __enter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    #[pyo3(signature = (*_error))]
    fn __exit__(&self, py: Python<'_>, _error: &Bound<'_, PyAny>) -> PyResult<()> {
        self.close(py)
    }
}
