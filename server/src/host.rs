//! A server without sockets: connections on one side, scenes on the other.
//!
//! Routes each request to the scene that its connection is about. The real driver and the pretend network drive it
//! alike. It reads no clock but the stopwatch it is given, and that only to measure.

use std::collections::BTreeMap;

use rhumb_protocol::limits::SCENES_MAX;
use rhumb_protocol::message::{Denial, Grease, ServerMessage};
use rhumb_protocol::packet::{Doubt, Echo, Head, Kind};
use rhumb_protocol::scene::{SceneName, SceneTerms};
use rhumb_protocol::session::{Request, ServerSession};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_protocol::{Ending, Endpoint, Instant, LinkReport, Peer, Transmit, Wake, WakeReason};

use crate::app::{AppOptions, Guests};
use crate::drives::DriveStatistics;
use crate::engine::Workers;
use crate::hook::Hooks;
use crate::outbox::Outbox;
use crate::room::Room;
use crate::scene::Scene;
use crate::stream_names::StreamNames;

/// What a connection is about, and whether its client is a member.
#[derive(Debug)]
struct Connection {
    scene: Option<SceneName>,
    member: bool,
}

/// All scenes of one server process and all connections to them.
pub struct Host {
    pub(crate) rooms: BTreeMap<SceneName, Room>,
    connections: BTreeMap<Peer, Connection>,
    pub(crate) out: Outbox,
    pub(crate) guests: Guests,
    scenes_begun: u32,
    hooks: Option<Hooks>,
    workers: Workers,
    pub(crate) stopwatch: Box<dyn Fn() -> Instant + Send>,
}

impl Host {
    /// A server without scenes. `stopwatch` measures the stages of a tick; it need not be the clock of the driver.
    pub fn new(stopwatch: impl Fn() -> Instant + Send + 'static) -> Self {
        Self {
            rooms: BTreeMap::new(),
            connections: BTreeMap::new(),
            out: Outbox::default(),
            guests: Guests::default(),
            scenes_begun: 0,
            hooks: None,
            workers: Workers::default(),
            stopwatch: Box::new(stopwatch),
        }
    }

    /// Gives scenes that are created from now on their hooks.
    pub fn attach(&mut self, hooks: Hooks) {
        self.hooks = Some(hooks);
    }

    /// Speaks so to clients of the paper's protocol.
    pub fn configure_app(&mut self, options: AppOptions) {
        self.guests.configure(options);
    }

    /// Has scenes that are created from now on stepped by these threads.
    pub fn employ(&mut self, workers: Workers) {
        self.workers = workers;
    }

    /// Names of the scenes that exist.
    pub fn scenes(&self) -> impl Iterator<Item = &SceneName> {
        self.rooms.keys()
    }

    /// How the bodies of a scene are doing that members drive.
    pub fn drives(&self, scene: &SceneName) -> impl Iterator<Item = DriveStatistics> {
        let room = self.rooms.get(scene).into_iter();
        room.flat_map(Room::drive_statistics)
    }

    fn handle_request(&mut self, now: Instant, peer: Peer, request: Request) {
        let Some(connection) = self.connections.get_mut(&peer) else {
            return;
        };
        let Some(name) = connection.scene.clone() else {
            if let Request::Hello { scene } = request {
                let terms = self.rooms.get(&scene).map(|room| *room.terms());
                connection.scene = Some(scene);
                if let Some(session) = self.out.session(peer) {
                    session.welcome(terms);
                }
            }
            return;
        };
        match request {
            Request::Create(terms) => {
                let answer = match self.create(&name, terms) {
                    Ok(()) => ServerMessage::Created,
                    Err(denial) => ServerMessage::Denied(denial),
                };
                self.out.say(peer, &answer);
            }
            Request::Join(choice) => {
                let joined = match self.rooms.get_mut(&name) {
                    Some(room) => room.join(now, peer, choice, &mut self.out),
                    None => Err(Denial::NoSuchScene),
                };
                match joined {
                    Ok(()) => self.note_member(peer),
                    Err(denial) => self.out.say(peer, &ServerMessage::Denied(denial)),
                }
            }
            Request::Delete => self.delete(peer, &name),
            Request::Follow(choice) => {
                if let Some(room) = self.rooms.get_mut(&name) {
                    room.follow(peer, choice);
                }
            }
            Request::Drive(drive) => {
                if let Some(room) = self.rooms.get_mut(&name) {
                    room.drive(peer, drive, &mut self.out);
                }
            }
            request => self.handle_scene_request(now, peer, &name, request),
        }
    }

