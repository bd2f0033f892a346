//! What a client of another protocol does with the scene that it leads.
//!
//! It is no member: it names its bodies itself, hears no stream, and alone says when the scene steps and ends. Members
//! may watch, push and add; they hear of everything by the same scene_events and packets as in any scene.

use rhumb_protocol::limits::BODIES_MAX;
use rhumb_protocol::scene::{Command, CommandError, IdRange};
use rhumb_protocol::{Peer, Span};

use super::{SceneRunner, Stopwatch};
use crate::outbox::Outbox;
use crate::scene::Scene;

impl SceneRunner {
    /// Gives the scene to a client of another protocol, with the indices that its bodies may have; none when somebody has
    /// them already.
    pub(crate) fn lead(&mut self, leader: Peer) -> Option<IdRange> {
        self.led = true;
        self.grant(leader, BODIES_MAX).ok()
    }

    /// Whether a client of another protocol leads it.
    pub(crate) const fn is_led(&self) -> bool {
        self.led
    }

    /// Whether its engine failed.
    pub(crate) const fn is_faulted(&self) -> bool {
        self.faulted
    }

    /// Does what its leader wishes, and has members hear of it with the next tick.
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

    /// To tell its leader of a frame took so long: what publishing is to members.
    pub(crate) fn note_reporting(&mut self, took: Span) {
        self.times.add_reporting(took);
    }

    /// What is in it.
    pub(crate) const fn scene(&self) -> &Scene {
        &self.scene
    }
}
