//! A client of an edge: what it may ask, and which mirror serves it.
//!
//! Decides which messages the edge answers, which go to the owner, and how an observer without a voice is refused.
//! Sends nothing by itself but answers. Invariant: a member has a snapshot of its mirror before any scene event or
//! packet of it.
//!
//! Hands what a mirror received to the members that it serves. Knows mirrors by their numbers and asks no owner. Invariant: a
//! packet, a scene event and the events of a tick reach each of these members once.

use std::collections::BTreeMap;
use std::sync::Arc;

use bytes::Bytes;
use rhumb_protocol::message::{
    AuthorityError, ClientMessage, Denial, ServerMessage, SessionState, StreamChoice, TickEvents,
};
use rhumb_protocol::scene::{BodyEvent, CommandError, IdRange, SceneConfig, SceneName};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Instant, Peer};
use rhumb_reckoning::Tick;
use rhumb_scene::{ControlStream, EventKey, PendingOutput, Permit, StepEvents};

use crate::mirror::Mirror;
use crate::voice::Voice;

/// The number of a mirror.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct MirrorId(pub(crate) u64);

/// One client.
#[derive(Debug)]
pub(crate) struct EdgeClient {
    pub(crate) control: ControlStream,
    pub(crate) permit: Arc<Permit>,
    /// True if the packets of its stream reach it by a fan-out.
    pub(crate) is_shared: bool,
    /// The scene that its first message names.
    pub(crate) scene: Option<SceneName>,
    /// True for one whose role is asked for by a token.
    pub(crate) has_token: bool,
    /// When its token ends, as far as that can be read of it.
    pub(crate) token_ends: Option<Instant>,
    /// When it is closed, and why: without a hello, or an observer when its token ends.
    pub(crate) deadline: Option<(Instant, CloseCode)>,
    /// True once it was welcomed.
    pub(crate) is_greeted: bool,
    /// Its connection to the owner; `None` for an observer.
    pub(crate) voice: Option<Voice>,
    /// A join that no snapshot has answered.
    pub(crate) joining: Option<Joining>,
    /// True if the scene of its membership, or of its join, is deleted, and the owner has not said so yet.
    pub(crate) scene_is_over: bool,
    /// Of an observer that names a session with its join: the commands that it knows to be refused.
    pub(crate) asks_session: Option<u64>,
    pub(crate) member: Option<EdgeMember>,
}

/// A join that waits for a snapshot.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Joining {
    pub(crate) choice: StreamChoice,
    /// The indices and the scene events of the owner's answer; `None` before it.
    pub(crate) granted: Option<(IdRange, u64)>,
}

impl Joining {
    /// True once the owner has made the client a member, or if that needs no owner.
    pub(crate) const fn is_granted(self) -> bool {
        self.granted.is_some()
    }
}

/// A client that is a member.
#[derive(Debug)]
pub(crate) struct EdgeMember {
    /// The mirror of its newest stream.
    pub(crate) mirror: MirrorId,
    /// That of the stream before, until the member has caught up.
    pub(crate) previous: Option<MirrorId>,
    /// The choice of the snapshot that it waits for.
    pub(crate) wanted: Option<StreamChoice>,
    /// True if its mirror has another snapshot, of another connection or of an owner that began anew, and it has none of
    /// that: nothing else is for it.
    pub(crate) is_stale: bool,
    pub(crate) granted: IdRange,
    /// Commands of an observer, which are all refused.
    commands: u64,
    /// Queries of an observer.
    queries: u64,
    /// Its questions without an answer.
    pub(crate) unanswered: usize,
    pub(crate) events: MemberEvents,
}

/// How far a member has been reported the events of bodies (PROTOCOL 4.15).
#[derive(Clone, Copy, Debug)]
pub(crate) struct MemberEvents {
    /// The newest tick of the owner's events that it was handed or that it missed.
    through: Tick,
    /// The newest tick with which it was reported what stands.
    reported: Tick,
    /// The last event of what stands that it was reported; `None` once it knows all.
    standing_after: Option<EventKey>,
    missed: u64,
}

