//! A client of one scene that speaks the coordinates of its application.
//!
//! It adds nothing to the client but conversions, whole batches, and arrays that stay until the next view.

use std::collections::{BTreeSet, VecDeque};
use std::time::Duration;

use glam::{Quat, Vec3};
#[cfg(feature = "local")]
use rhumb_client::scene::CommandError;
use rhumb_client::scene::{Answer, Command, Query};
use rhumb_client::{
    BodyCentres, BodyId, BodyState, Client, ClientError, ErrorBound, Misuse, PipelineDepth,
    RenderTime, ServerConnection, Statistics, Tick,
};
#[cfg(feature = "serve")]
use rhumb_client::{Checkpoint, CheckpointError};

use crate::cells::{self, CellBand, CellChoice, CellRecord};
use crate::coordinates::{Coordinates, rounding, units_up};
use crate::descriptions::{BodyParams, StateRecord};
use crate::error::BindingError;
#[cfg(feature = "local")]
use crate::feeding::{FedArrays, FedStates, RequestRecord};
#[cfg(feature = "files")]
use crate::files::{self, LoadParams, LoadedFile, NamedBody, NamedJoint};
use crate::joining::{JoinParams, TICKS_NEEDED, tolerance};
#[cfg(feature = "serve")]
use crate::own_server::{OwnServer, SceneServer};
use crate::records::{ContactRecord, EventRecord, HitRecord, KnownBodies, RefusalRecord};
use crate::view::ConvertedView;

/// Limit of unread events, the client's own. Beyond it, the oldest are dropped, and counted.
const EVENTS_KEPT: usize = 65_536;

/// A client of one scene.
pub struct RemoteScene {
    client: Client,
    view: ConvertedView,
    /// Events that the application has not read.
    events: VecDeque<EventRecord>,
    /// Events that were dropped unread.
    events_left_out: u64,
    known: KnownBodies,
    /// Of the last call that the refusals made an error.
    refusals: VecDeque<RefusalRecord>,
    /// Of the last [`Self::error_bounds`].
    error_bounds: Vec<f32>,
    centres: BodyCentres,
    #[cfg(feature = "local")]
    fed: FedStates,
    /// Numbers of joints that this client has given out and not taken back.
    #[cfg(feature = "files")]
    joints: BTreeSet<rhumb_client::scene::JointId>,
    /// Goes after the client.
    #[cfg(feature = "serve")]
    origin: Option<SceneServer>,
}

impl RemoteScene {
    /// Joins a scene, and returns when the copy of the scene is complete.
    ///
    /// # Errors
    ///
    /// [`BindingError`] for wrong parameters, a request that the server denies, and an answer that does not arrive in
    /// time.
    pub fn join(
        connection: ServerConnection,
        scene: &str,
        params: &JoinParams,
    ) -> Result<Self, BindingError> {
        let client = connection.join_with(scene, params.options()?)?;
        Ok(Self {
            client,
            view: ConvertedView::new(params.coordinates),
            events: VecDeque::new(),
            events_left_out: 0,
            known: KnownBodies::default(),
            refusals: VecDeque::new(),
            error_bounds: Vec::new(),
            centres: BodyCentres::default(),
            #[cfg(feature = "local")]
            fed: FedStates::default(),
            #[cfg(feature = "files")]
            joints: BTreeSet::new(),
            #[cfg(feature = "serve")]
            origin: None,
        })
    }

    /// Keeps the scene's server, which is in this process: it ends no earlier than this client.
    #[cfg(feature = "serve")]
    #[must_use]
    pub fn of(mut self, origin: OwnServer, scene: &str) -> Self {
        self.origin = Some(SceneServer::new(origin, scene));
        self
    }

    /// The one text by which other processes connect to the scene's server, if that is in this process and has sockets.
    #[cfg(feature = "serve")]
    #[must_use]
    pub fn address(&self) -> Option<String> {
        self.origin.as_ref().and_then(SceneServer::address)
    }

