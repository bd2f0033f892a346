//! Certificates of a server: chains with keys, short-lived ones of browsers.
//!
//! A chain is not renewed, and no certificate authority is called. Invariant: key and chain of a `Certificate` belong
//! together.
//!
//! Browsers accept a pinned certificate only if it is valid for two weeks at most and its key is on the curve P-256. Each
//! serves for one period of the calendar, and is known a period before. Servers that share a folder keep them there, and so
//! show the same. Connections that stand keep theirs. Time is an argument here; `HandshakeCertificate` reads the clock. The
//! options name the origins of pages and the certificate.

use std::fmt;
use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime};

use quinn::rustls;
use rcgen::{CertificateParams, KeyPair, PKCS_ECDSA_P256_SHA256};
use rhumb_link::trust::{read_certificates, unreadable};
use rhumb_link::tuning::{ALPN, DRAFT_ALPN, WEB_ALPN};
use rhumb_link::{CertificateError, Fingerprint};
use ring::hmac;
use rustls::crypto::ring::default_provider;
use rustls::crypto::ring::sign::any_ecdsa_type;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer};
use rustls::server::{ClientHello, ResolvesServerCert};
use rustls::sign::{CertifiedKey, SingleCertAndKey};

use crate::web_request::Origins;

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
) -> Result<rcgen::CertifiedKey<KeyPair>, CertificateError> {
    let names: Vec<String> = names.into_iter().map(Into::into).collect();
    rcgen::generate_simple_self_signed(names).map_err(|cause| CertificateError::Development {
        cause: cause.into(),
    })
}

/// Time for which a certificate serves: a period. It is valid an hour longer on either side.
const SERVES: Duration = Duration::from_hours(6 * 24);
/// A browser's clock may be so far behind or ahead.
const CLOCK_SLACK: Duration = Duration::from_hours(1);

const DAY: u64 = 24 * 60 * 60;
// Browsers refuse a certificate that is valid for more than 14 days.
const _: () = assert!(SERVES.as_secs() + 2 * CLOCK_SLACK.as_secs() <= 13 * DAY);

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
    source: WebSource,
    /// Periods since 1970.
    period: u64,
    serving: WebCertificate,
    next: WebCertificate,
}

/// Where certificates for browsers come from.
struct WebSource {
    names: Vec<String>,
    /// The folder that keeps them; without it, each process has its own.
    folder: Option<PathBuf>,
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

    /// Two certificates for `names`, which a folder keeps if one is given.
    fn new(names: Vec<String>, folder: Option<PathBuf>) -> Result<Self, CertificateError> {
        let pair = Pair::new(WebSource { names, folder }, now())?;
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
    fn new(source: WebSource, now: SystemTime) -> Result<Self, CertificateError> {
        let period = period_of(now);
        Ok(Self {
            serving: source.certificate(period)?,
            next: source.certificate(period + 1)?,
            source,
            period,
        })
    }

    /// Replaces certificates that have served their time.
    fn rotate(&mut self, now: SystemTime) -> Result<(), CertificateError> {
        let period = period_of(now);
        if period == self.period {
            return Ok(());
        }
        let next = self.source.certificate(period + 1)?;
        self.serving = match period == self.period + 1 {
            true => self.next.clone(),
            false => self.source.certificate(period)?,
        };
        self.next = next;
        self.period = period;
        self.source.forget_before(period);
        Ok(())
    }
}

impl WebSource {
    /// The certificate of a period: the one that is kept, if there is one.
    fn certificate(&self, period: u64) -> Result<WebCertificate, CertificateError> {
        let Some(folder) = &self.folder else {
            return WebCertificate::parse(&self.make(period)?);
        };
        let path = folder.join(file_of(period));
        let failed = |cause: io::Error| CertificateError::Development {
            cause: format!("{}: {cause}", path.display()).into(),
        };
        if !path.exists() {
            keep(&path, self.make(period)?.as_bytes()).map_err(failed)?;
        }
        WebCertificate::parse(&fs::read_to_string(&path).map_err(failed)?)
    }

    /// A certificate and its key as PEM.
    fn make(&self, period: u64) -> Result<String, CertificateError> {
        let failed = |cause: rcgen::Error| CertificateError::Development {
            cause: cause.into(),
        };
        let begin = SystemTime::UNIX_EPOCH + Duration::from_secs(period * SERVES.as_secs());
        let key = KeyPair::generate_for(&PKCS_ECDSA_P256_SHA256).map_err(failed)?;
        let mut params = CertificateParams::new(self.names.clone()).map_err(failed)?;
        params.not_before = (begin - CLOCK_SLACK).into();
        params.not_after = (begin + SERVES + CLOCK_SLACK).into();
        let made = params.self_signed(&key).map_err(failed)?;
        Ok(made.pem() + &key.serialize_pem())
    }

