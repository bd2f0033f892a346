//! Clients of a scene: connection, rights, membership, and what goes out.
//!
//! Knows sessions, not scenes. Datagrams are shared: one packet for many members is one allocation. Invariant: a driver
//! that reports what links take is handed at most [`WINDOW_BYTES`] and one piece beyond that for a connection. What
//! else waits is counted here, and a connection whose peer does not read is closed.
//!
//! With it: which member has authority over which body. At most one member has authority over a body, and a member moves no
//! other bodies.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use bytes::Bytes;
use rhumb_protocol::message::{ClientMessage, Grease, SceneEvent, ServerMessage, SessionRequest};
use rhumb_protocol::session::{CloseCode, ServerSession, TransportCode, UpstreamReceiver};
use rhumb_protocol::{Instant, Peer, Span, Transmit};
use rhumb_reckoning::{BodyId, Tick};

use crate::baking::Bake;
use crate::hook::Traffic;
use crate::member::{AuthorityGroup, Member, SnapshotRequest};
use crate::permit::{ClientName, Permit};
use crate::record::SessionNumber;
use crate::scene::Scene;
use crate::settings::Limits;

/// Control bytes handed to the driver beyond those that the link has taken.
const WINDOW_BYTES: usize = 256 << 10;
/// Longest piece of control bytes.
const PIECE_BYTES: usize = 64 << 10;
/// Waiting answers to a connection beyond which its messages are not read.
const ANSWERS_WAITING_BYTES: usize = 256 << 10;
/// A peer that has taken bytes in this time reads.
const READS: Span = Span::from_millis(1_000);

/// All that a scene keeps of one client while it is connected.
#[derive(Debug)]
pub(crate) struct SceneClient {
    pub(crate) permit: Arc<Permit>,
    /// True once it has said hello.
    pub(crate) is_greeted: bool,
    pub(crate) turn: Turn,
    /// A join that waits until the link has taken the snapshot before it, or a shape whose solid is being made.
    pub(crate) held: Option<ClientMessage>,
    /// The solid of the held shape.
    pub(crate) bake: Option<Bake>,
    /// The session of its next join.
    pub(crate) session_request: Option<SessionRequest>,
    pub(crate) control: ControlStream,
    /// Its membership, if it has joined.
    pub(crate) member: Option<Member>,
}

/// When the unread messages of a client are handled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Turn {
    /// As they arrive.
    AtOnce,
    /// At the next call: others had their turn.
    Queued,
    /// Once its link, a step or slower members allow it.
    Blocked,
    /// Never: the client broke the protocol.
    Over,
}

/// The control stream of a client, and its snapshots.
#[derive(Debug)]
pub(crate) struct ControlStream {
    peer: Peer,
    /// `None` once it is closed.
    session: Option<ServerSession>,
    /// The rest of a piece that was cut.
    rest: Bytes,
    /// Bytes handed to the driver so far.
    handed: u64,
    /// Bytes that the link has taken so far; `None` if the driver does not report them.
    taken: Option<u64>,
    /// Value of `handed` at which the last snapshot has been handed over.
    snapshot_end: u64,
    /// The earliest time of the next snapshot.
    snapshot_after: Instant,
    /// The last time at which the link took bytes, or had none to take.
    taken_at: Instant,
    /// The batch of the log that must be durable before its control bytes go out.
    kept_back: Option<u64>,
    /// The counters of the scene that its client is a member of.
    traffic: Option<Traffic>,
}

/// Bytes and datagrams that go out next.
#[derive(Debug)]
pub(crate) struct PendingOutput {
    /// Clients whose control streams may have data to send.
    sendable: BTreeSet<Peer>,
    datagrams: VecDeque<Transmit>,
    now: Instant,
    limits: Limits,
}

/// All clients of a scene.
#[derive(Debug)]
pub(crate) struct Clients {
    clients: BTreeMap<Peer, SceneClient>,
    out: PendingOutput,
}