    /// The address of the page that shows the scene to browsers of this machine, until the scene is closed. What is queued
    /// is sent first.
    ///
    /// # Errors
    ///
    /// [`BindingError`] if the server is elsewhere, this build has no page, or the system refuses sockets or threads.
    #[cfg(feature = "serve")]
    pub fn page(&mut self) -> Result<String, BindingError> {
        let origin = self.origin.as_mut();
        let address = origin.ok_or(BindingError::PageElsewhere)?.page()?;
        self.client.flush();
        Ok(address)
    }

    /// The whole state of the scene, with everything that this client has sent: any number of scenes continue from it.
    ///
    /// # Errors
    ///
    /// [`BindingError`] if the server is elsewhere, as [`Client::inspect`], and for a scene that cannot be
    /// saved.
    #[cfg(feature = "serve")]
    pub fn save(&mut self) -> Result<Checkpoint, BindingError> {
        let origin = self.origin.as_ref().ok_or(CheckpointError::NoServer)?;
        // The answer comes after everything that was sent before.
        self.client.inspect()?;
        origin.save()
    }

    /// The coordinates that it was joined with.
    #[must_use]
    pub const fn coordinates(&self) -> Coordinates {
        self.view.coordinates()
    }

    /// Queues the addition of bodies, and returns their ids in the same order. If one is wrong, none is added.
    ///
    /// A hull or compound may be given from anywhere: its centre of mass is found, and poses, anchors and mounts of the
    /// body stay those of the origin that its points have. Other members see the body from its centre of mass.
    ///
    /// # Errors
    ///
    /// As [`Client::add_bodies`].
    pub fn add_bodies(&mut self, bodies: &[BodyParams]) -> Result<Vec<BodyId>, BindingError> {
        let coordinates = self.coordinates();
        let builders = bodies.iter().map(|body| body.builder(coordinates));
        let builders: Vec<_> = builders.collect::<Result<_, _>>()?;
        let (builders, centres) = BodyCentres::centred(builders);
        let ids = self.client.add_bodies(builders)?;
        self.centres.keep(&ids, &centres);
        ids.iter().for_each(|id| self.known.add(*id));
        Ok(ids)
    }

    /// Queues commands, and returns the number of the last one; `None` for no commands. If one is wrong, none is queued.
    ///
    /// # Errors
    ///
    /// As [`Client::command`].
    pub fn command(&mut self, commands: Vec<Command>) -> Result<Option<u64>, BindingError> {
        let coordinates = self.coordinates();
        let converted: Vec<_> = commands
            .into_iter()
            .map(|command| self.centres.command_in(coordinates.command_in(command)))
            .collect();
        for command in &converted {
            command.check()?;
            command.check_ids().map_err(ClientError::Id)?;
        }
        let mut last = None;
        #[cfg(feature = "files")]
        for command in &converted {
            match command {
                Command::AddJoint { id, .. } => drop(self.joints.insert(*id)),
                Command::RemoveJoint { id } => drop(self.joints.remove(id)),
                _ => {}
            }
        }
        for command in converted {
            last = Some(self.client.command(command)?);
        }
        Ok(last)
    }

