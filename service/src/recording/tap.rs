//! Taps copy the states of a scene; writers make them messages of a trace.
//!
//! A tap fills the queues of its readers. A writer writes the records of one scene.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, PoisonError};

use rhumb_protocol::message::SceneEvent;
use rhumb_protocol::scene::{BodyDesc, BodyKind, SceneName, Shape};
use rhumb_protocol::stream::{Activity, Observation, PredictionParameters};
use rhumb_reckoning::{BodyId, Inertia, Rate, Tick};
use rhumb_scene::Scene;
use rhumb_trace::{
    ASLEEP, AWAKE, DrawnBody, Placed, SceneFacts, SceneTopics, StateForm, States, TraceSink,
    log_time_ns,
};

/// The states of a scene after a tick.
#[derive(Debug)]
pub(crate) struct TickRecord {
    pub(crate) scene: SceneName,
    /// Distinguishes the scene from others of the same name.
    pub(crate) number: u64,
    /// The numbers of the engine for predictions, with the gravity of this tick.
    pub(crate) facts: SceneFacts,
    pub(crate) tick: Tick,
    /// True if it holds every body as placed.
    pub(crate) is_whole: bool,
    /// Bodies that moved or fell asleep.
    pub(crate) observed: Vec<Observation>,
    /// Bodies that were added or changed since the record before.
    pub(crate) placed: Vec<RecordedBody>,
    pub(crate) removed: Vec<BodyId>,
}

/// A body with its state after a tick.
#[derive(Clone, Debug)]
pub(super) struct RecordedBody {
    pub(crate) desc: BodyDesc,
    pub(crate) shape: Shape,
    pub(crate) observation: Observation,
    inertia: Option<Inertia>,
}

/// A message to a thread that writes.
#[derive(Clone, Debug)]
pub(crate) enum TapMessage {
    Tick(Arc<TickRecord>),
    /// The scene has ended.
    Ended(SceneName, u64),
    /// The server ends.
    End,
}

/// The way to one reader.
#[derive(Clone)]
pub(crate) struct TapQueue {
    pub(super) messages: Sender<TapMessage>,
    pub(super) waiting: QueuedBytes,
    pub(super) bytes_max: usize,
}

/// Bytes of records that wait for one reader; all clones are one.
#[derive(Clone, Debug, Default)]
pub(super) struct QueuedBytes(Arc<AtomicUsize>);

impl QueuedBytes {
    /// The reader is done with a record.
    pub(super) fn remove(&self, bytes: usize) {
        self.0.fetch_sub(bytes, Ordering::Relaxed);
    }

    /// Adds a record; false if it finds no place. A record alone always does.
    fn add(&self, bytes: usize, most: usize) -> bool {
        let more = |waiting: usize| {
            let sum = waiting.saturating_add(bytes);
            (waiting == 0 || sum <= most).then_some(sum)
        };
        let added = (self.0).fetch_update(Ordering::Relaxed, Ordering::Relaxed, more);
        added.is_ok()
    }
}

impl TickRecord {
    /// Its size in memory, about.
    pub(crate) fn bytes(&self) -> usize {
        size_of::<Self>()
            + size_of_val(self.observed.as_slice())
            + size_of_val(self.placed.as_slice())
            + size_of_val(self.removed.as_slice())
    }
}

/// The taps of all scenes; all clones are one. The default has no readers.
#[derive(Clone, Default)]
pub(crate) struct SceneTaps(Arc<Readers>);

#[derive(Default)]
struct Readers {
    queues: Mutex<Vec<TapQueue>>,
    scenes_begun: AtomicU64,
}

impl SceneTaps {
    /// Adds a reader of the records of later scenes.
    pub(crate) fn add(&self, queue: TapQueue) {
        let mut queues = self.0.queues.lock().unwrap_or_else(PoisonError::into_inner);
        queues.push(queue);
    }

