//! Requests to etcd through its JSON gateway: claims, and the board's notices.
//!
//! One connection for each request: a server asks a few times a second. The first of the endpoints that answers is asked
//! again. Numbers are text in this JSON, over HTTP/1.1, and keys and values are base64 (etcd's API v3.4).
//!
//! Decides nothing. A notice is a key under the lease of who posts it, so that none outlives its writer. Notices of a later
//! version are passed over.

use std::fmt;
use std::str::FromStr;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use bytes::Bytes;
use hyper::{Method, StatusCode, Uri};
use rhumb_protocol::limits::EXTENSION_BYTES_MAX;
use rhumb_protocol::scene::SceneName;
use serde_json::{Value, json};
use tokio::sync::Semaphore;

use super::claims::{DirectoryAnswer, DirectoryRequest, Epoch, LeaseId, ServerPlace};
use super::handovers::{Board, Notice};
use crate::http;

/// The servers of an etcd cluster.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Endpoints(Vec<(String, u16)>);

/// A text that names no endpoints.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct InvalidEndpoints(String);

impl fmt::Display for InvalidEndpoints {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:?} is no endpoint of etcd: give http://host:port, several with commas between; \
             for https, run a proxy beside the server",
            self.0
        )
    }
}

impl std::error::Error for InvalidEndpoints {}

impl FromStr for Endpoints {
    type Err = InvalidEndpoints;

    fn from_str(text: &str) -> Result<Self, InvalidEndpoints> {
        /// Where etcd listens by default.
        const PORT: u16 = 2379;
        let one = |text: &str| {
            let url: Uri = text.trim().parse().ok()?;
            let is_plain = url.scheme_str() == Some("http") && url.path() == "/";
            let host = url.host().filter(|_| is_plain && url.query().is_none())?;
            let port = url.port_u16().unwrap_or(PORT);
            // Neither a user nor a port that is none is passed over.
            let with = |port: &str| {
                url.authority()
                    .is_some_and(|all| *all == format!("{host}{port}"))
            };
            let is_all = with("") || with(&format!(":{port}"));
            is_all.then(|| (host.to_owned(), port))
        };
        let endpoints = text
            .split(',')
            .map(|text| one(text).ok_or_else(|| InvalidEndpoints(text.to_owned())));
        endpoints.collect::<Result<_, _>>().map(Self)
    }
}

/// A client of a cluster.
pub(super) struct Etcd {
    endpoints: Endpoints,
    /// The endpoint that is asked first.
    first: AtomicUsize,
    /// Places of claims and releases that are asked at the same time.
    places: Semaphore,
}

/// Time for an answer that no lease waits for.
const ANSWER_TIME: Duration = Duration::from_secs(1);
/// Before the names of scenes.
const SCENES: &str = "rhumb/scenes/";
/// Claims and releases that are asked at the same time, each by a connection; others wait in order. At 37 ms an answer,
/// the slowest measured (decision 91), these are 430 a second.
const AT_ONCE: usize = 16;

impl Etcd {
    pub(super) fn new(endpoints: Endpoints) -> Self {
        Self {
            endpoints,
            first: AtomicUsize::new(0),
            places: Semaphore::new(AT_ONCE),
        }
    }

    /// Asks once for the server at a place; [`DirectoryAnswer::Failed`] without an answer in time that is understood. Claims
    /// and releases wait for a place first, what concerns the lease never does.
    pub(super) async fn answer(
        &self,
        place: &ServerPlace,
        request: &DirectoryRequest,
        limit: Duration,
    ) -> DirectoryAnswer {
        let _place = match request {
            DirectoryRequest::Claim(..) | DirectoryRequest::Release(..) => {
                self.places.acquire().await.ok()
            }
            _ => None,
        };
        let (path, body) = body_of(request, place);
        let answer = self.post_to_first(path, &body, limit).await;
        let answer = answer.and_then(|(status, answer)| read(request, status, &answer));
        answer.unwrap_or_else(|| {
            self.try_another();
            DirectoryAnswer::Failed
        })
    }

