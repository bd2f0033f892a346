//! A file that gets its final name only when complete.
//!
//! An unfinished file is removed on drop.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use super::TraceError;

/// The file while it is written.
#[derive(Debug)]
pub(super) struct Partial {
    path: PathBuf,
    named: PathBuf,
    sink: BufWriter<File>,
    finished: bool,
}

impl Partial {
    /// Opens `named` with `.partial` appended; replaces an existing file.
    pub(super) fn create(named: &Path) -> Result<Self, TraceError> {
        let mut path = OsString::from(named);
        path.push(".partial");
        let path = PathBuf::from(path);
        match File::create(&path) {
            Ok(file) => Ok(Self {
                path,
                named: named.to_owned(),
                sink: BufWriter::new(file),
                finished: false,
            }),
            Err(cause) => Err(TraceError::Create { path, cause }),
        }
    }

    /// The writer of the unfinished file.
    pub(super) fn sink(&mut self) -> &mut BufWriter<File> {
        &mut self.sink
    }

    /// The temporary path.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Renames the file to its final name; returns its size in bytes.
    pub(super) fn finish(mut self) -> Result<u64, TraceError> {
        let path = self.path.clone();
        let whole = self.sink.flush().and_then(|()| {
            self.sink.get_ref().sync_all()?;
            Ok(self.sink.get_ref().metadata()?.len())
        });
        let bytes = whole.map_err(|cause| TraceError::Write { path, cause })?;
        if let Err(cause) = fs::rename(&self.path, &self.named) {
            return Err(TraceError::Rename {
                path: self.named.clone(),
                cause,
            });
        }
        self.finished = true;
        Ok(bytes)
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        if !self.finished {
            // The caller already has the error that matters.
            let _ = fs::remove_file(&self.path);
        }
    }
}
