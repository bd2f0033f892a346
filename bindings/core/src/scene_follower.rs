//! Follows a scene frame by frame, for an engine with an object for each body.
//!
//! Invariant: each body of the view that the objects show has its object here, also one that the application destroyed.

use std::collections::HashMap;
use std::time::Duration;

use rhumb_client::scene::Stepping;
use rhumb_client::{BodyId, Client, ClientError, PipelineDepth, RefusedRequests, View};

use crate::coordinates::Coordinates;
use crate::remote_scene::StateRecord;

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
