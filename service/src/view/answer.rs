//! Answers the page's requests: files, how to connect, the link's condition.

use core::net::{IpAddr, SocketAddr};

use hyper::header::{CONTENT_SECURITY_POLICY, HeaderName, HeaderValue};
use hyper::{Method, StatusCode};
use rhumb_transport::conditioner::{Direction, LinkConfig, UdpRelay};
use serde::Serialize;

use crate::access::TokenIssuer;
use crate::http::{HttpAnswer, HttpRequest, TEXT};
use crate::metrics::Metrics;

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
pub(super) type Hashes = Box<dyn Fn() -> Vec<String> + Send + Sync>;

/// The sources of the page's answers.
pub(super) struct Page {
    /// Address of the server.
    pub(super) listens: SocketAddr,
    /// The page's connections pass through it.
    pub(super) relay: UdpRelay,
    pub(super) hashes: Hashes,
    /// Scenes that the server provides.
    pub(super) scenes: Vec<ViewScene>,
    pub(super) metrics: Metrics,
    /// Issues the page's tokens, if the server asks for tokens.
    pub(super) issuer: Option<TokenIssuer>,
    /// Seconds since 1970.
    pub(super) now: fn() -> i64,
    /// True if names of hosts are answered to, and not only addresses of this machine.
    pub(super) named: bool,
}

impl Page {
    /// The answer to a request.
    pub(super) fn answer(&self, request: &HttpRequest) -> HttpAnswer {
        let mut answer = self.answer_to(request);
        let policy = (CONTENT_SECURITY_POLICY, self.policy(request));
        let fixed = HEADERS.map(|(name, value)| {
            let name = HeaderName::from_static(name);
            (name, HeaderValue::from_static(value))
        });
        answer.headers = [policy].into_iter().chain(fixed).collect();
        answer
    }

    /// The page's rights: it connects to this server, and after a restart to the server's new ports.
    fn policy(&self, request: &HttpRequest) -> HeaderValue {
        let sources = request.host(self.named).map(|host| {
            let listens = [self.listens, self.relay.local_addr()];
            listens.map(|listens| source(listens, host)).join(" ")
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
pub(super) struct Facts {
    /// Of the server.
    pub(super) version: &'static str,
    /// Address of WebTransport.
    pub(super) url: String,
    /// The same through the relay.
    pub(super) conditioned_url: String,
    /// SHA-256 of each certificate that the server may show, hexadecimal.
    pub(super) certificate_hashes: Vec<String>,
    pub(super) scenes: Vec<ViewScene>,
    /// A token that lets the page observe, if the server asks for tokens.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) token: Option<String>,
}

/// The URL of WebTransport at an address.
pub(super) fn url(listens: SocketAddr, page_host: &str) -> String {
    format!("https://{}:{}/", host(listens, page_host), listens.port())
}

/// The URLs of WebTransport at an address and any port, as a content security policy names them.
pub(super) fn source(listens: SocketAddr, page_host: &str) -> String {
    match host(listens, page_host) {
        // A policy cannot name an address of IPv6, nor a name with an underscore.
        host if host.contains(['[', '_']) => "https:".to_owned(),
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
}
