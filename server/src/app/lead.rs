//! A scene under the commands of its leading APP client.

use glam::Vec3;
use rhumb_protocol::Peer;
use rhumb_protocol::scene::{Command, CommandError, IdRange};

use crate::scene::Scene;
use crate::scene_runner::SceneRunner;

/// A scene runner, as its leader commands it.
pub(super) struct Lead<'a> {
    pub(super) runner: &'a mut SceneRunner,
    pub(super) leader: Peer,
    /// Index range of its bodies.
    pub(super) range: IdRange,
}

impl Lead<'_> {
    pub(super) fn command(&mut self, command: &Command) -> Result<(), CommandError> {
        self.runner.command_of_leader(self.leader, command)
    }

    pub(super) fn set_gravity(&mut self, gravity: Vec3) -> Result<(), CommandError> {
        self.command(&Command::SetGravity { gravity })
    }

    pub(super) const fn scene(&self) -> &Scene {
        self.runner.scene()
    }
}