    /// Queues the addition of a robot or a scene from a file: bodies, then joints.
    ///
    /// The file gives neither gravity nor the duration of a tick: those are of the scene. Where they differ, the result says
    /// so.
    ///
    /// # Errors
    ///
    /// [`BindingError::File`] for a file that cannot be loaded, with its line; else as [`Self::add_bodies`]. Then nothing is
    /// queued.
    #[cfg(feature = "files")]
    pub fn load(&mut self, path: &str, params: &LoadParams) -> Result<LoadedFile, BindingError> {
        let coordinates = self.coordinates();
        let scene = files::read(path, coordinates, params)?;
        let mut taken = self.joints.clone();
        let replica = self.client.replica();
        taken.extend(
            replica
                .into_iter()
                .flat_map(|replica| replica.joints().iter().map(|(id, _)| id)),
        );
        let gravity = replica.map_or(scene.config.gravity, rhumb_client::Replica::gravity);
        let mut left_out: Vec<_> = scene
            .report
            .notes()
            .iter()
            .map(ToString::to_string)
            .collect();
        left_out.extend(files::differences(
            &scene,
            self.client.config(),
            gravity,
            coordinates,
        ));
        let numbers = files::numbers(scene.joints.len(), params.first_joint, &taken)?;
        let builders = scene.bodies.iter().map(|body| body.builder.clone());
        let ids = self.client.add_bodies(builders)?;
        ids.iter().for_each(|id| self.known.add(*id));
        for (id, joint) in numbers.iter().zip(&scene.joints) {
            self.client.command(files::joint(*id, joint, &ids))?;
            self.joints.insert(*id);
        }
        let names = files::distinct(scene.bodies.iter().map(|body| body.name.as_str()), "body");
        let bodies = names.into_iter().zip(&scene.bodies).zip(ids);
        let joint_names = files::distinct(
            scene.joints.iter().map(|joint| joint.name.as_str()),
            "joint",
        );
        Ok(LoadedFile {
            name: scene.name.clone(),
            bodies: bodies
                .map(|((name, body), id)| NamedBody {
                    name,
                    id,
                    frame_position: coordinates.vector_out(body.frame_position),
                    frame_rotation: coordinates.rotation_out(body.frame_rotation),
                })
                .collect(),
            joints: (joint_names.into_iter().zip(numbers))
                .map(|(name, id)| NamedJoint { name, id })
                .collect(),
            left_out,
        })
    }

    /// Requests authority over kinematic bodies in place of the present ones; `tolerance_m` is in metres.
    ///
    /// # Errors
    ///
    /// As [`Client::take_authority`], and [`BindingError::Tolerance`].
    pub fn take_authority(
        &mut self,
        bodies: &[BodyId],
        tolerance_m: f64,
    ) -> Result<(), BindingError> {
        let tolerance = tolerance(tolerance_m)?;
        Ok(self.client.take_authority(bodies, tolerance)?)
    }

    /// The edges of the scene's cells along x, y and z; 0 along an axis that is not divided. `None` for a scene that is not
    /// divided, and for one that was not joined by cells.
    #[must_use]
    pub fn cell_grid(&self) -> Option<[f32; 3]> {
        let grid = self.client.cell_grid()?;
        Some(self.coordinates().cell_edges_out(grid))
    }

    /// Takes these cells and no others: as [`Client::take_cells`].
    ///
    /// # Errors
    ///
    /// As [`Client::take_cells`], and [`BindingError::Tolerance`].
    pub fn take_cells(&mut self, choices: &[CellChoice]) -> Result<(), BindingError> {
        let grid = self.client.cell_grid().ok_or(Misuse::NotDivided);
        let grid = grid.map_err(ClientError::from)?;
        let coordinates = self.coordinates();
        let cells = choices.iter().map(|of| of.of_client(grid, coordinates));
        Ok(self.client.take_cells(&cells.collect::<Result<_, _>>()?)?)
    }

    /// Takes the cells around a point, each by the first band that reaches it: as [`Client::take_cells_around`].
    ///
    /// # Errors
    ///
    /// As [`Self::take_cells`], and [`BindingError::Value`] for a point or a radius that is none.
    pub fn take_cells_around(
        &mut self,
        point: Vec3,
        bands: &[CellBand],
    ) -> Result<(), BindingError> {
        let coordinates = self.coordinates();
        let bands = bands.iter().map(|band| band.of_client(coordinates));
        let bands: Vec<_> = bands.collect::<Result<_, _>>()?;
        let point = cells::point(point, coordinates)?;
        Ok(self.client.take_cells_around(point, &bands)?)
    }

    /// The cells that are taken, and the state of each.
    #[must_use]
    pub fn cells(&self) -> Vec<CellRecord> {
        let Some(grid) = self.client.cell_grid() else {
            return Vec::new();
        };
        let record = |taken| CellRecord::new(taken, grid, self.coordinates());
        self.client.cells().map(record).collect()
    }

