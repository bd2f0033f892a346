//! The workers of scenes that a data directory has.

use rhumb_protocol::Instant;

use super::Front;
use super::message::WorkerInput;
use crate::durable::{DataDir, DataError};

impl Front {
    /// Keeps scenes in a data directory, and begins to restore those that it has. Call it last of the settings.
    ///
    /// # Errors
    ///
    /// [`DataError`] if the directory cannot be read.
    pub fn store_in(&mut self, now: Instant, data: DataDir) -> Result<(), DataError> {
        let scenes = data.scenes()?;
        self.settings.data = Some(data);
        for (name, _) in scenes {
            match self.worker_of(self.scope_of(&name)) {
                Ok(id) => self.route(now, id, WorkerInput::Restore(name)),
                Err(code) => tracing::error!(scene = %name, %code, "cannot restore a scene"),
            }
        }
        Ok(())
    }
}
