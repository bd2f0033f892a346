//! The cells of a scene: which bodies each has, and its streams.
//!
//! A cell that a member takes has streams and scene events of its own, as a scene has. A body that crosses leaves the old
//! cell and arrives in the new one at one published tick, before that tick is published, so that both tell of it at that
//! tick. Members are known to the running scene alone. Invariants: each body is in one cell, or, if it is too large for
//! any, in what all members have in common; a scene without members that take cells keeps nothing here.

use std::collections::{BTreeMap, BTreeSet};

use bytes::Bytes;
use rhumb_protocol::Peer;
use rhumb_protocol::message::{CellNews, SceneEvent, ServerMessage};
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::{
    BodyDesc, Cell, CellGrid, Joint, JointId, PublishSchedule, SceneConfig,
};
use rhumb_protocol::stream::Observation;
use rhumb_reckoning::{BodyId, BodyState, Tick, Ticks, Track};

use crate::engine::StepThreads;
use crate::scene::Scene;
use crate::streams::{self, Stream, Streams};
use crate::taken_cell::{CellIds, TakenCell};

/// Cells of one scene that members take, at most: each has tables of its own.
pub(crate) const TAKEN_CELLS_MAX: usize = 4_096;

/// The cells of one scene.
#[derive(Debug)]
pub(crate) struct Cells {
    grid: CellGrid,
    publish_schedule: PublishSchedule,
    threads: StepThreads,
    /// Members that take cells. Without any, nothing below is kept.
    members: usize,
    /// By index.
    homes: Vec<Option<Home>>,
    /// The bodies of each cell, and of what is common to all.
    bodies: BTreeMap<Option<Cell>, BTreeSet<BodyId>>,
    /// The cells that members take; the place 0 is what they have in common.
    taken: Vec<Option<TakenCell>>,
    places: BTreeMap<Option<Cell>, usize>,
    /// Places in `taken` of cells that no member takes any more.
    vacant: BTreeSet<usize>,
    /// The names of all streams.
    names: BTreeSet<StreamId>,
    /// The newest tick, and the newest published one.
    tick: Tick,
    published: Tick,
    sent_joints: SentJoints,
    /// Scene events that members have not got yet, in order: the cell, and their messages.
    unsent: Vec<(Option<Cell>, Vec<u8>)>,
}

/// Where a body is.
#[derive(Clone, Copy, Debug)]
struct Home {
    id: BodyId,
    cell: Option<Cell>,
    /// The place of the cell in `taken`, and the body's id there; `None` for a cell that no member takes.
    taken: Option<(usize, BodyId)>,
}

/// The joints that members know, each with its place in `taken`; found by their bodies too.
#[derive(Debug, Default)]
struct SentJoints {
    by_id: BTreeMap<JointId, (usize, [BodyId; 2])>,
    by_body: BTreeSet<(BodyId, JointId)>,
}

impl SentJoints {
    fn insert(&mut self, id: JointId, place: usize, bodies: [BodyId; 2]) {
        self.remove(id);
        self.by_id.insert(id, (place, bodies));
        self.by_body.extend(bodies.map(|body| (body, id)));
    }

    /// Forgets a joint; returns its place.
    fn remove(&mut self, id: JointId) -> Option<usize> {
        let (place, bodies) = self.by_id.remove(&id)?;
        for body in bodies {
            self.by_body.remove(&(body, id));
        }
        Some(place)
    }

    /// Forgets the joints of a body.
    fn forget(&mut self, body: BodyId) {
        let all = (body, JointId(0))..=(body, JointId(u32::MAX));
        let ids: Vec<_> = self.by_body.range(all).map(|(_, id)| *id).collect();
        for id in ids {
            self.remove(id);
        }
    }
}

/// Why a body comes into a cell.
#[derive(Clone, Copy, Debug)]
enum PlacementCause {
    /// It is new in the scene.
    Addition,
    /// It was in another cell until the newest tick.
    Crossing,
}

/// The state of a body that is placed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placement {
    pub(crate) desc: BodyDesc,
    pub(crate) motion: BodyState,
    pub(crate) track: Track,
}

