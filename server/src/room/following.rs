//! What a member asks of its streams: another one, or what it lost.

use rhumb_protocol::message::{Denial, StreamChoice};
use rhumb_protocol::packet::{Doubt, Echo, StreamId};
use rhumb_protocol::{Instant, Peer};

use super::Room;
use crate::member::Want;
use crate::outbox::Outbox;

impl Room {
    /// A member lost touch with its stream and needs the whole scene again; it is told when the piece is read, and once
    /// however often it asks in it.
    pub(crate) fn resync(&mut self, peer: Peer) {
        if let Some(member) = self.members.get_mut(&peer) {
            member.wants.get_or_insert(Want::Again);
        }
    }

    /// A member wants another stream; of what it wants at once the last counts.
    pub(crate) fn follow(&mut self, peer: Peer, choice: StreamChoice, new_stream: StreamId) {
        if let Some(member) = self.members.get_mut(&peer) {
            member.wants = Some(Want::Other { choice, new_stream });
        }
    }

    /// A member has caught up with the stream that it changed to.
    pub(crate) fn followed(&mut self, peer: Peer, with: StreamId) {
        let member = self.members.get_mut(&peer);
        if let Some(former) = member.and_then(|member| member.caught_up(with)) {
            self.streams.unfollow(former);
        }
    }

    /// Gives a member the snapshot that it wants.
    pub(super) fn grant_want(&mut self, peer: Peer, want: Want) -> Result<(), Denial> {
        let Want::Other { choice, new_stream } = want else {
            return Ok(());
        };
        if self.faulted {
            return Err(Denial::SceneFaulted);
        }
        let Some(member) = self.members.get(&peer) else {
            return Ok(());
        };
        let (present, heard) = (member.stream(), member.streams());
        let wanted = self.streams.of_choice(choice);
        if wanted == Some(present) {
            return Ok(());
        }
        // One that it is leaving counts it already.
        let stream = match heard.into_iter().find(|heard| Some(*heard) == wanted) {
            Some(leaving) => leaving,
            None => match self.streams.follow(choice)? {
                Some(stream) => stream,
                None => self.begin_stream(choice, new_stream),
            },
        };
        let member = self.members.get_mut(&peer);
        if let Some(gone) = member.and_then(|member| member.change(stream)) {
            self.streams.unfollow(gone);
        }
        Ok(())
    }

    /// A member says how far it heard: repairs what it lost and vouches for what it could not know of.
    ///
    /// Of echoes that follow each other too fast only the first is answered. Members that lost the same packet before the
    /// next tick hear the same datagrams, encoded once.
    pub(crate) fn echo(
        &mut self,
        now: Instant,
        peer: Peer,
        stream: StreamId,
        echo: &Echo,
        out: &mut Outbox,
    ) {
        let member = self.members.get_mut(&peer);
        if !member.is_some_and(|member| member.answers_echo(stream, now)) {
            return;
        }
        let Some(stream) = self.streams.get_mut(stream) else {
            return;
        };
        for datagram in stream.answer(peer, echo, self.notices) {
            out.datagram(peer, datagram);
        }
    }

    /// A member believes otherwise than its stream said: it hears more sums, or the one track in question.
    pub(crate) fn doubt(
        &mut self,
        now: Instant,
        peer: Peer,
        stream: StreamId,
        doubt: Doubt,
        out: &mut Outbox,
    ) {
        let member = self.members.get_mut(&peer);
        if !member.is_some_and(|member| member.answers_doubt(stream, now)) {
            return;
        }
        if let Some(stream) = self.streams.get_mut(stream) {
            for datagram in stream.reassure(doubt, self.notices) {
                out.datagram(peer, datagram);
            }
        }
    }
}
