//! An edge: its clients, its mirrors, and the connections to owners.
//!
//! Routes: what a mirror hands on goes to the members that it serves, what a client asks goes to its voice or is answered
//! here. Two faces, one state: [`Edge`] is the endpoint of its clients, [`OwnerSide`] that of its connections to owners.
//! Invariants: a mirror forwards a packet to each member once, as it came; no message of a client is answered before
//! those it sent earlier.

mod owner_side;

use std::sync::Arc;

use bytes::Bytes;
use rhumb_protocol::message::{
    ClientMessage, Denial, Extension, Grease, Role, ServerMessage, StreamChoice, Token, Welcome,
};
use rhumb_protocol::packet::{Datagram, LossReport, PacketKind};
use rhumb_protocol::scene::{IdRange, SceneName};
use rhumb_protocol::session::{CloseCode, TransportCode};
use rhumb_protocol::{
    Ending, Endpoint, Instant, LinkReport, Peer, Span, Transmit, Wake, WakeReason,
};
use rhumb_reckoning::Tolerance;
use rhumb_scene::{ControlStream, Limits, PendingOutput, Permit};

use crate::client::{Action, Clients, EdgeClient, EdgeMember, Joining, MirrorId};
use crate::mirror::{Forward, Mirror};
use crate::owners::{Dial, LinkUse, MIRRORS_MAX, Owners, SharedPacket, SharedQueue, SharedStream};
use crate::voice::{Reply, Voice};

/// Bytes of a client that wait for the owner beyond which no more are read.
const UNREAD_BYTES: usize = 64 << 10;
/// Questions of an observer that wait for the owner beyond which no more are read.
const UNANSWERED: usize = 64;
/// The stream by which an edge learns of a scene that none of its members has joined.
const FIRST_CHOICE: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);

/// Settings of an edge.
#[derive(Clone, Debug)]
pub struct EdgeSettings {
    /// Bounds of its clients' control streams.
    pub limits: Limits,
    /// The token that the edge itself shows the owner; an observer's suffices.
    pub token: Option<Token>,
    /// Rights of a client before [`Edge::admit`]. An observer is served by the edge alone; for every other one a connection to
    /// the owner is opened, which decides.
    pub permit: Arc<Permit>,
    /// True if a client of an owner that asks for no token is refused.
    pub asks_tokens: bool,
    /// The time for which a token is valid, by its own words: the owner has verified it. An observer is closed after that
    /// time; where it is `None`, the observer keeps its connection to the owner, which ends it.
    pub token_life: fn(&[u8]) -> Option<Span>,
}

/// An edge.
pub struct Edge {
    settings: EdgeSettings,
    out: PendingOutput,
    clients: Clients,
    owners: Owners,
    shared: SharedQueue,
}

/// The face of an edge to owners.
pub struct OwnerSide<'a>(&'a mut Edge);

impl Edge {
    /// An edge without clients.
    #[must_use]
    pub fn new(settings: EdgeSettings) -> Self {
        Self {
            out: PendingOutput::new(settings.limits),
            owners: Owners::new(settings.token.clone()),
            settings,
            clients: Clients::default(),
            shared: SharedQueue::default(),
        }
    }

    /// Sets what a new connection may do, before its first message.
    pub fn admit(&mut self, peer: Peer, permit: Arc<Permit>) {
        if let Some(client) = self.clients.by_peer.get_mut(&peer) {
            client.permit = permit;
        }
    }

    /// The packets of its streams reach a client by a fan-out from now on: [`Self::poll_shared`].
    pub fn share(&mut self, peer: Peer) {
        if let Some(client) = self.clients.by_peer.get_mut(&peer) {
            client.is_shared = true;
        }
    }

    /// The next connection to open.
    pub fn poll_dial(&mut self) -> Option<Dial> {
        self.owners.poll_dial()
    }

    /// The next packet for a fan-out.
    pub fn poll_shared(&mut self) -> Option<SharedPacket> {
        self.shared.pop()
    }

    /// The streams whose packets it needs.
    pub fn streams(&self) -> impl Iterator<Item = SharedStream> {
        self.owners.streams()
    }

