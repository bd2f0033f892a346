//! Recordings of OpenSimulator's plug-in, played to a server without sockets.
//!
//! The recordings in `data/app/` are all bytes that the unmodified plug-in wrote on TCP in a session; its one datagram
//! is a copy of its first message. `PluginSession` plays them to a router of scenes and keeps the answers, message by
//! message, after checking that none would break the plug-in.

use std::collections::BTreeMap;
use std::net::SocketAddr;

use glam::{Quat, Vec3};
use rhumb_app::{
    AppDatagram, AppOptions, AppServer, AppTransmit, AttachShape, CreateDynamicActor, Id, Kind,
    Logon, Message, MessageFraming, Motion, SetWorld, Surface,
};
use rhumb_protocol::{Instant, Peer};
use rhumb_scene::{SceneRouter, SceneSettings};
use rhumb_server::AppScenes;

/// The messages of the plug-in in one session.
#[derive(Clone, Debug)]
pub struct Recording {
    /// All bytes that it wrote on TCP.
    pub bytes: Vec<u8>,
    /// The same, split into messages.
    pub messages: Vec<Message>,
    /// Start of each message in the bytes, and the end.
    borders: Vec<usize>,
}

/// Length of the datagram that the plug-in sends: its logon.
const LOGON_BYTES: usize = 76;

impl Recording {
    /// Unpacks a recording.
    ///
    /// # Panics
    ///
    /// When it is not a valid recording.
    #[must_use]
    pub fn unpack(packed: &[u8]) -> Self {
        let bytes = zstd::decode_all(packed).expect("a valid recording");
        let mut frames = MessageFraming::default();
        let (mut messages, mut borders) = (Vec::new(), vec![0]);
        let mut fed = 0;
        while fed < bytes.len() {
            // Up to the header byte by byte, then the body at once: a message comes out exactly at its end.
            let next = (fed + 4).min(bytes.len());
            frames.push(&bytes[fed..next]);
            fed = next;
            while let Some(framed) = frames
                .next_message()
                .expect("the plug-in sends whole messages")
            {
                messages.push(framed.message);
                borders.push(fed);
            }
        }
        assert_eq!(
            borders.last(),
            Some(&bytes.len()),
            "the recording ends with a whole message"
        );
        Self {
            bytes,
            messages,
            borders,
        }
    }

    /// The datagram of the session.
    #[must_use]
    pub fn datagram(&self) -> &[u8] {
        &self.bytes[..LOGON_BYTES]
    }

    /// The bytes of each message.
    pub fn pieces(&self) -> impl Iterator<Item = &[u8]> {
        let ends = self.borders.windows(2);
        ends.map(|ends| &self.bytes[ends[0]..ends[1]])
    }

    /// The number of messages of this kind.
    #[must_use]
    pub fn count(&self, kind: Kind) -> usize {
        self.messages.iter().filter(|m| m.kind() == kind).count()
    }
}

/// A server with its APP clients, without sockets.
pub struct PluginServer {
    /// The scenes.
    pub router: SceneRouter,
    clients: AppServer,
}

impl PluginServer {
    /// A server without scenes.
    #[must_use]
    pub fn new(options: AppOptions) -> Self {
        Self::with(options, SceneSettings::new(|| Instant::ZERO))
    }

    /// A server without scenes, with these settings of scenes.
    #[must_use]
    pub fn with(options: AppOptions, settings: SceneSettings) -> Self {
        Self {
            router: SceneRouter::new(settings),
            clients: AppServer::new(options),
        }
    }
}

/// A session with a server.
#[derive(Debug)]
pub struct PluginSession {
    peer: Peer,
    from: SocketAddr,
    /// Messages received on TCP.
    pub tcp_messages: Vec<Message>,
    /// Messages received by datagram.
    pub datagram_messages: Vec<Message>,
    /// Every received state in order of arrival, from both transports, with the number of its frame; the first is 1.
    pub states: Vec<(usize, Motion)>,
    /// Number of bytes queued on its TCP connection, as passed to the server with every event.
    pub waiting_bytes: usize,
    /// Number of bytes received on TCP.
    pub stream_bytes: usize,
    /// True if the server closed the connection.
    pub closed: bool,
    /// Number of finished frames, plus one.
    frame: usize,
    frames: MessageFraming,
}

/// The most that the published plug-in accepts in one read; it also fits into one TCP segment.
const PIECE_BYTES_MAX: usize = 1_400;

impl PluginSession {
    /// Connects, and sends the logon by datagram as the plug-in does.
    pub fn begin(server: &mut PluginServer, number: u16, logon: &[u8]) -> Self {
        let from = SocketAddr::from(([127, 0, 0, 1], 40_000 + number));
        let udp = SocketAddr::from(([127, 0, 0, 1], 50_000 + number));
        let peer = Peer(1 << 63 | u64::from(number));
        server.clients.handle_datagram(udp, logon);
        server.clients.handle_opened(peer, from);
        Self {
            peer,
            from: udp,
            tcp_messages: Vec::new(),
            datagram_messages: Vec::new(),
            states: Vec::new(),
            waiting_bytes: 0,
            stream_bytes: 0,
            frame: 1,
            closed: false,
            frames: MessageFraming::default(),
        }
    }