    /// Publishes the states of bodies under this client's authority: as [`Client::publish`].
    ///
    /// # Errors
    ///
    /// As [`Client::publish`], and [`BindingError::Twice`] for a body that has two states.
    pub fn publish(&mut self, states: &[StateRecord]) -> Result<Option<Tick>, BindingError> {
        if let Some(body) = twice(states.iter().map(|state| state.body)) {
            return Err(BindingError::Twice(body));
        }
        let converted = self.states_in(states)?;
        Ok(self.client.publish(&converted)?)
    }

    /// States in Rhumb's coordinates.
    fn states_in(&self, states: &[StateRecord]) -> Result<Vec<(BodyId, BodyState)>, BindingError> {
        let coordinates = self.coordinates();
        let converted = states.iter().map(|state| {
            let converted = StateRecord {
                body: state.body,
                position: coordinates.vector_in(state.position),
                rotation: coordinates.rotation_in(state.rotation),
                linear_velocity: coordinates.vector_in(state.linear_velocity),
                angular_velocity: coordinates.angular_in(state.angular_velocity),
            };
            converted.check()?;
            let body_state = BodyState::new(
                converted.position.to_array(),
                converted.rotation.to_array(),
                converted.linear_velocity.to_array(),
                converted.angular_velocity.to_array(),
            )?;
            let body_state = self.centres.state_in(state.body, body_state)?;
            Ok((state.body, body_state))
        });
        converted.collect()
    }

    /// Hands over the states of one tick of a scene that this client feeds, and returns the tick: the next one if it is
    /// `None`.
    ///
    /// # Errors
    ///
    /// As [`Client::feed`], and [`BindingError::Value`] for arrays that differ in length. After
    /// [`BindingError::Refused`], the states were handed over.
    #[cfg(feature = "local")]
    pub fn feed(
        &mut self,
        tick: Option<Tick>,
        states: &FedArrays<'_>,
    ) -> Result<Tick, BindingError> {
        self.take_events();
        let next = self.client.fed_tick().map_or(Tick::ZERO, Tick::next);
        let tick = tick.unwrap_or(next);
        let coordinates = self.coordinates();
        let converted = self.fed.convert(states, coordinates, &self.centres)?;
        let fed = self.client.feed(tick, converted, states.velocities());
        self.reported(fed)?;
        Ok(tick)
    }

    /// The tick of the newest states that were fed: also beside refusals.
    #[cfg(feature = "local")]
    #[must_use]
    pub fn fed_tick(&self) -> Option<Tick> {
        self.client.fed_tick()
    }

    /// The oldest unread request of another member of a scene that this client feeds.
    #[cfg(feature = "local")]
    pub fn poll_request(&mut self) -> Option<RequestRecord> {
        let coordinates = self.coordinates();
        loop {
            let record = RequestRecord::new(self.client.poll_request()?, coordinates);
            if record.is_some() {
                return record;
            }
        }
    }

    /// Changes the scene as another member asked.
    ///
    /// # Errors
    ///
    /// As [`Client::accept_request`].
    #[cfg(feature = "local")]
    pub fn accept_request(&mut self, request: &RequestRecord) -> Result<(), BindingError> {
        self.client.accept_request(request.request.clone())?;
        if let Some(body) = request.body {
            self.known.add(body);
        }
        Ok(())
    }

    /// Refuses what another member asked for.
    ///
    /// # Errors
    ///
    /// As [`Client::refuse_request`].
    #[cfg(feature = "local")]
    pub fn refuse_request(&mut self, request: &RequestRecord) -> Result<(), BindingError> {
        let (request, reason) = (request.request.clone(), CommandError::NotAllowed);
        Ok(self.client.refuse_request(request, reason)?)
    }

    /// Queues the removal of this client's shapes that no body has, and returns their number.
    ///
    /// # Errors
    ///
    /// As [`Client::remove_unused_shapes`].
    pub fn remove_unused_shapes(&mut self) -> Result<usize, BindingError> {
        Ok(self.client.remove_unused_shapes()?)
    }

    /// Sends the queued commands at once.
    pub fn flush(&mut self) {
        self.client.flush();
    }

