//! The files of a data directory, behind a trait; why they cannot be used.
//!
//! The trait lets a test lose what a crash may lose.
//! Knows no format. A name is durable only after its directory was synchronised, and bytes only after their file was.
//! Each error names the file, and what is lost.

use std::fmt;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use rhumb_reckoning::Tick;
use rhumb_transport::CertificateError;

/// A place for files.
pub(crate) trait Disk: Send + Sync {
    /// Names in a directory, in order; none if there is no such directory.
    fn list(&self, directory: &Path) -> io::Result<Vec<String>>;

    /// Everything in a file.
    fn read(&self, path: &Path) -> io::Result<Vec<u8>>;

    /// A new file, which must not exist.
    fn create(&self, path: &Path) -> io::Result<Box<dyn LogFile>>;

    /// Gives a file another name, in place of the file of that name.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Removes a file.
    fn remove(&self, path: &Path) -> io::Result<()>;

    /// Makes a directory and those above it, if they do not exist.
    fn make_directory(&self, directory: &Path) -> io::Result<()>;

    /// Removes a directory with everything in it.
    fn remove_directory(&self, directory: &Path) -> io::Result<()>;

    /// Returns when the names of a directory are durable.
    fn sync_directory(&self, directory: &Path) -> io::Result<()>;

    /// Bytes of all files in a directory, or of the one file that it is; none if there is nothing of that name.
    fn bytes_in(&self, directory: &Path) -> io::Result<u64>;
}

/// A file that grows at its end.
pub(crate) trait LogFile: Send {
    /// Appends bytes.
    fn append(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Writes over bytes that exist. Nothing is appended to the file afterwards.
    fn write_at(&mut self, place: u64, bytes: &[u8]) -> io::Result<()>;

    /// Returns when all bytes are durable.
    fn sync(&mut self) -> io::Result<()>;
}

/// The files of the system.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SystemDisk;

impl Disk for SystemDisk {
    fn list(&self, directory: &Path) -> io::Result<Vec<String>> {
        let entries = match fs::read_dir(directory) {
            Err(cause) if cause.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries?,
        };
        let mut names = Vec::new();
        for entry in entries {
            // A name that is no text is none of ours.
            names.extend(entry?.file_name().into_string().ok());
        }
        names.sort();
        Ok(names)
    }

    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        File::open(path)?.read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    fn create(&self, path: &Path) -> io::Result<Box<dyn LogFile>> {
        let file = OpenOptions::new().write(true).create_new(true).open(path)?;
        Ok(Box::new(file))
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }

    fn make_directory(&self, directory: &Path) -> io::Result<()> {
        fs::create_dir_all(directory)
    }

    fn remove_directory(&self, directory: &Path) -> io::Result<()> {
        fs::remove_dir_all(directory)
    }

    fn sync_directory(&self, directory: &Path) -> io::Result<()> {
        File::open(directory)?.sync_all()
    }

    fn bytes_in(&self, directory: &Path) -> io::Result<u64> {
        let names = match self.list(directory) {
            Err(cause) if cause.kind() == io::ErrorKind::NotADirectory => {
                return Ok(fs::metadata(directory)?.len());
            }
            names => names?,
        };
        let mut bytes = 0;
        for name in names {
            match fs::metadata(directory.join(name)) {
                // Another thread removes what is not needed any more.
                Err(cause) if cause.kind() == io::ErrorKind::NotFound => {}
                metadata => bytes += metadata?.len(),
            }
        }
        Ok(bytes)
    }
}

impl LogFile for File {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.write_all(bytes)
    }

    fn write_at(&mut self, place: u64, bytes: &[u8]) -> io::Result<()> {
        self.seek(SeekFrom::Start(place))?;
        self.write_all(bytes)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }
}

/// Writes a file so that its name always stands for all of its bytes.
pub(super) fn write_whole(disk: &dyn Disk, path: &Path, bytes: &[u8]) -> io::Result<()> {
    let temporary = path.with_extension("tmp");
    match disk.remove(&temporary) {
        Err(cause) if cause.kind() != io::ErrorKind::NotFound => return Err(cause),
        _ => {}
    }
    let mut file = disk.create(&temporary)?;
    file.append(bytes)?;
    file.sync()?;
    drop(file);
    disk.rename(&temporary, path)?;
    disk.sync_directory(&parent(path))
}

/// The directory of a file.
pub(super) fn parent(path: &Path) -> PathBuf {
    path.parent().unwrap_or(Path::new(".")).to_owned()
}

