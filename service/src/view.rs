//! The page in which scenes are seen, served over HTTP.
//!
//! Beside the page's files it answers what the page needs to connect, and conditions the link of the page's own
//! connections: these pass through a relay, and no other connection does. It refuses pages of other origins. The same page,
//! written with recordings, needs no server.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fmt;
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use hyper::header::{CONTENT_SECURITY_POLICY, HeaderName, HeaderValue};
use hyper::{Method, StatusCode};
use rhumb_transport::conditioner::{Direction, LinkConfig, RelayError, UdpRelay};
use serde::Serialize;

use crate::access::TokenIssuer;
use crate::http::{self, HttpAnswer, HttpRequest, TEXT, TcpService};
use crate::metrics::Metrics;

/// Sockets of the page: bound, but not yet answering.
#[derive(Debug)]
pub(crate) struct PageListener {
    listener: TcpListener,
    address: SocketAddr,
    relay: UdpRelay,
    /// Address of the server.
    listens: SocketAddr,
    /// True if scenes may move to other servers.
    is_shared: bool,
}

/// Reason why the page cannot be served.
#[derive(Debug)]
pub enum ViewError {
    /// This build has no page; the text says what to do.
    Unavailable(&'static str),
    /// Listening for the page's requests failed.
    Listen {
        /// The TCP address.
        address: SocketAddr,
        /// The system's error.
        cause: io::Error,
    },
    /// The relay of the page's connections cannot start.
    Relay(RelayError),
}

impl PageListener {
    /// Listens at a TCP address for a server at a UDP address.
    pub(crate) fn bind(address: SocketAddr, listens: SocketAddr) -> Result<Self, ViewError> {
        if let Some(reason) = rhumb_viewer::UNAVAILABLE {
            return Err(ViewError::Unavailable(reason));
        }
        let failed = |cause| ViewError::Listen { address, cause };
        let listener = TcpListener::bind(address).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let relay = UdpRelay::start(
            SocketAddr::new(listens.ip(), 0),
            reachable(listens),
            LinkConfig::PERFECT,
            SEED,
        );
        Ok(Self {
            listener,
            address,
            relay: relay.map_err(ViewError::Relay)?,
            listens,
            is_shared: false,
        })
    }

    /// Lets the page follow scenes to other servers.
    pub(crate) const fn share_scenes(&mut self) {
        self.is_shared = true;
    }

    /// Its address.
    pub(crate) const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Answers requests until the result is dropped.
    pub(crate) fn start(
        self,
        hashes: Hashes,
        (scenes, metrics): (Vec<ViewScene>, Metrics),
        issuer: Option<TokenIssuer>,
        now: fn() -> i64,
    ) -> io::Result<TcpService> {
        let page = Page {
            listens: self.listens,
            relay: self.relay,
            hashes,
            scenes,
            metrics,
            issuer,
            now,
            named: !self.address.ip().is_loopback(),
            is_shared: self.is_shared,
        };
        let answer = Arc::new(move |request: &HttpRequest| page.answer(request));
        http::start(self.listener, "rhumb-server-view", answer)
    }
}

/// Seed of the relay's links: chance need not differ from run to run.
const SEED: u64 = 1;

/// The address by which this machine reaches a server that may listen at every address.
fn reachable(listens: SocketAddr) -> SocketAddr {
    let ip = match listens.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
        ip => ip,
    };
    SocketAddr::new(ip, listens.port())
}

impl fmt::Display for ViewError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unavailable(reason) => write!(f, "this build has no page: {reason}"),
            Self::Listen { address, cause } => write!(
                f,
                "cannot serve the page at tcp {address}: {cause}; choose another address by --view ADDRESS"
            ),
            Self::Relay(cause) => write!(f, "cannot relay the page's connections: {cause}"),
        }
    }
}

impl std::error::Error for ViewError {}

/// Seconds for which the page's token is valid. The page gets another one when it connects again.
const TOKEN_SECONDS: i64 = 3_600;
/// The type of JSON.
const JSON: &str = "application/json";
/// Headers of every answer, with the policy of [`Page::policy`]: nothing guessed, nothing kept.
const HEADERS: [(&str, &str); 6] = [
    ("x-content-type-options", "nosniff"),
    ("referrer-policy", "no-referrer"),
    ("cross-origin-opener-policy", "same-origin"),
    ("cross-origin-embedder-policy", "require-corp"),
    ("cross-origin-resource-policy", "same-origin"),
    ("cache-control", "no-cache"),
];

