//! Accepts TCP connections and answers HTTP requests, on their own threads.
//!
//! HTTP is for metrics, health and the page, and for requests to what runs beside a server. It shares nothing with a scene but
//! what the answering function reads.
//!
//! Peers cannot hold a thread up: connections are bounded, also those of one address, and so are heads, bodies and times
//! of requests, and bytes and times of the answers to our own. A system without descriptors is asked again.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bytes::Bytes;
use http_body_util::{BodyExt, Full, Limited};
use hyper::body::Incoming;
use hyper::client::conn::http1 as client;
use hyper::header::{CONTENT_TYPE, HOST, HeaderName, HeaderValue, ORIGIN};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use rhumb_transport::io_runtime;
use serde_json::Value;
use tokio::io::AsyncReadExt;
use tokio::net::TcpStream;
use tokio::sync::{Semaphore, oneshot};
use tokio::time::timeout;

/// Time for the head of a request, and again for its body.
const PART_TIMEOUT: Duration = Duration::from_secs(5);
/// Time for a connection in all.
const CONNECTION_TIMEOUT: Duration = Duration::from_secs(60);
/// Longest head of a request.
const HEAD_BYTES_MAX: usize = 16 << 10;
/// Longest body of a request.
const BODY_BYTES_MAX: usize = 4 << 10;

/// Longest body of an answer that is read, bytes.
const ANSWER_BYTES_MAX: usize = 1 << 20;
/// Bytes that are read of one answer: its body and all heads, of which there may be any number.
const ASKED_BYTES_MAX: u64 = (ANSWER_BYTES_MAX + (64 << 10)) as u64;

/// Asks another server once, with JSON or without a body, by a connection of its own; `None` without a whole answer within
/// the time. The host may be an address of IPv6 in brackets, as in a URL.
pub(crate) async fn ask(
    peer: (&str, u16),
    call: (Method, &str),
    body: Option<&Value>,
    within: Duration,
) -> Option<(StatusCode, Bytes)> {
    let asked = timeout(within, exchange(peer, call, body));
    asked.await.ok().flatten()
}

async fn exchange(
    (host, port): (&str, u16),
    (method, path): (Method, &str),
    body: Option<&Value>,
) -> Option<(StatusCode, Bytes)> {
    let body = Bytes::from(body.map(Value::to_string).unwrap_or_default());
    let stream = TcpStream::connect((host.trim_matches(['[', ']']), port)).await;
    let (reads, writes) = stream.ok()?.into_split();
    let stream = tokio::io::join(reads.take(ASKED_BYTES_MAX), writes);
    let (mut sender, connection) = client::handshake(TokioIo::new(stream)).await.ok()?;
    let request = Request::builder()
        .method(method)
        .uri(path)
        .header(HOST, format!("{host}:{port}"))
        .header(CONTENT_TYPE, "application/json")
        .body(Full::new(body))
        .ok()?;
    let exchange = async move {
        let answer = sender.send_request(request).await.ok()?;
        let status = answer.status();
        let body = Limited::new(answer.into_body(), ANSWER_BYTES_MAX).collect();
        Some((status, body.await.ok()?.to_bytes()))
    };
    let (answer, _) = tokio::join!(exchange, connection);
    answer
}

/// A request, as far as an answer depends on it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct HttpRequest {
    pub(crate) method: Method,
    pub(crate) path: String,
    /// The name or address, and the port, under which the peer knows this server.
    pub(crate) host: Option<String>,
    /// The page that requests, if the browser names one.
    pub(crate) origin: Option<String>,
    pub(crate) body: Bytes,
}

impl HttpRequest {
    /// The host part of the address by which the server was reached: [`reached_host`].
    pub(crate) fn host(&self, named: bool) -> Option<&str> {
        reached_host(self.host.as_deref()?, named)
    }

    /// The page that requests, if it is not one of this server.
    pub(crate) fn foreign_origin(&self) -> Option<&str> {
        let origin = self.origin.as_deref()?;
        let (_, place) = origin.split_once("://").unwrap_or_default();
        let host = self.host.as_deref();
        let is_own = host.is_some_and(|host| host.eq_ignore_ascii_case(place));
        (!is_own).then_some(origin)
    }
}

