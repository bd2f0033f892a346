//! A client's token, and the role that it gives.
//!
//! Tokens are opaque here: the server's keys decide what one is worth (PROTOCOL 3.6).

use alloc::string::String;
use core::fmt;
use core::str::FromStr;

use super::extensions::Extension;
use crate::limits::EXTENSION_BYTES_MAX;

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
}
