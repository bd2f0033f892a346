//! Servers that break one promise each.

use std::collections::{BTreeMap, VecDeque};
use std::net::SocketAddr;
use std::thread::{self, JoinHandle};

use bytes::Bytes;
use rhumb_protocol::limits::FRICTION_MAX;
use rhumb_protocol::message::{ClientMessage, Framed, Frames, SceneEvent, ServerMessage, frame};
use rhumb_protocol::packet::{Checksums, FullPacket, Head, PacketKind, RepairSymbol, UpdateWriter};
use rhumb_protocol::scene::{BodyEvent, SceneConfig};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit, Wake};
use rhumb_reckoning::BodyState;
use rhumb_scene::{SceneRouter, SceneSettings};
use rhumb_transport::{Certificate, Fingerprint, QuicServer, ServerOptions, Stop};

use super::packets::{updates_of, without_rests, written};
use crate::peer::datagram;

/// Control bytes that a queue without bound hands over at a time.
const WINDOW_BYTES: usize = 256 << 10;

/// The promise that is broken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServerMutant {
    /// Accepts any offered version.
    AnyVersion,
    /// Closes with the code that follows the correct one.
    WrongCode,
    /// Ignores an unknown critical message.
    CriticalPasses,
    /// Ends the connection at an unknown optional message.
    OptionalRefused,
    /// Ends the connection at an unknown command.
    CommandRefused,
    /// Treats NaN as zero.
    NanTaken,
    /// Never sends a refresh.
    RefreshIgnored,
    /// Numbers packets one too high.
    OffByOne,
    /// Never sends a watermark.
    NeverSendsWatermark,
    /// Sends no rest updates.
    RestLost,
    /// Sends no updates for bodies that leave their tolerance.
    ToleranceIgnored,
    /// Computes checksums wrongly.
    ChecksumsWrong,
    /// Computes repair symbols wrongly.
    RepairSymbolWrong,
    /// Steps one tick more than requested.
    StepsTooFar,
    /// Sends no scene event for a changed gravity.
    GravityNotSent,
    /// Sends no refusals of commands.
    RefusalsNotSent,
    /// Leaves joints out of the snapshot of a late joiner.
    JointsNotSent,
    /// Never tells that a character reaches the ground.
    GroundNotSent,
    /// Answers a ping with another number.
    PongWrong,
    /// Steps with the next higher friction value: like another engine whose results are close but not equal.
    FrictionOff,
    /// Changes one bit of each speed on full streams.
    SpeedsOff,
    /// Queues without bound what a client does not read.
    QueuesWithoutBound,
}

impl ServerMutant {
    /// Serves on a free port of loopback.
    ///
    /// # Panics
    ///
    /// When the machine has no free port.
    #[must_use]
    pub fn serve(self) -> MutantServer {
        let certificate = Certificate::development(["localhost", "127.0.0.1"]);
        let server = QuicServer::bind(ServerOptions::new(
            SocketAddr::from(([127, 0, 0, 1], 0)),
            certificate.expect("making a certificate"),
        ));
        let server = server.expect("listening on loopback");
        let (address, fingerprint) = (server.local_addr(), server.fingerprint());
        let stop = Stop::new();
        let stop_requested = stop.clone();
        let thread = thread::spawn(move || {
            let mut endpoint = MutantEndpoint {
                mutant: self,
                inner: SceneRouter::new(SceneSettings::new(|| Instant::ZERO)),
                connections: BTreeMap::new(),
            };
            // If the server fails, its case is inconclusive, which the test of the mutants detects.
            let _ = server.run(&mut endpoint, &stop_requested);
        });
        MutantServer {
            address,
            fingerprint,
            stop,
            thread: Some(thread),
        }
    }
}

/// A running mutant; it stops on drop.
#[derive(Debug)]
pub struct MutantServer {
    /// Its address.
    pub address: SocketAddr,
    /// The fingerprint to pin.
    pub fingerprint: Fingerprint,
    stop: Stop,
    thread: Option<JoinHandle<()>>,
}

impl Drop for MutantServer {
    fn drop(&mut self) {
        self.stop.stop();
        if let Some(thread) = self.thread.take() {
            // A panic of this thread shows in its case.
            let _ = thread.join();
        }
    }
}

/// A correct server whose received and sent data is altered.
struct MutantEndpoint {
    mutant: ServerMutant,
    inner: SceneRouter,
    connections: BTreeMap<Peer, MutantConnection>,
}

/// The state of one connection.
#[derive(Default)]
struct MutantConnection {
    received: Frames,
    sent: Frames,
    is_in_snapshot: bool,
    /// The queue of a mutant that queues without bound, and its bytes in transit.
    queue: VecDeque<Bytes>,
    in_flight: usize,
}

