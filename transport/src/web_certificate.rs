//! Short-lived certificates that a browser accepts by their hash; options.
//!
//! Browsers accept a pinned certificate only if it is valid for two weeks at most and its key is on the curve P-256. A
//! certificate that is made now serves half a lifetime later, so that its hash is known before it serves. Connections
//! that stand keep theirs. Time is an argument here; `HandshakeCertificate` reads the clock. The options name the
//! origins of pages and the certificate.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime};

use quinn::rustls;
use rcgen::{CertificateParams, KeyPair, PKCS_ECDSA_P256_SHA256};
use rhumb_link::tuning::WEB_ALPN;
use rhumb_link::{CertificateError, Fingerprint};
use rustls::crypto::ring::sign::any_ecdsa_type;
use rustls::pki_types::{PrivateKeyDer, PrivatePkcs8KeyDer};
use rustls::server::{ClientHello, ResolvesServerCert};
use rustls::sign::CertifiedKey;

use crate::origins::Origins;

/// Time for which a certificate serves. It is valid for two of these, and an hour on either side.
const SERVES: Duration = Duration::from_hours(6 * 24);
/// A browser's clock may be so far behind or ahead.
const CLOCK_SLACK: Duration = Duration::from_hours(1);

const DAY: u64 = 24 * 60 * 60;
// Browsers refuse a certificate that is valid for more than 14 days.
const _: () = assert!(2 * SERVES.as_secs() + 2 * CLOCK_SLACK.as_secs() <= 13 * DAY);

/// The hashes of the certificates that browsers may be shown; all clones are one.
///
/// Give them to pages that connect: the first is of the certificate that serves now, the second of the one that
/// follows.
#[derive(Clone)]
pub struct CertificateHashes {
    pair: Option<Arc<Mutex<Pair>>>,
}

/// The certificate that serves, and the one that follows.
struct Pair {
    names: Vec<String>,
    serving: WebCertificate,
    next: WebCertificate,
    /// The moment from which the next one serves.
    until: SystemTime,
}

#[derive(Clone)]
struct WebCertificate {
    key: Arc<CertifiedKey>,
    fingerprint: Fingerprint,
}

/// Chooses the certificate of a handshake: a short-lived one for browsers, the server's own for all others.
pub(crate) struct HandshakeCertificate {
    own: Arc<CertifiedKey>,
    web: CertificateHashes,
}

impl CertificateHashes {
    /// None: browsers are shown the server's own certificate.
    pub(crate) const fn none() -> Self {
        Self { pair: None }
    }

    /// Makes two certificates for `names`.
    pub(crate) fn new(names: Vec<String>) -> Result<Self, CertificateError> {
        let pair = Pair::new(names, now())?;
        Ok(Self {
            pair: Some(Arc::new(Mutex::new(pair))),
        })
    }

    /// The hashes that a page may pin now; empty if browsers are shown a certificate of an authority.
    ///
    /// A page can connect with them for six days at least.
    #[must_use]
    pub fn current(&self) -> Vec<Fingerprint> {
        self.with_pair(|pair| vec![pair.serving.fingerprint, pair.next.fingerprint])
            .unwrap_or_default()
    }

    fn serving(&self) -> Option<Arc<CertifiedKey>> {
        self.with_pair(|pair| Arc::clone(&pair.serving.key))
    }

    fn with_pair<T>(&self, read: impl FnOnce(&Pair) -> T) -> Option<T> {
        let pair = self.pair.as_ref()?;
        // A pair is whole between any two statements that change it.
        let mut pair = pair.lock().unwrap_or_else(PoisonError::into_inner);
        if let Err(cause) = pair.rotate(now()) {
            tracing::error!(%cause, "the certificate for browsers is not renewed");
        }
        Some(read(&pair))
    }
}

impl Pair {
    fn new(names: Vec<String>, now: SystemTime) -> Result<Self, CertificateError> {
        Ok(Self {
            serving: WebCertificate::new(&names, now)?,
            next: WebCertificate::new(&names, now)?,
            names,
            until: now + SERVES,
        })
    }