    /// A packet that a fan-out carried.
    pub fn handle_shared(&mut self, now: Instant, packet: &SharedPacket) {
        let receivers = self.owners.mirrors.iter_mut().filter(|(_, mirror)| {
            mirror.scene == packet.of.scene && mirror.stream() == Some(packet.of.stream)
        });
        let mut ids = Vec::new();
        for (id, mirror) in receivers {
            mirror.handle_datagram(now, packet.bytes.clone());
            ids.push(*id);
        }
        for id in ids {
            self.serve_mirror(now, id);
        }
    }

    /// Its face to owners.
    pub const fn owner(&mut self) -> OwnerSide<'_> {
        OwnerSide(self)
    }

    /// Reads the messages of a client as far as they can be answered now.
    fn read(&mut self, now: Instant, peer: Peer) {
        loop {
            let Some(client) = self.clients.by_peer.get_mut(&peer) else {
                return;
            };
            if client.waits(UNANSWERED) {
                return;
            }
            let Some(session) = client.control.session(&mut self.out) else {
                return;
            };
            let Some(message) = session.poll_message() else {
                let broken = session.poll_close();
                if let Some(code) = broken {
                    tracing::warn!(peer = peer.0, %code, "closing a connection that broke the protocol");
                    self.part(peer, TransportCode::LEFT.0);
                }
                return;
            };
            let framed = session.last_frame().cloned();
            if !client.is_greeted {
                if let Ok(ClientMessage::Hello {
                    scene, extensions, ..
                }) = message
                {
                    let token = extensions.value(Extension::TOKEN);
                    let life = token.and_then(self.settings.token_life);
                    client.has_token = token.is_some();
                    client.token_ends = life.map(|life| now + life);
                    client.deadline = None;
                    client.scene = Some(scene.clone());
                    if client.permit.role == Role::Observer {
                        self.learn_of(now, peer, &scene);
                    } else {
                        let link = self.owners.dial(scene, LinkUse::Voice(peer));
                        let mut voice = Voice::new(link);
                        if let Some(framed) = &framed {
                            voice.send_frame(framed);
                        }
                        if let Some(client) = self.clients.by_peer.get_mut(&peer) {
                            client.voice = Some(voice);
                        }
                    }
                }
                continue;
            }
            let action = client.decide(message);
            if matches!(action, Action::Pass | Action::Join(_))
                && let (Some(voice), Some(framed)) = (&mut client.voice, &framed)
            {
                voice.send_frame(framed);
            }
            self.act(now, peer, action);
        }
    }

    fn act(&mut self, now: Instant, peer: Peer, action: Action) {
        let Some(client) = self.clients.by_peer.get_mut(&peer) else {
            return;
        };
        match action {
            Action::Done | Action::Pass => {}
            Action::Answer(answers) => {
                for answer in answers {
                    client.control.send(&answer, &mut self.out);
                }
            }
            Action::Refuse(number, error) => {
                let mirror = client.member.as_ref().map(|member| member.mirror);
                let (tick, _) = self.owners.time(now, mirror);
                let refused = ServerMessage::Refused { number, error };
                client.control.send(&refused, &mut self.out);
                let applied = ServerMessage::Applied {
                    through: number,
                    tick,
                };
                client.control.send(&applied, &mut self.out);
            }
            Action::Time(sent) => {
                let mut mirrors = self.owners.of_scene(client.scene.as_ref());
                let mirror = mirrors.next().map(|(id, _)| id);
                let (tick, since_tick_ns) = self.owners.time(now, mirror);
                let pong = ServerMessage::Pong {
                    sent,
                    tick,
                    since_tick_ns,
                };
                client.control.send(&pong, &mut self.out);
            }
            Action::Ask(question) => self.ask(peer, question),
            Action::Join(choice) => {
                let granted = client.voice.is_none().then_some((IdRange::EMPTY, 0));
                client.joining = Some(Joining { choice, granted });
                self.want_copy(now, peer, choice);
            }
            Action::Snapshot(choice) => {
                let present = client.member.as_ref().map(|member| member.mirror);
                let present = present.and_then(|present| self.owners.get(present));
                let present = present.map(|present| present.choice);
                if let Some(member) = &mut client.member
                    && let Some(choice) = choice.or(member.wanted).or(present)
                {
                    member.wanted = Some(choice);
                    self.want_copy(now, peer, choice);
                }
            }
            Action::CaughtUp(stream) => {
                if let Some(member) = &mut client.member
                    && self.owners.get(member.mirror).and_then(Mirror::stream) == Some(stream)
                    && let Some(previous) = member.previous.take()
                    && let Some(previous) = self.owners.get_mut(previous)
                {
                    previous.forget(peer);
                }
            }
            Action::Leave => {
                client.member = None;
                client.control.send(&ServerMessage::Left, &mut self.out);
                self.owners.forget_questions(peer);
            }
        }
    }

    /// Sends a client the snapshot that it waits for, as soon as there is one.
    fn want_copy(&mut self, now: Instant, peer: Peer, choice: StreamChoice) {
        let client = self.clients.by_peer.get(&peer);
        let scene = client.and_then(|client| client.scene.clone());
        let has_room = scene.is_none_or(|scene| self.mirror_of(now, &scene, choice));
        if !has_room && let Some(client) = self.clients.by_peer.get_mut(&peer) {
            client.deny((None, choice), Denial::TooManyStreams, &mut self.out);
        }
        self.send_snapshot(now, peer);
    }

    /// Welcomes an observer once it is known whether its scene exists. If that cannot be asked, it has to come again.
    fn learn_of(&mut self, now: Instant, peer: Peer, scene: &SceneName) {
        let has_room = self.mirror_of(now, scene, FIRST_CHOICE);
        if has_room || self.owners.of_scene(Some(scene)).next().is_some() {
            return self.greet_observers(scene);
        }
        let client = self.clients.by_peer.get_mut(&peer);
        if let Some(session) = client.and_then(|client| client.control.session(&mut self.out)) {
            tracing::warn!(
                peer = peer.0,
                %scene,
                limit = MIRRORS_MAX,
                "closing a connection: members of this edge receive as many streams as it may have; start another edge"
            );
            session.close(CloseCode::BUSY);
        }
    }

    /// Makes sure that there is a mirror of a choice; false if its scene, or the edge, has as many as it may.
    fn mirror_of(&mut self, now: Instant, scene: &SceneName, choice: StreamChoice) -> bool {
        let clients = &self.clients;
        let is_used = |id, mirror: &Mirror| clients.need(id, mirror);
        self.owners.mirror_of(now, (scene, choice), is_used)
    }

    /// An observer's question goes to the owner by its mirror; answers come in order.
    fn ask(&mut self, peer: Peer, question: ClientMessage) {
        let client = self.clients.by_peer.get_mut(&peer);
        if let Some(member) = client.and_then(|client| client.member.as_mut())
            && let Some(mirror) = self.owners.get_mut(member.mirror)
        {
            mirror.ask(peer, member.count_question(&question), question);
        }
    }

    /// Welcomes the observers of a scene, once it is known whether it exists.
    fn greet_observers(&mut self, scene: &SceneName) {
        let of_scene = || self.owners.of_scene(Some(scene));
        let config = of_scene().find_map(|(_, mirror)| mirror.config());
        let is_absent = of_scene().any(|(_, mirror)| mirror.denied.is_some());
        if config.is_some() || is_absent {
            self.clients.greet_observers(scene, config, &mut self.out);
        }
    }

    /// Hands on what a mirror has received, and does what it makes possible.
    fn serve_mirror(&mut self, now: Instant, id: MirrorId) {
        while let Some(forward) = self.owners.get_mut(id).and_then(Mirror::poll_forward) {
            self.forward(now, id, forward);
        }
        let Some(mirror) = self.owners.get_mut(id) else {
            return;
        };
        let (answers, astray) = mirror.answer_reports(now);
        let (scene, mirror_choice, denied) = (mirror.scene.clone(), mirror.choice, mirror.denied);
        for (peer, bytes) in answers {
            if let Some(client) = self.clients.by_peer.get(&peer) {
                client.control.send_datagram(bytes, &mut self.out);
            }
        }
        for peer in astray {
            self.renew(peer, id);
        }
        self.greet_observers(&scene);
        if let Some(denial) = denied {
            let of = (id, &scene, mirror_choice);
            let is_awaited = self.clients.deny(of, denial, &mut self.out);
            if let Some(mirror) = self.owners.get_mut(id) {
                mirror.is_awaited = is_awaited;
            }
        }
        self.send_snapshots(now);
        self.tell_standing(now, id);
        for peer in self.clients.peers() {
            self.hear(now, peer);
        }
    }

    /// Tells the members of a mirror the next part of what stands, once for a tick (PROTOCOL 4.15-11).
    fn tell_standing(&mut self, now: Instant, id: MirrorId) {
        if let Some(mirror) = self.owners.get_mut(id).filter(|mirror| mirror.is_live())
            && self.clients.lack_standing(id)
        {
            let (tick, standing) = (mirror.scene_tick(), mirror.standing());
            self.clients
                .tell_standing(id, (tick, &standing), &mut self.out);
            if self.clients.lack_standing(id) {
                mirror.ask_watermark(now);
            }
        }
    }

    fn forward(&mut self, now: Instant, id: MirrorId, forward: Forward) {
        match forward {
            Forward::Control(bytes) => self.clients.forward_control(id, &bytes, &mut self.out),
            Forward::Events(events, bytes) => {
                if let Some(mirror) = self.owners.get(id) {
                    let events = (&events, &bytes);
                    self.clients
                        .forward_events(id, events, mirror, &mut self.out);
                }
            }
            Forward::Packet(bytes) => self.forward_packet(id, bytes),
            Forward::Answer(peer, answer) => self.answer(now, peer, &answer),
            Forward::Deleted => {
                let Some(mirror) = self.owners.get(id) else {
                    return;
                };
                let of = (id, &mirror.scene, mirror.choice);
                for peer in self.clients.end_scene(of, &mut self.out) {
                    self.owners.forget_questions(peer);
                }
            }
            Forward::Retold => {
                let members = self.clients.members_of(id);
                members.for_each(|member| member.events.retell());
            }
            Forward::Renewed => self.renew_all(id, EdgeMember::renew),
            Forward::Replaced => self.renew_all(id, EdgeMember::replace),
        }
    }

    fn forward_packet(&mut self, id: MirrorId, bytes: Bytes) {
        let is_shared = self.clients.forward_packet(id, &bytes, &mut self.out);
        if is_shared
            && let Some(mirror) = self.owners.get(id)
            && let Some(stream) = mirror.stream()
        {
            let scene = mirror.scene.clone();
            let of = SharedStream { scene, stream };
            self.shared.push(SharedPacket { of, bytes });
        }
    }

    /// Gives an answer of the owner to the member that asked.
    fn answer(&mut self, now: Instant, peer: Peer, answer: &ServerMessage) {
        if let Some(client) = self.clients.by_peer.get_mut(&peer)
            && let Some(member) = &mut client.member
        {
            member.unanswered -= 1;
            client.control.send(answer, &mut self.out);
            self.read(now, peer);
        }
    }

    /// All members of a mirror get a new snapshot; each notes why.
    fn renew_all(&mut self, id: MirrorId, note: impl Fn(&mut EdgeMember)) {
        self.clients.members_of(id).for_each(note);
        for peer in self.clients.peers() {
            self.renew(peer, id);
        }
    }

    /// A member of a mirror gets a new snapshot, asked for or not (PROTOCOL 3.2-4).
    fn renew(&mut self, peer: Peer, id: MirrorId) {
        let choice = self.owners.get(id).map(|mirror| mirror.choice);
        let member = self
            .clients
            .by_peer
            .get_mut(&peer)
            .and_then(|client| client.member.as_mut());
        if let Some(member) = member {
            if member.previous == Some(id) {
                member.previous = None;
            }
            if member.mirror == id && member.wanted.is_none() {
                member.wanted = choice;
            }
        }
    }

    /// Makes members of the clients whose mirrors are ready, and sends the snapshots that members wait for.
    fn send_snapshots(&mut self, now: Instant) {
        let waiting = self.clients.by_peer.iter();
        let waiting = waiting.filter(|(_, client)| client.awaits_copy().is_some());
        for peer in waiting.map(|(peer, _)| *peer).collect::<Vec<_>>() {
            self.send_snapshot(now, peer);
        }
    }

    fn send_snapshot(&mut self, now: Instant, peer: Peer) {
        let Some(client) = self.clients.by_peer.get_mut(&peer) else {
            return;
        };
        let Some(id) = self.owners.source_for(client) else {
            return;
        };
        if !client.control.may_snapshot(now) {
            return;
        }
        if let Some(mirror) = self.owners.get_mut(id) {
            client.begin_copy((id, mirror), &mut self.out);
        }
        self.tell_standing(now, id);
        self.read(now, peer);
        self.hear(now, peer);
    }

    /// Tells a client what the owner said, as far as it has the scene events before it.
    fn hear(&mut self, now: Instant, peer: Peer) {
        loop {
            let Some(client) = self.clients.by_peer.get_mut(&peer) else {
                return;
            };
            let Some(voice) = &mut client.voice else {
                return;
            };
            let reached = client
                .member
                .as_ref()
                .filter(|member| !member.is_stale)
                .and_then(|member| self.owners.get(member.mirror))
                .map(Mirror::scene_events);
            let is_over = client.scene_is_over || (client.member.is_none() && voice.tells_end());
            match voice.next_reply() {
                None => return,
                Some(Reply::Message(_, Some(events)))
                    if !is_over && reached.is_none_or(|reached| reached < *events) =>
                {
                    return;
                }
                Some(_) => {}
            }
            let Some(reply) = voice.take_reply() else {
                return;
            };
            match reply {
                Reply::Joined(joined) => {
                    let granted = Some((joined.granted, joined.start.scene_events));
                    let choice = joined.choice;
                    client.scene_is_over = false;
                    client.joining = Some(Joining { choice, granted });
                    self.want_copy(now, peer, choice);
                }
                Reply::Message(message, _) => self.tell(now, peer, *message),
                Reply::Datagram(bytes) => client.control.send_datagram(bytes, &mut self.out),
                Reply::Ended(ending) => {
                    let elsewhere = voice.elsewhere().map(str::to_owned);
                    if let Some(scene) = &client.scene {
                        self.owners.note_end(scene, ending, elsewhere.as_deref());
                        // Its member has not been welcomed yet.
                        if elsewhere.is_some() && !client.is_greeted {
                            self.owners.links.remove(&voice.link());
                            let link = self.owners.dial(scene.clone(), LinkUse::Voice(peer));
                            if voice.follow(link) {
                                return;
                            }
                        }
                    }
                    if let Some(voice) = client.voice.take() {
                        self.owners.end_voice(voice);
                    }
                    let code = match ending {
                        Ending::Closed(code) => CloseCode(code),
                        Ending::TimedOut | Ending::Broken => CloseCode(TransportCode::GOING_AWAY.0),
                    };
                    if !matches!(ending, Ending::Closed(_)) {
                        self.owners.doubt(now, client.scene.as_ref());
                    }
                    if let Some(session) = client.control.session(&mut self.out) {
                        session.close(code);
                    }
                    return;
                }
            }
        }
    }

    /// Hands on a message of the owner.
    fn tell(&mut self, now: Instant, peer: Peer, message: ServerMessage) {
        let Some(client) = self.clients.by_peer.get_mut(&peer) else {
            return;
        };
        match message {
            ServerMessage::Welcome(welcome) => self.greet(now, peer, &welcome),
            message => {
                let ends = matches!(message, ServerMessage::Left | ServerMessage::Deleted);
                if ends {
                    client.member = None;
                    client.scene_is_over = false;
                }
                let denies_join =
                    matches!(message, ServerMessage::Denied(_)) && client.member.is_none();
                let message = match ends && client.joining.is_some_and(Joining::is_granted) {
                    true => ServerMessage::Denied(Denial::NoSuchScene),
                    false => message,
                };
                client.control.send(&message, &mut self.out);
                // A join that the owner has granted ends with the membership, another one with its denial.
                let is_answered = |joining: &mut Joining| match joining.is_granted() {
                    true => ends,
                    false => denies_join,
                };
                if client.joining.take_if(is_answered).is_some() {
                    self.read(now, peer);
                }
            }
        }
    }

    /// Hands on the owner's welcome, by which the owner has admitted a client. An observer no longer needs the owner.
    fn greet(&mut self, now: Instant, peer: Peer, welcome: &Welcome) {
        let Some(client) = self.clients.by_peer.get_mut(&peer) else {
            return;
        };
        client.is_greeted = true;
        let role = welcome.extensions.value(Extension::TOKEN);
        let role = role.and_then(|role| Role::from_code(*role.first()?));
        let Some(session) = client.control.session(&mut self.out) else {
            return;
        };
        if role.is_none() && self.settings.asks_tokens {
            tracing::warn!(
                peer = peer.0,
                "the owner asks for no token, and this edge is open to other machines: refused"
            );
            return session.close(CloseCode::TOKEN_MISSING);
        }
        session.welcome(welcome.scene, role);
        if role == Some(Role::Observer)
            && let Some(ends) = client.token_ends
            && let Some(mut voice) = client.voice.take()
        {
            client.deadline = Some((ends, CloseCode::TOKEN_EXPIRED));
            voice.close(CloseCode::DONE.0);
            self.owners.end_voice(voice);
        }
        self.read(now, peer);
    }

    /// Ends what a client has at the owner. With code 0 its session is over.
    fn part(&mut self, peer: Peer, code: u32) {
        let Some(client) = self.clients.by_peer.get_mut(&peer) else {
            return;
        };
        client.member = None;
        client.joining = None;
        if let Some(mut voice) = client.voice.take() {
            voice.close(code);
            self.owners.end_voice(voice);
        }
        for mirror in self.owners.mirrors.values_mut() {
            mirror.forget(peer);
            mirror.forget_questions(peer);
        }
    }

    /// Leaves the streams that no client has needed for some time.
    fn close_unused(&mut self, now: Instant) {
        let clients = &self.clients;
        let is_used = |id, mirror: &Mirror| clients.need(id, mirror);
        self.owners.close_unused(now, is_used);
    }

    /// Gives what came over a connection to its mirror or voice, and does what follows.
    fn heed(
        &mut self,
        now: Instant,
        link: Peer,
        of_mirror: impl FnOnce(&mut Mirror),
        of_voice: impl FnOnce(&mut Voice),
    ) {
        self.out.at(now);
        match self.owners.links.get(&link).copied() {
            Some(LinkUse::Mirror(id)) => {
                self.owners.get_mut(id).map(of_mirror);
                self.serve_mirror(now, id);
            }
            Some(LinkUse::Voice(peer)) => {
                let client = self.clients.by_peer.get_mut(&peer);
                client
                    .and_then(|client| client.voice.as_mut())
                    .map(of_voice);
                self.hear(now, peer);
            }
            None => {}
        }
    }

    /// The next moment at which there is something to do: for the owners, when a client may get the snapshot that is ready, or
    /// when one is closed.
    fn next_wake(&self) -> Option<Wake> {
        let clients = self.clients.by_peer.values();
        let ready = clients.filter(|client| self.owners.source_for(client).is_some());
        let snapshots = ready.filter_map(|client| client.control.snapshot_at());
        let at = snapshots.min().map(|at| Wake {
            at,
            reason: WakeReason::Snapshot,
        });
        let clients = self.clients.by_peer.values();
        let deadlines = clients.filter_map(|client| Some(client.deadline?.0));
        let deadline = deadlines.min().map(|at| Wake {
            at,
            reason: WakeReason::Deadline,
        });
        let wakes = [at, deadline, self.owners.next_wake()]
            .into_iter()
            .flatten();
        wakes.min_by_key(|wake| wake.at)
    }

    fn wake(&mut self, now: Instant) {
        self.out.at(now);
        for id in self.owners.wake(now) {
            self.serve_mirror(now, id);
        }
        self.close_late(now);
        self.close_unused(now);
        self.send_snapshots(now);
    }

    /// Closes the clients whose deadline is over.
    fn close_late(&mut self, now: Instant) {
        for client in self.clients.by_peer.values_mut() {
            let over = client.deadline.take_if(|(at, _)| *at <= now);
            if let Some((_, code)) = over
                && let Some(session) = client.control.session(&mut self.out)
            {
                session.close(code);
            }
        }
    }
}