    /// Removes the one that has served. What cannot be removed harms nothing.
    fn forget_before(&self, period: u64) {
        if let (Some(folder), Some(last)) = (&self.folder, period.checked_sub(1)) {
            let path = folder.join(file_of(last));
            if let Err(cause) = fs::remove_file(&path) {
                tracing::debug!(path = %path.display(), %cause, "an old certificate stays");
            }
        }
    }
}

fn period_of(now: SystemTime) -> u64 {
    // A clock before 1970 is in its first period.
    let since = now.duration_since(SystemTime::UNIX_EPOCH);
    since.unwrap_or_default().as_secs() / SERVES.as_secs()
}

fn file_of(period: u64) -> String {
    format!("browser-certificate-{period}.pem")
}

/// Writes a secret file as a whole, unless another server has written it.
fn keep(path: &Path, bytes: &[u8]) -> io::Result<()> {
    // Servers in containers may have the same process id; a key of its own names each one's file.
    let temporary = path.with_extension(format!("{}.tmp", Fingerprint::of(bytes)));
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt;
        options.mode(0o600);
    }
    let mut file = options.open(&temporary)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    let kept = match fs::hard_link(&temporary, path) {
        Err(cause) if cause.kind() == io::ErrorKind::AlreadyExists => Ok(()),
        linked => linked,
    };
    fs::remove_file(&temporary)?;
    kept
}

impl WebCertificate {
    fn parse(pem: &str) -> Result<Self, CertificateError> {
        let failed = |cause: rustls::pki_types::pem::Error| CertificateError::Development {
            cause: format!("a certificate for browsers: {cause}").into(),
        };
        let certificate = CertificateDer::from_pem_slice(pem.as_bytes()).map_err(failed)?;
        let key = PrivateKeyDer::from_pem_slice(pem.as_bytes()).map_err(failed)?;
        let signing = any_ecdsa_type(&key).map_err(|cause| CertificateError::Development {
            cause: cause.into(),
        })?;
        Ok(Self {
            fingerprint: Fingerprint::of(&certificate),
            key: Arc::new(CertifiedKey::new(vec![certificate], signing)),
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
    /// The same, kept in a folder: servers that share it show the same ones.
    Kept(Vec<String>, PathBuf),
}

impl WebIdentity {
    pub(crate) fn hashes(&self) -> Result<CertificateHashes, CertificateError> {
        match self {
            Self::Own => Ok(CertificateHashes::none()),
            Self::Pinned(names) => CertificateHashes::new(names.clone(), None),
            Self::Kept(names, folder) => {
                CertificateHashes::new(names.clone(), Some(folder.clone()))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first day is that of a period.
    fn day(days: u64) -> SystemTime {
        SystemTime::UNIX_EPOCH + Duration::from_secs(19_998 * DAY + days * DAY)
    }

    fn source(folder: Option<&Path>) -> WebSource {
        WebSource {
            names: vec!["localhost".into()],
            folder: folder.map(Path::to_owned),
        }
    }

    fn prints(pair: &Pair) -> [Fingerprint; 2] {
        [pair.serving.fingerprint, pair.next.fingerprint]
    }

    #[test]
    fn a_certificate_is_announced_for_as_long_as_it_serves() {
        let mut pair = Pair::new(source(None), day(0)).unwrap();
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
        let mut pair = Pair::new(source(None), day(0)).unwrap();
        let before = prints(&pair);
        pair.rotate(day(13)).unwrap();
        assert!(prints(&pair).iter().all(|print| !before.contains(print)));
    }

    #[test]
    fn servers_that_share_a_folder_show_the_same_certificates() {
        let folder = tempfile::tempdir().unwrap();
        let of = |day| Pair::new(source(Some(folder.path())), day).unwrap();
        let (mut one, other) = (of(day(0)), of(day(5)));
        assert_eq!(prints(&one), prints(&other));
        one.rotate(day(6)).unwrap();
        assert_eq!(prints(&one), prints(&of(day(7))));
        assert_eq!(prints(&one)[0], prints(&other)[1]);
        let mut kept: Vec<_> = fs::read_dir(folder.path())
            .unwrap()
            .map(|file| file.unwrap().file_name())
            .collect();
        kept.sort();
        assert_eq!(kept, [file_of(3_334).as_str(), file_of(3_335).as_str()]);
    }

    #[test]
    fn a_clock_that_goes_back_to_its_beginning_gets_a_certificate() {
        let folder = tempfile::tempdir().unwrap();
        let mut pair = Pair::new(source(Some(folder.path())), day(0)).unwrap();
        let before = prints(&pair);
        pair.rotate(SystemTime::UNIX_EPOCH).unwrap();
        assert_ne!(prints(&pair), before);
        assert!(folder.path().join(file_of(0)).exists());
    }

    #[test]
    fn a_certificate_that_another_server_has_just_kept_is_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(file_of(1));
        keep(&path, b"first").unwrap();
        keep(&path, b"second").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"first");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
