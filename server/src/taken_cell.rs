//! One cell that members take: its streams, and the ids of its bodies there.
//!
//! Which bodies it has is decided in `bodies_by_cell`. A cell that has nothing to say is **silent**: until its next watermark it is
//! neither observed nor published, and costs a tick nothing. Each change of it wakes it first. Invariant: what a silent
//! cell sends is what it would send if each tick were published.

use std::collections::VecDeque;

use rhumb_protocol::scene::Cell;
use rhumb_protocol::stream::Observation;
use rhumb_reckoning::{BodyId, Tick};

use crate::streams::Streams;

/// A cell that members take.
#[derive(Debug)]
pub(crate) struct TakenCell {
    pub(crate) cell: Option<Cell>,
    pub(crate) streams: Streams,
    pub(crate) scene_events: u64,
    pub(crate) ids: CellIds,
    /// Those of its bodies at the newest tick.
    pub(crate) observed: Vec<Observation>,
    /// The tick of its next watermark, while it is silent.
    silent_until: Option<Tick>,
    /// The last tick at which it was not silent.
    spoke_at: Option<Tick>,
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
            spoke_at: None,
        }
    }

    /// Ends its silence, before it changes. `published`: the newest published tick.
    pub(crate) fn wake(&mut self, published: Tick) {
        if self.silent_until.take().is_some() {
            self.streams.pass(published);
        }
    }

    /// Stores what was observed at a tick. `published`: the newest published tick before.
    pub(crate) fn observe(&mut self, tick: Tick, published: Tick) {
        let is_due = self.silent_until.is_some_and(|until| until <= tick);
        if is_due || !self.observed.is_empty() {
            self.wake(published);
        }
        if self.silent_until.is_none() {
            self.observed.sort_unstable_by_key(|observed| observed.id);
            self.streams.observe(tick, &self.observed);
        }
    }

    /// Publishes the newest tick, unless it is silent. `is_published`: true at a published tick, at which it may become
    /// silent.
    pub(crate) fn publish(&mut self, tick: Tick, is_published: bool) {
        if self.silent_until.is_some() {
            return;
        }
        self.streams.publish(self.scene_events);
        self.spoke_at = Some(tick);
        if is_published && self.observed.is_empty() {
            self.silent_until = self.streams.silent_until();
        }
    }

    /// True if it was published at a tick.
    pub(crate) fn speaks_at(&self, tick: Tick) -> bool {
        self.spoke_at == Some(tick)
    }
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
    use crate::engine::StepThreads;
    use crate::scene::Scene;
    use crate::streams::Stream;

    const STREAM: StreamId = StreamId(3);
    const MEMBER: Peer = Peer(1);
    const BODY: BodyId = BodyId::new(0, 0);
    /// The body is there at these ticks, and moves at some of them.
    const COMES: u64 = 200;
    const MOVES: [std::ops::Range<u64>; 2] = [220..260, 700..701];
    const GOES: u64 = 900;
    /// A member reports now and then.
    const REPORTS: [u64; 3] = [100, 102, 520];
    const TICKS: u64 = 1_200;

    fn cell(scene: &Scene, choice: StreamChoice) -> TakenCell {
        let schedule = scene.config().publish_schedule;
        let mut streams = Streams::new(schedule, StepThreads::default());
        streams.begin(Stream::new(choice, STREAM, LargestPacket::DEFAULT, scene));
        TakenCell::new(Some(Cell::default()), streams, CellIds::default())
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

    /// The packets of a cell at each tick, and the number of ticks at which it had to be published. `is_silent`: false for a cell that is
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
        let mut cell = cell(&scene, choice);
        let (mut published, mut active) = (Tick::ZERO, 0);
        let mut sent = Vec::new();
        for number in 1..TICKS {
            let tick = Tick::new(number);
            let mut packets = Vec::new();
            if !is_silent {
                cell.wake(published);
            }
            if number == COMES {
                cell.wake(published);
                let desc = BodyDesc::plain(BODY, BodyKind::Dynamic, ShapeId(0));
                let shape = Shape::ball(0.5);
                let parameters = PredictionParameters::of(&desc, &shape, Damping::default(), None);
                let at = state(0);
                let track = Track::resting(tick, at);
                cell.streams.insert(BODY, &parameters, track, at);
                cell.scene_events += 1;
            }
            if number == GOES {
                cell.wake(published);
                cell.streams.remove(BODY);
                cell.scene_events += 1;
            }
            if REPORTS.contains(&number) {
                cell.wake(published);
                report(&mut cell, number, &mut packets);
            }
            cell.observed.clear();
            let moves = MOVES.iter().find(|ticks| ticks.contains(&number));
            cell.observed.extend(moves.map(|ticks| Observation {
                id: BODY,
                motion: state(number),
                activity: match number + 1 == ticks.end {
                    true => Activity::Asleep,
                    false => Activity::Awake,
                },
            }));
            cell.observe(tick, published);
            let is_published = schedule.publishes(tick);
            published = if is_published { tick } else { published };
            cell.publish(tick, is_published);
            if cell.speaks_at(tick) {
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
}