    /// Steps a lockstep scene once, and computes the view, also beside refusals: as [`Client::advance`].
    ///
    /// # Errors
    ///
    /// As [`Client::advance`].
    pub fn advance(&mut self, depth: PipelineDepth) -> Result<Tick, BindingError> {
        self.begin_view();
        let advanced = self.client.advance(depth);
        self.note_removed();
        self.reported(advanced)
    }

    /// As [`Self::advance`] for a call of several ticks: refusals are added to `refused`, so that no tick is left out for
    /// them.
    ///
    /// # Errors
    ///
    /// As [`Self::advance`], but for [`BindingError::Refused`].
    pub fn advance_through(
        &mut self,
        depth: PipelineDepth,
        refused: &mut Option<BindingError>,
    ) -> Result<u64, BindingError> {
        match self.advance(depth) {
            Err(later @ BindingError::Refused { .. }) => {
                *refused = Some(match refused.take() {
                    Some(earlier) => earlier.and_later(later),
                    None => later,
                });
                Ok(self.time().tick.value())
            }
            advanced => advanced.map(Tick::value),
        }
    }

    /// Waits for the tick of the last advance that timed out, and computes the view.
    ///
    /// # Errors
    ///
    /// As [`Client::wait`].
    pub fn wait(&mut self, depth: PipelineDepth) -> Result<Tick, BindingError> {
        self.begin_view();
        let waited = self.client.wait(depth);
        self.note_removed();
        self.reported(waited)
    }

    /// Computes the view of a free-running scene for the present moment. Does not wait.
    ///
    /// # Errors
    ///
    /// As [`Client::poll`].
    pub fn poll(&mut self) -> Result<RenderTime, BindingError> {
        self.begin_view();
        let polled = self.client.poll();
        self.note_removed();
        self.reported(polled)
    }

    /// The arrays are about to be old. Events of earlier views are taken, before the client drops any.
    fn begin_view(&mut self) {
        self.take_events();
        self.view.expire();
    }

    /// Learns of the bodies that are not in the view any more. No event tells of one that has left the cells of this client.
    fn note_removed(&mut self) {
        let (view, grid) = (self.client.view(), self.client.cell_grid());
        self.centres.forget(view, grid);
        view.removed().iter().for_each(|id| self.known.add(*id));
    }

    /// Keeps the refusals of a call for [`Self::poll_refusal`].
    fn reported<T>(&mut self, result: Result<T, ClientError>) -> Result<T, BindingError> {
        let result = result.map_err(BindingError::from);
        if let Err(BindingError::Refused { kept, .. }) = &result {
            self.refusals = kept.iter().cloned().collect();
        }
        result
    }

    /// The oldest refusal of the last call that was [`BindingError::Refused`], once.
    pub fn poll_refusal(&mut self) -> Option<RefusalRecord> {
        self.refusals.pop_front()
    }

    /// Handles received data for a time, without computing the view.
    ///
    /// # Errors
    ///
    /// As [`Client::idle`].
    pub fn idle(&mut self, duration: Duration) -> Result<(), BindingError> {
        Ok(self.client.idle(duration)?)
    }

    /// Sends queries and waits for their answers; returns the tick whose scene was asked, and the hits in the order of the
    /// queries.
    ///
    /// # Errors
    ///
    /// As [`Client::ask`], and [`BindingError::Query`] when the server does not answer them.
    pub fn query(&mut self, queries: Vec<Query>) -> Result<(Tick, Vec<HitRecord>), BindingError> {
        let coordinates = self.coordinates();
        let converted = queries.into_iter().map(|query| coordinates.query_in(query));
        let converted = converted.collect::<Result<Vec<_>, _>>()?;
        let result = self.client.ask(converted)?;
        let answers = result.answers.map_err(BindingError::Query)?;
        let mut hits = Vec::new();
        for (query, answer) in (0..).zip(answers) {
            match answer {
                Answer::Hits(found) => hits.extend(found.into_iter().map(|hit| {
                    let hit = coordinates.hit_out(hit);
                    HitRecord {
                        query,
                        body: hit.body,
                        distance: hit.distance,
                        point: hit.point,
                        normal: hit.normal,
                    }
                })),
                Answer::Bodies(found) => hits.extend(found.into_iter().map(|body| HitRecord {
                    query,
                    body,
                    distance: 0.0,
                    point: Vec3::ZERO,
                    normal: Vec3::ZERO,
                })),
            }
        }
        Ok((result.tick, hits))
    }