impl Endpoint for MutantEndpoint {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        self.connections.insert(peer, MutantConnection::default());
        self.inner.handle_opened(now, peer);
    }

    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        let Some(connection) = self.connections.get_mut(&from) else {
            return;
        };
        connection.received.push(bytes);
        let mut received = Vec::new();
        loop {
            match connection.received.next_frame() {
                Ok(Some(framed)) => received.extend(received_as(self.mutant, framed)),
                Ok(None) => break,
                Err(_) => {
                    received.extend_from_slice(bytes);
                    break;
                }
            }
        }
        self.inner.handle_control(now, from, &received);
    }

    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.inner.handle_datagram(now, from, bytes);
    }

    fn handle_control_taken(&mut self, _: Instant, peer: Peer, bytes: usize) {
        // The server inside receives no report: its peer seems to take everything at once.
        if let Some(connection) = self.connections.get_mut(&peer) {
            connection.in_flight = connection.in_flight.saturating_sub(bytes);
        }
    }

    fn handle_ended(&mut self, now: Instant, peer: Peer, ending: Ending) {
        self.connections.remove(&peer);
        self.inner.handle_ended(now, peer, ending);
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.inner.handle_timeout(now);
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        loop {
            if let Some(transmit) = self.poll_queue() {
                return Some(transmit);
            }
            let sent = match self.inner.poll_transmit()? {
                Transmit::Control { to, bytes } => {
                    let connection = self.connections.get_mut(&to)?;
                    if self.mutant == ServerMutant::QueuesWithoutBound {
                        connection.queue.push_back(bytes);
                        continue;
                    }
                    let bytes = connection.sent_bytes_as(self.mutant, &bytes).into();
                    Some(Transmit::Control { to, bytes })
                }
                Transmit::State { to, bytes } => sent_as(self.mutant, &bytes).map(|bytes| {
                    let bytes = bytes.into();
                    Transmit::State { to, bytes }
                }),
                Transmit::Close { to, code } => {
                    let code = code + u32::from(self.mutant == ServerMutant::WrongCode);
                    Some(Transmit::Close { to, code })
                }
            };
            if sent.is_some() {
                return sent;
            }
        }
    }

    fn poll_timeout(&self) -> Option<Wake> {
        self.inner.poll_timeout()
    }
}

impl MutantEndpoint {
    /// Control bytes of a queue whose peer has room for them.
    fn poll_queue(&mut self) -> Option<Transmit> {
        let mut open = self.connections.iter_mut();
        let (peer, connection) = open.find(|(_, connection)| {
            connection.in_flight < WINDOW_BYTES && !connection.queue.is_empty()
        })?;
        let bytes = connection.queue.pop_front()?;
        connection.in_flight += bytes.len();
        Some(Transmit::Control { to: *peer, bytes })
    }
}

/// A received message as the mutant takes it.
fn received_as(mutant: ServerMutant, framed: Framed) -> Vec<u8> {
    let Framed { kind, mut body } = framed;
    let known = 0..=16;
    let mut received = Vec::new();
    let message = |kind, body: &[u8]| {
        let body = body.to_vec();
        ClientMessage::decode(&Framed { kind, body }).ok().flatten()
    };
    match mutant {
        ServerMutant::CriticalPasses if kind < 0x80 && !known.contains(&kind) => return received,
        ServerMutant::OptionalRefused if kind >= 0x80 => frame(0x7f, &body, &mut received),
        ServerMutant::CommandRefused if kind == COMMAND && body.first() >= Some(&0x80) => {
            frame(0x7f, &body, &mut received);
        }
        ServerMutant::NanTaken if kind == COMMAND => {
            let nan = f32::NAN.to_le_bytes();
            while let Some(at) = body.windows(4).position(|four| four == nan) {
                body[at..at + 4].fill(0);
            }
            frame(kind, &body, &mut received);
        }
        ServerMutant::FrictionOff => match message(kind, &body) {
            Some(ClientMessage::Create(config)) => {
                ClientMessage::Create(with_friction(config, f32::next_up)).encode(&mut received);
            }
            _ => frame(kind, &body, &mut received),
        },
        ServerMutant::AnyVersion | ServerMutant::StepsTooFar => match message(kind, &body) {
            Some(ClientMessage::Hello {
                scene, extensions, ..
            }) if mutant == ServerMutant::AnyVersion => {
                let versions = vec![1];
                let hello = ClientMessage::Hello {
                    versions,
                    scene,
                    extensions,
                };
                hello.encode(&mut received);
            }
            Some(ClientMessage::Advance { to }) if mutant == ServerMutant::StepsTooFar => {
                ClientMessage::Advance { to: to.next() }.encode(&mut received);
            }
            _ => frame(kind, &body, &mut received),
        },
        _ => frame(kind, &body, &mut received),
    }
    received
}

const COMMAND: u8 = 7;

/// The configuration with the next friction value above or below; unchanged at the ends of the range.
fn with_friction(mut config: SceneConfig, next: fn(f32) -> f32) -> SceneConfig {
    let friction = config.material.friction;
    if friction > 0.0 && friction < FRICTION_MAX {
        config.material.friction = next(friction);
    }
    config
}

const fn is_ground_reached(event: &BodyEvent) -> bool {
    matches!(event, BodyEvent::ReachedGround(_))
}