    /// The tap of a new scene.
    pub(crate) fn begin(&self, name: &SceneName) -> SceneTap {
        let queues = self.0.queues.lock().unwrap_or_else(PoisonError::into_inner);
        SceneTap {
            scene: name.clone(),
            number: self.0.scenes_begun.fetch_add(1, Ordering::Relaxed),
            readers: queues.iter().cloned().collect(),
            is_whole_due: true,
            changed: BTreeSet::new(),
            removed: Vec::new(),
        }
    }
}

/// The tap of one scene; dropping it ends the recording.
pub(crate) struct SceneTap {
    scene: SceneName,
    number: u64,
    readers: Vec<TapQueue>,
    is_whole_due: bool,
    /// Bodies placed since the last record.
    changed: BTreeSet<BodyId>,
    removed: Vec<BodyId>,
}

impl SceneTap {
    /// Notes what a scene event says of bodies.
    pub(crate) fn note(&mut self, event: &SceneEvent) {
        if self.readers.is_empty() {
            return;
        }
        match event {
            SceneEvent::BodyPlaced { desc, .. } => {
                self.changed.insert(desc.id);
            }
            SceneEvent::BodyRemoved { id, .. } => {
                self.changed.remove(id);
                self.removed.push(*id);
            }
            _ => {}
        }
    }

    /// Hands over the states after a tick.
    pub(crate) fn record(&mut self, scene: &Scene) {
        if self.readers.is_empty() {
            return;
        }
        let record = Arc::new(self.make(scene));
        let bytes = record.bytes();
        let mut lost = false;
        for reader in &self.readers {
            if !reader.waiting.add(bytes, reader.bytes_max) {
                lost = true;
                continue;
            }
            // A reader that has ended needs no records.
            let _ = reader.messages.send(TapMessage::Tick(Arc::clone(&record)));
        }
        if lost && !self.is_whole_due {
            let scene = &self.scene;
            tracing::warn!(%scene, tick = record.tick.value(), "a recording lacks ticks: its thread is too slow");
        }
        self.is_whole_due = lost;
    }

    fn make(&mut self, scene: &Scene) -> TickRecord {
        let body = |desc: &BodyDesc| {
            let shape = scene.shape(desc.shape)?;
            let (damping, inertia) = (scene.config().damping, scene.inertia(desc.id));
            Some(RecordedBody {
                desc: *desc,
                shape: shape.clone(),
                observation: scene.observation_at_tick(desc.id)?,
                inertia: PredictionParameters::of(desc, shape, damping, inertia).inertia,
            })
        };
        let changed = std::mem::take(&mut self.changed);
        let placed = if self.is_whole_due {
            scene.bodies().filter_map(body).collect()
        } else {
            let there = changed.iter().filter_map(|id| scene.body(*id));
            there.filter_map(body).collect()
        };
        TickRecord {
            scene: self.scene.clone(),
            number: self.number,
            facts: SceneFacts {
                gravity: scene.gravity(),
                ..SceneFacts::of(scene.config())
            },
            tick: scene.tick(),
            is_whole: self.is_whole_due,
            observed: scene.observations().to_vec(),
            placed,
            removed: std::mem::take(&mut self.removed),
        }
    }
}

impl Drop for SceneTap {
    fn drop(&mut self) {
        for reader in &self.readers {
            let ended = TapMessage::Ended(self.scene.clone(), self.number);
            // A reader that has ended needs no message.
            let _ = reader.messages.send(ended);
        }
    }
}

/// Drawings in a simulated second.
const DRAWINGS_PER_SECOND: u64 = 30;
/// Simulated time that a body lies still before it is drawn as resting, nanoseconds.
const REST_DELAY_NS: u64 = 500_000_000;

/// One scene, written record by record.
#[derive(Debug)]
pub(super) struct SceneWriter {
    prefix: String,
    rate: Rate,
    mirror: SceneMirror,
    topics: SceneTopics,
    /// True if the sink has nothing of the scene yet.
    begins: bool,
    statics_due: bool,
    drawn: Option<u64>,
}

