//! QUIC for both ends: control as one stream, state as datagrams.
//!
//! No bytes are interpreted here. Each end has a thread of its own for the sockets; the queues between that thread and
//! its caller are bounded lane by lane.

mod certificate;
mod client;
mod connect_error;
mod connection;
#[cfg(not(feature = "web"))]
mod no_web_session;
#[cfg_attr(
    not(feature = "web"),
    expect(dead_code, reason = "only sessions of browsers have an origin")
)]
mod origins;
#[cfg(feature = "web")]
mod reset_stream_at;
mod server;
mod server_io;
mod server_loop;
mod trust;
mod tuning;
mod watch;
mod web_certificate;
#[cfg(feature = "web")]
mod web_request;
#[cfg(feature = "web")]
mod web_session;

#[cfg(not(feature = "web"))]
use no_web_session as web_session;

pub use certificate::{
    Certificate, CertificateError, DevelopmentPem, Fingerprint, FingerprintError,
};
pub use client::{ClientOptions, QuicClient};
pub use connect_error::ConnectError;
pub use origins::{InvalidPageOrigin, Origins, PageOrigin};
pub use server::{BindError, QuicServer, ServerOptions};
pub use server_loop::{LinkMeter, ServeError, Waker};
pub use trust::Trust;
#[cfg(feature = "raw")]
pub(crate) use trust::client_tls;
#[cfg(feature = "raw")]
pub(crate) use tuning::ALPN;
pub use tuning::DATAGRAM_BYTES_MIN;
pub use watch::{ServerStatistics, ServerWatch, Stop};
pub use web_certificate::{CertificateHashes, WebIdentity, WebOptions};