/// Hashes of the certificates that browsers may be shown now, hexadecimal.
type Hashes = Box<dyn Fn() -> Vec<String> + Send + Sync>;

/// The sources of the page's answers.
struct Page {
    /// Address of the server.
    listens: SocketAddr,
    /// The page's connections pass through it.
    relay: UdpRelay,
    hashes: Hashes,
    /// Scenes that the server provides.
    scenes: Vec<ViewScene>,
    metrics: Metrics,
    /// Issues the page's tokens, if the server asks for tokens.
    issuer: Option<TokenIssuer>,
    /// Seconds since 1970.
    now: fn() -> i64,
    /// True if names of hosts are answered to, and not only addresses of this machine.
    named: bool,
    /// True if scenes may move to other servers.
    is_shared: bool,
}

impl Page {
    /// The answer to a request.
    fn answer(&self, request: &HttpRequest) -> HttpAnswer {
        let mut answer = self.answer_to(request);
        let policy = (CONTENT_SECURITY_POLICY, self.policy(request));
        let fixed = HEADERS.map(|(name, value)| {
            let name = HeaderName::from_static(name);
            (name, HeaderValue::from_static(value))
        });
        answer.headers = [policy].into_iter().chain(fixed).collect();
        answer
    }

    /// The page's rights: it connects to this server, and after a restart to the server's new ports. Of several servers it
    /// connects to any: a policy cannot name those that are to come.
    fn policy(&self, request: &HttpRequest) -> HeaderValue {
        let sources = request.host(self.named).map(|host| {
            let listens = [self.listens, self.relay.local_addr()];
            match self.is_shared {
                true => ANY_SERVER.to_owned(),
                false => listens.map(|listens| source(listens, host)).join(" "),
            }
        });
        let policy = rhumb_viewer::content_security_policy(&sources.unwrap_or_default());
        HeaderValue::from_str(&policy).unwrap_or(HeaderValue::from_static("default-src 'none'"))
    }

    fn answer_to(&self, request: &HttpRequest) -> HttpAnswer {
        let Some(host) = request.host(self.named) else {
            return HttpAnswer::refusal(
                StatusCode::FORBIDDEN,
                "open this page by the address that the server printed, not by another name",
            );
        };
        if let Some(origin) = request.foreign_origin() {
            return HttpAnswer::refusal(
                StatusCode::FORBIDDEN,
                format!(
                    "a page of {origin} may not use this view: open the address that the server printed"
                ),
            );
        }
        match (&request.method, request.path.as_str()) {
            (&Method::GET, "/connect.json") => self.facts(host),
            (&Method::GET, "/link") => HttpAnswer::ok(TEXT, self.relay.config().to_string()),
            (&Method::POST, "/link") => self.set_link(&request.body),
            (&Method::GET, "/link/counts") => HttpAnswer::ok(JSON, self.counts()),
            (&Method::GET, path) => match rhumb_viewer::asset(path) {
                Some(file) => HttpAnswer::ok(file.content_type, file.bytes),
                None => HttpAnswer::refusal(StatusCode::NOT_FOUND, "this page has no such file"),
            },
            _ => HttpAnswer::refusal(
                StatusCode::METHOD_NOT_ALLOWED,
                "GET, and POST for /link, are what there is",
            ),
        }
    }

    fn facts(&self, host: &str) -> HttpAnswer {
        let token = self.issuer.as_ref();
        let token = token.map(|issuer| issuer.observer("view", (self.now)(), TOKEN_SECONDS));
        let token = match token.transpose() {
            Ok(token) => token,
            Err(cause) => {
                tracing::error!(%cause, "no token for the page");
                return HttpAnswer::refusal(
                    StatusCode::INTERNAL_SERVER_ERROR,
                    "the server could not make a token: its log says why",
                );
            }
        };
        let mut scenes = self.scenes.clone();
        for name in self.metrics.scene_names() {
            if !scenes.iter().any(|scene| scene.name == name.as_str()) {
                scenes.push(ViewScene {
                    name: name.as_str().to_owned(),
                    player: None,
                });
            }
        }
        let facts = Facts {
            version: env!("CARGO_PKG_VERSION"),
            url: url(self.listens, host),
            conditioned_url: url(self.relay.local_addr(), host),
            certificate_hashes: (self.hashes)(),
            scenes,
            several: self.is_shared,
            token,
        };
        json(&facts)
    }