    /// What a member asks of its scene, and the time, which anybody may ask.
    fn handle_scene_request(
        &mut self,
        now: Instant,
        peer: Peer,
        name: &SceneName,
        request: Request,
    ) {
        let out = &mut self.out;
        let Some(room) = self.rooms.get_mut(name) else {
            if let Request::Ping(sent) = request {
                let (tick, since_tick_ns) = (rhumb_reckoning::Tick::ZERO, 0);
                let pong = ServerMessage::Pong {
                    sent,
                    tick,
                    since_tick_ns,
                };
                out.say(peer, &pong);
            } else {
                out.say(peer, &ServerMessage::Denied(Denial::NoSuchScene));
            }
            return;
        };
        // Answers come in the order of what they answer; what was commanded before is answered when it is settled.
        if matches!(
            request,
            Request::Leave | Request::Reserve(_) | Request::Ping(_) | Request::Inspect
        ) {
            room.settle(out);
        }
        match request {
            Request::Leave => {
                room.leave(peer);
                out.say(peer, &ServerMessage::Left);
                if let Some(connection) = self.connections.get_mut(&peer) {
                    connection.member = false;
                }
            }
            Request::Reserve(count) => room.reserve(peer, count, out),
            Request::Command { number, command } => room.command(peer, number, command, out),
            Request::Advance(to) => room.advance(peer, to, out),
            Request::Resync => room.resync(peer),
            Request::Followed(stream) => room.followed(peer, stream),
            Request::Moves(moves) => room.allow(peer, moves),
            Request::Upstream(packet) => room.upstream(peer, packet, out),
            Request::Ping(sent) => room.pong(now, peer, sent, out),
            Request::Inspect => room.inspect(peer, out),
            Request::Hello { .. }
            | Request::Create(_)
            | Request::Join(_)
            | Request::Follow(_)
            | Request::Drive(_)
            | Request::Delete => {}
        }
    }

    fn note_member(&mut self, peer: Peer) {
        if let Some(connection) = self.connections.get_mut(&peer) {
            connection.member = true;
        }
    }

    pub(crate) fn create(&mut self, name: &SceneName, terms: SceneTerms) -> Result<(), Denial> {
        if self.rooms.contains_key(name) {
            return Err(Denial::SceneExists);
        }
        if self.rooms.len() >= SCENES_MAX {
            return Err(Denial::TooManyScenes);
        }
        let mut scene = Scene::on(terms, &self.workers).map_err(Denial::Terms)?;
        if let Some(hook) = self.hooks.as_mut().and_then(|hooks| hooks.of(name, &terms)) {
            scene.attach(hook);
        }
        let names = StreamNames::of_scene(self.scenes_begun);
        self.scenes_begun = self.scenes_begun.wrapping_add(1);
        self.rooms.insert(name.clone(), Room::new(scene, names));
        tracing::info!(scene = %name, "scene created");
        Ok(())
    }

    fn delete(&mut self, peer: Peer, name: &SceneName) {
        if self.rooms.get(name).is_some_and(Room::is_led) {
            let denial = ServerMessage::Denied(Denial::Led);
            return self.out.say(peer, &denial);
        }
        if !self.rooms.contains_key(name) {
            let denial = ServerMessage::Denied(Denial::NoSuchScene);
            return self.out.say(peer, &denial);
        }
        let connection = self.connections.get(&peer);
        let asked_by_member = connection.is_some_and(|connection| connection.member);
        self.end_scene(name);
        if !asked_by_member {
            self.out.say(peer, &ServerMessage::Deleted);
        }
    }

