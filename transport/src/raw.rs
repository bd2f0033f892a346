//! Sockets and TLS without the bounds of a session, for tests.

use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;

use quinn::rustls;
use tokio::runtime::Runtime;

use crate::quic::{self, Certificate, CertificateError, Trust};
use crate::socket;

/// The application protocol, as TLS names it.
pub const ALPN: &[u8] = quic::ALPN;

/// Binds a socket with buffers that hold a tick's burst.
///
/// # Errors
///
/// When the address cannot be bound.
pub fn bind(address: SocketAddr) -> io::Result<UdpSocket> {
    socket::bind(address)
}

/// The runtime of one I/O thread.
///
/// # Errors
///
/// When the system gives no event queue.
pub fn runtime() -> io::Result<Runtime> {
    socket::runtime()
}

/// The TLS side of a client that trusts so.
///
/// # Errors
///
/// [`CertificateError`] when the roots cannot be read.
pub fn client_tls(trust: &Trust) -> Result<Arc<rustls::ClientConfig>, CertificateError> {
    quic::client_tls(trust)
}

/// The TLS side of a server with this certificate.
#[must_use]
pub fn server_tls(certificate: &Certificate) -> Arc<rustls::ServerConfig> {
    certificate.tls()
}
