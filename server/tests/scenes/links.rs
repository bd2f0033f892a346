//! A router of scenes without sockets, and the links of its clients.
//!
//! A link takes bytes when a test says so, as a driver reports what real links take.

use std::collections::BTreeMap;

use rhumb_protocol::message::{
    ClientMessage, Denial, Extensions, Frames, RemovalCause, SceneEvent, ServerMessage,
    StreamChoice, VERSIONS,
};
use rhumb_protocol::scene::{CommandError, IdRange, SceneConfig, Stepping};
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit};
use rhumb_reckoning::{Tick, Tolerance};
use rhumb_scene::{Limits, SceneRouter, SceneSettings};

/// A router of scenes, and the links of its connections.
pub(crate) struct Links {
    pub(crate) server: SceneRouter,
    pub(crate) now: Instant,
    pub(crate) links: BTreeMap<Peer, Link>,
}

/// The data that a client has received, and those that it could not send yet.
#[derive(Default)]
pub(crate) struct Link {
    pub(crate) frames: Frames,
    /// Bytes to the server that it did not want yet.
    pub(crate) unsent: Vec<u8>,
    /// Bytes handed over that the link has not taken.
    pub(crate) waiting: usize,
    pub(crate) counts: Counts,
}

/// Messages of each kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Counts {
    pub(crate) joined: usize,
    pub(crate) left: usize,
    pub(crate) snapshots: usize,
    pub(crate) inspections: usize,
    /// Tick and bodies of the newest inspection.
    pub(crate) inspected: Option<(Tick, u32)>,
    pub(crate) pongs: usize,
    pub(crate) bodies: usize,
    pub(crate) denied: usize,
    pub(crate) denial: Option<Denial>,
    /// True if the newest session was known.
    pub(crate) resumed: Option<bool>,
    /// The newest range of indices.
    pub(crate) granted: Option<IdRange>,
    pub(crate) not_finite: usize,
    pub(crate) refused: Option<CommandError>,
    pub(crate) closed: Option<u32>,
}

impl Links {
    pub(crate) fn new() -> Self {
        Self::with(SceneSettings::new(|| Instant::ZERO))
    }

    pub(crate) fn with_limits(limits: Limits) -> Self {
        Self::with(SceneSettings {
            limits,
            ..SceneSettings::new(|| Instant::ZERO)
        })
    }

    pub(crate) fn with(settings: SceneSettings) -> Self {
        Self {
            server: SceneRouter::new(settings),
            now: Instant::ZERO,
            links: BTreeMap::new(),
        }
    }

    pub(crate) fn connect(&mut self, peer: Peer) {
        self.connect_to(peer, "attacked");
    }

    pub(crate) fn connect_to(&mut self, peer: Peer, scene: &str) {
        self.links.insert(peer, Link::default());
        self.server.handle_opened(self.now, peer);
        self.server.handle_control_taken(self.now, peer, 0);
        self.send(
            peer,
            &[ClientMessage::Hello {
                versions: VERSIONS.to_vec(),
                scene: scene.parse().expect("a good name"),
                extensions: Extensions::NONE,
            }],
        );
    }

    /// Sends messages in one read, as far as the server wants them; the rest follows when it does.
    pub(crate) fn send(&mut self, peer: Peer, messages: &[ClientMessage]) {
        let link = self.links.get_mut(&peer).expect("a connection");
        for message in messages {
            message.encode(&mut link.unsent);
        }
        self.send_rest(peer);
    }

    pub(crate) fn send_rest(&mut self, peer: Peer) {
        let link = self.links.get_mut(&peer).expect("a connection");
        let mut sent = 0;
        while sent < link.unsent.len() && self.server.wants_control(peer) {
            let end = link.unsent.len().min(sent + (64 << 10));
            self.server
                .handle_control(self.now, peer, &link.unsent[sent..end]);
            sent = end;
        }
        link.unsent.drain(..sent);
        self.collect();
    }

