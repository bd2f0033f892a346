//! The cells that members take: their streams, and the ids of their bodies.
//!
//! Which bodies a cell has is decided in `cells`. A cell that has nothing to say is **silent**: until its next watermark it is
//! neither observed nor published, and no tick looks at it. Whatever changes it wakes it first. Invariants: what a silent
//! cell sends is what it would send if each tick were published; a cell that is not silent is among those awake.

use std::collections::{BTreeSet, VecDeque};

use rhumb_protocol::scene::Cell;
use rhumb_protocol::stream::Observation;
use rhumb_reckoning::{BodyId, Tick};

use crate::engine::StepThreads;
use crate::streams::Streams;

/// A cell that members take.
#[derive(Debug)]
pub(crate) struct TakenCell {
    pub(crate) cell: Option<Cell>,
    pub(crate) streams: Streams,
    pub(crate) scene_events: u64,
    pub(crate) ids: CellIds,
    /// Those of its bodies at the newest tick.
    observed: Vec<Observation>,
    /// The tick of its next watermark, while it is silent.
    silent_until: Option<Tick>,
}

impl TakenCell {
    /// A cell whose bodies have these ids.
    pub(crate) const fn new(cell: Option<Cell>, streams: Streams, ids: CellIds) -> Self {
        Self {
            cell,
            streams,
            scene_events: 0,
            ids,
            observed: Vec::new(),
            silent_until: None,
        }
    }

    /// Stores what was observed at a tick.
    fn observe(&mut self, tick: Tick) {
        self.observed.sort_unstable_by_key(|observed| observed.id);
        self.streams.observe(tick, &self.observed);
    }

    /// Publishes the newest tick. `is_published`: true at a published tick, at which it may become silent.
    fn publish(&mut self, is_published: bool) {
        self.streams.publish(self.scene_events);
        if is_published && self.observed.is_empty() {
            self.silent_until = self.streams.silent_until();
        }
    }
}

/// All cells that members take, each at a place.
#[derive(Debug, Default)]
pub(crate) struct TakenCells {
    /// By place.
    cells: Vec<Option<TakenCell>>,
    /// Places without a cell.
    vacant: BTreeSet<usize>,
    /// Places of cells that are not silent.
    awake: BTreeSet<usize>,
    /// Those of the others, by the tick of their next watermark.
    silent: BTreeSet<(Tick, usize)>,
    /// Places of the cells that were published at the newest tick.
    spoke: Vec<usize>,
}

impl TakenCells {
    /// The place of the next cell.
    pub(crate) fn next_place(&self) -> usize {
        self.vacant.first().copied().unwrap_or(self.cells.len())
    }

    /// Adds a cell; returns its place.
    pub(crate) fn insert(&mut self, cell: TakenCell) -> usize {
        let place = self.vacant.pop_first().unwrap_or(self.cells.len());
        if place == self.cells.len() {
            self.cells.push(None);
        }
        self.cells[place] = Some(cell);
        self.awake.insert(place);
        place
    }

    /// Forgets a cell.
    pub(crate) fn remove(&mut self, place: usize) {
        if let Some(cell) = self.cells[place].take() {
            self.awake.remove(&place);
            if let Some(until) = cell.silent_until {
                self.silent.remove(&(until, place));
            }
            self.vacant.insert(place);
        }
    }

    pub(crate) fn get(&self, place: usize) -> Option<&TakenCell> {
        self.cells[place].as_ref()
    }

    /// The ids of a cell's bodies.
    pub(crate) fn ids_mut(&mut self, place: usize) -> Option<&mut CellIds> {
        Some(&mut self.cells[place].as_mut()?.ids)
    }

    /// A cell that is about to change: its silence ends. `published`: the newest published tick.
    pub(crate) fn wake(&mut self, place: usize, published: Tick) -> Option<&mut TakenCell> {
        let cell = self.cells[place].as_mut()?;
        if let Some(until) = cell.silent_until.take() {
            cell.streams.pass(published);
            self.silent.remove(&(until, place));
            self.awake.insert(place);
        }
        Some(cell)
    }

    /// The places, also vacant ones.
    pub(crate) fn places(&self) -> std::ops::Range<usize> {
        0..self.cells.len()
    }

    /// Forgets what was observed at the tick before.
    pub(crate) fn begin_tick(&mut self) {
        // A silent cell had nothing to observe.
        awake(&mut self.cells, &self.awake).for_each(|cell| cell.observed.clear());
    }

    /// Notes what was observed of a body of a cell. `published`: the newest published tick before.
    pub(crate) fn note(&mut self, place: usize, observation: Observation, published: Tick) {
        if let Some(cell) = self.wake(place, published) {
            cell.observed.push(observation);
        }
    }

