//! Reads a recording of either form.

use std::path::Path;

use super::error::RecordingError;
use super::recorded::Recording;
use super::{mcap, rhtrace};

/// Reads a recording; the file name's extension selects the format.
///
/// # Errors
///
/// [`RecordingError`] names the file and the defect.
pub fn read(path: &Path) -> Result<Recording, RecordingError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let bytes = std::fs::read(path).map_err(|cause| RecordingError::read(path, cause))?;
    let recording = if let Some(name) = name.strip_suffix(".rhtrace.zst") {
        rhtrace::read(name, &bytes)
    } else if name.ends_with(".mcap") {
        mcap::read(&bytes)
    } else {
        return Err(RecordingError::UnknownForm {
            path: path.to_owned(),
        });
    };
    recording.map_err(|cause| RecordingError::File {
        path: path.to_owned(),
        cause: Box::new(cause),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_names_the_file_that_is_no_recording() {
        let folder = std::env::temp_dir().join(format!("rhumb-recording-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("the temporary folder is writable");
        for name in [
            "empty.mcap",
            "empty.rhtrace.zst",
            "empty.txt",
            "nosuch.mcap",
        ] {
            let path = folder.join(name);
            if !name.starts_with("nosuch") {
                std::fs::write(&path, b"").expect("it is our own folder");
            }
            let Err(error) = read(&path) else {
                panic!("{name} is no recording");
            };
            let (message, named) = (error.to_string(), path.display().to_string());
            assert!(message.contains(&named), "{message}");
        }
        std::fs::remove_dir_all(folder).expect("it is our own folder");
    }
}
