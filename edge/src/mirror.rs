//! An edge's membership of one stream: what it holds, and what it sends.
//!
//! Reads what the owner sends twice: the session keeps the tracks, and the messages and packets themselves are handed on.
//! Knows no members of the edge but as numbers. Invariant: a snapshot is made only while the tracks are settled, so that
//! it equals the owner's at that tick.

use std::collections::{BTreeMap, VecDeque};

use bytes::Bytes;
use rhumb_protocol::message::{
    ClientMessage, Denial, Extensions, Framed, Frames, Joined, SceneEvent, ServerMessage,
    StreamChoice, TickEvents, TierPolicy, Token, frame,
};
use rhumb_protocol::packet::{Datagram, LossReport, PacketKind, StreamId};
use rhumb_protocol::scene::{BodyEvent, IdRange, SceneConfig, SceneName, ShapeId, Stepping};
use rhumb_protocol::session::{ClientSession, CloseCode, Event, Misuse, Replica, StandingEvents};
use rhumb_protocol::stream::{Recipient, RefreshReplies, StreamStart, Subscriber};
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit, Wake, WakeReason};
use rhumb_reckoning::{BodyId, Inertia, Tick};

/// The peer number of the owner in a session.
const OWNER: Peer = Peer(0);
/// Pause before it connects again, or joins again.
pub(crate) const RETRY: Span = Span::from_millis(250);
/// Attempts to connect that make the pause longer.
const ATTEMPTS_COUNTED: u32 = 4;
/// Silence after which it asks whether the owner is there.
const PROBES_EVERY: Span = Span::from_millis(1_000);
/// Pause between two questions for the newest tick: several times that in which the owner answers one.
const ASKS_EVERY: Span = Span::from_millis(50);

/// News that a mirror passes on to the members of its stream.
#[derive(Debug)]
pub(crate) enum Forward {
    /// Control bytes for all members that it serves.
    Control(Bytes),
    /// The events of a tick, and the bytes that tell them.
    Events(TickEvents, Bytes),
    /// The owner tells anew what stands.
    Retold,
    /// A datagram of the stream, as it came.
    Packet(Bytes),
    /// The answer to a member's question.
    Answer(Peer, Box<ServerMessage>),
    /// The scene was deleted.
    Deleted,
    /// The copies of members are out of date: a new snapshot came over another connection.
    Renewed,
    /// The copies of members are out of date: the owner began another snapshot by itself, as an edge does whose own owner
    /// has changed. Its events continue.
    Replaced,
}

/// A question that any member may ask.
#[derive(Debug)]
struct Question {
    /// `None` for a member that has left.
    from: Option<Peer>,
    /// Its number among the member's queries.
    number: u64,
    message: ClientMessage,
    is_sent: bool,
}

/// One membership of an edge.
#[derive(Debug)]
pub(crate) struct Mirror {
    pub(crate) scene: SceneName,
    pub(crate) choice: StreamChoice,
    /// Its connection; `None` while there is none.
    pub(crate) link: Option<Peer>,
    /// When it may connect again.
    pub(crate) retry_at: Instant,
    /// Connections that have ended since it last was whole; each makes the next pause longer.
    attempts: u32,
    /// Since when no member needs it.
    pub(crate) unused_since: Option<Instant>,
    /// The owner's refusal of the last attempt.
    pub(crate) denied: Option<Denial>,
    /// True if a client waits for it that the owner has made a member.
    pub(crate) is_awaited: bool,
    session: ClientSession,
    frames: Frames,
    filling: bool,
    /// True if the newest snapshot is not the first one over this connection.
    is_repeated: bool,
    /// True once the connection is open.
    is_open: bool,
    /// True once this end has closed the connection: nothing more is read.
    has_closed: bool,
    /// True once the owner has begun a snapshot over this connection: the next one tells nothing of what stands.
    knows_standing: bool,
    /// True once a snapshot has been complete over any connection.
    was_whole: bool,
    config: Option<SceneConfig>,
    granted: IdRange,
    shapes: BTreeMap<ShapeId, Bytes>,
    inertias: BTreeMap<BodyId, Inertia>,
    silences: Vec<(Tick, Vec<BodyId>)>,
    /// The standing contacts and sensors, for new members.
    standing: StandingEvents,
    /// The newest tick whose events it has.
    events_tick: Tick,
    /// The time of the next question for the newest tick.
    asks_at: Option<Instant>,
    /// True until the owner answers.
    is_doubtful: bool,
    /// The newest statement of the scene's time: a moment, a tick, the time since it.
    clock: Option<(Instant, Tick, Span)>,
    replies: RefreshReplies,
    /// Loss reports that wait until the tracks are settled.
    reports: BTreeMap<Peer, LossReport>,
    /// The last snapshot, and the tick, number and scene events of which it is.
    snapshot: Option<((Tick, u64, u64), Bytes)>,
    /// The questions that the owner has not answered, oldest first.
    questions: VecDeque<Question>,
    forwards: VecDeque<Forward>,
}

