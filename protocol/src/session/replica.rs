//! A member's replica of a scene: its shapes, bodies, joints, stream.
//!
//! Scene events, in order, and datagrams change it. Invariant: every body has a known shape, and every joint connects
//! two known bodies.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;

use glam::Vec3;
use rhumb_reckoning::{BodyId, Damping, Inertia, Tick, Track};

use super::CloseCode;
use crate::interner::{Internable, Interner};
use crate::limits::{SHAPE_BYTES_PER_SCENE_MAX, SHAPES_MAX};
use crate::message::{CellNews, Joined, SceneEvent, StreamChoice};
use crate::scene::{BodyDesc, Joints, Shape, ShapeId};
use crate::stream::{PredictionParameters, StreamReceiver, Subscriber};
use crate::wire::Wire;
use crate::wire::bytes::Writer;

/// A replica of the scene, fed by one stream.
#[derive(Debug)]
pub struct Replica {
    choice: StreamChoice,
    pub(crate) receiver: StreamReceiver,
    damping: Damping,
    gravity: Vec3,
    shapes: BTreeMap<ShapeId, Shape>,
    shape_bytes: usize,
    /// The distinct descriptors of the bodies. Their numbers are the labels of the stream's bodies.
    descs: Interner<BodyDesc>,
    joints: Joints,
    /// Of a cell: the id in the scene of each of its bodies, and of some that have left.
    names: BTreeMap<BodyId, BodyId>,
    /// The same the other way round, for the newest of the ids that a body has had here.
    locals: BTreeMap<BodyId, BodyId>,
    complete: bool,
    revision: u64,
}

impl Replica {
    /// An empty replica. The snapshot after `joined` fills it.
    #[must_use]
    pub(crate) fn new(joined: &Joined) -> Self {
        let mut subscriber = match joined.choice {
            StreamChoice::Capped { .. } => Subscriber::limited(&joined.start),
            StreamChoice::Within(_) | StreamChoice::Full | StreamChoice::Changed => {
                Subscriber::new(&joined.start)
            }
        };
        subscriber.set_lookahead(joined.config.publish_schedule.lookahead);
        subscriber.set_stepping(joined.config.stepping);
        Self {
            choice: joined.choice,
            receiver: StreamReceiver::new(subscriber),
            damping: joined.config.damping,
            gravity: joined.start.gravity,
            shapes: BTreeMap::new(),
            shape_bytes: 0,
            descs: Interner::default(),
            joints: Joints::default(),
            names: BTreeMap::new(),
            locals: BTreeMap::new(),
            complete: false,
            revision: 0,
        }
    }

    /// The scene's stream that feeds the replica.
    #[must_use]
    pub const fn choice(&self) -> StreamChoice {
        self.choice
    }

    /// True if this replica can be shown in place of another one of the same scene without going back in time.
    pub(crate) fn has_caught_up_with(&self, other: &Self) -> bool {
        other.stream().has_lost_sync() || self.stream().complete() >= other.stream().complete()
    }

    /// The subscriber that predicts the bodies.
    #[must_use]
    pub const fn stream(&self) -> &Subscriber {
        self.receiver.subscriber()
    }

    /// The subscriber, for draining the changed bodies.
    pub const fn stream_mut(&mut self) -> &mut Subscriber {
        self.receiver.subscriber_mut()
    }

    /// True if the snapshot has arrived.
    #[must_use]
    pub const fn is_complete(&self) -> bool {
        self.complete
    }

    /// The present gravity, m/s², world frame.
    #[must_use]
    pub const fn gravity(&self) -> Vec3 {
        self.gravity
    }

    /// Grows whenever a shape or the description of a body may have changed, also where this replica replaces another.
    #[must_use]
    pub const fn revision(&self) -> u64 {
        self.revision
    }

    /// The descriptor of a body; None if the replica has no such body.
    #[must_use]
    pub fn body(&self, id: BodyId) -> Option<BodyDesc> {
        let label = self.stream().label(id)?;
        let desc = *self.descs.get(label);
        Some(BodyDesc { id, ..desc })
    }

    /// The descriptor of a body as it is at a tick that a view shows: a body that is removed or changed later still has
    /// it. None for a body that does not exist then.
    #[must_use]
    pub fn body_at(&self, id: BodyId, tick: Tick) -> Option<BodyDesc> {
        let label = self.stream().label_at(id, tick)?;
        let desc = *self.descs.get(label);
        Some(BodyDesc { id, ..desc })
    }

    /// The shape of this id; None if the replica has no such shape.
    #[must_use]
    pub fn shape(&self, id: ShapeId) -> Option<&Shape> {
        self.shapes.get(&id)
    }

    /// All bodies in order of index.
    pub fn bodies(&self) -> impl Iterator<Item = BodyDesc> {
        let indices = 0..self.stream().index_end() as u32;
        let ids = indices.filter_map(|index| self.stream().body(index));
        ids.filter_map(|id| self.body(id))
    }