    /// Asks once for anything else; `None` without a good answer.
    async fn ask(&self, path: &str, body: &Value) -> Option<Value> {
        let asked = self.post_to_first(path, body, ANSWER_TIME).await;
        let answer = asked.and_then(|(status, answer)| {
            let answer = serde_json::from_slice(&answer).ok()?;
            (status == StatusCode::OK).then_some(answer)
        });
        if answer.is_none() {
            self.try_another();
        }
        answer
    }

    async fn post_to_first(
        &self,
        path: &str,
        body: &Value,
        within: Duration,
    ) -> Option<(StatusCode, Bytes)> {
        let first = self.first.load(Ordering::Relaxed);
        let (host, port) = &self.endpoints.0[first % self.endpoints.0.len()];
        http::ask((host, *port), (Method::POST, path), Some(body), within).await
    }

    /// The next endpoint may know more.
    fn try_another(&self) {
        self.first.fetch_add(1, Ordering::Relaxed);
    }
}

fn body_of(request: &DirectoryRequest, place: &ServerPlace) -> (&'static str, Value) {
    match request {
        DirectoryRequest::Grant { seconds } => {
            ("/v3/lease/grant", json!({ "TTL": seconds.to_string() }))
        }
        DirectoryRequest::Renew(LeaseId(id)) => {
            ("/v3/lease/keepalive", json!({ "ID": id.to_string() }))
        }
        DirectoryRequest::Revoke(LeaseId(id)) => {
            ("/v3/lease/revoke", json!({ "ID": id.to_string() }))
        }
        DirectoryRequest::Claim(LeaseId(id), scene) => {
            let key = key_of(scene);
            let value = base64(place.0.as_bytes());
            let put = json!({ "key": key, "value": value, "lease": id.to_string() });
            let range = json!({ "request_range": { "key": key } });
            let is_free = json!({ "target": "CREATE", "key": key, "create_revision": "0" });
            let put = json!({ "request_put": put });
            let claim = json!({
                "compare": [is_free], "success": [put, range], "failure": [range],
            });
            ("/v3/kv/txn", claim)
        }
        DirectoryRequest::Release(Epoch(epoch), scene) => {
            let key = key_of(scene);
            let epoch = epoch.to_string();
            let is_ours = json!({ "target": "CREATE", "key": key, "create_revision": epoch });
            let delete = json!({ "request_delete_range": { "key": key } });
            let release = json!({ "compare": [is_ours], "success": [delete] });
            ("/v3/kv/txn", release)
        }
    }
}

fn key_of(scene: &SceneName) -> String {
    base64(format!("{SCENES}{scene}").as_bytes())
}

/// The meaning of an answer; `None` if it has none.
fn read(to: &DirectoryRequest, status: StatusCode, answer: &[u8]) -> Option<DirectoryAnswer> {
    /// The code of what does not exist (gRPC).
    const NOT_FOUND: u64 = 5;
    let answer: Value = serde_json::from_slice(answer).ok()?;
    if status != StatusCode::OK {
        let is_gone = answer["code"].as_u64() == Some(NOT_FOUND);
        return match to {
            DirectoryRequest::Revoke(_) if is_gone => Some(DirectoryAnswer::Revoked),
            DirectoryRequest::Claim(..) if is_gone => Some(DirectoryAnswer::NoLease),
            _ => None,
        };
    }
    Some(match to {
        DirectoryRequest::Grant { .. } => {
            DirectoryAnswer::Granted(LeaseId(number(&answer["ID"])?), number(&answer["TTL"])?)
        }
        DirectoryRequest::Renew(_) => match answer.get("result")?.get("TTL") {
            None => DirectoryAnswer::NoLease,
            Some(seconds) => DirectoryAnswer::Renewed(number(seconds)?),
        },
        DirectoryRequest::Revoke(_) => DirectoryAnswer::Revoked,
        DirectoryRequest::Claim(..) => owner(&answer)?,
        DirectoryRequest::Release(..) => DirectoryAnswer::Released,
    })
}

