//! Members of a scene: their sessions and their streams.
//!
//! Sessions begin, change their connection, and end. Streams have snapshots, changes, losses, mismatches.

use std::sync::Arc;

use bytes::Bytes;
use rhumb_protocol::message::{
    Denial, Extension, Extensions, Joined, ResyncCause, SceneEvent, ServerMessage, SessionRequest,
    SessionState, StreamChoice, TierChangeCause,
};
use rhumb_protocol::packet::{LossReport, StreamId};
use rhumb_protocol::scene::{IdRange, Stepping};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::stream::{Recipient, StreamStart};
use rhumb_protocol::{Instant, LinkReport, Peer, Span};
use rhumb_reckoning::Tick;

use super::{DisconnectReason, RunningScene};
use crate::clients::Clients;
use crate::feed::FedScene;
use crate::hook::Incident;
use crate::member::{Extent, Member, SnapshotRequest};
use crate::permit::{IndexLimits, Ownership, Permit};
use crate::record::{LogEntry, SessionNumber};
use crate::sessions::{ResumableSession, Sessions};
use crate::streams::{self, Stream, append_snapshot};
use crate::tier_controller::{Confirmation, TierDecision};

/// Cost of finding the cell of a body when a member comes by cells, as bytes of a snapshot.
const HOME_WORK: usize = 16;
/// With this part of its share for a new member, no session of another has to end.
const SUFFICES: u32 = 4;

impl RunningScene {
    /// Makes a client a member; it gets the whole scene, then the stream.
    pub(crate) fn join(
        &mut self,
        now: Instant,
        peer: Peer,
        permit: Arc<Permit>,
        (choice, extent, request): (StreamChoice, Extent, Option<SessionRequest>),
        clients: &mut Clients,
    ) -> Result<(), Denial> {
        let known = self.known_session(&permit, request);
        let replaced = known.and_then(|number| self.sessions.member_of(number));
        let extent = match self.cells {
            Some(_) => extent,
            None => Extent::Whole,
        };
        let streams = self.streams_of(extent);
        let wanted = streams.and_then(|streams| streams.of_choice(choice));
        self.rights(peer, &permit, clients).join(wanted, replaced)?;
        if let Some(replaced) = replaced {
            self.end_replaced(replaced, clients);
        }
        let stream = self.subscribe(choice, extent, clients)?;
        let before = self.sessions.next_number();
        let (session, ids) = match self.begin_session(now, (peer, &permit), request, clients) {
            Ok(begun) => begun,
            Err(denial) => {
                self.unsubscribe_all([stream], peer, extent);
                return Err(denial);
            }
        };
        self.send_scene_events(clients);
        let commands = session.and_then(|number| self.sessions.get(number));
        let commands = commands.map_or(0, |session| session.commands);
        self.observer.joined(peer, permit.client.as_deref());
        let member = Member::new((stream, choice), (session, ids), commands);
        let member = match extent {
            Extent::Cells => member.by_cells(),
            Extent::Whole => member,
        };
        if let Some(client) = clients.get_mut(peer) {
            client.member = Some(member);
        }
        let resumed = session.is_some_and(|number| number < before);
        clients.count(peer, self.observer.traffic());
        self.announce_session(peer, resumed, clients);
        let bodies = match extent {
            Extent::Cells => self.scene.body_count(),
            Extent::Whole => 0,
        };
        self.send_snapshot(peer, bodies * HOME_WORK, clients);
        if let Some(request) = request {
            self.repeat_answers(peer, request.answered, clients);
            self.repeat_fed_refusals(peer, clients);
        }
        if resumed {
            self.acknowledge_resumed(peer, clients);
        } else if session.is_some() {
            self.answer_durably(peer, clients);
        }
        self.tell_standing(peer, clients);
        if self.scene.tick() == Tick::ZERO
            && let Some(fed) = &mut self.fed
        {
            fed.begin(now);
            self.last_step = now;
        } else if self.next_step.is_none() && self.fed.is_none() {
            self.last_step = now;
            self.next_step = Some(now + self.step());
        }
        Ok(())
    }

    /// Ends a membership. The client's bodies stay; its input behind a pending advance is dropped.
    pub(crate) fn leave(&mut self, peer: Peer, reason: DisconnectReason, clients: &mut Clients) {
        self.waiting.retain(|(sender, _)| *sender != peer);
        self.authority_table.end(peer, clients);
        let client = clients.get_mut(peer);
        if let Some(member) = client.and_then(|client| client.member.take()) {
            self.observer.left(peer);
            for (cell, stream) in member.cell_streams() {
                self.unsubscribe_from_cell(cell, stream, peer);
            }
            self.unsubscribe_all(member.streams(), peer, member.extent());
            self.end_session(member, reason, clients);
        }
        if clients.member_count() == 0 {
            self.next_step = None;
        }
    }

