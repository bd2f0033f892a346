//! What a member asks of its streams: another one, or what it lost.

use rhumb_protocol::message::{
    Denial, ResyncCause, ServerMessage, StreamChoice, TierChangeCause, TierPolicy,
};
use rhumb_protocol::packet::{LossReport, StreamId};
use rhumb_protocol::scene::Stepping;
use rhumb_protocol::stream::Recipient;
use rhumb_protocol::{Instant, LinkReport, Peer, Span};

use super::SceneRunner;
use crate::member::SnapshotRequest;
use crate::outbox::Outbox;
use crate::tier_controller::{Confirmation, TierDecision};

impl SceneRunner {
    /// A member needs a new snapshot. It is sent once for all requests of one batch of messages.
    pub(crate) fn resync(&mut self, peer: Peer, cause: ResyncCause) {
        let Some(member) = self.members.get_mut(&peer) else {
            return;
        };
        if member.snapshot_request.is_some() {
            return;
        }
        member.snapshot_request = Some(SnapshotRequest::Again);
        let stream = member.stream();
        match cause {
            ResyncCause::LostSync => {
                tracing::debug!(peer = peer.0, %stream, "a member lost sync with its stream");
            }
            ResyncCause::ChecksumMismatch => {
                tracing::warn!(peer = peer.0, %stream, "a member's checksum differs from its stream's");
                if let Some(stream) = self.streams.get_mut(stream) {
                    stream.sender.count_mismatch();
                }
            }
        }
    }

    /// A member snapshot_request another stream; of what it snapshot_request at once the last counts.
    pub(crate) fn subscribe(&mut self, peer: Peer, choice: StreamChoice) {
        if let Some(member) = self.members.get_mut(&peer) {
            member.snapshot_request = Some(SnapshotRequest::Other(choice));
        }
    }

    /// A member has caught up with the stream that it changed to.
    pub(crate) fn subscribed(&mut self, peer: Peer, with: StreamId) {
        let Some(member) = self.members.get_mut(&peer) else {
            return;
        };
        member.link.caught_up(with);
        if let Some(former) = member.caught_up(with) {
            self.streams.unsubscribe(former, peer);
        }
    }

    /// A member says where it may be moved.
    pub(crate) fn set_tier_policy(&mut self, peer: Peer, tier_policy: TierPolicy) {
        if let Some(member) = self.members.get_mut(&peer) {
            member.link.set_policy(tier_policy);
        }
    }

    /// How a member's link did lately: tier_policy it to another tier if it does not carry its own, and back when it does again.
    ///
    /// Only where nobody waits for ticks: a lockstep scene goes as slowly as its links.
    pub(crate) fn handle_link_report(
        &mut self,
        now: Instant,
        peer: Peer,
        report: &LinkReport,
        out: &mut Outbox,
    ) {
        if self.faulted || self.config().stepping == Stepping::Lockstep {
            return;
        }
        let Some(present) = self.stream_of(peer).map(|stream| stream.choice) else {
            return;
        };
        let member = self
            .members
            .get_mut(&peer)
            .filter(|member| member.snapshot_request.is_none());
        let Some(decision) = member.and_then(|member| member.link.decide(now, report, present))
        else {
            return;
        };
        let (to, cause) = match decision {
            TierDecision::Coarser(to) => (to, TierChangeCause::LinkCongested),
            TierDecision::Finer(to) => (to, TierChangeCause::LinkRecovered),
        };
        self.send_scene_events(out);
        let expected = match self.change_stream(peer, to) {
            Ok(expected) => expected,
            Err(denial) => {
                // Tried again with the next report.
                tracing::debug!(peer = peer.0, ?denial, "a member is not moved");
                return;
            }
        };
        self.note_tier_change(now, peer, decision, expected);
        let tolerance = to.tolerance();
        tracing::info!(peer = peer.0, %tolerance, ?cause, "a member is moved for its link's sake");
        out.send(peer, &ServerMessage::TierChanged { to, cause });
        self.send_snapshot(peer, out);
    }

    /// A member is on its way to another stream. A thin link is spared the one that it leaves.
    fn note_tier_change(
        &mut self,
        now: Instant,
        peer: Peer,
        decision: TierDecision,
        expected: Confirmation,
    ) {
        let Some(member) = self.members.get_mut(&peer) else {
            return;
        };
        let stream = member.stream();
        member.link.note_tier_changed(now, decision, expected);
        let spared = match decision {
            TierDecision::Coarser(_) => member.caught_up(stream),
            TierDecision::Finer(_) => None,
        };
        if let Some(spared) = spared {
            self.streams.unsubscribe(spared, peer);
        }
    }

    /// Gives a member the snapshot that it snapshot_request.
    pub(super) fn begin_snapshot_change(
        &mut self,
        peer: Peer,
        snapshot_request: SnapshotRequest,
    ) -> Result<(), Denial> {
        let SnapshotRequest::Other(choice) = snapshot_request else {
            return Ok(());
        };
        if self.faulted {
            return Err(Denial::SceneFaulted);
        }
        let expected = self.change_stream(peer, choice)?;
        if let Some(member) = self.members.get_mut(&peer) {
            member.link.choose(choice, expected);
        }
        Ok(())
    }

    /// Has a member follow another stream, begun if nobody follows it yet; returns what will show that it has the snapshot
    /// of that.
    fn change_stream(&mut self, peer: Peer, choice: StreamChoice) -> Result<Confirmation, Denial> {
        let Some(member) = self.members.get(&peer) else {
            return Ok(Confirmation::AnyMessage);
        };
        let (present, heard) = (member.stream(), member.streams());
        let wanted = self.streams.of_choice(choice);
        if wanted == Some(present) {
            return Ok(Confirmation::Subscribed(present));
        }
        // One that it is leaving counts it already.
        let leaving = heard.into_iter().find(|heard| Some(*heard) == wanted);
        let stream = match leaving {
            Some(leaving) => leaving,
            None => match self.streams.subscribe(choice)? {
                Some(stream) => stream,
                None => self.begin_stream(choice),
            },
        };
        let member = self.members.get_mut(&peer);
        if let Some(gone) = member.and_then(|member| member.change(stream)) {
            self.streams.unsubscribe(gone, peer);
        }
        Ok(match leaving {
            Some(leaving) => Confirmation::Subscribed(leaving),
            None => Confirmation::LossReport(stream),
        })
    }

    /// A member says how far it heard: refreshes what it lost and watermarks for what it could not know of.
    ///
    /// Of loss_reports that follow each other too fast only the first is answered. Members that lost the same packet before the
    /// next tick hear the same datagrams, encoded once.
    pub(crate) fn handle_loss_report(
        &mut self,
        now: Instant,
        peer: Peer,
        stream: StreamId,
        loss_report: &LossReport,
        out: &mut Outbox,
    ) {
        let Some(member) = self.members.get_mut(&peer) else {
            return;
        };
        if stream == member.stream() {
            member.link.received_loss_report(stream, loss_report.gone);
        }
        if !member.hears(stream) {
            return;
        }
        let Some(stream) = self.streams.get_mut(stream) else {
            return;
        };
        let from = Recipient {
            id: peer.0,
            round_trip: Span::ZERO,
        };
        let mut answers = Vec::new();
        stream
            .sender
            .handle_report(now, from, loss_report, self.scene_events, &mut answers);
        for datagram in answers {
            out.datagram(peer, datagram);
        }
    }
}
