//! A scene begins to run in a server loop.

use rhumb_protocol::Span;
use rhumb_protocol::message::Denial;
use rhumb_protocol::scene::{Invalid, Quantity, SceneConfig, SceneName, Stepping};

use super::ServerLoop;
use crate::load::{self, SceneLoad};
use crate::rights;
use crate::scene::Scene;
use crate::scene_runner::{Provision, SceneRunner};
use crate::scene_slots::SceneSlot;
use crate::stream_names::StreamNames;

impl ServerLoop {
    /// Begins a scene that the server provides, unless it is there.
    pub(super) fn begin_if_provided(&mut self, name: &SceneName) {
        if self.runners.contains_key(name) {
            return;
        }
        let Some(provided) = self.provided.as_ref().and_then(|scenes| scenes.of(name)) else {
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
        let limits = &self.limits;
        let slot = self.slots.take(limits.scenes as usize);
        let slot = slot.ok_or(Denial::TooManyScenes)?;
        config.check().map_err(Denial::InvalidConfig)?;
        if config.stepping == Stepping::FreeRunning
            && rights::ticks_in_second(&config) > limits.scene_ticks_per_second
        {
            let rate = Invalid::out_of_range(Quantity::Rate);
            return Err(Denial::InvalidConfig(rate));
        }
        let load = self.load_of(&config);
        if !load.has_room() {
            let retry_seconds = load::RETRY_SECONDS;
            return Err(Denial::Overloaded { retry_seconds });
        }
        let engine = self.engines.make(&config, &self.threads).map_err(|cause| {
            tracing::warn!(scene = %name, %cause, "a scene cannot begin");
            Denial::TooManyScenes
        })?;
        let scene = Scene::with_engine(config, engine).map_err(Denial::InvalidConfig)?;
        tracing::info!(scene = %name, "scene created");
        Ok(self.run_scene(name, scene, slot, load))
    }

    /// A scene's share of the server's time, none of it taken.
    pub(super) fn load_of(&self, config: &SceneConfig) -> SceneLoad {
        let ticks = match config.stepping {
            Stepping::FreeRunning => rights::ticks_in_second(config),
            Stepping::Lockstep => 0,
        };
        let substeps = u64::from(config.integrator.substeps.get());
        let limits = &self.limits;
        let (scene_max, server_max) = (limits.scene_load, limits.server_load);
        self.load.of_scene((ticks, substeps), scene_max, server_max)
    }

    /// Runs a scene that is new or restored.
    pub(super) fn run_scene(
        &mut self,
        name: &SceneName,
        scene: Scene,
        slot: SceneSlot,
        load: SceneLoad,
    ) -> &mut SceneRunner {
        let config = *scene.config();
        let names = StreamNames::of_scene(self.scenes_begun);
        let period = Span::from_nanos(config.integrator.rate.step_ns());
        let provision = Provision {
            limits: self.limits,
            load,
            heartbeat: self.heartbeat.clone(),
            observer: self.observers.begin(name, period),
        };
        let mut runner = SceneRunner::new(scene, names, provision);
        runner.employ(self.threads.clone());
        runner.set_largest_packet(self.largest_packet);
        if let Some(hook) = self
            .hooks
            .as_ref()
            .and_then(|hooks| hooks.of(name, &config))
        {
            runner.attach(hook);
        }
        self.scenes_begun = self.scenes_begun.wrapping_add(1);
        self.taken_slots.insert(name.clone(), slot);
        self.runners.entry(name.clone()).or_insert(runner)
    }
}
