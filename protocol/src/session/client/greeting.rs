//! The handshake of a client.
//!
//! Messages of later versions are accepted or refused by their code (PROTOCOL 3.5).

use super::{ClientSession, ClientState};
use crate::endpoint::Peer;
use crate::message::{ClientMessage, Grease, StreamChoice, VERSIONS, Welcome};
use crate::scene::SceneConfig;
use crate::session::close::CloseCode;
use crate::session::event::Event;
use crate::session::misuse::Misuse;
use crate::time::Instant;

impl ClientSession {
    /// Creates the scene; answered by `Created` or `Denied`.
    ///
    /// # Errors
    ///
    /// [`Misuse`] before the welcome, as a member, or for a config that is invalid.
    pub fn create(&mut self, config: SceneConfig) -> Result<(), Misuse> {
        self.must_be(ClientState::Lobby)?;
        config.check().map_err(Misuse::Invalid)?;
        self.send(&ClientMessage::Create(config));
        Ok(())
    }

    /// Requests membership; answered by `Joined` or `Denied`.
    ///
    /// # Errors
    ///
    /// [`Misuse::NotNow`] before the welcome or as a member.
    pub fn join(&mut self, choice: StreamChoice) -> Result<(), Misuse> {
        self.must_be(ClientState::Lobby)?;
        self.send(&ClientMessage::Join(choice));
        Ok(())
    }

    /// Sends the `Hello`: offered versions, scene, token, extensions.
    pub(super) fn greet(&mut self, now: Instant, peer: Peer) {
        // The seed only has to differ between most connections.
        let mut grease = Grease::new(now.as_nanos() ^ peer.0.rotate_left(48));
        let versions = grease.versions(&VERSIONS);
        let mut extensions = grease.extensions();
        if let Some(token) = &self.token {
            let fits = extensions.insert(token.extension());
            debug_assert!(fits, "a token fits an extension");
        }
        let hello = ClientMessage::Hello {
            versions,
            scene: self.scene.clone(),
            extensions,
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
        // The server may not choose the reserved version that the client offers to test tolerance of unknown ones.
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
        if self.can_reconnect() {
            self.rejoin();
        } else {
            self.events.push_back(Event::Welcomed(welcome));
        }
        Ok(())
    }
}
