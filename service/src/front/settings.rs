//! The settings of each worker's server loop.
//!
//! They hold for the scenes that begin after they were set.

use std::sync::Arc;

use rhumb_protocol::Instant;
use rhumb_protocol::packet::LargestPacket;
use rhumb_scene::engine::{EngineKind, Engines, StepThreads};
use rhumb_scene::{Hooks, Limits, ProvidedScenes, SceneSlots, ServerLoad, ServerLoop};

use super::threads::SharedClock;
use crate::durable::DataDir;
use crate::recorders::SceneRecorders;

/// The settings of each worker's server loop.
pub(super) struct WorkerSettings {
    pub(super) stopwatch: SharedClock,
    pub(super) hooks: Option<Hooks>,
    pub(super) provided: Option<ProvidedScenes>,
    pub(super) engine: EngineKind,
    pub(super) engine_threads: StepThreads,
    pub(super) largest_packet: LargestPacket,
    pub(super) slots: SceneSlots,
    pub(super) load: ServerLoad,
    pub(super) recorders: SceneRecorders,
    pub(super) limits: Limits,
    pub(super) data: Option<DataDir>,
}

impl WorkerSettings {
    /// The defaults; no scene expires.
    pub(super) fn new(stopwatch: impl Fn() -> Instant + Send + Sync + 'static) -> Self {
        Self {
            stopwatch: Arc::new(stopwatch),
            hooks: None,
            provided: None,
            engine: EngineKind::default(),
            engine_threads: StepThreads::default(),
            largest_packet: LargestPacket::DEFAULT,
            slots: SceneSlots::default(),
            load: ServerLoad::default(),
            recorders: SceneRecorders::default(),
            limits: Limits {
                empty_scene_seconds: 0,
                ..Limits::default()
            },
            data: None,
        }
    }

    /// A server loop with these settings.
    pub(super) fn server_loop(&self) -> ServerLoop {
        let stopwatch = SharedClock::clone(&self.stopwatch);
        let mut server_loop = ServerLoop::new(move || stopwatch());
        if let Some(hooks) = &self.hooks {
            server_loop.attach(hooks.clone());
        }
        if let Some(provided) = &self.provided {
            server_loop.provide(provided.clone());
        }
        server_loop.build_with(Engines::of(self.engine));
        server_loop.employ(self.engine_threads.clone());
        server_loop.set_largest_packet(self.largest_packet);
        server_loop.share(self.slots.clone(), self.load.clone());
        server_loop.observe_with(Arc::new(self.recorders.clone()));
        server_loop.set_limits(self.limits);
        server_loop
    }
}
