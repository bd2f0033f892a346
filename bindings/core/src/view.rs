//! A view as its application has it: as arrays, or as objects of an engine.
//!
//! In Rhumb's own coordinates, no array is copied. In others, an array is converted when it is first read in a frame.
//!
//! [`SceneFollower`] serves an engine with an object for each body. Invariant: each body of the view that the objects show
//! has its object there, also one that the application destroyed.

use std::collections::HashMap;
use std::time::Duration;

use glam::{Quat, Vec3};
use rhumb_client::scene::Stepping;
use rhumb_client::{
    BodyCentres, BodyId, Client, ClientError, PipelineDepth, RefusedRequests, View,
};

use crate::coordinates::Coordinates;
use crate::descriptions::StateRecord;
use crate::records::packed_id;

/// An array that is computed once in a frame, when it is first read.
#[derive(Debug)]
struct Lazy<T> {
    values: Vec<T>,
    is_current: bool,
}

impl<T> Default for Lazy<T> {
    fn default() -> Self {
        Self {
            values: Vec::new(),
            is_current: false,
        }
    }
}

impl<T> Lazy<T> {
    fn get(&mut self, values: impl Iterator<Item = T>) -> &[T] {
        if !self.is_current {
            self.values.clear();
            self.values.extend(values);
            self.is_current = true;
        }
        &self.values
    }
}

/// The arrays of the last view.
#[derive(Debug, Default)]
pub(crate) struct ConvertedView {
    coordinates: Coordinates,
    bodies: Lazy<u64>,
    changed: Lazy<u32>,
    removed: Lazy<u64>,
    positions: Lazy<Vec3>,
    rotations: Lazy<Quat>,
    linear: Lazy<Vec3>,
    angular: Lazy<Vec3>,
}

impl ConvertedView {
    pub(crate) fn new(coordinates: Coordinates) -> Self {
        Self {
            coordinates,
            ..Self::default()
        }
    }

    pub(crate) const fn coordinates(&self) -> Coordinates {
        self.coordinates
    }

    /// Tells that the view was computed anew.
    pub(crate) const fn expire(&mut self) {
        self.bodies.is_current = false;
        self.changed.is_current = false;
        self.removed.is_current = false;
        self.positions.is_current = false;
        self.rotations.is_current = false;
        self.linear.is_current = false;
        self.angular.is_current = false;
    }

    pub(crate) fn bodies(&mut self, view: &View) -> &[u64] {
        self.bodies.get(view.ids().iter().map(|id| packed_id(*id)))
    }

    pub(crate) fn changed(&mut self, view: &View) -> &[u32] {
        self.changed.get(view.changed().map(|place| place as u32))
    }

    pub(crate) fn removed(&mut self, view: &View) -> &[u64] {
        self.removed
            .get(view.removed().iter().map(|id| packed_id(*id)))
    }

    pub(crate) fn positions<'a>(&'a mut self, view: &'a View, centres: &BodyCentres) -> &'a [Vec3] {
        let coordinates = self.coordinates;
        let values = view.positions();
        if centres.is_empty() {
            return match coordinates {
                Coordinates::Rhumb => values,
                _ => (self.positions).get(values.iter().map(|v| coordinates.vector_out(*v))),
            };
        }
        let bodies = view.ids().iter().zip(values).zip(view.rotations());
        let origins = bodies.map(|((id, position), rotation)| {
            coordinates.vector_out(centres.position_out(*id, *position, *rotation))
        });
        self.positions.get(origins)
    }

    pub(crate) fn rotations<'a>(&'a mut self, view: &'a View) -> &'a [Quat] {
        let coordinates = self.coordinates;
        let values = view.rotations();
        match coordinates {
            Coordinates::Rhumb => values,
            _ => (self.rotations).get(values.iter().map(|q| coordinates.rotation_out(*q))),
        }
    }

