//! The settings of a dispatcher and its scenes.
//!
//! They are made once, before its threads. What an operator writes is parsed elsewhere.

use rhumb_protocol::Instant;
use rhumb_scene::SceneSettings;
use rhumb_scene::engine::EngineKind;

use super::process::ProcessOptions;
use super::recorders::SceneRecorders;
use crate::access::Authenticator;
use crate::durable::DataDir;

/// Settings of a dispatcher, made once.
pub struct DispatcherSettings {
    /// Of its scenes. Store, bakers and heartbeat are each worker's own.
    pub scenes: SceneSettings,
    /// Decides which connections are admitted.
    pub(crate) authenticator: Authenticator,
    /// The engine of scenes in worker processes, which make it by its kind.
    pub(crate) engine: EngineKind,
    /// Metrics, flight recorders and recordings.
    pub(crate) recorders: SceneRecorders,
    /// The directory that keeps scenes.
    pub(crate) data: Option<DataDir>,
    /// `Some` if scenes run in worker processes.
    pub(crate) processes: Option<ProcessOptions>,
}

impl DispatcherSettings {
    /// The defaults. `clock` measures the stages of ticks, and tells the threads the time.
    #[must_use]
    pub fn new(clock: impl Fn() -> Instant + Send + Sync + 'static) -> Self {
        Self::of(SceneSettings::new(clock))
    }

    /// With these settings of scenes.
    #[must_use]
    pub fn of(scenes: SceneSettings) -> Self {
        Self {
            scenes,
            authenticator: Authenticator::Open,
            engine: EngineKind::default(),
            recorders: SceneRecorders::default(),
            data: None,
            processes: None,
        }
    }
}
