//! TLS without the bounds of a session, for tests.

use std::sync::Arc;

use quinn::rustls;

use crate::quic::{self, Certificate, CertificateError, Trust};

/// The application protocol, as TLS names it.
pub const ALPN: &[u8] = quic::ALPN;

/// The TLS side of a client with this trust.
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
