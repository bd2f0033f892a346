//! A member's session that is told by hand what a server says.
//!
//! Plays no server: it says what it is given, sound or not, at one moment.

use rhumb_protocol::message::{
    ClientMessage, Extensions, Frames, Joined, Notice, ServerMessage, StreamChoice, VERSIONS,
    Welcome,
};
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::{IdRange, SceneTerms};
use rhumb_protocol::session::ClientSession;
use rhumb_protocol::stream::StreamStart;
use rhumb_protocol::{Endpoint, Instant, Peer, Transmit};
use rhumb_reckoning::Tick;

/// The session, and what it said.
#[derive(Debug)]
pub struct Told {
    /// What is told.
    pub session: ClientSession,
    heard: Frames,
}

impl Told {
    /// Who tells.
    pub const SERVER: Peer = Peer(0);

    /// A session that is welcome and has asked to join.
    ///
    /// # Panics
    ///
    /// When a session refuses to join a scene to which it is welcome.
    #[must_use]
    pub fn welcomed(choice: StreamChoice) -> Self {
        let session = ClientSession::new("told".parse().expect("a short word is a scene's name"));
        let heard = Frames::new();
        let mut told = Self { session, heard };
        told.session.handle_opened(Instant::ZERO, Self::SERVER);
        let welcome = Welcome {
            version: VERSIONS[0],
            scene: None,
            extensions: Extensions::NONE,
        };
        told.tell(&[ServerMessage::Welcome(welcome)]);
        told.session.join(choice).expect("it is welcome");
        told
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
    pub fn tell_snapshot(
        &mut self,
        terms: &SceneTerms,
        choice: StreamChoice,
        (stream, tick): (StreamId, Tick),
        notices: &[Notice],
    ) {
        let start = StreamStart {
            stream,
            tolerance: choice.tolerance(),
            integrator: terms.integrator,
            every: terms.cadence.every,
            gravity: terms.gravity,
            tick,
            next: 0,
            notices: 0,
        };
        let joined = Joined {
            choice,
            terms: *terms,
            start,
            granted: IdRange::EMPTY,
            extensions: Extensions::NONE,
        };
        self.tell(&[ServerMessage::Joined(joined)]);
        for notice in notices {
            self.tell(&[ServerMessage::Notice(notice.clone())]);
        }
        self.tell(&[ServerMessage::SnapshotEnd]);
    }

    /// What it said since the last look.
    ///
    /// # Panics
    ///
    /// When that is no message of a client.
    pub fn said(&mut self) -> Vec<ClientMessage> {
        while let Some(transmit) = self.session.poll_transmit() {
            if let Transmit::Control { bytes, .. } = transmit {
                self.heard.push(&bytes);
            }
        }
        let mut said = Vec::new();
        while let Some(framed) = self.heard.next_frame().expect("a session says messages") {
            let message = ClientMessage::decode(&framed).expect("a session says what is known");
            said.extend(message);
        }
        said
    }
}