    /// The joints of the scene.
    #[must_use]
    pub const fn joints(&self) -> &Joints {
        &self.joints
    }

    /// The id in the scene of a body of a cell, which may have left; `None` for one that the cell never had, and in a
    /// replica of a whole scene, whose ids are the scene's.
    #[must_use]
    pub fn id_in_scene(&self, id: BodyId) -> Option<BodyId> {
        self.names.get(&id).copied()
    }

    /// The id here of a body of the scene; `None` if it is not here now. In a replica of a whole scene it is the same.
    pub(crate) fn id_here(&self, id: BodyId) -> Option<BodyId> {
        let local = match self.names.is_empty() {
            true => id,
            false => *self.locals.get(&id)?,
        };
        (self.stream().body(local.index()) == Some(local)).then_some(local)
    }

    /// The descriptor of a body by its id in the scene; `None` if it is not here.
    pub(crate) fn body_of_scene(&self, id: BodyId) -> Option<BodyDesc> {
        self.body(self.id_here(id)?)
    }

    /// Applies what a cell tells of its bodies. Its shapes are those of the scene, which `shapes` has.
    ///
    /// # Errors
    ///
    /// As [`Self::apply_scene_event`].
    pub(crate) fn apply_cell_news(
        &mut self,
        news: &CellNews,
        shapes: &Self,
    ) -> Result<(), CloseCode> {
        match news {
            CellNews::Placed { id, placed } => {
                self.note_name(*id, placed, shapes)?;
                self.apply_scene_event(placed)
            }
            CellNews::Arrived { id, placed } => {
                self.note_name(*id, placed, shapes)?;
                self.arrive(placed)?;
                self.count_event();
                Ok(())
            }
            CellNews::Departed { id, tick } => {
                self.remove(*id, Some(*tick))?;
                self.count_event();
                Ok(())
            }
            CellNews::SceneEvent(scene_event) => self.apply_scene_event(scene_event),
            CellNews::Joined(_) | CellNews::SnapshotEnd | CellNews::Denied(_) => Ok(()),
        }
    }

    /// Notes the id in the scene of a body of a cell that is placed, and copies its shape.
    fn note_name(
        &mut self,
        id: BodyId,
        placed: &SceneEvent,
        shapes: &Self,
    ) -> Result<(), CloseCode> {
        if let SceneEvent::BodyPlaced { desc, .. } = placed {
            self.borrow_shape(desc.shape, shapes)?;
            self.forget_names();
            self.names.insert(desc.id, id);
            self.locals.insert(id, desc.id);
        }
        Ok(())
    }

    /// Places a body that has crossed from another cell.
    fn arrive(&mut self, placed: &SceneEvent) -> Result<(), CloseCode> {
        let SceneEvent::BodyPlaced {
            desc,
            inertia,
            track,
            ..
        } = placed
        else {
            return Ok(());
        };
        self.place(desc, *inertia, *track, Subscriber::place_arrived)
    }

    /// Counts an event that is no part of a snapshot.
    fn count_event(&mut self) {
        self.revision += 1;
        if self.complete {
            self.stream_mut().apply_scene_event();
        }
    }

    /// Copies a shape of the scene. One that the scene has changed since replaces the earlier one.
    fn borrow_shape(&mut self, id: ShapeId, shapes: &Self) -> Result<(), CloseCode> {
        let shape = shapes.shapes.get(&id).ok_or(CloseCode::VIOLATION)?;
        if self.shapes.get(&id) != Some(shape) {
            self.shapes.insert(id, shape.clone());
        }
        Ok(())
    }

    /// Forgets the names of bodies that no view shows, once they are as many as those that are there.
    fn forget_names(&mut self) {
        if self.names.len() < 2 * self.stream().index_end() + NAMES_LEFT {
            return;
        }
        let stream = self.receiver.subscriber();
        self.names.retain(|id, _| stream.knows(*id));
        let names = &self.names;
        self.locals.retain(|_, local| names.contains_key(local));
    }

    /// Replaces another replica of the same scene. Every body of the other one counts as changed, because it may be
    /// gone.
    pub(crate) fn take_over(&mut self, old: &Self) {
        self.stream_mut().succeed(old.stream());
        self.revision += old.revision + 1;
    }

    /// Marks the snapshot as complete.
    pub(crate) fn end_snapshot(&mut self) {
        self.complete = true;
        self.stream_mut().handle_snapshot_end();
    }