impl MemberEvents {
    /// Nothing is reported: all that stands follows.
    fn of(mirror: &Mirror) -> Self {
        Self {
            through: mirror.events_tick(),
            reported: Tick::ZERO,
            standing_after: Some(EventKey::FIRST),
            missed: mirror.untold(),
        }
    }

    /// True if it is to be reported what stands with a tick.
    pub(crate) fn wants_standing(&self, tick: Tick) -> bool {
        self.is_untold() && tick > self.reported
    }

    /// True if it does not know all that stands.
    pub(crate) const fn is_untold(&self) -> bool {
        self.standing_after.is_some()
    }

    /// Notes events that it is not reported; then all that stands follows anew.
    pub(crate) const fn miss(&mut self, count: u64) {
        self.missed += count;
        if count > 0 {
            self.standing_after = Some(EventKey::FIRST);
        }
    }

    /// Another connection to the owner replaces that whose events it was reported; some were lost, at least one.
    pub(crate) const fn renew(&mut self) {
        self.miss(1);
        self.restart();
    }

    /// Another snapshot replaces its copy: its scene may have gone back to an earlier tick.
    const fn restart(&mut self) {
        (self.through, self.reported) = (Tick::ZERO, Tick::ZERO);
    }

    /// The owner tells all of them anew what stands.
    pub(crate) const fn retell(&mut self) {
        self.standing_after = None;
    }

    /// Takes the events of a tick; true if they are new to it.
    pub(crate) fn reaches(&mut self, tick: Tick) -> bool {
        let is_new = tick > self.through;
        self.through = self.through.max(tick);
        is_new
    }

    /// True if the owner's message is for it as it is.
    pub(crate) const fn takes_all(&self) -> bool {
        self.standing_after.is_none() && self.missed == 0
    }

    /// The events of a tick, and as many with them that stand as the message has room for; `None` if there is nothing
    /// to tell.
    pub(crate) fn tell(
        &mut self,
        tick: Tick,
        events: &[BodyEvent],
        standing: &[BodyEvent],
    ) -> Option<ServerMessage> {
        let happened = StepEvents {
            events: events.to_vec(),
            ..StepEvents::default()
        };
        let events = match self.standing_after {
            None => happened.events,
            Some(after) => {
                let (events, due) = happened.with_standing(tick, standing, after);
                (self.standing_after, self.reported) = (due, tick);
                events
            }
        };
        let missed = std::mem::take(&mut self.missed);
        let has_any = missed > 0 || !events.is_empty();
        has_any.then_some(ServerMessage::TickEvents(TickEvents {
            tick,
            missed,
            events,
        }))
    }
}

/// The work that a message asks for.
#[derive(Debug, PartialEq)]
pub(crate) enum Action {
    /// Nothing more.
    Done,
    /// These answers.
    Answer(Vec<ServerMessage>),
    /// The refusal of the command of this number.
    Refuse(u64, CommandError),
    /// The owner decides.
    Pass,
    /// The mirror asks the owner.
    Ask(ClientMessage),
    /// The scene's time.
    Time(Instant),
    /// The client joins.
    Join(StreamChoice),
    /// It gets another snapshot.
    Snapshot(Option<StreamChoice>),
    /// It has caught up with its newest stream.
    CaughtUp(rhumb_protocol::packet::StreamId),
    /// It is no member any more.
    Leave,
}

impl EdgeMember {
    fn new((id, mirror): (MirrorId, &Mirror), granted: IdRange) -> Self {
        Self {
            mirror: id,
            previous: None,
            wanted: None,
            is_stale: false,
            granted,
            commands: 0,
            queries: 0,
            unanswered: 0,
            events: MemberEvents::of(mirror),
        }
    }

    /// Counts a question, and returns the number of its answer if that has one.
    pub(crate) const fn count_question(&mut self, question: &ClientMessage) -> u64 {
        self.unanswered += 1;
        if matches!(question, ClientMessage::Query(_)) {
            self.queries += 1;
        }
        self.queries.saturating_sub(1)
    }

    /// Its mirror came back over another connection.
    pub(crate) const fn renew(&mut self) {
        self.is_stale = true;
        self.events.renew();
    }

    /// The owner of its mirror has begun another snapshot.
    pub(crate) const fn replace(&mut self) {
        self.is_stale = true;
        self.events.restart();
    }

