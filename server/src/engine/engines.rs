//! The engine of later scenes.

use std::fmt;
use std::sync::Arc;

use rhumb_protocol::scene::SceneConfig;

use super::interface::Engine;
use super::rapier::RapierEngine;
use super::rapier_workers::Workers;

/// Makes the engine of a new scene; by default [`RapierEngine`].
///
/// Scenes that a data directory restores always have [`RapierEngine`]: the images of another engine are not known.
#[derive(Clone, Default)]
pub struct Engines(Option<Arc<dyn Make>>);

/// The function type of engines.
trait Make: Fn(&SceneConfig, &Workers) -> Box<dyn Engine> + Send + Sync {}

impl<F: Fn(&SceneConfig, &Workers) -> Box<dyn Engine> + Send + Sync> Make for F {}

impl Engines {
    /// Engines from a function. An engine must be empty and have the configuration's gravity.
    pub fn new(
        make: impl Fn(&SceneConfig, &Workers) -> Box<dyn Engine> + Send + Sync + 'static,
    ) -> Self {
        Self(Some(Arc::new(make)))
    }

    /// An empty engine for a scene of a checked configuration.
    #[must_use]
    pub fn make(&self, config: &SceneConfig, workers: &Workers) -> Box<dyn Engine> {
        match &self.0 {
            Some(make) => make(config, workers),
            None => Box::new(RapierEngine::on(config, workers)),
        }
    }
}

impl fmt::Debug for Engines {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Engines")
    }
}
