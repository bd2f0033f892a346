//! The sockets of Rhumb's servers: QUIC, WebTransport, Unix sockets.
//!
//! Carries bytes between [`rhumb_protocol::Endpoint`]s and interprets none of them. Every queue between threads is
//! bounded. A listener of another protocol wakes the thread of a server by a [`Waker`].
//!
//! The connections of clients are those of [`rhumb_link`], whose public names this crate has too.
#![forbid(unsafe_code)]

mod certificate;
#[cfg(target_os = "linux")]
mod child_stream;
pub mod conditioner;
mod reset_stream_at;
mod server;
mod server_loop;
#[cfg(unix)]
mod unix;
mod web_request;
mod web_session;

pub use certificate::{Certificate, CertificateHashes, DevelopmentPem, WebIdentity, WebOptions};
#[cfg(target_os = "linux")]
pub use child_stream::{
    CHILD_FRAME_BYTES_MAX, ChildSender, FrameReceiver, ParentSender, child_stream, parent_stream,
};
#[cfg(unix)]
pub use rhumb_link::UnixClient;
pub use rhumb_link::{
    ByteCredit, CertificateError, ClientOptions, ClientTransport, Clock, ConnectError,
    DATAGRAM_BYTES_MIN, Fingerprint, FingerprintError, HeldBack, IdleLimit, Inbox,
    PIECE_COST_BYTES, Piece, QuicClient, Received, TransportCode, Trust, WireStatistics, bind_udp,
    io_runtime, outward_ip, random_bytes,
};
pub use server::{BindError, QuicServer, ServerOptions};
pub use server_loop::{LinkMeter, ServeError, ServerStatistics, ServerWatch, Stop, Waker};
#[cfg(unix)]
pub use unix::{UnixServer, WithUnixPeers};
pub use web_request::{InvalidPageOrigin, Origins, PageOrigin};
