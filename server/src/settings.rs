//! The settings of scenes, made once and shared by all that run with them.

use core::fmt;
use std::sync::Arc;

use rhumb_protocol::Instant;
use rhumb_protocol::packet::LargestPacket;

use crate::admission::Admission;
use crate::baking::Bakers;
use crate::command_log::SceneStore;
use crate::engine::{Engines, StepThreads};
use crate::heartbeat::Heartbeat;
use crate::hook::Hooks;
use crate::limits::Limits;
use crate::observer::{ObserveScenes, Unobserved};
use crate::provided::ProvidedScenes;

/// A clock that threads share.
pub type SharedClock = Arc<dyn Fn() -> Instant + Send + Sync>;

/// Settings of scenes.
#[derive(Clone)]
pub struct SceneSettings {
    /// Limits of connections and scenes. By default no scene expires.
    pub limits: Limits,
    /// The engine of each scene.
    pub engines: Engines,
    /// Threads that divide a step, and the streams of a scene.
    pub threads: StepThreads,
    /// Bounds the packets of streams.
    pub largest_packet: LargestPacket,
    /// Act on scenes before each step.
    pub hooks: Option<Hooks>,
    /// Scenes that begin when a client names them.
    pub provided: Option<ProvidedScenes>,
    /// Where the solids of large shapes are made; by default each is made at once.
    pub bakers: Bakers,
    /// Shares the bounds on scenes and on their load with others.
    pub admission: Admission,
    /// Observe scenes.
    pub observers: Arc<dyn ObserveScenes>,
    /// Keeps the scenes that clients create.
    pub store: Option<Arc<dyn SceneStore>>,
    /// Shows that a long work makes progress.
    pub heartbeat: Heartbeat,
    /// Measures the stages of a tick, and nothing else; it need not be the clock of the driver.
    pub clock: SharedClock,
}

impl SceneSettings {
    /// The defaults.
    #[must_use]
    pub fn new(clock: impl Fn() -> Instant + Send + Sync + 'static) -> Self {
        Self {
            limits: Limits {
                empty_scene_seconds: 0,
                ..Limits::default()
            },
            engines: Engines::default(),
            threads: StepThreads::default(),
            largest_packet: LargestPacket::DEFAULT,
            hooks: None,
            provided: None,
            bakers: Bakers::default(),
            admission: Admission::default(),
            observers: Arc::new(Unobserved),
            store: None,
            heartbeat: Heartbeat::default(),
            clock: Arc::new(clock),
        }
    }
}

impl fmt::Debug for SceneSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SceneSettings")
            .field("limits", &self.limits)
            .finish_non_exhaustive()
    }
}
