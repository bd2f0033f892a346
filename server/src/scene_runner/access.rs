//! What members may do in a scene.

use rhumb_protocol::Peer;
use rhumb_protocol::scene::{Command, CommandError};

use super::SceneRunner;
use crate::access::Ownership;
use crate::access::rights::{self, Refused, Request};
use crate::durable::Record;

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
        let client = (self.members.get(&peer)).and_then(|member| member.permit.client.clone());
        self.ownership.note(client.as_ref(), command);
        let tick = self.scene.tick();
        if let (Some(client), Some(journal)) = (client, self.scene.journal_mut())
            && Ownership::concerns(command)
        {
            journal.push(tick, &Record::Owned(client));
        }
        Ok(())
    }
}