    pub(crate) fn reserve(&mut self, peer: Peer, count: u32, clients: &mut Clients) {
        let rights = self.rights_of(peer, clients).ok_or(Denial::NotAllowed);
        let allowed = rights.and_then(|rights| rights.reserve());
        let ids = clients.member(peer).map_or(&[][..], |member| &member.ids);
        let answer = match allowed.and_then(|()| self.reserve_more(ids, count, clients)) {
            Ok(range) => {
                if let Some(member) = clients.member_mut(peer) {
                    member.ids.push(range);
                    if let Some(number) = member.session {
                        self.note_session(LogEntry::Granted(number, range));
                    }
                }
                ServerMessage::Reserved(range)
            }
            Err(denial) => ServerMessage::Denied(denial),
        };
        let is_durable = matches!(answer, ServerMessage::Reserved(_))
            && self.session_of(peer, clients).is_some();
        clients.send(peer, &answer);
        if is_durable {
            self.answer_durably(peer, clients);
        }
    }

    /// Takes over the sessions and owners of a restored scene. `unnoted`: records of sessions that the log lacks.
    pub(crate) fn restore_members(
        &mut self,
        sessions: Sessions,
        ownership: Ownership,
        unnoted: Vec<LogEntry>,
        clients: &mut Clients,
    ) {
        self.ownership = ownership;
        self.sessions = sessions;
        for entry in unnoted {
            self.note_session(entry);
        }
        self.commit(clients);
        let of_sessions = self
            .sessions
            .iter()
            .flat_map(|(_, session)| &session.ranges);
        self.id_ranges
            .restore(self.scene.indices(), of_sessions.copied());
    }

    /// Sends the shapes of a restored scene to later members.
    pub(crate) fn restore_shapes(&mut self) {
        for (id, shape) in self.scene.shapes() {
            let shape = shape.clone();
            let mut event = Vec::new();
            ServerMessage::SceneEvent(SceneEvent::ShapeAdded { id, shape }).encode(&mut event);
            self.shape_events.insert(id, Bytes::from(event));
        }
    }

    /// The session that a client asks for, if the scene knows it.
    fn known_session(
        &self,
        permit: &Permit,
        request: Option<SessionRequest>,
    ) -> Option<SessionNumber> {
        self.sessions.of_key(request?.key, permit.client.as_ref())
    }

    /// Ends the membership of a connection whose session another one takes up, with its stream and its place.
    fn end_replaced(&mut self, replaced: Peer, clients: &mut Clients) {
        tracing::info!(peer = replaced.0, "another connection takes the session up");
        self.leave(replaced, DisconnectReason::Disconnected, clients);
        if let Some(session) = clients.session(replaced) {
            session.close(CloseCode::SESSION_TAKEN);
        }
    }

    /// Grants a new member its indices, or gives it back those of its session.
    fn begin_session(
        &mut self,
        now: Instant,
        (peer, permit): (Peer, &Permit),
        request: Option<SessionRequest>,
        clients: &Clients,
    ) -> Result<(Option<SessionNumber>, Vec<IdRange>), Denial> {
        self.close_expired(now);
        let known = self.known_session(permit, request);
        if let Some(number) = known {
            let ranges = self
                .sessions
                .get(number)
                .map(|session| session.ranges.clone());
            self.sessions.attach(number, peer);
            return Ok((known, ranges.unwrap_or_default()));
        }
        let range = self.reserve_for_new_member(clients)?;
        let Some(request) = request else {
            return Ok((None, vec![range]));
        };
        let number = self.sessions.next_number();
        let client = permit.client.clone();
        self.note_session(LogEntry::opened(number, request.key, client));
        self.note_session(LogEntry::Granted(number, range));
        self.sessions.attach(number, peer);
        Ok((Some(number), vec![range]))
    }

    /// Grants a new member its indices. Clients that are away give way to one that is here: their sessions end, one after
    /// the other, until the indices suffice. A session whose indices all have bodies would free none, and continues.
    fn reserve_for_new_member(&mut self, clients: &Clients) -> Result<IdRange, Denial> {
        let least = (self.index_limits(clients).share / SUFFICES).max(1);
        let mut granted = self.reserve_first(least, clients);
        for number in self.sessions.absent() {
            if granted.is_some() {
                break;
            }
            if !self.has_vacant_index(number) {
                continue;
            }
            tracing::info!(session = number.0, "a session ends: its indices are needed");
            self.close_absent(number);
            granted = self.reserve_first(least, clients);
        }
        let granted = granted.or_else(|| self.reserve_first(1, clients));
        granted.ok_or(Denial::NoIndicesLeft)
    }