    /// True if packets of a mirror are for it now.
    pub(crate) fn takes(&self, mirror: MirrorId) -> bool {
        self.receives(mirror) && !(self.is_stale && self.mirror == mirror)
    }

    /// True if it receives a mirror's stream.
    pub(crate) fn receives(&self, mirror: MirrorId) -> bool {
        self.mirror == mirror || self.previous == Some(mirror)
    }

    /// Takes a snapshot of a mirror.
    fn change(&mut self, mirror: MirrorId, events_tick: Tick) {
        self.wanted = None;
        self.is_stale = false;
        if self.mirror != mirror {
            // Events are counted by no stream: between two connections some may have been lost, at least one.
            if events_tick != self.events.through {
                self.events.miss(1);
                self.events.through = events_tick;
            }
            // A second change keeps the stream whose copy is complete.
            self.previous = self
                .previous
                .or(Some(self.mirror))
                .filter(|kept| *kept != mirror);
            self.mirror = mirror;
        }
    }
}

impl EdgeClient {
    /// Its hello has to come by `hello_until`.
    pub(crate) const fn new(
        control: ControlStream,
        permit: Arc<Permit>,
        hello_until: Instant,
    ) -> Self {
        Self {
            deadline: Some((hello_until, CloseCode::HELLO_LATE)),
            control,
            permit,
            is_shared: false,
            scene: None,
            has_token: false,
            token_ends: None,
            is_greeted: false,
            voice: None,
            joining: None,
            scene_is_over: false,
            asks_session: None,
            member: None,
        }
    }

    /// True while none of its messages is read: it waits for its welcome, its membership, or so many answers.
    pub(crate) fn waits(&self, unanswered: usize) -> bool {
        let member = self.member.as_ref();
        (self.scene.is_some() && !self.is_greeted)
            || self.joining.is_some()
            || member.is_some_and(|member| member.unanswered >= unanswered)
    }

    /// True if it is a member that does not know all that stands.
    pub(crate) fn lacks_standing(&self) -> bool {
        let member = self.member.as_ref();
        member.is_some_and(|member| member.events.is_untold())
    }

    /// True if it is a member, and a mirror is that of its newest stream.
    pub(crate) fn is_served_by(&self, mirror: MirrorId) -> bool {
        let member = self.member.as_ref();
        member.is_some_and(|member| member.mirror == mirror)
    }

    /// True if scene events of a mirror are for it now.
    pub(crate) fn takes_events(&self, mirror: MirrorId) -> bool {
        let member = self.member.as_ref();
        member.is_some_and(|member| member.mirror == mirror && !member.is_stale)
    }

    /// True if it needs a mirror of its scene: to be served by it, or to learn of the scene.
    pub(crate) fn needs(&self, mirror: MirrorId, choice: StreamChoice) -> bool {
        let joins = self.joining.map(|joining| joining.choice) == Some(choice);
        let member = self.member.as_ref();
        let is_served =
            member.is_some_and(|member| member.receives(mirror) || member.wanted == Some(choice));
        joins || is_served || !self.is_greeted
    }

    /// The choice of the snapshot that it waits for, and the scene events that this has to include. A join waits for the
    /// owner first.
    pub(crate) fn awaits_copy(&self) -> Option<(StreamChoice, u64)> {
        match (&self.joining, &self.member) {
            (Some(joining), _) => joining.granted.map(|(_, events)| (joining.choice, events)),
            (None, member) => member.as_ref()?.wanted.map(|choice| (choice, 0)),
        }
    }

