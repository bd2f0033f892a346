//! Flight recorders: the last moments of each scene, written after a fault.
//!
//! Each scene keeps its commands, steps and packet heads in bounded memory. After a fault, a thread of its own writes
//! them to a file that `rhumb-server flight FILE` prints. Invariants: a scene never waits for the disk; memory, the
//! number of files and their rate are bounded. A scene locks its own ring for one entry at a time, and not while it steps:
//! the dispatcher can copy the ring of a scene that is stuck.

mod file;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::{fs, io};

use bytes::Bytes;
use rhumb_protocol::scene::{Command, CommandError, SceneName};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Writer;
use rhumb_protocol::{Instant, Peer};
use rhumb_reckoning::Tick;
use rhumb_scene::{
    COMMAND_BYTES_KEPT, Digest, Limits, LogEntry, PacketHead, ReceivedCommand, TickMetrics,
};

use self::file::{FlightHead, FlightRing, encode};

pub(crate) use self::file::FlightCause;
pub(crate) use file::run;

/// Recorders that wait for the disk.
const JOBS_WAITING_MAX: usize = 8;
/// Seconds between two files of one scene.
const PAUSE_SECONDS: i64 = 10;
/// The ending of a file's name.
const ENDING: &str = ".flight";

/// The thread; dropping this ends it once all that waits is written.
pub(crate) struct FlightWriter {
    jobs: SyncSender<FlightJob>,
    thread: Option<JoinHandle<()>>,
}

impl FlightWriter {
    /// Starts the thread, and makes the directory. `seconds`: the system's time since 1970.
    ///
    /// # Errors
    ///
    /// The system's, if the directory cannot be made or the thread cannot start.
    pub(crate) fn start(
        directory: PathBuf,
        limits: &Limits,
        seconds: fn() -> i64,
    ) -> io::Result<(Self, FlightRecorders)> {
        fs::create_dir_all(&directory)?;
        let (jobs, received) = sync_channel(JOBS_WAITING_MAX);
        let files_max = limits.flight_files as usize;
        let thread = thread::Builder::new()
            .name("rhumb-flight".to_owned())
            .spawn(move || write_jobs(&directory, files_max, seconds, &received))?;
        let bytes_max = (limits.flight_kib << 10) as usize;
        let recorders = FlightRecorders::new(jobs.clone(), bytes_max);
        let thread = Some(thread);
        Ok((Self { jobs, thread }, recorders))
    }
}

impl Drop for FlightWriter {
    fn drop(&mut self) {
        // Fails only if the thread has ended.
        let _ = self.jobs.send(FlightJob::End);
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was logged.
            let _ = thread.join();
        }
    }
}

fn write_jobs(
    directory: &Path,
    files_max: usize,
    seconds: fn() -> i64,
    jobs: &Receiver<FlightJob>,
) {
    let mut last: BTreeMap<SceneName, i64> = BTreeMap::new();
    for job in jobs {
        let FlightJob::Write {
            scene,
            cause,
            dropped,
            entries,
        } = job
        else {
            return;
        };
        let now = seconds();
        last.retain(|_, at| (0..PAUSE_SECONDS).contains(&(now - *at)));
        if last.contains_key(&scene) {
            tracing::info!(%scene, %cause, "a flight recorder is not written twice in ten seconds");
            continue;
        }
        let head = FlightHead {
            server: env!("CARGO_PKG_VERSION").to_owned(),
            scene: scene.as_str().to_owned(),
            cause,
            written: now,
            dropped,
        };
        match write(directory, files_max, &head, &entries) {
            Ok(path) => {
                let path = path.display();
                tracing::warn!(%scene, %cause, %path, "a flight recorder is written");
                last.insert(scene, now);
            }
            Err(error) => {
                let directory = directory.display();
                tracing::error!(%scene, %cause, %directory, %error, "a flight recorder cannot be written");
            }
        }
    }
}

/// Writes a file under a temporary name, renames it, and removes the oldest beyond the bound.
fn write(
    directory: &Path,
    files_max: usize,
    head: &FlightHead,
    entries: &[u8],
) -> io::Result<PathBuf> {
    let bytes = encode(head, entries).ok_or(io::ErrorKind::InvalidInput)?;
    let scene: String = (head.scene.chars())
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '_' })
        .collect();
    // Names in the order of time; the scene's exact name is in the file.
    let name = format!("{:011}.{scene}.{}", head.written, head.cause.word());
    let path = (0_u32..)
        .map(|number| match number {
            0 => directory.join(format!("{name}{ENDING}")),
            _ => directory.join(format!("{name}.{number}{ENDING}")),
        })
        .find(|path| !path.exists())
        .ok_or(io::ErrorKind::AlreadyExists)?;
    let temporary = path.with_extension("tmp");
    let written = fs::write(&temporary, bytes).and_then(|()| fs::rename(&temporary, &path));
    if let Err(cause) = written {
        // The rest of a file that cannot be written; if it stays, the next one replaces it.
        let _ = fs::remove_file(&temporary);
        return Err(cause);
    }
    let mut files = Vec::new();
    for entry in fs::read_dir(directory)? {
        let path = entry?.path();
        if path.to_string_lossy().ends_with(ENDING) {
            files.push(path);
        }
    }
    files.sort();
    for old in &files[..files.len().saturating_sub(files_max)] {
        fs::remove_file(old)?;
    }
    Ok(path)
}

