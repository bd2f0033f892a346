//! The sockets and clocks of Rhumb: QUIC, and the sockets of APP.
//!
//! No other crate touches either. This one carries bytes between [`rhumb_protocol::Endpoint`]s and interprets none of
//! them. Every queue between threads is bounded.
#![forbid(unsafe_code)]

mod app;
mod clock;
mod link_meter;
mod piece;
mod quic;
#[cfg(feature = "raw")]
pub mod raw;
mod socket;

pub use app::{AppBindError, AppEndpoint, AppListen, AppTransmit};
pub use clock::Clock;
pub use link_meter::LinkMeter;
pub use quic::{
    BindError, Certificate, CertificateError, ClientOptions, ConnectError, DATAGRAM_BYTES_MIN,
    Fingerprint, FingerprintError, QuicClient, QuicServer, Received, ServeError, ServerOptions,
    ServerStatistics, ServerWatch, Stop, TransportCode, Trust, Waker, WireStatistics,
};
