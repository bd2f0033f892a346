//! Authentication of a server by its client.
//!
//! Either a pinned certificate or trusted roots. A pin never waives the proof that the server has the certificate's
//! key. A refusal is stored, so that the caller learns more than an alert number.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use quinn::rustls;
use rustls::client::WebPkiServerVerifier;
use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::crypto::ring::default_provider;
use rustls::crypto::{CryptoProvider, verify_tls12_signature, verify_tls13_signature};
use rustls::pki_types::{CertificateDer, ServerName, UnixTime};
use rustls::{CertificateError as Refusal, DigitallySignedStruct, RootCertStore, SignatureScheme};

use super::certificate::{CertificateError, Fingerprint, read_certificates};
use super::tuning::{ALPN, DRAFT_ALPN};

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
pub(super) enum Distrust {
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
pub(super) struct CertificateCheck {
    refused: Arc<OnceLock<Distrust>>,
}

impl CertificateCheck {
    /// Reason of the refusal, if the certificate was refused.
    pub(super) fn refusal(&self) -> Option<&Distrust> {
        self.refused.get()
    }
}

/// The client's TLS configuration, and the place of its refusal.
///
/// # Errors
///
/// The file of roots cannot be used.
pub(super) fn tls(
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

/// The client's TLS configuration alone.
///
/// # Errors
///
/// The file of roots cannot be used.
#[cfg(feature = "raw")]
pub(crate) fn client_tls(trust: &Trust) -> Result<Arc<rustls::ClientConfig>, CertificateError> {
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