impl Placement {
    fn of(scene: &Scene, observation: &Observation) -> Option<Self> {
        let desc = *scene.body(observation.id)?;
        let state = (observation.motion, observation.activity);
        let tumbles = scene.inertia(desc.id).is_some();
        Some(Self {
            desc,
            motion: observation.motion,
            track: streams::first_track(scene.tick(), state, &desc, tumbles),
        })
    }
}

impl Cells {
    /// The cells of a scene; `None` if it is not divided. With a lookahead, what is published is not of the newest tick,
    /// where bodies cross.
    pub(crate) fn of_scene(
        config: &SceneConfig,
        grid: Option<CellGrid>,
        threads: &StepThreads,
    ) -> Option<Self> {
        let schedule = config.publish_schedule;
        let grid = grid.filter(|_| schedule.lookahead == Ticks::ZERO)?;
        Some(Self::new(grid, schedule, threads.clone()))
    }

    /// The cells of a scene that publishes by this schedule, on these threads.
    fn new(grid: CellGrid, publish_schedule: PublishSchedule, threads: StepThreads) -> Self {
        Self {
            grid,
            publish_schedule,
            threads,
            members: 0,
            homes: Vec::new(),
            bodies: BTreeMap::new(),
            taken: Vec::new(),
            places: BTreeMap::new(),
            vacant: BTreeSet::new(),
            names: BTreeSet::new(),
            tick: Tick::ZERO,
            published: Tick::ZERO,
            sent_joints: SentJoints::default(),
            unsent: Vec::new(),
        }
    }

    /// The grid.
    pub(crate) const fn grid(&self) -> &CellGrid {
        &self.grid
    }

    /// True while a member takes cells.
    pub(crate) const fn is_used(&self) -> bool {
        self.members > 0
    }

    /// Number of cells that are taken.
    pub(crate) fn taken_count(&self) -> usize {
        self.places.len()
    }

    /// Adds a member. With the first one, all bodies find their cells.
    pub(crate) fn enter(&mut self, scene: &Scene) {
        self.members += 1;
        if self.members > 1 {
            return;
        }
        (self.tick, self.published) = (scene.tick(), scene.tick());
        let mut observations = Vec::new();
        scene.observe_all(&mut observations);
        for observation in &observations {
            let (id, motion) = (observation.id, observation.motion);
            let cell = self.cell_of(scene, id, &motion);
            self.set_home(id, cell);
        }
        self.take(None, scene);
    }

    /// Removes a member, which has given up all of its streams.
    pub(crate) fn leave(&mut self) {
        self.members -= 1;
        if self.members == 0 {
            let schedule = self.publish_schedule;
            *self = Self::new(self.grid, schedule, self.threads.clone());
        }
    }

    /// The streams of a cell that is taken, or of what is common.
    pub(crate) fn streams(&self, cell: Option<Cell>) -> Option<&Streams> {
        Some(&self.taken_cell(cell)?.streams)
    }

    /// See [`Self::streams`].
    pub(crate) fn streams_mut(&mut self, cell: Option<Cell>) -> Option<&mut Streams> {
        let place = *self.places.get(&cell)?;
        Some(&mut self.taken_mut(place)?.streams)
    }

    /// Begins a stream of a cell that is taken, for one member.
    pub(crate) fn begin(&mut self, cell: Option<Cell>, stream: Stream) {
        let name = stream.id();
        if let Some(streams) = self.streams_mut(cell) {
            streams.begin(stream);
            self.names.insert(name);
        }
    }

    /// Ends a member's subscription to a stream.
    pub(crate) fn unsubscribe(&mut self, cell: Option<Cell>, stream: StreamId, peer: Peer) {
        if let Some(streams) = self.streams_mut(cell) {
            streams.unsubscribe(stream, peer);
            if streams.get(stream).is_none() {
                self.names.remove(&stream);
            }
        }
    }

    /// Scene events of a cell so far.
    pub(crate) fn scene_events(&self, cell: Option<Cell>) -> u64 {
        self.taken_cell(cell).map_or(0, |taken| taken.scene_events)
    }

