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
mod origins;
mod reset_stream_at;
mod server;
mod server_io;
mod server_loop;
#[cfg(unix)]
mod unix;
mod watch;
mod web_certificate;
mod web_request;
mod web_session;

pub use certificate::{Certificate, DevelopmentPem};
#[cfg(target_os = "linux")]
pub use child_stream::{
    CHILD_FRAME_BYTES_MAX, ChildSender, FrameReceiver, ParentSender, child_stream, parent_stream,
};
pub use origins::{InvalidPageOrigin, Origins, PageOrigin};
#[cfg(unix)]
pub use rhumb_link::UnixClient;
pub use rhumb_link::{
    ByteCredit, CertificateError, ClientOptions, ClientTransport, Clock, ConnectError,
    DATAGRAM_BYTES_MIN, Fingerprint, FingerprintError, HeldBack, Inbox, PIECE_COST_BYTES, Piece,
    QuicClient, Received, TransportCode, Trust, WireStatistics, bind_udp, io_runtime, outward_ip,
    random_bytes,
};
pub use server::{BindError, QuicServer, ServerOptions};
pub use server_loop::{LinkMeter, ServeError, Waker};
#[cfg(unix)]
pub use unix::{UnixServer, WithUnixPeers};
pub use watch::{ServerStatistics, ServerWatch, Stop};
pub use web_certificate::{CertificateHashes, WebIdentity, WebOptions};