    /// The oldest unread event.
    pub fn poll_event(&mut self) -> Option<EventRecord> {
        self.take_events();
        self.events.pop_front()
    }

    /// The contacts of a body, or of all bodies, between bodies of which one reports its contacts.
    ///
    /// # Errors
    ///
    /// [`BindingError::NotInView`] for a body that this client never knew.
    pub fn contacts(&mut self, body: Option<BodyId>) -> Result<Vec<ContactRecord>, BindingError> {
        match body.filter(|body| !self.knows(*body)) {
            Some(unknown) => Err(BindingError::NotInView(unknown)),
            None => {
                let (pairs, coordinates) = (self.client.contacts(body), self.coordinates());
                Ok(pairs
                    .map(|pair| ContactRecord::new(&pair, coordinates))
                    .collect())
            }
        }
    }

    /// Takes the client's events, which keeps no more of them than this scene.
    fn take_events(&mut self) {
        let coordinates = self.coordinates();
        while let Some((after, event)) = self.client.poll_event() {
            self.centres.note(&event);
            let record = EventRecord::new(after, event, coordinates);
            self.known.note(&record);
            if self.events.len() == EVENTS_KEPT {
                self.events.pop_front();
                self.events_left_out += 1;
            }
            self.events.push_back(record);
        }
    }

    /// The moment of the view.
    #[must_use]
    pub fn time(&self) -> RenderTime {
        let time = self.client.view().time();
        time.unwrap_or_else(|| RenderTime::at(Tick::ZERO))
    }

    /// Number of bodies in the view.
    #[must_use]
    pub fn count(&self) -> usize {
        self.client.view().ids().len()
    }

    /// True if the view has a body.
    #[must_use]
    pub fn has(&self, body: BodyId) -> bool {
        self.client.view().place(body).is_some()
    }

    /// True if a body is in the view, is still to come, or has gone.
    pub fn knows(&mut self, body: BodyId) -> bool {
        self.take_events();
        self.has(body) || self.known.has(body)
    }

    /// Place of a body in the arrays.
    ///
    /// # Errors
    ///
    /// [`BindingError::NotInView`] for a body that is still to come, has gone, or was never there.
    pub fn place(&self, body: BodyId) -> Result<usize, BindingError> {
        let place = self.client.view().place(body);
        place.ok_or(BindingError::NotInView(body))
    }

    /// Words of the bodies of the view. The other arrays have the same order.
    pub fn bodies(&mut self) -> &[u64] {
        self.view.bodies(self.client.view())
    }

    /// Centres of mass; of a body that this client added, the origin that its shape was given from.
    pub fn positions(&mut self) -> &[Vec3] {
        self.view.positions(self.client.view(), &self.centres)
    }

    /// The centre of mass of a body in its own axes, in units of length from its position: not zero for a hull or compound
    /// that this client gave from elsewhere.
    #[must_use]
    pub fn centre(&self, body: BodyId) -> Vec3 {
        self.coordinates().vector_out(self.centres.centre(body))
    }

    /// Rotations body → world.
    pub fn rotations(&mut self) -> &[Quat] {
        self.view.rotations(self.client.view())
    }

    /// Velocities of centres of mass, units of length per second.
    pub fn linear_velocities(&mut self) -> &[Vec3] {
        self.view.linear(self.client.view())
    }

    /// Angular velocities, rad/s.
    pub fn angular_velocities(&mut self) -> &[Vec3] {
        self.view.angular(self.client.view())
    }

    /// True for each body that rests.
    #[must_use]
    pub fn resting(&self) -> &[bool] {
        self.client.view().resting()
    }

