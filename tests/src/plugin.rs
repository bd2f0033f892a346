//! OpenSimulator's plug-in as it was recorded, and what a host answers it.
//!
//! The recordings in `data/app/` are every byte that the unmodified plug-in wrote on TCP in a session; its one datagram is
//! a copy of its first message. `PluginTalk` plays them to a host without sockets and keeps what comes back, message by
//! message, after checking that none of it would hurt the plug-in.

use std::net::SocketAddr;

use rhumb_app::{Frames, Kind, Message};
use rhumb_protocol::{Instant, Peer};
use rhumb_server::Host;
use rhumb_transport::{AppEndpoint, AppTransmit};

/// What the plug-in said in one session.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Every byte that it wrote on TCP.
    pub bytes: Vec<u8>,
    /// The same, cut into messages.
    pub messages: Vec<Message>,
    /// Where each begins in the bytes, and the end.
    borders: Vec<usize>,
}

/// Bytes of the datagram that the plug-in sends: its logon.
const LOGON_BYTES: usize = 76;

impl Recording {
    /// Unpacks a recording.
    ///
    /// # Panics
    ///
    /// When it is none.
    #[must_use]
    pub fn unpack(packed: &[u8]) -> Self {
        let bytes = zstd::decode_all(packed).expect("a recording of this repository");
        let mut frames = Frames::default();
        let (mut messages, mut borders) = (Vec::new(), vec![0]);
        let mut fed = 0;
        while fed < bytes.len() {
            // Byte by byte through a header, then its body at once: a border is where a message comes out.
            let next = (fed + 4).min(bytes.len());
            frames.push(&bytes[fed..next]);
            fed = next;
            while let Some(framed) = frames.next_message().expect("the plug-in says messages") {
                messages.push(framed.message);
                borders.push(fed);
            }
        }
        assert_eq!(borders.last(), Some(&bytes.len()), "no byte is left over");
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

    /// How often it says something.
    #[must_use]
    pub fn count(&self, kind: Kind) -> usize {
        self.messages.iter().filter(|m| m.kind() == kind).count()
    }
}

/// A session with a host.
#[derive(Debug)]
pub struct PluginTalk {
    peer: Peer,
    from: SocketAddr,
    /// What came on TCP.
    pub lasting: Vec<Message>,
    /// What came by datagram.
    pub passing: Vec<Message>,
    /// Whether the host closed the connection.
    pub closed: bool,
    frames: Frames,
}

/// What the published plug-in takes in one read, and what fits a segment.
const PIECE_BYTES_MAX: usize = 1_400;

impl PluginTalk {
    /// Connects, and logs on by datagram as the plug-in does.
    pub fn begin(host: &mut Host, number: u16, logon: &[u8]) -> Self {
        let from = SocketAddr::from(([127, 0, 0, 1], 40_000 + number));
        let udp = SocketAddr::from(([127, 0, 0, 1], 50_000 + number));
        let peer = Peer(1 << 63 | u64::from(number));
        host.handle_app_datagram(Instant::ZERO, udp, logon);
        host.handle_app_opened(Instant::ZERO, peer, from);
        Self {
            peer,
            from: udp,
            lasting: Vec::new(),
            passing: Vec::new(),
            closed: false,
            frames: Frames::default(),
        }
    }

    /// Says bytes, and hears what the host answers to anybody.
    pub fn say(&mut self, host: &mut Host, bytes: &[u8]) {
        host.handle_app_bytes(Instant::ZERO, self.peer, bytes);
        let mut others = [];
        hear(host, self, &mut others);
    }

    /// The connection is gone.
    pub fn end(&self, host: &mut Host) {
        host.handle_app_ended(Instant::ZERO, self.peer);
    }

    /// The last state of each actor, from either transport, in order of hearing within each.
    #[must_use]
    pub fn last_states(&self) -> std::collections::BTreeMap<u32, rhumb_app::Motion> {
        let mut last = std::collections::BTreeMap::new();
        for message in self.passing.iter().chain(&self.lasting) {
            if let Message::SetDynamicActor(motion) = message {
                last.insert(motion.actor.object, *motion);
            }
        }
        last
    }

    /// How often it heard something.
    #[must_use]
    pub fn heard(&self, kind: Kind) -> usize {
        let all = self.lasting.iter().chain(&self.passing);
        all.filter(|message| message.kind() == kind).count()
    }

    fn take(&mut self, transmit: &AppTransmit) {
        match transmit {
            AppTransmit::Bytes { bytes, .. } => {
                assert!(bytes.len() <= PIECE_BYTES_MAX, "a read may cut it");
                self.frames.push(bytes);
                while let Some(framed) = self.frames.next_message().expect("messages") {
                    self.lasting.push(framed.message);
                }
                let whole = self.frames.next_message();
                assert_eq!(whole, Ok(None));
            }
            AppTransmit::Datagram { bytes, .. } => {
                let message = Message::from_datagram(bytes).expect("a message");
                let mut again = Vec::new();
                let index = u32::from_be_bytes(bytes[4..8].try_into().expect("four bytes"));
                message.encode(index, &mut again);
                assert_eq!(&again[..], &bytes[..], "one message in a datagram");
                self.passing.push(message);
            }
            AppTransmit::Close { .. } => self.closed = true,
        }
    }
}

/// Hands what a host has to say to those whom it concerns.
///
/// # Panics
///
/// When it concerns nobody here.
pub fn hear(host: &mut Host, first: &mut PluginTalk, others: &mut [&mut PluginTalk]) {
    while let Some(transmit) = host.poll_app() {
        let concerns = |talk: &PluginTalk| match &transmit {
            AppTransmit::Bytes { to, .. } | AppTransmit::Close { to } => *to == talk.peer,
            AppTransmit::Datagram { to, .. } => *to == talk.from,
        };
        if concerns(first) {
            first.take(&transmit);
            continue;
        }
        let other = others.iter_mut().find(|talk| concerns(talk));
        other
            .unwrap_or_else(|| panic!("{transmit:?} is for nobody"))
            .take(&transmit);
    }
}
