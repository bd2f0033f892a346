//! The begin of a scene: provided, created by a client, or restored.

use std::sync::Arc;

use rhumb_protocol::message::Denial;
use rhumb_protocol::scene::SceneConfig;
use rhumb_protocol::{Peer, Span};

use super::{RunningScene, SceneLoop};
use crate::admission::{self, SceneLoad, SceneSlot};
use crate::command_log::RestoredScene;
use crate::rights;
use crate::scene::Scene;
use crate::streams::StreamNames;

impl SceneLoop {
    /// Begins the scene if the server provides it, unless it is there.
    pub(super) fn begin_if_provided(&mut self) {
        if self.exists() {
            return;
        }
        let provided = self.settings.provided.as_ref();
        let Some(provided) = provided.and_then(|scenes| scenes.of(&self.name)) else {
            return;
        };
        match self.create(provided.config) {
            Ok(()) => {
                if let Some(running) = &mut self.running {
                    running.follow_script(provided.script, &mut self.clients);
                }
                self.note_empty();
            }
            Err(denial) => {
                tracing::warn!(scene = %self.name, %denial, "a provided scene cannot begin");
            }
        }
    }

    /// Creates the scene for a client: for one that owns it, or with a log if there is a store.
    pub(super) fn create_for(
        &mut self,
        owner: Option<Peer>,
        config: SceneConfig,
    ) -> Result<(), Denial> {
        if self.is_damaged() {
            return Err(Denial::SceneFaulted);
        }
        self.create(config)?;
        if let (Some(owner), Some(running)) = (owner, self.running.as_mut()) {
            running.give_to(owner);
        }
        let store = self.settings.store.as_ref().filter(|_| owner.is_none());
        let log = store.and_then(|store| store.create(&self.name, &config));
        if let (Some(log), Some(running)) = (log, self.running.as_mut()) {
            running.keep_log(log, Span::ZERO);
        }
        self.note_empty();
        Ok(())
    }

    /// Runs the scene that was restored.
    pub fn add_restored(&mut self, restored: RestoredScene) {
        let RestoredScene {
            scene,
            sessions,
            ownership,
            unnoted,
            log,
            took,
        } = restored;
        let Some(slot) = self.settings.take_slot() else {
            return tracing::error!(scene = %self.name, "no place for another scene");
        };
        let mut load = self.settings.load_of(scene.config());
        // The bodies were admitted before: a server with lower limits now takes no more of them.
        for _ in 0..scene.body_count() {
            load.add_body();
        }
        let _ = load.set_locomotion(admission::locomotion_steps(scene.locomotions()));
        self.run_scene(scene, slot, load);
        let Some(running) = &mut self.running else {
            return;
        };
        running.restore_shapes();
        if let Some(log) = log {
            running.keep_log(log, took);
        }
        running.restore_members(sessions, ownership, unnoted, &mut self.clients);
        self.note_empty();
    }

    /// Tells members what has become durable.
    pub fn report_durable(&mut self) {
        if let Some(running) = &mut self.running {
            running.report_durable(&mut self.clients);
        }
    }

    /// True if the store has a scene of this name that cannot be served.
    #[must_use]
    pub fn is_damaged(&self) -> bool {
        let store = self.settings.store.as_ref();
        store.is_some_and(|store| store.is_damaged(&self.name))
    }

    /// Reason why a scene that does not run cannot be joined.
    pub(super) fn absence(&self) -> Denial {
        if self.is_damaged() {
            Denial::SceneFaulted
        } else {
            Denial::NoSuchScene
        }
    }

    pub(super) fn create(&mut self, config: SceneConfig) -> Result<(), Denial> {
        if self.exists() {
            return Err(Denial::SceneExists);
        }
        let (slot, load) = rights::admit_scene(&config, &self.settings)?;
        let settings = &self.settings;
        let engine = settings.engines.make(&config, &settings.threads);
        let engine = engine.map_err(|cause| {
            tracing::warn!(scene = %self.name, %cause, "a scene cannot begin");
            Denial::TooManyScenes
        })?;
        let scene = Scene::with_engine(config, engine).map_err(Denial::InvalidConfig)?;
        tracing::info!(scene = %self.name, "scene created");
        self.run_scene(scene, slot, load);
        Ok(())
    }

    /// Runs a scene that is new or restored.
    fn run_scene(&mut self, scene: Scene, slot: SceneSlot, load: SceneLoad) {
        let names = StreamNames::of_scene(self.begun);
        let settings = Arc::clone(&self.settings);
        let share = (slot, load);
        let running = RunningScene::new(&self.name, scene, names, settings, share);
        self.begun = self.begun.wrapping_add(1);
        self.running = Some(running);
    }
}