    /// Changes the condition of the page's link: a list as in `delay=50ms,loss=5%`.
    fn set_link(&self, body: &[u8]) -> HttpAnswer {
        let text = String::from_utf8_lossy(body);
        match text.trim().parse::<LinkConfig>() {
            Ok(config) => {
                self.relay.set_config(config);
                tracing::info!(link = %config, "the page's link is conditioned");
                HttpAnswer::ok(TEXT, config.to_string())
            }
            Err(error) => HttpAnswer::refusal(StatusCode::BAD_REQUEST, error.to_string()),
        }
    }

    /// Datagrams and bytes of the page's link, both ways.
    fn counts(&self) -> String {
        let of = |direction| {
            let counts = self.relay.counts(direction);
            serde_json::json!({
                "datagrams": counts.pushed.pieces,
                "bytes": counts.pushed.bytes,
                "lost": counts.lost.pieces + counts.overflowed.pieces,
            })
        };
        serde_json::json!({ "up": of(Direction::Up), "down": of(Direction::Down) }).to_string()
    }
}

fn json(facts: &Facts) -> HttpAnswer {
    match serde_json::to_vec(facts) {
        Ok(text) => HttpAnswer::ok(JSON, text),
        Err(cause) => HttpAnswer::refusal(StatusCode::INTERNAL_SERVER_ERROR, cause.to_string()),
    }
}

/// A scene that the page offers, whether or not it has begun.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ViewScene {
    /// Its name.
    pub name: String,
    /// The body that the page's keys drive: its index.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub player: Option<u32>,
}

/// `/connect.json`.
#[derive(Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "camelCase")]
struct Facts {
    /// Of the server.
    version: &'static str,
    /// Address of WebTransport.
    url: String,
    /// The same through the relay.
    conditioned_url: String,
    /// SHA-256 of each certificate that the server may show, hexadecimal.
    certificate_hashes: Vec<String>,
    scenes: Vec<ViewScene>,
    /// True if other servers may have more scenes.
    several: bool,
    /// A token that lets the page observe, if the server asks for tokens.
    #[serde(skip_serializing_if = "Option::is_none")]
    token: Option<String>,
}

/// The URL of WebTransport at an address.
fn url(listens: SocketAddr, page_host: &str) -> String {
    format!("https://{}:{}/", host(listens, page_host), listens.port())
}

/// Any server, as a content security policy names it.
const ANY_SERVER: &str = "https:";

/// The URLs of WebTransport at an address and any port, as a content security policy names them.
fn source(listens: SocketAddr, page_host: &str) -> String {
    match host(listens, page_host) {
        // A policy cannot name an address of IPv6, nor a name with an underscore.
        host if host.contains(['[', '_']) => ANY_SERVER.to_owned(),
        host => format!("https://{host}:*"),
    }
}

/// The host of an address. A server that listens at every address is reached where the page was.
fn host(listens: SocketAddr, page_host: &str) -> String {
    match listens.ip() {
        ip if ip.is_unspecified() => page_host.to_owned(),
        IpAddr::V4(ip) => ip.to_string(),
        IpAddr::V6(ip) => format!("[{ip}]"),
    }
}

/// The folder of the page, and the recordings that it plays.
#[derive(Debug, Args)]
pub(crate) struct PageArguments {
    /// Folder for the page: a new one, or an empty one.
    #[arg(long = "static", value_name = "DIR")]
    folder: PathBuf,
    /// Recordings that the page plays: .mcap, .rhtrace or .rhtrace.zst.
    #[arg(required = true, value_name = "FILE")]
    recordings: Vec<PathBuf>,
}

/// The folder of the recordings, in that of the page.
const RECORDINGS: &str = "recordings";
/// Beginnings of the files that the page plays: MCAP, .rhtrace, and what zstd has packed.
const MAGICS: [&[u8]; 3] = [b"\x89MCAP0\r\n", b"RHTRACE1", b"\x28\xb5\x2f\xfd"];

