//! The thread that writes a scene's log, and the scene's end of it.
//!
//! The scene hands over batches and never waits. One synchronisation makes durable whatever waited for it. If the disk
//! refuses, or too much waits for it, nothing more is acknowledged, and the log begins anew from the next snapshot.
//! Invariants: a batch is reported durable only if everything before it is durable too; what waits is bounded.

use std::io;
use std::mem;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{self, JoinHandle};

use rhumb_protocol::scene::{SceneConfig, SceneName};
use rhumb_reckoning::Tick;
use rhumb_scene::{Batch, CommandLog, Frozen};

use super::data_dir::{LOOK_BYTES, Room};
use super::disk::DataError;
use super::format::{OVERHEAD, Snapshot};
use super::scene_files::{LogHeader, SceneFiles, Segment};

/// Bytes of batches that may wait for the disk; beyond them the log is given up until the next snapshot.
pub(super) const WAITING_BYTES_MAX: usize = 64 << 20;

/// A scene's end of its log.
pub(crate) struct SceneLog {
    jobs: Sender<Job>,
    thread: Option<JoinHandle<()>>,
    shared: Arc<Shared>,
    /// Batches so far.
    batches: u64,
    /// Bytes of frames since the last snapshot.
    bytes: usize,
    /// Number of times that the log had been given up at the last snapshot: batches are lost while it is another number.
    given_up: u64,
}

/// The place at which the log of a scene begins or continues.
pub(crate) struct Origin {
    pub(crate) name: SceneName,
    pub(crate) config: SceneConfig,
    pub(crate) tick: Tick,
    pub(crate) segment: u32,
    pub(crate) previous: Option<(u32, u64)>,
}

#[derive(Default)]
struct Shared {
    /// Batches that are durable, from the first one on.
    durable: AtomicU64,
    /// Memory of the batches that wait for the disk.
    waiting_bytes: AtomicUsize,
    /// True if a snapshot is under way.
    snapshot: AtomicBool,
    /// Number of times that the log was given up, by the scene or because the disk refused.
    given_up: AtomicU64,
    /// The value of `given_up` up to which a snapshot has made the log whole: it is broken while they differ.
    made_whole: AtomicU64,
}

impl Shared {
    fn give_up(&self) {
        self.given_up.fetch_add(1, Ordering::Relaxed);
    }

    fn given_up(&self) -> u64 {
        self.given_up.load(Ordering::Relaxed)
    }

    fn is_broken(&self) -> bool {
        self.given_up() != self.made_whole.load(Ordering::Relaxed)
    }
}

/// The moment of a snapshot.
#[derive(Clone, Copy)]
struct SnapshotPoint {
    /// Batches before it, with those that were lost.
    batches: u64,
    /// Number of times that the log had been given up.
    given_up: u64,
}

enum Job {
    Batch(Batch),
    /// The log continues in a new segment, which a snapshot of its beginning follows.
    Snapshot(Box<Frozen>, SnapshotPoint),
    /// A snapshot is written, or is not.
    Written(u32, Result<(), DataError>),
    /// The scene is deleted.
    Delete,
    /// The scene hands over nothing more.
    End,
}

/// Called when more is durable, and when the disk refuses.
pub(crate) type Wake = Arc<dyn Fn() + Send + Sync>;

impl SceneLog {
    /// Starts the thread that writes.
    pub(crate) fn start(
        (files, room): (SceneFiles, Room),
        origin: Origin,
        wake: Wake,
    ) -> io::Result<Self> {
        let (jobs, received) = channel();
        let shared = Arc::new(Shared::default());
        let writer = LogWriter {
            files,
            room,
            unlooked: LOOK_BYTES,
            scene: origin.name.clone(),
            config: origin.config,
            segment: None,
            next: origin.segment,
            batches: 0,
            oldest_needed: None,
            shared: Arc::clone(&shared),
            jobs: jobs.clone(),
            wake,
        };
        let thread = thread::Builder::new()
            .name("rhumb-scene-log".to_owned())
            .spawn(move || writer.run(&received, origin.tick, origin.previous))?;
        Ok(Self {
            jobs,
            thread: Some(thread),
            shared,
            batches: 0,
            bytes: 0,
            given_up: 0,
        })
    }

    /// Memory of the batches that wait for the disk.
    pub(super) fn waiting_bytes(&self) -> usize {
        self.shared.waiting_bytes.load(Ordering::Relaxed)
    }

    /// True if no snapshot that was handed over can make durable what follows.
    fn is_losing(&self) -> bool {
        self.given_up != self.shared.given_up()
    }

