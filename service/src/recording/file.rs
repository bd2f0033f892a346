//! One file of a recording, and the bound on all of them.

use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rhumb_protocol::Instant;
use rhumb_protocol::scene::SceneName;
use rhumb_trace::{McapError, NoSeek, SceneFacts, TraceFile};

/// The ending of a file's name.
const ENDING: &str = ".mcap";
/// The program that writes, in each file.
const LIBRARY: &str = concat!("rhumb-server/", env!("CARGO_PKG_VERSION"));

/// The head of a file: its scene and its beginning.
#[derive(Clone, Copy, Debug)]
pub(super) struct FileHead<'a> {
    pub(super) scene: &'a SceneName,
    /// The numbers of its engine for predictions.
    pub(super) facts: &'a SceneFacts,
    /// Its first tick.
    pub(super) tick: u64,
    /// When it was begun, seconds since 1970.
    pub(super) seconds: i64,
}

/// A file that grows.
pub(super) struct RecordingFile {
    pub(super) trace: TraceFile<NoSeek<BufWriter<CountedFile>>>,
    pub(super) path: PathBuf,
    written: Arc<AtomicU64>,
    pub(super) began: Instant,
}

/// A file that counts its bytes.
pub(super) struct CountedFile {
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
pub(super) fn remove_oldest(
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