    /// True if an index of a session has no body.
    fn has_vacant_index(&self, number: SessionNumber) -> bool {
        let ranges = self.sessions.get(number).map(|session| &session.ranges);
        let mut indices = ranges
            .into_iter()
            .flatten()
            .flat_map(|range| range.first()..range.first() + range.count());
        indices.any(|index| self.scene.vacancy(index).is_some())
    }

    /// Grants a new member its share of the indices, or fewer if no free run is so long, but not fewer than `least`.
    fn reserve_first(&mut self, least: u32, clients: &Clients) -> Option<IdRange> {
        let (scene, limits) = (&self.scene, self.index_limits(clients));
        let vacancy = |index| scene.vacancy(index);
        self.id_ranges.admit(least, limits, &vacancy)
    }

    fn reserve_more(
        &mut self,
        ids: &[IdRange],
        count: u32,
        clients: &Clients,
    ) -> Result<IdRange, Denial> {
        let (scene, limits) = (&self.scene, self.index_limits(clients));
        let vacancy = |index| scene.vacancy(index);
        let granted = self.id_ranges.reserve(ids, count, limits, &vacancy);
        granted.ok_or(Denial::NoIndicesLeft)
    }

    fn index_limits(&self, clients: &Clients) -> IndexLimits {
        let limits = &self.settings.limits;
        let members = clients.member_count() as u64;
        IndexLimits::of(limits.indices_per_scene, limits.members_per_scene, members)
    }

    /// Tells a new member where its session continues.
    fn announce_session(&self, peer: Peer, resumed: bool, clients: &mut Clients) {
        if let Some(session) = self.session_of(peer, clients) {
            let state = SessionState {
                resumed,
                durable: self.is_durable(),
                commands: session.commands,
                tick: self.scene.tick(),
            };
            clients.send(peer, &ServerMessage::Session(state));
        }
    }

    /// Repeats the answers that a member may have missed.
    fn repeat_answers(&self, peer: Peer, answered: u64, clients: &mut Clients) {
        let Some(session) = self.session_of(peer, clients) else {
            return;
        };
        for (number, error) in session.refusals_from(answered) {
            clients.send(peer, &ServerMessage::Refused { number, error });
        }
        if let Some(through) = session.commands.checked_sub(1)
            && session.commands > answered
        {
            let tick = self.scene.tick();
            clients.send(peer, &ServerMessage::Applied { through, tick });
        }
    }

    pub(super) fn session_of(&self, peer: Peer, clients: &Clients) -> Option<&ResumableSession> {
        self.sessions.get(clients.member(peer)?.session?)
    }

    /// Ends the session of a member that has left, or keeps it for another connection.
    fn end_session(
        &mut self,
        Member { session, ids, .. }: Member,
        reason: DisconnectReason,
        clients: &mut Clients,
    ) {
        let now = clients.now();
        match (session, reason) {
            (Some(number), DisconnectReason::Left) => {
                self.note_session(LogEntry::Closed(number));
                self.id_ranges.free(ids);
            }
            // The session keeps the indices.
            (Some(number), DisconnectReason::Disconnected) => self.sessions.detach(number, now),
            (None, _) => self.id_ranges.free(ids),
        }
        self.close_expired(now);
        self.commit(clients);
    }

    fn close_expired(&mut self, now: Instant) {
        for number in self.sessions.expired(now) {
            self.close_absent(number);
        }
    }

    /// Ends a session without a member.
    fn close_absent(&mut self, number: SessionNumber) {
        let session = self.sessions.get(number);
        let ranges = session.map(|session| session.ranges.clone());
        self.id_ranges.free(ranges.unwrap_or_default());
        self.note_session(LogEntry::Closed(number));
    }
}

