//! A server's certificate chain and its key; a fingerprint to pin.
//!
//! Renews nothing and calls no certificate authority. Invariant: key and chain of a `Certificate` belong together. A
//! fingerprint decides no trust by itself; see `trust`.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

use quinn::rustls;
use ring::{digest, hmac};
use rustls::crypto::ring::default_provider;
use rustls::pki_types::pem::{Error as PemError, PemObject};
use rustls::pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer};
use rustls::server::ResolvesServerCert;
use rustls::sign::{CertifiedKey, SingleCertAndKey};

use super::tuning::{ALPN, DRAFT_ALPN};

/// A server's certificate with its key, ready to serve.
#[derive(Clone, Debug)]
pub struct Certificate {
    key: Arc<CertifiedKey>,
    fingerprint: Fingerprint,
    reset_key: hmac::Key,
}

/// Reason why a certificate or a root cannot be used.
#[derive(Debug)]
pub enum CertificateError {
    /// The file cannot be read, or is not PEM.
    Unreadable {
        /// The file.
        file: PathBuf,
        /// The parser's error.
        cause: PemError,
    },
    /// The file has no certificate.
    NoCertificate {
        /// The file.
        file: PathBuf,
    },
    /// The certificate cannot serve, or the key is not its key.
    Unusable {
        /// The file of the chain.
        certificate: PathBuf,
        /// The file of the key.
        key: PathBuf,
        /// The TLS error.
        cause: rustls::Error,
    },
    /// A root in this file cannot be trusted.
    Root {
        /// The file.
        file: PathBuf,
        /// The TLS error.
        cause: rustls::Error,
    },
    /// No certificate can be made for these names.
    Development {
        /// The generator's error.
        cause: rcgen::Error,
    },
}

impl Certificate {
    /// Makes a self-signed certificate for `names` (host names or addresses), new at each call, for clients to pin.
    ///
    /// # Errors
    ///
    /// [`CertificateError::Development`] if a name is invalid.
    pub fn development<N: Into<String>>(
        names: impl IntoIterator<Item = N>,
    ) -> Result<Self, CertificateError> {
        let made = generate(names)?;
        let key = PrivatePkcs8KeyDer::from(made.signing_key.serialize_der());
        let made = Self::new(vec![made.cert.der().clone()], key.into());
        Ok(made.expect("a certificate made with its key belongs to it"))
    }

    /// Reads a chain (the server's own certificate first) and its key from PEM files.
    ///
    /// # Errors
    ///
    /// [`CertificateError`] names the file that is missing, not PEM, or does not fit the other.
    pub fn from_pem_files(
        certificate: impl AsRef<Path>,
        key: impl AsRef<Path>,
    ) -> Result<Self, CertificateError> {
        let (certificate, key) = (certificate.as_ref(), key.as_ref());
        let chain = read_certificates(certificate)?;
        let secret = PrivateKeyDer::from_pem_file(key).map_err(|cause| unreadable(key, cause))?;
        Self::new(chain, secret).map_err(|cause| CertificateError::Unusable {
            certificate: certificate.to_owned(),
            key: key.to_owned(),
            cause,
        })
    }

    /// The fingerprint for clients to pin.
    #[must_use]
    pub fn fingerprint(&self) -> Fingerprint {
        self.fingerprint
    }

    /// Key of the tokens that end connections of an earlier process: the same for the same private key, so that clients
    /// of a server that crashed learn of it at their next packet.
    pub(crate) fn reset_key(&self) -> hmac::Key {
        self.reset_key.clone()
    }

    /// The TLS configuration of a server of plain clients alone.
    pub(crate) fn tls(&self) -> Arc<rustls::ServerConfig> {
        server_tls(
            Arc::new(SingleCertAndKey::from(self.key())),
            &[DRAFT_ALPN, ALPN],
        )
    }

    pub(super) fn key(&self) -> Arc<CertifiedKey> {
        Arc::clone(&self.key)
    }

    fn new(
        chain: Vec<CertificateDer<'static>>,
        key: PrivateKeyDer<'static>,
    ) -> Result<Self, rustls::Error> {
        let fingerprint = Fingerprint::of(
            chain
                .first()
                .ok_or(rustls::Error::NoCertificatesPresented)?,
        );
        let secret = hmac::Key::new(hmac::HMAC_SHA256, key.secret_der());
        let reset_key = hmac::sign(&secret, b"rhumb stateless reset");
        Ok(Self {
            key: Arc::new(CertifiedKey::from_der(chain, key, &default_provider())?),
            fingerprint,
            reset_key: hmac::Key::new(hmac::HMAC_SHA256, reset_key.as_ref()),
        })
    }
}

/// The TLS configuration of a server that serves these protocols.
pub(super) fn server_tls(
    certificates: Arc<dyn ResolvesServerCert>,
    protocols: &[&[u8]],
) -> Arc<rustls::ServerConfig> {
    let mut tls = rustls::ServerConfig::builder_with_provider(Arc::new(default_provider()))
        .with_protocol_versions(&[&rustls::version::TLS13])
        .expect("the ring provider speaks TLS 1.3")
        .with_no_client_auth()
        .with_cert_resolver(certificates);
    tls.alpn_protocols = protocols.iter().map(|name| name.to_vec()).collect();
    // No session is resumed: commands must not ride on replayable data, and tickets cost bytes at each join.
    tls.send_tls13_tickets = 0;
    Arc::new(tls)
}