impl SceneWriter {
    /// A scene of which nothing is written yet.
    pub(super) fn new(record: &TickRecord) -> Self {
        let prefix = format!("/{}", record.scene);
        let rate = record.facts.integrator.rate;
        Self {
            topics: SceneTopics::new(&prefix, rest_delay_ticks(rate)),
            prefix,
            rate,
            mirror: SceneMirror::default(),
            begins: true,
            statics_due: true,
            drawn: None,
        }
    }

    /// The beginning of the names of its topics.
    #[cfg(feature = "foxglove")]
    pub(super) fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Writes the next record in full, to another sink.
    pub(super) fn begin(&mut self) {
        self.topics = SceneTopics::new(&self.prefix, rest_delay_ticks(self.rate));
        self.begin_for_viewer();
    }

    /// Writes the next record in full, to the same sink.
    fn begin_for_viewer(&mut self) {
        self.begins = true;
        self.statics_due = true;
        self.drawn = None;
        self.topics.redraw();
    }

    /// Takes a record without writing it.
    pub(super) fn skip(&mut self, record: &TickRecord) {
        self.mirror.apply(record);
        self.begins = true;
    }

    /// Takes a record, and writes it.
    pub(super) fn write<S: TraceSink>(
        &mut self,
        sink: &mut S,
        record: &TickRecord,
    ) -> Result<(), S::Error> {
        let changes = self.mirror.apply(record);
        self.put(sink, &record.observed, &changes)
    }

    /// Writes the newest tick once more, whole.
    #[cfg(feature = "foxglove")]
    pub(super) fn write_whole<S: TraceSink>(&mut self, sink: &mut S) -> Result<(), S::Error> {
        self.begin_for_viewer();
        self.put(sink, &[], &MirrorChanges::default())
    }

    fn put<S: TraceSink>(
        &mut self,
        sink: &mut S,
        observed: &[Observation],
        changes: &MirrorChanges,
    ) -> Result<(), S::Error> {
        let tick = self.mirror.tick();
        let at_ns = log_time_ns(self.rate, tick.value());
        let placed = if std::mem::take(&mut self.begins) {
            self.mirror.all_placed()
        } else {
            let ids = changes.placed.iter();
            ids.filter_map(|id| self.mirror.placed(*id)).collect()
        };
        // The placement of a body has its state after this tick.
        let new: BTreeSet<BodyId> = placed.iter().map(|placed| placed.desc.id).collect();
        let others = observed.iter().filter(|o| !new.contains(&o.id));
        let observed: Vec<_> = others.copied().collect();
        let after = (placed.as_slice(), changes.removed.as_slice());
        let states = States::of(tick, &observed, after, &mut StateForm::Exact);
        self.topics.put_states(sink, at_ns, &states)?;
        self.statics_due |= changes.statics;
        let stride = (1_000_000_000 / DRAWINGS_PER_SECOND / self.rate.step_ns().max(1)).max(1);
        let number = tick.value() / stride;
        if self.drawn == Some(number) {
            return Ok(());
        }
        self.drawn = Some(number);
        if std::mem::take(&mut self.statics_due) {
            self.topics
                .draw_statics(sink, at_ns, self.mirror.drawn(true))?;
        }
        let painted: Vec<_> = (self.mirror.drawn(false))
            .map(|body| (body, if body.still { ASLEEP } else { AWAKE }))
            .collect();
        self.topics.draw(sink, (tick.value(), at_ns), &painted)
    }
}

fn rest_delay_ticks(rate: Rate) -> u64 {
    REST_DELAY_NS / rate.step_ns().max(1)
}

/// All bodies of a scene.
#[derive(Debug, Default)]
struct SceneMirror {
    bodies: BTreeMap<BodyId, RecordedBody>,
    tick: Tick,
}

/// The changes by a record.
#[derive(Debug, Default)]
struct MirrorChanges {
    pub(super) placed: Vec<BodyId>,
    pub(super) removed: Vec<BodyId>,
    /// True if a fixed body is among them.
    statics: bool,
}

impl SceneMirror {
    /// The newest tick.
    pub(super) const fn tick(&self) -> Tick {
        self.tick
    }