impl Mirror {
    /// A mirror before its connection.
    pub(crate) fn new(scene: SceneName, choice: StreamChoice) -> Self {
        Self {
            session: ClientSession::new(scene.clone()),
            scene,
            choice,
            link: None,
            retry_at: Instant::ZERO,
            attempts: 0,
            unused_since: None,
            denied: None,
            is_awaited: false,
            frames: Frames::new(),
            filling: false,
            is_repeated: false,
            is_open: false,
            has_closed: false,
            knows_standing: false,
            was_whole: false,
            config: None,
            granted: IdRange::EMPTY,
            shapes: BTreeMap::new(),
            inertias: BTreeMap::new(),
            silences: Vec::new(),
            standing: StandingEvents::default(),
            events_tick: Tick::ZERO,
            asks_at: None,
            is_doubtful: false,
            clock: None,
            replies: RefreshReplies::default(),
            reports: BTreeMap::new(),
            snapshot: None,
            questions: VecDeque::new(),
            forwards: VecDeque::new(),
        }
    }

    /// Begins a connection.
    pub(crate) fn connect(&mut self, link: Peer, token: Option<Token>) {
        let mut session = ClientSession::new(self.scene.clone());
        session.relay();
        if let Some(token) = token {
            session.set_token(token);
        }
        self.session = session;
        self.frames = Frames::new();
        self.link = Some(link);
        self.denied = None;
        self.is_doubtful = false;
        (self.is_open, self.has_closed) = (false, false);
        (self.filling, self.knows_standing) = (false, false);
        // Another scene may have the same tick and counts.
        self.snapshot = None;
        self.clock = None;
        self.questions.retain(|question| question.from.is_some());
        for question in &mut self.questions {
            question.is_sent = false;
        }
        self.reports.clear();
    }

    pub(crate) fn handle_opened(&mut self, now: Instant) {
        self.is_open = true;
        self.asks_at = Some(now + PROBES_EVERY);
        self.session.handle_opened(now, OWNER);
    }

    /// Control bytes of the owner.
    pub(crate) fn handle_control(&mut self, now: Instant, bytes: &[u8]) {
        self.is_doubtful = false;
        self.frames.push(bytes);
        while let Some(framed) = self.next_frame() {
            let mut message = Vec::new();
            frame(framed.kind, &framed.body, &mut message);
            self.session.handle_control(now, OWNER, &message);
            if let Ok(Some(decoded)) = ServerMessage::decode(&framed) {
                self.take(now, decoded, message);
            }
            self.drain_events(now);
        }
        self.replies.begin_tick();
    }

    /// The next message. Bytes that are none end the connection.
    fn next_frame(&mut self) -> Option<Framed> {
        if self.has_closed {
            return None;
        }
        self.frames.next_frame().unwrap_or_else(|malformed| {
            tracing::warn!(scene = %self.scene, %malformed, "closing a connection to the owner");
            self.has_closed = true;
            self.session.close(CloseCode::MALFORMED);
            None
        })
    }

    /// A datagram of the owner, or of a fan-out.
    pub(crate) fn handle_datagram(&mut self, now: Instant, bytes: Bytes) {
        let Ok(datagram) = Datagram::open(&bytes) else {
            return;
        };
        if self.has_closed {
            return;
        }
        self.is_doubtful = false;
        self.session.handle_datagram(now, OWNER, &bytes);
        self.replies.begin_tick();
        if let Some(replica) = self.session.replica_mut() {
            // No view shows the past of an edge.
            let stream = replica.stream_mut();
            stream.forget_before(stream.watermark_tick());
        }
        // A snapshot that replaces the copies of members includes what comes meanwhile.
        if datagram.head().kind != PacketKind::LossReport
            && Some(datagram.head().stream) == self.stream()
            && !self.filling
        {
            self.forwards.push_back(Forward::Packet(bytes));
        }
    }

