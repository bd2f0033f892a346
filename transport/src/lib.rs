//! The sockets and clocks of Rhumb: QUIC, and Unix sockets within one machine.
//!
//! Carries bytes between [`rhumb_protocol::Endpoint`]s and interprets none of them. Every queue between threads is
//! bounded. A listener of another protocol wakes the thread of a server by a `Waker`.
//!
//! Without the feature `quic` there are no sockets: what is left serves a link within one process.
#![forbid(unsafe_code)]

#[cfg(all(target_os = "linux", feature = "quic"))]
mod child_stream;
mod client_transport;
mod clock;
#[cfg(feature = "conditioner")]
pub mod conditioner;
mod piece;
#[cfg(feature = "quic")]
mod quic;
#[cfg(feature = "raw")]
pub mod raw;
#[cfg(feature = "quic")]
mod system;
#[cfg(all(unix, feature = "quic"))]
mod unix;

#[cfg(all(target_os = "linux", feature = "quic"))]
pub use child_stream::{
    CHILD_FRAME_BYTES_MAX, ChildSender, FrameReceiver, ParentSender, child_stream, parent_stream,
};
pub use client_transport::{
    CONTROL_IN_FLIGHT_BYTES, ClientTransport, Inbox, Received, WireStatistics,
};
pub use clock::Clock;
pub use piece::{ByteCredit, HeldBack, PIECE_COST_BYTES, Piece};
#[cfg(feature = "quic")]
pub use quic::{
    BindError, Certificate, CertificateError, CertificateHashes, ClientOptions, ConnectError,
    DATAGRAM_BYTES_MIN, DevelopmentPem, Fingerprint, FingerprintError, InvalidPageOrigin,
    LinkMeter, Origins, PageOrigin, QuicClient, QuicServer, ServeError, ServerOptions,
    ServerStatistics, ServerWatch, Stop, Trust, Waker, WebIdentity, WebOptions,
};
pub use rhumb_protocol::session::TransportCode;
#[cfg(feature = "quic")]
pub use system::{bind_udp, io_runtime, random_bytes};
#[cfg(all(unix, feature = "quic"))]
pub use unix::{UnixClient, UnixServer, WithUnixPeers};
