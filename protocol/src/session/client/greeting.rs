//! How a client opens a conversation, and what it makes of the answer.
//!
//! What a later version may send is borne here or refused by its code (PROTOCOL 3.5).

use super::{ClientSession, ClientState};
use crate::endpoint::Peer;
use crate::message::{ClientMessage, Grease, VERSIONS, Welcome};
use crate::session::close::CloseCode;
use crate::session::event::Event;
use crate::time::Instant;

impl ClientSession {
    /// Says what is spoken, and which scene it is about.
    pub(super) fn greet(&mut self, now: Instant, peer: Peer) {
        // Any number does that is seldom twice the same.
        let mut grease = Grease::new(now.as_nanos() ^ peer.0.rotate_left(48));
        let hello = ClientMessage::Hello {
            versions: grease.versions(&VERSIONS),
            scene: self.scene.clone(),
            extensions: grease.extensions(),
        };
        self.send(&hello);
        grease.message(&mut self.unsent);
    }

    pub(super) fn handle_welcome(
        &mut self,
        now: Instant,
        welcome: Welcome,
    ) -> Result<(), CloseCode> {
        if self.state != ClientState::Greeting {
            return Err(CloseCode::VIOLATION);
        }
        // A version that was offered to see whether anybody minds it is none to be taken.
        if !VERSIONS.contains(&welcome.version) {
            return Err(CloseCode::VERSION);
        }
        if welcome.extensions.has_unknown_critical() {
            return Err(CloseCode::EXTENSION);
        }
        let config = welcome.scene.as_ref();
        if config.is_some_and(|config| config.check().is_err()) {
            return Err(CloseCode::VIOLATION);
        }
        self.state = ClientState::Lobby;
        self.config = welcome.scene;
        self.send(&ClientMessage::Ping { sent: now });
        self.events.push_back(Event::Welcomed(welcome));
        Ok(())
    }
}
