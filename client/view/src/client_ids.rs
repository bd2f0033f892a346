//! Body ids and shape numbers for the commands of one client.
//!
//! Queues commands at the session and never waits.

use core::fmt;
use std::collections::{BTreeMap, VecDeque};

use rhumb_protocol::limits::{GRANT, GRANTED_MAX, SHAPES_MAX};
use rhumb_protocol::scene::{BodyBuilder, BodyDesc, BodyKind, Command, IdRange, Shape, ShapeId};
use rhumb_protocol::session::{ClientSession, Event, Misuse, Replica};
use rhumb_reckoning::{BodyId, BodyState};

use crate::body_ids::{IdAllocator, IdSource, OwnBodies};
use crate::shapes::{ShapeClashes, ShapeNumbers, ShapeRefusal, ShapeSlot, WrongBody};
use crate::unanswered::{CommandBodies, RefusedRequest};

/// The ids and numbers of one client in one scene.
#[derive(Debug)]
pub struct ClientIds {
    ids: IdAllocator,
    shapes: ShapeNumbers,
    clashes: ShapeClashes,
    own_bodies: OwnBodies,
    /// Bodies of commands that the server has not answered yet, by the number of the command.
    bodies: VecDeque<(u64, BodyChange)>,
    command_bodies: CommandBodies,
    last_command: Option<u64>,
}

/// Effect of a command on the shapes in use. A body that is changed leaves its shape and takes one.
#[derive(Clone, Copy, Debug)]
enum BodyChange {
    Takes(ShapeId),
    Leaves(BodyId),
}

impl ClientIds {
    /// `granted`: the ids that the server granted when the client joined.
    #[must_use]
    pub fn new(granted: IdRange) -> Self {
        Self {
            ids: IdAllocator::new(granted),
            shapes: ShapeNumbers::default(),
            clashes: ShapeClashes::default(),
            own_bodies: OwnBodies::default(),
            bodies: VecDeque::new(),
            command_bodies: CommandBodies::default(),
            last_command: None,
        }
    }

    /// The number of the last queued command; `None` before the first one.
    #[must_use]
    pub const fn last_command(&self) -> Option<u64> {
        self.last_command
    }

    /// The number of ids to request from the server before `count` ids are available; zero when enough are available.
    ///
    /// A client has a limited number of ranges, so it requests a large range whenever the limit allows.
    #[must_use]
    pub fn missing_ids(&self, count: u32) -> u32 {
        match count.saturating_sub(self.ids.available()) {
            0 => 0,
            missing => {
                let most = GRANTED_MAX.saturating_sub(self.ids.granted());
                GRANT.min(most).max(missing)
            }
        }
    }

    /// Takes `count` ids, or fewer when fewer are granted, for commands of the caller. The id of a body that is refused
    /// stays the caller's.
    pub fn take_ids(&mut self, count: u32) -> Vec<BodyId> {
        (0..count).map_while(|_| self.ids.take()).collect()
    }

    /// Queues a command; returns its number.
    ///
    /// # Errors
    ///
    /// As [`ClientSession::command`], and [`Misuse::JoinedToItself`].
    pub fn command(
        &mut self,
        session: &mut ClientSession,
        command: Command,
    ) -> Result<u64, Misuse> {
        if let Command::AddJoint { joint, .. } | Command::ChangeJoint { joint, .. } = &command
            && joint.bodies[0] == joint.bodies[1]
        {
            return Err(Misuse::JoinedToItself(joint.bodies[0]));
        }
        self.queue(session, command, IdSource::Caller)
    }

    /// Queues a command; `id_source` is that of the body that it adds.
    fn queue(
        &mut self,
        session: &mut ClientSession,
        command: Command,
        id_source: IdSource,
    ) -> Result<u64, Misuse> {
        let shape = match &command {
            Command::AddShape { id, shape } => Some((*id, shape.clone())),
            _ => None,
        };
        let (leaves, takes) = match &command {
            Command::AddBody { desc, .. } => (None, Some(desc.shape)),
            Command::ChangeBody { desc } => (Some(desc.id), Some(desc.shape)),
            Command::RemoveBody { id } => (Some(*id), None),
            _ => (None, None),
        };
        let added = match &command {
            Command::AddBody { desc, .. } => Some(desc.id),
            _ => None,
        };
        let changed = match &command {
            Command::ChangeBody { desc } => Some((desc.id, Some(*desc))),
            Command::RemoveBody { id } => Some((*id, None)),
            _ => None,
        };
        let about = command.body();
        let number = session.command(command)?;
        self.last_command = Some(number);
        if let Some(body) = about {
            self.command_bodies.add(number, body);
        }
        if let Some((id, desc)) = changed {
            self.clashes.note_changed(id, desc);
        }
        if let Some(id) = added {
            self.own_bodies.add(id, number, id_source);
        }
        if let Some((id, shape)) = shape {
            self.shapes.add(id, shape, number);
        }
        let leaves = leaves.map(BodyChange::Leaves);
        let changes = leaves.into_iter().chain(takes.map(BodyChange::Takes));
        self.bodies.extend(changes.map(|change| (number, change)));
        Ok(number)
    }

