//! Recorded motion of a scene: the input of a replay.
//!
//! ```text
//!   trace.mcap, a server's recording ──▶ states of a load ───────────────────┐
//!   .rhtrace.zst ──▶ records by frame ────────────────────────────────────────┼─▶ Recording
//!   MCAP of others, CSV, NumPy ──▶ poses by time ──▶ frames of a constant rate ┘
//! ```
//! A recording is checked when it is read, so a replay can rely on it. A fact that the file lacks is a note.
//!
//! The file's content tells its form.

mod arguments;
mod arrays;
mod bytes;
mod cdr;
mod csv;
mod error;
pub(crate) mod fit;
mod foxglove;
mod linear;
pub mod mcap;
mod npy;
mod options;
mod poses;
mod recorded;
pub mod rhtrace;
mod rhtrace2;
mod ros2;
mod velocity;

use std::path::Path;

use rhumb_reckoning::Rate;

use options::rate_of_hertz;

pub(crate) use arguments::{DEFAULT_TOLERANCE, print_notes};
pub use arguments::{RecordingSource, ToleranceOptions};
pub use cdr::CdrError;
pub use error::{Place, RecordingError, RowDefect};
pub use npy::NpyError;
pub use options::{MissingPoses, QuaternionOrder, ReadOptions, ShapeChoice};
pub(crate) use recorded::first_track;
pub use recorded::{Recording, ScriptOrigin, Velocities};
pub use rhtrace2::write as write_rhtrace;

/// The first bytes of what zstd packs.
const ZSTD: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];
/// The first bytes of an MCAP file.
const MCAP: &[u8] = b"\x89MCAP0\r\n";

/// A rate on the command line, Hz.
pub(crate) fn hertz(text: &str) -> Result<Rate, String> {
    rate_of_hertz(text)
}

/// Reads a recording.
///
/// # Errors
///
/// [`RecordingError`] names the file and the defect.
pub fn read(path: &Path, options: &ReadOptions) -> Result<Recording, RecordingError> {
    let bytes = std::fs::read(path).map_err(|cause| RecordingError::read(path, cause))?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let name = name.split('.').next().unwrap_or_default();
    let recording = read_bytes(name, &bytes, options);
    recording.map_err(|cause| RecordingError::File {
        path: path.to_owned(),
        cause: Box::new(cause),
    })
}

/// Reads the bytes of a file, whose first ones tell its form.
///
/// # Errors
///
/// [`RecordingError`] names the defect and its place.
pub fn read_bytes(
    name: &str,
    bytes: &[u8],
    options: &ReadOptions,
) -> Result<Recording, RecordingError> {
    if bytes.starts_with(MCAP) {
        return mcap::read(name, bytes, options);
    }
    if bytes.starts_with(ZSTD) || rhtrace::is_plain(bytes) {
        return rhtrace::read(name, bytes);
    }
    if bytes.starts_with(npy::ZIP) {
        return arrays::read_archive(name, bytes, options);
    }
    if bytes.starts_with(npy::MAGIC) {
        return arrays::read_array(name, bytes, options);
    }
    match std::str::from_utf8(bytes) {
        Ok(text) if !text.trim().is_empty() => csv::read(name, text, options),
        _ => Err(RecordingError::UnknownForm),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_names_the_file_and_what_would_be_read() {
        let folder = std::env::temp_dir().join(format!("rhumb-recording-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("the temporary folder is writable");
        let contents: [(&str, &[u8]); 4] = [
            ("empty.mcap", b""),
            ("picture.png", b"\x89PNG\r\n\xff"),
            ("letter.txt", b"Dear all, this is no recording.\n"),
            ("half.rhtrace.zst", b"\x28\xb5\x2f\xfd"),
        ];
        for (name, bytes) in contents {
            let path = folder.join(name);
            std::fs::write(&path, bytes).expect("it is our own folder");
            let error = read(&path, &ReadOptions::default()).expect_err("it is no recording");
            let (message, named) = (error.to_string(), path.display().to_string());
            assert!(message.contains(&named), "{message}");
        }
        let error = read(&folder.join("empty.mcap"), &ReadOptions::default());
        let message = error.expect_err("it is empty").to_string();
        assert!(message.contains("foxglove.FrameTransforms"), "{message}");
        let missing = read(&folder.join("nosuch.mcap"), &ReadOptions::default());
        assert!(matches!(missing, Err(RecordingError::Read { .. })));
        std::fs::remove_dir_all(folder).expect("it is our own folder");
    }
}
