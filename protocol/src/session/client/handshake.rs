//! The greeting of a client: what it offers, and what it accepts.
//!
//! Versions and extensions that do not exist are offered too, so that every server learns to skip them. The session decides when
//! to greet, and closes with the codes of the checks.

use super::outbox::ClientOutbox;
use crate::endpoint::{Instant, Peer};
use crate::message::{ClientMessage, Grease, Joined, Token, VERSIONS, Welcome};
use crate::scene::SceneName;
use crate::session::CloseCode;

/// The statements of a client about itself.
#[derive(Debug)]
pub(super) struct ClientHandshake {
    pub(super) scene: SceneName,
    pub(super) token: Option<Token>,
}

impl ClientHandshake {
    /// Sends the `Hello`: offered versions, scene, token, extensions.
    pub(super) fn greet(&self, now: Instant, peer: Peer, outbox: &mut ClientOutbox) {
        // The seed only has to differ between most connections.
        let mut grease = Grease::new(now.as_nanos() ^ peer.0.rotate_left(48));
        let versions = grease.versions(&VERSIONS);
        let mut extensions = grease.extensions();
        if let Some(token) = &self.token {
            let fits = extensions.insert(token.extension());
            debug_assert!(fits, "a token fits an extension");
        }
        outbox.send(&ClientMessage::Hello {
            versions,
            scene: self.scene.clone(),
            extensions,
        });
        outbox.send_framed(|unsent| grease.message(unsent));
    }

    /// Checks the server's answer.
    pub(super) fn check(welcome: &Welcome) -> Result<(), CloseCode> {
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
        Ok(())
    }

    /// Checks the config and the extensions with which a snapshot begins.
    pub(super) fn check_joined(joined: &Joined) -> Result<(), CloseCode> {
        joined.config.check().map_err(|_| CloseCode::VIOLATION)?;
        if joined.extensions.has_unknown_critical() {
            return Err(CloseCode::EXTENSION);
        }
        Ok(())
    }
}
