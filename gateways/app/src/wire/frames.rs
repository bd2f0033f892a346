//! Framing: splits a byte stream into messages, allowed in a client's session.
//!
//! The published plug-in sends torques without a header: 24 zero bytes, then 20 of body. Such bytes are decoded as a
//! torque: a length of zero would lose the stream.
//!
//! A client logs on once, with its first message, and off with its last. The logon names its simulation; names in
//! later messages count as of that simulation, since some of them have simulation zero.

use core::fmt;

use super::codec::{FieldReader, HEADER_BYTES, Header, Kind, MalformedMessage};
use super::message::Message;

/// A message, with its sender's counter.
#[derive(Clone, Debug, PartialEq)]
pub struct FramedMessage {
    /// The counter, as received.
    pub index: u32,
    /// The message.
    pub message: Message,
}

/// Splits a stream of bytes into messages. Holds at most one unfinished message and the bytes received with it.
#[derive(Debug, Default)]
pub struct MessageFraming {
    buffer: Vec<u8>,
    /// Bytes at the front of the buffer that are decoded already.
    taken: usize,
}

impl MessageFraming {
    /// Appends the next bytes of the stream, cut at any place.
    pub fn push(&mut self, bytes: &[u8]) {
        if self.taken > 0 {
            self.buffer.drain(..self.taken);
            self.taken = 0;
        }
        self.buffer.extend_from_slice(bytes);
    }

    /// The next whole message, or `None` until more bytes come.
    ///
    /// # Errors
    ///
    /// [`MalformedMessage`] when the front cannot be a message; nothing after it can be decoded either.
    pub fn next_message(&mut self) -> Result<Option<FramedMessage>, MalformedMessage> {
        let front = &self.buffer[self.taken..];
        let Some(head) = front.first_chunk::<HEADER_BYTES>() else {
            return Ok(None);
        };
        let header = if *head == [0; HEADER_BYTES] {
            Header {
                kind: Kind::ApplyTorque,
                index: 0,
                length: TORQUE_BYTES,
            }
        } else {
            Header::take(&mut FieldReader::new(head))?
        };
        let Some(body) = front.get(HEADER_BYTES..header.length) else {
            return Ok(None);
        };
        let message = Message::decode(header.kind, body)?;
        self.taken += header.length;
        Ok(Some(FramedMessage {
            index: header.index,
            message,
        }))
    }
}

/// Bytes of a torque, header included.
const TORQUE_BYTES: usize = HEADER_BYTES + 20;

/// Progress of a session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum SessionPhase {
    /// No message yet.
    #[default]
    Silent,
    /// Logged on.
    Active,
    /// Logged off, or failed.
    Over,
}

/// The server's end of a session.
#[derive(Debug, Default)]
pub(crate) struct Session {
    frames: MessageFraming,
    state: SessionPhase,
}

/// Reason for which a session ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum SessionError {
    /// The bytes are not a message.
    Malformed(MalformedMessage),
    /// The client sent another message before its logon.
    NotLoggedOn,
    /// The client logged on twice.
    LoggedOnTwice,
    /// The client sent a message that only servers send.
    ServersWord,
}

impl fmt::Display for SessionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Malformed(malformed) => malformed.fmt(f),
            Self::NotLoggedOn => f.write_str("the first message was not a logon"),
            Self::LoggedOnTwice => f.write_str("the client logged on twice"),
            Self::ServersWord => f.write_str("the client sent a message that only servers send"),
        }
    }
}

impl core::error::Error for SessionError {}

impl Session {
    /// Appends the next bytes of the connection, cut at any place.
    pub(crate) fn handle_bytes(&mut self, bytes: &[u8]) {
        if self.state != SessionPhase::Over {
            self.frames.push(bytes);
        }
    }

    /// The next message that is allowed; `None` after a logoff.
    ///
    /// # Errors
    ///
    /// [`SessionError`] when the session cannot continue; from then on it accepts nothing.
    pub(crate) fn poll_message(&mut self) -> Result<Option<FramedMessage>, SessionError> {
        if self.state == SessionPhase::Over {
            return Ok(None);
        }
        let next = self.frames.next_message().map_err(SessionError::Malformed);
        let checked = next.and_then(|framed| match framed {
            Some(framed) => self.admit(&framed.message).map(|()| Some(framed)),
            None => Ok(None),
        });
        if checked.is_err() {
            self.end();
        }
        checked
    }

    fn admit(&mut self, message: &Message) -> Result<(), SessionError> {
        match (self.state, message) {
            (SessionPhase::Silent, Message::Logon(_)) => self.state = SessionPhase::Active,
            (SessionPhase::Silent, _) => return Err(SessionError::NotLoggedOn),
            (_, Message::Logon(_)) => return Err(SessionError::LoggedOnTwice),
            (
                _,
                Message::Error(_)
                | Message::LogonReady(_)
                | Message::TimeAdvanced(_)
                | Message::UpdateMass(_)
                | Message::ActorsCollided(_),
            ) => return Err(SessionError::ServersWord),
            (_, Message::Logoff(_)) => self.end(),
            _ => {}
        }
        Ok(())
    }

    fn end(&mut self) {
        self.state = SessionPhase::Over;
        self.frames = MessageFraming::default();
    }
}
