//! A member's session that is reported by hand what a server says.
//!
//! Plays no server: it says what it is given, sound or not, at one moment.

use rhumb_protocol::message::{
    ClientMessage, Extensions, Frames, Joined, SceneEvent, ServerMessage, StreamChoice, VERSIONS,
    Welcome,
};
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::{IdRange, SceneConfig};
use rhumb_protocol::session::ClientSession;
use rhumb_protocol::stream::StreamStart;
use rhumb_protocol::{Endpoint, Instant, Peer, Transmit};
use rhumb_reckoning::Tick;

/// The session, and what it sent.
#[derive(Debug)]
pub struct ScriptedSession {
    /// What is reported.
    pub session: ClientSession,
    heard: Frames,
}

impl ScriptedSession {
    /// Who tells.
    pub const SERVER: Peer = Peer(0);

    /// A session that is welcome and has asked to join.
    ///
    /// # Panics
    ///
    /// When a session refuses to join a scene to which it is welcome.
    #[must_use]
    pub fn welcomed(choice: StreamChoice) -> Self {
        let session =
            ClientSession::new("reported".parse().expect("a short word is a scene's name"));
        let heard = Frames::new();
        let mut reported = Self { session, heard };
        reported.session.handle_opened(Instant::ZERO, Self::SERVER);
        let welcome = Welcome {
            version: VERSIONS[0],
            scene: None,
            extensions: Extensions::NONE,
        };
        reported.tell(&[ServerMessage::Welcome(welcome)]);
        reported.session.join(choice).expect("it is welcome");
        reported
    }

    /// Says messages.
    pub fn tell(&mut self, messages: &[ServerMessage]) {
        let mut bytes = Vec::new();
        for message in messages {
            message.encode(&mut bytes);
        }
        let now = Instant::ZERO;
        self.session.handle_control(now, Self::SERVER, &bytes);
    }

    /// Says the whole of a scene, as a stream has it at a tick.
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
        self.tell(&[ServerMessage::Joined(joined)]);
        for scene_event in scene_events {
            self.tell(&[ServerMessage::SceneEvent(scene_event.clone())]);
        }
        self.tell(&[ServerMessage::SnapshotEnd]);
    }

    /// What it sent since the last look.
    ///
    /// # Panics
    ///
    /// When that is no message of a client.
    pub fn sent(&mut self) -> Vec<ClientMessage> {
        while let Some(transmit) = self.session.poll_transmit() {
            if let Transmit::Control { bytes, .. } = transmit {
                self.heard.push(&bytes);
            }
        }
        let mut sent = Vec::new();
        while let Some(framed) = self.heard.next_frame().expect("a session says messages") {
            let message = ClientMessage::decode(&framed).expect("a session says what is known");
            sent.extend(message);
        }
        sent
    }
}