    /// The connection has ended.
    pub(crate) fn handle_ended(&mut self, now: Instant, ending: Ending) {
        if let Ending::Closed(code) = ending {
            let code = CloseCode(code);
            tracing::warn!(scene = %self.scene, %code, "the owner closes the connection of an edge");
        }
        self.session.handle_ended(now, OWNER, ending);
        self.attempts = (self.attempts + 1).min(ATTEMPTS_COUNTED);
        self.retry_at = now + Span::from_nanos(RETRY.as_nanos() * u64::from(self.attempts));
        self.link = None;
        self.reports.clear();
    }

    /// The address that the owner gave for its scene, if the connection ended with that.
    pub(crate) fn elsewhere(&self) -> Option<&str> {
        self.session.elsewhere()
    }

    /// Its scene has moved: it is to be connected there at once, unless it is sent from server to server. True if it is.
    pub(crate) fn follow(&mut self, now: Instant) -> bool {
        let follows = self.attempts <= 1;
        if follows {
            self.retry_at = now;
        }
        follows
    }

    pub(crate) fn handle_timeout(&mut self, now: Instant) {
        if self.asks_at.is_some_and(|at| at <= now) {
            self.session.query_watermark(now, Span::ZERO);
            self.asks_at = Some(now + PROBES_EVERY);
        }
        self.session.handle_timeout(now);
    }

    pub(crate) fn poll_transmit(&mut self) -> Option<Transmit> {
        self.session.poll_transmit()
    }

    pub(crate) fn poll_timeout(&self) -> Option<Wake> {
        self.link?;
        let asks = self.asks_at.map(|at| Wake {
            at,
            reason: WakeReason::Watermark,
        });
        let wakes = [self.session.poll_timeout(), asks].into_iter().flatten();
        wakes.min_by_key(|wake| wake.at)
    }

    pub(crate) fn poll_forward(&mut self) -> Option<Forward> {
        self.forwards.pop_front()
    }

    /// Leaves the scene.
    pub(crate) fn close(&mut self) {
        self.session.close(CloseCode::DONE);
    }

    /// The stream, once it is known.
    pub(crate) fn stream(&self) -> Option<StreamId> {
        self.session
            .replica()
            .map(|replica| replica.stream().stream())
    }

    /// The scene's config, if the owner has the scene.
    pub(crate) const fn config(&self) -> Option<SceneConfig> {
        self.config
    }

    /// Scene events that its members have been handed.
    pub(crate) fn scene_events(&self) -> u64 {
        self.subscriber().map_or(0, Subscriber::scene_events)
    }

    /// True once its connection is open.
    pub(crate) const fn is_open(&self) -> bool {
        self.is_open
    }

    /// True while it has a connection with a complete copy.
    pub(crate) fn is_live(&self) -> bool {
        let is_open = self.link.is_some() && !self.has_closed;
        is_open && !self.filling && self.subscriber().is_some()
    }

    /// True if a snapshot can be made now.
    pub(crate) fn is_settled(&self) -> bool {
        let is_sure = self.is_live() && !self.is_doubtful;
        is_sure && self.subscriber().is_some_and(Subscriber::is_settled)
    }

    /// The indices that the owner granted the edge. It adds no bodies, and an observer may not.
    pub(crate) const fn granted(&self) -> IdRange {
        self.granted
    }

    /// The newest tick of its copy.
    pub(crate) fn scene_tick(&self) -> Tick {
        self.subscriber()
            .map_or(Tick::ZERO, Subscriber::watermark_tick)
    }

    /// True if it has members, and the owner has no place for it now.
    pub(crate) const fn is_refused(&self) -> bool {
        (self.was_whole || self.is_awaited) && self.link.is_some() && self.denied.is_some()
    }

    /// Joins once more, if the owner has denied that.
    pub(crate) fn join_again(&mut self) {
        if self.link.is_some() && self.denied.take().is_some() {
            let asked = self.session.join(self.choice);
            debug_assert!(asked.is_ok(), "a denied client is in the lobby");
        }
    }