/// The owner in the answer to a claim.
fn owner(answer: &Value) -> Option<DirectoryAnswer> {
    let responses = answer["responses"].as_array()?;
    let key = &responses.last()?["response_range"]["kvs"][0];
    let place = String::from_utf8(from_base64(key["value"].as_str()?)?).ok()?;
    if !is_place(&place) {
        tracing::warn!(
            "the directory has a server whose address no client could read: its key was not written by a server"
        );
        return None;
    }
    Some(DirectoryAnswer::Owner {
        lease: LeaseId(number(&key["lease"])?),
        epoch: Epoch(number(&key["create_revision"])?),
        place: ServerPlace(place),
    })
}

/// True for a text that a client can be sent as the address of a server.
fn is_place(text: &str) -> bool {
    (1..=EXTENSION_BYTES_MAX).contains(&text.len())
        && text.bytes().all(|byte| byte.is_ascii_graphic())
}

/// A number of 64 bits, which this JSON has as text.
fn number(value: &Value) -> Option<u64> {
    value.as_str()?.parse().ok()
}

const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

/// Bytes as base64 with padding (RFC 4648, 4).
fn base64(bytes: &[u8]) -> String {
    let mut text = String::new();
    for group in bytes.chunks(3) {
        let mut padded = [0; 3];
        padded[..group.len()].copy_from_slice(group);
        let [first, second, third] = padded.map(u32::from);
        let bits = first << 16 | second << 8 | third;
        for place in 0..4 {
            let digit = DIGITS[(bits >> (18 - 6 * place) & 63) as usize];
            text.push(if place > group.len() {
                '='
            } else {
                char::from(digit)
            });
        }
    }
    text
}

/// The bytes of such a text.
fn from_base64(text: &str) -> Option<Vec<u8>> {
    let digits = text.trim_end_matches('=').bytes();
    let (mut bytes, mut bits, mut count) = (Vec::new(), 0u32, 0);
    for digit in digits {
        let value = DIGITS.iter().position(|other| *other == digit)?;
        bits = bits << 6 | u32::try_from(value).ok()?;
        count += 6;
        if count >= 8 {
            count -= 8;
            bytes.push(u8::try_from(bits >> count & 0xff).ok()?);
        }
    }
    Some(bytes)
}

/// Before the keys of all notices.
const BOARD: &str = "rhumb/board/";
/// Keys of one answer.
const PAGE: usize = 1_000;

/// A key with its value and lease.
struct Entry {
    key: String,
    value: String,
    lease: LeaseId,
}

impl Notice {
    /// Its key behind [`BOARD`], and its value.
    fn key_and_value(&self) -> (String, &str) {
        /// A value says nothing where the key says all; etcd leaves out an empty one.
        const PLAIN: &str = "1";
        match self {
            Self::Server(place) => (format!("server/{}", place.0), PLAIN),
            Self::Drained(place) => (format!("drained/{}", place.0), PLAIN),
            Self::Order(scene, to) => (format!("order/{scene}"), &to.0),
            Self::Standby(scene, by) => (format!("standby/{scene}"), &by.0),
            Self::Refused(scene, by) => (format!("refused/{scene}"), &by.0),
        }
    }
}

impl Board {
    /// Adds a notice; others than ours are passed over, and addresses that no client could read.
    fn add(&mut self, entry: Entry) {
        let of_board = entry.key.strip_prefix(BOARD);
        let Some((kind, name)) = of_board.and_then(|key| key.split_once('/')) else {
            return;
        };
        if !is_place(name) || !is_place(&entry.value) {
            return;
        }
        let (place, value) = (ServerPlace(name.to_owned()), ServerPlace(entry.value));
        match (kind, name.parse::<SceneName>()) {
            ("server", _) => drop(self.servers.insert(place, entry.lease)),
            ("drained", _) => drop(self.drained.insert(place, entry.lease)),
            ("order", Ok(scene)) => drop(self.orders.insert(scene, value)),
            ("standby", Ok(scene)) => drop(self.standbys.insert(scene, value)),
            ("refused", Ok(scene)) => drop(self.refused.insert(scene, value)),
            _ => {}
        }
    }
}