    /// Replaces certificates that have served their time.
    fn rotate(&mut self, now: SystemTime) -> Result<(), CertificateError> {
        if now < self.until {
            return Ok(());
        }
        let made = WebCertificate::new(&self.names, now)?;
        // After a long time without a connection, the next one has expired too.
        if now >= self.until + SERVES {
            self.serving = WebCertificate::new(&self.names, now)?;
        } else {
            self.serving = self.next.clone();
        }
        self.next = made;
        self.until = now + SERVES;
        Ok(())
    }
}

impl WebCertificate {
    fn new(names: &[String], now: SystemTime) -> Result<Self, CertificateError> {
        let failed = |cause: rcgen::Error| CertificateError::Development {
            cause: cause.into(),
        };
        let key = KeyPair::generate_for(&PKCS_ECDSA_P256_SHA256).map_err(failed)?;
        let mut params = CertificateParams::new(names.to_vec()).map_err(failed)?;
        params.not_before = (now - CLOCK_SLACK).into();
        params.not_after = (now + 2 * SERVES + CLOCK_SLACK).into();
        let made = params.self_signed(&key).map_err(failed)?;
        let der = PrivateKeyDer::from(PrivatePkcs8KeyDer::from(key.serialize_der()));
        let signing = any_ecdsa_type(&der).expect("a key made for P-256 signs");
        Ok(Self {
            fingerprint: Fingerprint::of(made.der()),
            key: Arc::new(CertifiedKey::new(vec![made.der().clone()], signing)),
        })
    }
}

impl HandshakeCertificate {
    pub(crate) const fn new(own: Arc<CertifiedKey>, web: CertificateHashes) -> Self {
        Self { own, web }
    }
}

impl ResolvesServerCert for HandshakeCertificate {
    fn resolve(&self, hello: ClientHello<'_>) -> Option<Arc<CertifiedKey>> {
        let is_browser = (hello.alpn()).is_some_and(|mut names| names.any(|name| name == WEB_ALPN));
        let web = is_browser.then(|| self.web.serving()).flatten();
        Some(web.unwrap_or_else(|| Arc::clone(&self.own)))
    }
}

fn now() -> SystemTime {
    SystemTime::now()
}

impl fmt::Debug for CertificateHashes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.current()).finish()
    }
}

impl fmt::Debug for HandshakeCertificate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("HandshakeCertificate")
            .field("web", &self.web)
            .finish_non_exhaustive()
    }
}

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
    pub(crate) fn hashes(&self) -> Result<CertificateHashes, CertificateError> {
        match self {
            Self::Own => Ok(CertificateHashes::none()),
            Self::Pinned(names) => CertificateHashes::new(names.clone()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn day(days: u64) -> SystemTime {
        SystemTime::UNIX_EPOCH + Duration::from_secs(20_000 * DAY + days * DAY)
    }

    fn prints(pair: &Pair) -> [Fingerprint; 2] {
        [pair.serving.fingerprint, pair.next.fingerprint]
    }

    #[test]
    fn a_certificate_is_announced_for_as_long_as_it_serves() {
        let mut pair = Pair::new(vec!["localhost".into()], day(0)).unwrap();
        let [first, second] = prints(&pair);
        assert_ne!(first, second);
        pair.rotate(day(5)).unwrap();
        assert_eq!(prints(&pair), [first, second]);
        pair.rotate(day(6)).unwrap();
        let [serving, third] = prints(&pair);
        assert_eq!(serving, second);
        pair.rotate(day(12)).unwrap();
        assert_eq!(prints(&pair)[0], third);
    }

    #[test]
    fn after_a_long_silence_no_expired_certificate_serves() {
        let mut pair = Pair::new(vec!["localhost".into()], day(0)).unwrap();
        let before = prints(&pair);
        pair.rotate(day(13)).unwrap();
        assert!(prints(&pair).iter().all(|print| !before.contains(print)));
    }
}
