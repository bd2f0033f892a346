//! QUIC for both ends: control as one stream, state as datagrams.
//!
//! No bytes are interpreted here. Each end has a thread of its own for the sockets; the queues between that thread and
//! its caller are bounded lane by lane.

mod addresses;
mod certificate;
mod client;
mod client_io;
mod closing;
mod connect_error;
mod connection_id;
mod control_queue;
mod datagram_lane;
mod fingerprint;
mod inbox;
mod input;
#[cfg(not(feature = "web"))]
mod no_web_session;
#[cfg_attr(
    not(feature = "web"),
    expect(dead_code, reason = "only sessions of browsers have an origin")
)]
mod origins;
#[cfg(feature = "web")]
mod partial_reset_tls;
#[cfg(feature = "web")]
mod reset_stream_at;
mod server;
mod server_io;
mod server_loop;
mod statistics;
mod stop;
mod trust;
mod tuning;
mod waker;
mod watch;
mod web_certificate;
mod web_options;
#[cfg(feature = "web")]
mod web_request;
#[cfg(feature = "web")]
mod web_session;
#[cfg(feature = "web")]
mod web_settings;

#[cfg(not(feature = "web"))]
use self::no_web_session as web_session;

pub use certificate::{Certificate, CertificateError, DevelopmentPem};
pub use client::{ClientOptions, QuicClient};
pub use connect_error::ConnectError;
pub use fingerprint::{Fingerprint, FingerprintError};
pub use inbox::{Inbox, Received};
pub use origins::{InvalidPageOrigin, Origins, PageOrigin};
pub use server::{BindError, QuicServer, ServerOptions};
pub use server_loop::ServeError;
pub use statistics::{ServerStatistics, WireStatistics};
pub use stop::Stop;
pub use trust::Trust;
#[cfg(feature = "raw")]
pub(crate) use trust::client_tls;
#[cfg(feature = "raw")]
pub(crate) use tuning::ALPN;
pub use tuning::DATAGRAM_BYTES_MIN;
pub use waker::Waker;
pub use watch::ServerWatch;
pub use web_certificate::CertificateHashes;
pub use web_options::{WebIdentity, WebOptions};
