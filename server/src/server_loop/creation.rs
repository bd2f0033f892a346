//! A scene begins to run in a server loop.

use std::sync::Arc;

use rhumb_protocol::message::Denial;
use rhumb_protocol::scene::{Invalid, Quantity, SceneConfig, SceneName, Stepping};

use super::ServerLoop;
use crate::admission::{self, SceneLoad, SceneSlot};
use crate::rights;
use crate::scene::Scene;
use crate::scene_runner::SceneRunner;
use crate::stream_names::StreamNames;

impl ServerLoop {
    /// Begins a scene that the server provides, unless it is there.
    pub(super) fn begin_if_provided(&mut self, name: &SceneName) {
        if self.runners.contains_key(name) {
            return;
        }
        let Some(provided) = self
            .settings
            .provided
            .as_ref()
            .and_then(|scenes| scenes.of(name))
        else {
            return;
        };
        match self.create(name, provided.config) {
            Ok(runner) => {
                runner.follow_script(provided.script);
                self.note_empty(name);
            }
            Err(denial) => tracing::warn!(scene = %name, %denial, "a provided scene cannot begin"),
        }
    }

    pub(super) fn create(
        &mut self,
        name: &SceneName,
        config: SceneConfig,
    ) -> Result<&mut SceneRunner, Denial> {
        if self.runners.contains_key(name) {
            return Err(Denial::SceneExists);
        }
        let slot = self.take_slot().ok_or(Denial::TooManyScenes)?;
        config.check().map_err(Denial::InvalidConfig)?;
        if config.stepping == Stepping::FreeRunning
            && rights::ticks_in_second(&config) > self.settings.limits.scene_ticks_per_second
        {
            let rate = Invalid::out_of_range(Quantity::Rate);
            return Err(Denial::InvalidConfig(rate));
        }
        let load = self.load_of(&config);
        if !load.has_room() {
            let retry_seconds = admission::RETRY_SECONDS;
            return Err(Denial::Overloaded { retry_seconds });
        }
        let settings = &self.settings;
        let engine = settings.engines.make(&config, &settings.threads);
        let engine = engine.map_err(|cause| {
            tracing::warn!(scene = %name, %cause, "a scene cannot begin");
            Denial::TooManyScenes
        })?;
        let scene = Scene::with_engine(config, engine).map_err(Denial::InvalidConfig)?;
        tracing::info!(scene = %name, "scene created");
        Ok(self.run_scene(name, scene, slot, load))
    }

    /// The place of another scene; `None` if the server has as many as may be.
    pub(super) fn take_slot(&self) -> Option<SceneSlot> {
        let scenes = self.settings.limits.scenes as usize;
        self.settings.admission.slots.take(scenes)
    }

    /// A scene's share of the server's time, none of it taken.
    pub(super) fn load_of(&self, config: &SceneConfig) -> SceneLoad {
        let ticks = match config.stepping {
            Stepping::FreeRunning => rights::ticks_in_second(config),
            Stepping::Lockstep => 0,
        };
        let substeps = u64::from(config.integrator.substeps.get());
        let limits = &self.settings.limits;
        let (scene_max, server_max) = (limits.scene_load, limits.server_load);
        self.settings
            .admission
            .load
            .of_scene((ticks, substeps), scene_max, server_max)
    }

    /// Runs a scene that is new or restored.
    pub(super) fn run_scene(
        &mut self,
        name: &SceneName,
        scene: Scene,
        slot: SceneSlot,
        load: SceneLoad,
    ) -> &mut SceneRunner {
        let names = StreamNames::of_scene(self.scenes_begun);
        let settings = Arc::clone(&self.settings);
        let runner = SceneRunner::new(name, scene, names, settings, load);
        self.scenes_begun = self.scenes_begun.wrapping_add(1);
        self.taken_slots.insert(name.clone(), slot);
        self.runners.entry(name.clone()).or_insert(runner)
    }
}