impl MutantConnection {
    /// The bytes that replace sent bytes of the control stream.
    fn sent_bytes_as(&mut self, mutant: ServerMutant, bytes: &Bytes) -> Vec<u8> {
        self.sent.push(bytes);
        let mut output = Vec::new();
        while let Ok(Some(framed)) = self.sent.next_frame() {
            let message = ServerMessage::decode(&framed).ok().flatten();
            match &message {
                Some(ServerMessage::Joined(_)) => self.is_in_snapshot = true,
                Some(ServerMessage::SnapshotEnd) => self.is_in_snapshot = false,
                _ => {}
            }
            match (mutant, message) {
                (ServerMutant::RefusalsNotSent, Some(ServerMessage::Refused { .. })) => {}
                (ServerMutant::GroundNotSent, Some(ServerMessage::TickEvents(events)))
                    if events.events.iter().any(is_ground_reached) => {}
                (
                    ServerMutant::JointsNotSent,
                    Some(ServerMessage::SceneEvent(SceneEvent::JointAdded { .. })),
                ) if self.is_in_snapshot => {}
                (
                    ServerMutant::GravityNotSent,
                    Some(ServerMessage::SceneEvent(SceneEvent::GravityChanged { .. })),
                ) => {
                    // An unknown scene event, so that the count of scene events stays correct.
                    frame(framed.kind, &[0x8a], &mut output);
                }
                (
                    ServerMutant::PongWrong,
                    Some(ServerMessage::Pong {
                        sent,
                        tick,
                        since_tick_ns,
                    }),
                ) => {
                    let sent = sent + Span::from_nanos(1);
                    let pong = ServerMessage::Pong {
                        sent,
                        tick,
                        since_tick_ns,
                    };
                    pong.encode(&mut output);
                }
                (ServerMutant::FrictionOff, Some(ServerMessage::Welcome(mut welcome))) => {
                    let config = welcome
                        .scene
                        .map(|config| with_friction(config, f32::next_down));
                    welcome.scene = config;
                    ServerMessage::Welcome(welcome).encode(&mut output);
                }
                _ => frame(framed.kind, &framed.body, &mut output),
            }
        }
        output
    }
}

/// The datagram that replaces a sent one.
fn sent_as(mutant: ServerMutant, bytes: &[u8]) -> Option<Vec<u8>> {
    let kind = datagram::kind(bytes);
    let otherwise = match (mutant, kind) {
        (ServerMutant::RefreshIgnored, Some(PacketKind::Refresh))
        | (ServerMutant::NeverSendsWatermark, Some(PacketKind::Watermark)) => return None,
        (ServerMutant::RestLost, _) => without_rests(bytes),
        (ServerMutant::ToleranceIgnored, _) => without_updates(bytes),
        (ServerMutant::OffByOne, _) => numbered_higher(bytes),
        (ServerMutant::SpeedsOff, Some(kind @ (PacketKind::Full | PacketKind::FullEnd))) => {
            other_speeds(bytes, kind)
        }
        (ServerMutant::ChecksumsWrong, Some(PacketKind::Checksums)) => other_sums(bytes),
        (ServerMutant::RepairSymbolWrong, Some(PacketKind::RepairSymbol)) => {
            other_repair_symbol(bytes)
        }
        _ => None,
    };
    Some(otherwise.unwrap_or_else(|| bytes.to_vec()))
}

/// The packet without its updates.
fn without_updates(bytes: &[u8]) -> Option<Vec<u8>> {
    let (head, packet, _) = updates_of(bytes)?;
    written(head, &packet, &[])
}

fn numbered_higher(bytes: &[u8]) -> Option<Vec<u8>> {
    let (head, packet, updates) = updates_of(bytes)?;
    let [number, tick, scene_events] =
        [packet.number, packet.tick, packet.scene_events].map(|low| u64::from(low.0));
    let mut writer = UpdateWriter::new(head.stream, number + 1, tick, scene_events);
    let fits = updates.iter().all(|update| writer.push(update));
    fits.then(|| writer.finish(packet.ends_tick))
}

fn other_speeds(bytes: &[u8], kind: PacketKind) -> Option<Vec<u8>> {
    let mut reader = Reader::new(bytes);
    let head = Head::decode(&mut reader).ok()?;
    let mut packet = FullPacket::decode(kind == PacketKind::FullEnd, reader).ok()?;
    for record in &mut packet.records {
        let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = record.motion.parts();
        // A zero speed stays: any other value would show the body as awake.
        let vy = if vy == 0.0 { vy } else { vy.next_up() };
        let (place, turn) = ([px, py, pz], [x, y, z, w]);
        record.motion = BodyState::new(place, turn, [vx, vy, vz], [wx, wy, wz]).ok()?;
    }
    Some(packet.encode(head.stream))
}

fn other_sums(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut reader = Reader::new(bytes);
    let head = Head::decode(&mut reader).ok()?;
    let mut checksums = Checksums::decode(reader).ok()?;
    checksums.sum ^= 1;
    Some(checksums.encode(head.stream))
}

fn other_repair_symbol(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut reader = Reader::new(bytes);
    let head = Head::decode(&mut reader).ok()?;
    let mut repair_symbol = RepairSymbol::decode(reader).ok()?;
    *repair_symbol.sums.first_mut()? ^= 0x11;
    Some(repair_symbol.encode(head.stream))
}
