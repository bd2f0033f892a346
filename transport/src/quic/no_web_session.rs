//! The session of a browser where there is none: without the feature `web`.

use std::fmt;

use bytes::Bytes;
use quinn::{Connection, RecvStream, SendStream, VarInt};

pub(super) use self::{NoSession as WebSession, NoWeb as WebRefusal};
use super::origins::Origins;

/// A session that no connection has.
#[derive(Debug)]
pub(super) enum NoSession {}

/// Reason why a connection with HTTP/3 has no session.
#[derive(Debug)]
pub(super) enum NoWeb {
    /// The server was built without the feature `web`.
    Absent,
}

impl fmt::Display for NoWeb {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Absent => f.write_str("this server was built without the feature web"),
        }
    }
}

impl NoWeb {
    pub(super) const fn foreign_origin(&self) -> Option<&str> {
        None
    }
}

/// Settings that no connection has.
pub(super) use std::convert::Infallible as SentSettings;

pub(super) async fn send_settings(_connection: &Connection) -> Result<SentSettings, NoWeb> {
    Err(NoWeb::Absent)
}

impl NoSession {
    pub(super) async fn accept(
        _connection: &Connection,
        settings: SentSettings,
        _origins: &Origins,
    ) -> Result<Self, NoWeb> {
        match settings {}
    }

    pub(super) async fn run(&self, _close: impl Fn(VarInt)) {
        match *self {}
    }

    pub(super) async fn accept_bi(&self) -> Option<(SendStream, RecvStream)> {
        match *self {}
    }

    pub(super) fn wrap(&self, _bytes: &[u8]) -> Bytes {
        match *self {}
    }

    pub(super) fn unwrap(&self, _datagram: Bytes) -> Option<Bytes> {
        match *self {}
    }

    pub(super) const fn overhead(&self) -> usize {
        match *self {}
    }

    pub(super) fn close(&self, _code: u32) {
        match *self {}
    }

    pub(super) fn peer_code(&self) -> Option<u32> {
        match *self {}
    }
}

/// No stream has a session.
pub(super) fn is_end_of_session(_code: VarInt) -> bool {
    false
}

/// No code belongs to a session.
pub(super) fn session_code(_code: VarInt) -> Option<u32> {
    None
}