/// The host that a request names, without its port. `None` for a name, which others could have pointed at this machine,
/// unless the server is `named`: bound where other machines reach it.
pub(crate) fn reached_host(host: &str, named: bool) -> Option<&str> {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|digit| digit.is_ascii_digit()) => name,
        _ => host,
    };
    // A dot at the end of a name is the root of all names.
    let rooted = name.strip_suffix('.').unwrap_or(name);
    let bare = rooted.trim_start_matches('[').trim_end_matches(']');
    let is_address = bare.parse::<IpAddr>().is_ok() || bare.eq_ignore_ascii_case("localhost");
    let is_name = !bare.is_empty()
        && bare
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || b"-._".contains(&byte));
    (is_address || named && is_name).then_some(name)
}

/// An answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct HttpAnswer {
    pub(crate) status: StatusCode,
    pub(crate) content_type: &'static str,
    pub(crate) headers: Vec<(HeaderName, HeaderValue)>,
    pub(crate) body: Bytes,
}

/// The type of plain text.
pub(crate) const TEXT: &str = "text/plain; charset=utf-8";

impl HttpAnswer {
    /// A success.
    pub(crate) fn ok(content_type: &'static str, body: impl Into<Bytes>) -> Self {
        Self {
            status: StatusCode::OK,
            content_type,
            headers: Vec::new(),
            body: body.into(),
        }
    }

    /// A refusal that says why.
    pub(crate) fn refusal(status: StatusCode, reason: impl Into<String>) -> Self {
        Self {
            status,
            content_type: TEXT,
            headers: Vec::new(),
            body: Bytes::from(reason.into() + "\n"),
        }
    }
}

/// Answers requests.
type Answering = Arc<dyn Fn(&HttpRequest) -> HttpAnswer + Send + Sync>;

/// Answers requests at a bound socket.
pub(crate) fn start(
    listener: TcpListener,
    name: &str,
    answering: Answering,
) -> io::Result<TcpService> {
    start_within(listener, name, answering, PART_TIMEOUT)
}

/// Like [`start`], with another time for the head of a request, and for its body.
fn start_within(
    listener: TcpListener,
    name: &str,
    answering: Answering,
    part: Duration,
) -> io::Result<TcpService> {
    let serving = move |stream, peer| -> Pin<Box<dyn Future<Output = ()> + Send>> {
        Box::pin(serve(stream, peer, Arc::clone(&answering), part))
    };
    TcpService::start(listener, name, Arc::new(serving))
}