/// The flight recorders of all scenes; all clones are one. The default records nothing.
#[derive(Clone, Default)]
pub(crate) struct FlightRecorders(Option<Arc<Recorders>>);

struct Recorders {
    rings: Mutex<BTreeMap<SceneName, SharedRing>>,
    out: FlightOutlet,
    /// Bytes of each ring.
    bytes_max: usize,
}

/// The way of entries that are to be kept or written.
enum FlightOutlet {
    /// To the thread that writes files.
    Writer(SyncSender<FlightJob>),
    /// To the dispatcher: a process that ends takes its memory along.
    Dispatcher(ForwardFlight),
}

/// Hands something to the dispatcher of a worker process.
type ForwardFlight = Arc<dyn Fn(&SceneName, ForwardedFlight) + Send + Sync>;

/// Entries that a worker process hands to its dispatcher.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum ForwardedFlight {
    /// New entries.
    Entries(Vec<u8>),
    /// The recorder is to be written.
    Write(FlightCause),
}

type SharedRing = Arc<Mutex<FlightRing>>;

/// The flight recorder of one scene; dropping it ends it. In a thread that panics, it is written first.
pub(crate) struct FlightRecorder {
    name: SceneName,
    ring: Option<SharedRing>,
    recorders: FlightRecorders,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // An entry is added whole or not at all.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl FlightRecorders {
    /// Recorders of so many bytes each, which hand what is to be written to a thread.
    fn new(jobs: SyncSender<FlightJob>, bytes_max: usize) -> Self {
        Self::with(FlightOutlet::Writer(jobs), bytes_max)
    }

    /// Recorders of a worker process, whose entries the dispatcher keeps. So many bytes wait for that, at most.
    pub(crate) fn forwarding(forward: ForwardFlight, bytes_max: usize) -> Self {
        Self::with(FlightOutlet::Dispatcher(forward), bytes_max)
    }

    fn with(out: FlightOutlet, bytes_max: usize) -> Self {
        let rings = Mutex::default();
        Self(Some(Arc::new(Recorders {
            rings,
            out,
            bytes_max,
        })))
    }

    /// True if anything is recorded.
    pub(crate) const fn is_on(&self) -> bool {
        self.0.is_some()
    }

    /// Hands the entries of all scenes to the dispatcher.
    pub(crate) fn forward_all(&self) {
        let Some(recorders) = &self.0 else {
            return;
        };
        let rings = lock(&recorders.rings).clone();
        for (name, ring) in &rings {
            self.forward(name, ring);
        }
    }

    /// Hands the entries of a scene to the dispatcher, if they go there.
    fn forward(&self, name: &SceneName, ring: &SharedRing) {
        if let Some(recorders) = &self.0
            && let FlightOutlet::Dispatcher(forward) = &recorders.out
        {
            let entries = lock(ring).take();
            if !entries.is_empty() {
                forward(name, ForwardedFlight::Entries(entries));
            }
        }
    }

    /// The recorder of a new scene.
    pub(crate) fn begin(&self, name: &SceneName) -> FlightRecorder {
        let ring = self.0.as_ref().map(|recorders| {
            let ring = Arc::new(Mutex::new(FlightRing::new(recorders.bytes_max)));
            lock(&recorders.rings).insert(name.clone(), Arc::clone(&ring));
            ring
        });
        FlightRecorder {
            name: name.clone(),
            ring,
            recorders: self.clone(),
        }
    }

    /// Writes the recorders of some scenes, whatever their threads do.
    pub(crate) fn write_where(&self, is_wanted: impl Fn(&SceneName) -> bool, cause: FlightCause) {
        let Some(recorders) = &self.0 else {
            return;
        };
        let rings = lock(&recorders.rings).clone();
        for (name, ring) in rings.iter().filter(|(name, _)| is_wanted(name)) {
            self.write(name, ring, cause);
        }
    }

