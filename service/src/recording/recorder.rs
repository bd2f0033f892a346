//! The thread that writes scenes to MCAP files.
//!
//! A second at most lies between a tick and its chunk on the disk: a crash costs what came after the last chunk. A file
//! that cannot be written is given up, and another one is tried later: a full disk costs log lines and ticks of the
//! recording, never a tick of the scene.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rhumb_protocol::scene::SceneName;
use rhumb_protocol::{Instant, Span};
use rhumb_scene::Limits;
use rhumb_trace::McapError;
use rhumb_transport::Clock;

use super::file::{FileHead, RecordingFile, remove_oldest};
use super::tap::{QueuedBytes, SceneTaps, TapMessage, TapQueue, TickRecord};
use super::writer::SceneWriter;

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

#[cfg(all(test, target_os = "linux"))]
mod tests {
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
        let full = fs::File::options().write(true).open("/dev/full").unwrap();
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
