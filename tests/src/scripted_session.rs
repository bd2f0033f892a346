//! A member's session that receives scripted server messages.
//!
//! It is not a server: it delivers any messages, valid or not, all at the same time.

use rhumb_protocol::message::{
    ClientMessage, Extensions, Frames, Joined, SceneEvent, ServerMessage, StreamChoice, VERSIONS,
    Welcome,
};
use rhumb_protocol::packet::{LargestPacket, StreamId};
use rhumb_protocol::scene::{IdRange, SceneConfig};
use rhumb_protocol::session::ClientSession;
use rhumb_protocol::stream::StreamStart;
use rhumb_protocol::{Endpoint, Instant, Peer, Transmit};
use rhumb_reckoning::Tick;

/// The session, and a decoder of what it sends.
#[derive(Debug)]
pub struct ScriptedSession {
    /// The session under test.
    pub session: ClientSession,
    frames: Frames,
}

impl ScriptedSession {
    /// The peer that the messages come from.
    pub const SERVER: Peer = Peer(0);

    /// A session that has received its welcome and has asked to join.
    ///
    /// # Panics
    ///
    /// When the session refuses to join after a welcome.
    #[must_use]
    pub fn welcomed(choice: StreamChoice) -> Self {
        let session = ClientSession::new("reported".parse().expect("a valid scene name"));
        let frames = Frames::new();
        let mut reported = Self { session, frames };
        reported.session.handle_opened(Instant::ZERO, Self::SERVER);
        let welcome = Welcome {
            version: VERSIONS[0],
            scene: None,
            extensions: Extensions::NONE,
        };
        reported.deliver(&[ServerMessage::Welcome(welcome)]);
        reported
            .session
            .join(choice)
            .expect("the session is in the lobby");
        reported
    }

    /// Delivers messages to the session.
    pub fn deliver(&mut self, messages: &[ServerMessage]) {
        let mut bytes = Vec::new();
        for message in messages {
            message.encode(&mut bytes);
        }
        let now = Instant::ZERO;
        self.session.handle_control(now, Self::SERVER, &bytes);
    }

    /// Delivers the snapshot of a scene as of a tick.
    pub fn send_snapshot(
        &mut self,
        config: &SceneConfig,
        choice: StreamChoice,
        (stream, tick): (StreamId, Tick),
        scene_events: &[SceneEvent],
    ) {
        let start = StreamStart {
            stream,
            tolerance: choice.tolerance(),
            integrator: config.integrator,
            publish_interval: config.publish_schedule.publish_interval,
            largest_packet: LargestPacket::DEFAULT,
            gravity: config.gravity,
            tick,
            next: 0,
            scene_events: 0,
        };
        let joined = Joined {
            choice,
            config: *config,
            start,
            granted: IdRange::EMPTY,
            extensions: Extensions::NONE,
        };
        self.deliver(&[ServerMessage::Joined(joined)]);
        for scene_event in scene_events {
            self.deliver(&[ServerMessage::SceneEvent(scene_event.clone())]);
        }
        self.deliver(&[ServerMessage::SnapshotEnd]);
    }

    /// The messages that the session sent since the last call.
    ///
    /// # Panics
    ///
    /// When the session sent anything else.
    pub fn sent(&mut self) -> Vec<ClientMessage> {
        while let Some(transmit) = self.session.poll_transmit() {
            if let Transmit::Control { bytes, .. } = transmit {
                self.frames.push(&bytes);
            }
        }
        let mut sent = Vec::new();
        while let Some(framed) = self
            .frames
            .next_frame()
            .expect("a session sends whole messages")
        {
            let message = ClientMessage::decode(&framed).expect("a session sends known messages");
            sent.extend(message);
        }
        sent
    }
}