    /// The stream of a choice cannot be had: denies a join, or a member's change to it. `mirror`: that of the stream, whose
    /// members only wait. Returns true if the owner has made it a member of a scene that the mirror does not find.
    pub(crate) fn deny(
        &mut self,
        (mirror, choice): (Option<MirrorId>, StreamChoice),
        denial: Denial,
        out: &mut PendingOutput,
    ) -> bool {
        if let Some(member) = &mut self.member
            && Some(member.mirror) != mirror
            && (member.wanted)
                .take_if(|wanted| *wanted == choice)
                .is_some()
        {
            // No other denial answers a request for a stream.
            let answer = match denial {
                Denial::SceneFaulted => denial,
                _ => Denial::TooManyStreams,
            };
            self.control.send(&ServerMessage::Denied(answer), out);
        }
        let Some(joining) = self.joining.filter(|joining| joining.choice == choice) else {
            return false;
        };
        if self.voice.is_none() {
            self.joining = None;
            self.control.send(&ServerMessage::Denied(denial), out);
        } else if joining.is_granted() && denial == Denial::NoSuchScene {
            return true;
        } else if joining.is_granted()
            && let Some(session) = self.control.session(out)
        {
            // The owner has taken it, and its stream cannot be had.
            session.close(CloseCode::BUSY);
        }
        false
    }

    /// Takes a snapshot of a mirror that is settled; the mirror serves it from then on.
    pub(crate) fn begin_copy(
        &mut self,
        (id, mirror): (MirrorId, &mut Mirror),
        out: &mut PendingOutput,
    ) {
        let joins = self.joining.take();
        let granted = match (&self.member, joins.and_then(|joining| joining.granted)) {
            (Some(member), _) => member.granted,
            (None, Some((granted, _))) if self.voice.is_some() => granted,
            (None, _) => mirror.granted(),
        };
        mirror.forget(self.control.peer());
        let tick = mirror.scene_tick();
        let Some(snapshot) = mirror.snapshot(granted) else {
            return;
        };
        let asked = self.asks_session.take();
        if let Some(commands) = asked {
            // Whichever edge or server it comes from: an observer's session holds nothing but refusals.
            let state = SessionState {
                resumed: true,
                durable: false,
                commands,
                tick,
            };
            self.control.send(&ServerMessage::Session(state), out);
        }
        (self.control).send(&ServerMessage::Joined(snapshot.joined), out);
        let mut bytes = snapshot.rest.len();
        for shape in snapshot.shapes.values() {
            bytes += shape.len();
            self.control.send_encoded(shape, out);
        }
        self.control.send_encoded(&snapshot.rest, out);
        self.control.note_snapshot(bytes, out);
        match &mut self.member {
            Some(member) => member.change(id, mirror.events_tick()),
            None => {
                let mut member = EdgeMember::new((id, &*mirror), granted);
                member.commands = asked.unwrap_or_default();
                self.member = Some(member);
            }
        }
        self.tell_standing(tick, &mirror.standing(), out);
    }

    /// Tells it with a tick what stands, as far as that has room and was not reported.
    pub(crate) fn tell_standing(
        &mut self,
        tick: Tick,
        standing: &[BodyEvent],
        out: &mut PendingOutput,
    ) {
        let untold = (self.member.as_mut()).filter(|member| {
            !member.is_stale && member.events.wants_standing(tick) && !self.control.is_behind()
        });
        if let Some(message) = untold.and_then(|member| member.events.tell(tick, &[], standing)) {
            self.control.send(&message, out);
        }
    }

    /// Tells it the events of a tick: as they came, or with what stands. One that reads too slowly misses them.
    pub(crate) fn tell_events(
        &mut self,
        (events, bytes): (&TickEvents, &Bytes),
        standing: &[BodyEvent],
        out: &mut PendingOutput,
    ) {
        let Some(member) = &mut self.member else {
            return;
        };
        if !member.events.reaches(events.tick) {
            return;
        }
        if member.is_stale || self.control.is_behind() {
            return (member.events).miss(events.missed + events.events.len() as u64);
        }
        if events.missed > 0 {
            member.events.retell();
        }
        if member.events.takes_all() {
            return self.control.send_encoded(bytes, out);
        }
        member.events.missed += events.missed;
        if let Some(message) = member.events.tell(events.tick, &events.events, standing) {
            self.control.send(&message, out);
        }
    }