impl Endpoint for Edge {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        self.out.at(now);
        let seed = now.as_nanos() ^ peer.0.rotate_left(48);
        let control = ControlStream::new(peer, Grease::new(seed), now);
        let hello_until = now + self.settings.limits.hello();
        let client = EdgeClient::new(control, Arc::clone(&self.settings.permit), hello_until);
        self.clients.by_peer.insert(peer, client);
    }

    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.out.at(now);
        let client = self.clients.by_peer.get_mut(&from);
        if let Some(session) = client.and_then(|client| client.control.session(&mut self.out)) {
            session.handle_control(bytes);
        }
        self.read(now, from);
    }

    fn handle_control_taken(&mut self, now: Instant, peer: Peer, bytes: usize) {
        self.out.at(now);
        if let Some(client) = self.clients.by_peer.get_mut(&peer) {
            client.control.note_taken(bytes, &mut self.out);
        }
        if bytes > 0 {
            self.send_snapshot(now, peer);
        }
    }

    fn wants_control(&self, from: Peer) -> bool {
        self.clients.by_peer.get(&from).is_none_or(|client| {
            let waiting = client.voice.as_ref().map_or(0, Voice::queued_bytes);
            let unread = client.control.unread_bytes() + waiting;
            unread < UNREAD_BYTES && !client.control.is_behind()
        })
    }

    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.out.at(now);
        let (Ok(datagram), Some(client)) =
            (Datagram::open(bytes), self.clients.by_peer.get_mut(&from))
        else {
            return;
        };
        if datagram.head().kind != PacketKind::LossReport {
            if let Some(voice) = &mut client.voice {
                voice.send_datagram(Bytes::copy_from_slice(bytes));
            }
            return;
        }
        let Some(member) = &client.member else {
            return;
        };
        let mirrors = [Some(member.mirror), member.previous];
        for id in mirrors.into_iter().flatten() {
            // A report of a stale member is about the stream before.
            if let Some(mirror) = self.owners.get_mut(id)
                && member.takes(id)
                && mirror.stream() == Some(datagram.head().stream)
                && let Ok(report) = LossReport::decode(datagram.body())
            {
                mirror.handle_report(from, report);
                return self.serve_mirror(now, id);
            }
        }
    }

    fn handle_link(&mut self, now: Instant, peer: Peer, _report: &LinkReport) {
        self.out.at(now);
        if let Some(client) = self.clients.by_peer.get_mut(&peer) {
            client.control.close_if_stalled(&mut self.out);
        }
    }

    fn handle_ended(&mut self, now: Instant, peer: Peer, ending: Ending) {
        self.out.at(now);
        let code = match ending {
            Ending::Closed(code) if code == CloseCode::DONE.0 => code,
            Ending::Closed(_) | Ending::TimedOut | Ending::Broken => TransportCode::LEFT.0,
        };
        self.part(peer, code);
        self.clients.by_peer.remove(&peer);
        self.out.forget(peer);
        self.close_unused(now);
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.wake(now);
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        while let Some(peer) = self.out.next_sendable() {
            let control = self
                .clients
                .by_peer
                .get_mut(&peer)
                .map(|client| &mut client.control);
            let transmit = self.out.poll_control(peer, control);
            if transmit.is_some() {
                return transmit;
            }
        }
        self.out.poll_datagram()
    }

    fn poll_timeout(&self) -> Option<Wake> {
        self.next_wake()
    }
}