    /// Sends bytes, and receives the server's answers.
    pub fn send(&mut self, server: &mut PluginServer, bytes: &[u8]) {
        let mut scenes = AppScenes(&mut server.router);
        (server.clients).handle_bytes(&mut scenes, self.peer, bytes, self.waiting_bytes);
        let mut others = [];
        deliver(server, self, &mut others);
    }

    /// Ends the connection.
    pub fn end(&self, server: &mut PluginServer) {
        let mut scenes = AppScenes(&mut server.router);
        server.clients.handle_ended(&mut scenes, self.peer);
    }

    /// The last state of each actor, from either transport.
    #[must_use]
    pub fn last_states(&self) -> BTreeMap<u32, Motion> {
        let states = self.states.iter();
        states
            .map(|(_, state)| (state.actor.object, *state))
            .collect()
    }

    /// The states of one actor by frame; the last one of each frame.
    #[must_use]
    pub fn track(&self, object: u32) -> BTreeMap<usize, Motion> {
        let states = self.states.iter();
        let its = states.filter(|(_, state)| state.actor.object == object);
        its.copied().collect()
    }

    /// The number of received messages of this kind.
    #[must_use]
    pub fn received(&self, kind: Kind) -> usize {
        let all = self.tcp_messages.iter().chain(&self.datagram_messages);
        all.filter(|message| message.kind() == kind).count()
    }

    fn take(&mut self, transmit: &AppTransmit) {
        match transmit {
            AppTransmit::Bytes { bytes, .. } => {
                assert!(
                    bytes.len() <= PIECE_BYTES_MAX,
                    "a longer write would be split by the plug-in's read"
                );
                self.stream_bytes += bytes.len();
                self.frames.push(bytes);
                while let Some(framed) = self.frames.next_message().expect("messages") {
                    self.note(&framed.message);
                    self.tcp_messages.push(framed.message);
                }
                let whole = self.frames.next_message();
                assert_eq!(whole, Ok(None));
            }
            AppTransmit::Datagram(AppDatagram { bytes, .. }) => {
                let message = Message::from_datagram(bytes).expect("a valid message");
                let mut again = Vec::new();
                let index = u32::from_be_bytes(bytes[4..8].try_into().expect("four bytes"));
                message.encode(index, &mut again);
                assert_eq!(&again[..], &bytes[..], "a datagram contains one message");
                self.note(&message);
                self.datagram_messages.push(message);
            }
            AppTransmit::Close { .. } => self.closed = true,
        }
    }

    fn note(&mut self, message: &Message) {
        match message {
            Message::SetDynamicActor(state) => self.states.push((self.frame, *state)),
            Message::TimeAdvanced(_) => self.frame += 1,
            _ => {}
        }
    }
}

/// Delivers the server's transmits to the sessions that they are addressed to.
///
/// # Panics
///
/// When a transmit is addressed to another peer.
pub fn deliver(
    server: &mut PluginServer,
    first: &mut PluginSession,
    others: &mut [&mut PluginSession],
) {
    while let Some(transmit) = server.clients.poll_transmit() {
        let concerns = |session: &PluginSession| match &transmit {
            AppTransmit::Bytes { to, .. } | AppTransmit::Close { to } => *to == session.peer,
            AppTransmit::Datagram(datagram) => datagram.to == session.from,
        };
        if concerns(first) {
            first.take(&transmit);
            continue;
        }
        let other = others.iter_mut().find(|session| concerns(session));
        other
            .unwrap_or_else(|| panic!("{transmit:?} has no receiver"))
            .take(&transmit);
    }
}

/// The message that defines a world with gravity along z, above a plane at this height, m.
#[must_use]
pub fn plugin_world(simulation: u32, height: f32) -> Message {
    Message::SetWorld(SetWorld {
        plane: Id {
            simulation,
            object: 0,
        },
        gravity: Vec3::new(0.0, 0.0, -10.0),
        static_friction: 0.5,
        kinetic_friction: 0.5,
        restitution: 0.0,
        margin: 0.0,
        height,
        normal: Vec3::Z,
    })
}

/// The messages of a client whose balls fall forever without contacts, before its first frame.
#[must_use]
pub fn falling(simulation: u32, balls: u32) -> Vec<u8> {
    let id = |object| Id { simulation, object };
    let mut bytes = Vec::new();
    let mut send = |message: &Message| message.encode(0, &mut bytes);
    send(&Message::Logon(Logon::new(simulation, "falling")));
    // So deep that the balls never reach it.
    send(&plugin_world(simulation, -1e5));
    send(&Message::AddSphere((id(100), Vec3::ZERO, 0.5)));
    for ball in 0..balls {
        let actor = id(1_000 + ball);
        let place = Vec3::new((ball % 32) as f32, (ball / 32) as f32, 0.0);
        let motion = Motion {
            actor,
            position: place * 3.0,
            rotation: Quat::IDENTITY,
            gravity_modifier: 1.0,
            linear: Vec3::ZERO,
            angular: Vec3::ZERO,
        };
        send(&Message::CreateDynamicActor(CreateDynamicActor {
            motion,
            flags: 0,
        }));
        send(&Message::AttachShape(AttachShape {
            actor,
            shape: id(100),
            surface: Surface {
                density: 1_000.0,
                static_friction: 0.5,
                kinetic_friction: 0.5,
                restitution: 0.0,
            },
            rotation: Quat::IDENTITY,
            position: Vec3::ZERO,
        }));
    }
    bytes
}