/// Reason why the page was not written.
#[derive(Debug)]
pub(crate) enum PageError {
    /// The folder has files already.
    NotEmpty(PathBuf),
    /// The file is no recording that the page plays.
    NotARecording(PathBuf),
    /// Two recordings have this name.
    SameName(OsString),
    /// A file or folder could not be read or written.
    Io(PathBuf, io::Error),
}

/// Writes the page, and says how to look at it. A refusal leaves nothing behind.
pub(crate) fn write_page(arguments: &PageArguments, out: &mut impl Write) -> Result<(), PageError> {
    let PageArguments { folder, recordings } = arguments;
    let at = |path: &Path| {
        let path = path.to_owned();
        move |cause| PageError::Io(path, cause)
    };
    if folder.exists() && fs::read_dir(folder).map_err(at(folder))?.next().is_some() {
        return Err(PageError::NotEmpty(folder.clone()));
    }
    let mut names = BTreeSet::new();
    for recording in recordings {
        check(recording)?;
        let name = recording.file_name().unwrap_or_default();
        if !names.insert(name) {
            return Err(PageError::SameName(name.to_owned()));
        }
    }
    let paths: Vec<String> = recordings.iter().map(|path| address(path)).collect();
    let mut written = 0;
    for (path, bytes) in rhumb_viewer::static_files(&paths) {
        let path = folder.join(path);
        let parent = path.parent().unwrap_or(folder);
        fs::create_dir_all(parent).map_err(at(parent))?;
        fs::write(&path, &bytes).map_err(at(&path))?;
        written += bytes.len() as u64;
    }
    let kept = folder.join(RECORDINGS);
    fs::create_dir_all(&kept).map_err(at(&kept))?;
    for recording in recordings {
        let path = kept.join(recording.file_name().unwrap_or_default());
        written += fs::copy(recording, &path).map_err(at(recording))?;
    }
    let shown = folder.display();
    let said = writeln!(
        out,
        "wrote the page to {shown}, {:.1} MB; any web host serves it: python3 -m http.server --directory {shown}",
        written as f64 / 1e6
    );
    said.map_err(at(folder))
}

/// Refuses a file that the page could not play.
fn check(path: &Path) -> Result<(), PageError> {
    let failed = |cause| PageError::Io(path.to_owned(), cause);
    let mut head = Vec::new();
    let file = File::open(path).map_err(failed)?;
    file.take(8).read_to_end(&mut head).map_err(failed)?;
    match MAGICS.iter().any(|magic| head.starts_with(magic)) {
        true => Ok(()),
        false => Err(PageError::NotARecording(path.to_owned())),
    }
}

/// The address of a recording, from the page's folder.
fn address(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default();
    let mut address = format!("{RECORDINGS}/");
    for byte in name.as_encoded_bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'.' | b'_' | b'~' => {
                address.push(char::from(*byte));
            }
            _ => address += &format!("%{byte:02X}"),
        }
    }
    address
}

impl fmt::Display for PageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotEmpty(folder) => write!(
                f,
                "{} has files already: name a new folder, or empty it",
                folder.display()
            ),
            Self::NotARecording(path) => write!(
                f,
                "{} is no recording that the page plays: it is neither an MCAP file nor an .rhtrace",
                path.display()
            ),
            Self::SameName(name) => write!(
                f,
                "two recordings are named {}: rename one of them",
                name.to_string_lossy()
            ),
            Self::Io(path, cause) => write!(f, "{}: {cause}", path.display()),
        }
    }
}

impl std::error::Error for PageError {}

#[cfg(test)]
mod tests {
    use bytes::Bytes;

    use super::*;
    use crate::access::tests::Signed;

    fn page() -> Page {
        let listens: SocketAddr = "127.0.0.1:4433".parse().unwrap();
        let anywhere = "127.0.0.1:0".parse().unwrap();
        Page {
            listens,
            relay: UdpRelay::start(anywhere, listens, LinkConfig::PERFECT, 1).unwrap(),
            hashes: Box::new(|| vec!["ab".repeat(32)]),
            scenes: vec![ViewScene {
                name: "cubes".into(),
                player: Some(1),
            }],
            metrics: Metrics::default(),
            issuer: None,
            now: || 1_767_225_600,
            named: false,
            is_shared: false,
        }
    }

    fn get(path: &str) -> HttpRequest {
        HttpRequest {
            method: Method::GET,
            path: path.into(),
            host: Some("127.0.0.1:8433".into()),
            origin: None,
            body: Bytes::new(),
        }
    }

