//! The source of files: a folder, or bytes in memory.
//!
//! Paths have forward slashes. Nothing else of the crate touches a disk, so that browsers and tests can use it.

use std::collections::BTreeMap;
use std::error::Error;
use std::fmt;
use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::PathBuf;

/// A source of files.
pub trait Files {
    /// The bytes of a file, at most so many.
    ///
    /// # Errors
    ///
    /// [`FileError`] when there is none, it is larger, or it cannot be read.
    fn read(&self, path: &str, most: usize) -> Result<Vec<u8>, FileError>;
}

/// A file that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FileError {
    /// There is none of this name.
    NotFound,
    /// A folder has this name.
    IsFolder,
    /// It has more bytes than are read.
    TooLarge {
        /// The bytes that are read.
        most: usize,
    },
    /// The system's sentence.
    Unreadable(String),
}

impl fmt::Display for FileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFound => f.write_str("there is no such file"),
            Self::IsFolder => f.write_str("it is a folder: name a file in it"),
            Self::TooLarge { most } => write!(f, "the file has more than {most} bytes"),
            Self::Unreadable(cause) => write!(f, "the file cannot be read: {cause}"),
        }
    }
}

impl Error for FileError {}

/// Files of this machine; relative paths begin at a folder.
#[derive(Clone, Debug, Default)]
pub struct Folder {
    folder: PathBuf,
}

impl Folder {
    /// Files of this machine; relative paths begin here.
    #[must_use]
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        let folder = folder.into();
        Self { folder }
    }
}

impl Files for Folder {
    fn read(&self, path: &str, most: usize) -> Result<Vec<u8>, FileError> {
        let wrong = |error: std::io::Error| match error.kind() {
            ErrorKind::NotFound | ErrorKind::NotADirectory => FileError::NotFound,
            _ => FileError::Unreadable(error.to_string()),
        };
        let path = self.folder.join(path);
        // The path "." is empty here: it is the folder itself.
        if path.as_os_str().is_empty() || path.is_dir() {
            return Err(FileError::IsFolder);
        }
        let file = File::open(path).map_err(wrong)?;
        let mut bytes = Vec::new();
        let beyond = most as u64 + 1;
        file.take(beyond).read_to_end(&mut bytes).map_err(wrong)?;
        if bytes.len() > most {
            return Err(FileError::TooLarge { most });
        }
        Ok(bytes)
    }
}

/// Files in memory.
#[derive(Clone, Debug, Default)]
pub struct MemoryFiles {
    by_path: BTreeMap<String, Vec<u8>>,
}

impl MemoryFiles {
    /// Adds a file, in place of the one of this path.
    pub fn insert(&mut self, path: &str, bytes: impl Into<Vec<u8>>) {
        self.by_path.insert(path.to_owned(), bytes.into());
    }
}

impl Files for MemoryFiles {
    fn read(&self, path: &str, most: usize) -> Result<Vec<u8>, FileError> {
        let bytes = self.by_path.get(path).ok_or(FileError::NotFound)?;
        if bytes.len() > most {
            return Err(FileError::TooLarge { most });
        }
        Ok(bytes.clone())
    }
}

/// The folder of a file: everything before its last slash.
pub(crate) fn folder_of(path: &str) -> &str {
    path.rfind('/').map_or("", |end| &path[..end])
}

/// A path relative to a folder, without `.` and, where it can be, without `..`.
pub(crate) fn join(folder: &str, path: &str) -> String {
    let path = path.replace('\\', "/");
    let is_absolute = path.starts_with('/') || path.get(1..3) == Some(":/");
    let whole = match folder.is_empty() || is_absolute {
        true => path,
        false => format!("{folder}/{path}"),
    };
    let root = if whole.starts_with('/') { "/" } else { "" };
    let mut parts: Vec<&str> = Vec::new();
    for part in whole.split('/') {
        match part {
            "" | "." => {}
            ".." if parts.last().is_some_and(|last| *last != "..") => {
                parts.pop();
            }
            part => parts.push(part),
        }
    }
    format!("{root}{}", parts.join("/"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_folder_itself_is_named_as_one() {
        for path in ["", ".", "src"] {
            let read = Folder::default().read(path, 1);
            assert!(matches!(read, Err(FileError::IsFolder)), "{path}");
        }
    }

    #[test]
    fn paths_are_joined_without_detours() {
        for (folder, path, whole) in [
            ("", "a.stl", "a.stl"),
            ("robots/urdf", "../meshes/./a.stl", "robots/meshes/a.stl"),
            ("/robots", "/a.stl", "/a.stl"),
            ("/robots", "a.stl", "/robots/a.stl"),
            ("", "../a.stl", "../a.stl"),
            ("x", "meshes\\a.stl", "x/meshes/a.stl"),
        ] {
            assert_eq!(join(folder, path), whole);
        }
        assert_eq!(folder_of("a/b/c.xml"), "a/b");
        assert_eq!(folder_of("c.xml"), "");
    }
}