/// Reason why a data directory or a scene in it cannot be used.
#[derive(Debug)]
pub enum DataError {
    /// The system refused.
    Io {
        /// The file or directory.
        path: PathBuf,
        /// The operation that failed.
        doing: &'static str,
        /// The system's error.
        cause: io::Error,
    },
    /// A limit on the bytes of scenes is reached.
    Full {
        /// The directory of all scenes.
        path: PathBuf,
        /// The limit's name.
        limit: &'static str,
        /// Bytes that there are.
        bytes: u64,
        /// Bytes that there may be.
        most: u64,
    },
    /// Another process uses the directory.
    InUse {
        /// The directory.
        path: PathBuf,
    },
    /// Another server has taken the files of a scene over.
    TakenOver {
        /// Their directory.
        path: PathBuf,
    },
    /// No certificate for development can be made.
    Certificate(CertificateError),
    /// A file of a scene is not what was written.
    Damaged {
        /// The file.
        path: PathBuf,
        /// Its fault.
        damage: Damage,
    },
}

/// Fault of a file of a scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Damage {
    /// Bytes from a place on are lost or changed; records after a tick are lost.
    Bytes {
        /// The place of the first damaged frame.
        at: u64,
        /// The newest tick before it.
        after: Tick,
    },
    /// Bytes that were durable are lost or changed at the end of the newest segment.
    End {
        /// The place of the first lost frame.
        at: u64,
        /// Bytes that were durable.
        of: u64,
        /// The newest tick before it.
        after: Tick,
        /// The newest tick that was durable at least.
        through: Tick,
    },
    /// The file that says how far the log is durable is not readable.
    Head,
    /// The beginning is lost or changed, and with it the whole file.
    Beginning,
    /// The file is missing.
    Missing,
    /// A frame is whole, but is not of this version.
    Unreadable {
        /// The tick before its records.
        after: Tick,
    },
    /// The run from this file differs from the one that was recorded.
    Diverged {
        /// The first tick that differs.
        at: Tick,
    },
    /// A snapshot is not authentic: it is damaged, or of another data directory.
    NotAuthentic,
    /// A log or a snapshot of another version of the engine or of this program.
    Version {
        /// The version in the file.
        found: String,
    },
}

impl DataError {
    pub(super) fn io(path: &Path, doing: &'static str) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |cause| Self::Io { path, doing, cause }
    }

    pub(super) fn damaged(path: &Path, damage: Damage) -> Self {
        Self::Damaged {
            path: path.to_owned(),
            damage,
        }
    }

    /// True if bytes are damaged or lost: the system did not refuse, and another version may not read them better.
    pub(super) const fn is_damage(&self) -> bool {
        match self {
            Self::Damaged { damage, .. } => !matches!(damage, Damage::Version { .. }),
            _ => false,
        }
    }
}

impl fmt::Display for DataError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io { path, doing, cause } => {
                write!(f, "cannot {doing} {}: {cause}", path.display())
            }
            Self::Full {
                path,
                limit,
                bytes,
                most,
            } => write!(
                f,
                "{} has {bytes} bytes of the {most} that limits.{limit} allows: delete scenes, or raise the limit",
                path.display()
            ),
            Self::InUse { path } => {
                write!(f, "another process uses the directory {}", path.display())
            }
            Self::TakenOver { path } => write!(
                f,
                "another server has taken {} over: this one claimed the scene before, and its lease has ended",
                path.display()
            ),
            Self::Certificate(cause) => cause.fmt(f),
            Self::Damaged { path, damage } => write!(f, "{}: {damage}", path.display()),
        }
    }
}

impl std::error::Error for DataError {}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bytes { at, after } => write!(
                f,
                "damaged at byte {at}; what happened after tick {} is lost",
                after.value()
            ),
            Self::End {
                at,
                of,
                after,
                through,
            } => write!(
                f,
                "damaged or cut at byte {at} of {of}; what happened after tick {} is lost, to tick {} at least",
                after.value(),
                through.value()
            ),
            Self::Head => {
                f.write_str("damaged; how far the log beside it was durable is not known")
            }
            Self::Beginning => {
                f.write_str("damaged at its beginning; everything recorded in it is lost")
            }
            Self::Missing => f.write_str("missing; everything recorded in it is lost"),
            Self::Unreadable { after } => write!(
                f,
                "a record after tick {} is not of this version",
                after.value()
            ),
            Self::Diverged { at } => write!(
                f,
                "the run from it differs from the recorded one at tick {}; \
                 another version of the program may have written it",
                at.value()
            ),
            Self::NotAuthentic => f.write_str("damaged, or not written with this directory's key"),
            Self::Version { found } => write!(f, "written by another version, {found}"),
        }
    }
}
