//! Clients of a scene: connection, rights, membership, and what goes out.
//!
//! Knows sessions, not scenes.
//!
//! With it: which member has authority over which body. At most one member has authority over a body, and a member moves no
//! other bodies.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use bytes::Bytes;
use rhumb_protocol::message::{
    AuthorityError, ClientMessage, Grease, SceneEvent, ServerMessage, SessionRequest,
};
use rhumb_protocol::scene::Cell;
use rhumb_protocol::session::{CloseCode, ServerSession, UpstreamReceiver};
use rhumb_protocol::{Instant, Peer, Transmit};
use rhumb_reckoning::{BodyId, Tick};

use crate::baking::Bake;
use crate::control_stream::{ControlStream, PendingOutput};
use crate::hook::Traffic;
use crate::member::{AuthorityGroup, Extent, Member, SnapshotRequest};
use crate::permit::{ClientName, Permit};
use crate::record::SessionNumber;
use crate::scene::Scene;
use crate::settings::Limits;

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
    /// How its next join takes the scene.
    pub(crate) extent: Extent,
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

impl Clients {
    pub(crate) const fn new(limits: Limits) -> Self {
        Self {
            clients: BTreeMap::new(),
            out: PendingOutput::new(limits),
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
            extent: Extent::Whole,
            control: ControlStream::new(peer, grease, self.out.now()),
            member: None,
        };
        self.clients.insert(peer, client);
    }

    pub(crate) fn forget(&mut self, peer: Peer) {
        self.clients.remove(&peer);
        self.out.forget(peer);
    }

    /// True if none is connected.
    pub(crate) fn is_empty(&self) -> bool {
        let mut clients = self.clients.values();
        clients.all(|client| client.control.is_closed())
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
        member.charge_command(&client.permit.quotas, self.out.now());
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
        let ready = members.filter(|(_, control)| control.may_snapshot(out.now()));
        let requests =
            ready.map(|(member, control)| (control.peer(), &mut member.snapshot_request));
        let requests = requests.filter_map(|(peer, request)| Some((peer, request.take()?)));
        requests.collect()
    }

    /// The members whose requests about cells may be answered.
    pub(crate) fn asking_for_cells(&mut self) -> Vec<Peer> {
        let (members, out) = self.members_mut();
        let asking = members.filter(|(member, control)| {
            !member.cell_requests.is_empty() && control.may_snapshot(out.now())
        });
        asking.map(|(_, control)| control.peer()).collect()
    }

    /// The next request of a member about a cell.
    pub(crate) fn next_cell_request(&mut self, peer: Peer) -> Option<(Cell, SnapshotRequest)> {
        self.member_mut(peer)?.cell_requests.pop_first()
    }

    /// Tells all clients that another server has their scene, and closes them.
    pub(crate) fn send_elsewhere(&mut self, to: &str) {
        let moved = ServerMessage::Moved {
            address: to.as_bytes().to_vec(),
        };
        for client in self.clients.values_mut() {
            client.turn = Turn::Over;
            if client.is_greeted {
                client.control.send(&moved, &mut self.out);
            }
            if let Some(session) = client.control.session(&mut self.out) {
                session.close(CloseCode::SCENE_ELSEWHERE);
            }
        }
    }

    /// Number of members.
    pub(crate) fn member_count(&self) -> usize {
        self.members().count()
    }

    /// Sets the present moment.
    pub(crate) fn at(&mut self, now: Instant) {
        self.out.at(now);
    }

    /// The present moment.
    pub(crate) fn now(&self) -> Instant {
        self.out.now()
    }

    /// Starts to count the bytes of a client.
    pub(crate) fn count(&mut self, peer: Peer, traffic: Traffic) {
        if let Some(client) = self.clients.get_mut(&peer) {
            client.control.count(traffic);
        }
    }