    /// Places whose pose differs from that of the last view.
    pub fn changed(&mut self) -> &[u32] {
        self.view.changed(self.client.view())
    }

    /// Words of bodies that were removed since the last view.
    pub fn removed(&mut self) -> &[u64] {
        self.view.removed(self.client.view())
    }

    /// How far any point of a body as the view shows it may be from its true place at the moment of the view, in units of
    /// length.
    ///
    /// Infinite while nothing finite is known: a packet that may hold an update of the body is missing, or the view shows
    /// a moment of which the news has not arrived.
    ///
    /// # Errors
    ///
    /// [`BindingError::NotInView`].
    pub fn error_bound(&self, body: BodyId) -> Result<f32, BindingError> {
        let bound = self.client.error_bound(body);
        let bound = bound.ok_or(BindingError::NotInView(body))?;
        Ok(self.bound_in_units(bound, self.place(body)?))
    }

    /// The bounds of all bodies of the view, in the order of the arrays: see [`Self::error_bound`].
    pub fn error_bounds(&mut self) -> &[f32] {
        let bounds = self.client.error_bounds().enumerate();
        let bounds: Vec<_> = bounds
            .map(|(place, bound)| self.bound_in_units(bound, place))
            .collect();
        self.error_bounds = bounds;
        &self.error_bounds
    }

    /// How far any point of a body may be off at a tick by what is known of it, whatever the view shows, in units of
    /// length: the bound of its track.
    ///
    /// # Errors
    ///
    /// [`BindingError::NotInView`] for a body that the copy does not have.
    pub fn tick_error_bound(&self, body: BodyId, tick: Tick) -> Result<f32, BindingError> {
        let bound = self.client.tick_error_bound(body, tick);
        let bound = bound.ok_or(BindingError::NotInView(body))?;
        let unit = f64::from(self.coordinates().metres_per_unit());
        Ok(units_up(bound.metres() / unit))
    }

    /// The bound of a pose as it is handed out: in the application's units, and from the body's origin.
    fn bound_in_units(&self, bound: ErrorBound, place: usize) -> f32 {
        let (view, coordinates) = (self.client.view(), self.coordinates());
        let centre = self.centres.centre(view.ids()[place]);
        let rounding = rounding(view.positions()[place], centre, coordinates);
        let unit = f64::from(coordinates.metres_per_unit());
        units_up(bound.metres() / unit + rounding)
    }

    /// Sets the ticks by which bodies under authority are published ahead of the server's clock: as
    /// [`Client::set_lead_ticks`].
    ///
    /// # Errors
    ///
    /// [`BindingError::Value`] for a number that is not 0 to 3,600.
    pub fn set_lead_ticks(&mut self, ticks: f64) -> Result<(), BindingError> {
        let set = self.client.set_lead_ticks(ticks);
        set.map_err(|_| BindingError::value("ticks", ticks, TICKS_NEEDED))
    }

    /// Statistics of the connection and of the stream.
    #[must_use]
    pub fn statistics(&self) -> Statistics {
        let mut statistics = self.client.statistics();
        statistics.events_left_out += self.events_left_out;
        statistics
    }

    /// Deletes the scene for all members, and waits for the answer.
    ///
    /// # Errors
    ///
    /// As [`Client::delete`].
    pub fn delete(&mut self) -> Result<(), BindingError> {
        Ok(self.client.delete()?)
    }

    /// Leaves the scene and closes the connection.
    pub fn close(self) {
        self.client.close();
    }
}

/// The body that is there twice, if any.
fn twice(mut bodies: impl Iterator<Item = BodyId>) -> Option<BodyId> {
    let mut seen = BTreeSet::new();
    bodies.find(|body| !seen.insert(*body))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_body_that_is_there_twice_is_found() {
        let [first, second] = [BodyId::new(1, 0), BodyId::new(1, 1)];
        assert_eq!(twice([first, second].into_iter()), None);
        assert_eq!(twice([first, second, first].into_iter()), Some(first));
    }
}
