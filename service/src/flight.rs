//! Flight recorders: the last moments of each scene, written after a fault.
//!
//! Each scene keeps its commands, steps and packet heads in bounded memory. After a fault, a thread of its own writes
//! them to a file that `rhumb-server flight FILE` prints. Invariants: a scene never waits for the disk; memory, the
//! number of files and their rate are bounded. A scene locks its own ring for one entry at a time, and not while it steps:
//! the dispatcher can copy the ring of a scene that is stuck.
//!
//! The ring drops its oldest entries and holds whole ones only. Each is its length, two bytes little-endian, and its bytes,
//! an entry of the record of a run. A file is eight bytes that name the format, the length of the head (two bytes,
//! little-endian), the head in postcard form, the entries, and the CRC-32 of everything before it.

use std::collections::{BTreeMap, VecDeque};
use std::error::Error;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::{fmt, fs, io};

use bytes::Bytes;
use rhumb_protocol::packet::Datagram;
use rhumb_protocol::scene::{Command, CommandError, SceneName};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::{Instant, Peer, Span};
use rhumb_reckoning::Tick;
use rhumb_scene::{
    COMMAND_BYTES_KEPT, Digest, Limits, LogEntry, PacketHead, ReceivedCommand, TickMetrics,
};
use serde::{Deserialize, Serialize};

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

/// Names the format and its version.
const MAGIC: &[u8; 8] = b"RHFLGHT2";
const CRC_BYTES: usize = 4;

/// The head of a file: its scene, cause and moment.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct FlightHead {
    /// The version of the server.
    server: String,
    scene: String,
    cause: FlightCause,
    /// When it was written, seconds since 1970.
    written: i64,
    /// Older entries that it no longer had.
    dropped: u64,
}

/// Reason why a file cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum UnreadableFlight {
    /// It does not begin as such a file does.
    NotAFlight,
    /// It was cut short or changed.
    Damaged,
}

impl fmt::Display for UnreadableFlight {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotAFlight => "is no file of a flight recorder of this version",
            Self::Damaged => "was cut short or changed",
        })
    }
}

/// The bytes of a file; `None` if the head is too long.
fn encode(head: &FlightHead, entries: &[u8]) -> Option<Vec<u8>> {
    let encoded = postcard::to_allocvec(head).ok()?;
    let mut bytes = MAGIC.to_vec();
    bytes.extend(u16::try_from(encoded.len()).ok()?.to_le_bytes());
    bytes.extend(encoded);
    bytes.extend(entries);
    bytes.extend(crc32fast::hash(&bytes).to_le_bytes());
    Some(bytes)
}

/// The head and the entries of a file.
fn decode(bytes: &[u8]) -> Result<(FlightHead, &[u8]), UnreadableFlight> {
    let rest = bytes.strip_prefix(MAGIC);
    let rest = rest.ok_or(UnreadableFlight::NotAFlight)?;
    decode_rest(bytes, rest).ok_or(UnreadableFlight::Damaged)
}

fn decode_rest<'a>(bytes: &[u8], rest: &'a [u8]) -> Option<(FlightHead, &'a [u8])> {
    let (rest, crc) = rest.split_at_checked(rest.len().checked_sub(CRC_BYTES)?)?;
    let body = &bytes[..bytes.len() - CRC_BYTES];
    if crc32fast::hash(body).to_le_bytes() != crc {
        return None;
    }
    let (length, rest) = rest.split_at_checked(2)?;
    let length = u16::from_le_bytes(length.try_into().ok()?);
    let (head, entries) = rest.split_at_checked(usize::from(length))?;
    Some((postcard::from_bytes(head).ok()?, entries))
}

