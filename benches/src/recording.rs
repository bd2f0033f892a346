//! Recorded motion of a scene: the input of a replay.
//!
//! Two formats are read: the truth in a `trace.mcap` ([`mcap`]) and foreign recordings ([`rhtrace`]). A recording is
//! checked when it is read, so a replay can rely on it.

mod error;
pub mod mcap;
mod play;
pub mod rhtrace;

use std::collections::BTreeMap;
use std::path::Path;

use glam::Vec3;
use rhumb_protocol::scene::BodyKind;
use rhumb_protocol::stream::PredictionParameters;
use rhumb_reckoning::{BodyId, Damping, Inertia, Integrator};

pub use error::RecordingError;

use crate::record::{Placed, Truth};

/// A recorded scene.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Name: a scene, or the file name without its extension.
    pub name: String,
    /// Arguments of its script; none for a foreign recording.
    pub played: Option<ScriptOrigin>,
    /// Every body and every tick.
    pub truth: Truth,
    /// Integrator of the engine.
    pub integrator: Integrator,
    /// Gravity, m/s², world frame.
    pub gravity: Vec3,
    /// Damping of every body.
    pub damping: Damping,
    /// Inertia of bodies with free rotation, as far as known.
    pub inertias: BTreeMap<BodyId, Inertia>,
}

/// Arguments that reproduce a script, besides its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScriptOrigin {
    /// Requested number of bodies.
    pub bodies: u32,
    /// Its seed.
    pub seed: u64,
}

impl Recording {
    /// Reads a recording; the file name's extension selects the format.
    ///
    /// # Errors
    ///
    /// [`RecordingError`] names the file and the defect.
    pub fn read(path: &Path) -> Result<Self, RecordingError> {
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

    /// Prediction parameters of a body.
    pub(crate) fn parameters(&self, placed: &Placed) -> PredictionParameters {
        let inertia = self.inertias.get(&placed.desc.id).copied();
        PredictionParameters::of(&placed.desc, &placed.shape, self.damping, inertia)
    }

    /// Number of bodies requested from the script; for a foreign recording, its number of dynamic bodies.
    #[must_use]
    pub fn bodies(&self) -> u32 {
        if let Some(played) = self.played {
            return played.bodies;
        }
        let placed = self.truth.placed.iter();
        let dynamic = placed.filter(|placed| placed.desc.kind == BodyKind::Dynamic);
        dynamic.count() as u32
    }

    /// Ticks after the first state.
    #[must_use]
    pub fn ticks(&self) -> u32 {
        self.truth.ticks.len() as u32
    }
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
            let Err(error) = Recording::read(&path) else {
                panic!("{name} is no recording");
            };
            let (message, named) = (error.to_string(), path.display().to_string());
            assert!(message.contains(&named), "{message}");
        }
        std::fs::remove_dir_all(folder).expect("it is our own folder");
    }
}
