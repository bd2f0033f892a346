//! Physics engines behind a trait, by their names.

#[cfg(feature = "box3d")]
mod box3d;
mod fed;
mod interface;
mod kinematic_target;
mod rapier;

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use rhumb_protocol::scene::SceneConfig;
use serde::{Deserialize, Serialize};

#[cfg(feature = "box3d")]
pub use box3d::Box3dEngine;
pub use fed::FedEngine;
pub use interface::{
    BakedShape, Baker, BodyProperties, Engine, EngineFault, EnginePart, FrozenEngine, NoEngine,
    Push, UnanswerableQuery, UnusableShape,
};
pub use rapier::RapierEngine;
#[doc(hidden)]
pub use rapier::threads::{StepThreads, StepThreadsError};

/// An engine by its name. A build without the feature of an engine does not know it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum EngineKind {
    /// Rapier, the engine of every build.
    #[default]
    Rapier,
    /// Box3D, with the feature `box3d`.
    #[cfg(feature = "box3d")]
    Box3d,
}

impl EngineKind {
    /// The engines of this build.
    pub const ALL: &'static [Self] = &[
        Self::Rapier,
        #[cfg(feature = "box3d")]
        Self::Box3d,
    ];

    /// Its name in settings.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rapier => "rapier",
            #[cfg(feature = "box3d")]
            Self::Box3d => "box3d",
        }
    }

    /// True if a data directory can keep its scenes, and a scene continues after a fault: the engine has images and copies.
    #[must_use]
    pub const fn keeps_images(self) -> bool {
        matches!(self, Self::Rapier)
    }
}

impl fmt::Display for EngineKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Error: this build has no engine of the name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnknownEngine(String);

impl fmt::Display for UnknownEngine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let known: Vec<_> = EngineKind::ALL.iter().map(|kind| kind.name()).collect();
        let (name, known) = (&self.0, known.join(", "));
        write!(
            f,
            "no engine \"{name}\": this program was built with {known}"
        )
    }
}

impl std::error::Error for UnknownEngine {}

impl FromStr for EngineKind {
    type Err = UnknownEngine;

    fn from_str(name: &str) -> Result<Self, UnknownEngine> {
        let known = Self::ALL.iter().find(|kind| kind.name() == name);
        known.copied().ok_or_else(|| UnknownEngine(name.to_owned()))
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_engine_has_its_name_and_an_unknown_name_lists_them() {
        for kind in EngineKind::ALL {
            assert_eq!(kind.name().parse(), Ok(*kind));
        }
        let error = "bulldozer".parse::<EngineKind>().unwrap_err().to_string();
        assert!(error.contains("\"bulldozer\"") && error.contains("rapier"));
    }
}