    /// A scene is gone; its members hear it.
    pub(crate) fn end_scene(&mut self, name: &SceneName) {
        let Some(room) = self.rooms.remove(name) else {
            return;
        };
        for member in room.members() {
            if let Some(connection) = self.connections.get_mut(&member) {
                connection.member = false;
            }
        }
        room.end(&mut self.out);
        tracing::info!(scene = %name, "scene deleted");
    }

    /// The room of which a peer is a member.
    fn room_of(&mut self, peer: Peer) -> Option<&mut Room> {
        let connection = self.connections.get(&peer)?;
        let name = connection.scene.as_ref().filter(|_| connection.member)?;
        self.rooms.get_mut(name)
    }

    fn leave(&mut self, peer: Peer) {
        if let Some(room) = self.room_of(peer) {
            room.leave(peer);
        }
    }
}

impl Endpoint for Host {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        let connection = Connection {
            scene: None,
            member: false,
        };
        self.connections.insert(peer, connection);
        // Any number does that is seldom twice the same.
        let seed = now.as_nanos() ^ peer.0.rotate_left(48);
        self.out.open(peer, Grease::new(seed));
    }

    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        if let Some(session) = self.out.session(from) {
            session.handle_control(bytes);
        }
        while let Some(request) = self.out.session(from).and_then(ServerSession::poll_request) {
            self.handle_request(now, from, request);
        }
        let broken = self
            .out
            .session(from)
            .and_then(|session| session.poll_close());
        if let Some(code) = broken {
            tracing::warn!(peer = from.0, %code, "closing a connection that broke the protocol");
            self.leave(from);
            self.connections.remove(&from);
        }
        let out = &mut self.out;
        let name = self
            .connections
            .get(&from)
            .and_then(|connection| connection.scene.as_ref());
        if let Some(room) = name.and_then(|name| self.rooms.get_mut(name)) {
            room.settle(out);
        }
    }

    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        let mut reader = Reader::new(bytes);
        let Ok(head) = Head::decode(&mut reader) else {
            return;
        };
        let Some(connection) = self.connections.get(&from).filter(|c| c.member) else {
            return;
        };
        let room = connection
            .scene
            .as_ref()
            .and_then(|name| self.rooms.get_mut(name));
        let Some(room) = room else {
            return;
        };
        // What is no word of a member, or not of the protocol, is dropped.
        match head.kind {
            Kind::Echo => {
                if let Ok(echo) = Echo::decode(reader) {
                    room.echo(now, from, head.stream, &echo, &mut self.out);
                }
            }
            Kind::Doubt => {
                if let Ok(doubt) = Doubt::decode(reader) {
                    room.doubt(now, from, head.stream, doubt, &mut self.out);
                }
            }
            // What the source of a stream says, of the stream of what it drives.
            _ => room.upstream_datagram(from, bytes, &mut self.out),
        }
    }

    fn handle_link(&mut self, now: Instant, peer: Peer, report: &LinkReport) {
        let Some(connection) = self.connections.get(&peer).filter(|c| c.member) else {
            return;
        };
        let name = connection.scene.as_ref();
        if let Some(room) = name.and_then(|name| self.rooms.get_mut(name)) {
            room.hear_of_link(now, peer, report, &mut self.out);
        }
    }

    fn handle_ended(&mut self, _now: Instant, peer: Peer, ending: Ending) {
        tracing::debug!(peer = peer.0, ?ending, "connection ended");
        self.leave(peer);
        self.connections.remove(&peer);
        self.out.forget(peer);
    }

    fn handle_timeout(&mut self, now: Instant) {
        for room in self.rooms.values_mut() {
            room.handle_timeout(now, &self.stopwatch, &mut self.out);
        }
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        self.out.poll()
    }

    fn poll_timeout(&self) -> Option<Wake> {
        let at = self.rooms.values().filter_map(Room::next_step).min()?;
        let reason = WakeReason::Tick;
        Some(Wake { at, reason })
    }
}