    /// Bytes of a client arrive at this moment.
    pub(crate) fn receive(&mut self, now: Instant, peer: Peer, bytes: usize) {
        self.out.at(now);
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
        self.control(peer).is_some_and(ControlStream::is_paced)
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
            client.control.keep_back(batch);
        }
    }

    /// Sends what was kept back for these batches.
    pub(crate) fn release(&mut self, is_due: impl Fn(u64) -> bool) {
        for client in self.clients.values_mut() {
            client.control.release(&is_due, &mut self.out);
        }
    }

    /// The link took so many more bytes of a client.
    pub(crate) fn note_taken(&mut self, peer: Peer, bytes: usize) {
        if let Some(client) = self.clients.get_mut(&peer) {
            client.control.note_taken(bytes, &mut self.out);
        }
    }

    /// A snapshot of so many bytes was queued for a client.
    pub(crate) fn note_snapshot(&mut self, peer: Peer, bytes: usize) {
        if let Some(client) = self.clients.get_mut(&peer) {
            client.control.note_snapshot(bytes, &self.out);
        }
    }

    /// True if the link of a client has yet to take the rest of its snapshot.
    pub(crate) fn has_snapshot_under_way(&self, peer: Peer) -> bool {
        (self.control(peer)).is_some_and(|control| control.snapshot_at().is_none())
    }

    /// True if a snapshot for a client may begin: none is under way, and the last one was long enough ago.
    pub(crate) fn may_snapshot(&self, peer: Peer) -> bool {
        (self.control(peer)).is_some_and(|control| control.may_snapshot(self.out.now()))
    }

    /// The earliest time of a snapshot that a member has requested; `None` if none is, or one is under way.
    pub(crate) fn next_snapshot(&self) -> Option<Instant> {
        let requests = self
            .members()
            .filter(|(.., member)| member.awaits_snapshot());
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
        members.any(|(_, client, _)| client.control.waiting_bytes(self.out.now()) > bytes)
    }

    /// Bytes of a client's messages that were not handled yet.
    pub(crate) fn unread_bytes(&self, peer: Peer) -> usize {
        self.control(peer).map_or(0, ControlStream::unread_bytes)
    }

    /// Closes the connection of a client that reads too slowly; returns whether it did.
    pub(crate) fn close_if_stalled(&mut self, peer: Peer) -> bool {
        let client = self.clients.get_mut(&peer);
        client.is_some_and(|client| client.control.close_if_stalled(&mut self.out))
    }

    pub(crate) fn poll(&mut self) -> Option<Transmit> {
        while let Some(peer) = self.out.next_sendable() {
            let control = self
                .clients
                .get_mut(&peer)
                .map(|client| &mut client.control);
            let transmit = self.out.poll_control(peer, control);
            if transmit.is_some() {
                return transmit;
            }
        }
        self.out.poll_datagram()
    }
}

/// Authority of all members over bodies of one scene.
#[derive(Debug, Default)]
pub(crate) struct AuthorityTable {
    authorities: BTreeMap<BodyId, Peer>,
    /// Bodies of silent members whose authority has ended since the last step.
    released: BTreeSet<BodyId>,
    /// Bodies that have left the scene under the authority of members by cells, who are to learn it.
    removed: Vec<(Peer, BodyId)>,
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

    /// Ends a member's authority; its bodies stand still. It does not have to learn which of them have left the scene.
    pub(crate) fn end(&mut self, peer: Peer, clients: &mut Clients) {
        self.removed.retain(|(of, _)| *of != peer);
        self.end_group(peer, clients);
    }

    fn end_group(&mut self, peer: Peer, clients: &mut Clients) {
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
        let Some(member) = clients.member_mut(peer) else {
            return;
        };
        let is_by_cells = member.extent() == Extent::Cells;
        if let Some(group) = &mut member.authority {
            group.remove(id);
            if group.bodies().next().is_none() {
                self.end_group(peer, clients);
            }
        }
        self.removed.extend(is_by_cells.then_some((peer, id)));
    }

    /// Tells members by cells which bodies under their authority have left the scene, whatever cells they take: requests about
    /// cells may be under way. Called after the scene events, of which one says the same in a cell that the member takes.
    pub(crate) fn tell_removed(&mut self, clients: &mut Clients) {
        for (peer, id) in self.removed.drain(..) {
            let removed = AuthorityError::UnknownBody(id);
            clients.send(peer, &ServerMessage::AuthorityDenied(removed));
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
