//! The command log of a scene, and the store of all, as a scene knows them.
//!
//! With them a scene survives its process. What keeps them is elsewhere: files, another process. Invariant: neither a log nor a store makes a scene wait.

use rhumb_protocol::Span;
use rhumb_protocol::scene::{SceneConfig, SceneName};
use rhumb_reckoning::Tick;

use crate::digest::Digest;
use crate::permit::Ownership;
use crate::record::{Batch, LogEntry};
use crate::scene::{FrozenScene, Scene};
use crate::sessions::Sessions;

/// A scene's end of its log. Batches are durable in their order.
pub trait CommandLog: Send {
    /// Hands over a batch; returns its number, for [`Self::durable`]. Once the log is given up, a batch is lost and
    /// only counts: the next snapshot has what it did.
    fn append(&mut self, batch: Batch) -> u64;

    /// Number of batches so far.
    fn appended(&self) -> u64;

    /// Number of batches that are durable.
    fn durable(&self) -> u64;

    /// Bytes of the log since the last snapshot.
    fn bytes(&self) -> usize;

    /// True if another snapshot may begin.
    fn may_snapshot(&self) -> bool;

    /// True if only a snapshot makes the log whole again.
    fn is_broken(&self) -> bool;

    /// Gives the log up until the next snapshot: the scene continues from another state, which counts as a batch. A
    /// snapshot that was handed over before does not count.
    fn give_up(&mut self);

    /// Hands over a snapshot of the scene after all batches so far.
    fn snapshot(&mut self, frozen: Frozen);

    /// Removes everything that the log keeps of the scene.
    fn delete(self: Box<Self>);
}

/// The state of a scene at a moment, for a snapshot.
pub struct Frozen {
    /// The newest tick.
    pub tick: Tick,
    /// Digest of all observations up to it.
    pub digest: Digest,
    /// Sessions of its clients.
    pub sessions: Sessions,
    /// Owners of its bodies, shapes and joints.
    pub ownership: Ownership,
    /// Its bodies.
    pub scene: FrozenScene,
}

/// The logs of all scenes, and those that are damaged: they are not served, and keep their names until a client deletes
/// them.
pub trait SceneStore: Send + Sync {
    /// The log of a scene that begins; `None` if it cannot be kept.
    fn create(&self, scene: &SceneName, config: &SceneConfig) -> Option<Box<dyn CommandLog>>;

    /// True for a scene that is damaged.
    fn is_damaged(&self, scene: &SceneName) -> bool;

    /// Removes a damaged scene; `false` for any other scene, and if it cannot be removed.
    fn delete_damaged(&self, scene: &SceneName) -> bool;

    /// Number of damaged scenes.
    fn damaged(&self) -> usize;
}

/// A scene that continues where its log ends.
pub struct RestoredScene {
    /// Its bodies.
    pub scene: Scene,
    /// Sessions of its clients.
    pub sessions: Sessions,
    /// Owners of its bodies, shapes and joints.
    pub ownership: Ownership,
    /// Entries of sessions that the log lacks.
    pub unnoted: Vec<LogEntry>,
    /// The log, which continues; `None` if it cannot be kept any longer.
    pub log: Option<Box<dyn CommandLog>>,
    /// Time that the restoration took.
    pub took: Span,
}

/// Time of steps after which a snapshot is due: a third of the time for a restart.
const SNAPSHOT_AFTER: Span = Span::from_millis(1_000);
/// Bytes of the log after which a snapshot is due.
const SNAPSHOT_BYTES: usize = 4 << 20;
/// Steps after which a snapshot is tried that makes a broken log whole.
const REPAIR_STEPS: u64 = 60;

/// The log of a scene, and the work since its last snapshot.
pub(crate) struct Durability {
    pub(crate) log: Box<dyn CommandLog>,
    /// Time of the steps since the last snapshot.
    pub(crate) stepped: Span,
    pub(crate) snapshot_tick: Tick,
}

impl Durability {
    /// `stepped`: time that the replay of the log took.
    pub(crate) fn new(log: Box<dyn CommandLog>, stepped: Span, tick: Tick) -> Self {
        Self {
            log,
            stepped,
            snapshot_tick: tick,
        }
    }

    pub(crate) fn is_snapshot_due(&self, tick: Tick) -> bool {
        let steps = tick.value().saturating_sub(self.snapshot_tick.value());
        let due = if self.log.is_broken() {
            steps >= REPAIR_STEPS
        } else {
            self.stepped >= SNAPSHOT_AFTER || self.log.bytes() >= SNAPSHOT_BYTES
        };
        due && self.log.may_snapshot()
    }

    /// True if a snapshot is due by the bytes of the log alone, in whatever state the scene is.
    pub(crate) fn is_long(&self) -> bool {
        !self.log.is_broken() && self.log.bytes() >= SNAPSHOT_BYTES && self.log.may_snapshot()
    }

    /// True if the log is longer than so many bytes and goes on.
    pub(crate) fn is_beyond(&self, bytes: usize) -> bool {
        !self.log.is_broken() && self.log.bytes() >= bytes
    }
}