/// A fault of a scene. The numbers in files are those of the order; new causes are added at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum FlightCause {
    /// The engine panicked.
    EnginePanicked,
    /// The thread of the scene panicked.
    ThreadPanicked,
    /// The scene did not answer the watchdog and is quarantined.
    Quarantined,
    /// The engine removed a body whose state was not finite.
    NotFinite,
    /// A checksum of a client's copy differs from that of the stream.
    ChecksumMismatch,
    /// The scene did not answer the watchdog, and its process was killed.
    Killed,
    /// The process of the scene ended.
    ProcessEnded,
}

impl FlightCause {
    /// The word for the cause in the name of a file.
    const fn word(self) -> &'static str {
        match self {
            Self::EnginePanicked => "engine-panicked",
            Self::ThreadPanicked => "thread-panicked",
            Self::Quarantined => "quarantined",
            Self::NotFinite => "not-finite",
            Self::ChecksumMismatch => "checksum-mismatch",
            Self::Killed => "killed",
            Self::ProcessEnded => "process-ended",
        }
    }
}

impl fmt::Display for FlightCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::EnginePanicked => "the physics engine panicked",
            Self::ThreadPanicked => "the thread of the scene panicked",
            Self::Quarantined => "the scene did not answer and is quarantined",
            Self::NotFinite => "a body's state was not finite",
            Self::ChecksumMismatch => "a client's copy has another checksum than its stream",
            Self::Killed => "the scene did not answer and its process was killed",
            Self::ProcessEnded => "the process of the scene ended",
        })
    }
}

/// Longest text of a printed command.
const COMMAND_TEXT_MAX: usize = 240;

/// Prints a file, oldest event first.
///
/// # Errors
///
/// For a file that cannot be read, with its path and the cause.
pub(crate) fn run(path: &Path, out: &mut dyn Write) -> Result<(), Box<dyn Error>> {
    let shown = path.display();
    let bytes = fs::read(path).map_err(|cause| format!("cannot read {shown}: {cause}"))?;
    let (head, rest) = decode(&bytes).map_err(|cause| format!("{shown} {cause}"))?;
    writeln!(out, "scene {}", head.scene)?;
    writeln!(out, "cause {}", head.cause)?;
    writeln!(
        out,
        "written {} seconds after 1970 by rhumb-server {}",
        head.written, head.server
    )?;
    writeln!(out, "{} older entries are not kept", head.dropped)?;
    for entry in entries(rest) {
        let entry = entry.ok_or_else(|| format!("{shown} has an entry of another version"))?;
        writeln!(out, "{}", text(&entry))?;
    }
    Ok(())
}

fn text(entry: &LogEntry) -> String {
    let ms = |span: Span| span.as_nanos() as f64 / 1e6;
    match entry {
        LogEntry::Joined(peer, client) => {
            let client = client.as_deref().unwrap_or("without a token");
            format!("client {} joins: {client}", peer.0)
        }
        LogEntry::Left(peer) => format!("client {} leaves", peer.0),
        LogEntry::Received(received) => {
            let shown = command(&received.bytes, received.length as usize);
            format!(
                "client {} command {}: {shown}",
                received.member.0, received.number
            )
        }
        LogEntry::Refused(error) => format!("  refused: {error}"),
        LogEntry::StepBegan(at, tick) => {
            let seconds = at.as_nanos() as f64 / 1e9;
            format!("{seconds:.6} s: step from tick {}", tick.value())
        }
        LogEntry::Stepped(digest) => format!("  digest {digest:016x}"),
        LogEntry::Measured(metrics) => format!(
            "  tick {}: step {:.3} ms, publish {:.3} ms, {} members, {} bodies, {} awake",
            metrics.tick.value(),
            ms(metrics.step),
            ms(metrics.publish),
            metrics.members,
            metrics.bodies,
            metrics.awake,
        ),
        LogEntry::Packet(head) => format!("  {}, {} bytes", packet(head.bytes()), head.length),
        changes => format!("  {changes:?}"),
    }
}

