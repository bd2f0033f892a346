//! The workers of scenes that a data directory has.

use super::Dispatcher;
use crate::durable::{DataDir, DataError};

impl Dispatcher {
    /// Begins to restore the scenes that the data directory has.
    ///
    /// # Errors
    ///
    /// [`DataError`] if the directory cannot be read.
    pub(crate) fn restore(&mut self) -> Result<(), DataError> {
        let scenes = self
            .settings
            .data
            .as_ref()
            .map(DataDir::scenes)
            .transpose()?;
        for (name, _) in scenes.into_iter().flatten() {
            if let Err(code) = self.worker_of(self.scope_of(&name)) {
                tracing::error!(scene = %name, %code, "cannot restore a scene");
            }
        }
        Ok(())
    }
}