    pub(crate) fn linear<'a>(&'a mut self, view: &'a View) -> &'a [Vec3] {
        let coordinates = self.coordinates;
        let values = view.linear_velocities();
        match coordinates {
            Coordinates::Rhumb => values,
            _ => (self.linear).get(values.iter().map(|v| coordinates.vector_out(*v))),
        }
    }

    pub(crate) fn angular<'a>(&'a mut self, view: &'a View) -> &'a [Vec3] {
        let coordinates = self.coordinates;
        let values = view.angular_velocities();
        match coordinates {
            Coordinates::Rhumb => values,
            _ => (self.angular).get(values.iter().map(|v| coordinates.angular_out(*v))),
        }
    }
}

/// The objects of an engine that stand for the bodies of a scene.
///
/// `O` is the engine's handle of an object.
#[derive(Debug)]
pub struct SceneFollower<O> {
    coordinates: Coordinates,
    stepping: Stepping,
    fixed_step: Duration,
    /// By body, once the view has it.
    objects: HashMap<BodyId, O>,
    /// Objects of the application for bodies that the view does not have yet.
    reserved: HashMap<BodyId, O>,
    /// Refreshes of the view that the objects show; `None` before the first one.
    shown: Option<u64>,
    /// True while the requested tick of a lockstep scene is not shown.
    is_waiting: bool,
    late_steps: u64,
    /// Refusals of the last advance.
    refused: Option<RefusedRequests>,
    is_ended: bool,
}

/// A change of the objects, which the view asks for.
#[derive(Debug, PartialEq)]
pub enum ObjectChange<O> {
    /// A body has this state.
    Show(StateRecord),
    /// An object stands for no body any more.
    Destroy(O),
}

impl<O> SceneFollower<O> {
    /// Follows the scene that a client has joined. Nothing is shown yet.
    #[must_use]
    pub fn new(client: &Client, coordinates: Coordinates) -> Self {
        let config = client.config();
        let interval = config.publish_schedule.publish_interval.get();
        let seconds = config.integrator.rate.step().seconds() * f64::from(interval);
        Self {
            coordinates,
            stepping: config.stepping,
            fixed_step: Duration::from_secs_f64(seconds),
            objects: HashMap::new(),
            reserved: HashMap::new(),
            shown: None,
            is_waiting: false,
            late_steps: 0,
            refused: None,
            is_ended: false,
        }
    }

    /// Steps by a member, or by the server's clock.
    #[must_use]
    pub const fn stepping(&self) -> Stepping {
        self.stepping
    }

    /// Simulated time from one step of a lockstep client to the next.
    #[must_use]
    pub const fn fixed_step(&self) -> Duration {
        self.fixed_step
    }

    /// Steps at which the requested tick of a lockstep scene was not there yet. Its bodies then stood still.
    #[must_use]
    pub const fn late_steps(&self) -> u64 {
        self.late_steps
    }

    /// True before the first view is shown.
    #[must_use]
    pub const fn is_new(&self) -> bool {
        self.shown.is_none()
    }

    /// True after [`Self::end`].
    #[must_use]
    pub const fn is_ended(&self) -> bool {
        self.is_ended
    }

    /// Notes that the scene has ended.
    pub const fn end(&mut self) {
        self.is_ended = true;
    }

    /// The object of a body; `None` until the body is shown.
    #[must_use]
    pub fn object(&self, id: BodyId) -> Option<&O> {
        self.objects.get(&id)
    }

    /// All bodies that are shown, in the order of their ids, and their objects.
    #[must_use]
    pub fn objects(&self) -> Vec<(BodyId, &O)> {
        let mut objects: Vec<_> = self
            .objects
            .iter()
            .map(|(id, object)| (*id, object))
            .collect();
        objects.sort_unstable_by_key(|(id, _)| *id);
        objects
    }

    /// Sets the object of a body that is shown from now on.
    pub fn set_object(&mut self, id: BodyId, object: O) {
        self.objects.insert(id, object);
    }