    /// The thread reports its own end.
    fn send(&self, job: Job) {
        let _ = self.jobs.send(job);
    }
}

impl CommandLog for SceneLog {
    fn append(&mut self, batch: Batch) -> u64 {
        self.batches += 1;
        self.bytes += OVERHEAD + batch.records.len();
        if !self.is_losing() && self.waiting_bytes() > WAITING_BYTES_MAX {
            tracing::error!(
                "the disk is too slow: commands are not durable until the next snapshot"
            );
            self.shared.give_up();
        }
        if !self.is_losing() {
            self.shared
                .waiting_bytes
                .fetch_add(batch.memory_bytes(), Ordering::Relaxed);
            self.send(Job::Batch(batch));
        }
        self.batches
    }

    fn appended(&self) -> u64 {
        self.batches
    }

    fn durable(&self) -> u64 {
        self.shared.durable.load(Ordering::Acquire)
    }

    fn bytes(&self) -> usize {
        self.bytes
    }

    fn may_snapshot(&self) -> bool {
        !self.shared.snapshot.load(Ordering::Relaxed)
    }

    fn is_broken(&self) -> bool {
        self.shared.is_broken()
    }

    fn give_up(&mut self) {
        self.batches += 1;
        self.shared.give_up();
    }

    fn snapshot(&mut self, frozen: Frozen) {
        self.bytes = 0;
        self.given_up = self.shared.given_up();
        let point = SnapshotPoint {
            batches: self.batches,
            given_up: self.given_up,
        };
        self.shared.snapshot.store(true, Ordering::Relaxed);
        self.send(Job::Snapshot(Box::new(frozen), point));
    }

    fn delete(self: Box<Self>) {
        self.send(Job::Delete);
    }
}

impl Drop for SceneLog {
    /// Waits until everything handed over is written.
    fn drop(&mut self) {
        self.send(Job::End);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread of a command log panicked");
        }
    }
}

/// Writes the log of one scene.
struct LogWriter {
    files: SceneFiles,
    room: Room,
    /// Bytes written since the last look at the room.
    unlooked: usize,
    scene: SceneName,
    config: SceneConfig,
    /// `None` while the log is broken.
    segment: Option<Segment>,
    /// Number of the next segment.
    next: u32,
    /// Batches taken, with those that were lost before the last snapshot.
    batches: u64,
    /// The newest durable snapshot.
    oldest_needed: Option<u32>,
    shared: Arc<Shared>,
    jobs: Sender<Job>,
    wake: Wake,
}

impl LogWriter {
    /// Writes until the scene ends or is deleted.
    fn run(mut self, jobs: &Receiver<Job>, tick: Tick, previous: Option<(u32, u64)>) {
        self.begin_segment(tick, previous);
        let mut batches = Vec::new();
        while let Ok(job) = jobs.recv() {
            let mut next = Some(job);
            while let Some(Job::Batch(batch)) = next {
                batches.push(batch);
                next = jobs.try_recv().ok();
            }
            self.write(&mut batches);
            match next {
                Some(Job::Snapshot(frozen, point)) => self.begin_snapshot(*frozen, point),
                Some(Job::Written(number, written)) => self.end_snapshot(number, written),
                Some(Job::Delete) => return self.delete(),
                Some(Job::End) => return,
                Some(Job::Batch(_)) | None => {}
            }
        }
    }

    /// Makes batches durable, unless the log is broken.
    fn write(&mut self, batches: &mut Vec<Batch>) {
        let batches = mem::take(batches);
        if batches.is_empty() {
            return;
        }
        self.batches += batches.len() as u64;
        let bytes: usize = batches.iter().map(Batch::memory_bytes).sum();
        if self.shared.is_broken() {
            self.segment = None;
        }
        let looked = self.look(bytes);
        if let Some(segment) = &mut self.segment {
            let written = looked.and_then(|()| segment.append(&batches));
            match written.and_then(|()| segment.sync()) {
                Ok(()) => self.report_durable(),
                Err(error) => self.break_off(&error),
            }
        }
        self.shared
            .waiting_bytes
            .fetch_sub(bytes, Ordering::Relaxed);
    }

    /// Looks at the room after so many more bytes, now and then.
    fn look(&mut self, bytes: usize) -> Result<(), DataError> {
        self.unlooked = self.unlooked.saturating_add(bytes);
        if self.unlooked < LOOK_BYTES || self.segment.is_none() {
            return Ok(());
        }
        self.room.check(&self.files.directory)?;
        self.unlooked = 0;
        Ok(())
    }

