//! The files of a data directory, behind a trait.
//!
//! The trait lets a test lose what a crash may lose.
//! Knows no format. A name is durable only after its directory was synchronised, and bytes only after their file was.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

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
