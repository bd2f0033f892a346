//! The thread that writes scenes to MCAP files, and the bound on them.
//!
//! A second at most lies between a tick and its chunk on the disk: a crash costs what came after the last chunk. A file
//! that cannot be written is given up, and another one is tried later: a full disk costs log lines and ticks of the
//! recording, never a tick of the scene.

use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rhumb_protocol::scene::SceneName;
use rhumb_protocol::{Instant, Span};
use rhumb_scene::Limits;
use rhumb_trace::{McapError, NoSeek, SceneFacts, TraceFile};
use rhumb_transport::Clock;

use super::tap::{QueuedBytes, SceneTaps, SceneWriter, TapMessage, TapQueue, TickRecord};

/// Longest time between a tick and the end of its chunk.
const CHUNK: Span = Span::from_millis(1_000);
/// Pause after a file could not be written.
const RETRY: Span = Span::from_millis(10_000);

/// The thread; dropping this ends it once all that waits is written.
pub(crate) struct Recorder {
    messages: Sender<TapMessage>,
    thread: Option<JoinHandle<()>>,
}

/// Bounds of a recording.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RecordingLimits {
    file_bytes: u64,
    file_time: Span,
    total_bytes: u64,
    waiting_bytes: usize,
}

impl RecordingLimits {
    pub(crate) const fn of(limits: &Limits) -> Self {
        Self {
            file_bytes: limits.record_file_mib << 20,
            file_time: Span::from_millis(limits.record_file_minutes * 60_000),
            total_bytes: limits.record_total_mib << 20,
            waiting_bytes: (limits.record_waiting_mib << 20) as usize,
        }
    }

    /// Bytes of records that may wait for one reader.
    #[cfg(feature = "foxglove")]
    pub(super) const fn waiting_bytes(&self) -> usize {
        self.waiting_bytes
    }
}

impl Recorder {
    /// Starts the thread, and makes the directory. `seconds`: the system's time since 1970.
    ///
    /// # Errors
    ///
    /// The system's, if the directory cannot be made or the thread cannot start.
    pub(crate) fn start(
        directory: PathBuf,
        limits: RecordingLimits,
        seconds: fn() -> i64,
        taps: &SceneTaps,
    ) -> io::Result<Self> {
        fs::create_dir_all(&directory)?;
        let (messages, received) = channel();
        let waiting = QueuedBytes::default();
        taps.add(TapQueue {
            messages: messages.clone(),
            waiting: waiting.clone(),
            bytes_max: limits.waiting_bytes,
        });
        let recording = Recording {
            directory,
            limits,
            seconds,
            clock: Clock::start(),
            scenes: BTreeMap::new(),
        };
        let thread = thread::Builder::new()
            .name("rhumb-record".to_owned())
            .spawn(move || recording.run(&received, &waiting))?;
        Ok(Self {
            messages,
            thread: Some(thread),
        })
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // Fails only if the thread has ended.
        let _ = self.messages.send(TapMessage::End);
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was logged.
            let _ = thread.join();
        }
    }
}

/// All scenes that are recorded.
struct Recording {
    directory: PathBuf,
    limits: RecordingLimits,
    seconds: fn() -> i64,
    clock: Clock,
    scenes: BTreeMap<(SceneName, u64), RecordedScene>,
}

/// One scene, and its file unless that could not be written.
struct RecordedScene {
    writer: SceneWriter,
    file: Option<RecordingFile>,
    retry_at: Instant,
}

impl Recording {
    fn run(mut self, messages: &Receiver<TapMessage>, waiting: &QueuedBytes) {
        let mut flushed = self.clock.now();
        loop {
            let since = self.clock.now().since(flushed);
            let left = CHUNK.as_nanos().saturating_sub(since.as_nanos());
            match messages.recv_timeout(Duration::from_nanos(left)) {
                Ok(TapMessage::Tick(record)) => {
                    self.write(&record);
                    waiting.remove(record.bytes());
                }
                Ok(TapMessage::Ended(scene, number)) => {
                    if let Some(ended) = self.scenes.remove(&(scene, number)) {
                        ended.finish();
                    }
                }
                Ok(TapMessage::End) | Err(RecvTimeoutError::Disconnected) => break,
                Err(RecvTimeoutError::Timeout) => {}
            }
            if self.clock.now().since(flushed) >= CHUNK {
                self.flush();
                flushed = self.clock.now();
            }
        }
        for scene in self.scenes.into_values() {
            scene.finish();
        }
    }