    fn report_durable(&self) {
        self.shared.durable.store(self.batches, Ordering::Release);
        (self.wake)();
    }

    /// Gives the log up until the next snapshot. A file whose synchronisation failed is not trusted again.
    fn break_off(&mut self, error: &DataError) {
        tracing::error!(scene = %self.scene, %error, "commands are not durable until the next snapshot");
        self.segment = None;
        self.shared.give_up();
        (self.wake)();
    }

    fn begin_segment(&mut self, tick: Tick, previous: Option<(u32, u64)>) {
        let header = LogHeader {
            scene: self.scene.clone(),
            config: self.config,
            previous,
        };
        let number = self.next;
        self.next += 1;
        match self.files.begin_segment(number, tick, &header) {
            Ok(segment) => self.segment = Some(segment),
            Err(error) => self.break_off(&error),
        }
    }

    /// Continues in a new segment with a snapshot of its beginning. A broken log begins anew with it, unless it was given
    /// up since: the scene may have left that state.
    fn begin_snapshot(&mut self, frozen: Frozen, point: SnapshotPoint) {
        self.batches = point.batches;
        match self.segment.take().filter(|_| !self.shared.is_broken()) {
            Some(before) => self.continue_after(&before, frozen),
            None if point.given_up == self.shared.given_up() => {
                self.begin_anew(frozen, point.given_up);
            }
            None => self.shared.snapshot.store(false, Ordering::Relaxed),
        }
    }

    /// Writes the snapshot before the log: nothing else has the state. Perhaps the directory could not be made before.
    /// `given_up`: how often the log had been when the snapshot was taken.
    fn begin_anew(&mut self, frozen: Frozen, given_up: u64) {
        let (tick, number) = (frozen.tick, self.next);
        let has_room = self.room.check_others(&self.files.directory);
        let made = has_room.and_then(|()| self.files.make_directory());
        let written = made.and_then(|()| write_snapshot(&self.files, number, frozen));
        if written.is_ok() {
            self.begin_segment(tick, None);
        } else {
            self.next += 1;
        }
        if written.is_ok() && self.segment.is_some() {
            self.shared.made_whole.store(given_up, Ordering::Relaxed);
            // The scene may have given it up meanwhile.
            if !self.shared.is_broken() {
                tracing::info!(scene = %self.scene, tick = tick.value(), "commands are durable again");
                self.report_durable();
            }
        }
        self.end_snapshot(number, written);
    }

    /// Writes the snapshot beside the log, which continues after a segment.
    fn continue_after(&mut self, before: &Segment, frozen: Frozen) {
        let number = self.next;
        self.begin_segment(frozen.tick, Some((before.number, before.length)));
        if self.segment.is_none() {
            // Nothing would follow the snapshot.
            return self.shared.snapshot.store(false, Ordering::Relaxed);
        }
        let (files, jobs) = (self.files.clone(), self.jobs.clone());
        let write = move || {
            let written = write_snapshot(&files, number, frozen);
            // A log that has ended needs no report.
            let _ = jobs.send(Job::Written(number, written));
        };
        let thread = thread::Builder::new().name("rhumb-snapshot".to_owned());
        if let Err(cause) = thread.spawn(write) {
            tracing::error!(scene = %self.scene, %cause, "no thread for a snapshot");
            self.shared.snapshot.store(false, Ordering::Relaxed);
        }
    }

    /// Notes a snapshot, and removes what only older ones than the one before it need.
    fn end_snapshot(&mut self, number: u32, written: Result<(), DataError>) {
        self.shared.snapshot.store(false, Ordering::Relaxed);
        let removed = written.and_then(|()| match self.oldest_needed.replace(number) {
            Some(before) => self.files.remove_before(before),
            None => Ok(()),
        });
        if let Err(error) = removed {
            tracing::error!(scene = %self.scene, %error, "a snapshot failed");
        }
    }

    fn delete(mut self) {
        self.segment = None;
        if let Err(error) = self.files.delete() {
            tracing::error!(scene = %self.scene, %error, "a deleted scene may come back");
        }
    }
}

fn write_snapshot(files: &SceneFiles, segment: u32, frozen: Frozen) -> Result<(), DataError> {
    let path = files.snapshot_path(segment);
    let scene = (frozen.scene.encode()).ok_or(io::Error::from(io::ErrorKind::InvalidData));
    let snapshot = Snapshot {
        segment,
        tick: frozen.tick,
        digest: frozen.digest,
        sessions: frozen.sessions,
        ownership: frozen.ownership,
        scene: scene.map_err(DataError::io(&path, "encode"))?,
    };
    files.write_snapshot(&snapshot)
}
