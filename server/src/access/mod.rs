//! Access: which clients a server admits, and what each of them may do.
//!
//! The front verifies a client's token once, before its first message reaches a scene; no tick waits for that. Scenes
//! get the resulting permit, and ask [`rights`] about each request.

mod claims;
mod gate;
mod keys;
mod ownership;
mod permit;
pub(crate) mod rights;

pub(crate) use self::claims::{Claims, DEFAULT_AUDIENCE, role_of};
pub(crate) use self::gate::Gate;
#[cfg(test)]
pub(crate) use self::gate::tests;
#[cfg(feature = "view")]
pub(crate) use self::keys::TokenIssuer;
pub use self::keys::{KeyError, TokenKeys};
pub(crate) use self::keys::{make_keys, sign};
pub(crate) use self::ownership::{Ownership, decode_client, decode_client_of, encode_client_of};
pub(crate) use self::permit::{ClientName, Permit, Quotas};