    /// Asks the owner something that any member may ask, now or once there is a connection. Answers come in the order of
    /// questions. `number`: that of the member's queries.
    pub(crate) fn ask(&mut self, from: Peer, number: u64, message: ClientMessage) {
        self.questions.push_back(Question {
            from: Some(from),
            number,
            message,
            is_sent: false,
        });
        self.send_questions();
    }

    /// True while a member waits for an answer.
    pub(crate) fn is_asked(&self) -> bool {
        let mut askers = self.questions.iter().map(|question| question.from);
        askers.any(|from| from.is_some())
    }

    /// The answers to a member that has left are dropped.
    pub(crate) fn forget_questions(&mut self, peer: Peer) {
        for question in &mut self.questions {
            question.from = question.from.filter(|from| *from != peer);
        }
        (self.questions).retain(|question| question.is_sent || question.from.is_some());
        let is_for_it =
            |forward: &Forward| matches!(forward, Forward::Answer(to, _) if *to == peer);
        self.forwards.retain(|forward| !is_for_it(forward));
    }

    fn send_questions(&mut self) {
        let waiting = self
            .questions
            .iter_mut()
            .filter(|question| !question.is_sent);
        for question in waiting {
            let asked = match &question.message {
                ClientMessage::Query(queries) => self.session.query(queries.clone()).map(drop),
                _ => self.session.inspect(),
            };
            match asked {
                Ok(()) => question.is_sent = true,
                Err(Misuse::NotNow) => return,
                Err(misuse) => {
                    tracing::error!(scene = %self.scene, %misuse, "a question that no client may ask");
                    question.from = None;
                }
            }
        }
        (self.questions).retain(|question| question.is_sent || question.from.is_some());
    }

    /// The scene's time at a moment: a tick, and nanoseconds since it.
    pub(crate) fn time(&self, now: Instant) -> (Tick, u64) {
        let newest = self
            .subscriber()
            .map_or(Tick::ZERO, Subscriber::watermark_tick);
        let (Some((at, tick, since)), Some(config)) = (self.clock, self.config) else {
            return (newest, 0);
        };
        if config.stepping == Stepping::Lockstep {
            return (tick.max(newest), 0);
        }
        let step = config.integrator.rate.step_ns();
        let elapsed = now.since(at).as_nanos() + since.as_nanos();
        (Tick::new(tick.value() + elapsed / step), elapsed % step)
    }

