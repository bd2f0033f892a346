//! Commands of an APP client to the scene that it owns.
//!
//! The owner is no member: it assigns its own body ids, gets no stream, and alone steps and ends the scene. Members
//! may subscribe, push and add bodies; they get the same scene events and packets as in any scene.

use rhumb_protocol::limits::BODIES_MAX;
use rhumb_protocol::message::Denial;
use rhumb_protocol::scene::{Command, CommandError, IdRange};
use rhumb_protocol::{Peer, Span};

use super::{SceneRunner, Stopwatch};
use crate::outbox::Outbox;
use crate::scene::Scene;

impl SceneRunner {
    /// Gives the scene to an APP client, with the index range of its bodies.
    pub(crate) fn give_to(&mut self, owner: Peer) -> Result<IdRange, Denial> {
        let own_indices = self.grant_more(owner, BODIES_MAX)?;
        self.owned = true;
        Ok(own_indices)
    }

    /// True if its engine failed.
    pub(crate) const fn is_faulted(&self) -> bool {
        self.faulted
    }

    /// Applies a command of the owner; members learn of it with the next tick.
    pub(crate) fn command_of_owner(
        &mut self,
        owner: Peer,
        command: &Command,
    ) -> Result<(), CommandError> {
        let applied = self.apply(owner, command);
        let now = self.last_step;
        applied.map_err(|error| self.restore_if_failed(now, error))
    }

    /// Steps once.
    pub(crate) fn step_for_owner(&mut self, clock: Stopwatch<'_>, out: &mut Outbox) {
        if !self.faulted {
            self.target = self.target.next();
            self.tick(clock, out);
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
