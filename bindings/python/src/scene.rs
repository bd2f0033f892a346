//! Scenes: bodies, commands, time, arrays, events, queries.
//!
//! The methods here are written by hand; those of most commands are made by `bindings/table`, in `generated`.

use std::path::PathBuf;
use std::sync::{Mutex, TryLockError};

use numpy::{IntoPyArray, PyArray1, PyArrayDyn};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rhumb_bindings::rhumb_client::glam::Vec3;
use rhumb_bindings::rhumb_client::scene::{Command, JointId};
use rhumb_bindings::rhumb_client::{BodyId, PipelineDepth, Tick};
use rhumb_bindings::{BindingError, Coordinates, RemoteScene, packed_id};

use crate::answers::{PyContact, PyEvent, PyHit, PyQuery, PyRequest};
use crate::arguments::{Bodies, bodies, optional_tick, seconds, single, vector};
use crate::body::{GivenStates, PyJoint, PyShape, bodies_at, plain_body, states};
use crate::errors::{exception, wrong_value};
use crate::file::{PyCheckpoint, PyLoaded, params};
use crate::number;
use crate::open_scene::{OpenScene, dictionary, floats};

/// A client of one scene. It leaves the scene at the end of a with block.
///
/// It has no constructor: rhumb.connect(address, fingerprint=...).join(name), rhumb.local() and rhumb.serve() return one.
///
/// Bodies have ids, which add_body and add_bodies return. Every call that takes a body takes a row of ids too, with one row
/// of numbers for all of them or one for each. The poses of all bodies are arrays of one order; place finds a body in them.
///
/// Lengths are in the unit of the scene's coordinates, and so are forces and torques: N and N m, and in Unreal's coordinates
/// kg cm/s² and kg cm²/s². Impulses are those times a second. Limits are stated in SI units.
///
/// Commands are queued, and sent together by the next call that waits, or by flush. Each returns its number, which events
/// and refusals name; for a row of bodies, the number of the last. What is wrong at once raises InvalidError, and nothing is
/// queued. What the server refuses raises RefusedError at the next advance, wait or poll.
///
/// One thread at a time may be inside a call; a second one raises BusyError at once. len() is the number of bodies of the
/// view, and "body in scene" tells whether it has one.
#[pyclass(frozen, name = "Scene", module = "rhumb")]
pub(crate) struct PyScene {
    name: String,
    /// `None` once it is closed.
    opened: Mutex<Option<OpenScene>>,
}

impl PyScene {
    pub(crate) const fn new(name: String, scene: RemoteScene) -> Self {
        Self {
            name,
            opened: Mutex::new(Some(OpenScene::new(scene))),
        }
    }

    /// Calls with the scene. A second thread does not wait.
    pub(crate) fn with<R>(
        &self,
        py: Python<'_>,
        call: impl FnOnce(&mut OpenScene) -> Result<R, BindingError>,
    ) -> PyResult<R> {
        self.locked(call).map_err(|error| exception(py, &error))
    }

