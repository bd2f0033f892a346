//! Authentication of a server by its client.
//!
//! Either a pinned certificate or trusted roots, from a file. A pin never waives the proof that the server has the
//! certificate's key. A refusal is stored, so that the caller learns more than an alert number.

use std::error::Error;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::{Arc, OnceLock};

use quinn::rustls;
use ring::digest;
use rustls::client::WebPkiServerVerifier;
use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::crypto::ring::default_provider;
use rustls::crypto::{CryptoProvider, verify_tls12_signature, verify_tls13_signature};
use rustls::pki_types::pem::{Error as PemError, PemObject};
use rustls::pki_types::{CertificateDer, ServerName, UnixTime};
use rustls::{CertificateError as Refusal, DigitallySignedStruct, RootCertStore, SignatureScheme};

use crate::tuning::{ALPN, DRAFT_ALPN};

/// Condition under which a certificate is trusted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Trust {
    /// The certificate has this fingerprint.
    Fingerprint(Fingerprint),
    /// A root of this PEM file signed the certificate for the server's name.
    Roots(PathBuf),
}

/// Reason why a certificate is not trusted.
#[derive(Clone, Debug)]
pub enum Distrust {
    /// The certificate is not the pinned one.
    OtherFingerprint {
        expected: Fingerprint,
        presented: Fingerprint,
    },
    /// No root signed the certificate.
    Roots(rustls::Error),
}

/// Stores the refusal of a verifier.
#[derive(Clone, Debug, Default)]
pub struct CertificateCheck {
    refused: Arc<OnceLock<Distrust>>,
}

impl CertificateCheck {
    /// Reason of the refusal, if the certificate was refused.
    pub fn refusal(&self) -> Option<&Distrust> {
        self.refused.get()
    }
}

/// The client's TLS configuration, and the place of its refusal.
///
/// # Errors
///
/// The file of roots cannot be used.
pub fn tls(
    trust: &Trust,
) -> Result<(Arc<rustls::ClientConfig>, CertificateCheck), CertificateError> {
    let provider = Arc::new(default_provider());
    let trust_policy = match trust {
        Trust::Fingerprint(expected) => TrustPolicy::Pin(*expected),
        Trust::Roots(file) => TrustPolicy::Roots(roots(file, &provider)?),
    };
    let certificate_check = CertificateCheck::default();
    let verifier = Verifier {
        trust_policy,
        provider: Arc::clone(&provider),
        certificate_check: certificate_check.clone(),
    };
    let mut tls = rustls::ClientConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&rustls::version::TLS13])
        .expect("the ring provider speaks TLS 1.3")
        .dangerous()
        .with_custom_certificate_verifier(Arc::new(verifier))
        .with_no_client_auth();
    tls.alpn_protocols = vec![DRAFT_ALPN.to_vec(), ALPN.to_vec()];
    tls.resumption = rustls::client::Resumption::disabled();
    Ok((Arc::new(tls), certificate_check))
}

/// The client's TLS configuration alone, for the raw peers of tests.
///
/// # Errors
///
/// The file of roots cannot be used.
pub fn client_tls(trust: &Trust) -> Result<Arc<rustls::ClientConfig>, CertificateError> {
    tls(trust).map(|(tls, _)| tls)
}

fn roots(
    file: &Path,
    provider: &Arc<CryptoProvider>,
) -> Result<Arc<WebPkiServerVerifier>, CertificateError> {
    let refused = |cause| CertificateError::Root {
        file: file.to_owned(),
        cause,
    };
    let mut store = RootCertStore::empty();
    for root in read_certificates(file)? {
        store.add(root).map_err(refused)?;
    }
    WebPkiServerVerifier::builder_with_provider(Arc::new(store), Arc::clone(provider))
        .build()
        .map_err(|cause| refused(rustls::Error::General(cause.to_string())))
}

#[derive(Debug)]
enum TrustPolicy {
    Pin(Fingerprint),
    Roots(Arc<WebPkiServerVerifier>),
}

#[derive(Debug)]
struct Verifier {
    trust_policy: TrustPolicy,
    provider: Arc<CryptoProvider>,
    certificate_check: CertificateCheck,
}

impl ServerCertVerifier for Verifier {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        intermediates: &[CertificateDer<'_>],
        server_name: &ServerName<'_>,
        ocsp_response: &[u8],
        now: UnixTime,
    ) -> Result<ServerCertVerified, rustls::Error> {
        let distrust = match &self.trust_policy {
            TrustPolicy::Pin(expected) => {
                let presented = Fingerprint::of(end_entity);
                if presented == *expected {
                    return Ok(ServerCertVerified::assertion());
                }
                Distrust::OtherFingerprint {
                    expected: *expected,
                    presented,
                }
            }
            TrustPolicy::Roots(roots) => {
                match roots.verify_server_cert(
                    end_entity,
                    intermediates,
                    server_name,
                    ocsp_response,
                    now,
                ) {
                    Ok(verified) => return Ok(verified),
                    Err(cause) => Distrust::Roots(cause),
                }
            }
        };
        let cause = match &distrust {
            Distrust::OtherFingerprint { .. } => Refusal::ApplicationVerificationFailure.into(),
            Distrust::Roots(cause) => cause.clone(),
        };
        // One handshake per verifier: an earlier refusal cannot exist.
        let _ = self.certificate_check.refused.set(distrust);
        Err(cause)
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        cert: &CertificateDer<'_>,
        dss: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        verify_tls12_signature(
            message,
            cert,
            dss,
            &self.provider.signature_verification_algorithms,
        )
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        cert: &CertificateDer<'_>,
        dss: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        verify_tls13_signature(
            message,
            cert,
            dss,
            &self.provider.signature_verification_algorithms,
        )
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.provider
            .signature_verification_algorithms
            .supported_schemes()
    }
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
        /// The error of the generator, which clients do not have.
        cause: Box<dyn Error + Send + Sync>,
    },
}

/// All certificates of a PEM file; at least one.
pub fn read_certificates(file: &Path) -> Result<Vec<CertificateDer<'static>>, CertificateError> {
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

/// The error of a file that is not PEM.
pub fn unreadable(file: &Path, cause: PemError) -> CertificateError {
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

impl Error for CertificateError {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        match self {
            Self::Unreadable { cause, .. } => Some(cause),
            Self::NoCertificate { .. } => None,
            Self::Unusable { cause, .. } | Self::Root { cause, .. } => Some(cause),
            Self::Development { cause } => Some(&**cause),
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

impl Error for FingerprintError {}

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
