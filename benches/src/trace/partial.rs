//! A file that takes its name only when it is whole.
//!
//! Whoever finds the name finds a finished file; dropped before that, the unfinished one is removed.

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
    /// Opens `named` with `.partial` appended, in place of what may lie there.
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

    /// What to write to.
    pub(super) fn sink(&mut self) -> &mut BufWriter<File> {
        &mut self.sink
    }

    /// The name it has for now.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Gives it its name; returns its size in bytes.
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
            // It holds nothing of worth, and whoever dropped it has the reason already.
            let _ = fs::remove_file(&self.path);
        }
    }
}