    pub(crate) fn unsent(&self, peer: Peer) -> usize {
        self.links[&peer].unsent.len()
    }

    /// Takes what the server transmits into the links.
    pub(crate) fn collect(&mut self) {
        while let Some(transmit) = self.server.poll_transmit() {
            match transmit {
                Transmit::Control { to, bytes } => {
                    let link = self.links.get_mut(&to).expect("a connection");
                    link.waiting += bytes.len();
                    link.frames.push(&bytes);
                    link.read();
                }
                Transmit::Close { to, code } => {
                    let link = self.links.get_mut(&to).expect("a connection");
                    link.counts.closed = Some(code);
                    self.server.handle_ended(self.now, to, Ending::Closed(code));
                }
                Transmit::State { .. } => {}
            }
        }
    }

    /// The link of a client takes so many of its waiting bytes.
    pub(crate) fn take(&mut self, peer: Peer, most: usize) {
        let link = self.links.get_mut(&peer).expect("a connection");
        let taken = link.waiting.min(most);
        link.waiting -= taken;
        self.server.handle_control_taken(self.now, peer, taken);
        self.collect();
    }

    /// Lets a moment pass, with what is due.
    pub(crate) fn pass(&mut self, span: Span) {
        self.now = self.now + span;
        for _ in 0..1_000 {
            if self
                .server
                .poll_timeout()
                .is_none_or(|wake| wake.at > self.now)
            {
                break;
            }
            self.server.handle_timeout(self.now);
        }
        self.collect();
        let peers: Vec<_> = self.links.keys().copied().collect();
        for peer in peers {
            self.send_rest(peer);
        }
    }

    pub(crate) fn counts(&self, peer: Peer) -> Counts {
        self.links[&peer].counts
    }

    /// Connects a client that creates the scene, and joins it.
    pub(crate) fn begin(&mut self, peer: Peer, stepping: Stepping) {
        self.connect(peer);
        self.send(peer, &[create(stepping), join()]);
        self.take(peer, usize::MAX);
    }
}

impl Link {
    pub(crate) fn read(&mut self) {
        while let Some(framed) = self.frames.next_frame().expect("whole messages") {
            let counts = &mut self.counts;
            match ServerMessage::decode(&framed).expect("the server follows the protocol") {
                Some(ServerMessage::Joined(joined)) => {
                    counts.joined += 1;
                    counts.granted = Some(joined.granted);
                }
                Some(ServerMessage::Reserved(range)) => counts.granted = Some(range),
                Some(ServerMessage::Session(state)) => counts.resumed = Some(state.resumed),
                Some(ServerMessage::Refused { error, .. }) => counts.refused = Some(error),
                Some(ServerMessage::Left) => counts.left += 1,
                Some(ServerMessage::SnapshotEnd) => counts.snapshots += 1,
                Some(ServerMessage::Inspection(inspection)) => {
                    counts.inspections += 1;
                    counts.inspected = Some((inspection.tick, inspection.bodies));
                }
                Some(ServerMessage::Pong { .. }) => counts.pongs += 1,
                Some(ServerMessage::Denied(denial)) => {
                    counts.denied += 1;
                    counts.denial = Some(denial);
                }
                Some(ServerMessage::SceneEvent(event)) => match event {
                    SceneEvent::BodyPlaced { .. } => counts.bodies += 1,
                    SceneEvent::BodyRemoved { cause, .. } => {
                        counts.not_finite += usize::from(cause == RemovalCause::NotFinite);
                    }
                    _ => {}
                },
                _ => {}
            }
        }
    }
}

pub(crate) fn create(stepping: Stepping) -> ClientMessage {
    let config = SceneConfig::default();
    ClientMessage::Create(SceneConfig { stepping, ..config })
}

pub(crate) fn join() -> ClientMessage {
    ClientMessage::Join(StreamChoice::Within(Tolerance::NORMAL))
}