    /// True if a stream is one of a cell.
    pub(crate) fn has_stream(&self, id: StreamId) -> bool {
        self.names.contains(&id)
    }

    fn taken_cell(&self, cell: Option<Cell>) -> Option<&TakenCell> {
        self.taken[*self.places.get(&cell)?].as_ref()
    }

    /// A taken cell that is about to change.
    fn taken_mut(&mut self, place: usize) -> Option<&mut TakenCell> {
        let taken = self.taken[place].as_mut()?;
        taken.wake(self.published);
        Some(taken)
    }

    /// Makes a cell one that is taken. It has no streams yet.
    pub(crate) fn take(&mut self, cell: Option<Cell>, scene: &Scene) {
        if self.places.contains_key(&cell) {
            return;
        }
        let place = self.vacant.pop_first().unwrap_or(self.taken.len());
        if place == self.taken.len() {
            self.taken.push(None);
        }
        let mut ids = CellIds::default();
        for id in self.bodies.get(&cell).into_iter().flatten() {
            let local = cell.map_or(*id, |_| ids.assign());
            if let Some(home) = &mut self.homes[id.index() as usize] {
                home.taken = Some((place, local));
            }
        }
        let streams = Streams::new(self.publish_schedule, self.threads.clone());
        self.taken[place] = Some(TakenCell::new(cell, streams, ids));
        self.places.insert(cell, place);
        for (id, joint) in self.joints_of(cell, scene) {
            if self
                .place_of_joint(&joint)
                .is_some_and(|(at, _)| at == place)
            {
                self.sent_joints.insert(id, place, joint.bodies);
            }
        }
    }

    /// The joints of a cell's bodies, each once, in the order of ids; those to bodies of other cells too.
    fn joints_of(&self, cell: Option<Cell>, scene: &Scene) -> BTreeMap<JointId, Joint> {
        let bodies = self.bodies.get(&cell).into_iter().flatten();
        let joints = bodies.flat_map(|body| scene.joints().of_body(*body));
        joints.map(|(id, joint)| (id, *joint)).collect()
    }

    /// Forgets the streams of a cell that no member takes any more.
    pub(crate) fn give_up(&mut self, cell: Cell) {
        let is_empty = self.streams(Some(cell)).is_some_and(Streams::is_empty);
        if !is_empty {
            return;
        }
        let Some(place) = self.places.remove(&Some(cell)) else {
            return;
        };
        self.taken[place] = None;
        self.vacant.insert(place);
        for id in self.bodies.get(&Some(cell)).into_iter().flatten() {
            self.sent_joints.forget(*id);
            if let Some(home) = &mut self.homes[id.index() as usize] {
                home.taken = None;
            }
        }
    }

    /// The bodies of a cell, by their ids there, for a stream that begins.
    pub(crate) fn placements(&self, cell: Option<Cell>, scene: &Scene) -> Vec<(BodyId, Placement)> {
        let ids = self.bodies.get(&cell).into_iter().flatten();
        let placed = ids.filter_map(|id| {
            let (_, local) = self.home(*id)?.taken?;
            let placement = Placement::of(scene, &scene.observation_at_tick(*id)?)?;
            Some((local, placement))
        });
        placed.collect()
    }

    /// Publishes the newest tick of every cell in which something is to be said.
    pub(crate) fn publish(&mut self) {
        let (threads, tick) = (self.threads.clone(), self.tick);
        let is_published = self.published == tick;
        threads.on_each(&mut self.taken, |taken| {
            if let Some(taken) = taken {
                taken.publish(tick, is_published);
            }
        });
    }

    /// The streams of the cells that were published at the newest tick, by cell; the first is what is common.
    pub(crate) fn speaking(&self) -> BTreeMap<Option<Cell>, &Streams> {
        let taken = self.taken.iter().flatten();
        let speaking = taken.filter(|taken| taken.speaks_at(self.tick));
        speaking.map(|taken| (taken.cell, &taken.streams)).collect()
    }