    /// Reserves an object of the application for a body that the view does not have yet.
    pub fn reserve(&mut self, id: BodyId, object: O) {
        self.reserved.insert(id, object);
    }

    /// The object that the application has for a body, if any.
    pub fn take_reserved(&mut self, id: BodyId) -> Option<O> {
        self.reserved.remove(&id)
    }

    /// Computes the view of the present, or of the next step, and returns whether there is a new view.
    ///
    /// A free-running scene is computed for the present moment. A lockstep scene is stepped once; it waits only at depth 0,
    /// and only once for a tick that is late.
    ///
    /// # Errors
    ///
    /// As [`Client::poll`], [`Client::request_tick`] and [`Client::wait`]; but what the server refused is kept for
    /// [`Self::take_refused`], for the view is computed all the same.
    pub fn advance(
        &mut self,
        client: &mut Client,
        depth: PipelineDepth,
    ) -> Result<bool, ClientError> {
        let refreshes = client.view().refreshes();
        match self.advance_once(client, depth) {
            Err(ClientError::Refused(refused)) => {
                self.refused = Some(refused);
                let is_shown = client.view().refreshes() != refreshes;
                self.is_waiting &= !is_shown;
                Ok(is_shown)
            }
            advanced => advanced,
        }
    }

    /// Refusals of the server, each once.
    pub fn take_refused(&mut self) -> Option<RefusedRequests> {
        self.refused.take()
    }

    fn advance_once(
        &mut self,
        client: &mut Client,
        depth: PipelineDepth,
    ) -> Result<bool, ClientError> {
        if self.stepping == Stepping::FreeRunning {
            return client.poll().map(|_| true);
        }
        let is_late = self.is_waiting;
        if !is_late {
            client.request_tick()?;
            self.is_waiting = true;
        }
        // One wait for a tick at most: after a time-out, later frames only look.
        let shown = match depth == PipelineDepth::LOCKSTEP && !is_late {
            true => match client.wait(depth) {
                Err(ClientError::Timeout { .. }) => None,
                waited => Some(waited?),
            },
            false => client.try_wait(depth)?,
        };
        self.is_waiting = shown.is_none();
        self.late_steps += u64::from(self.is_waiting);
        Ok(shown.is_some())
    }

    /// Changes of the objects that show a client's view.
    pub fn changes(&mut self, view: &View) -> Vec<ObjectChange<O>> {
        let mut changes = Vec::new();
        let follows = self.shown.and_then(|shown| shown.checked_add(1)) == Some(view.refreshes());
        self.shown = Some(view.refreshes());
        let coordinates = self.coordinates;
        let shown = |place| shown(coordinates, view, place).map(ObjectChange::Show);
        if follows {
            let gone = (view.removed().iter()).filter_map(|id| self.objects.remove(id));
            changes.extend(gone.map(ObjectChange::Destroy));
            changes.extend(view.changed().filter_map(shown));
        } else {
            // The application has computed views of its own: what they removed and changed is not known.
            let gone = self.objects.extract_if(|id, _| view.place(*id).is_none());
            let mut gone: Vec<_> = gone.collect();
            gone.sort_unstable_by_key(|(id, _)| *id);
            changes.extend((gone.into_iter()).map(|(_, object)| ObjectChange::Destroy(object)));
            changes.extend((0..view.ids().len()).filter_map(shown));
        }
        changes
    }
}

/// The state of a body of a view; `None` before it has a pose.
fn shown(coordinates: Coordinates, view: &View, place: usize) -> Option<StateRecord> {
    let position = view.positions()[place];
    let state = StateRecord {
        body: view.ids()[place],
        position: coordinates.vector_out(position),
        rotation: coordinates.rotation_out(view.rotations()[place]),
        linear_velocity: coordinates.vector_out(view.linear_velocities()[place]),
        angular_velocity: coordinates.angular_out(view.angular_velocities()[place]),
    };
    position.is_finite().then_some(state)
}