    fn write(&self, scene: &SceneName, ring: &SharedRing, cause: FlightCause) {
        let Some(recorders) = &self.0 else {
            return;
        };
        let jobs = match &recorders.out {
            FlightOutlet::Writer(jobs) => jobs,
            FlightOutlet::Dispatcher(forward) => {
                self.forward(scene, ring);
                return forward(scene, ForwardedFlight::Write(cause));
            }
        };
        let (entries, dropped) = lock(ring).copy();
        let job = FlightJob::Write {
            scene: scene.clone(),
            cause,
            dropped,
            entries,
        };
        if jobs.try_send(job).is_err() {
            tracing::warn!(%scene, %cause, "a flight recorder is not written: too many wait for the disk");
        }
    }
}

impl FlightRecorder {
    fn push(&self, entry: &LogEntry) {
        if let Some(ring) = &self.ring {
            lock(ring).push(entry);
        }
    }

    pub(crate) fn joined(&self, peer: Peer, client: Option<&str>) {
        self.push(&LogEntry::Joined(peer, client.map(Into::into)));
    }

    pub(crate) fn left(&self, peer: Peer) {
        self.push(&LogEntry::Left(peer));
    }

    /// A command is about to be checked and applied.
    pub(crate) fn command(&self, peer: Peer, number: u64, command: &Command) {
        if self.ring.is_none() {
            return;
        }
        let mut bytes = Writer::new();
        command.encode(&mut bytes);
        let mut bytes = bytes.into_bytes();
        let length = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
        bytes.truncate(COMMAND_BYTES_KEPT);
        let received = ReceivedCommand {
            member: peer,
            number,
            length,
            bytes,
        };
        self.push(&LogEntry::Received(received.into()));
    }

    /// The last command was refused.
    pub(crate) fn refused(&self, error: &CommandError) {
        self.push(&LogEntry::Refused(*error));
    }

    pub(crate) fn step_began(&self, at: Instant, tick: Tick) {
        self.push(&LogEntry::StepBegan(at, tick));
        // The dispatcher keeps the entries of a process before a step that ends it.
        if let Some(ring) = &self.ring {
            self.recorders.forward(&self.name, ring);
        }
    }

    /// Adds the entries of a scene in another process.
    pub(crate) fn append(&self, entries: &[u8]) {
        if let Some(ring) = &self.ring {
            lock(ring).append(entries);
        }
    }

    pub(crate) fn stepped(&self, metrics: &TickMetrics, digest: Digest) {
        self.push(&LogEntry::Stepped(digest.value()));
        self.push(&LogEntry::Measured((*metrics).into()));
    }

    /// The packets of a tick.
    pub(crate) fn packets<'a>(&self, packets: impl Iterator<Item = &'a Bytes>) {
        let Some(ring) = &self.ring else {
            return;
        };
        let mut ring = lock(ring);
        for packet in packets {
            ring.push(&LogEntry::Packet(PacketHead::of(packet)));
        }
    }

    /// Requests that the recorder be written.
    pub(crate) fn write(&self, cause: FlightCause) {
        if let Some(ring) = &self.ring {
            self.recorders.write(&self.name, ring, cause);
        }
    }
}

impl Drop for FlightRecorder {
    fn drop(&mut self) {
        if thread::panicking() {
            self.write(FlightCause::ThreadPanicked);
        }
        let (Some(recorders), Some(ring)) = (&self.recorders.0, &self.ring) else {
            return;
        };
        let mut rings = lock(&recorders.rings);
        // A quarantined scene ends late: another one may have its name by then.
        if (rings.get(&self.name)).is_some_and(|now| Arc::ptr_eq(now, ring)) {
            rings.remove(&self.name);
        }
    }
}

/// A piece of work for the thread.
enum FlightJob {
    /// The entries of a scene's recorder are to be written.
    Write {
        scene: SceneName,
        cause: FlightCause,
        /// Older entries that it no longer had.
        dropped: u64,
        entries: Vec<u8>,
    },
    /// Nothing more is to be written.
    End,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::FlightCause;

    fn head(written: i64) -> FlightHead {
        FlightHead {
            server: String::new(),
            scene: "a/b".to_owned(),
            cause: FlightCause::Quarantined,
            written,
            dropped: 0,
        }
    }

    #[test]
    fn the_oldest_files_are_removed_beyond_the_bound() {
        let directory = tempfile::tempdir().unwrap();
        let write = |at| write(directory.path(), 3, &head(at), b"").unwrap();
        let first = write(1);
        let later: Vec<_> = [2, 2, 3].map(write).into();
        assert!(!first.exists());
        assert!(later.iter().all(|path| path.exists()));
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 3);
    }

    #[test]
    fn a_directory_that_is_gone_is_an_error() {
        let directory = tempfile::tempdir().unwrap();
        let gone = directory.path().join("gone");
        assert!(write(&gone, 3, &head(1), b"").is_err());
    }
}