    /// Applies a scene event. Events before the end of the snapshot belong to the snapshot and are not counted.
    ///
    /// # Errors
    ///
    /// The code to close with, when the event contradicts earlier ones or exceeds a limit.
    pub(crate) fn apply_scene_event(&mut self, scene_event: &SceneEvent) -> Result<(), CloseCode> {
        self.revision += 1;
        match scene_event {
            SceneEvent::ShapeAdded { id, shape } => {
                if self.shapes.len() >= SHAPES_MAX as usize {
                    return Err(CloseCode::LIMIT);
                }
                self.shape_bytes += shape.bytes();
                if self.shape_bytes > SHAPE_BYTES_PER_SCENE_MAX {
                    return Err(CloseCode::LIMIT);
                }
                if let Some(before) = self.shapes.insert(*id, shape.clone()) {
                    self.shape_bytes -= before.bytes();
                }
            }
            SceneEvent::ShapeRemoved { id } => {
                let shape = self.shapes.remove(id).ok_or(CloseCode::VIOLATION)?;
                self.shape_bytes -= shape.bytes();
            }
            SceneEvent::BodyPlaced {
                desc,
                inertia,
                track,
                alias,
            } => {
                self.place(desc, *inertia, *track, Subscriber::place_labelled)?;
                if let Some(alias) = alias {
                    self.stream_mut().alias(desc.id, *alias);
                }
            }
            SceneEvent::BodyRemoved { id, .. } => {
                self.remove(*id, None)?;
            }
            SceneEvent::GravityChanged { since, gravity } => {
                self.gravity = *gravity;
                self.stream_mut().change_gravity(*since, *gravity);
            }
            SceneEvent::PublisherSilent { since, bodies } => {
                self.check_bodies(bodies)?;
                self.stream_mut().silence(*since, bodies);
            }
            SceneEvent::PublisherActive { tick, bodies } => {
                self.check_bodies(bodies)?;
                self.stream_mut().confirm(*tick, bodies);
            }
            SceneEvent::SceneFaulted { .. }
            | SceneEvent::SceneRestored { .. }
            | SceneEvent::Unknown { .. } => {}
            SceneEvent::JointAdded { id, joint } => {
                let known = joint.bodies.map(|body| self.body(body).is_some());
                if known != [true; 2] {
                    return Err(CloseCode::VIOLATION);
                }
                self.joints.insert(*id, *joint);
            }
            SceneEvent::JointRemoved { id } => {
                self.joints.remove(*id).ok_or(CloseCode::VIOLATION)?;
            }
        }
        if self.complete {
            self.stream_mut().apply_scene_event();
        }
        Ok(())
    }

    fn check_bodies(&self, bodies: &[BodyId]) -> Result<(), CloseCode> {
        let is_known = |id: &BodyId| self.stream().body(id.index()) == Some(*id);
        match bodies.iter().all(is_known) {
            true => Ok(()),
            false => Err(CloseCode::VIOLATION),
        }
    }

    fn place(
        &mut self,
        desc: &BodyDesc,
        inertia: Option<Inertia>,
        track: Track,
        place: PlaceBody,
    ) -> Result<(), CloseCode> {
        let shape = self.shapes.get(&desc.shape).ok_or(CloseCode::VIOLATION)?;
        let parameters = PredictionParameters::of(desc, shape, self.damping, inertia);
        let before = self.stream().body(desc.id.index());
        let label = self.descs.join(without_id(desc));
        let stream = self.receiver.subscriber_mut();
        if !place(stream, desc.id, &parameters, track, Some(label)) {
            self.descs.leave(label);
            return Err(CloseCode::LIMIT);
        }
        if let Some(id) = before.filter(|id| *id != desc.id) {
            self.joints.remove_body(id);
        }
        self.release_descs();
        Ok(())
    }

    /// Releases the descriptors of bodies that no view shows.
    fn release_descs(&mut self) {
        for label in self.stream_mut().take_released_labels() {
            self.descs.leave(label);
        }
    }

    fn remove(&mut self, id: BodyId, tick: Option<Tick>) -> Result<(), CloseCode> {
        if !self.stream_mut().remove_at(id, tick) {
            return Err(CloseCode::VIOLATION);
        }
        self.release_descs();
        self.joints.remove_body(id);
        Ok(())
    }
}

/// How a subscriber places a body.
type PlaceBody = fn(&mut Subscriber, BodyId, &PredictionParameters, Track, Option<u32>) -> bool;

/// Names of bodies that have left a cell, kept without a look at which of them a view shows.
const NAMES_LEFT: usize = 64;

/// The descriptor without the id: many bodies can share it.
fn without_id(desc: &BodyDesc) -> BodyDesc {
    BodyDesc {
        id: BodyId::new(0, 0),
        ..*desc
    }
}

impl Internable for BodyDesc {
    type Key = Vec<u8>;

    /// The encoding: equal values have equal encodings.
    fn key(&self) -> Vec<u8> {
        let mut bytes = Writer::new();
        self.encode(&mut bytes);
        bytes.into_bytes()
    }
}
