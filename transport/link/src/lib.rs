//! The links between clients and servers: connections of clients, and clocks.
//!
//! Carries bytes between [`rhumb_protocol::Endpoint`]s and interprets none of them. Every queue between threads is
//! bounded.
//!
//! Without the feature `quic` there are no sockets: the rest serves a link within one process. Servers with sockets are
//! those of `rhumb-transport`; the hidden modules are for them and for raw peers of tests, and may change at any time.
#![forbid(unsafe_code)]

mod client_transport;
#[cfg(feature = "quic")]
#[doc(hidden)]
pub mod connection;
#[cfg(feature = "quic")]
mod quic_client;
#[cfg(feature = "quic")]
mod system;
#[cfg(feature = "quic")]
#[doc(hidden)]
pub mod trust;
#[cfg(feature = "quic")]
#[doc(hidden)]
pub mod tuning;
#[cfg(all(unix, feature = "quic"))]
#[doc(hidden)]
pub mod unix;

pub use client_transport::{
    ByteCredit, CONTROL_IN_FLIGHT_BYTES, ClientTransport, HeldBack, Inbox, PIECE_COST_BYTES, Piece,
    Received, WireStatistics,
};
#[cfg(feature = "quic")]
pub use quic_client::{ClientOptions, ConnectError, QuicClient};
pub use rhumb_protocol::session::TransportCode;
pub use system::Clock;
#[cfg(feature = "quic")]
pub use system::{bind_udp, io_runtime, outward_ip, random_bytes};
#[cfg(feature = "quic")]
pub use trust::{CertificateError, Fingerprint, FingerprintError, Trust};
#[cfg(feature = "quic")]
pub use tuning::{DATAGRAM_BYTES_MIN, IdleLimit};
#[cfg(all(unix, feature = "quic"))]
pub use unix::UnixClient;
