//! The identity of a client: its token and role, its session's key.
//!
//! Tokens are opaque here: the server's keys decide what one is worth (PROTOCOL 3.6). A session is a client's place in
//! its order of commands, across connections: the client draws the key, and a scene keeps what it needs to resume the
//! session.

use alloc::string::String;
use core::fmt;
use core::str::FromStr;

use rhumb_reckoning::Tick;

use super::extensions::Extension;
use crate::limits::EXTENSION_BYTES_MAX;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// A signed text that a client shows in its first message.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

/// The rights of a client. Each role includes those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// Joins scenes and receives streams.
    Observer,
    /// Also adds bodies, commands its own ones, and advances a lockstep scene.
    Controller,
    /// Also creates and deletes scenes, and commands everything in them.
    Owner,
}

impl Token {
    /// As text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The extension of `Hello` that carries it.
    #[must_use]
    pub fn extension(&self) -> Extension {
        Extension {
            id: Extension::TOKEN,
            value: self.0.as_bytes().to_vec(),
        }
    }
}

impl FromStr for Token {
    type Err = InvalidToken;

    /// Accepts printable ASCII of at most [`EXTENSION_BYTES_MAX`] bytes, without the space around it.
    fn from_str(text: &str) -> Result<Self, InvalidToken> {
        let text = text.trim();
        let fits = (1..=EXTENSION_BYTES_MAX).contains(&text.len());
        if fits && text.bytes().all(|byte| byte.is_ascii_graphic()) {
            Ok(Self(text.into()))
        } else {
            Err(InvalidToken)
        }
    }
}

/// Leaves the text out: a log is no place for a secret.
impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(…)")
    }
}

impl Role {
    /// Its number on the wire.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Observer => 0,
            Self::Controller => 1,
            Self::Owner => 2,
        }
    }

    /// The role of a number.
    #[must_use]
    pub const fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Observer),
            1 => Some(Self::Controller),
            2 => Some(Self::Owner),
            _ => None,
        }
    }

    /// The extension of `Welcome` that tells it.
    #[must_use]
    pub fn extension(self) -> Extension {
        Extension {
            id: Extension::TOKEN,
            value: alloc::vec![self.code()],
        }
    }
}

/// A text that cannot be a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InvalidToken;

impl fmt::Display for InvalidToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "a token is 1 to {EXTENSION_BYTES_MAX} printable characters without spaces"
        )
    }
}

impl core::error::Error for InvalidToken {}

/// Names a session of one scene. It is secret: a client that knows it may take the session over.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SessionKey(pub [u8; 16]);

impl fmt::Debug for SessionKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SessionKey")
    }
}

/// A client's request to begin a session with its next join, or to take up the one of that key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SessionRequest {
    /// Its key.
    pub key: SessionKey,
    /// Commands of the session that the client knows to be done: no earlier refusal is repeated.
    pub answered: u64,
}

/// The state from which a session resumes; sent before the answer to the join.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SessionState {
    /// True if the scene knows the session; otherwise it has just begun.
    pub resumed: bool,
    /// True if the scene has a command log, so that `Durable` is sent.
    pub durable: bool,
    /// Commands of the session that were applied or refused; the next one has this number.
    pub commands: u64,
    /// The tick at which the scene resumes. After a restart of the server it may be earlier than the last one sent.
    pub tick: Tick,
}

impl Wire for SessionKey {
    fn encode(&self, to: &mut Writer) {
        to.raw(&self.0);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let bytes = from.raw(16)?;
        bytes.try_into().map(Self).map_err(|_| Malformed::Truncated)
    }
}

impl Wire for SessionRequest {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.answered);
        self.key.encode(to);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let answered = from.count()?;
        let key = SessionKey::decode(from)?;
        Ok(Self { key, answered })
    }
}

/// Bits of a session's first byte.
mod flag {
    pub(super) const RESUMED: u8 = 1;
    pub(super) const DURABLE: u8 = 2;
}

impl Wire for SessionState {
    fn encode(&self, to: &mut Writer) {
        let resumed = if self.resumed { flag::RESUMED } else { 0 };
        let durable = if self.durable { flag::DURABLE } else { 0 };
        to.u8(resumed | durable);
        to.varint(self.commands);
        to.varint(self.tick.value());
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let flags = from.u8()?;
        if flags > flag::RESUMED | flag::DURABLE {
            return Err(Malformed::UnknownCode);
        }
        Ok(Self {
            resumed: flags & flag::RESUMED != 0,
            durable: flags & flag::DURABLE != 0,
            commands: from.count()?,
            tick: Tick::new(from.count()?),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_printable_and_fits_an_extension() {
        let token: Token = " v4.public.abc\n".parse().unwrap();
        assert_eq!(token.as_str(), "v4.public.abc");
        assert_eq!(token.extension().value, b"v4.public.abc");
        assert!(!token.extension().is_critical());
        let long = String::from_utf8(alloc::vec![b'a'; EXTENSION_BYTES_MAX + 1]);
        for text in ["", "two words", "\u{e9}", &long.unwrap()] {
            assert_eq!(text.parse::<Token>(), Err(InvalidToken), "{text}");
        }
    }

    #[test]
    fn roles_have_numbers_and_an_order() {
        for role in [Role::Observer, Role::Controller, Role::Owner] {
            assert_eq!(Role::from_code(role.code()), Some(role));
        }
        assert_eq!(Role::from_code(3), None);
        assert!(Role::Observer < Role::Controller && Role::Controller < Role::Owner);
    }

    #[test]
    fn a_session_state_round_trips_and_its_flags_are_known() {
        let state = SessionState {
            resumed: true,
            durable: false,
            commands: 300,
            tick: Tick::new(7),
        };
        let mut writer = Writer::new();
        state.encode(&mut writer);
        let bytes = writer.into_bytes();
        assert_eq!(bytes, [1, 0xac, 2, 7]);
        assert_eq!(SessionState::decode(&mut Reader::new(&bytes)), Ok(state));
        let unknown = SessionState::decode(&mut Reader::new(&[4, 0, 0]));
        assert_eq!(unknown, Err(Malformed::UnknownCode));
        for cut in 0..bytes.len() {
            let cut = SessionState::decode(&mut Reader::new(&bytes[..cut]));
            assert_eq!(cut, Err(Malformed::Truncated));
        }
    }

    #[test]
    fn a_key_is_not_printed() {
        assert_eq!(alloc::format!("{:?}", SessionKey([7; 16])), "SessionKey");
    }
}