    fn post(path: &str, body: &'static str) -> HttpRequest {
        HttpRequest {
            method: Method::POST,
            body: Bytes::from_static(body.as_bytes()),
            origin: Some("http://127.0.0.1:8433".into()),
            ..get(path)
        }
    }

    fn policy(answer: &HttpAnswer) -> String {
        let (name, policy) = &answer.headers[0];
        assert_eq!(name, CONTENT_SECURITY_POLICY);
        policy.to_str().unwrap().to_owned()
    }

    fn text(answer: &HttpAnswer) -> &str {
        std::str::from_utf8(&answer.body).unwrap()
    }

    #[test]
    fn the_page_learns_how_to_connect_and_which_scenes_there_are() {
        let mut page = page();
        let _pit = page.metrics.begin_scene(&"pit".parse().unwrap());
        let answer = page.answer(&get("/connect.json"));
        let facts: serde_json::Value = serde_json::from_slice(&answer.body).unwrap();
        assert_eq!(facts["url"], "https://127.0.0.1:4433/");
        let relay = page.relay.local_addr().port();
        assert_eq!(
            facts["conditionedUrl"],
            format!("https://127.0.0.1:{relay}/")
        );
        assert_eq!(facts["certificateHashes"][0], "ab".repeat(32));
        assert_eq!(facts["scenes"][0]["player"], 1);
        assert_eq!(facts["scenes"][1]["name"], "pit");
        assert!(facts.get("token").is_none());

        let signed = Signed::new("view-page");
        let mut keys = signed.keys();
        page.issuer = Some(keys.issuer().unwrap());
        let answer = page.answer(&get("/connect.json"));
        let facts: serde_json::Value = serde_json::from_slice(&answer.body).unwrap();
        let token = facts["token"].as_str().unwrap();
        assert!(token.starts_with("v4.public."));
    }

    #[test]
    fn a_page_of_another_origin_and_a_strange_name_are_refused_with_a_reason() {
        let page = page();
        let mut request = get("/connect.json");
        request.origin = Some("https://example.org".into());
        let answer = page.answer(&request);
        assert_eq!(answer.status, StatusCode::FORBIDDEN);
        assert!(text(&answer).contains("https://example.org"));
        for host in [None, Some("example.org"), Some("example.org:8433")] {
            let request = HttpRequest {
                host: host.map(str::to_owned),
                ..get("/")
            };
            assert_eq!(page.answer(&request).status, StatusCode::FORBIDDEN);
        }
        for host in ["localhost:8433", "[::1]:8433", "127.0.0.1", "192.0.2.7:80"] {
            let request = HttpRequest {
                host: Some(host.into()),
                ..get("/connect.json")
            };
            assert_eq!(page.answer(&request).status, StatusCode::OK, "{host}");
        }
    }

    #[test]
    fn the_page_conditions_its_link_and_a_wrong_condition_is_explained() {
        let page = page();
        let answer = page.answer(&post("/link", "delay=50ms,loss=5%,rate=1mbit"));
        assert_eq!(answer.status, StatusCode::OK);
        let config = page.relay.config();
        assert_eq!(config.rate_bytes, Some(125_000));
        assert_eq!(text(&page.answer(&get("/link"))), config.to_string());
        let answer = page.answer(&post("/link", "lag=1"));
        assert_eq!(answer.status, StatusCode::BAD_REQUEST);
        assert!(text(&answer).contains("delay"));
        assert_eq!(page.relay.config(), config);
        let mut foreign = post("/link", "");
        foreign.origin = Some("http://127.0.0.1:9".into());
        assert_eq!(page.answer(&foreign).status, StatusCode::FORBIDDEN);
        assert_eq!(page.relay.config(), config);
    }

    #[test]
    fn every_answer_has_the_policy_and_unknown_requests_are_refused() {
        let page = page();
        for (request, status) in [
            (get("/nothing"), StatusCode::NOT_FOUND),
            (post("/connect.json", ""), StatusCode::METHOD_NOT_ALLOWED),
            (get("/link/counts"), StatusCode::OK),
        ] {
            let answer = page.answer(&request);
            assert_eq!(answer.status, status);
            let policy = policy(&answer);
            assert!(policy.starts_with("default-src 'none'"));
        }
    }