    /// Bodies whose updates wait for a budget, in all streams.
    pub(crate) fn waiting(&self) -> usize {
        let taken = self.taken.iter().flatten();
        taken.map(|taken| taken.streams.waiting()).sum()
    }

    /// The datagrams of the newest tick of all streams, without repair symbols.
    pub(crate) fn all_packets(&self) -> impl Iterator<Item = &Bytes> {
        let taken = self.taken.iter().flatten();
        let speaking = taken.filter(|taken| taken.speaks_at(self.tick));
        speaking.flat_map(|taken| taken.streams.all_packets())
    }

    /// Takes the scene events that members have not got yet, in order.
    pub(crate) fn take_unsent(&mut self) -> Vec<(Option<Cell>, Vec<u8>)> {
        std::mem::take(&mut self.unsent)
    }
}

impl Cells {
    /// Lets bodies cross at a published tick, and stores the observations of each cell. `silences`: the events of bodies
    /// whose publisher is silent.
    pub(crate) fn observe(&mut self, scene: &Scene, silences: &[SceneEvent]) {
        let (tick, observations) = (scene.tick(), scene.observations());
        let is_published = self.publish_schedule.publishes(tick);
        if is_published {
            self.cross(scene, observations, silences);
        }
        for taken in self.taken.iter_mut().flatten() {
            taken.observed.clear();
        }
        for observation in observations {
            let home = self.home(observation.id).and_then(|home| home.taken);
            if let Some((place, local)) = home
                && let Some(taken) = &mut self.taken[place]
            {
                taken.observed.push(Observation {
                    id: local,
                    ..*observation
                });
            }
        }
        for taken in self.taken.iter_mut().flatten() {
            taken.observe(tick, self.published);
        }
        self.tick = tick;
        if is_published {
            self.published = tick;
        }
    }

    /// Bodies leave and arrive. All arrive before any leaves, so that a member of both cells always has them.
    fn cross(&mut self, scene: &Scene, observations: &[Observation], silences: &[SceneEvent]) {
        let mut crossing = Vec::new();
        for observation in observations {
            let home = self.home(observation.id).copied();
            if let Some(home) = home
                && let Some(cell) = home.cell
            {
                let next = self.grid.next_cell(cell, position(&observation.motion));
                if next != cell {
                    crossing.push((home, next, observation));
                }
            }
        }
        // The events of a cell are then one run of bytes.
        crossing.sort_by_key(|(_, next, _)| *next);
        for (home, next, observation) in &crossing {
            self.sent_joints.forget(home.id);
            self.set_home(home.id, Some(*next));
            if let Some(placement) = Placement::of(scene, observation) {
                self.arrive(scene, &placement, PlacementCause::Crossing);
                self.tell_silence(home.id, silences);
            }
        }
        crossing.sort_by_key(|(home, ..)| home.cell);
        for (home, ..) in &crossing {
            self.depart(home, scene.tick());
        }
    }

    /// Tells a cell of a body that is new there, with its joints to other bodies of the cell.
    fn arrive(&mut self, scene: &Scene, placement: &Placement, cause: PlacementCause) {
        let id = placement.desc.id;
        let Some(home) = self.home(id).copied() else {
            return;
        };
        let Some((place, local)) = home.taken else {
            return;
        };
        self.put(scene, (place, local), placement);
        let Placement { desc, track, .. } = placement;
        let (id_in_scene, placed) = (desc.id, placed(scene, (*desc, local), *track, None));
        let news = match cause {
            PlacementCause::Crossing => CellNews::Arrived {
                id: id_in_scene,
                placed,
            },
            PlacementCause::Addition => CellNews::Placed {
                id: id_in_scene,
                placed,
            },
        };
        self.record(place, news);
        let joints: Vec<_> = (scene.joints().of_body(id))
            .map(|(id, joint)| (id, *joint))
            .collect();
        for (joint_id, joint) in joints {
            self.tell_joint(joint_id, &joint);
        }
    }

