//! Scenes of a store: how they are created, and run once they are restored.
//!
//! Without a store, none of this does anything.

use rhumb_protocol::Span;
use rhumb_protocol::message::Denial;
use rhumb_protocol::scene::{SceneConfig, SceneName};

use super::ServerLoop;
use crate::admission;
use crate::command_log::RestoredScene;

impl ServerLoop {
    /// Number of scenes that exist, damaged ones too.
    #[must_use]
    pub fn scene_count(&self) -> usize {
        let damaged = self
            .settings
            .store
            .as_ref()
            .map_or(0, |store| store.damaged());
        self.runners.len() + damaged
    }

    /// Tells members what has become durable.
    pub fn report_durable(&mut self) {
        for runner in self.runners.values_mut() {
            runner.report_durable(&mut self.out);
        }
    }

    fn is_damaged(&self, name: &SceneName) -> bool {
        (self.settings.store.as_ref()).is_some_and(|store| store.is_damaged(name))
    }

    /// Reason why a scene without a runner cannot be joined.
    pub(super) fn absence(&self, name: &SceneName) -> Denial {
        if self.is_damaged(name) {
            Denial::SceneFaulted
        } else {
            Denial::NoSuchScene
        }
    }

    /// Creates a scene for a client, with a log if there is a store.
    pub(super) fn create_stored(
        &mut self,
        name: &SceneName,
        config: SceneConfig,
    ) -> Result<(), Denial> {
        if self.is_damaged(name) {
            return Err(Denial::SceneFaulted);
        }
        self.create(name, config)?;
        self.note_empty(name);
        let log = (self.settings.store.as_ref()).and_then(|store| store.create(name, &config));
        if let (Some(log), Some(runner)) = (log, self.runners.get_mut(name)) {
            runner.keep_log(log, Span::ZERO);
            self.note_empty(name);
        }
        Ok(())
    }

    /// Runs a scene that was restored.
    pub fn add_restored(&mut self, restored: RestoredScene) {
        let RestoredScene {
            name,
            scene,
            sessions,
            ownership,
            unnoted,
            log,
            took,
        } = restored;
        let Some(slot) = self.take_slot() else {
            return tracing::error!(scene = %name, "no place for another scene");
        };
        let mut load = self.load_of(scene.config());
        // The bodies were admitted before: a server with lower limits now takes no more of them.
        for _ in 0..scene.body_count() {
            load.add_body();
        }
        let _ = load.set_locomotion(admission::locomotion_steps(scene.locomotions()));
        let runner = self.run_scene(&name, scene, slot, load);
        runner.restore_shapes();
        if let Some(log) = log {
            runner.keep_log(log, took);
        }
        runner.restore_members(sessions, ownership, &unnoted);
        self.note_empty(&name);
    }
}