    /// Queues the removal of the shapes that came with bodies of this client and that no body has any more; returns their
    /// number. Queued additions, changes and removals of bodies count.
    ///
    /// # Errors
    ///
    /// As [`ClientSession::command`].
    pub fn remove_unused_shapes(&mut self, session: &mut ClientSession) -> Result<usize, Misuse> {
        let Some(replica) = session.replica() else {
            return Ok(0);
        };
        let mut used = vec![false; SHAPES_MAX as usize];
        let mut leaves = vec![false; replica.stream().index_end()];
        for (_, body) in &self.bodies {
            let (flags, place) = match *body {
                BodyChange::Takes(shape) => (&mut used, shape.0),
                BodyChange::Leaves(id) => (&mut leaves, id.index()),
            };
            if let Some(flag) = flags.get_mut(place as usize) {
                *flag = true;
            }
        }
        for body in replica.bodies() {
            if !leaves[body.id.index() as usize] {
                used[body.shape.0 as usize] = true;
            }
        }
        let is_used = |id: ShapeId| used[id.0 as usize];
        let unused = self.shapes.unused(is_used, |id| replica.shape(id));
        for id in &unused {
            let number = session.command(Command::RemoveShape { id: *id })?;
            self.last_command = Some(number);
            self.shapes.remove(*id, number);
        }
        Ok(unused.len())
    }

    /// Queues a body under a new id, and its shape unless the scene has an equal one.
    ///
    /// # Errors
    ///
    /// [`AddError`] when no id or no number of a shape is left, or a number is invalid.
    pub fn add_body(
        &mut self,
        session: &mut ClientSession,
        body: &BodyBuilder,
        motion: BodyState,
    ) -> Result<BodyId, AddError> {
        check_inside(body)?;
        let slot = self.shape_slot(session, body.shape(), &mut BTreeMap::new())?;
        self.check_ids_left(1)?;
        self.queue_body(session, body, motion, slot)
    }

    /// Queues bodies as [`Self::add_body`] does, and returns their ids in the same order. Equal shapes are queued once.
    ///
    /// # Errors
    ///
    /// As [`Self::add_body`]. If ids or numbers of shapes are left for some of the bodies only, none is queued.
    pub fn add_bodies(
        &mut self,
        session: &mut ClientSession,
        bodies: &[(BodyBuilder, BodyState)],
    ) -> Result<Vec<BodyId>, AddError> {
        let (mut slots, mut planned) = (Vec::with_capacity(bodies.len()), BTreeMap::new());
        for (body, _) in bodies {
            check_inside(body)?;
            slots.push(self.shape_slot(session, body.shape(), &mut planned)?);
        }
        self.check_ids_left(u32::try_from(bodies.len()).unwrap_or(u32::MAX))?;
        let mut ids = Vec::with_capacity(bodies.len());
        for ((body, motion), slot) in bodies.iter().zip(slots) {
            ids.push(self.queue_body(session, body, *motion, slot)?);
        }
        Ok(ids)
    }

    fn check_ids_left(&self, count: u32) -> Result<(), Misuse> {
        match self.ids.available() < count {
            true => Err(Misuse::Indices(count)),
            false => Ok(()),
        }
    }

