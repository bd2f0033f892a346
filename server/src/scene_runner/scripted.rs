//! The script of a scene that the server provides.

use rhumb_protocol::scene::{Command, CommandError};

use super::SceneRunner;
use crate::provided::SceneScript;

impl SceneRunner {
    /// Attaches a script, which commands the scene before each step, and runs it once. Members get ids after
    /// those of its bodies.
    pub(crate) fn follow_script(&mut self, script: SceneScript) {
        self.script = Some(script);
        self.run_script();
        let indices = self.scene.bodies().map(|body| body.id.index() + 1);
        let end = indices.max().unwrap_or(0);
        self.id_ranges.begin_after(end);
    }

    /// Applies the script's commands before the next step.
    pub(super) fn run_script(&mut self) {
        let Some(mut script) = self.script.take() else {
            return;
        };
        if !self.faulted && self.scene.is_sound() {
            for command in script.commands(&self.scene) {
                // A script may add thousands of bodies at once.
                self.settings.heartbeat.beat();
                if let Err(error) = self.apply_of_script(&command) {
                    tracing::warn!(%error, "a command of the scene's script is refused");
                }
            }
        }
        self.script = Some(script);
    }

    fn apply_of_script(&mut self, command: &Command) -> Result<(), CommandError> {
        self.check_not_under_authority(command)?;
        self.apply_and_announce(command)
    }
}