    /// The action for a message.
    pub(crate) fn decide(&mut self, message: Result<ClientMessage, CommandError>) -> Action {
        match message {
            Ok(ClientMessage::Join(choice)) => Action::Join(choice),
            Ok(ClientMessage::Resync(_)) => Action::Snapshot(None),
            Ok(ClientMessage::Subscribe(choice)) => Action::Snapshot(Some(choice)),
            Ok(ClientMessage::Subscribed(stream)) => Action::CaughtUp(stream),
            // The edge moves no member to another tier.
            Ok(ClientMessage::TierPolicy(_)) => Action::Done,
            // An edge serves whole scenes.
            Ok(ClientMessage::JoinCells | ClientMessage::OfCell { .. }) => Action::Done,
            _ if self.voice.is_some() => Action::Pass,
            message => self.decide_for_observer(message),
        }
    }

    /// The same of an observer, of which the owner knows nothing.
    fn decide_for_observer(&mut self, message: Result<ClientMessage, CommandError>) -> Action {
        let denied = |denial| Action::Answer(vec![ServerMessage::Denied(denial)]);
        match message {
            Ok(
                ClientMessage::Create(_) | ClientMessage::Delete | ClientMessage::Reserve { .. },
            ) => denied(Denial::NotAllowed),
            Ok(ClientMessage::Advance { .. }) => denied(Denial::AdvanceNotAllowed),
            Ok(ClientMessage::TakeAuthority(_)) => {
                Action::Answer(vec![ServerMessage::AuthorityDenied(
                    AuthorityError::NotAllowed,
                )])
            }
            Ok(ClientMessage::Session(request)) => {
                self.asks_session = Some(request.answered);
                Action::Done
            }
            Ok(ClientMessage::Ping { sent }) => Action::Time(sent),
            Ok(ClientMessage::Leave) => Action::Leave,
            Ok(question @ (ClientMessage::Inspect | ClientMessage::Query(_))) => {
                Action::Ask(question)
            }
            Ok(ClientMessage::Command(_)) => self.refuse(CommandError::NotAllowed),
            Err(error) => self.refuse(error),
            Ok(_) => Action::Done,
        }
    }

    fn refuse(&mut self, error: CommandError) -> Action {
        let Some(member) = &mut self.member else {
            return Action::Done;
        };
        member.commands += 1;
        Action::Refuse(member.commands - 1, error)
    }
}

/// The clients by their connections.
#[derive(Debug, Default)]
pub(crate) struct Clients {
    pub(crate) by_peer: BTreeMap<Peer, EdgeClient>,
}

impl Clients {
    /// The connections, for a loop that changes clients.
    pub(crate) fn peers(&self) -> Vec<Peer> {
        self.by_peer.keys().copied().collect()
    }

    /// The members whose newest stream is that of a mirror.
    pub(crate) fn members_of(&mut self, id: MirrorId) -> impl Iterator<Item = &mut EdgeMember> {
        let members = self.by_peer.values_mut();
        let members = members.filter_map(|client| client.member.as_mut());
        members.filter(move |member| member.mirror == id)
    }

    /// Control bytes for all members that a mirror serves.
    pub(crate) fn forward_control(&mut self, id: MirrorId, bytes: &Bytes, out: &mut PendingOutput) {
        for client in self.served_by(id) {
            if client.takes_events(id) {
                client.control.send_encoded(bytes, out);
            }
        }
    }

    /// The events of a tick, and the bytes that tell them.
    pub(crate) fn forward_events(
        &mut self,
        id: MirrorId,
        events: (&TickEvents, &Bytes),
        mirror: &Mirror,
        out: &mut PendingOutput,
    ) {
        let mut standing = None;
        for client in self.served_by(id) {
            let standing = match client.lacks_standing() {
                true => standing.get_or_insert_with(|| mirror.standing()).as_slice(),
                false => &[],
            };
            client.tell_events(events, standing, out);
        }
    }

    /// A packet; returns true if a fan-out is to carry it, too.
    pub(crate) fn forward_packet(
        &self,
        id: MirrorId,
        bytes: &Bytes,
        out: &mut PendingOutput,
    ) -> bool {
        let mut is_shared = false;
        for client in self.by_peer.values() {
            let member = client.member.as_ref();
            if !member.is_some_and(|member| member.takes(id)) {
                continue;
            }
            match client.is_shared {
                true => is_shared = true,
                false => client.control.send_datagram(bytes.clone(), out),
            }
        }
        is_shared
    }