async fn serve(stream: TcpStream, peer: SocketAddr, answering: Answering, part: Duration) {
    let service = service_fn(|request| async {
        Ok::<_, Infallible>(respond(request, &answering, part).await)
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .keep_alive(false)
        .header_read_timeout(part)
        .max_buf_size(HEAD_BYTES_MAX)
        .serve_connection(TokioIo::new(stream), service);
    // A connection that takes too long ends here.
    if let Ok(Err(cause)) = timeout(CONNECTION_TIMEOUT, connection).await {
        tracing::debug!(%peer, %cause, "an http connection failed");
    }
}

async fn respond(
    request: Request<Incoming>,
    answering: &Answering,
    part: Duration,
) -> Response<Full<Bytes>> {
    let answer = match read(request, part).await {
        Ok(request) => answering(&request),
        Err(refusal) => refusal,
    };
    let mut response = Response::new(Full::new(answer.body));
    *response.status_mut() = answer.status;
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(answer.content_type));
    headers.extend(
        answer
            .headers
            .into_iter()
            .map(|(name, value)| (Some(name), value)),
    );
    response
}

/// The request, with its whole body, or the refusal of one that cannot be answered.
async fn read(request: Request<Incoming>, part: Duration) -> Result<HttpRequest, HttpAnswer> {
    let (head, body) = request.into_parts();
    let refusal = |status, reason: String| Err(HttpAnswer::refusal(status, reason));
    // Two readers of one request could take two different hosts from it.
    for name in [HOST, ORIGIN] {
        if head.headers.get_all(&name).iter().count() > 1 {
            return refusal(
                StatusCode::BAD_REQUEST,
                format!("a request has one line {name}"),
            );
        }
    }
    let text = |name| head.headers.get(name)?.to_str().ok().map(str::to_owned);
    let (host, origin) = (text(HOST), text(ORIGIN));
    let body = timeout(part, Limited::new(body, BODY_BYTES_MAX).collect()).await;
    match body {
        Ok(Ok(body)) => Ok(HttpRequest {
            method: head.method,
            path: head.uri.path().to_owned(),
            host,
            origin,
            body: body.to_bytes(),
        }),
        Ok(Err(_)) => refusal(
            StatusCode::PAYLOAD_TOO_LARGE,
            format!("a request has {BODY_BYTES_MAX} bytes at most"),
        ),
        Err(_) => refusal(
            StatusCode::REQUEST_TIMEOUT,
            format!("a request's body comes within {} s", part.as_secs_f32()),
        ),
    }
}

/// Connections at one time: several browsers, scrapers or viewers. Others wait.
const CONNECTIONS_MAX: usize = 64;
/// Connections of one address at one time; further ones are closed. A browser opens six.
const PEER_CONNECTIONS_MAX: usize = 16;
/// Pause after the system refused a connection, for lack of descriptors.
const REFUSED_PAUSE: Duration = Duration::from_millis(50);

/// Serves one connection to its end.
pub(crate) type Serving =
    Arc<dyn Fn(TcpStream, SocketAddr) -> Pin<Box<dyn Future<Output = ()> + Send>> + Send + Sync>;

/// The thread that accepts; it ends, with all connections, when this is dropped.
#[derive(Debug)]
pub(crate) struct TcpService {
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl TcpService {
    /// Serves connections to a bound socket.
    pub(crate) fn start(listener: TcpListener, name: &str, serving: Serving) -> io::Result<Self> {
        listener.set_nonblocking(true)?;
        let runtime = io_runtime()?;
        let listener = {
            let _inside = runtime.enter();
            tokio::net::TcpListener::from_std(listener)?
        };
        let (end, ended) = oneshot::channel();
        let thread = thread::Builder::new()
            .name(name.into())
            .spawn(move || runtime.block_on(accept(listener, serving, ended)))?;
        Ok(Self {
            end: Some(end),
            thread: Some(thread),
        })
    }
}

impl Drop for TcpService {
    fn drop(&mut self) {
        if let Some(end) = self.end.take() {
            // An error means that the thread has ended already.
            let _ = end.send(());
        }
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was logged.
            let _ = thread.join();
        }
    }
}

/// Connections of each address.
type Peers = Arc<Mutex<BTreeMap<IpAddr, usize>>>;

/// The place of a connection among those of its address, given back when it is dropped.
struct PeerPlace {
    peers: Peers,
    ip: IpAddr,
}

impl PeerPlace {
    /// A place; `None` if the address has all of its places.
    fn take(peers: &Peers, ip: IpAddr) -> Option<Self> {
        let mut counts = peers.lock().unwrap_or_else(PoisonError::into_inner);
        let count = counts.entry(ip).or_default();
        (*count < PEER_CONNECTIONS_MAX).then(|| {
            *count += 1;
            Self {
                peers: Arc::clone(peers),
                ip,
            }
        })
    }
}

impl Drop for PeerPlace {
    fn drop(&mut self) {
        let mut counts = self.peers.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = counts.get_mut(&self.ip) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&self.ip);
            }
        }
    }
}

