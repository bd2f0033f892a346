//! Options for browsers: origins of pages, and a certificate.

use super::certificate::CertificateError;
use super::origins::Origins;
use super::web_certificate::CertificateHashes;

/// A server's options for browsers.
#[derive(Clone, Debug)]
pub struct WebOptions {
    /// The pages that may connect.
    pub origins: Origins,
    /// The certificate that browsers are shown.
    pub certificate: WebIdentity,
}

/// The certificate that browsers are shown.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum WebIdentity {
    /// The server's own: an authority that browsers know has signed it.
    Own,
    /// Short-lived ones for these names (host names or addresses), which pages pin by their hashes.
    Pinned(Vec<String>),
}

impl WebIdentity {
    pub(super) fn hashes(&self) -> Result<CertificateHashes, CertificateError> {
        match self {
            Self::Own => Ok(CertificateHashes::none()),
            Self::Pinned(names) => CertificateHashes::new(names.clone()),
        }
    }
}
