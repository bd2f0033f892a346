//! Commands of a client of another protocol to the scene that it owns.
//!
//! The owner is no member: it assigns its own body ids, gets no stream, and alone steps and ends the scene. Members
//! may subscribe, push and add bodies; they get the same scene events and packets as in any scene.

use rhumb_protocol::limits::BODIES_MAX;
use rhumb_protocol::message::Denial;
use rhumb_protocol::scene::{Command, CommandError, IdRange};
use rhumb_protocol::{Peer, Span};

use super::SceneRunner;
use crate::clients::Clients;
use crate::permit::Permit;
use crate::scene::Scene;

impl SceneRunner {
    /// Gives the scene to a client of another protocol, with the index range of its bodies.
    pub(crate) fn give_to(&mut self, owner: Peer, clients: &Clients) -> Result<IdRange, Denial> {
        let own_indices = self.reserve_more(&[], BODIES_MAX, clients)?;
        self.owner = Some((owner, vec![own_indices]));
        Ok(own_indices)
    }

    /// True if its engine failed.
    pub(crate) const fn is_faulted(&self) -> bool {
        self.faulted
    }

    /// Applies a command of the owner; members learn of it with the next tick. One message may have many.
    pub(crate) fn command_of_owner(
        &mut self,
        owner: Peer,
        command: &Command,
        clients: &mut Clients,
    ) -> Result<(), CommandError> {
        self.settings.heartbeat.beat();
        let permit = Permit::OPEN;
        let allowed = self.rights(owner, &permit, clients).command(command);
        let applied = allowed.and_then(|()| self.apply_and_announce(command, clients));
        applied.map_err(|error| self.restore_if_failed(error, clients))
    }

    /// Steps once. One message may ask for many steps.
    pub(crate) fn step_for_owner(&mut self, clients: &mut Clients) {
        if !self.faulted {
            self.settings.heartbeat.beat();
            self.target = self.target.next();
            self.tick(clients);
        }
    }

    /// Adds the time of a report to the owner: it counts as publishing.
    pub(crate) fn note_reporting(&mut self, took: Span) {
        self.times.add_reporting(took);
    }

    /// The scene.
    pub(crate) const fn scene(&self) -> &Scene {
        &self.scene
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU64, Ordering};

    use rhumb_protocol::Instant;
    use rhumb_protocol::scene::SceneConfig;

    use super::*;
    use crate::limits::Limits;
    use crate::settings::Heartbeat;
    use crate::settings::SceneSettings;
    use crate::streams::StreamNames;

    #[test]
    fn each_command_and_each_step_of_an_owner_is_a_piece_of_work() {
        let nanos = Arc::new(AtomicU64::new(0));
        let clock = Arc::clone(&nanos);
        let heartbeat = Heartbeat::new(move || Instant::from_nanos(clock.load(Ordering::Relaxed)));
        let settings = SceneSettings {
            heartbeat: heartbeat.clone(),
            ..SceneSettings::new(|| Instant::ZERO)
        };
        let load = settings.admission.load.of_scene((0, 1), u64::MAX, u64::MAX);
        let scene = Scene::new(SceneConfig::default()).unwrap();
        let (name, names) = ("owned".parse().unwrap(), StreamNames::of_scene(0));
        let mut runner = SceneRunner::new(&name, scene, names, settings.into(), load);
        heartbeat.beat();
        let gravity = glam::Vec3::NEG_Y;
        let work: [&dyn Fn(&mut SceneRunner); 2] = [
            &|runner| {
                let mut clients = Clients::new(Limits::default());
                let command = Command::SetGravity { gravity };
                let applied = runner.command_of_owner(Peer(1), &command, &mut clients);
                assert_eq!(applied, Ok(()));
            },
            &|runner| runner.step_for_owner(&mut Clients::new(Limits::default())),
        ];
        for work in work {
            nanos.fetch_add(5_000_000_000, Ordering::Relaxed);
            assert_eq!(heartbeat.busy_for(), Span::from_millis(5_000));
            work(&mut runner);
            assert_eq!(heartbeat.busy_for(), Span::ZERO);
        }
    }
}
