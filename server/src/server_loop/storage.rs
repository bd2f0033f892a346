//! Scenes in a data directory: how a worker creates and restores them.
//!
//! Without a data directory, none of this does anything.

use rhumb_protocol::message::Denial;
use rhumb_protocol::scene::{SceneConfig, SceneName};

use super::ServerLoop;
use crate::durable::{DataDir, LogTail, Origin, ReplayStart, Restored, SceneFiles, Wake};
use crate::load;

impl ServerLoop {
    /// Keeps the scenes that clients create from now on in a data directory.
    pub(crate) fn store_in(&mut self, data: DataDir) {
        self.stored.data = Some(data);
    }

    /// Sets the call by which a log has this loop report what has become durable.
    pub(crate) fn wake_by(&mut self, wake: Wake) {
        self.stored.wake = Some(wake);
    }

    /// Number of scenes that exist, damaged ones too.
    pub(crate) fn scene_count(&self) -> usize {
        self.runners.len() + self.stored.damaged.len()
    }

    /// Tells members what has become durable.
    pub(crate) fn report_durable(&mut self) {
        for runner in self.runners.values_mut() {
            runner.report_durable(&mut self.out);
        }
    }

    /// Creates a scene for a client, with files if there is a data directory.
    pub(super) fn create_stored(
        &mut self,
        name: &SceneName,
        config: SceneConfig,
    ) -> Result<(), Denial> {
        if self.stored.damaged.contains_key(name) {
            return Err(Denial::SceneFaulted);
        }
        self.create(name, config)?;
        self.note_empty(name);
        let Some(data) = &self.stored.data else {
            return Ok(());
        };
        let origin = Origin {
            name: name.clone(),
            config,
            tick: rhumb_reckoning::Tick::ZERO,
            segment: 0,
            previous: None,
        };
        let log = self.stored.start(data.create(name), origin);
        if let (Some(log), Some(runner)) = (log, self.runners.get_mut(name)) {
            runner.keep_log(log, rhumb_protocol::Span::ZERO);
        }
        self.note_empty(name);
        Ok(())
    }

    /// Restores a scene from its files, if it has any.
    pub(crate) fn restore(&mut self, name: &SceneName, tail: LogTail) {
        let scenes = self.stored.data.as_ref().map(DataDir::scenes);
        let files = match scenes {
            Some(Ok(scenes)) => scenes.into_iter().find(|(scene, _)| scene == name),
            Some(Err(error)) => return tracing::error!(scene = %name, %error, "cannot restore"),
            None => None,
        };
        let Some((_, files)) = files else {
            return;
        };
        let begun = (self.stopwatch)();
        let pulse = self.pulse.clone();
        match files.restore(&self.workers, (ReplayStart::Newest, tail), &mut || {
            pulse.beat();
        }) {
            Ok(Some(restored)) => {
                let took = (self.stopwatch)().since(begun);
                self.serve_restored(files, restored, took);
            }
            Ok(None) => {
                if let Err(error) = files.delete() {
                    tracing::warn!(scene = %name, %error, "the rest of a scene stays");
                }
            }
            Err(error) => {
                tracing::error!(scene = %name, %error, "the scene cannot be restored and is not served");
                self.stored.damaged.insert(name.clone(), files);
            }
        }
    }

    fn serve_restored(
        &mut self,
        files: SceneFiles,
        restored: Restored,
        took: rhumb_protocol::Span,
    ) {
        let Some(slot) = self.slots.take(self.limits.scenes as usize) else {
            return tracing::error!(scene = %restored.name, "no place for another scene");
        };
        let report = &restored.report;
        for refused in &report.refused {
            tracing::warn!(scene = %restored.name, "a snapshot is not used: {refused}");
        }
        if let Some((path, bytes)) = &report.torn {
            let path = path.display();
            tracing::warn!(%path, bytes, "the end of the log was cut off before it was durable");
        }
        tracing::info!(
            scene = %restored.name,
            tick = restored.scene.tick().value(),
            digest = %restored.scene.digest(),
            snapshot = report.from.value(),
            steps = report.steps,
            ms = took.as_nanos() / 1_000_000,
            "scene restored"
        );
        let name = restored.name.clone();
        let config = *restored.scene.config();
        let origin = restored.origin();
        let log = self.stored.start(files, origin);
        let mut load = self.load_of(&config);
        // The bodies were admitted before: a server with lower limits now takes no more of them.
        for _ in 0..restored.scene.body_count() {
            load.add_body();
        }
        let _ = load.set_locomotion(load::locomotion_steps(restored.scene.locomotions()));
        let runner = self.run_scene(&name, restored.scene, slot, load);
        runner.restore_shapes();
        if let Some(log) = log {
            runner.keep_log(log, took);
        }
        runner.restore_members(restored.sessions, restored.ownership, &restored.unnoted);
        self.note_empty(&name);
    }
}
