//! Recordings of OpenSimulator's plug-in, played to a gateway without sockets.
//!
//! The recordings in `data/app/` are all bytes that the unmodified plug-in wrote on TCP in a session; its one datagram
//! is a copy of its first message. `PluginSession` plays them to a gateway beside a server in this process, which steps
//! on this thread, and keeps the answers, message by message, after checking that none would break the plug-in.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;

use glam::{Quat, Vec3};
use rhumb_app::{
    AppClient, AppDatagram, AppOptions, AppTransmit, AttachShape, CreateDynamicActor, Gateway, Id,
    Kind, Logon, Message, MessageFraming, Motion, SetWorld, Surface,
};
use rhumb_client::{Client, JoinMode, JoinOptions, LocalServer, OpenError};
use rhumb_protocol::Instant;
use rhumb_protocol::message::Denial;
use rhumb_scene::{Permit, SceneRouter, SceneSettings};

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

/// A server in this process, and a gateway of APP clients to it, without sockets.
pub struct PluginServer {
    server: LocalServer,
    gateway: Arc<Gateway>,
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
        let router = SceneRouter::new(settings).admitting(Permit::GATEWAY);
        let server = LocalServer::of(router);
        let connections = server.clone();
        let gateway = Gateway::new(options, move || Ok(connections.connect()));
        Self { server, gateway }
    }

    /// Joins the scene of a simulation as another client does.
    ///
    /// # Errors
    ///
    /// [`OpenError`] if there is no such scene.
    pub fn join(&self, simulation: u32) -> Result<Client, OpenError> {
        let options = JoinOptions {
            mode: JoinMode::Join,
            ..JoinOptions::default()
        };
        let connection = self.server.connect();
        connection.join_with(&format!("app/{simulation}"), options)
    }

    /// True if a simulation has a scene.
    ///
    /// # Panics
    ///
    /// When its scene cannot be joined.
    #[must_use]
    pub fn has_scene(&self, simulation: u32) -> bool {
        match self.join(simulation) {
            Ok(_) => true,
            Err(OpenError::Denied {
                denial: Denial::NoSuchScene,
                ..
            }) => false,
            Err(other) => panic!("{other}"),
        }
    }
}

/// A session with a server.
pub struct PluginSession {
    client: Option<AppClient>,
    udp: SocketAddr,
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
    /// 64-bit FNV-1a of all received bytes in order, those of TCP and of datagrams.
    pub digest: u64,
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
        server.gateway.handle_datagram(udp, logon);
        Self {
            client: Some(AppClient::new(&server.gateway, u64::from(number), from)),
            udp,
            tcp_messages: Vec::new(),
            datagram_messages: Vec::new(),
            states: Vec::new(),
            waiting_bytes: 0,
            stream_bytes: 0,
            digest: 0xcbf2_9ce4_8422_2325,
            frame: 1,
            closed: false,
            frames: MessageFraming::default(),
        }
    }

    /// Sends bytes, and receives the answers.
    pub fn send(&mut self, _: &mut PluginServer, bytes: &[u8]) {
        let Some(client) = &mut self.client else {
            return;
        };
        client.handle_bytes(bytes, self.waiting_bytes);
        self.receive();
    }

    /// Passes time without sending, and receives what comes.
    pub fn wait(&mut self) {
        if let Some(client) = &mut self.client {
            client.handle_silence();
        }
        self.receive();
    }

    fn receive(&mut self) {
        while let Some(transmit) = self.client.as_mut().and_then(AppClient::poll_transmit) {
            self.take(&transmit);
        }
    }

    /// Ends the connection.
    pub fn end(&mut self, _: &mut PluginServer) {
        self.client = None;
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
        if let AppTransmit::Bytes(bytes) | AppTransmit::Datagram(AppDatagram { bytes, .. }) =
            transmit
        {
            for byte in bytes {
                self.digest = (self.digest ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
            }
        }
        match transmit {
            AppTransmit::Bytes(bytes) => {
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
            AppTransmit::Datagram(AppDatagram { to, bytes, .. }) => {
                assert_eq!(*to, self.udp, "a datagram for another client");
                let message = Message::from_datagram(bytes).expect("a valid message");
                let mut again = Vec::new();
                let index = u32::from_be_bytes(bytes[4..8].try_into().expect("four bytes"));
                message.encode(index, &mut again);
                assert_eq!(&again[..], &bytes[..], "a datagram contains one message");
                self.note(&message);
                self.datagram_messages.push(message);
            }
            AppTransmit::Close => self.closed = true,
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
    falling_apart(simulation, balls, 3.0)
}

/// The same with a distance between the balls, m; at 0 all are in one place.
#[must_use]
pub fn falling_apart(simulation: u32, balls: u32, distance: f32) -> Vec<u8> {
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
            position: place * distance,
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
