//! The messages of a server, from the bytes of the control stream.
//!
//! Unknown messages that a client may ignore are skipped.

use crate::message::{Frames, ServerMessage};
use crate::wire::Malformed;

/// The bytes that are not decoded yet.
#[derive(Debug)]
pub(super) struct ServerMessages {
    frames: Frames,
}

impl ServerMessages {
    pub(super) const fn new(frames: Frames) -> Self {
        Self { frames }
    }

    /// Adds received bytes.
    pub(super) fn push(&mut self, bytes: &[u8]) {
        self.frames.push(bytes);
    }

    /// The next message; `None` until more bytes come.
    pub(super) fn next(&mut self) -> Result<Option<ServerMessage>, Malformed> {
        while let Some(framed) = self.frames.next_frame()? {
            if let Some(message) = ServerMessage::decode(&framed)? {
                return Ok(Some(message));
            }
        }
        Ok(None)
    }
}