    #[test]
    fn the_page_connects_to_its_server_and_to_no_other() {
        let mut page = page();
        let of = |page: &Page, host: &str| {
            let request = HttpRequest {
                host: Some(host.into()),
                ..get("/")
            };
            let policy = policy(&page.answer(&request));
            let (_, rest) = policy.split_once("connect-src ").unwrap();
            rest.split_once(';').unwrap().0.to_owned()
        };
        let own = "'self' https://127.0.0.1:* https://127.0.0.1:*";
        assert_eq!(of(&page, "localhost:8433"), own);
        assert_eq!(of(&page, "example.org").trim(), "'self'");
        page.listens = "0.0.0.0:4433".parse().unwrap();
        let named = "'self' https://192.0.2.7:* https://127.0.0.1:*";
        assert_eq!(of(&page, "192.0.2.7:8433"), named);
        page.named = true;
        let other = of(&page, "example.org; script-src https:");
        assert_eq!(other.trim(), "'self'");
        page.is_shared = true;
        assert_eq!(of(&page, "192.0.2.7:8433"), "'self' https:");
    }

    #[test]
    fn the_url_is_where_the_server_listens_or_where_the_page_was_reached() {
        let of = |listens: &str| url(listens.parse().unwrap(), "192.0.2.7");
        assert_eq!(of("127.0.0.1:4433"), "https://127.0.0.1:4433/");
        assert_eq!(of("[::1]:4433"), "https://[::1]:4433/");
        assert_eq!(of("0.0.0.0:4433"), "https://192.0.2.7:4433/");
        assert_eq!(of("[::]:4433"), "https://192.0.2.7:4433/");
        let source = |listens: &str| source(listens.parse().unwrap(), "192.0.2.7");
        assert_eq!(source("0.0.0.0:4433"), "https://192.0.2.7:*");
        assert_eq!(source("[::1]:4433"), "https:");
        assert_eq!(
            super::source("0.0.0.0:1".parse().unwrap(), "my_server"),
            "https:"
        );
    }

    /// A folder of this test alone, empty.
    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("rhumb-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    fn write(folder: &Path, recordings: &[&Path]) -> Result<String, PageError> {
        let arguments = PageArguments {
            folder: folder.to_owned(),
            recordings: recordings.iter().map(|&path| path.to_owned()).collect(),
        };
        let mut out = Vec::new();
        write_page(&arguments, &mut out)?;
        Ok(String::from_utf8(out).unwrap())
    }

    #[test]
    fn the_page_and_its_recordings_are_written_and_nothing_is_overwritten() {
        let work = folder("static-page");
        let recording = work.join("a b.mcap");
        fs::write(&recording, b"\x89MCAP0\r\nrest").unwrap();
        let page = work.join("page");
        let said = write(&page, &[&recording]).unwrap();
        assert!(said.contains("http.server"), "{said}");
        let index = fs::read_to_string(page.join("index.html")).unwrap();
        assert!(index.contains("recordings/a%20b.mcap"));
        let copied = fs::read(page.join("recordings/a b.mcap")).unwrap();
        assert_eq!(copied, fs::read(&recording).unwrap());
        assert!(page.join("three/build/three.module.min.js").exists());
        assert!(!page.join("client").exists());
        let again = write(&page, &[&recording]).unwrap_err();
        assert!(again.to_string().contains("has files already"), "{again}");
        fs::remove_dir_all(work).unwrap();
    }

    #[test]
    fn a_refused_page_leaves_nothing_behind() {
        let work = folder("static-page-refused");
        let (text, trace) = (work.join("a.txt"), work.join("x.rhtrace"));
        fs::write(&text, "no recording").unwrap();
        fs::write(&trace, b"RHTRACE1").unwrap();
        fs::create_dir(work.join("other")).unwrap();
        let same = work.join("other/x.rhtrace");
        fs::write(&same, b"RHTRACE1").unwrap();
        let page = work.join("page");
        for (recordings, words) in [
            (vec![text.as_path()], "neither an MCAP file nor an .rhtrace"),
            (
                vec![trace.as_path(), same.as_path()],
                "two recordings are named",
            ),
            (vec![Path::new("/nowhere/a.mcap")], "/nowhere/a.mcap"),
        ] {
            let error = write(&page, &recordings).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
            assert!(!page.exists());
        }
        fs::remove_dir_all(work).unwrap();
    }
}
