//! An edge's membership of one stream: what it holds, and what it sends.
//!
//! Reads what the owner sends twice: the session keeps the tracks, and the messages and packets themselves are handed on. Knows
//! no members of the edge but as numbers. Invariant: a snapshot is made only while the tracks are settled, so that it equals the
//! owner's at that tick.

use std::collections::{BTreeMap, VecDeque};

use bytes::Bytes;
use rhumb_protocol::limits::{EVENTS_PER_TICK_MAX, STANDING_PAIRS_MAX};
use rhumb_protocol::message::{
    ClientMessage, Denial, Extensions, Frames, Joined, SceneEvent, ServerMessage, StreamChoice,
    TickEvents, TierPolicy, Token, frame,
};
use rhumb_protocol::packet::{Datagram, LossReport, PacketKind, StreamId};
use rhumb_protocol::scene::{BodyEvent, IdRange, SceneConfig, SceneName, ShapeId, Stepping};
use rhumb_protocol::session::{ClientSession, Event, Replica};
use rhumb_protocol::stream::{Recipient, RefreshReplies, StreamStart, Subscriber};
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit, Wake};
use rhumb_reckoning::{BodyId, Inertia, Tick};

/// The peer number of the owner in a session.
const OWNER: Peer = Peer(0);

/// What a mirror hands on to the members of its stream.
#[derive(Debug)]
pub(crate) enum Forward {
    /// Control bytes for all members that it serves.
    Control(Bytes),
    /// A datagram of the stream, as it came.
    Packet(Bytes),
    /// The answer to a member's question.
    Answer(Peer, Box<ServerMessage>),
    /// The scene was deleted.
    Deleted,
    /// What members have is out of date: a new snapshot came over another connection.
    Renewed,
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
    /// Since when no member needs it.
    pub(crate) unused_since: Option<Instant>,
    /// The owner's refusal of the last attempt.
    pub(crate) denied: Option<Denial>,
    session: ClientSession,
    frames: Frames,
    filling: bool,
    /// True once a snapshot has been complete over any connection.
    was_whole: bool,
    config: Option<SceneConfig>,
    granted: IdRange,
    shapes: BTreeMap<ShapeId, Bytes>,
    inertias: BTreeMap<BodyId, Inertia>,
    silences: Vec<(Tick, Vec<BodyId>)>,
    standing: Standing,
    /// The newest statement of the scene's time: a moment, a tick, the time since it.
    clock: Option<(Instant, Tick, Span)>,
    replies: RefreshReplies,
    /// Loss reports that wait until the tracks are settled.
    reports: BTreeMap<Peer, LossReport>,
    /// The last snapshot, and the tick, number and scene events of which it is.
    snapshot: Option<((Tick, u64, u64), Bytes)>,
    /// Members whose questions the owner has not answered, oldest first.
    askers: VecDeque<Peer>,
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
            unused_since: None,
            denied: None,
            frames: Frames::new(),
            filling: false,
            was_whole: false,
            config: None,
            granted: IdRange::EMPTY,
            shapes: BTreeMap::new(),
            inertias: BTreeMap::new(),
            silences: Vec::new(),
            standing: Standing::default(),
            clock: None,
            replies: RefreshReplies::default(),
            reports: BTreeMap::new(),
            snapshot: None,
            askers: VecDeque::new(),
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
        self.filling = false;
        self.clock = None;
        self.askers.clear();
        self.reports.clear();
    }

    pub(crate) fn handle_opened(&mut self, now: Instant) {
        self.session.handle_opened(now, OWNER);
    }

    /// Control bytes of the owner.
    pub(crate) fn handle_control(&mut self, now: Instant, bytes: &[u8]) {
        self.frames.push(bytes);
        // The session reads the same bytes and closes the connection if they are malformed.
        while let Ok(Some(framed)) = self.frames.next_frame() {
            let mut message = Vec::new();
            frame(framed.kind, &framed.body, &mut message);
            self.session.handle_control(now, OWNER, &message);
            if let Ok(Some(decoded)) = ServerMessage::decode(&framed) {
                self.take(now, decoded, message);
            }
            self.drain_events();
        }
        self.replies.begin_tick();
    }

    /// A datagram of the owner, or of a fan-out.
    pub(crate) fn handle_datagram(&mut self, now: Instant, bytes: Bytes) {
        let Ok(datagram) = Datagram::open(&bytes) else {
            return;
        };
        self.session.handle_datagram(now, OWNER, &bytes);
        self.replies.begin_tick();
        if let Some(replica) = self.session.replica_mut() {
            // No view shows the past of an edge.
            let stream = replica.stream_mut();
            stream.forget_before(stream.watermark_tick());
        }
        if datagram.head().kind != PacketKind::LossReport
            && Some(datagram.head().stream) == self.stream()
        {
            self.forwards.push_back(Forward::Packet(bytes));
        }
    }

    /// The connection has ended.
    pub(crate) fn handle_ended(&mut self, now: Instant, ending: Ending) {
        self.session.handle_ended(now, OWNER, ending);
        self.link = None;
        self.reports.clear();
    }

    pub(crate) fn handle_timeout(&mut self, now: Instant) {
        self.session.handle_timeout(now);
    }

    pub(crate) fn poll_transmit(&mut self) -> Option<Transmit> {
        self.session.poll_transmit()
    }

    pub(crate) fn poll_timeout(&self) -> Option<Wake> {
        self.link.and_then(|_| self.session.poll_timeout())
    }

    pub(crate) fn poll_forward(&mut self) -> Option<Forward> {
        self.forwards.pop_front()
    }

    /// Leaves the scene.
    pub(crate) fn close(&mut self) {
        self.session.close(rhumb_protocol::session::CloseCode::DONE);
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

    /// True while it has a connection with a complete copy.
    pub(crate) fn is_live(&self) -> bool {
        self.link.is_some() && !self.filling && self.subscriber().is_some()
    }

    /// True if a snapshot can be made now.
    pub(crate) fn is_settled(&self) -> bool {
        self.is_live() && self.subscriber().is_some_and(Subscriber::is_settled)
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

    /// Joins once more, if the owner has denied that.
    pub(crate) fn join_again(&mut self) {
        if self.link.is_some() && self.denied.take().is_some() {
            let asked = self.session.join(self.choice);
            debug_assert!(asked.is_ok(), "a denied client is in the lobby");
        }
    }

    /// Asks the owner something that any member may ask. Answers come in the order of questions.
    pub(crate) fn ask(&mut self, peer: Peer, message: &ClientMessage) {
        let asked = match message {
            ClientMessage::Inspect => self.session.inspect(),
            ClientMessage::Query(queries) => self.session.query(queries.clone()).map(drop),
            _ => return,
        };
        if asked.is_ok() {
            self.askers.push_back(peer);
        }
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

    /// What stands, for a new member.
    pub(crate) fn standing(&self) -> Option<TickEvents> {
        let tick = self.subscriber()?.watermark_tick();
        self.standing.events(tick)
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

    /// Answers the loss reports while the tracks are settled: datagrams for each member, and the members that need a snapshot,
    /// since they lack packets from before the edge's own.
    pub(crate) fn answer_reports(&mut self, now: Instant) -> (Vec<(Peer, Bytes)>, Vec<Peer>) {
        let (mut answers, mut too_old) = (Vec::new(), Vec::new());
        if self.reports.is_empty() || !self.is_settled() {
            return (answers, too_old);
        }
        let Some(replica) = self.session.replica() else {
            return (answers, too_old);
        };
        let stream = replica.stream();
        let (next, scene_events) = (stream.next_number(), stream.scene_events());
        for (peer, report) in std::mem::take(&mut self.reports) {
            if !self.replies.allow_report(now, peer.0) {
                continue;
            }
            let lost = report.lost.iter().map(|lost| lost.expand(next));
            let lost: Vec<u64> = lost.filter(|number| *number < next).collect();
            if lost.iter().any(|number| !stream.relays(*number)) {
                too_old.push(peer);
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
        (answers, too_old)
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
                self.standing = Standing::default();
            }
            ServerMessage::SnapshotEnd => self.filling = false,
            ServerMessage::SceneEvent(event) => {
                let bytes = Bytes::from(bytes);
                self.note_event(&event, &bytes);
                if !self.filling {
                    self.forwards.push_back(Forward::Control(bytes));
                }
            }
            ServerMessage::TickEvents(events) => {
                self.standing.handle(&events);
                self.forwards
                    .push_back(Forward::Control(Bytes::from(bytes)));
            }
            ServerMessage::Pong {
                sent,
                tick,
                since_tick_ns,
            } => {
                let half = Span::from_nanos(now.since(sent).as_nanos() / 2);
                self.clock = Some((sent + half, tick, Span::from_nanos(since_tick_ns)));
            }
            answer @ (ServerMessage::QueryResult(_) | ServerMessage::Inspection(_)) => {
                if let Some(peer) = self.askers.pop_front() {
                    self.forwards
                        .push_back(Forward::Answer(peer, Box::new(answer)));
                }
            }
            ServerMessage::Deleted => {
                self.config = None;
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
                self.standing.remove(*id);
                for (_, bodies) in &mut self.silences {
                    bodies.retain(|body| body != id);
                }
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
    fn drain_events(&mut self) {
        while let Some(event) = self.session.poll_event() {
            let acted = match event {
                Event::Welcomed(_) => self.session.join(self.choice),
                Event::Joined(_) => {
                    if std::mem::replace(&mut self.was_whole, true) {
                        self.forwards.push_back(Forward::Renewed);
                    }
                    self.session.set_tier_policy(TierPolicy::Never)
                }
                Event::Denied(denial) => {
                    tracing::warn!(scene = %self.scene, %denial, "the owner refuses an edge");
                    self.denied = Some(denial);
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

/// What stands between bodies, for members that join (PROTOCOL 4.15-11): the pairs in contact and the bodies in sensors, each with
/// the event in which it began.
///
/// Invariant: a pair is kept from its beginning to its end, or until one of its bodies has left the scene.
#[derive(Debug, Default)]
struct Standing {
    pairs: BTreeMap<(u8, BodyId, BodyId), BodyEvent>,
}

impl Standing {
    /// Takes the events of a tick.
    fn handle(&mut self, events: &TickEvents) {
        for event in &events.events {
            match *event {
                BodyEvent::ContactBegan { body, contact } => {
                    self.insert((0, body, contact.with), *event);
                }
                BodyEvent::ContactEnded { body, with } => {
                    self.pairs.remove(&(0, body, with));
                }
                BodyEvent::SensorEntered { sensor, body } => {
                    self.insert((1, sensor, body), *event);
                }
                BodyEvent::SensorLeft { sensor, body } => {
                    self.pairs.remove(&(1, sensor, body));
                }
                _ => {}
            }
        }
    }

    /// Forgets the pairs of a body that has left.
    fn remove(&mut self, id: BodyId) {
        self.pairs
            .retain(|(_, first, second), _| *first != id && *second != id);
    }

    /// What stands, as the events of a tick; `None` if nothing does. A tick has one message, and what finds no place in it is left
    /// out.
    fn events(&self, tick: Tick) -> Option<TickEvents> {
        let events = self.pairs.values().take(EVENTS_PER_TICK_MAX);
        let events: Vec<_> = events.copied().collect();
        (!events.is_empty()).then_some(TickEvents {
            tick,
            missed: 0,
            events,
        })
    }

    fn insert(&mut self, pair: (u8, BodyId, BodyId), event: BodyEvent) {
        if self.pairs.len() < STANDING_PAIRS_MAX {
            self.pairs.insert(pair, event);
        }
    }
}