/// A self-signed certificate and its key, as PEM texts to keep in files.
#[derive(Clone)]
pub struct DevelopmentPem {
    /// The certificate.
    pub certificate: String,
    /// Its private key, which is secret.
    pub key: String,
}

impl DevelopmentPem {
    /// Makes a certificate for `names` (host names or addresses), new at each call.
    ///
    /// # Errors
    ///
    /// [`CertificateError::Development`] if a name is invalid.
    pub fn new<N: Into<String>>(
        names: impl IntoIterator<Item = N>,
    ) -> Result<Self, CertificateError> {
        let made = generate(names)?;
        Ok(Self {
            certificate: made.cert.pem(),
            key: made.signing_key.serialize_pem(),
        })
    }
}

fn generate<N: Into<String>>(
    names: impl IntoIterator<Item = N>,
) -> Result<rcgen::CertifiedKey<rcgen::KeyPair>, CertificateError> {
    let names: Vec<String> = names.into_iter().map(Into::into).collect();
    rcgen::generate_simple_self_signed(names)
        .map_err(|cause| CertificateError::Development { cause })
}

/// All certificates of a PEM file; at least one.
pub(super) fn read_certificates(
    file: &Path,
) -> Result<Vec<CertificateDer<'static>>, CertificateError> {
    let found: Result<Vec<_>, PemError> =
        CertificateDer::pem_file_iter(file).and_then(Iterator::collect);
    let found = found.map_err(|cause| unreadable(file, cause))?;
    if found.is_empty() {
        return Err(CertificateError::NoCertificate {
            file: file.to_owned(),
        });
    }
    Ok(found)
}

fn unreadable(file: &Path, cause: PemError) -> CertificateError {
    CertificateError::Unreadable {
        file: file.to_owned(),
        cause,
    }
}

impl fmt::Display for CertificateError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreadable { file, cause } => {
                write!(f, "cannot read {} as pem: {cause}", file.display())
            }
            Self::NoCertificate { file } => write!(f, "{} has no certificate", file.display()),
            Self::Unusable {
                certificate,
                key,
                cause,
            } => write!(
                f,
                "cannot serve with certificate {} and key {}: {cause}",
                certificate.display(),
                key.display()
            ),
            Self::Root { file, cause } => {
                write!(f, "cannot trust the roots of {}: {cause}", file.display())
            }
            Self::Development { cause } => {
                write!(f, "cannot make a development certificate: {cause}")
            }
        }
    }
}

impl std::error::Error for CertificateError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Unreadable { cause, .. } => Some(cause),
            Self::NoCertificate { .. } => None,
            Self::Unusable { cause, .. } | Self::Root { cause, .. } => Some(cause),
            Self::Development { cause } => Some(cause),
        }
    }
}

/// SHA-256 of a server's own certificate in DER form.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Fingerprint(pub [u8; 32]);

/// Error of a written fingerprint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FingerprintError {
    /// The text has this many characters rather than 64.
    Length(usize),
    /// The character at this place is not a hexadecimal digit.
    Digit(usize),
}

impl Fingerprint {
    /// The fingerprint of a certificate in DER form.
    #[must_use]
    pub fn of(certificate_der: &[u8]) -> Self {
        let digest = digest::digest(&digest::SHA256, certificate_der);
        let mut bytes = [0; 32];
        bytes.copy_from_slice(digest.as_ref());
        Self(bytes)
    }
}

impl fmt::Display for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl FromStr for Fingerprint {
    type Err = FingerprintError;

    fn from_str(text: &str) -> Result<Self, FingerprintError> {
        let digits = text.as_bytes();
        if digits.len() != 64 {
            return Err(FingerprintError::Length(digits.len()));
        }
        let mut bytes = [0; 32];
        for (at, &digit) in digits.iter().enumerate() {
            let value = char::from(digit)
                .to_digit(16)
                .ok_or(FingerprintError::Digit(at))?;
            bytes[at / 2] = bytes[at / 2] << 4 | value as u8;
        }
        Ok(Self(bytes))
    }
}

impl fmt::Display for FingerprintError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length(have) => {
                write!(f, "a fingerprint is 64 hexadecimal digits, this has {have}")
            }
            Self::Digit(at) => write!(
                f,
                "character {} of the fingerprint is not a hexadecimal digit",
                at + 1
            ),
        }
    }
}

impl std::error::Error for FingerprintError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_displayed_fingerprint_parses_back() {
        let print = Fingerprint::of(b"abc");
        let text = print.to_string();
        assert_eq!(
            text,
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        );
        assert_eq!(text.parse(), Ok(print));
        assert_eq!(text.to_uppercase().parse(), Ok(print));
    }

    #[test]
    fn a_malformed_fingerprint_error_names_the_fault() {
        assert_eq!(
            "ab".parse::<Fingerprint>(),
            Err(FingerprintError::Length(2))
        );
        let text = "0".repeat(9) + "x" + &"0".repeat(54);
        assert_eq!(text.parse::<Fingerprint>(), Err(FingerprintError::Digit(9)));
    }
}
