//! Access: which clients a server admits.
//!
//! The dispatcher verifies a client's token once, before its first message reaches a scene; no tick waits for that. Scenes
//! get the resulting permit.

mod authenticator;
mod claims;
mod keys;

pub(crate) use self::authenticator::Authenticator;
#[cfg(test)]
pub(crate) use self::authenticator::tests;
pub(crate) use self::claims::{Claims, DEFAULT_AUDIENCE, role_of};
#[cfg(feature = "view")]
pub(crate) use self::keys::TokenIssuer;
pub use self::keys::{KeyError, TokenKeys};
pub(crate) use self::keys::{make_keys, sign};
