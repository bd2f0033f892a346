//! Sockets and clocks of Rhumb: QUIC, and a simulated network for tests.
//!
//! No other crate touches either. This one carries bytes between [`rhumb_protocol::Endpoint`]s and interprets none of
//! them. Every queue between threads is bounded.
#![forbid(unsafe_code)]

mod app;
mod clock;
mod link_meter;
mod netsim;
mod piece;
mod quic;
mod raw_peer;
mod relay;
mod socket;

pub use app::{AppBindError, AppEndpoint, AppListen, AppTransmit};
pub use clock::Clock;
pub use netsim::{
    Direction, Lane, Link, LinkConfig, LinkConfigError, LinkCounts, Probability, RunStop,
    SimNetwork, Tally,
};
pub use quic::{
    BindError, Certificate, CertificateError, ClientOptions, ConnectError, DATAGRAM_BYTES_MIN,
    Fingerprint, FingerprintError, QuicClient, QuicServer, Received, ServeError, ServerOptions,
    ServerStatistics, ServerWatch, Stop, TransportCode, Trust, WireStatistics,
};
pub use raw_peer::{
    RawConnection, RawEvent, RawPeerConfig, RawPeerEnd, RawPeerError, RawPeerServer,
};
pub use relay::{RelayError, UdpRelay};
