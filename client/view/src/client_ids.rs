//! Body ids and shape numbers for the commands of one client.
//!
//! Queues commands at the session and never waits. Body ids are of granted ranges and used again. Invariants: no id is
//! allocated twice, and an id is done with once.

use core::fmt;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

use rhumb_protocol::limits::{GRANT, GRANTED_MAX, SHAPES_MAX};
use rhumb_protocol::scene::{
    BodyBuilder, BodyDesc, BodyKind, Command, CommandError, IdRange, Shape, ShapeId,
};
use rhumb_protocol::session::{ClientSession, Event, Misuse};
use rhumb_reckoning::{BodyId, BodyState};

use crate::shapes::{ShapeClashes, ShapeNumbers, ShapeRefusal, ShapeSlot, WrongBody};
use crate::unanswered::{CommandBodies, RefusedRequest, Unanswered};

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
    /// number. Queued additions, changes and removals of bodies count. The server keeps a shape that a body elsewhere has, in
    /// a cell that is not taken.
    ///
    /// # Errors
    ///
    /// As [`ClientSession::command`].
    pub fn remove_unused_shapes(&mut self, session: &mut ClientSession) -> Result<usize, Misuse> {
        let Some(replica) = session.replica() else {
            return Ok(0);
        };
        let mut used = vec![false; SHAPES_MAX as usize];
        let mut leaves = BTreeSet::new();
        for (_, body) in &self.bodies {
            match *body {
                BodyChange::Takes(shape) => {
                    let flag = used.get_mut(shape.0 as usize);
                    flag.into_iter().for_each(|flag| *flag = true);
                }
                BodyChange::Leaves(id) => drop(leaves.insert(id.index())),
            }
        }
        let of_cells = session.cells().map(|(_, copy)| copy);
        for copy in std::iter::once(replica).chain(of_cells) {
            for body in copy.bodies() {
                let id = copy.id_in_scene(body.id).unwrap_or(body.id);
                used[body.shape.0 as usize] |= !leaves.contains(&id.index());
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
        let is_passed = self.take_event(event, session);
        self.mend_shapes(session);
        is_passed
    }

    /// The refusal that an event reports, of those that [`Self::note`] passes to the caller.
    #[must_use]
    pub fn refusal(&self, event: &Event) -> Option<RefusedRequest> {
        self.command_bodies.refusal(event)
    }

    /// The body that a command would have added, before [`Self::note`] has handled its refusal; `None` for any other command.
    #[must_use]
    pub fn refused_addition(&self, command: u64) -> Option<BodyId> {
        let id = self.command_bodies.get(command)?;
        let addition = self.own_bodies.get(id)?;
        (addition.command == command).then_some(id)
    }

    fn take_event(&mut self, event: &Event, session: &ClientSession) -> bool {
        let replica = session.replica();
        let known = |id| replica.and_then(|replica| replica.shape(id));
        // A member by cells does not know of a body elsewhere.
        let knows_all = session.cell_grid().is_none();
        let is_gone = |id: BodyId| {
            knows_all
                && replica.is_some_and(|replica| replica.stream().body(id.index()) != Some(id))
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

/// The ids of one client in one scene.
#[derive(Debug)]
struct IdAllocator {
    ranges: Vec<IdRange>,
    /// Position of the range in use, and the number of its indices that are allocated.
    next: (usize, u32),
    /// For each index of a removed or refused body, the id of the next generation.
    free: Vec<BodyId>,
}

impl IdAllocator {
    pub(crate) fn new(granted: IdRange) -> Self {
        Self {
            ranges: vec![granted],
            next: (0, 0),
            free: Vec::new(),
        }
    }

    /// Adds a range that the server granted.
    fn grant(&mut self, range: IdRange) {
        self.ranges.push(range);
    }

    /// Number of granted indices in all ranges.
    pub(crate) fn granted(&self) -> u32 {
        self.ranges.iter().map(IdRange::count).sum()
    }

    /// Number of ids that can be allocated before another grant.
    fn available(&self) -> u32 {
        let (place, given) = self.next;
        let fresh: u32 = self.ranges[place..].iter().map(IdRange::count).sum();
        fresh - given + self.free.len() as u32
    }

    /// Allocates an id: an unused index while there is one, then the index of a body that is gone.
    pub(crate) fn take(&mut self) -> Option<BodyId> {
        loop {
            let (place, given) = self.next;
            if let Some(id) = self.ranges[place].id(given) {
                self.next.1 += 1;
                return Some(id);
            }
            if place + 1 == self.ranges.len() {
                return self.free.pop();
            }
            self.next = (place + 1, 0);
        }
    }

    /// Frees the index of a removed or refused body for its next generation, if this client was granted the index. The
    /// id of a refused body is not allocated again: commands that name it may be under way.
    fn release(&mut self, id: BodyId) {
        let ours = self.ranges.iter().any(|range| range.contains(id));
        if ours && let Some(generation) = id.generation().checked_add(1) {
            self.free.push(BodyId::new(id.index(), generation));
        }
    }
}

/// The bodies of one client in one scene, from the command that adds each of them.
#[derive(Debug, Default)]
struct OwnBodies {
    by_index: Vec<Option<Addition>>,
    /// Bodies whose addition the server has not answered yet.
    unanswered: Unanswered<BodyId>,
}

/// The command that adds a body.
#[derive(Clone, Copy, Debug)]
struct Addition {
    command: u64,
    generation: u16,
    id_source: IdSource,
}

/// The origin of a body's id.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum IdSource {
    /// The client took it for this body alone.
    Client,
    /// The caller named it, and may add the body again under it. It is done with when such a body is removed.
    Caller,
}

impl OwnBodies {
    /// Stores a body whose addition is queued.
    pub(crate) fn add(&mut self, id: BodyId, command: u64, id_source: IdSource) {
        if id_source == IdSource::Client {
            self.unanswered.insert(command, id);
        }
        if self.get(id).is_some() {
            return;
        }
        let (index, generation) = (id.index() as usize, id.generation());
        if index >= self.by_index.len() {
            self.by_index.resize(index + 1, None);
        }
        self.by_index[index] = Some(Addition {
            command,
            generation,
            id_source,
        });
    }

    /// Handles a refusal; returns the id that is done with. The server never placed its body.
    pub(crate) fn handle_refused(&mut self, command: u64, error: CommandError) -> Option<BodyId> {
        let id = self.unanswered.remove(command)?;
        self.get(id).filter(|known| known.command == command)?;
        self.remove(id);
        // An index that another body has, or that is not this client's, is not this client's to give out.
        let usable = !matches!(
            error,
            CommandError::BodyIdTaken(_) | CommandError::NotGranted(_)
        );
        usable.then_some(id)
    }

    /// Handles the answer to all commands up to this number; returns the ids that are done with. A body that the scene
    /// does not have now was removed, or refused while no connection was there.
    pub(crate) fn handle_applied(
        &mut self,
        through: u64,
        is_gone: impl Fn(BodyId) -> bool,
    ) -> Vec<BodyId> {
        let answered = self.unanswered.take_through(through).into_iter();
        let mut gone: Vec<_> = answered.map(|(_, id)| id).collect();
        gone.retain(|id| is_gone(*id) && self.remove(*id));
        gone
    }

    /// Handles the begin of another connection, over which commands from this number on are sent again; returns the ids
    /// that are done with. No connection carried the removals of their bodies.
    fn handle_resumed(&mut self, commands: u64, is_gone: impl Fn(BodyId) -> bool) -> Vec<BodyId> {
        let mut gone = Vec::new();
        for (index, addition) in (0..).zip(&self.by_index) {
            let addition = addition.filter(|known| known.id_source == IdSource::Client);
            let Some(addition) = addition else {
                continue;
            };
            let id = BodyId::new(index, addition.generation);
            if addition.command >= commands {
                self.unanswered.insert(addition.command, id);
            } else if !self.unanswered.has(addition.command) && is_gone(id) {
                gone.push(id);
            }
        }
        gone.retain(|id| self.remove(*id));
        gone
    }

    /// Handles the removal of a body; true if its id is done with now.
    pub(crate) fn remove(&mut self, id: BodyId) -> bool {
        let is_known = self.get(id).is_some();
        if is_known {
            self.by_index[id.index() as usize] = None;
        }
        is_known
    }

    fn get(&self, id: BodyId) -> Option<Addition> {
        let addition = *self.by_index.get(id.index() as usize)?;
        addition.filter(|addition| addition.generation == id.generation())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_come_from_each_range_once_and_then_from_removed_bodies() {
        let mut ids = IdAllocator::new(IdRange::new(10, 2, 3).unwrap());
        assert_eq!((ids.available(), ids.granted()), (2, 2));
        assert_eq!(ids.take(), Some(BodyId::new(10, 3)));
        assert_eq!(ids.take(), Some(BodyId::new(11, 3)));
        assert_eq!((ids.take(), ids.available()), (None, 0));
        ids.grant(IdRange::new(40, 1, 0).unwrap());
        ids.release(BodyId::new(10, 3));
        assert_eq!(ids.available(), 2);
        assert_eq!(ids.take(), Some(BodyId::new(40, 0)));
        assert_eq!(ids.take(), Some(BodyId::new(10, 4)));
        assert_eq!((ids.take(), ids.granted()), (None, 3));
    }

    #[test]
    fn the_index_of_another_client_and_one_without_generations_left_are_not_reused() {
        let mut ids = IdAllocator::new(IdRange::new(0, 1, 0).unwrap());
        ids.take();
        ids.release(BodyId::new(5, 0));
        ids.release(BodyId::new(0, u16::MAX));
        assert_eq!(ids.take(), None);
    }

    const ID: BodyId = BodyId::new(3, 0);

    #[test]
    fn an_id_is_done_with_once() {
        let mut bodies = OwnBodies::default();
        bodies.add(ID, 7, IdSource::Client);
        // The engine failed on a command that was applied: the body is removed as well.
        let error = CommandError::EngineFailed;
        assert_eq!(bodies.handle_refused(7, error), Some(ID));
        assert_eq!(bodies.handle_refused(7, error), None);
        assert!(!bodies.remove(ID));
        bodies.add(ID, 8, IdSource::Client);
        assert_eq!(bodies.handle_applied(8, |_| false), []);
        assert_eq!(bodies.handle_refused(8, error), None);
        assert!(bodies.remove(ID));
        assert!(!bodies.remove(ID));
    }

    #[test]
    fn a_body_that_another_connection_finds_gone_is_done_with_unless_it_is_added_again() {
        let mut bodies = OwnBodies::default();
        let ids = [0, 1, 2].map(|index| BodyId::new(index, 0));
        for (id, command) in ids.into_iter().zip(0..) {
            bodies.add(id, command, IdSource::Client);
        }
        assert_eq!(bodies.handle_applied(1, |_| false), []);
        // The scene is restored to a moment before the second body was added.
        assert_eq!(bodies.handle_resumed(1, |_| true), [ids[0]]);
        assert!(!bodies.remove(ids[0]));
        let second = |id| id == ids[1];
        assert_eq!(bodies.handle_applied(2, second), [ids[1]]);
        assert_eq!(bodies.handle_resumed(3, |_| false), []);
        assert!(bodies.remove(ids[2]));
    }

    #[test]
    fn an_id_that_is_taken_or_that_the_caller_named_is_not_done_with() {
        let mut bodies = OwnBodies::default();
        let taken = [
            CommandError::BodyIdTaken(ID),
            CommandError::NotGranted(ID),
            CommandError::TooManyBodies,
        ];
        let id_sources = [IdSource::Client, IdSource::Client, IdSource::Caller];
        for (command, (error, id_source)) in (0..).zip(taken.into_iter().zip(id_sources)) {
            bodies.add(ID, command, id_source);
            assert_eq!(bodies.handle_refused(command, error), None, "{error}");
        }
        // One of two bodies of the id is refused, and the other stays.
        for refused in [5, 6] {
            bodies.add(ID, 5, IdSource::Caller);
            bodies.add(ID, 6, IdSource::Caller);
            let error = CommandError::BodyIdTaken(ID);
            assert_eq!(bodies.handle_refused(refused, error), None);
            assert_eq!(bodies.handle_applied(6, |_| false), []);
            assert!(bodies.remove(ID));
        }
        // It may be added again, although the answer was lost.
        bodies.add(ID, 7, IdSource::Caller);
        assert_eq!(bodies.handle_applied(7, |_| true), []);
        assert_eq!(bodies.handle_resumed(8, |_| true), []);
    }
}