    /// The start of a snapshot and its scene events, for a member with these indices; `None` unless it is settled.
    pub(crate) fn snapshot(&mut self, granted: IdRange) -> Option<Snapshot<'_>> {
        if !self.is_settled() {
            return None;
        }
        let (replica, config) = (self.session.replica()?, self.config?);
        let stream = replica.stream();
        let start = StreamStart {
            stream: stream.stream(),
            tolerance: stream.tolerance(),
            integrator: config.integrator,
            publish_interval: config.publish_schedule.publish_interval,
            largest_packet: stream.largest_packet(),
            gravity: replica.gravity(),
            tick: stream.watermark_tick(),
            next: stream.next_number(),
            scene_events: stream.scene_events(),
        };
        let joined = Joined {
            choice: replica.choice(),
            config,
            start,
            granted,
            extensions: Extensions::NONE,
        };
        let of = (start.tick, start.next, start.scene_events);
        let rest = match self.snapshot.take().filter(|(known, _)| *known == of) {
            Some((_, rest)) => rest,
            None => self.encoded_bodies(replica),
        };
        self.snapshot = Some((of, rest.clone()));
        Some(Snapshot {
            joined,
            shapes: &self.shapes,
            rest,
        })
    }

    /// The standing contacts and sensors, in the order of events.
    pub(crate) fn standing(&self) -> Vec<BodyEvent> {
        self.standing.events().collect()
    }

    /// Pairs that stand and that it does not know.
    pub(crate) const fn untold(&self) -> u64 {
        self.standing.untold()
    }

    /// The newest tick whose events it has handed on.
    pub(crate) const fn events_tick(&self) -> Tick {
        self.events_tick
    }

    /// Asks up to which tick there is nothing more to say: a tick tells the next part of what stands.
    pub(crate) fn ask_watermark(&mut self, now: Instant) {
        if self.asks_at.is_none_or(|at| at > now + ASKS_EVERY) {
            self.session.query_watermark(now, Span::ZERO);
            self.asks_at = Some(now + ASKS_EVERY);
        }
    }

    /// Another connection to the owner broke: this one may be broken, too. It serves no snapshot before the owner answers.
    pub(crate) fn doubt(&mut self, now: Instant) {
        self.is_doubtful = true;
        self.session.query_watermark(now, Span::ZERO);
    }

    /// Takes a loss report of a member, to be answered by [`Self::answer_reports`].
    pub(crate) fn handle_report(&mut self, from: Peer, report: LossReport) {
        self.reports.insert(from, report);
    }

    /// Forgets a member that left or starts again.
    pub(crate) fn forget(&mut self, peer: Peer) {
        self.reports.remove(&peer);
        self.replies.forget(peer.0);
    }

    /// Answers the loss reports while the tracks are settled: datagrams for each member, and the members that need a
    /// snapshot, since they lack packets from before the edge's own, or know of some that the stream does not have: late
    /// datagrams of the stream that had its name before the owner started again.
    pub(crate) fn answer_reports(&mut self, now: Instant) -> (Vec<(Peer, Bytes)>, Vec<Peer>) {
        let (mut answers, mut astray) = (Vec::new(), Vec::new());
        if self.reports.is_empty() || !self.is_settled() {
            return (answers, astray);
        }
        let Some(replica) = self.session.replica() else {
            return (answers, astray);
        };
        let stream = replica.stream();
        let (next, scene_events) = (stream.next_number(), stream.scene_events());
        for (peer, report) in std::mem::take(&mut self.reports) {
            if !self.replies.allow_report(now, peer.0) {
                continue;
            }
            let lost: Vec<u64> = report.lost.iter().map(|lost| lost.expand(next)).collect();
            let is_ahead = report.next.expand(next) > next;
            if is_ahead || lost.iter().any(|number| !stream.relays(*number)) {
                astray.push(peer);
                continue;
            }
            let to = Recipient {
                id: peer.0,
                round_trip: Span::ZERO,
            };
            let mut datagrams = Vec::new();
            let encode = |number| stream.refresh(number);
            (self.replies).refresh(now, to, (lost, scene_events), encode, &mut datagrams);
            datagrams.push(stream.watermark());
            answers.extend(datagrams.into_iter().map(|datagram| (peer, datagram)));
        }
        (answers, astray)
    }

    fn subscriber(&self) -> Option<&Subscriber> {
        self.session.replica().map(Replica::stream)
    }

    /// Hands on a message, and keeps what snapshots need of it.
    fn take(&mut self, now: Instant, message: ServerMessage, bytes: Vec<u8>) {
        match message {
            ServerMessage::Welcome(welcome) => self.config = welcome.scene,
            ServerMessage::Joined(joined) => {
                self.config = Some(joined.config);
                self.granted = joined.granted;
                self.filling = true;
                self.shapes.clear();
                self.inertias.clear();
                self.silences.clear();
                // The scene may have gone back.
                self.events_tick = Tick::ZERO;
                self.is_repeated = std::mem::replace(&mut self.knows_standing, true);
                if !self.is_repeated {
                    self.standing.clear();
                }
            }
            ServerMessage::SnapshotEnd => {
                self.filling = false;
                if self.is_repeated {
                    self.reports.clear();
                    self.forwards.push_back(Forward::Replaced);
                }
            }
            ServerMessage::SceneEvent(event) => {
                let bytes = Bytes::from(bytes);
                self.note_event(&event, &bytes);
                if !self.filling {
                    self.forwards.push_back(Forward::Control(bytes));
                }
            }
            ServerMessage::TickEvents(events) => {
                self.standing.note(&events);
                self.events_tick = self.events_tick.max(events.tick);
                let bytes = Bytes::from(bytes);
                self.forwards.push_back(Forward::Events(events, bytes));
            }
            ServerMessage::Pong {
                sent,
                tick,
                since_tick_ns,
            } => {
                let half = Span::from_nanos(now.since(sent).as_nanos() / 2);
                self.clock = Some((sent + half, tick, Span::from_nanos(since_tick_ns)));
            }
            mut answer @ (ServerMessage::QueryResult(_) | ServerMessage::Inspection(_)) => {
                let Some(question) = self.questions.pop_front() else {
                    return;
                };
                if let ServerMessage::QueryResult(result) = &mut answer {
                    result.number = question.number;
                }
                if let Some(peer) = question.from {
                    let answer = Box::new(answer);
                    self.forwards.push_back(Forward::Answer(peer, answer));
                }
            }
            ServerMessage::Deleted => {
                self.config = None;
                (self.knows_standing, self.was_whole) = (false, false);
                // A later join asks anew.
                self.denied = Some(Denial::NoSuchScene);
                self.forwards.push_back(Forward::Deleted);
            }
            _ => {}
        }
    }

    /// Keeps what a snapshot needs of a scene event.
    fn note_event(&mut self, event: &SceneEvent, bytes: &Bytes) {
        match event {
            SceneEvent::ShapeAdded { id, .. } => {
                self.shapes.insert(*id, bytes.clone());
            }
            SceneEvent::ShapeRemoved { id } => {
                self.shapes.remove(id);
            }
            SceneEvent::BodyPlaced { desc, inertia, .. } => {
                match inertia {
                    Some(inertia) => self.inertias.insert(desc.id, *inertia),
                    None => self.inertias.remove(&desc.id),
                };
            }
            SceneEvent::BodyRemoved { id, .. } => {
                self.inertias.remove(id);
                for (_, bodies) in &mut self.silences {
                    bodies.retain(|body| body != id);
                }
            }
            SceneEvent::SceneRestored { .. } => {
                self.standing.clear();
                self.forwards.push_back(Forward::Retold);
            }
            SceneEvent::PublisherSilent { since, bodies } => {
                self.silences.push((*since, bodies.clone()));
            }
            SceneEvent::PublisherActive { bodies: active, .. } => {
                for (_, bodies) in &mut self.silences {
                    bodies.retain(|body| !active.contains(body));
                }
            }
            _ => {}
        }
        self.silences.retain(|(_, bodies)| !bodies.is_empty());
    }

    /// Acts on what the session reports: joins after the welcome, and notes a refusal.
    fn drain_events(&mut self, now: Instant) {
        while let Some(event) = self.session.poll_event() {
            let acted = match event {
                Event::Welcomed(_) => self.session.join(self.choice),
                Event::Joined(_) => {
                    self.attempts = 0;
                    self.send_questions();
                    if std::mem::replace(&mut self.was_whole, true) {
                        self.forwards.push_back(Forward::Renewed);
                    }
                    self.session.set_tier_policy(TierPolicy::Never)
                }
                Event::Denied(denial) => {
                    tracing::warn!(scene = %self.scene, %denial, "the owner refuses an edge");
                    self.denied = Some(denial);
                    self.retry_at = now + RETRY;
                    if denial == Denial::NoSuchScene && std::mem::take(&mut self.was_whole) {
                        self.forwards.push_back(Forward::Deleted);
                    }
                    Ok(())
                }
                Event::Ended(_) => {
                    self.has_closed = true;
                    Ok(())
                }
                _ => Ok(()),
            };
            if let Err(misuse) = acted {
                tracing::error!(scene = %self.scene, %misuse, "an edge cannot join");
            }
        }
    }

    /// The snapshot behind its shapes (PROTOCOL 4.8-1).
    fn encoded_bodies(&self, replica: &Replica) -> Bytes {
        let mut bytes = Vec::new();
        let mut add = |event| ServerMessage::SceneEvent(event).encode(&mut bytes);
        let stream = replica.stream();
        let changes: Vec<_> = stream.gravity_changes().collect();
        if changes.len() > 1 {
            for (since, gravity) in changes {
                add(SceneEvent::GravityChanged { since, gravity });
            }
        }
        for (id, track) in stream.tracks() {
            if let Some(desc) = replica.body(id) {
                add(SceneEvent::BodyPlaced {
                    desc,
                    inertia: self.inertias.get(&id).copied(),
                    track,
                    alias: stream.alias_of(id),
                });
            }
        }
        for (id, joint) in replica.joints().iter() {
            let joint = *joint;
            add(SceneEvent::JointAdded { id, joint });
        }
        for (since, bodies) in &self.silences {
            let (since, bodies) = (*since, bodies.clone());
            add(SceneEvent::PublisherSilent { since, bodies });
        }
        ServerMessage::SnapshotEnd.encode(&mut bytes);
        Bytes::from(bytes)
    }
}

/// A snapshot of a mirror.
pub(crate) struct Snapshot<'a> {
    pub(crate) joined: Joined,
    pub(crate) shapes: &'a BTreeMap<ShapeId, Bytes>,
    pub(crate) rest: Bytes,
}