    fn write(&mut self, record: &TickRecord) {
        let now = self.clock.now();
        let key = (record.scene.clone(), record.number);
        let scene = self.scenes.entry(key).or_insert_with(|| RecordedScene {
            writer: SceneWriter::new(record),
            file: None,
            retry_at: Instant::ZERO,
        });
        let is_over = |file: &mut RecordingFile| {
            file.bytes() >= self.limits.file_bytes || now.since(file.began) >= self.limits.file_time
        };
        if let Some(full) = scene.file.take_if(is_over) {
            finish(full);
        }
        if scene.file.is_none() && scene.retry_at <= now {
            scene.writer.begin();
            let head = FileHead {
                scene: &record.scene,
                facts: &record.facts,
                tick: record.tick.value(),
                seconds: (self.seconds)(),
            };
            match RecordingFile::create(&self.directory, &head, now) {
                Ok(file) => scene.file = Some(file),
                Err(cause) => scene.give_up(now, &self.directory, &cause),
            }
        }
        let Some(file) = &mut scene.file else {
            return scene.writer.skip(record);
        };
        if let Err(cause) = scene.writer.write(&mut file.trace, record) {
            let path = file.path.clone();
            scene.give_up(now, &path, &cause);
        }
    }

    /// Ends the chunks of all files, and removes the oldest files.
    fn flush(&mut self) {
        let now = self.clock.now();
        for scene in self.scenes.values_mut() {
            if let Some(file) = &mut scene.file
                && let Err(cause) = file.trace.flush()
            {
                let path = file.path.clone();
                scene.give_up(now, &path, &cause);
            }
        }
        let open: Vec<&Path> = (self.scenes.values())
            .filter_map(|scene| Some(scene.file.as_ref()?.path.as_path()))
            .collect();
        let (directory, most) = (&self.directory, self.limits.total_bytes);
        if let Err(cause) = remove_oldest(directory, most, |path| open.contains(&path)) {
            let directory = directory.display();
            tracing::error!(%directory, %cause, "old recordings cannot be removed");
        }
    }
}

impl RecordedScene {
    /// Continues without the file; another one is tried later.
    fn give_up(&mut self, now: Instant, path: &Path, cause: &McapError) {
        let path = path.display();
        tracing::error!(%path, %cause, "a recording cannot be written; it continues in another file after ten seconds");
        self.file = None;
        self.retry_at = now + RETRY;
    }

    fn finish(self) {
        if let Some(file) = self.file {
            finish(file);
        }
    }
}

fn finish(file: RecordingFile) {
    let path = file.path.clone();
    if let Err(cause) = file.finish() {
        let path = path.display();
        tracing::error!(%path, %cause, "the end of a recording cannot be written; it can be read up to its last chunk");
    }
}

/// The ending of a file's name.
const ENDING: &str = ".mcap";
/// The program that writes, in each file.
const LIBRARY: &str = concat!("rhumb-server/", env!("CARGO_PKG_VERSION"));

/// The head of a file: its scene and its beginning.
#[derive(Clone, Copy, Debug)]
struct FileHead<'a> {
    pub(super) scene: &'a SceneName,
    /// The numbers of its engine for predictions.
    pub(super) facts: &'a SceneFacts,
    /// Its first tick.
    pub(super) tick: u64,
    /// When it was begun, seconds since 1970.
    pub(super) seconds: i64,
}

/// A file that grows.
struct RecordingFile {
    pub(super) trace: TraceFile<NoSeek<BufWriter<CountedFile>>>,
    pub(super) path: PathBuf,
    written: Arc<AtomicU64>,
    pub(super) began: Instant,
}

/// A file that counts its bytes.
struct CountedFile {
    file: File,
    written: Arc<AtomicU64>,
}