async fn accept(
    listener: tokio::net::TcpListener,
    serving: Serving,
    mut ended: oneshot::Receiver<()>,
) {
    let places = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    let peers = Peers::default();
    loop {
        let place = tokio::select! {
            _ = &mut ended => return,
            place = Arc::clone(&places).acquire_owned() => place,
        };
        // The semaphore is never closed.
        let Ok(place) = place else {
            return;
        };
        let accepted = tokio::select! {
            _ = &mut ended => return,
            accepted = listener.accept() => accepted,
        };
        match accepted {
            Ok((stream, peer)) => {
                let Some(of_peer) = PeerPlace::take(&peers, peer.ip()) else {
                    tracing::debug!(%peer, "a connection was closed: its address has {PEER_CONNECTIONS_MAX}");
                    continue;
                };
                let served = serving(stream, peer);
                tokio::spawn(async move {
                    served.await;
                    drop((place, of_peer));
                });
            }
            Err(cause) => {
                tracing::debug!(%cause, "a connection was not accepted");
                tokio::time::sleep(REFUSED_PAUSE).await;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net::TcpStream;
    use std::sync::Mutex;

    use super::*;
    use crate::http::PEER_CONNECTIONS_MAX;

    /// Longer than any answer takes; reached only by a failure.
    const LONG: Duration = Duration::from_secs(30);

    /// A listener that answers by the path, and the requests that it got.
    fn listening() -> (TcpService, SocketAddr, Arc<Mutex<Vec<HttpRequest>>>) {
        listening_within(LONG)
    }

    fn listening_within(part: Duration) -> (TcpService, SocketAddr, Arc<Mutex<Vec<HttpRequest>>>) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let requests = Arc::new(Mutex::new(Vec::new()));
        let noted = Arc::clone(&requests);
        let answering = Arc::new(move |request: &HttpRequest| {
            noted.lock().unwrap().push(request.clone());
            HttpAnswer::ok(TEXT, request.path.clone())
        });
        let listener = start_within(listener, "rhumb-test-http", answering, part).unwrap();
        (listener, address, requests)
    }

    fn connect(address: SocketAddr) -> TcpStream {
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(LONG)).unwrap();
        stream
    }

    fn answer(mut stream: TcpStream, request: &[u8]) -> String {
        stream.write_all(request).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    }

    #[test]
    fn a_request_is_passed_on_whole_and_its_answer_sent() {
        let (_listener, address, requests) = listening();
        let request = b"POST /a?b HTTP/1.1\r\nHost: here:1\r\nOrigin: http://here:1\r\nContent-Length: 2\r\n\r\nok";
        let answer = answer(connect(address), request);
        assert!(answer.starts_with("HTTP/1.1 200 OK\r\n"), "{answer}");
        assert!(answer.ends_with("\r\n\r\n/a"), "{answer}");
        let expected = HttpRequest {
            method: Method::POST,
            path: "/a".into(),
            host: Some("here:1".into()),
            origin: Some("http://here:1".into()),
            body: Bytes::from_static(b"ok"),
        };
        assert_eq!(*requests.lock().unwrap(), [expected]);
    }

    #[test]
    fn a_host_is_known_in_any_case_and_with_the_root_s_dot() {
        for host in [
            "localhost",
            "LOCALHOST",
            "LocalHost:80",
            "localhost.",
            "LOCALHOST.:80",
            "127.0.0.1:1",
            "[::1]:1",
        ] {
            assert!(reached_host(host, false).is_some(), "{host}");
        }
        for host in [
            "",
            ".",
            ":80",
            "localhost..",
            "localhost.evil",
            "evil.localhost",
            "127.0.0.1.nip.io",
        ] {
            assert_eq!(reached_host(host, false), None, "{host}");
        }
        for (host, known) in [
            ("Physics.example.:80", true),
            ("", false),
            (".", false),
            ("a/b", false),
        ] {
            assert_eq!(reached_host(host, true).is_some(), known, "{host}");
        }
    }

    #[test]
    fn a_peer_that_says_nothing_holds_up_no_other() {
        let (_listener, address, _) = listening();
        let silent: Vec<_> = (0..8).map(|_| connect(address)).collect();
        let answer = answer(connect(address), b"GET / HTTP/1.1\r\nHost: x\r\n\r\n");
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        drop(silent);
    }

    #[test]
    fn what_is_too_long_or_no_request_reaches_no_answering_function() {
        let (_listener, address, requests) = listening();
        let long = format!(
            "POST / HTTP/1.1\r\nHost: x\r\nContent-Length: {}\r\n\r\n",
            BODY_BYTES_MAX + 1
        );
        let mut request = long.into_bytes();
        request.resize(request.len() + BODY_BYTES_MAX + 1, b'x');
        let refused = answer(connect(address), &request);
        assert!(refused.starts_with("HTTP/1.1 413"), "{refused}");
        let refused = answer(connect(address), b"no request\r\n\r\n");
        assert!(refused.starts_with("HTTP/1.1 400"), "{refused}");
        assert!(requests.lock().unwrap().is_empty());
    }

    #[test]
    fn a_body_that_never_comes_holds_its_place_for_no_longer_than_a_head() {
        let (_listener, address, requests) = listening_within(Duration::from_millis(50));
        let refused = answer(
            connect(address),
            b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 2\r\n\r\n",
        );
        assert!(refused.starts_with("HTTP/1.1 408"), "{refused}");
        assert!(requests.lock().unwrap().is_empty());
    }

    #[test]
    fn a_request_with_two_hosts_or_origins_is_refused() {
        let (_listener, address, requests) = listening();
        for twice in [
            "Host: a\r\nHost: b",
            "Host: a\r\nOrigin: http://a\r\nOrigin: http://b",
        ] {
            let request = format!("GET / HTTP/1.1\r\n{twice}\r\n\r\n");
            let refused = answer(connect(address), request.as_bytes());
            assert!(refused.starts_with("HTTP/1.1 400"), "{refused}");
        }
        assert!(requests.lock().unwrap().is_empty());
    }

    #[test]
    fn an_address_has_its_share_of_places_and_gets_them_back() {
        let (_listener, address, _) = listening();
        let mut silent: Vec<_> = (0..PEER_CONNECTIONS_MAX)
            .map(|_| connect(address))
            .collect();
        let mut rest = String::new();
        let one_more = connect(address).read_to_string(&mut rest);
        assert!(
            !matches!(one_more, Ok(1..)),
            "an answer beyond the share: {rest}"
        );
        let last = silent.pop().unwrap();
        let given = answer(last, b"GET / HTTP/1.1\r\nHost: x\r\n\r\n");
        assert!(given.starts_with("HTTP/1.1 200"), "{given}");
        // The place is free once the server has seen that the connection is over.
        let served = (0..1_000).any(|_| {
            let mut stream = connect(address);
            let mut given = String::new();
            let sent = stream.write_all(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n");
            sent.is_ok() && stream.read_to_string(&mut given).is_ok() && given.contains("200 OK")
        });
        assert!(served);
    }

    /// The answer that a request gets from a peer that sends this again and again, then nothing more, and keeps the connection.
    fn asked(sent: &'static [u8], times: usize, within: Duration) -> Option<(StatusCode, Bytes)> {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let peer = thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let sent = (0..times).try_for_each(|_| stream.write_all(sent));
            // A reader that has enough closes.
            sent.is_ok().then_some(stream)
        });
        let asking = ask(("127.0.0.1", port), (Method::GET, "/"), None, within);
        let answer = io_runtime().unwrap().block_on(asking);
        drop(peer.join());
        answer
    }

    const EARLY_HINTS: &[u8] = b"HTTP/1.1 103 Early Hints\r\n\r\n";

    #[test]
    fn a_peer_that_announces_an_answer_without_end_is_given_up_after_so_many_bytes() {
        assert_eq!(asked(EARLY_HINTS, usize::MAX, Duration::MAX), None);
    }

    #[test]
    fn a_peer_that_announces_an_answer_and_sends_none_has_its_time() {
        assert_eq!(asked(EARLY_HINTS, 3, Duration::from_millis(50)), None);
    }

    #[test]
    fn an_answer_counts_whatever_announced_it_and_though_its_connection_stays() {
        const ANSWER: &[u8] =
            b"HTTP/1.1 102 Processing\r\n\r\nHTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\nok";
        let expected = (StatusCode::OK, Bytes::from_static(b"ok"));
        assert_eq!(asked(ANSWER, 1, LONG), Some(expected));
    }

    #[test]
    fn it_ends_while_peers_are_connected() {
        let (listener, address, _) = listening();
        let mut peer = connect(address);
        drop(listener);
        let mut rest = Vec::new();
        // Closed, or reset: either way it is over.
        let _ = peer.read_to_end(&mut rest);
        assert!(rest.is_empty());
    }
}