impl Etcd {
    /// A lease of so many seconds; `None` without an answer.
    pub(super) async fn grant(&self, seconds: u64) -> Option<LeaseId> {
        let grant = json!({ "TTL": seconds.to_string() });
        let answer = self.ask("/v3/lease/grant", &grant).await?;
        Some(LeaseId(number(&answer["ID"])?))
    }

    /// Gives a lease its whole time again; false without an answer.
    pub(super) async fn renew(&self, lease: LeaseId) -> bool {
        let renew = json!({ "ID": lease.0.to_string() });
        self.ask("/v3/lease/keepalive", &renew).await.is_some()
    }

    /// Ends a lease, and what it holds; false without an answer.
    pub(super) async fn revoke(&self, lease: LeaseId) -> bool {
        let revoke = json!({ "ID": lease.0.to_string() });
        self.ask("/v3/lease/revoke", &revoke).await.is_some()
    }

    /// All notices; `None` without an answer.
    pub(super) async fn read_board(&self) -> Option<Board> {
        let mut board = Board::default();
        for entry in self.range(BOARD).await? {
            board.add(entry);
        }
        Some(board)
    }

    /// Posts a notice that ends with a lease; false without an answer.
    pub(super) async fn post(&self, lease: LeaseId, notice: &Notice) -> bool {
        let (key, value) = notice.key_and_value();
        let key = base64(format!("{BOARD}{key}").as_bytes());
        let value = base64(value.as_bytes());
        let put = json!({ "key": key, "value": value, "lease": lease.0.to_string() });
        self.ask("/v3/kv/put", &put).await.is_some()
    }

    /// Takes a notice off the board, if it says the same there; false without an answer.
    pub(super) async fn remove(&self, notice: &Notice) -> bool {
        let (key, value) = notice.key_and_value();
        let key = base64(format!("{BOARD}{key}").as_bytes());
        let is_same = json!({ "target": "VALUE", "key": key, "value": base64(value.as_bytes()) });
        let delete = json!({ "request_delete_range": { "key": key } });
        let transaction = json!({ "compare": [is_same], "success": [delete] });
        self.ask("/v3/kv/txn", &transaction).await.is_some()
    }

    /// The scenes that servers have; `None` without an answer.
    pub(super) async fn scenes(&self) -> Option<Vec<(SceneName, ServerPlace)>> {
        let entries = self.range(SCENES).await?.into_iter();
        let scenes = entries.filter_map(|entry| {
            let name = entry.key.strip_prefix(SCENES)?.parse().ok()?;
            Some((name, ServerPlace(entry.value)))
        });
        Some(scenes.collect())
    }

    /// The server that has a scene: `Some(None)` if none has it, `None` without an answer.
    pub(super) async fn owner_of(&self, scene: &SceneName) -> Option<Option<ServerPlace>> {
        let key = format!("{SCENES}{scene}");
        let ask = json!({ "key": base64(key.as_bytes()) });
        let answer = self.ask("/v3/kv/range", &ask).await?;
        let entry = entries(&answer)?.pop();
        Some(entry.map(|entry| ServerPlace(entry.value)))
    }

    /// All keys that begin so.
    async fn range(&self, prefix: &str) -> Option<Vec<Entry>> {
        let mut end = prefix.as_bytes().to_vec();
        // No prefix of ours ends with the last of all bytes.
        if let Some(last) = end.last_mut() {
            *last += 1;
        }
        let (mut all, mut from) = (Vec::new(), prefix.as_bytes().to_vec());
        loop {
            let ask = json!({
                "key": base64(&from), "range_end": base64(&end), "limit": PAGE.to_string(),
            });
            let answer = self.ask("/v3/kv/range", &ask).await?;
            let mut page = entries(&answer)?;
            let last = page.last().map(|entry| entry.key.clone().into_bytes());
            let is_full = page.len() == PAGE;
            all.append(&mut page);
            match last {
                Some(last) if is_full => {
                    from = last;
                    from.push(0);
                }
                _ => return Some(all),
            }
        }
    }
}

