//! One connection at the server: reads messages where they are allowed.
//!
//! A client logs on once, as its first word, and off as its last. Whose simulation it is, the logon says; the names in
//! later messages are taken for its own, since some of them say simulation zero.

use core::fmt;

use crate::frames::{Framed, Frames};
use crate::malformed::Malformed;
use crate::message::Message;

/// Where a conversation stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum SessionState {
    /// Nothing was said.
    #[default]
    Silent,
    /// Logged on.
    Active,
    /// Logged off, or broken.
    Over,
}

/// The server's end of a connection.
#[derive(Debug, Default)]
pub struct Session {
    frames: Frames,
    state: SessionState,
}

/// Why a connection cannot go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SessionError {
    /// Its bytes are no messages.
    Malformed(Malformed),
    /// It said something before it logged on.
    NotLoggedOn,
    /// It logged on twice.
    LoggedOnTwice,
    /// It said what only servers say.
    ServersWord,
}

impl fmt::Display for SessionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Malformed(malformed) => malformed.fmt(f),
            Self::NotLoggedOn => f.write_str("the first message was no logon"),
            Self::LoggedOnTwice => f.write_str("it logged on twice"),
            Self::ServersWord => f.write_str("it said what only servers say"),
        }
    }
}

impl core::error::Error for SessionError {}

impl Session {
    /// The next bytes of the connection, cut anywhere.
    pub fn handle_bytes(&mut self, bytes: &[u8]) {
        if self.state != SessionState::Over {
            self.frames.push(bytes);
        }
    }

    /// The next message that may be said here; nothing after a logoff.
    ///
    /// # Errors
    ///
    /// [`SessionError`] when the connection cannot go on; then nothing more is heard of it.
    pub fn poll_message(&mut self) -> Result<Option<Framed>, SessionError> {
        if self.state == SessionState::Over {
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
            (SessionState::Silent, Message::Logon(_)) => self.state = SessionState::Active,
            (SessionState::Silent, _) => return Err(SessionError::NotLoggedOn),
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
        self.state = SessionState::Over;
        self.frames = Frames::default();
    }
}
