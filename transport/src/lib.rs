//! The sockets and clocks of Rhumb: QUIC, and Unix sockets within one machine.
//!
//! Carries bytes between [`rhumb_protocol::Endpoint`]s and interprets none of them. Every queue between threads is
//! bounded. A listener of another protocol wakes the thread of a server by a [`Waker`].
#![forbid(unsafe_code)]

#[cfg(target_os = "linux")]
mod child_stream;
#[cfg(feature = "conditioner")]
pub mod conditioner;
mod piece;
mod quic;
#[cfg(feature = "raw")]
pub mod raw;
mod system;
#[cfg(unix)]
mod unix;

#[cfg(target_os = "linux")]
pub use child_stream::{
    CHILD_FRAME_BYTES_MAX, ChildSender, FrameReceiver, ParentSender, child_stream, parent_stream,
};
pub use piece::{ByteCredit, HeldBack, PIECE_COST_BYTES, Piece};
pub use quic::{
    BindError, Certificate, CertificateError, CertificateHashes, ClientOptions, ClientTransport,
    ConnectError, DATAGRAM_BYTES_MIN, DevelopmentPem, Fingerprint, FingerprintError, Inbox,
    InvalidPageOrigin, LinkMeter, Origins, PageOrigin, QuicClient, QuicServer, Received,
    ServeError, ServerOptions, ServerStatistics, ServerWatch, Stop, Trust, Waker, WebIdentity,
    WebOptions, WireStatistics,
};
pub use rhumb_protocol::session::TransportCode;
pub use system::{Clock, bind_udp, io_runtime, random_bytes};
#[cfg(unix)]
pub use unix::{UnixClient, UnixServer, WithUnixPeers};