    /// The number of a body's shape. `planned`: shapes that earlier bodies of a batch add; a new shape is added to them.
    fn shape_slot<'a>(
        &self,
        session: &ClientSession,
        shape: &'a Shape,
        planned: &mut BTreeMap<ShapeId, &'a Shape>,
    ) -> Result<ShapeSlot, AddError> {
        let replica = session.replica();
        let known = |id: ShapeId| {
            let in_scene = replica.and_then(|replica| replica.shape(id));
            planned.get(&id).copied().or(in_scene)
        };
        let slot = self.shapes.find(shape, known);
        Ok(match slot.ok_or(AddError::TooManyShapes)? {
            // The number of a shape that is being removed is free once for an equal one.
            ShapeSlot::Free(id) if planned.insert(id, shape).is_some() => ShapeSlot::Known(id),
            slot => slot,
        })
    }

    /// Queues a body under the next id, after its shape unless that is known.
    fn queue_body(
        &mut self,
        session: &mut ClientSession,
        body: &BodyBuilder,
        motion: BodyState,
        slot: ShapeSlot,
    ) -> Result<BodyId, AddError> {
        let id = self.ids.take().ok_or(Misuse::Indices(1))?;
        let shape = self.queue_shape(session, body.shape(), slot, id)?;
        let desc = body.desc(id, shape);
        let number = self.queue(session, Command::AddBody { desc, motion }, IdSource::Client)?;
        self.clashes.add(desc, number);
        Ok(id)
    }

    /// Queues the shape of a body unless its number is known; returns the number.
    fn queue_shape(
        &mut self,
        session: &mut ClientSession,
        shape: &Shape,
        slot: ShapeSlot,
        body: BodyId,
    ) -> Result<ShapeId, Misuse> {
        match slot {
            ShapeSlot::Known(id) => Ok(id),
            ShapeSlot::Free(id) => {
                let shape = shape.clone();
                let number = self.command(session, Command::AddShape { id, shape })?;
                self.command_bodies.add(number, body);
                self.shapes.add_of_body(id);
                Ok(id)
            }
        }
    }

    /// Queues what mends bodies that have another client's shape; returns when the session takes no command now.
    fn mend_shapes(&mut self, session: &mut ClientSession) {
        while let Some(wrong) = self.clashes.next_wrong() {
            if self.mend_shape(session, &wrong).is_err() {
                return;
            }
            self.clashes.end_wrong();
        }
    }

    fn mend_shape(&mut self, session: &mut ClientSession, wrong: &WrongBody) -> Result<(), Misuse> {
        let shape = wrong.shape.as_ref();
        let slot = shape.map(|shape| self.shape_slot(session, shape, &mut BTreeMap::new()));
        let (Some(shape), Some(Ok(slot))) = (shape, slot) else {
            // It cannot be changed, or no number is left for its shape.
            let removal = Command::RemoveBody { id: wrong.desc.id };
            let number = self.command(session, removal)?;
            self.clashes.add_removal(number);
            return Ok(());
        };
        let shape = self.queue_shape(session, shape, slot, wrong.desc.id)?;
        let desc = BodyDesc {
            shape,
            ..wrong.desc
        };
        let number = self.command(session, Command::ChangeBody { desc })?;
        self.clashes.add_change(desc, number);
        Ok(())
    }

    /// Updates ids and shape numbers from an event, and queues what it calls for; returns whether the event is passed to
    /// the caller.
    pub fn note(&mut self, event: &Event, session: &mut ClientSession) -> bool {
        let is_passed = self.take_event(event, session.replica());
        self.mend_shapes(session);
        is_passed
    }

    /// The refusal that an event reports, of those that [`Self::note`] passes to the caller.
    #[must_use]
    pub fn refusal(&self, event: &Event) -> Option<RefusedRequest> {
        self.command_bodies.refusal(event)
    }

    fn take_event(&mut self, event: &Event, replica: Option<&Replica>) -> bool {
        let known = |id| replica.and_then(|replica| replica.shape(id));
        let is_gone = |id: BodyId| {
            replica.is_some_and(|replica| replica.stream().body(id.index()) != Some(id))
        };
        match *event {
            Event::Reserved(range) => {
                self.ids.grant(range);
                return false;
            }
            Event::Refused { number, error } => {
                if let Some(id) = self.own_bodies.handle_refused(number, error) {
                    self.ids.release(id);
                }
                let is_own = self.clashes.handle_refused(number, error);
                return match self.shapes.handle_refused(number, error, known) {
                    ShapeRefusal::Reported => !is_own,
                    ShapeRefusal::Harmless => false,
                    ShapeRefusal::Taken(id, shape) => {
                        self.clashes.handle_taken(number, id, shape);
                        false
                    }
                };
            }
            Event::Applied { through, .. } => {
                self.command_bodies.handle_applied(through);
                self.shapes.handle_applied(through);
                self.clashes.handle_applied(through, known);
                let gone = self.own_bodies.handle_applied(through, is_gone);
                gone.into_iter().for_each(|id| self.ids.release(id));
                while self
                    .bodies
                    .pop_front_if(|(command, _)| *command <= through)
                    .is_some()
                {}
            }
            Event::Resumed(state) => {
                let gone = self.own_bodies.handle_resumed(state.commands, is_gone);
                gone.into_iter().for_each(|id| self.ids.release(id));
            }
            Event::BodyRemoved { id, .. } if self.own_bodies.remove(id) => self.ids.release(id),
            _ => {}
        }
        true
    }
}

/// Refuses a body that no engine can move as it is to be moved.
fn check_inside(body: &BodyBuilder) -> Result<(), Misuse> {
    match body.kind() == BodyKind::Dynamic && !body.shape().is_solid() {
        true => Err(Misuse::NoInside),
        false => Ok(()),
    }
}

/// Reason why the addition of a body is not queued.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AddError {
    /// The caller's own mistake.
    Misuse(Misuse),
    /// All shape numbers of the scene are in use.
    TooManyShapes,
}

impl From<Misuse> for AddError {
    fn from(misuse: Misuse) -> Self {
        Self::Misuse(misuse)
    }
}

impl fmt::Display for AddError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Misuse(misuse) => misuse.fmt(f),
            Self::TooManyShapes => write!(
                f,
                "the scene has {SHAPES_MAX} shapes, as many as it may; remove one that no body has, or use equal shapes"
            ),
        }
    }
}

impl std::error::Error for AddError {}