impl SceneClient {
    /// Its rights and its membership, if it is a member.
    pub(crate) fn membership(&self) -> Option<(&Permit, &Member)> {
        Some((&self.permit, self.member.as_ref()?))
    }
}

impl ControlStream {
    pub(crate) const fn peer(&self) -> Peer {
        self.peer
    }

    fn new(peer: Peer, grease: Grease, now: Instant) -> Self {
        Self {
            peer,
            session: Some(ServerSession::new(grease)),
            rest: Bytes::new(),
            handed: 0,
            taken: None,
            snapshot_end: 0,
            snapshot_after: Instant::ZERO,
            taken_at: now,
            kept_back: None,
            traffic: None,
        }
    }

    /// Its session, unless it is closed; it may have data to send afterwards.
    fn session(&mut self, out: &mut PendingOutput) -> Option<&mut ServerSession> {
        // The session may now send something, and no longer waits since its last sending.
        self.note_idle(out.now);
        let session = self.session.as_mut()?;
        out.sendable.insert(self.peer);
        Some(session)
    }

    pub(crate) fn send(&mut self, message: &ServerMessage, out: &mut PendingOutput) {
        if let Some(session) = self.session(out) {
            session.send(message);
        }
    }

    /// Sends messages that were encoded once for many members.
    pub(crate) fn send_encoded(&mut self, messages: &Bytes, out: &mut PendingOutput) {
        if let Some(session) = self.session(out) {
            session.send_encoded(messages);
        }
    }

    /// Sends a datagram beside it.
    pub(crate) fn send_datagram(&self, bytes: Bytes, out: &mut PendingOutput) {
        if let Some(traffic) = self.open_traffic() {
            traffic.add_sent(bytes.len());
        }
        let to = self.peer;
        out.datagrams.push_back(Transmit::State { to, bytes });
    }

    /// Notes that the link has nothing to take, if it has not.
    fn note_idle(&mut self, now: Instant) {
        if self.in_driver() == 0 && self.queued() == 0 {
            self.taken_at = now;
        }
    }

    fn open_traffic(&self) -> Option<&Traffic> {
        self.session.as_ref().and(self.traffic.as_ref())
    }

    fn queued(&self) -> usize {
        let session = self.session.as_ref();
        self.rest.len() + session.map_or(0, ServerSession::queued_bytes)
    }

    /// Bytes that the driver has and the link has not taken.
    fn in_driver(&self) -> u64 {
        self.taken.map_or(0, |taken| self.handed - taken)
    }

    fn has_room(&self) -> bool {
        self.in_driver() < WINDOW_BYTES as u64
    }

    /// Waiting bytes beyond those of a snapshot.
    fn waiting(&self) -> usize {
        let end = self.handed + self.queued() as u64;
        let from = self.handed - self.in_driver();
        (end - from.max(self.snapshot_end)) as usize
    }

    /// True if so much waits for the client that no more of its messages are answered.
    pub(crate) fn is_behind(&self) -> bool {
        self.taken.is_some() && self.waiting() > ANSWERS_WAITING_BYTES
    }

    /// Bytes that wait for the client beside its snapshot; none for one that has taken nothing for a second, since no
    /// other is to wait for it.
    fn waiting_bytes(&self, now: Instant) -> usize {
        let reads = self.taken.is_some() && now.since(self.taken_at) < READS;
        if reads { self.waiting() } else { 0 }
    }

    /// The earliest time of a snapshot; `None` while one is under way.
    fn snapshot_at(&self) -> Option<Instant> {
        self.session.as_ref()?;
        match self.taken {
            // A driver that reports nothing, as in a test, has no links to spare.
            None => Some(Instant::ZERO),
            Some(taken) => (taken >= self.snapshot_end).then_some(self.snapshot_after),
        }
    }

    /// True if a snapshot may begin: none is under way, and the last one was long enough ago.
    pub(crate) fn may_snapshot(&self, now: Instant) -> bool {
        self.snapshot_at().is_some_and(|at| at <= now)
    }

