//! The engine of later scenes.

use std::fmt;
use std::sync::Arc;

use rhumb_protocol::scene::SceneConfig;

#[cfg(feature = "box3d")]
use super::box3d::Box3dEngine;
use super::engine_kind::EngineKind;
use super::interface::{Engine, NoEngine};
use super::rapier::RapierEngine;
use super::rapier_threads::StepThreads;

/// Makes the engine of a new scene; by default [`RapierEngine`].
///
/// Scenes that a data directory restores always have [`RapierEngine`]: the images of another engine are not known.
#[derive(Clone, Default)]
pub struct Engines(EngineSource);

#[derive(Clone)]
enum EngineSource {
    Kind(EngineKind),
    Function(Arc<dyn Make>),
}

impl Default for EngineSource {
    fn default() -> Self {
        Self::Kind(EngineKind::default())
    }
}

/// The function type of engines.
trait Make: Fn(&SceneConfig, &StepThreads) -> Result<Box<dyn Engine>, NoEngine> + Send + Sync {}

impl<F> Make for F where
    F: Fn(&SceneConfig, &StepThreads) -> Result<Box<dyn Engine>, NoEngine> + Send + Sync
{
}

impl Engines {
    /// Engines of a kind that this program was built with.
    #[must_use]
    pub const fn of(kind: EngineKind) -> Self {
        Self(EngineSource::Kind(kind))
    }

    /// Engines from a function. An engine must be empty and have the configuration's gravity.
    pub fn new(
        make: impl Fn(&SceneConfig, &StepThreads) -> Result<Box<dyn Engine>, NoEngine>
        + Send
        + Sync
        + 'static,
    ) -> Self {
        Self(EngineSource::Function(Arc::new(make)))
    }

    /// An empty engine for a scene of a checked configuration.
    ///
    /// # Errors
    ///
    /// [`NoEngine`] if the engine has no room for another world.
    pub fn make(
        &self,
        config: &SceneConfig,
        threads: &StepThreads,
    ) -> Result<Box<dyn Engine>, NoEngine> {
        match &self.0 {
            EngineSource::Function(make) => make(config, threads),
            EngineSource::Kind(EngineKind::Rapier) => {
                Ok(Box::new(RapierEngine::on(config, threads)))
            }
            #[cfg(feature = "box3d")]
            EngineSource::Kind(EngineKind::Box3d) => Ok(Box::new(Box3dEngine::new(config)?)),
        }
    }
}

impl fmt::Debug for Engines {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Engines")
    }
}
