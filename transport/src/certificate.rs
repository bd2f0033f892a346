//! A server's certificate chain and its key.
//!
//! Renews nothing and calls no certificate authority. Invariant: key and chain of a `Certificate` belong together.

use std::path::Path;
use std::sync::Arc;

use quinn::rustls;
use rhumb_link::trust::{read_certificates, unreadable};
use rhumb_link::tuning::{ALPN, DRAFT_ALPN};
use rhumb_link::{CertificateError, Fingerprint};
use ring::hmac;
use rustls::crypto::ring::default_provider;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer};
use rustls::server::ResolvesServerCert;
use rustls::sign::{CertifiedKey, SingleCertAndKey};

/// A server's certificate with its key, ready to serve.
#[derive(Clone, Debug)]
pub struct Certificate {
    key: Arc<CertifiedKey>,
    fingerprint: Fingerprint,
    reset_key: hmac::Key,
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
    #[doc(hidden)]
    #[must_use]
    pub fn tls(&self) -> Arc<rustls::ServerConfig> {
        server_tls(
            Arc::new(SingleCertAndKey::from(self.key())),
            &[DRAFT_ALPN, ALPN],
        )
    }

    pub(crate) fn key(&self) -> Arc<CertifiedKey> {
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
pub(crate) fn server_tls(
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
    rcgen::generate_simple_self_signed(names).map_err(|cause| CertificateError::Development {
        cause: cause.into(),
    })
}
