//! The bytes of a connection up to its first message, which names its scene.
//!
//! Bounds what a client may send before it. Decides nothing: the driver hands the bytes on to the scene, or closes.

use bytes::Bytes;
use rhumb_protocol::message::{ClientMessage, Extension, Grease, Role};
use rhumb_protocol::scene::SceneName;
use rhumb_protocol::session::{CloseCode, ServerSession};

/// The bytes of a connection up to its first message.
#[derive(Debug)]
pub struct Greeting {
    /// Reads the first message only; the session in the scene reads all bytes again.
    session: ServerSession,
    received: Vec<u8>,
    /// True if the driver reports what the link takes.
    pub paced: bool,
}

/// The result of some bytes.
#[derive(Debug, PartialEq)]
pub enum Greeted {
    /// The first message is not whole.
    NotYet,
    /// The scene, the token if there is one, and all bytes so far.
    Names(SceneName, Option<Vec<u8>>, Bytes),
    /// The client breaks the protocol.
    Broken(CloseCode),
}

/// Bytes before the end of a first message: unknown messages may precede it.
const RECEIVED_BYTES_MAX: usize = 128 << 10;

impl Default for Greeting {
    fn default() -> Self {
        Self {
            session: ServerSession::new(Grease::new(0)),
            received: Vec::new(),
            paced: false,
        }
    }
}

impl Greeting {
    /// The answer to a first message that names a scene of another server, and the code to close with.
    pub fn welcome_elsewhere(&mut self, place: &str, role: Option<Role>) -> (Bytes, CloseCode) {
        self.session.welcome_elsewhere(place, role);
        let mut answer = Vec::new();
        while let Some(bytes) = self.session.poll_control() {
            answer.extend_from_slice(&bytes);
        }
        let code = self.session.poll_close();
        (answer.into(), code.unwrap_or(CloseCode::SCENE_ELSEWHERE))
    }

    /// Appends control bytes.
    pub fn handle_control(&mut self, bytes: &[u8]) -> Greeted {
        self.received.extend_from_slice(bytes);
        self.session.handle_control(bytes);
        match self.session.poll_message() {
            Some(Ok(ClientMessage::Hello {
                scene, extensions, ..
            })) => {
                let token = extensions.value(Extension::TOKEN).map(<[u8]>::to_vec);
                let received = Bytes::from(std::mem::take(&mut self.received));
                Greeted::Names(scene, token, received)
            }
            _ => match self.session.poll_close() {
                Some(code) => Greeted::Broken(code),
                None if self.received.len() > RECEIVED_BYTES_MAX => {
                    Greeted::Broken(CloseCode::LIMIT)
                }
                None => Greeted::NotYet,
            },
        }
    }
}
