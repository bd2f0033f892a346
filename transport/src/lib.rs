//! Sockets and clocks of Rhumb: QUIC, and a pretend network for tests.
//!
//! The only crate that touches either. It carries bytes between [`rhumb_protocol::Endpoint`]s and understands none of them.
//! Every queue between threads is bounded.
#![forbid(unsafe_code)]

mod app;
mod bare;
mod clock;
mod gauge;
mod piece;
mod pretend;
mod quic;
mod relay;
mod socket;

pub use app::{AppBindError, AppEndpoint, AppListen, AppTransmit};
pub use bare::{BareEnd, BareError, BareLine, BareServer, BareTerms, Seen};
pub use clock::Clock;
pub use pretend::{
    Arena, Direction, Lane, Link, LinkCounts, LinkTerms, Rest, Share, Tally, TermsError,
};
pub use quic::{
    BindError, Certificate, CertificateError, ClientOptions, ConnectError, DATAGRAM_BYTES_MIN,
    Fingerprint, FingerprintError, QuicClient, QuicServer, Received, ServeError, ServerOptions,
    ServerStatistics, ServerWatch, Stop, TransportCode, Trust, WireStatistics,
};
pub use relay::{RelayError, UdpRelay};