    /// The same without the interpreter's lock, for a call that waits.
    pub(crate) fn waiting<R: Send>(
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
    pub(crate) fn one(&self, py: Python<'_>, command: Command) -> PyResult<Option<u64>> {
        self.with(py, |opened| opened.scene.command(vec![command]))
    }

    /// Queues a command for each body of a row, which has its place in it.
    pub(crate) fn each(
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
    pub(crate) fn each_in(
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
    pub(crate) fn bounds(
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

#[pymethods]
impl PyScene {
    /// Adds a body, and returns its id: an int, for place and every call that takes a body.
    ///
    /// position: the origin of its shape, which is its centre of mass but for hulls and compounds; rotation: a unit quaternion
    /// x, y, z, w, body to world; linear_velocity: units of length per second; angular_velocity: rad/s about world axes.
    ///
    /// shape: a Shape. kind: "dynamic" (the engine moves it), "fixed" (nothing does), or "kinematic" (commands do).
    /// mass: kilograms; None: volume times density. moments: of inertia about its own axes, kg m², beside a mass; None:
    /// those of its shape. material: friction, restitution from 0 to 1, and density in kg/m³; None: the scene's.
    /// damping: linear and angular, 1/s; None: the scene's. gravity_scale: factor on the scene's gravity.
    /// locked_axes: bits 1, 2, 4 for translations along x, y, z, bits 8, 16, 32 for rotations about them, in the world.
    /// groups: bits of its own collision groups, and of those that it touches. sensor: bodies pass through it, and events
    /// report them. swept: it does not pass through moving bodies however fast it is.
    /// tolerance_exponent: power of two on the tolerance of its copies, -3 to 3. gyroscopic: its axis of spin wanders if its
    /// moments differ, as in physics. sleep: "settled", once it is slow and neither gravity nor a motor moves it; "never"; or
    /// a speed of its fastest point, rad/s, and the seconds for which it must be as slow; None: as the scene has it.
    #[pyo3(
        signature = (
            shape, position = None, kind = "dynamic", *, rotation = None, linear_velocity = None,
            angular_velocity = None, **keywords,
        ),
        text_signature = "($self, shape, position=None, kind='dynamic', *, rotation=None, linear_velocity=None, \
            angular_velocity=None, mass=None, moments=None, material=None, damping=None, gravity_scale=1.0, \
            locked_axes=0, groups=(4294967295, 4294967295), tolerance_exponent=0, sensor=False, swept=False, \
            gyroscopic=True, sleep=None)"
    )]
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
        id.map(packed_id)
            .ok_or_else(|| exception(py, &BindingError::Fault("no id for a body".into())))
    }

    /// Adds a body of one shape for each row of positions, and returns their ids. If one is wrong, none is added.
    ///
    /// rotations, linear_velocities and angular_velocities have one row for all or one for each. All else holds for all:
    ///
    /// shape: a Shape. kind: "dynamic" (the engine moves it), "fixed" (nothing does), or "kinematic" (commands do).
    /// mass: kilograms; None: volume times density. moments: of inertia about its own axes, kg m², beside a mass; None:
    /// those of its shape. material: friction, restitution from 0 to 1, and density in kg/m³; None: the scene's.
    /// damping: linear and angular, 1/s; None: the scene's. gravity_scale: factor on the scene's gravity.
    /// locked_axes: bits 1, 2, 4 for translations along x, y, z, bits 8, 16, 32 for rotations about them, in the world.
    /// groups: bits of its own collision groups, and of those that it touches. sensor: bodies pass through it, and events
    /// report them. swept: it does not pass through moving bodies however fast it is.
    /// tolerance_exponent: power of two on the tolerance of its copies, -3 to 3. gyroscopic: its axis of spin wanders if its
    /// moments differ, as in physics. sleep: "settled", once it is slow and neither gravity nor a motor moves it; "never"; or
    /// a speed of its fastest point, rad/s, and the seconds for which it must be as slow; None: as the scene has it.
    #[pyo3(
        signature = (
            shape, positions, kind = "dynamic", *, rotations = None, linear_velocities = None,
            angular_velocities = None, **keywords,
        ),
        text_signature = "($self, shape, positions, kind='dynamic', *, rotations=None, linear_velocities=None, \
            angular_velocities=None, mass=None, moments=None, material=None, damping=None, gravity_scale=1.0, \
            locked_axes=0, groups=(4294967295, 4294967295), tolerance_exponent=0, sensor=False, swept=False, \
            gyroscopic=True, sleep=None)"
    )]
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
        let words: Vec<u64> = ids.into_iter().map(packed_id).collect();
        Ok(words.into_pyarray(py))
    }

    /// Adds a joint under a number of yours, below 65,536, that no joint of the scene has.
    fn add_joint(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = number::whole::id)] id: u32,
        joint: &Bound<'_, PyJoint>,
    ) -> PyResult<Option<u64>> {
        self.one(py, joint.get().addition(id))
    }

    /// Replaces a joint, its limits and motors among others.
    fn change_joint(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = number::whole::id)] id: u32,
        joint: &Bound<'_, PyJoint>,
    ) -> PyResult<Option<u64>> {
        self.one(py, joint.get().change(id))
    }

    /// Removes a joint. It goes with either of its bodies too.
    fn remove_joint(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = number::whole::id)] id: u32,
    ) -> PyResult<Option<u64>> {
        self.one(py, Command::RemoveJoint { id: JointId(id) })
    }

    /// Requests authority over kinematic bodies in place of those of now; an empty row ends it.
    ///
    /// One client has authority over 256 bodies at most. The server's bodies are within the tolerance, in metres, of what
    /// publish sends; the tolerance of a stream adds to it: a client that follows within 0.05 m sees a body that is
    /// published within 0.02 m within 0.07 m of the publisher's.
    ///
    /// It is sent at once. An event, "authority granted" or "authority denied", answers; a denial raises RefusedError too. A
    /// second request before the answer raises InvalidError. For a member by cells, the grant of a body waits until a cell that
    /// it takes has had the body.
    #[pyo3(signature = (body, tolerance = 0.02))]
    fn take_authority(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        #[pyo3(from_py_with = number::double::tolerance)] tolerance: f64,
    ) -> PyResult<()> {
        let ids = bodies(body)?.ids;
        self.with(py, |opened| opened.scene.take_authority(&ids, tolerance))
    }

    /// Publishes the states of all bodies under this client's authority, once per frame; returns their tick.
    ///
    /// Give the states of now. In a lockstep scene their tick is the one that the next advance makes. In a free-running scene
    /// it is the tick nearest to now by the server's clock, plus lead_ticks; positions are moved to it by their velocities, by
    /// half a tick at most.
    ///
    /// None, and nothing is published, before the authority is granted, before the server's clock is known, and for a
    /// second frame of one tick. A body that is left out stands still.
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

    /// Hands over the states of one tick of a scene whose engine is in this program, has it step, and returns the tick.
    ///
    /// The scene is one of local(fed=True), serve(fed=True) or LocalServer.connect(feed=name). Call it once for each step of the
    /// engine, with the bodies in any order. A body that is left out rests where it is, and so does one that is fed at one pose
    /// without a velocity for five ticks; resting bodies cost nothing.
    ///
    /// tick: that of the states, from 1 on; None: the next one. Up to 600 ticks may be left out: the bodies then go evenly from
    /// one state to the next. rotation: None for bodies that are not turned, whatever they were before. Without linear and angular,
    /// velocities follow from the poses, as for an engine whose own are of no use.
    ///
    /// Followers see every pose within their tolerance. How many bytes that takes depends on gravity and substeps of join, and on
    /// mass, moments, damping and gravity_scale of add_body.
    ///
    /// It raises RefusedError, after it has handed the states over, for what the scene refused since the last call: commands of
    /// this program, and requests that it accepted.
    #[pyo3(signature = (body, position, rotation = None, linear = None, angular = None, *, tick = None))]
    // Named parameters are the interface of Python.
    #[expect(clippy::too_many_arguments)]
    fn feed(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        position: &Bound<'_, PyAny>,
        rotation: Option<&Bound<'_, PyAny>>,
        linear: Option<&Bound<'_, PyAny>>,
        angular: Option<&Bound<'_, PyAny>>,
        #[pyo3(from_py_with = optional_tick)] tick: Option<u64>,
    ) -> PyResult<u64> {
        let states = GivenStates::of(body, position, [rotation, linear, angular])?;
        let states = states.arrays();
        let tick = tick.map(Tick::new);
        self.waiting(py, |opened| Ok(opened.scene.feed(tick, &states)?.value()))
    }

    /// The unread requests of other members of a scene that this program feeds, the oldest first.
    ///
    /// Each is a command that a member gave. One that moves a body is answered by what is fed. One that adds, changes or removes
    /// something changes the scene once it is accepted: a body that is asked for has an id already, and is fed from then on.
    fn requests(&self, py: Python<'_>) -> PyResult<Vec<PyRequest>> {
        self.with(py, |opened| {
            let requests = std::iter::from_fn(|| opened.scene.poll_request());
            Ok(requests.map(PyRequest::new).collect())
        })
    }

    /// Changes the scene as another member asked. A request has one answer: Error for a second one.
    ///
    /// If the scene cannot, or the member has left, the member is refused after all, and the next feed raises RefusedError.
    fn accept(&self, py: Python<'_>, request: &Bound<'_, PyRequest>) -> PyResult<()> {
        let record = &request.get().record;
        self.waiting(py, |opened| opened.scene.accept_request(record))
    }

    /// Refuses what another member asked for: it learns of it as of any refusal.
    fn refuse(&self, py: Python<'_>, request: &Bound<'_, PyRequest>) -> PyResult<()> {
        let record = &request.get().record;
        self.waiting(py, |opened| opened.scene.refuse_request(record))
    }

    /// Queues the removal of the shapes that came with this client's bodies and that no body has, and returns their number.
    ///
    /// Queued additions, changes and removals of bodies count. A scene keeps its shapes until they are removed.
    fn remove_unused_shapes(&self, py: Python<'_>) -> PyResult<usize> {
        self.with(py, |opened| opened.scene.remove_unused_shapes())
    }

    /// Sends the queued commands at once.
    fn flush(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |opened| {
            opened.scene.flush();
            Ok(())
        })
    }

    /// Steps a lockstep scene by some ticks, computes the view, and returns its tick.
    ///
    /// At depth 1, the view is one tick behind, and the server computes the newest one meanwhile. A greater depth, up to
    /// 64, hides a link whose round trip is longer than a tick. It raises RefusedError
    /// for what the server refused, once and after all of the ticks; the next call continues.
    #[pyo3(signature = (ticks = 1, depth = 0))]
    fn advance(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = number::whole::ticks)] ticks: u32,
        #[pyo3(from_py_with = number::whole::depth)] depth: u32,
    ) -> PyResult<u64> {
        if ticks == 0 {
            return Err(wrong_value(py, "ticks", ticks, "at least 1"));
        }
        let depth = PipelineDepth::new(depth);
        let mut shown = 0;
        let mut refused = None;
        for _ in 0..ticks {
            // Between two ticks, Python may raise what a signal asks for.
            let advanced = py.check_signals().and_then(|()| {
                self.waiting(py, |opened| {
                    opened.expire();
                    opened.scene.advance_through(depth, &mut refused)
                })
            });
            shown = advanced.inspect_err(|error| {
                if let Some(refused) = &refused {
                    error.set_cause(py, Some(exception(py, refused)));
                }
            })?;
        }
        match refused {
            None => Ok(shown),
            Some(refused) => Err(exception(py, &refused)),
        }
    }

    /// Waits again for the tick of an advance that timed out.
    #[pyo3(signature = (depth = 0))]
    fn wait(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = number::whole::depth)] depth: u32,
    ) -> PyResult<u64> {
        self.waiting(py, |opened| {
            opened.expire();
            Ok(opened.scene.wait(PipelineDepth::new(depth))?.value())
        })
    }

    /// Computes the view of a free-running scene for now: its tick, and the part of the step to the next.
    ///
    /// It does not wait. A lockstep scene stands still until a client advances it. It raises RefusedError as advance does.
    fn poll(&self, py: Python<'_>) -> PyResult<(u64, f64)> {
        self.waiting(py, |opened| {
            opened.expire();
            let time = opened.scene.poll()?;
            Ok((time.tick.value(), time.fraction))
        })
    }

    /// Handles what arrives for a time in seconds, without computing the view.
    fn idle(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = number::double::duration)] duration: f64,
    ) -> PyResult<()> {
        let duration = seconds(py, duration, "duration")?;
        self.waiting(py, |opened| opened.scene.idle(duration))
    }

    /// The moment of the view.
    #[getter]
    fn time(&self, py: Python<'_>) -> PyResult<(u64, f64)> {
        self.with(py, |opened| {
            let time = opened.scene.time();
            Ok((time.tick.value(), time.fraction))
        })
    }

    /// Ids of the bodies of the view. All arrays have this order, which changes from view to view.
    #[getter]
    fn bodies<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<u64>>> {
        self.with(py, |opened| {
            Ok(opened.bodies.get(py, None, opened.scene.bodies()))
        })?
    }

    /// Rows of x, y, z: the centre of mass, or the origin of a hull or compound added here. They stay those of their view.
    #[getter]
    fn positions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.with(py, |opened| {
            let values = floats(opened.scene.positions());
            Ok(opened.positions.get(py, Some(3), values))
        })?
    }

    /// A row of x, y, z, w for each body: body to world.
    #[getter]
    fn rotations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.with(py, |opened| {
            let values = floats(opened.scene.rotations());
            Ok(opened.rotations.get(py, Some(4), values))
        })?
    }

    /// Velocities of the centres of mass, a row for each body, units of length per second; zero at rest.
    #[getter]
    fn linear_velocities<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.with(py, |opened| {
            let values = floats(opened.scene.linear_velocities());
            Ok(opened.linear.get(py, Some(3), values))
        })?
    }

    /// Spins, a row for each body, rad/s about world axes; zero at rest.
    #[getter]
    fn angular_velocities<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.with(py, |opened| {
            let values = floats(opened.scene.angular_velocities());
            Ok(opened.angular.get(py, Some(3), values))
        })?
    }

    /// True for each body that rests: its pose stays until it wakes.
    #[getter]
    fn resting<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<bool>>> {
        self.with(py, |opened| {
            Ok(opened.resting.get(py, None, opened.scene.resting()))
        })?
    }

    /// Places of the bodies whose pose differs from that of the last view.
    #[getter]
    fn changed<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<u32>>> {
        self.with(py, |opened| {
            Ok(opened.changed.get(py, None, opened.scene.changed()))
        })?
    }

    /// Bodies of the last view that are not in this one: removed, or in no cell that is taken.
    #[getter]
    fn removed<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<u64>>> {
        self.with(py, |opened| {
            Ok(opened.removed.get(py, None, opened.scene.removed()))
        })?
    }

    /// Place of a body in the arrays: scene.positions[scene.place(body)].
    ///
    /// None for a body that is still to come or has gone; the arrays refuse None as a place, with an IndexError. Raises
    /// NotInViewError, a KeyError, for a body that this client never knew. "body in scene" asks whether the view has it.
    fn place(&self, py: Python<'_>, body: &Bound<'_, PyAny>) -> PyResult<Option<usize>> {
        let id = single(body)?;
        self.with(py, |opened| match opened.scene.place(id) {
            Err(BindingError::NotInView(_)) if opened.scene.knows(id) => Ok(None),
            place => place.map(Some),
        })
    }

    fn __contains__(&self, py: Python<'_>, body: &Bound<'_, PyAny>) -> PyResult<bool> {
        let id = single(body)?;
        self.with(py, |opened| Ok(opened.scene.has(id)))
    }

    /// Places of many bodies, which must all be in the view: scene.positions[scene.places(bodies)].
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

    /// How far any point of a body, as the view shows it, may be from its true place at the moment of the view.
    ///
    /// In the scene's unit of length; an array for a row of bodies. Infinite while nothing finite is known: a packet is
    /// missing, or a free-running view shows a moment of which the news has not arrived. Give join delay_ticks of the
    /// network's delay and a little more for a finite one.
    fn error_bound(&self, py: Python<'_>, body: &Bound<'_, PyAny>) -> PyResult<Py<PyAny>> {
        self.bounds(py, body, RemoteScene::error_bound)
    }

    /// The error_bound of every body of the view, in the order of the arrays.
    #[getter]
    fn error_bounds<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.with(py, |opened| {
            opened.bounds.expire();
            let values = opened.scene.error_bounds();
            Ok(opened.bounds.get(py, None, values))
        })?
    }

    /// How far any point of a body may be off at a tick by what is known of it, whatever the view shows.
    fn tick_error_bound(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        #[pyo3(from_py_with = number::whole::tick)] tick: u64,
    ) -> PyResult<Py<PyAny>> {
        let tick = Tick::new(tick);
        self.bounds(py, body, |scene, id| scene.tick_error_bound(id, tick))
    }

    /// Sets lead_ticks of join anew: by how many ticks publish is ahead of the server's clock.
    fn set_lead_ticks(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = number::double::ticks)] ticks: f64,
    ) -> PyResult<()> {
        self.with(py, |opened| opened.scene.set_lead_ticks(ticks))
    }

    /// The contacts of now: of one body, or of all bodies.
    ///
    /// It knows the bodies that touch where one of the two reports contacts: call report_events(body, contacts=True) when
    /// you add them. With force=0.0 beside it, point, normal and force are those of the newest tick in which the two were
    /// awake; otherwise those of the beginning. Where more than 1,024 pairs report forces, they take turns: tick tells. A
    /// member that joins later knows those that touch already, too. Query.contacts
    /// asks the server about any body. Raises InvalidError for a body that this client never knew.
    #[pyo3(signature = (body = None))]
    fn contacts(
        &self,
        py: Python<'_>,
        body: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Vec<PyContact>> {
        let id = body.map(single).transpose()?;
        let contacts = self.with(py, |opened| opened.scene.contacts(id))?;
        Ok(contacts.iter().map(PyContact::new).collect())
    }

    /// All events since the last call, the oldest first. They tell what became of commands, and what bodies did.
    ///
    /// At most 65,536 unread ones are kept: statistics["events_left_out"] counts those that were dropped, the oldest first.
    fn events(&self, py: Python<'_>) -> PyResult<Vec<PyEvent>> {
        self.with(py, |opened| {
            let events = std::iter::from_fn(|| opened.scene.poll_event());
            Ok(events.map(PyEvent::new).collect())
        })
    }

    /// Asks the server, and waits: the tick whose scene was asked, and what each query found.
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

    /// Counts since the client connected: sent_bytes and received_bytes in UDP datagrams, updates of bodies, complete_tick
    /// (the newest one at which every copy is within its tolerance), behind_ticks (of the view behind the server's clock;
    /// None before it is known), updates, packets and bytes of the upstream since authority was granted, events_left_out
    /// (dropped unread, beyond 65,536) and contacts_left_out (pairs that touch and that contacts lacks, beyond 32,768).
    #[getter]
    fn statistics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let now = self.with(py, |opened| Ok(opened.scene.statistics()))?;
        dictionary(py, &now)
    }

    /// Deletes the scene for all of its clients.
    fn delete(&self, py: Python<'_>) -> PyResult<()> {
        self.waiting(py, |opened| opened.scene.delete())
    }

    /// Adds a robot or a scene from a file: URDF, MJCF with their meshes, glTF, or Rhumb's JSON.
    ///
    /// Loaded.left_out lists what the file says and a scene has not, with file and line. A file that cannot be read
    /// raises InvalidError, and nothing is added. Gravity and ticks are the scene's: rhumb.load makes a scene with the file's.
    ///
    /// position, rotation: where the file's world, or a robot's root, begins; what is up in the file is up in the scene.
    /// base: whether the root of a robot moves: "fixed", "free", or as the file has it. own_contacts: whether parts of a
    /// robot touch each other: "all" that no joint connects, or as other programs read the file. packages: folders that are
    /// searched for package:// names, before those above the file. density: kg/m³ of bodies with shapes and no mass.
    /// group: the collision group, below 32, of a robot's parts. first_joint: number of the first joint; None: the least
    /// that are free.
    #[pyo3(
        signature = (file, position = None, **keywords),
        text_signature = "($self, file, position=None, *, rotation=None, base='file', own_contacts='file', packages=(), \
            density=1000.0, group=1, first_joint=None)"
    )]
    fn load(
        &self,
        py: Python<'_>,
        file: PathBuf,
        position: Option<&Bound<'_, PyAny>>,
        keywords: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<PyLoaded> {
        let params = params(py, position, keywords)?;
        let path = file.to_string_lossy();
        let loaded = self.waiting(py, |opened| opened.scene.load(&path, &params));
        loaded.map(PyLoaded)
    }

    /// Address and fingerprint of the server, by which other processes connect; None unless serve made the scene.
    #[getter]
    fn address(&self, py: Python<'_>) -> PyResult<Option<String>> {
        self.with(py, |opened| Ok(opened.scene.address()))
    }

    /// The address of the page that shows this scene to browsers of this machine, until the scene is closed.
    ///
    /// Queued commands are sent first. The server must be in this process: serve, local or LocalServer. While a browser shows a
    /// scene of local, the scene's server is looked at between calls too, so that one that runs free moves on.
    fn page(&self, py: Python<'_>) -> PyResult<String> {
        self.waiting(py, |opened| opened.scene.page())
    }

    /// The whole state of the scene, with everything that this client has sent: bodies, joints, sleep, contacts, and the
    /// engine's own memory of them. Scenes that restore makes of it run to the same bits, given the same commands before the
    /// same ticks. A fork of a scene is rhumb.restore(scene.save()).
    ///
    /// The server must be in this process: of serve, local or LocalServer.
    fn save(&self, py: Python<'_>) -> PyResult<PyCheckpoint> {
        self.waiting(py, |opened| opened.scene.save())
            .map(PyCheckpoint)
    }

    /// Leaves the scene. A second time does nothing.
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

    /// True once it is closed.
    #[getter]
    fn closed(&self) -> bool {
        // A scene that is in use by another thread is open.
        (self.opened.try_lock()).is_ok_and(|opened| opened.is_none())
    }

    fn __repr__(&self) -> String {
        let name = &self.name;
        let Ok(opened) = self.opened.try_lock() else {
            return format!("<rhumb.Scene {name:?}, in use by another thread>");
        };
        let Some(opened) = opened.as_ref() else {
            return format!("<rhumb.Scene {name:?}, closed>");
        };
        let (tick, count) = (opened.scene.time().tick.value(), opened.scene.count());
        format!("<rhumb.Scene {name:?}, tick {tick}, {count} bodies>")
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