    /// Stores what was noted of a tick, and wakes the cells whose watermark is due. `published`: the newest published tick
    /// before.
    pub(crate) fn observe(&mut self, tick: Tick, published: Tick) {
        while let Some(&(until, place)) = self.silent.first()
            && until <= tick
        {
            self.silent.pop_first();
            self.wake(place, published);
        }
        awake(&mut self.cells, &self.awake).for_each(|cell| cell.observe(tick));
    }

    /// Publishes the newest tick of every cell that is awake. `is_published`: true at a published tick, at which cells may
    /// become silent.
    pub(crate) fn publish(&mut self, threads: &StepThreads, is_published: bool) {
        let mut speaking: Vec<_> = awake(&mut self.cells, &self.awake).collect();
        threads.on_each(&mut speaking, |cell| cell.publish(is_published));
        self.spoke.clear();
        self.spoke.extend(&self.awake);
        for &place in &self.spoke {
            let cell = self.cells[place].as_ref();
            if let Some(until) = cell.and_then(|cell| cell.silent_until) {
                self.awake.remove(&place);
                self.silent.insert((until, place));
            }
        }
    }

    /// The cells that were published at the newest tick.
    pub(crate) fn speaking(&self) -> impl Iterator<Item = &TakenCell> {
        let spoke = self.spoke.iter();
        spoke.filter_map(|place| self.cells[*place].as_ref())
    }
}

/// The cells at these places, which none of the others is visited for.
fn awake<'a>(
    cells: &'a mut [Option<TakenCell>],
    places: &'a BTreeSet<usize>,
) -> impl Iterator<Item = &'a mut TakenCell> {
    let (mut cells, mut next) = (cells.iter_mut(), 0);
    places.iter().filter_map(move |place| {
        let cell = cells.nth(place - next)?;
        next = place + 1;
        cell.as_mut()
    })
}

/// The ids of a cell's bodies: tables by index are as long as the cell has bodies.
#[derive(Debug, Default)]
pub(crate) struct CellIds {
    /// By index: the generation of the next body.
    generations: Vec<u16>,
    free: VecDeque<u32>,
}

impl CellIds {
    /// An id for a body that comes.
    pub(crate) fn assign(&mut self) -> BodyId {
        let index = self.free.pop_front().unwrap_or_else(|| {
            self.generations.push(0);
            self.generations.len() as u32 - 1
        });
        BodyId::new(index, self.generations[index as usize])
    }

    /// Takes back the id of a body that went. An index whose generations are used up is not assigned again.
    pub(crate) fn release(&mut self, id: BodyId) {
        let generation = &mut self.generations[id.index() as usize];
        if let Some(next) = generation.checked_add(1) {
            *generation = next;
            self.free.push_back(id.index());
        }
    }
}

#[cfg(test)]
mod tests {
    use bytes::Bytes;
    use rhumb_protocol::Peer;
    use rhumb_protocol::message::StreamChoice;
    use rhumb_protocol::packet::{LargestPacket, LossReport, Low16, StreamId};
    use rhumb_protocol::scene::{
        BodyDesc, BodyKind, PublishSchedule, SceneConfig, Shape, ShapeId, Stepping,
    };
    use rhumb_protocol::stream::{Activity, PredictionParameters, Recipient};
    use rhumb_protocol::{Instant, Span};
    use rhumb_reckoning::{BodyState, Damping, Tolerance, Track};

    use super::*;
    use crate::scene::Scene;
    use crate::streams::Stream;

    const STREAM: StreamId = StreamId(3);
    const PLACE: usize = 2;
    const MEMBER: Peer = Peer(1);
    const BODY: BodyId = BodyId::new(0, 0);
    /// The body is there at these ticks, and moves at some of them.
    const COMES: u64 = 200;
    const MOVES: [std::ops::Range<u64>; 2] = [220..260, 700..701];
    const GOES: u64 = 900;
    /// A member reports now and then.
    const REPORTS: [u64; 3] = [100, 102, 520];
    const TICKS: u64 = 1_200;

    /// One cell at the place [`PLACE`], among others without a body.
    fn cells(scene: &Scene, choice: StreamChoice) -> TakenCells {
        let schedule = scene.config().publish_schedule;
        let mut cells = TakenCells::default();
        for place in 0..=PLACE {
            let mut streams = Streams::new(schedule, StepThreads::default());
            streams.begin(Stream::new(choice, STREAM, LargestPacket::DEFAULT, scene));
            let cell = Cell([place as i32, 0, 0]);
            let at = cells.insert(TakenCell::new(Some(cell), streams, CellIds::default()));
            assert_eq!(at, place);
        }
        cells
    }