impl Write for CountedFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.file.write(bytes)?;
        self.written.fetch_add(written as u64, Ordering::Relaxed);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl RecordingFile {
    /// Begins a new file of a directory.
    pub(super) fn create(
        directory: &Path,
        head: &FileHead<'_>,
        now: Instant,
    ) -> Result<Self, McapError> {
        let (path, file) = create(directory, head)?;
        Self::begin((path, file), head, now)
    }

    /// Begins to write to an empty file.
    pub(super) fn begin(
        (path, file): (PathBuf, File),
        head: &FileHead<'_>,
        now: Instant,
    ) -> Result<Self, McapError> {
        let written = Arc::new(AtomicU64::new(0));
        let counted = CountedFile {
            file,
            written: Arc::clone(&written),
        };
        let mut trace = TraceFile::growing(BufWriter::new(counted), LIBRARY)?;
        let mut metadata: BTreeMap<_, _> = [
            ("scene", head.scene.to_string()),
            ("first_tick", head.tick.to_string()),
            ("began", head.seconds.to_string()),
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into();
        metadata.extend(head.facts.to_metadata());
        // Names are distinct, so that files can be merged.
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        trace.put_metadata(format!("rhumb.scene.{stem}"), metadata)?;
        Ok(Self {
            trace,
            path,
            written,
            began: now,
        })
    }

    /// Bytes written to the file so far.
    pub(super) fn bytes(&self) -> u64 {
        self.written.load(Ordering::Relaxed)
    }

    /// Writes the indexes and closes the file.
    pub(super) fn finish(self) -> Result<(), McapError> {
        Ok(self.trace.finish()?.flush()?)
    }
}

/// Makes a file with a new name; names sort in the order of time.
fn create(directory: &Path, head: &FileHead<'_>) -> io::Result<(PathBuf, File)> {
    let scene: String = (head.scene.as_str().chars())
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '_' })
        .collect();
    for number in 0_u32.. {
        let more = if number == 0 {
            String::new()
        } else {
            format!(".{number}")
        };
        let path = directory.join(format!("{:011}.{scene}{more}{ENDING}", head.seconds));
        match File::create_new(&path) {
            Ok(file) => {
                mark_open(&file);
                return Ok((path, file));
            }
            Err(cause) if cause.kind() == io::ErrorKind::AlreadyExists => {}
            Err(cause) => return Err(cause),
        }
    }
    Err(io::ErrorKind::AlreadyExists.into())
}

/// Shows the other processes of the server, which share the directory, that a file is open: by a lock, which ends with
/// the process. Where the file system has no locks, they may remove the file when the directory is full, as they may in the
/// moment between its creation and the lock. Another process that looks holds its own lock for a moment only.
fn mark_open(file: &File) {
    if let Err(cause) = file.lock() {
        tracing::debug!(%cause, "a recording cannot be locked");
    }
}

/// True if any process of the server has the file open.
fn is_marked_open(path: &Path) -> bool {
    let locked = File::open(path).map(|file| file.try_lock_shared());
    matches!(locked, Ok(Err(TryLockError::WouldBlock)))
}

