//! A scene's motion as it was recorded once: what a replay publishes.
//!
//! Two forms are read: the truth in a `trace.mcap` of ours ([`mcap`]), and foreign recordings ([`rhtrace`]). A recording
//! is checked when it is read, so that a replay can rely on it.

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
    /// What it is called: a scene, or the file without its ending.
    pub name: String,
    /// What its scene's script was asked for; none of a foreign recording.
    pub played: Option<ScriptOrigin>,
    /// Every body and every tick.
    pub truth: Truth,
    /// How the engine stepped.
    pub integrator: Integrator,
    /// What pulled, m/s², world frame.
    pub gravity: Vec3,
    /// Of every body.
    pub damping: Damping,
    /// How those bodies resist being turned that tumble when they are free, as far as it is known.
    pub inertias: BTreeMap<BodyId, Inertia>,
}

/// What makes a script the same again, beside its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScriptOrigin {
    /// How many bodies it was asked for.
    pub bodies: u32,
    /// Its seed.
    pub seed: u64,
}

impl Recording {
    /// Reads a recording; the file's ending tells its form.
    ///
    /// # Errors
    ///
    /// [`RecordingError`] names the file and what is wrong with it.
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

    /// What a predictor needs to know of a body.
    pub(crate) fn parameters(&self, placed: &Placed) -> PredictionParameters {
        let inertia = self.inertias.get(&placed.desc.id).copied();
        PredictionParameters::of(&placed.desc, &placed.shape, self.damping, inertia)
    }

    /// How many bodies its script was asked for; of a foreign recording, how many its engine moved.
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
    fn a_file_that_is_no_recording_is_named() {
        let folder = std::env::temp_dir().join(format!("rhumb-recording-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder for what is passing");
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
                panic!("{name} is nothing to replay");
            };
            let (said, named) = (error.to_string(), path.display().to_string());
            assert!(said.contains(&named), "{said}");
        }
        std::fs::remove_dir_all(folder).expect("it is our own folder");
    }
}