impl RunningScene {
    /// A name for a new stream.
    pub(super) fn new_stream(&mut self, clients: &Clients) -> StreamId {
        let (streams, cells) = (&self.streams, &self.cells);
        let is_of_cell = |name| cells.as_ref().is_some_and(|cells| cells.has_stream(name));
        let is_upstream = |name| {
            clients
                .authorities()
                .any(|(_, group)| group.stream() == name)
        };
        self.names
            .next(|name| streams.get(name).is_some() || is_of_cell(name) || is_upstream(name))
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

    /// Sends the start of the stream, and every shape and body. `work`: what it costs beside that, as bytes of a snapshot.
    pub(super) fn send_snapshot(&mut self, peer: Peer, work: usize, clients: &mut Clients) {
        let Some(member) = clients.member(peer) else {
            return;
        };
        let Some(granted) = member.ids.first().copied() else {
            return;
        };
        let (id, extent) = (member.stream(), member.extent());
        if let Some(streams) = self.streams_of_mut(extent) {
            streams.begin_snapshot(id, peer);
        }
        let streams = self.streams_of(extent);
        let Some(stream) = streams.and_then(|streams| streams.get(id)) else {
            return;
        };
        let cells = self.cells.as_ref().filter(|_| extent == Extent::Cells);
        let start = StreamStart {
            stream: stream.id(),
            tolerance: stream.tolerance(),
            integrator: self.config().integrator,
            publish_interval: self.config().publish_schedule.publish_interval,
            largest_packet: stream.sender.largest_packet(),
            gravity: self.scene.gravity(),
            tick: stream.sender.tick(),
            next: stream.sender.next_number(),
            scene_events: cells.map_or(self.scene_events, |cells| cells.scene_events(None)),
        };
        let mut extensions = Extensions::NONE;
        if let Some(cells) = cells {
            let fits = extensions.insert(Extension::of_cells(cells.grid()));
            debug_assert!(fits, "one extension fits");
        }
        let joined = Joined {
            choice: stream.choice,
            config: *self.config(),
            start,
            granted,
            extensions,
        };
        let mut rest = Vec::new();
        let silences = self.silences(clients);
        match cells {
            Some(cells) => {
                cells.append_snapshot(None, id, (&self.scene, &silences), &mut rest);
            }
            None => append_snapshot(&self.scene, stream, silences.into_iter(), &mut rest),
        }
        clients.send(peer, &ServerMessage::Joined(joined));
        let mut bytes = rest.len() + work;
        for event in self.shape_events.values() {
            bytes += event.len();
            clients.send_encoded(peer, event);
        }
        clients.send_encoded(peer, &Bytes::from(rest));
        clients.note_snapshot(peer, bytes);
        self.pace.note_snapshot();
    }

    /// The scene events of silent publishers.
    pub(super) fn silences(&self, clients: &Clients) -> Vec<SceneEvent> {
        let of_members = clients.authorities();
        let of_members = of_members.filter_map(|(_, group)| group.silence());
        let of_owner = self.fed.iter().flat_map(FedScene::silences);
        of_members.chain(of_owner).collect()
    }

    pub(super) fn stream_of(&self, peer: Peer, clients: &Clients) -> Option<&Stream> {
        let member = clients.member(peer)?;
        self.streams_of(member.extent())?.get(member.stream())
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
        let (stream, extent) = (member.stream(), member.extent());
        self.note_resync((peer, cause), stream);
        let streams = self.streams_of_mut(extent);
        if let Some(stream) = streams.and_then(|streams| streams.get_mut(stream))
            && cause == ResyncCause::ChecksumMismatch
        {
            stream.sender.count_mismatch();
        }
    }

    /// Logs why a member asks for a new snapshot.
    pub(super) fn note_resync(&mut self, (peer, cause): (Peer, ResyncCause), stream: StreamId) {
        match cause {
            ResyncCause::LostSync => {
                tracing::debug!(peer = peer.0, %stream, "a member lost sync with its stream");
            }
            ResyncCause::ChecksumMismatch => {
                tracing::warn!(peer = peer.0, %stream, "a member's checksum differs from its stream's");
                self.observer.incident(Incident::ChecksumMismatch);
            }
        }
    }

    /// The member has caught up with the stream that it changed to.
    pub(crate) fn subscribed(&mut self, peer: Peer, with: StreamId, clients: &mut Clients) {
        let Some(member) = clients.member_mut(peer) else {
            return;
        };
        member.link.caught_up(with);
        let (former, extent) = (member.caught_up(with), member.extent());
        self.unsubscribe(former, peer, extent);
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
        self.send_snapshot(peer, 0, clients);
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
        let extent = member.extent();
        self.unsubscribe(spared, peer, extent);
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
        let extent = member.extent();
        let streams = self.streams_of(extent);
        let wanted = streams.and_then(|streams| streams.of_choice(choice));
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
            None if extent == Extent::Cells => self.subscribe_to_cell(None, choice, clients)?,
            None => match self.streams.subscribe(choice)? {
                Some(stream) => stream,
                None => self.begin_stream(choice, clients),
            },
        };
        let member = clients.member_mut(peer);
        let former = member.and_then(|member| member.change(stream));
        self.unsubscribe(former, peer, extent);
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
        let Some(cell) = member.receives(stream) else {
            return;
        };
        let (streams, scene_events) = match (&mut self.cells, &member.cells) {
            (Some(cells), Some(_)) => {
                let scene_events = cells.scene_events(cell);
                (cells.streams_mut(cell), scene_events)
            }
            _ => (Some(&mut self.streams), self.scene_events),
        };
        let Some(stream) = streams.and_then(|streams| streams.get_mut(stream)) else {
            return;
        };
        let from = Recipient {
            id: peer.0,
            round_trip: Span::ZERO,
        };
        let mut answers = Vec::new();
        stream
            .sender
            .handle_report(now, from, loss_report, scene_events, &mut answers);
        for datagram in answers {
            clients.send_datagram(peer, datagram);
        }
    }
}