    /// Tells the cell that a body has left.
    fn depart(&mut self, home: &Home, tick: Tick) {
        let Some((place, local)) = home.taken else {
            return;
        };
        if let Some(taken) = self.taken_mut(place) {
            taken.streams.remove(local);
            taken.ids.release(local);
        }
        self.record(place, CellNews::Departed { id: local, tick });
    }

    /// Places a new or changed body in the streams of its cell, and tells of it.
    pub(crate) fn place(&mut self, scene: &Scene, placement: &Placement) {
        let id = placement.desc.id;
        let before = self.home(id).copied();
        let at = position(&placement.motion);
        // A changed body stays what it was: of a cell or not.
        let cell = match before {
            Some(Home {
                cell: Some(cell), ..
            }) => Some(self.grid.next_cell(cell, at)),
            Some(Home { cell: None, .. }) => None,
            None => self.cell_of(scene, id, &placement.motion),
        };
        if let Some(before) = before.filter(|before| before.cell == cell) {
            if let Some((place, local)) = before.taken {
                self.put(scene, (place, local), placement);
                let Placement { desc, track, .. } = *placement;
                let placed = placed(scene, (desc, local), track, None);
                self.record(place, CellNews::Placed { id, placed });
            }
            return;
        }
        self.sent_joints.forget(id);
        self.set_home(id, cell);
        let cause = before.map_or(PlacementCause::Addition, |_| PlacementCause::Crossing);
        self.arrive(scene, placement, cause);
        if let Some(before) = before {
            self.depart(&before, scene.tick());
        }
    }

    /// Learns from a scene event, and sends it to the members of the cells that it is about. Bodies are placed by [`Self::place`].
    pub(crate) fn note(&mut self, scene_event: &SceneEvent) {
        match scene_event {
            SceneEvent::ShapeAdded { .. }
            | SceneEvent::ShapeRemoved { .. }
            | SceneEvent::SceneFaulted { .. }
            | SceneEvent::SceneRestored { .. }
            | SceneEvent::Unknown { .. } => {
                if let Some(place) = self.places.get(&None) {
                    self.record(*place, CellNews::SceneEvent(scene_event.clone()));
                }
            }
            SceneEvent::GravityChanged { since, gravity } => {
                for place in 0..self.taken.len() {
                    if let Some(taken) = self.taken_mut(place) {
                        taken.streams.change_gravity(*since, *gravity);
                        self.record(place, CellNews::SceneEvent(scene_event.clone()));
                    }
                }
            }
            SceneEvent::BodyPlaced { .. } => {}
            SceneEvent::BodyRemoved { id, cause } => {
                if let Some((place, local)) = self.remove(*id) {
                    let (id, cause) = (local, *cause);
                    let removed = SceneEvent::BodyRemoved { id, cause };
                    self.record(place, CellNews::SceneEvent(removed));
                }
            }
            SceneEvent::JointAdded { id, joint } => self.tell_joint(*id, joint),
            SceneEvent::JointRemoved { id } => {
                if let Some(place) = self.sent_joints.remove(*id) {
                    self.record(place, CellNews::SceneEvent(scene_event.clone()));
                }
            }
            SceneEvent::PublisherSilent { since, bodies } => {
                let since = *since;
                self.tell_parts(bodies, |bodies| SceneEvent::PublisherSilent {
                    since,
                    bodies,
                });
            }
            SceneEvent::PublisherActive { tick, bodies } => {
                let tick = *tick;
                self.tell_parts(bodies, |bodies| SceneEvent::PublisherActive {
                    tick,
                    bodies,
                });
            }
        }
    }

    /// Removes a body that left the scene; returns where it was known, and its id there.
    fn remove(&mut self, id: BodyId) -> Option<(usize, BodyId)> {
        self.sent_joints.forget(id);
        let home = self.homes.get_mut(id.index() as usize)?;
        let home = home.take_if(|home| home.id == id)?;
        self.forget_body(&home);
        let (place, local) = home.taken?;
        let taken = self.taken_mut(place)?;
        taken.streams.remove(local);
        if taken.cell.is_some() {
            taken.ids.release(local);
        }
        Some((place, local))
    }