/// A command as far as it was kept.
fn command(bytes: &[u8], length: usize) -> String {
    if bytes.len() < length {
        return format!(
            "{length} bytes, of which {} were kept: {bytes:02x?}",
            bytes.len()
        );
    }
    let mut from = Reader::new(bytes);
    match Command::decode(&mut from) {
        Ok(command) => {
            let text = format!("{command:?}");
            text.chars().take(COMMAND_TEXT_MAX).collect()
        }
        Err(error) => format!("{error:?}: {bytes:02x?}"),
    }
}

fn packet(head: &[u8]) -> String {
    match Datagram::open(head) {
        Ok(datagram) => {
            let head = datagram.head();
            format!("{}: {:?}", head.stream, head.kind)
        }
        Err(error) => format!("packet {head:02x?}: {error:?}"),
    }
}

/// Longest encoded entry.
const ENTRY_BYTES_MAX: usize = 1_024;
const LENGTH_BYTES: usize = 2;

/// The newest entries of one scene.
#[derive(Debug)]
struct FlightRing {
    bytes: VecDeque<u8>,
    bytes_max: usize,
    /// The bytes of one entry, while it is encoded.
    encoded: Writer,
    /// Entries that were dropped for newer ones, or that were too long.
    dropped: u64,
}

impl FlightRing {
    fn new(bytes_max: usize) -> Self {
        Self {
            bytes: VecDeque::new(),
            bytes_max,
            encoded: Writer::new(),
            dropped: 0,
        }
    }

    fn push(&mut self, entry: &LogEntry) {
        let mut encoded = std::mem::take(&mut self.encoded);
        encoded.clear();
        entry.encode(&mut encoded);
        if encoded.len() <= ENTRY_BYTES_MAX {
            self.push_encoded(encoded.as_bytes());
        } else {
            self.dropped += 1;
        }
        self.encoded = encoded;
    }

    /// Adds entries that another ring gave away; bytes that are none end them.
    fn append(&mut self, mut entries: &[u8]) {
        while let Some((encoded, rest)) = split_entry(entries) {
            self.push_encoded(encoded);
            entries = rest;
        }
    }

    /// Gives all entries away.
    fn take(&mut self) -> Vec<u8> {
        self.bytes.drain(..).collect()
    }

    fn push_encoded(&mut self, encoded: &[u8]) {
        let length = encoded.len();
        while self.bytes.len() + LENGTH_BYTES + length > self.bytes_max {
            if !self.drop_oldest() {
                self.dropped += 1;
                return;
            }
        }
        self.bytes.extend((length as u16).to_le_bytes());
        self.bytes.extend(encoded);
    }

    /// False if there is none.
    fn drop_oldest(&mut self) -> bool {
        let (Some(low), Some(high)) = (self.bytes.pop_front(), self.bytes.pop_front()) else {
            return false;
        };
        let length = usize::from(u16::from_le_bytes([low, high]));
        self.bytes.drain(..length.min(self.bytes.len()));
        self.dropped += 1;
        true
    }

    /// All entries as bytes, and the number of those that were dropped.
    fn copy(&self) -> (Vec<u8>, u64) {
        (self.bytes.iter().copied().collect(), self.dropped)
    }
}

/// The entries in these bytes, in order; `None` stands for one that cannot be read, and ends them.
fn entries(mut bytes: &[u8]) -> impl Iterator<Item = Option<LogEntry>> {
    std::iter::from_fn(move || {
        if bytes.is_empty() {
            return None;
        }
        let entry = split_entry(bytes).and_then(|(entry, rest)| {
            bytes = rest;
            let mut from = Reader::new(entry);
            let entry = LogEntry::decode(&mut from).ok()?;
            from.finish().ok().map(|()| entry)
        });
        if entry.is_none() {
            bytes = &[];
        }
        Some(entry)
    })
}

/// The encoded entry at the beginning of some bytes, and the rest.
fn split_entry(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<LENGTH_BYTES>()?;
    let length = usize::from(u16::from_le_bytes(*length));
    (length <= ENTRY_BYTES_MAX).then(|| rest.split_at_checked(length))?
}

#[cfg(test)]
mod tests;