    fn next_piece(&mut self) -> Option<Bytes> {
        if self.rest.is_empty() {
            self.rest = self.session.as_mut()?.poll_control()?;
        }
        let length = self.rest.len().min(PIECE_BYTES);
        self.handed += length as u64;
        if let Some(traffic) = &self.traffic {
            traffic.add_sent(length);
        }
        Some(self.rest.split_to(length))
    }

    /// The code for a client that reads too slowly: too much waits for it, or it has taken nothing for long.
    fn overflow(&self, out: &PendingOutput) -> Option<CloseCode> {
        self.taken?;
        let waits = self.in_driver() > 0 || self.queued() > 0;
        let unread_for = out.now.since(self.taken_at);
        let stalled = self.kept_back.is_none() && waits && unread_for >= out.limits.stall();
        (stalled || self.waiting() > out.limits.waiting_bytes())
            .then_some(CloseCode(TransportCode::CONTROL_OVERFLOW.0))
    }

    fn poll(&mut self, out: &PendingOutput) -> Option<Transmit> {
        let to = self.peer;
        let overflow = self.overflow(out);
        let session = self.session.as_mut()?;
        if let Some(code) = overflow {
            session.close(code);
        }
        if self.has_room()
            && self.kept_back.is_none()
            && let Some(bytes) = self.next_piece()
        {
            return Some(Transmit::Control { to, bytes });
        }
        let code = self.session.as_ref()?.poll_close()?.0;
        // The bytes that the closed window holds back are lost with the connection.
        (self.session, self.rest) = (None, Bytes::new());
        if code == TransportCode::CONTROL_OVERFLOW.0 {
            tracing::warn!(peer = to.0, "a client reads too slowly, closing");
        }
        Some(Transmit::Close { to, code })
    }
}

impl Clients {
    pub(crate) const fn new(limits: Limits) -> Self {
        let out = PendingOutput {
            sendable: BTreeSet::new(),
            datagrams: VecDeque::new(),
            now: Instant::ZERO,
            limits,
        };
        Self {
            clients: BTreeMap::new(),
            out,
        }
    }

    /// Adds a client that may do everything.
    pub(crate) fn open(&mut self, peer: Peer, grease: Grease) {
        let client = SceneClient {
            permit: Arc::new(Permit::OPEN),
            is_greeted: false,
            turn: Turn::AtOnce,
            held: None,
            bake: None,
            session_request: None,
            control: ControlStream::new(peer, grease, self.out.now),
            member: None,
        };
        self.clients.insert(peer, client);
    }

    pub(crate) fn forget(&mut self, peer: Peer) {
        self.clients.remove(&peer);
        self.out.sendable.remove(&peer);
    }

    /// True if none is connected.
    pub(crate) fn is_empty(&self) -> bool {
        let mut clients = self.clients.values();
        clients.all(|client| client.control.session.is_none())
    }

    pub(crate) fn get(&self, peer: Peer) -> Option<&SceneClient> {
        self.clients.get(&peer)
    }

    pub(crate) fn get_mut(&mut self, peer: Peer) -> Option<&mut SceneClient> {
        self.clients.get_mut(&peer)
    }

    /// The clients whose turn is this one.
    pub(crate) fn in_turn(&self, turn: Turn) -> impl Iterator<Item = Peer> {
        let clients = self.clients.iter();
        clients.filter_map(move |(peer, client)| (client.turn == turn).then_some(*peer))
    }

    /// The clients whose turn is this one; their next messages are handled as they arrive.
    pub(crate) fn take_in_turn(&mut self, turn: Turn) -> Vec<Peer> {
        let peers: Vec<_> = self.in_turn(turn).collect();
        for peer in &peers {
            self.set_turn(*peer, Turn::AtOnce);
        }
        peers
    }

    /// Sets when the messages of a client are handled.
    pub(crate) fn set_turn(&mut self, peer: Peer, turn: Turn) {
        if let Some(client) = self.clients.get_mut(&peer) {
            client.turn = turn;
        }
    }