/// The keys of an answer; `None` if it is none of etcd.
fn entries(answer: &Value) -> Option<Vec<Entry>> {
    answer.get("header")?;
    let Some(keys) = answer.get("kvs") else {
        return Some(Vec::new());
    };
    let text = |value: &Value| String::from_utf8(from_base64(value.as_str()?)?).ok();
    let entries = keys.as_array()?.iter().map(|entry| {
        Some(Entry {
            key: text(&entry["key"])?,
            value: text(&entry["value"])?,
            lease: LeaseId(number(&entry["lease"]).unwrap_or(0)),
        })
    });
    entries.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_has_the_examples_of_its_document() {
        for (bytes, text) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("fooba", "Zm9vYmE="),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(bytes.as_bytes()), text);
            assert_eq!(from_base64(text).unwrap(), bytes.as_bytes());
        }
        assert_eq!(from_base64("Z g="), None);
    }

    #[test]
    fn no_more_than_some_claims_are_asked_at_the_same_time_and_a_renewal_waits_for_none() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        listener.set_nonblocking(true).unwrap();
        let etcd = Etcd::new(format!("http://127.0.0.1:{port}").parse().unwrap());
        let (place, limit) = (
            ServerPlace("rhumb://a:1".to_owned()),
            Duration::from_secs(60),
        );
        let claim = |n: u64| DirectoryRequest::Claim(LeaseId(7), format!("s{n}").parse().unwrap());
        let ask = |request| async {
            let request = request;
            etcd.answer(&place, &request, limit).await
        };
        let mut claims: Vec<_> = (0..40).map(|n| Box::pin(ask(claim(n)))).collect();
        let mut renewal = Box::pin(ask(DirectoryRequest::Renew(LeaseId(7))));
        let mut asked = Vec::new();
        let turns = async {
            // Each turn polls all; nothing answers.
            while asked.len() < AT_ONCE + 1 {
                let polled = std::future::poll_fn(|context| {
                    for claim in &mut claims {
                        assert!(claim.as_mut().poll(context).is_pending());
                    }
                    assert!(renewal.as_mut().poll(context).is_pending());
                    std::task::Poll::Ready(())
                });
                polled.await;
                asked.extend(listener.accept().ok());
                tokio::task::yield_now().await;
            }
        };
        rhumb_transport::io_runtime().unwrap().block_on(turns);
        assert!(listener.accept().is_err(), "another claim is asked");
    }

    #[test]
    fn an_endpoint_is_a_plain_url_with_a_host() {
        let read = |text: &str| text.parse::<Endpoints>();
        let both = Endpoints(vec![("a".to_owned(), 2379), ("[::1]".to_owned(), 5)]);
        assert_eq!(read("http://a,http://[::1]:5"), Ok(both));
        for wrong in [
            "",
            "a:2379",
            "https://a",
            "http://a/v3",
            "http://a,",
            "etcd://a",
            "http://a:70000",
            "http://user@a",
        ] {
            let refused = read(wrong).unwrap_err().to_string();
            assert!(refused.contains("http://host:port"), "{refused}");
        }
    }

    /// Recorded of etcd 3.4.23.
    #[test]
    fn answers_of_etcd_are_understood() {
        let read = |to: &DirectoryRequest, status: u16, answer: &str| {
            read(to, StatusCode::from_u16(status).unwrap(), answer.as_bytes())
        };
        let lease = LeaseId(7_587_899_251_892_517_127);
        let claim = DirectoryRequest::Claim(lease, "pit".parse().unwrap());
        let key = r#"{"key":"cmh1bWIvc2NlbmVzL3BpdA==","create_revision":"2","mod_revision":"2","version":"1","value":"cmh1bWI6Ly9hOjE=","lease":"7587899251892517127"}"#;
        let range = format!(
            r#"{{"response_range":{{"header":{{"revision":"2"}},"kvs":[{key}],"count":"1"}}}}"#
        );
        let owner = DirectoryAnswer::Owner {
            lease,
            epoch: Epoch(2),
            place: ServerPlace("rhumb://a:1".to_owned()),
        };
        let refused = format!(r#"{{"header":{{}},"responses":[{range}]}}"#);
        assert_eq!(read(&claim, 200, &refused), Some(owner.clone()));
        let taken = format!(
            r#"{{"header":{{}},"succeeded":true,"responses":[{{"response_put":{{}}}},{range}]}}"#
        );
        assert_eq!(read(&claim, 200, &taken), Some(owner));
        for place in [
            String::new(),
            "grün".to_owned(),
            "a b".to_owned(),
            "a".repeat(900),
        ] {
            let named = refused.replace("cmh1bWI6Ly9hOjE=", &base64(place.as_bytes()));
            assert_eq!(read(&claim, 200, &named), None, "{place:?}");
        }
        let gone = r#"{"error":"etcdserver: requested lease not found","message":"etcdserver: requested lease not found","code":5}"#;
        assert_eq!(read(&claim, 404, gone), Some(DirectoryAnswer::NoLease));
        assert_eq!(
            read(&DirectoryRequest::Revoke(lease), 404, gone),
            Some(DirectoryAnswer::Revoked)
        );
        let renew = DirectoryRequest::Renew(lease);
        let renewed = r#"{"result":{"header":{},"ID":"7587899251892517127","TTL":"5"}}"#;
        assert_eq!(
            read(&renew, 200, renewed),
            Some(DirectoryAnswer::Renewed(5))
        );
        let ended = r#"{"result":{"header":{},"ID":"77"}}"#;
        assert_eq!(read(&renew, 200, ended), Some(DirectoryAnswer::NoLease));
        let granted = r#"{"header":{},"ID":"7587899251892517127","TTL":"5"}"#;
        let answer = read(&DirectoryRequest::Grant { seconds: 5 }, 200, granted);
        assert_eq!(answer, Some(DirectoryAnswer::Granted(lease, 5)));
        for broken in ["", "{}", "[]", "<html>", r#"{"ID":7}"#] {
            assert_eq!(
                read(&DirectoryRequest::Grant { seconds: 5 }, 200, broken),
                None,
                "{broken}"
            );
            assert_eq!(read(&claim, 200, broken), None, "{broken}");
            assert_eq!(read(&renew, 200, broken), None, "{broken}");
        }
    }

    #[test]
    fn a_notice_is_read_as_it_was_posted() {
        let (scene, place) = (
            "team/pit".parse::<SceneName>().expect("a name"),
            ServerPlace("rhumb://a:1#00".to_owned()),
        );
        let notices = [
            Notice::Server(place.clone()),
            Notice::Drained(place.clone()),
            Notice::Order(scene.clone(), place.clone()),
            Notice::Standby(scene.clone(), place.clone()),
            Notice::Refused(scene.clone(), place.clone()),
        ];
        let mut board = Board::default();
        for notice in &notices {
            let (key, value) = notice.key_and_value();
            board.add(Entry {
                key: format!("{BOARD}{key}"),
                value: value.to_owned(),
                lease: LeaseId(7),
            });
        }
        let expected = Board {
            servers: [(place.clone(), LeaseId(7))].into(),
            drained: [(place.clone(), LeaseId(7))].into(),
            orders: [(scene.clone(), place.clone())].into(),
            standbys: [(scene.clone(), place.clone())].into(),
            refused: [(scene, place)].into(),
        };
        assert_eq!(board, expected);
        board.add(Entry {
            key: format!("{BOARD}order/pit"),
            value: "a b".to_owned(),
            lease: LeaseId(7),
        });
        assert_eq!(board, expected, "no client could read the address");
    }

    /// Recorded of etcd 3.4.23.
    #[test]
    fn a_range_without_keys_is_empty_and_no_answer_is_none() {
        let read = |text: &str| {
            let answer = serde_json::from_str(text).expect("it is JSON");
            entries(&answer).map(|entries| entries.len())
        };
        assert_eq!(read(r#"{"header":{"revision":"2"}}"#), Some(0));
        let one =
            r#"{"header":{},"kvs":[{"key":"cmh1bWI=","value":"MQ==","lease":"7"}],"count":"1"}"#;
        assert_eq!(read(one), Some(1));
        assert_eq!(read("{}"), None);
    }
}
