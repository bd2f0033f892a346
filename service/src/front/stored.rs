//! The workers of scenes that a data directory has.

use super::Front;
use crate::durable::{DataDir, DataError};

impl Front {
    /// Keeps scenes in a data directory, and begins to restore those that it has. Call it last of the settings.
    ///
    /// # Errors
    ///
    /// [`DataError`] if the directory cannot be read.
    pub fn store_in(&mut self, data: DataDir) -> Result<(), DataError> {
        let scenes = data.scenes()?;
        self.settings.data = Some(data);
        for (name, _) in scenes {
            if let Err(code) = self.worker_of(self.scope_of(&name)) {
                tracing::error!(scene = %name, %code, "cannot restore a scene");
            }
        }
        Ok(())
    }
}