    /// The membership of a client.
    pub(crate) fn member(&self, peer: Peer) -> Option<&Member> {
        self.clients.get(&peer)?.member.as_ref()
    }

    /// The membership of a client.
    pub(crate) fn member_mut(&mut self, peer: Peer) -> Option<&mut Member> {
        self.clients.get_mut(&peer)?.member.as_mut()
    }

    /// All members with their clients.
    pub(crate) fn members(&self) -> impl Iterator<Item = (Peer, &SceneClient, &Member)> {
        let clients = self.clients.iter();
        clients.filter_map(|(peer, client)| Some((*peer, client, client.member.as_ref()?)))
    }

    /// All members, and what sends to them.
    pub(crate) fn members_mut(
        &mut self,
    ) -> (
        impl Iterator<Item = (&mut Member, &mut ControlStream)>,
        &mut PendingOutput,
    ) {
        let members = self.clients.values_mut().filter_map(|client| {
            let SceneClient {
                member, control, ..
            } = client;
            Some((member.as_mut()?, control))
        });
        (members, &mut self.out)
    }

    /// The name of a member in its token.
    pub(crate) fn name(&self, peer: Peer) -> Option<&ClientName> {
        let (permit, _) = self.clients.get(&peer)?.membership()?;
        permit.client.as_ref()
    }

    /// Numbers the command of a member that is applied or refused now, and charges it; also returns the session.
    pub(crate) fn begin_command(&mut self, peer: Peer) -> Option<(u64, Option<SessionNumber>)> {
        let client = self.clients.get_mut(&peer)?;
        let member = client.member.as_mut()?;
        member.charge_command(&client.permit.quotas, self.out.now);
        Some((member.number_command(), member.session))
    }

    /// The bodies under the authority of members, with the members.
    pub(crate) fn authorities(&self) -> impl Iterator<Item = (Peer, &AuthorityGroup)> {
        let members = self.members();
        members.filter_map(|(peer, _, member)| Some((peer, member.authority.as_ref()?)))
    }

    /// Ends all memberships; returns them.
    pub(crate) fn take_members(&mut self) -> Vec<(Peer, Member)> {
        let clients = self.clients.iter_mut();
        let taken = clients.filter_map(|(peer, client)| Some((*peer, client.member.take()?)));
        taken.collect()
    }

    /// The requested snapshots that may begin.
    pub(crate) fn take_snapshot_requests(&mut self) -> Vec<(Peer, SnapshotRequest)> {
        let (members, out) = self.members_mut();
        let ready = members.filter(|(_, control)| control.may_snapshot(out.now));
        let requests = ready.map(|(member, control)| (control.peer, &mut member.snapshot_request));
        let requests = requests.filter_map(|(peer, request)| Some((peer, request.take()?)));
        requests.collect()
    }

    /// Number of members.
    pub(crate) fn member_count(&self) -> usize {
        self.members().count()
    }

    /// Sets the present moment.
    pub(crate) fn at(&mut self, now: Instant) {
        self.out.now = now;
    }

    /// The present moment.
    pub(crate) fn now(&self) -> Instant {
        self.out.now
    }

    /// Starts to count the bytes of a client.
    pub(crate) fn count(&mut self, peer: Peer, traffic: Traffic) {
        if let Some(client) = self.clients.get_mut(&peer) {
            client.control.traffic = Some(traffic);
        }
    }

    /// Bytes of a client arrive at this moment.
    pub(crate) fn receive(&mut self, now: Instant, peer: Peer, bytes: usize) {
        self.out.now = now;
        let control = self.control(peer);
        if let Some(traffic) = control.and_then(ControlStream::open_traffic) {
            traffic.add_received(bytes);
        }
    }

    fn control(&self, peer: Peer) -> Option<&ControlStream> {
        self.clients.get(&peer).map(|client| &client.control)
    }

    /// True if the driver reports what the link of a client takes.
    pub(crate) fn is_paced(&self, peer: Peer) -> bool {
        (self.control(peer)).is_some_and(|control| control.taken.is_some())
    }