    /// Applies a record.
    pub(super) fn apply(&mut self, record: &TickRecord) -> MirrorChanges {
        let mut changes = MirrorChanges::default();
        if record.is_whole {
            let gone = std::mem::take(&mut self.bodies);
            changes.statics = true;
            let placed: BTreeSet<_> = record.placed.iter().map(|body| body.desc.id).collect();
            changes.removed = gone.into_keys().filter(|id| !placed.contains(id)).collect();
        }
        for id in &record.removed {
            if let Some(body) = self.bodies.remove(id) {
                changes.statics |= body.desc.kind == BodyKind::Fixed;
                changes.removed.push(*id);
            }
        }
        for body in &record.placed {
            changes.statics |= body.desc.kind == BodyKind::Fixed;
            changes.placed.push(body.desc.id);
            self.bodies.insert(body.desc.id, body.clone());
        }
        for observation in &record.observed {
            if let Some(body) = self.bodies.get_mut(&observation.id) {
                body.observation = *observation;
            }
        }
        self.tick = record.tick;
        changes
    }

    /// A body as it is now.
    pub(super) fn placed(&self, id: BodyId) -> Option<Placed> {
        self.bodies.get(&id).map(|body| self.placement(body))
    }

    /// All bodies as they are now.
    fn all_placed(&self) -> Vec<Placed> {
        let bodies = self.bodies.values();
        bodies.map(|body| self.placement(body)).collect()
    }

    fn placement(&self, body: &RecordedBody) -> Placed {
        Placed {
            tick: self.tick,
            desc: body.desc,
            shape: body.shape.clone(),
            observation: body.observation,
            inertia: body.inertia,
        }
    }

