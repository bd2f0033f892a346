//! Streams of members: snapshots, changes, losses, mismatches.

use bytes::Bytes;
use rhumb_protocol::message::{
    Denial, Extensions, Joined, ResyncCause, ServerMessage, StreamChoice, TierChangeCause,
};
use rhumb_protocol::packet::{LossReport, StreamId};
use rhumb_protocol::scene::Stepping;
use rhumb_protocol::stream::{Recipient, StreamStart};
use rhumb_protocol::{Instant, LinkReport, Peer, Span};

use super::RunningScene;
use crate::clients::Clients;
use crate::member::SnapshotRequest;
use crate::observer::Incident;
use crate::streams::{self, Stream, append_snapshot};
use crate::tier_controller::{Confirmation, TierDecision};

impl RunningScene {
    /// A name for a new stream.
    pub(super) fn new_stream(&mut self, clients: &Clients) -> StreamId {
        let streams = &self.streams;
        let is_upstream = |name| {
            clients
                .authorities()
                .any(|(_, group)| group.stream() == name)
        };
        self.names
            .next(|name| streams.get(name).is_some() || is_upstream(name))
    }

    pub(super) fn begin_stream(&mut self, choice: StreamChoice, clients: &Clients) -> StreamId {
        let id = self.new_stream(clients);
        let stream = self.streams.begin(Stream::new(
            choice,
            id,
            self.settings.largest_packet,
            &self.scene,
        ));
        for (id, parameters, track, motion) in streams::everything(&self.scene) {
            stream.insert(id, &parameters, track, motion);
        }
        id
    }

    /// Sends the start of the stream, and every shape and body.
    pub(super) fn send_snapshot(&mut self, peer: Peer, clients: &mut Clients) {
        let Some(member) = clients.member(peer) else {
            return;
        };
        let Some(granted) = member.ids.first().copied() else {
            return;
        };
        self.streams.begin_snapshot(member.stream(), peer);
        let Some(stream) = self.streams.get(member.stream()) else {
            return;
        };
        let start = StreamStart {
            stream: stream.id(),
            tolerance: stream.tolerance(),
            integrator: self.config().integrator,
            publish_interval: self.config().publish_schedule.publish_interval,
            largest_packet: stream.sender.largest_packet(),
            gravity: self.scene.gravity(),
            tick: stream.sender.tick(),
            next: stream.sender.next_number(),
            scene_events: self.scene_events,
        };
        let joined = Joined {
            choice: stream.choice,
            config: *self.config(),
            start,
            granted,
            extensions: Extensions::NONE,
        };
        let mut rest = Vec::new();
        append_snapshot(
            &self.scene,
            stream,
            (clients.authorities()).filter_map(|(_, group)| group.silence()),
            &mut rest,
        );
        clients.send(peer, &ServerMessage::Joined(joined));
        let mut bytes = rest.len();
        for event in self.shape_events.values() {
            bytes += event.len();
            clients.send_encoded(peer, event);
        }
        clients.send_encoded(peer, &Bytes::from(rest));
        clients.note_snapshot(peer, bytes);
    }

    pub(super) fn stream_of(&self, peer: Peer, clients: &Clients) -> Option<&Stream> {
        let member = clients.member(peer)?;
        self.streams.get(member.stream())
    }