    /// A client's session, unless its connection is closed; it may have data to send afterwards.
    pub(crate) fn session(&mut self, peer: Peer) -> Option<&mut ServerSession> {
        let client = self.clients.get_mut(&peer)?;
        client.control.session(&mut self.out)
    }

    pub(crate) fn send(&mut self, to: Peer, message: &ServerMessage) {
        if let Some(session) = self.session(to) {
            session.send(message);
        }
    }

    /// Sends messages that were encoded once.
    pub(crate) fn send_encoded(&mut self, to: Peer, messages: &Bytes) {
        if let Some(session) = self.session(to) {
            session.send_encoded(messages);
        }
    }

    pub(crate) fn send_datagram(&mut self, to: Peer, bytes: Bytes) {
        if let Some(client) = self.clients.get(&to) {
            client.control.send_datagram(bytes, &mut self.out);
        }
    }

    /// Keeps all control bytes of a client back until a batch of the log is durable.
    pub(crate) fn keep_back(&mut self, peer: Peer, batch: u64) {
        if let Some(client) = self.clients.get_mut(&peer) {
            client.control.kept_back = Some(batch);
        }
    }

    /// Sends what was kept back for these batches.
    pub(crate) fn release(&mut self, is_due: impl Fn(u64) -> bool) {
        for (peer, client) in &mut self.clients {
            let control = &mut client.control;
            if control.kept_back.is_some_and(&is_due) {
                (control.kept_back, control.taken_at) = (None, self.out.now);
                self.out.sendable.insert(*peer);
            }
        }
    }

    /// The link took so many more bytes of a client.
    pub(crate) fn note_taken(&mut self, peer: Peer, bytes: usize) {
        if let Some(client) = self.clients.get_mut(&peer) {
            let control = &mut client.control;
            let taken = control.taken.unwrap_or(control.handed) + bytes as u64;
            control.taken = Some(taken.min(control.handed));
            control.taken_at = self.out.now;
            self.out.sendable.insert(peer);
        }
    }

    /// A snapshot of so many bytes was queued for a client.
    pub(crate) fn note_snapshot(&mut self, peer: Peer, bytes: usize) {
        let per_second = self.out.limits.snapshot_bytes_per_second();
        if let Some(client) = self.clients.get_mut(&peer) {
            let control = &mut client.control;
            control.snapshot_end = control.handed + control.queued() as u64;
            let pause = bytes as u64 * 1_000_000_000 / per_second;
            control.snapshot_after = self.out.now + Span::from_nanos(pause);
        }
    }

    /// True if a snapshot for a client may begin: none is under way, and the last one was long enough ago.
    pub(crate) fn may_snapshot(&self, peer: Peer) -> bool {
        (self.control(peer)).is_some_and(|control| control.may_snapshot(self.out.now))
    }

    /// The earliest time of a snapshot that a member has requested; `None` if none is, or one is under way.
    pub(crate) fn next_snapshot(&self) -> Option<Instant> {
        let requests = self
            .members()
            .filter(|(.., member)| member.snapshot_request.is_some());
        requests
            .filter_map(|(_, client, _)| client.control.snapshot_at())
            .min()
    }

    /// True if so much waits for a client that no more of its messages are answered.
    pub(crate) fn is_behind(&self, peer: Peer) -> bool {
        self.control(peer).is_some_and(ControlStream::is_behind)
    }

    /// True if more than so many bytes wait for a member that reads.
    pub(crate) fn is_any_behind(&self, bytes: usize) -> bool {
        let mut members = self.members();
        members.any(|(_, client, _)| client.control.waiting_bytes(self.out.now) > bytes)
    }

    /// Bytes of a client's messages that were not handled yet.
    pub(crate) fn unread_bytes(&self, peer: Peer) -> usize {
        let session = (self.control(peer)).and_then(|control| control.session.as_ref());
        session.map_or(0, ServerSession::unread_bytes)
    }

