//! A client's session at the server: accepts messages where allowed.
//!
//! A client logs on once, with its first message, and off with its last. The logon names its simulation; names in
//! later messages count as of that simulation, since some of them have simulation zero.

use core::fmt;

use super::frames::{FramedMessage, MessageFraming};
use super::malformed::MalformedMessage;
use super::message::Message;

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