    /// Places a body in the streams of a cell.
    fn put(&mut self, scene: &Scene, (place, local): (usize, BodyId), placement: &Placement) {
        let Placement {
            desc,
            motion,
            track,
        } = *placement;
        if let Some(parameters) = streams::parameters(scene, desc.id)
            && let Some(taken) = self.taken_mut(place)
        {
            taken.streams.insert(local, &parameters, track, motion);
        }
    }

    /// Tells of a joint if both of its bodies are in one taken cell.
    fn tell_joint(&mut self, id: JointId, joint: &Joint) {
        if let Some((place, bodies)) = self.place_of_joint(joint) {
            self.sent_joints.insert(id, place, joint.bodies);
            let joint = Joint { bodies, ..*joint };
            let added = SceneEvent::JointAdded { id, joint };
            self.record(place, CellNews::SceneEvent(added));
        }
    }

    /// Where both bodies of a joint are known, and their ids there.
    fn place_of_joint(&self, joint: &Joint) -> Option<(usize, [BodyId; 2])> {
        let [first, second] = joint.bodies.map(|id| self.home(id)?.taken);
        let ((place, first), (other, second)) = first.zip(second)?;
        (place == other).then_some((place, [first, second]))
    }

    /// Tells each cell of those of the bodies that it has.
    fn tell_parts(&mut self, bodies: &[BodyId], event: impl Fn(Vec<BodyId>) -> SceneEvent) {
        let mut parts: BTreeMap<usize, BTreeSet<BodyId>> = BTreeMap::new();
        let known = bodies.iter().filter_map(|id| self.home(*id)?.taken);
        for (place, local) in known {
            parts.entry(place).or_default().insert(local);
        }
        for (place, bodies) in parts {
            let event = event(bodies.into_iter().collect());
            self.record(place, CellNews::SceneEvent(event));
        }
    }

    /// Tells the new cell of a body that its publisher is silent.
    fn tell_silence(&mut self, id: BodyId, silences: &[SceneEvent]) {
        for silence in silences {
            if let SceneEvent::PublisherSilent { since, bodies } = silence
                && bodies.contains(&id)
            {
                let since = *since;
                self.tell_parts(&[id], |bodies| SceneEvent::PublisherSilent {
                    since,
                    bodies,
                });
            }
        }
    }

    /// Counts a scene event of a cell, and keeps it for the cell's members.
    fn record(&mut self, place: usize, news: CellNews) {
        let Some(taken) = self.taken_mut(place) else {
            return;
        };
        taken.scene_events += 1;
        let cell = taken.cell;
        if self.unsent.last().is_none_or(|(last, _)| *last != cell) {
            self.unsent.push((cell, Vec::new()));
        }
        if let Some((_, bytes)) = self.unsent.last_mut() {
            encode(cell, news, bytes);
        }
    }

    /// The bodies and joints of a cell for a snapshot of one of its streams, up to its end.
    pub(crate) fn append_snapshot(
        &self,
        cell: Option<Cell>,
        stream: StreamId,
        (scene, silences): (&Scene, &[SceneEvent]),
        bytes: &mut Vec<u8>,
    ) {
        let Some(&place) = self.places.get(&cell) else {
            return;
        };
        let taken = self.taken[place].as_ref();
        let Some(stream) = taken.and_then(|taken| taken.streams.get(stream)) else {
            return;
        };
        for (since, gravity) in stream.gravity_changes() {
            let changed = SceneEvent::GravityChanged { since, gravity };
            encode(cell, CellNews::SceneEvent(changed), bytes);
        }
        let ids = self.bodies.get(&cell).into_iter().flatten();
        let locals = ids.filter_map(|id| Some((self.home(*id)?.taken?.1, *id)));
        let ids: BTreeMap<BodyId, BodyId> = locals.collect();
        for (local, track) in stream.sender.tracks() {
            if let Some(desc) = ids.get(&local).and_then(|id| scene.body(*id)) {
                let (id, alias) = (desc.id, stream.alias(local));
                let placed = placed(scene, (*desc, local), track, alias);
                encode(cell, CellNews::Placed { id, placed }, bytes);
            }
        }
        for (id, joint) in self.joints_of(cell, scene) {
            if let Some((at, bodies)) = self.place_of_joint(&joint)
                && at == place
            {
                let joint = Joint { bodies, ..joint };
                let added = SceneEvent::JointAdded { id, joint };
                encode(cell, CellNews::SceneEvent(added), bytes);
            }
        }
        for silence in silences {
            if let Some(silence) = self.part_of(place, silence) {
                encode(cell, CellNews::SceneEvent(silence), bytes);
            }
        }
        encode(cell, CellNews::SnapshotEnd, bytes);
    }