    /// Closes the connection of a client that reads too slowly; returns whether it did.
    pub(crate) fn close_if_stalled(&mut self, peer: Peer) -> bool {
        let Some(client) = self.clients.get_mut(&peer) else {
            return false;
        };
        let control = &mut client.control;
        control.note_idle(self.out.now);
        let Some(code) = control.overflow(&self.out) else {
            return false;
        };
        let session = control.session(&mut self.out);
        session.map(|session| session.close(code)).is_some()
    }

    pub(crate) fn poll(&mut self) -> Option<Transmit> {
        // Messages go first: datagrams may belong to a stream that they announce.
        while let Some(peer) = self.out.sendable.first().copied() {
            let client = self.clients.get_mut(&peer);
            let transmit = client.and_then(|client| client.control.poll(&self.out));
            if let Some(transmit) = transmit {
                return Some(transmit);
            }
            self.out.sendable.remove(&peer);
        }
        self.out.datagrams.pop_front()
    }
}

/// Authority of all members over bodies of one scene.
#[derive(Debug, Default)]
pub(crate) struct AuthorityTable {
    authorities: BTreeMap<BodyId, Peer>,
    /// Bodies of silent members whose authority has ended since the last step.
    released: BTreeSet<BodyId>,
}

impl AuthorityTable {
    /// The member with authority over a body.
    pub(crate) fn authority_of(&self, id: BodyId) -> Option<Peer> {
        self.authorities.get(&id).copied()
    }

    /// Gives a member authority over these bodies, in place of its former ones.
    pub(crate) fn begin(&mut self, peer: Peer, receiver: UpstreamReceiver, clients: &mut Clients) {
        self.end(peer, clients);
        if let Some(member) = clients.member_mut(peer)
            && receiver.bodies().next().is_some()
        {
            let bodies = receiver.bodies();
            self.authorities.extend(bodies.map(|id| (id, peer)));
            member.authority = Some(AuthorityGroup::new(receiver));
        }
    }

    /// Ends a member's authority; its bodies stand still.
    pub(crate) fn end(&mut self, peer: Peer, clients: &mut Clients) {
        let member = clients.member_mut(peer);
        let Some(group) = member.and_then(|member| member.authority.take()) else {
            return;
        };
        self.authorities.retain(|_, authority| *authority != peer);
        if group.is_silent() {
            self.released.extend(group.bodies());
        }
        group.log_end(peer);
    }

    /// Removes a body that has left the scene.
    pub(crate) fn remove(&mut self, id: BodyId, clients: &mut Clients) {
        let Some(peer) = self.authorities.remove(&id) else {
            return;
        };
        let member = clients.member_mut(peer);
        if let Some(group) = member.and_then(|member| member.authority.as_mut()) {
            group.remove(id);
            if group.bodies().next().is_none() {
                self.end(peer, clients);
            }
        }
    }

    /// Sets the targets of all bodies for the next step. Returns the scene events of members that became silent or are
    /// active again.
    pub(crate) fn set_targets(
        &mut self,
        scene: &mut Scene,
        clients: &mut Clients,
    ) -> Vec<SceneEvent> {
        let tick = scene.tick().next();
        let mut scene_events = Vec::new();
        let bodies: Vec<_> = std::mem::take(&mut self.released)
            .into_iter()
            .filter(|id| scene.body(*id).is_some())
            .collect();
        if !bodies.is_empty() {
            scene_events.push(SceneEvent::PublisherActive { tick, bodies });
        }
        for (member, control) in clients.members_mut().0 {
            let group = member.authority.as_mut();
            scene_events.extend(group.and_then(|group| group.set_targets(control.peer(), scene)));
        }
        scene_events
    }
}

/// Sends NACKs for lost packets, and probes to silent members.
pub(crate) fn send_reports(now: Instant, tick: Tick, clients: &mut Clients) {
    let (members, out) = clients.members_mut();
    for (member, control) in members {
        let group = member.authority.as_mut();
        for report in group.map_or(Vec::new(), |group| group.poll_reports(now, tick)) {
            control.send_datagram(report, out);
        }
    }
}
