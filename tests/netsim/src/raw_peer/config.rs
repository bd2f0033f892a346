//! Handshake parameters of a raw peer, and reasons for a failed handshake.
//!
//! The defaults are those of PROTOCOL 1; a test may replace each by a bad value.

use std::fmt;
use std::io;
use std::time::Duration;

use quinn::{IdleTimeout, TransportConfig, VarInt};

use super::connection::RawPeerEnd;
use rhumb_link::CertificateError;

/// Handshake parameters of one end.
#[derive(Clone, Debug)]
pub struct RawPeerConfig {
    /// The transport of the control stream and the datagrams.
    pub carrier: Carrier,
    /// The path that a session requests.
    pub path: String,
    /// The origin of the page that requests it; `None`: it is no browser.
    pub origin: Option<String>,
    /// The application protocols that it offers, by their TLS names.
    pub alpn: Vec<Vec<u8>>,
    /// The longest datagram that it accepts; `None` disables datagrams.
    pub datagram_bytes: Option<u16>,
    /// Silence after which it considers the connection lost.
    pub idle: Duration,
    /// Interval of keep-alive packets; `None` for none.
    pub keep_alive: Option<Duration>,
    /// Streams of each kind that the peer may open.
    pub streams: u32,
    /// Bytes that the peer may send on a stream before this end reads them.
    pub window_bytes: u32,
}

/// The transport of the control stream and the datagrams.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Carrier {
    /// The connection itself.
    #[default]
    Quic,
    /// A session of WebTransport on it, as a browser has one (PROTOCOL 1.5).
    WebTransport,
}

/// Reason why there is no connection.
#[derive(Debug)]
pub enum RawPeerError {
    /// The file of roots cannot be used.
    Certificate(CertificateError),
    /// A socket or a thread of this machine failed.
    Host(io::Error),
    /// The TLS configuration cannot be used for QUIC.
    Tls(String),
    /// The handshake ended.
    Handshake(RawPeerEnd),
}

impl Default for RawPeerConfig {
    fn default() -> Self {
        Self {
            carrier: Carrier::Quic,
            path: "/rhumb/1".to_owned(),
            origin: None,
            alpn: vec![rhumb_link::tuning::ALPN.to_vec()],
            datagram_bytes: Some(u16::MAX),
            idle: Duration::from_secs(10),
            keep_alive: Some(Duration::from_secs(3)),
            streams: 16,
            window_bytes: 1 << 20,
        }
    }
}

impl RawPeerConfig {
    /// The default, over this carrier.
    #[must_use]
    pub fn over(carrier: Carrier) -> Self {
        match carrier {
            Carrier::Quic => Self::default(),
            Carrier::WebTransport => Self {
                carrier,
                alpn: vec![web_transport_quinn::ALPN.as_bytes().to_vec()],
                ..Self::default()
            },
        }
    }

    pub(super) fn transport(&self) -> TransportConfig {
        let mut transport = TransportConfig::default();
        let idle_ms = u32::try_from(self.idle.as_millis()).unwrap_or(u32::MAX);
        transport
            .max_idle_timeout(Some(IdleTimeout::from(VarInt::from_u32(idle_ms))))
            .keep_alive_interval(self.keep_alive)
            .max_concurrent_bidi_streams(VarInt::from_u32(self.streams))
            .max_concurrent_uni_streams(VarInt::from_u32(self.streams))
            .stream_receive_window(VarInt::from_u32(self.window_bytes))
            .datagram_receive_buffer_size(self.datagram_bytes.map(usize::from));
        transport
    }
}

impl fmt::Display for RawPeerError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Certificate(cause) => cause.fmt(f),
            Self::Host(cause) => write!(f, "a socket or thread of this machine failed: {cause}"),
            Self::Tls(cause) => write!(f, "the TLS configuration cannot be used: {cause}"),
            Self::Handshake(end) => write!(f, "the handshake ended: {end}"),
        }
    }
}

impl std::error::Error for RawPeerError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Certificate(cause) => Some(cause),
            Self::Host(cause) => Some(cause),
            Self::Tls(_) | Self::Handshake(_) => None,
        }
    }
}
