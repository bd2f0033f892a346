//! Flight recorders: the last moments of each scene, written after a fault.
//!
//! Each scene keeps its commands, steps and packet heads in bounded memory. After a fault, a thread of its own writes
//! them to a file that `rhumb-server flight FILE` prints. Invariants: a scene never waits for the disk; memory, the
//! number of files and their rate are bounded.

mod file;
mod recorder;
mod ring;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use std::{fs, io};

use rhumb_protocol::scene::SceneName;
use rhumb_scene::Limits;

use self::file::{FlightHead, encode};
use self::recorder::FlightJob;

pub(crate) use self::file::FlightCause;
pub(crate) use file::run;
pub(crate) use recorder::{FlightRecorder, FlightRecorders, ForwardedFlight};

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