/// Removes the oldest files until all together have at most so many bytes; those that are open stay. Other processes
/// may do the same in the same directory.
fn remove_oldest(
    directory: &Path,
    bytes_max: u64,
    is_open: impl Fn(&Path) -> bool,
) -> io::Result<()> {
    let mut files = Vec::new();
    for entry in fs::read_dir(directory)? {
        let entry = entry?;
        let path = entry.path();
        if path.to_string_lossy().ends_with(ENDING) {
            match entry.metadata() {
                Ok(metadata) => files.push((path, metadata.len())),
                Err(cause) if cause.kind() == io::ErrorKind::NotFound => {}
                Err(cause) => return Err(cause),
            }
        }
    }
    files.sort();
    let mut total: u64 = files.iter().map(|(_, bytes)| bytes).sum();
    for (path, bytes) in &files {
        if total <= bytes_max {
            break;
        }
        if is_open(path) || is_marked_open(path) {
            continue;
        }
        match fs::remove_file(path) {
            Err(cause) if cause.kind() != io::ErrorKind::NotFound => return Err(cause),
            _ => total -= bytes,
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::scene::SceneConfig;

    use super::*;

    #[test]
    fn the_oldest_closed_files_are_removed_beyond_the_bound() {
        let directory = tempfile::tempdir().unwrap();
        let write = |name: &str| {
            let path = directory.path().join(name);
            fs::write(&path, [0; 100]).unwrap();
            path
        };
        let [first, second, third, other] =
            ["1.a.mcap", "2.a.mcap", "3.a.mcap", "0.txt"].map(write);
        remove_oldest(directory.path(), 200, |path| path == first).unwrap();
        assert!(first.exists(), "it is open");
        assert!(!second.exists() && third.exists() && other.exists());
    }

    #[test]
    fn a_file_that_another_process_writes_stays() {
        let directory = tempfile::tempdir().unwrap();
        let scene = "pit".parse().unwrap();
        let head = FileHead {
            scene: &scene,
            facts: &SceneFacts::of(&SceneConfig::default()),
            tick: 0,
            seconds: 7,
        };
        // A lock belongs to the opened file, not to the process.
        let (path, file) = create(directory.path(), &head).unwrap();
        fs::write(&path, [0; 100]).unwrap();
        remove_oldest(directory.path(), 0, |_| false).unwrap();
        assert!(path.exists());
        drop(file);
        remove_oldest(directory.path(), 0, |_| false).unwrap();
        assert!(!path.exists());
    }

    #[test]
    fn files_of_one_second_have_names_of_their_own() {
        let directory = tempfile::tempdir().unwrap();
        let scene = "team/pit".parse().unwrap();
        let head = FileHead {
            scene: &scene,
            facts: &SceneFacts::of(&SceneConfig::default()),
            tick: 0,
            seconds: 7,
        };
        let names = [(); 3].map(|()| create(directory.path(), &head).unwrap().0);
        let names = names.map(|path| path.file_name().unwrap().to_owned());
        let expected = [
            "00000000007.team_pit.mcap",
            "00000000007.team_pit.1.mcap",
            "00000000007.team_pit.2.mcap",
        ];
        assert_eq!(names.map(|name| name.into_string().unwrap()), expected);
    }
}

#[cfg(all(test, target_os = "linux"))]
mod full_disk_tests {
    use rhumb_protocol::scene::SceneConfig;
    use rhumb_reckoning::Tick;
    use rhumb_trace::SceneFacts;

    use super::*;

    fn recording(directory: &Path, limits: RecordingLimits) -> Recording {
        Recording {
            directory: directory.to_owned(),
            limits,
            seconds: || 7,
            clock: Clock::start(),
            scenes: BTreeMap::new(),
        }
    }

    fn record(tick: u64) -> TickRecord {
        TickRecord {
            scene: "pit".parse().expect("a name"),
            number: 0,
            facts: SceneFacts::of(&SceneConfig::default()),
            tick: Tick::new(tick),
            is_whole: tick == 1,
            observed: Vec::new(),
            placed: Vec::new(),
            removed: Vec::new(),
        }
    }

    fn key() -> (SceneName, u64) {
        ("pit".parse().expect("a name"), 0)
    }

    fn files(directory: &Path) -> usize {
        fs::read_dir(directory)
            .expect("the directory is read")
            .count()
    }

    #[test]
    fn a_directory_that_is_gone_costs_the_recording_and_comes_back() {
        let above = tempfile::tempdir().unwrap();
        let directory = above.path().join("gone");
        let mut recording = recording(&directory, RecordingLimits::of(&Limits::default()));
        recording.write(&record(1));
        assert!(recording.scenes[&key()].file.is_none());
        fs::create_dir(&directory).unwrap();
        recording.write(&record(2));
        assert_eq!(files(&directory), 0, "it waits before it tries again");
        recording.scenes.get_mut(&key()).unwrap().retry_at = Instant::ZERO;
        recording.write(&record(3));
        assert_eq!(files(&directory), 1);
    }

    #[test]
    fn a_full_disk_ends_the_file_and_not_the_thread() {
        let directory = tempfile::tempdir().unwrap();
        let mut recording = recording(directory.path(), RecordingLimits::of(&Limits::default()));
        recording.write(&record(1));
        let full = File::options().write(true).open("/dev/full").unwrap();
        let (scene, _) = key();
        let head = FileHead {
            scene: &scene,
            facts: &SceneFacts::of(&SceneConfig::default()),
            tick: 1,
            seconds: 7,
        };
        let file = RecordingFile::begin(("/dev/full".into(), full), &head, Instant::ZERO).unwrap();
        recording.scenes.get_mut(&key()).unwrap().file = Some(file);
        recording.write(&record(2));
        recording.flush();
        assert!(recording.scenes[&key()].file.is_none());
        recording.scenes.get_mut(&key()).unwrap().retry_at = Instant::ZERO;
        recording.write(&record(3));
        assert!(recording.scenes[&key()].file.is_some());
        assert_eq!(files(directory.path()), 2);
    }

    #[test]
    fn a_full_file_is_followed_by_another_and_the_oldest_is_removed() {
        let directory = tempfile::tempdir().unwrap();
        let limits = RecordingLimits {
            file_bytes: 1,
            file_time: Span::from_millis(3_600_000),
            total_bytes: 1,
            waiting_bytes: 1,
        };
        let mut recording = recording(directory.path(), limits);
        for tick in 1..=3 {
            recording.write(&record(tick));
            recording.flush();
            assert_eq!(files(directory.path()), 1, "the open file stays");
        }
    }
}