    /// The part of a silence that concerns a cell; `None` if nothing does.
    fn part_of(&self, place: usize, silence: &SceneEvent) -> Option<SceneEvent> {
        let SceneEvent::PublisherSilent { since, bodies } = silence else {
            return None;
        };
        let known = bodies.iter().filter_map(|id| self.home(*id)?.taken);
        let here: BTreeSet<_> = (known.filter(|(at, _)| *at == place))
            .map(|(_, local)| local)
            .collect();
        let bodies: Vec<_> = here.into_iter().collect();
        let since = *since;
        (!bodies.is_empty()).then_some(SceneEvent::PublisherSilent { since, bodies })
    }

    /// Takes a body out of the cell in which it was.
    fn forget_body(&mut self, home: &Home) {
        if let Some(bodies) = self.bodies.get_mut(&home.cell) {
            bodies.remove(&home.id);
            if bodies.is_empty() {
                self.bodies.remove(&home.cell);
            }
        }
    }

    fn home(&self, id: BodyId) -> Option<&Home> {
        let home = self.homes.get(id.index() as usize)?.as_ref()?;
        (home.id == id).then_some(home)
    }

    /// The cell of a body that comes; `None` for one that is too large for any.
    fn cell_of(&self, scene: &Scene, id: BodyId, motion: &BodyState) -> Option<Cell> {
        let radius = scene.bounding_radius(id)?;
        (!self.grid.is_too_large(radius)).then(|| self.grid.cell_of(position(motion)))
    }

    /// Puts a body into a cell.
    fn set_home(&mut self, id: BodyId, cell: Option<Cell>) {
        let index = id.index() as usize;
        if index >= self.homes.len() {
            self.homes.resize(index + 1, None);
        }
        if let Some(before) = self.homes[index] {
            self.forget_body(&before);
        }
        self.bodies.entry(cell).or_default().insert(id);
        let place = self.places.get(&cell).copied();
        let taken = place.and_then(|place| {
            let ids = &mut self.taken[place].as_mut()?.ids;
            Some((place, cell.map_or(id, |_| ids.assign())))
        });
        self.homes[index] = Some(Home { id, cell, taken });
    }
}

/// The event of a body in a cell, by its id there.
fn placed(
    scene: &Scene,
    (desc, local): (BodyDesc, BodyId),
    track: Track,
    alias: Option<u32>,
) -> SceneEvent {
    SceneEvent::BodyPlaced {
        desc: BodyDesc { id: local, ..desc },
        inertia: scene.inertia(desc.id),
        track,
        alias,
    }
}

/// Appends the message with news of a cell. What is common to all members has the form of a scene's.
fn encode(cell: Option<Cell>, news: CellNews, to: &mut Vec<u8>) {
    let message = match (cell, news) {
        (Some(cell), news) => ServerMessage::OfCell { cell, news },
        (None, CellNews::SceneEvent(event) | CellNews::Placed { placed: event, .. }) => {
            ServerMessage::SceneEvent(event)
        }
        (None, CellNews::SnapshotEnd) => ServerMessage::SnapshotEnd,
        // A common body is in no cell, and never crosses.
        (None, _) => return,
    };
    message.encode(to);
}

fn position(motion: &BodyState) -> glam::Vec3 {
    glam::Vec3::from_array(motion.position())
}