    /// True if a client needs a mirror.
    pub(crate) fn need(&self, id: MirrorId, mirror: &Mirror) -> bool {
        let clients = self.by_peer.values();
        let mut of_scene = clients.filter(|client| client.scene.as_ref() == Some(&mirror.scene));
        mirror.is_asked() || of_scene.any(|client| client.needs(id, mirror.choice))
    }

    /// True if a member that a mirror serves does not know all that stands.
    pub(crate) fn lack_standing(&self, id: MirrorId) -> bool {
        let mut clients = self.by_peer.values();
        clients.any(|client| client.is_served_by(id) && client.lacks_standing())
    }

    /// Tells the members that a mirror serves the next part of what stands.
    pub(crate) fn tell_standing(
        &mut self,
        id: MirrorId,
        (tick, standing): (Tick, &[BodyEvent]),
        out: &mut PendingOutput,
    ) {
        for client in self.served_by(id) {
            client.tell_standing(tick, standing, out);
        }
    }

    /// The scene of a mirror is deleted: returns the observers that are no longer members. Others hear it from the
    /// owner, and no scene event precedes that any more.
    pub(crate) fn end_scene(
        &mut self,
        (id, scene, choice): (MirrorId, &SceneName, StreamChoice),
        out: &mut PendingOutput,
    ) -> Vec<Peer> {
        let mut ended = Vec::new();
        let of_scene =
            (self.by_peer.values_mut()).filter(|client| client.scene.as_ref() == Some(scene));
        for client in of_scene.filter(|client| client.voice.is_some()) {
            let joins = client.joining.filter(|joining| joining.is_granted());
            let joins = joins.is_some_and(|joining| joining.choice == choice);
            client.scene_is_over |= joins || client.is_served_by(id);
        }
        for client in self.served_by(id).filter(|client| client.voice.is_none()) {
            client.member = None;
            client.control.send(&ServerMessage::Deleted, out);
            ended.push(client.control.peer());
        }
        ended
    }

    /// Welcomes the observers of a scene. `config`: `None` if there is no such scene.
    pub(crate) fn greet_observers(
        &mut self,
        scene: &SceneName,
        config: Option<SceneConfig>,
        out: &mut PendingOutput,
    ) {
        for client in self.by_peer.values_mut() {
            let is_of_scene = client.scene.as_ref() == Some(scene);
            if is_of_scene && !client.is_greeted && client.voice.is_none() {
                client.is_greeted = true;
                let role = client.has_token.then_some(client.permit.role);
                if let Some(session) = client.control.session(out) {
                    session.welcome(config, role);
                }
            }
        }
    }

    /// The owner has denied a mirror's join: the joins of its clients are denied, too, and the changes of members to
    /// its stream. Returns true if a client waits for it all the same: the scene was created after the denial, or is
    /// deleted.
    pub(crate) fn deny(
        &mut self,
        (id, scene, choice): (MirrorId, &SceneName, StreamChoice),
        denial: Denial,
        out: &mut PendingOutput,
    ) -> bool {
        let of = (Some(id), choice);
        let mut is_awaited = false;
        let of_scene = self.by_peer.values_mut();
        for client in of_scene.filter(|client| client.scene.as_ref() == Some(scene)) {
            is_awaited |= client.deny(of, denial, out);
        }
        is_awaited
    }

    /// Closes the connections of clients that wait for a stream that cannot be had now, and of observers that wait to
    /// learn of its scene.
    pub(crate) fn turn_away(
        &mut self,
        (scene, choice): (&SceneName, StreamChoice),
        out: &mut PendingOutput,
    ) {
        let of_scene = self.by_peer.values_mut();
        for client in of_scene.filter(|client| client.scene.as_ref() == Some(scene)) {
            let joins = client
                .joining
                .is_some_and(|joining| joining.choice == choice);
            let asks = !client.is_greeted && client.voice.is_none();
            if (joins || asks)
                && let Some(session) = client.control.session(out)
            {
                session.close(CloseCode::BUSY);
            }
        }
    }

    fn served_by(&mut self, id: MirrorId) -> impl Iterator<Item = &mut EdgeClient> {
        let clients = self.by_peer.values_mut();
        clients.filter(move |client| client.is_served_by(id))
    }
}
