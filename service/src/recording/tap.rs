//! Copies the states of a scene's ticks into the queues of their readers.
//!
//! A record is whole if it holds every body: the first of a scene, and the first after one that found no place.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, PoisonError};

use rhumb_protocol::message::SceneEvent;
use rhumb_protocol::scene::{BodyDesc, SceneName, Shape};
use rhumb_protocol::stream::{Observation, PredictionParameters};
use rhumb_reckoning::{BodyId, Inertia, Tick};
use rhumb_scene::Scene;
use rhumb_trace::SceneFacts;

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
pub(crate) struct RecordedBody {
    pub(crate) desc: BodyDesc,
    pub(crate) shape: Shape,
    pub(crate) observation: Observation,
    pub(crate) inertia: Option<Inertia>,
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
