//! Sessions of members: how they begin, change their connection, and end.

use std::sync::Arc;

use bytes::Bytes;
use rhumb_protocol::message::{
    Denial, SceneEvent, ServerMessage, SessionRequest, SessionState, StreamChoice,
};
use rhumb_protocol::scene::IdRange;
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Instant, Peer};

use super::{DisconnectReason, RunningScene};
use crate::clients::Clients;
use crate::id_ranges::IndexLimits;
use crate::member::Member;
use crate::permit::{Ownership, Permit};
use crate::record::{LogEntry, SessionNumber};

use crate::sessions::{ResumableSession, Sessions};

/// With this part of its share for a new member, no session of another has to end.
const SUFFICES: u32 = 4;

impl RunningScene {
    /// Makes a client a member; it gets the whole scene, then the stream.
    pub(crate) fn join(
        &mut self,
        now: Instant,
        peer: Peer,
        permit: Arc<Permit>,
        (choice, request): (StreamChoice, Option<SessionRequest>),
        clients: &mut Clients,
    ) -> Result<(), Denial> {
        let known = self.known_session(&permit, request);
        let replaced = known.and_then(|number| self.sessions.member_of(number));
        let wanted = self.streams.of_choice(choice);
        self.rights(peer, &permit, clients).join(wanted, replaced)?;
        if let Some(replaced) = replaced {
            self.end_replaced(replaced, clients);
        }
        let stream = match self.streams.subscribe(choice)? {
            Some(stream) => stream,
            None => self.begin_stream(choice, clients),
        };
        let before = self.sessions.next_number();
        let (session, ids) = match self.begin_session(now, (peer, &permit), request, clients) {
            Ok(begun) => begun,
            Err(denial) => {
                self.streams.unsubscribe(stream, peer);
                return Err(denial);
            }
        };
        self.send_scene_events(clients);
        let commands = session.and_then(|number| self.sessions.get(number));
        let commands = commands.map_or(0, |session| session.commands);
        self.observer.joined(peer, permit.client.as_deref());
        let member = Member::new((stream, choice), (session, ids), commands);
        if let Some(client) = clients.get_mut(peer) {
            client.member = Some(member);
        }
        let resumed = session.is_some_and(|number| number < before);
        clients.count(peer, self.observer.traffic());
        self.announce_session(peer, resumed, clients);
        self.send_snapshot(peer, clients);
        if let Some(request) = request {
            self.repeat_answers(peer, request.answered, clients);
        }
        if resumed {
            self.acknowledge_resumed(peer, clients);
        } else if session.is_some() {
            self.answer_durably(peer, clients);
        }
        self.tell_standing(peer, clients);
        if self.next_step.is_none() {
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
            for stream in member.streams() {
                self.streams.unsubscribe(stream, peer);
            }
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

    pub(super) fn reserve_more(
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
    pub(super) fn announce_session(&self, peer: Peer, resumed: bool, clients: &mut Clients) {
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
    pub(super) fn repeat_answers(&self, peer: Peer, answered: u64, clients: &mut Clients) {
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
    pub(super) fn end_session(
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
