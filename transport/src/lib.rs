//! The sockets and clocks of Rhumb: QUIC, and Unix sockets within one machine.
//!
//! Carries bytes between [`rhumb_protocol::Endpoint`]s and interprets none of them. Every queue between threads is
//! bounded. A listener of another protocol wakes the thread of a server by a [`Waker`].
#![forbid(unsafe_code)]

#[cfg(target_os = "linux")]
mod child_stream;
mod client_transport;
mod clock;
#[cfg(feature = "conditioner")]
pub mod conditioner;
mod held_back;
mod link_meter;
mod piece;
mod quic;
mod random;
#[cfg(feature = "raw")]
pub mod raw;
mod socket;
#[cfg(unix)]
mod unix;

#[cfg(target_os = "linux")]
pub use child_stream::{
    CHILD_FRAME_BYTES_MAX, ChildSender, FrameReceiver, ParentSender, child_stream, parent_stream,
};
pub use client_transport::ClientTransport;
pub use clock::Clock;
pub use held_back::HeldBack;
pub use link_meter::LinkMeter;
pub use piece::{ByteCredit, PIECE_COST_BYTES, Piece};
pub use quic::{
    BindError, Certificate, CertificateError, CertificateHashes, ClientOptions, ConnectError,
    DATAGRAM_BYTES_MIN, DevelopmentPem, Fingerprint, FingerprintError, Inbox, InvalidPageOrigin,
    Origins, PageOrigin, QuicClient, QuicServer, Received, ServeError, ServerOptions,
    ServerStatistics, ServerWatch, Stop, Trust, Waker, WebIdentity, WebOptions, WireStatistics,
};
pub use random::random_bytes;
pub use rhumb_protocol::session::TransportCode;
pub use socket::{bind_udp, io_runtime};
#[cfg(unix)]
pub use unix::{UnixClient, UnixServer, WithUnixPeers};
