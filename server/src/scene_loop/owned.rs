//! Scenes that clients of another protocol own: they alone step and end them.
//!
//! Its gateway calls the loop of the scene, between the calls of the driver.

use rhumb_protocol::message::Denial;
use rhumb_protocol::scene::{Command, CommandError, IdRange, SceneConfig};
use rhumb_protocol::{Instant, Peer, Span};

use super::{RunningScene, SceneLoop};
use crate::clients::Clients;
use crate::scene::Scene;
use crate::scene_runner::SceneRunner;

/// A scene under the commands of its owner.
pub struct OwnedScene<'a> {
    runner: &'a mut SceneRunner,
    owner: Peer,
    clients: &'a mut Clients,
}

impl SceneLoop {
    /// Creates the scene for a client that owns it; returns the index range of its bodies.
    ///
    /// # Errors
    ///
    /// [`Denial`] if no such scene can be created.
    pub fn begin_owned(&mut self, owner: Peer, config: SceneConfig) -> Result<IdRange, Denial> {
        self.create(config)?;
        let running = self.running.as_mut().ok_or(Denial::NoSuchScene)?;
        let own_indices = running.runner.give_to(owner, &self.clients);
        match own_indices {
            Ok(_) => self.note_empty(),
            Err(_) => self.end_scene(),
        }
        own_indices
    }

    /// Ends the scene that a client owns.
    pub fn end_owned(&mut self) {
        self.end_scene();
    }

    /// The scene that a client owns.
    pub fn owned(&mut self, owner: Peer) -> Option<OwnedScene<'_>> {
        let RunningScene { runner, .. } = self.running.as_mut()?;
        let clients = &mut self.clients;
        Some(OwnedScene {
            runner,
            owner,
            clients,
        })
    }
}

impl OwnedScene<'_> {
    /// Applies a command; members learn of it with the next tick.
    ///
    /// # Errors
    ///
    /// [`CommandError`] names the reason; nothing has changed.
    pub fn command(&mut self, command: &Command) -> Result<(), CommandError> {
        self.runner
            .command_of_owner(self.owner, command, self.clients)
    }

    /// Steps once and publishes the tick.
    pub fn step(&mut self) {
        self.runner.step_for_owner(self.clients);
    }

    /// True if the engine failed: the scene has stopped.
    #[must_use]
    pub const fn is_faulted(&self) -> bool {
        self.runner.is_faulted()
    }

    /// The present moment, to measure time.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.runner.clock_now()
    }

    /// Adds the time of a report to the owner: it counts as publishing.
    pub fn note_reporting(&mut self, took: Span) {
        self.runner.note_reporting(took);
    }

    /// The scene.
    #[must_use]
    pub const fn scene(&self) -> &Scene {
        self.runner.scene()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::Limits;
    use crate::settings::SceneSettings;

    #[test]
    fn a_scene_whose_owner_gets_no_indices_is_not_kept() {
        let limits = Limits {
            indices_per_scene: 4_096,
            ..Limits::default()
        };
        let settings = SceneSettings {
            limits,
            ..SceneSettings::new(|| Instant::ZERO)
        };
        let name = "app/7".parse().unwrap();
        let mut scene = SceneLoop::new(name, settings.into());
        let begun = scene.begin_owned(Peer(1), SceneConfig::default());
        assert_eq!(begun, Err(Denial::NoIndicesLeft));
        assert!(!scene.exists());
    }
}
