//! What members may do in a scene.

use rhumb_protocol::Peer;
use rhumb_protocol::scene::{Command, CommandError};

use super::SceneRunner;
use crate::access::rights::{self, Refused, Request};

impl SceneRunner {
    /// Decides whether a member may make a request.
    pub(super) fn check(&self, peer: Peer, request: Request<'_>) -> Result<(), Refused> {
        let member = self.members.get(&peer).ok_or(Refused::NotAllowed)?;
        rights::check(&member.permit, &self.ownership, request)
    }

    /// Carries out a command of a member, and notes what now belongs to its client.
    pub(super) fn apply_of_member(
        &mut self,
        peer: Peer,
        command: &Command,
    ) -> Result<(), CommandError> {
        self.check(peer, Request::Command(command, self.config()))?;
        self.apply(peer, command)?;
        if let Some(member) = self.members.get(&peer) {
            self.ownership.note(&member.permit, command);
        }
        Ok(())
    }
}
