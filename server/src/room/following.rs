//! What a member asks of its streams: another one, or what it lost.

use rhumb_protocol::message::{Denial, MoveCause, Moves, ServerMessage, StreamChoice};
use rhumb_protocol::packet::{Doubt, Echo, StreamId};
use rhumb_protocol::scene::Pace;
use rhumb_protocol::{Instant, LinkReport, Peer};

use super::Room;
use crate::member::Want;
use crate::outbox::Outbox;
use crate::thin_link::{Awaited, Verdict};

impl Room {
    /// A member lost touch with its stream and needs the whole scene again; it is told when the piece is read, and once
    /// however often it asks in it.
    pub(crate) fn resync(&mut self, peer: Peer) {
        if let Some(member) = self.members.get_mut(&peer) {
            member.wants.get_or_insert(Want::Again);
        }
    }

    /// A member wants another stream; of what it wants at once the last counts.
    pub(crate) fn follow(&mut self, peer: Peer, choice: StreamChoice) {
        if let Some(member) = self.members.get_mut(&peer) {
            member.wants = Some(Want::Other(choice));
        }
    }

    /// A member has caught up with the stream that it changed to.
    pub(crate) fn followed(&mut self, peer: Peer, with: StreamId) {
        let Some(member) = self.members.get_mut(&peer) else {
            return;
        };
        member.link.caught_up(with);
        if let Some(former) = member.caught_up(with) {
            self.streams.unfollow(former, peer);
        }
    }

    /// A member says where it may be moved.
    pub(crate) fn allow(&mut self, peer: Peer, moves: Moves) {
        if let Some(member) = self.members.get_mut(&peer) {
            member.link.allow(moves);
        }
    }

    /// How a member's link did lately: moves it to another tier if it does not carry its own, and back when it does again.
    ///
    /// Only where nobody waits for ticks: a lockstep scene goes as slowly as its links.
    pub(crate) fn hear_of_link(
        &mut self,
        now: Instant,
        peer: Peer,
        report: &LinkReport,
        out: &mut Outbox,
    ) {
        if self.faulted || self.terms().pace == Pace::Lockstep {
            return;
        }
        let Some(present) = self.stream_of(peer).map(|stream| stream.choice) else {
            return;
        };
        let member = self
            .members
            .get_mut(&peer)
            .filter(|member| member.wants.is_none());
        let Some(verdict) = member.and_then(|member| member.link.judge(now, report, present))
        else {
            return;
        };
        let (to, cause) = match verdict {
            Verdict::Coarser(to) => (to, MoveCause::Thin),
            Verdict::Finer(to) => (to, MoveCause::Eased),
        };
        self.tell_notices(out);
        let awaited = match self.change_stream(peer, to) {
            Ok(awaited) => awaited,
            Err(denial) => {
                // Tried again with the next report.
                tracing::debug!(peer = peer.0, ?denial, "a member is not moved");
                return;
            }
        };
        self.note_move(now, peer, verdict, awaited);
        let tolerance = to.tolerance();
        tracing::info!(peer = peer.0, %tolerance, ?cause, "a member is moved for its link's sake");
        out.say(peer, &ServerMessage::Moved { to, cause });
        self.tell_snapshot(peer, out);
    }

    /// A member is on its way to another stream. A thin link is spared the one that it leaves.
    fn note_move(&mut self, now: Instant, peer: Peer, verdict: Verdict, awaited: Awaited) {
        let Some(member) = self.members.get_mut(&peer) else {
            return;
        };
        let stream = member.stream();
        member.link.moved(now, verdict, awaited);
        let spared = match verdict {
            Verdict::Coarser(_) => member.caught_up(stream),
            Verdict::Finer(_) => None,
        };
        if let Some(spared) = spared {
            self.streams.unfollow(spared, peer);
        }
    }

    /// Gives a member the snapshot that it wants.
    pub(super) fn grant_want(&mut self, peer: Peer, want: Want) -> Result<(), Denial> {
        let Want::Other(choice) = want else {
            return Ok(());
        };
        if self.faulted {
            return Err(Denial::SceneFaulted);
        }
        let awaited = self.change_stream(peer, choice)?;
        if let Some(member) = self.members.get_mut(&peer) {
            member.link.choose(choice, awaited);
        }
        Ok(())
    }

    /// Has a member follow another stream, begun if nobody follows it yet; returns what will show that it has the snapshot
    /// of that.
    fn change_stream(&mut self, peer: Peer, choice: StreamChoice) -> Result<Awaited, Denial> {
        let Some(member) = self.members.get(&peer) else {
            return Ok(Awaited::Word);
        };
        let (present, heard) = (member.stream(), member.streams());
        let wanted = self.streams.of_choice(choice);
        if wanted == Some(present) {
            return Ok(Awaited::Followed(present));
        }
        // One that it is leaving counts it already.
        let leaving = heard.into_iter().find(|heard| Some(*heard) == wanted);
        let stream = match leaving {
            Some(leaving) => leaving,
            None => match self.streams.follow(choice)? {
                Some(stream) => stream,
                None => self.begin_stream(choice),
            },
        };
        let member = self.members.get_mut(&peer);
        if let Some(gone) = member.and_then(|member| member.change(stream)) {
            self.streams.unfollow(gone, peer);
        }
        Ok(match leaving {
            Some(leaving) => Awaited::Followed(leaving),
            None => Awaited::Echo(stream),
        })
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
        let Some(member) = self.members.get_mut(&peer) else {
            return;
        };
        if stream == member.stream() {
            member.link.heard_echo(stream, echo.gone);
        }
        if !member.answers_echo(stream, now) {
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