    /// All bodies as they are drawn: the fixed ones, or the others.
    pub(super) fn drawn(&self, statics: bool) -> impl Iterator<Item = DrawnBody<'_>> {
        let bodies = self.bodies.values();
        let wanted = bodies.filter(move |body| (body.desc.kind == BodyKind::Fixed) == statics);
        wanted.map(|body| {
            let Observation {
                id,
                motion,
                activity,
            } = body.observation;
            DrawnBody {
                id,
                shape: &body.shape,
                position: motion.position(),
                rotation: motion.rotation(),
                still: activity == Activity::Asleep,
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;
    use std::sync::mpsc::{Receiver, channel};

    use prost::Message;
    use rhumb_protocol::message::{RemovalCause, SceneEvent};
    use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, SceneConfig, Shape, ShapeId};
    use rhumb_reckoning::{BodyState, Track};
    use rhumb_scene::Scene;
    use rhumb_trace::{Topic, read_states};

    use super::*;
    use crate::recording::tap::{QueuedBytes, SceneTap, SceneTaps, TapMessage, TapQueue};

    /// Keeps the messages of all topics.
    #[derive(Default)]
    struct Kept(Vec<Vec<u8>>);

    impl TraceSink for Kept {
        type Error = Infallible;

        fn put(&mut self, _: &mut Topic, _: u64, message: &impl Message) -> Result<(), Infallible> {
            self.0.push(message.encode_to_vec());
            Ok(())
        }
    }

    /// A scene with a tap, as a runner drives it.
    struct Tapped {
        scene: Scene,
        tap: SceneTap,
        messages: Receiver<TapMessage>,
        waiting: QueuedBytes,
    }

    impl Tapped {
        fn new(bytes_max: usize) -> Self {
            let mut scene = Scene::new(SceneConfig::default()).unwrap();
            let shape = Shape::Ball { radius: 0.5 };
            let id = ShapeId(1);
            scene.apply(&Command::AddShape { id, shape }).unwrap();
            let (sender, messages) = channel();
            let (taps, waiting) = (SceneTaps::default(), QueuedBytes::default());
            taps.add(TapQueue {
                messages: sender,
                waiting: waiting.clone(),
                bytes_max,
            });
            let tap = taps.begin(&"pit".parse().unwrap());
            Self {
                scene,
                tap,
                messages,
                waiting,
            }
        }

        fn add(&mut self, index: u32) {
            let id = BodyId::new(index, 0);
            let desc = BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(1));
            let (at, turn) = ([2.0 * index as f32, 5.0, 0.0], [0.0, 0.0, 0.0, 1.0]);
            let motion = BodyState::new(at, turn, [0.0; 3], [0.0; 3]).unwrap();
            self.scene
                .apply(&Command::AddBody { desc, motion })
                .unwrap();
            let track = Track::resting(self.scene.tick(), motion);
            let (inertia, alias) = (None, None);
            self.tap.note(&SceneEvent::BodyPlaced {
                desc,
                inertia,
                track,
                alias,
            });
        }

        fn remove(&mut self, index: u32) {
            let id = BodyId::new(index, 0);
            self.scene.apply(&Command::RemoveBody { id }).unwrap();
            let cause = RemovalCause::Command;
            self.tap.note(&SceneEvent::BodyRemoved { id, cause });
        }

        fn step(&mut self) {
            self.scene.step().unwrap();
            self.tap.record(&self.scene);
        }
    }

    fn written(tapped: &Tapped, writer: &mut Option<SceneWriter>) -> Vec<rhumb_trace::TickStates> {
        let mut kept = Kept::default();
        while let Ok(TapMessage::Tick(record)) = tapped.messages.try_recv() {
            let writer = writer.get_or_insert_with(|| SceneWriter::new(&record));
            let Ok(()) = writer.write(&mut kept, &record);
            tapped.waiting.remove(record.bytes());
        }
        let states = kept.0.iter().filter_map(|bytes| read_states(bytes).ok()?);
        states.filter(|states| states.tick.value() > 0).collect()
    }

    #[test]
    fn bodies_are_placed_moved_and_removed_as_in_the_scene() {
        let (mut tapped, mut writer) = (Tapped::new(1 << 20), None);
        tapped.add(1);
        tapped.step();
        tapped.add(2);
        tapped.step();
        tapped.remove(1);
        tapped.step();
        let states = written(&tapped, &mut writer);
        let placed = |at: usize| -> Vec<u32> {
            let placed = states[at].placed.iter();
            placed.map(|placed| placed.desc.id.index()).collect()
        };
        let observed = |at: usize| -> Vec<u32> {
            let observed = states[at].observed.iter();
            observed.map(|body| body.id.index()).collect()
        };
        assert_eq!((placed(0), observed(0)), (vec![1], vec![]));
        assert_eq!((placed(1), observed(1)), (vec![2], vec![1]));
        assert_eq!((placed(2), observed(2)), (vec![], vec![2]));
        assert_eq!(states[2].removed[0].1, BodyId::new(1, 0));
        let real = tapped.scene.observation_at_tick(BodyId::new(2, 0)).unwrap();
        assert_eq!(states[2].observed[0].motion, real.motion, "bit exact");
    }

    #[test]
    fn after_ticks_without_a_place_the_next_record_is_whole() {
        let (mut tapped, mut writer) = (Tapped::new(1), None);
        tapped.add(1);
        tapped.add(2);
        // The queue holds one record: the others are lost, and the scene waits for nothing.
        tapped.step();
        tapped.step();
        tapped.remove(1);
        tapped.step();
        let first = written(&tapped, &mut writer);
        assert_eq!(first.len(), 1);
        tapped.step();
        let after = written(&tapped, &mut writer);
        assert_eq!(after[0].tick.value(), 4);
        assert_eq!(after[0].placed.len(), 1, "every body that is left");
        assert_eq!(after[0].removed[0].1, BodyId::new(1, 0));
    }

    #[test]
    fn another_file_begins_whole() {
        let (mut tapped, mut writer) = (Tapped::new(1 << 20), None);
        tapped.add(1);
        tapped.step();
        written(&tapped, &mut writer);
        writer.as_mut().unwrap().begin();
        tapped.step();
        let states = written(&tapped, &mut writer);
        assert_eq!(states[0].placed.len(), 1);
        assert!(states[0].observed.is_empty(), "it is placed where it is");
    }
}