    /// Handles a request for a new snapshot; several requests in one read get one answer.
    pub(crate) fn resync(&mut self, peer: Peer, cause: ResyncCause, clients: &mut Clients) {
        let Some(member) = clients.member_mut(peer) else {
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
                self.observer.incident(Incident::ChecksumMismatch);
                if let Some(stream) = self.streams.get_mut(stream) {
                    stream.sender.count_mismatch();
                }
            }
        }
    }

    /// The member has caught up with the stream that it changed to.
    pub(crate) fn subscribed(&mut self, peer: Peer, with: StreamId, clients: &mut Clients) {
        let Some(member) = clients.member_mut(peer) else {
            return;
        };
        member.link.caught_up(with);
        if let Some(former) = member.caught_up(with) {
            self.streams.unsubscribe(former, peer);
        }
    }

    /// Handles a link report: changes the member's tier if its link does not carry its stream, and back when it does
    /// again.
    ///
    /// Only in free-running scenes: a lockstep scene goes as slowly as its links.
    pub(crate) fn handle_link_report(
        &mut self,
        now: Instant,
        peer: Peer,
        report: &LinkReport,
        clients: &mut Clients,
    ) {
        if self.faulted || self.config().stepping == Stepping::Lockstep {
            return;
        }
        let Some(present) = self.stream_of(peer, clients).map(|stream| stream.choice) else {
            return;
        };
        let may_snapshot = clients.may_snapshot(peer);
        let member = (clients.member_mut(peer))
            .filter(|member| member.snapshot_request.is_none() && may_snapshot);
        let Some(decision) = member.and_then(|member| member.link.decide(now, report, present))
        else {
            return;
        };
        let (to, cause) = match decision {
            TierDecision::Coarser(to) => (to, TierChangeCause::LinkCongested),
            TierDecision::Finer(to) => (to, TierChangeCause::LinkRecovered),
        };
        self.send_scene_events(clients);
        let expected = match self.change_stream(peer, to, clients) {
            Ok(expected) => expected,
            Err(denial) => {
                // The next report tries again.
                tracing::debug!(peer = peer.0, ?denial, "a tier change failed");
                return;
            }
        };
        self.note_tier_change(peer, decision, expected, clients);
        let tolerance = to.tolerance();
        tracing::info!(peer = peer.0, %tolerance, ?cause, "a tier changes with its link");
        clients.send(peer, &ServerMessage::TierChanged { to, cause });
        self.send_snapshot(peer, clients);
    }

    /// Notes a tier change. A congested link is relieved of the former stream at once.
    fn note_tier_change(
        &mut self,
        peer: Peer,
        decision: TierDecision,
        expected: Confirmation,
        clients: &mut Clients,
    ) {
        let now = clients.now();
        let Some(member) = clients.member_mut(peer) else {
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

    /// Starts the requested change of stream and its snapshot.
    pub(super) fn begin_snapshot_change(
        &mut self,
        peer: Peer,
        snapshot_request: SnapshotRequest,
        clients: &mut Clients,
    ) -> Result<(), Denial> {
        let SnapshotRequest::Other(choice) = snapshot_request else {
            return Ok(());
        };
        let expected = self.change_stream(peer, choice, clients)?;
        if let Some(member) = clients.member_mut(peer) {
            member.link.choose(choice, expected);
        }
        Ok(())
    }

    /// Subscribes a member to another stream, started if it has no subscriber yet; returns the confirmation of its
    /// snapshot.
    fn change_stream(
        &mut self,
        peer: Peer,
        choice: StreamChoice,
        clients: &mut Clients,
    ) -> Result<Confirmation, Denial> {
        let (Some(rights), Some(member)) = (self.rights_of(peer, clients), clients.member(peer))
        else {
            return Ok(Confirmation::AnyMessage);
        };
        let (present, received) = (member.stream(), member.streams());
        let wanted = self.streams.of_choice(choice);
        rights.subscribe(wanted)?;
        if wanted == Some(present) {
            return Ok(Confirmation::Subscribed(present));
        }
        // The stream that the member is leaving counts already.
        let leaving = received
            .into_iter()
            .find(|received| Some(*received) == wanted);
        let stream = match leaving {
            Some(leaving) => leaving,
            None => match self.streams.subscribe(choice)? {
                Some(stream) => stream,
                None => self.begin_stream(choice, clients),
            },
        };
        let member = clients.member_mut(peer);
        if let Some(former) = member.and_then(|member| member.change(stream)) {
            self.streams.unsubscribe(former, peer);
        }
        Ok(match leaving {
            Some(leaving) => Confirmation::Subscribed(leaving),
            None => Confirmation::LossReport(stream),
        })
    }

    /// Handles a loss report: refreshes lost tracks and sends watermarks for packets the member could not know of.
    ///
    /// Of loss reports in too fast succession only the first is answered. Members with the same loss before the next
    /// tick get the same datagrams, encoded once.
    pub(crate) fn handle_loss_report(
        &mut self,
        now: Instant,
        peer: Peer,
        stream: StreamId,
        loss_report: &LossReport,
        clients: &mut Clients,
    ) {
        let Some(member) = clients.member_mut(peer) else {
            return;
        };
        if stream == member.stream() {
            member
                .link
                .received_loss_report(stream, loss_report.abandoned);
        }
        if !member.receives(stream) {
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
            clients.send_datagram(peer, datagram);
        }
    }
}
