//! Commands of an APP client to the scene that it leads.
//!
//! The leader is no member: it assigns its own body ids, gets no stream, and alone steps and ends the scene. Members
//! may subscribe, push and add bodies; they get the same scene events and packets as in any scene.

use rhumb_protocol::limits::BODIES_MAX;
use rhumb_protocol::scene::{Command, CommandError, IdRange};
use rhumb_protocol::{Peer, Span};

use super::{SceneRunner, Stopwatch};
use crate::outbox::Outbox;
use crate::scene::Scene;

impl SceneRunner {
    /// Gives the scene to an APP client, with the index range of its bodies; `None` when the range is taken.
    pub(crate) fn lead(&mut self, leader: Peer) -> Option<IdRange> {
        self.led = true;
        self.grant(leader, BODIES_MAX).ok()
    }

    /// Whether an APP client leads it.
    pub(crate) const fn is_led(&self) -> bool {
        self.led
    }

    /// Whether its engine failed.
    pub(crate) const fn is_faulted(&self) -> bool {
        self.faulted
    }

    /// Applies a command of the leader; members learn of it with the next tick.
    pub(crate) fn command_of_leader(
        &mut self,
        leader: Peer,
        command: &Command,
    ) -> Result<(), CommandError> {
        self.apply(leader, command)
    }

    /// Steps once.
    pub(crate) fn step_for_leader(&mut self, clock: Stopwatch<'_>, out: &mut Outbox) {
        if !self.faulted {
            self.target = self.target.next();
            self.tick(clock, out);
        }
    }

    /// Adds the time of a report to the leader: it counts as publishing.
    pub(crate) fn note_reporting(&mut self, took: Span) {
        self.times.add_reporting(took);
    }

    /// The scene.
    pub(crate) const fn scene(&self) -> &Scene {
        &self.scene
    }
}