    fn state(tick: u64) -> BodyState {
        let x = (tick as f32 * 0.7).sin() * 3.0;
        let state = BodyState::new([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        state.expect("finite")
    }

    /// A member asks for the watermark.
    fn report(cell: &mut TakenCell, number: u64, answers: &mut Vec<Bytes>) {
        let from = Recipient {
            id: MEMBER.0,
            round_trip: Span::ZERO,
        };
        let now = Instant::ZERO + Span::from_millis(number * 16);
        let stream = cell.streams.get_mut(STREAM).expect("it is there");
        let report = LossReport {
            next: Low16::of(stream.sender.next_number()),
            abandoned: Low16(0),
            repair_symbols: 0,
            lost: Vec::new(),
        };
        let scene_events = cell.scene_events;
        (stream.sender).handle_report(now, from, &report, scene_events, answers);
    }

    /// What a cell says at each tick, and the ticks at which it had to be published. `is_silent`: false for a cell that is
    /// published at every tick.
    fn sent(choice: StreamChoice, every: u32, is_silent: bool) -> (Vec<Vec<Bytes>>, usize) {
        let schedule = PublishSchedule {
            publish_interval: std::num::NonZeroU32::new(every).expect("not zero"),
            ..PublishSchedule::EACH_TICK
        };
        let config = SceneConfig {
            stepping: Stepping::FreeRunning,
            publish_schedule: schedule,
            ..SceneConfig::default()
        };
        let scene = Scene::new(config).expect("valid");
        let mut cells = cells(&scene, choice);
        let (mut published, mut active) = (Tick::ZERO, 0);
        let mut sent = Vec::new();
        for number in 1..TICKS {
            let tick = Tick::new(number);
            let mut packets = Vec::new();
            if !is_silent {
                cells.wake(PLACE, published);
            }
            if number == COMES {
                let desc = BodyDesc::plain(BODY, BodyKind::Dynamic, ShapeId(0));
                let shape = Shape::ball(0.5);
                let parameters = PredictionParameters::of(&desc, &shape, Damping::default(), None);
                let at = state(0);
                let track = Track::resting(tick, at);
                let cell = cells.wake(PLACE, published).expect("it is there");
                cell.streams.insert(BODY, &parameters, track, at);
                cell.scene_events += 1;
            }
            if number == GOES {
                let cell = cells.wake(PLACE, published).expect("it is there");
                cell.streams.remove(BODY);
                cell.scene_events += 1;
            }
            if REPORTS.contains(&number) {
                let cell = cells.wake(PLACE, published).expect("it is there");
                report(cell, number, &mut packets);
            }
            cells.begin_tick();
            let moves = MOVES.iter().find(|ticks| ticks.contains(&number));
            if let Some(ticks) = moves {
                let observation = Observation {
                    id: BODY,
                    motion: state(number),
                    activity: match number + 1 == ticks.end {
                        true => Activity::Asleep,
                        false => Activity::Awake,
                    },
                };
                cells.note(PLACE, observation, published);
            }
            cells.observe(tick, published);
            let is_published = schedule.publishes(tick);
            published = if is_published { tick } else { published };
            cells.publish(&StepThreads::default(), is_published);
            let is_it = |of: &&TakenCell| of.cell == Some(Cell([PLACE as i32, 0, 0]));
            if let Some(cell) = cells.speaking().find(is_it) {
                active += 1;
                packets.extend(cell.streams.packets(STREAM, MEMBER).cloned());
            }
            sent.push(packets);
        }
        (sent, active)
    }

    #[test]
    fn a_silent_cell_says_what_it_would_say_if_each_tick_were_published() {
        for every in [1, 3] {
            for choice in [
                StreamChoice::Within(Tolerance::NORMAL),
                StreamChoice::Full,
                StreamChoice::Changed,
            ] {
                let (sent, active) = sent(choice, every, true);
                let (expected, all) = self::sent(choice, every, false);
                assert_eq!(sent, expected, "{choice:?} each {every}");
                assert!(active < all, "{choice:?}: {active}");
                if matches!(choice, StreamChoice::Within(_)) {
                    assert!(active < 150, "{active}");
                }
            }
        }
    }

    #[test]
    fn a_cell_that_is_given_up_leaves_nothing_behind() {
        let scene = Scene::new(SceneConfig {
            stepping: Stepping::FreeRunning,
            ..SceneConfig::default()
        });
        let scene = scene.expect("valid");
        let mut cells = cells(&scene, StreamChoice::Within(Tolerance::NORMAL));
        let threads = StepThreads::default();
        let step = |cells: &mut TakenCells, number| {
            let tick = Tick::new(number);
            cells.begin_tick();
            cells.observe(tick, Tick::new(number - 1));
            cells.publish(&threads, true);
            cells.speaking().count()
        };
        assert_eq!(step(&mut cells, 1), PLACE + 1);
        let silent = (2..TICKS).find(|number| step(&mut cells, *number) == 0);
        let silent = silent.expect("all fall silent");
        for place in cells.places() {
            cells.remove(place);
        }
        assert!(cells.silent.is_empty() && cells.awake.is_empty());
        assert_eq!(cells.next_place(), 0);
        for number in silent + 1..TICKS {
            assert_eq!(step(&mut cells, number), 0);
        }
    }
}
