//! Answers HTTP requests on a thread of its own.
//!
//! For metrics, health and the page. Peers cannot hold it up: connections, heads, bodies and times are bounded. It shares
//! nothing with a scene but what the answering function reads.

use std::convert::Infallible;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bytes::Bytes;
use http_body_util::{BodyExt, Full, Limited};
use hyper::body::Incoming;
use hyper::header::{CONTENT_TYPE, HOST, HeaderName, HeaderValue, ORIGIN};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use rhumb_transport::io_runtime;
use tokio::net::TcpStream;
use tokio::sync::{Semaphore, oneshot};
use tokio::time::timeout;

/// Time for the head of a request.
const HEAD_TIMEOUT: Duration = Duration::from_secs(5);
/// Time for a connection in all.
const CONNECTION_TIMEOUT: Duration = Duration::from_secs(60);
/// Connections at one time: several browsers and scrapers. Others wait.
const CONNECTIONS_MAX: usize = 64;
/// Longest head of a request.
const HEAD_BYTES_MAX: usize = 16 << 10;
/// Longest body of a request.
const BODY_BYTES_MAX: usize = 4 << 10;
/// Pause after the system refused a connection, for lack of descriptors.
const REFUSED_PAUSE: Duration = Duration::from_millis(50);

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
pub(crate) type Answering = Arc<dyn Fn(&HttpRequest) -> HttpAnswer + Send + Sync>;

/// The thread that answers; it ends when this is dropped.
#[derive(Debug)]
pub(crate) struct HttpListener {
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl HttpListener {
    /// Answers requests at a bound socket.
    pub(crate) fn start(
        listener: TcpListener,
        name: &str,
        answering: Answering,
    ) -> io::Result<Self> {
        listener.set_nonblocking(true)?;
        let runtime = io_runtime()?;
        let listener = {
            let _inside = runtime.enter();
            tokio::net::TcpListener::from_std(listener)?
        };
        let (end, ended) = oneshot::channel();
        let thread = thread::Builder::new()
            .name(name.into())
            .spawn(move || runtime.block_on(accept(listener, answering, ended)))?;
        Ok(Self {
            end: Some(end),
            thread: Some(thread),
        })
    }
}

impl Drop for HttpListener {
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

async fn accept(
    listener: tokio::net::TcpListener,
    answering: Answering,
    mut ended: oneshot::Receiver<()>,
) {
    let places = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    loop {
        // The semaphore is never closed.
        let Ok(place) = Arc::clone(&places).acquire_owned().await else {
            return;
        };
        let accepted = tokio::select! {
            _ = &mut ended => return,
            accepted = listener.accept() => accepted,
        };
        match accepted {
            Ok((stream, peer)) => {
                let answering = Arc::clone(&answering);
                tokio::spawn(async move {
                    serve(stream, peer, answering).await;
                    drop(place);
                });
            }
            Err(cause) => {
                tracing::debug!(%cause, "a connection for http was not accepted");
                tokio::time::sleep(REFUSED_PAUSE).await;
            }
        }
    }
}

async fn serve(stream: TcpStream, peer: SocketAddr, answering: Answering) {
    let service = service_fn(move |request| {
        let answering = Arc::clone(&answering);
        async move { Ok::<_, Infallible>(respond(request, &answering).await) }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .keep_alive(false)
        .header_read_timeout(HEAD_TIMEOUT)
        .max_buf_size(HEAD_BYTES_MAX)
        .serve_connection(TokioIo::new(stream), service);
    // A connection that takes too long ends here.
    if let Ok(Err(cause)) = timeout(CONNECTION_TIMEOUT, connection).await {
        tracing::debug!(%peer, %cause, "an http connection failed");
    }
}

async fn respond(
    request: hyper::Request<Incoming>,
    answering: &Answering,
) -> Response<Full<Bytes>> {
    let (head, body) = request.into_parts();
    let text = |name| head.headers.get(name)?.to_str().ok().map(str::to_owned);
    let (host, origin) = (text(HOST), text(ORIGIN));
    let answer = match Limited::new(body, BODY_BYTES_MAX).collect().await {
        Ok(body) => answering(&HttpRequest {
            method: head.method,
            path: head.uri.path().to_owned(),
            host,
            origin,
            body: body.to_bytes(),
        }),
        Err(_) => HttpAnswer::refusal(
            StatusCode::PAYLOAD_TOO_LARGE,
            format!("a request has {BODY_BYTES_MAX} bytes at most"),
        ),
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

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net::TcpStream;
    use std::sync::Mutex;

    use super::*;

    /// Longer than any answer takes; reached only by a failure.
    const LONG: Duration = Duration::from_secs(30);

    /// A listener that answers by the path, and the requests that it got.
    fn listening() -> (HttpListener, SocketAddr, Arc<Mutex<Vec<HttpRequest>>>) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let requests = Arc::new(Mutex::new(Vec::new()));
        let noted = Arc::clone(&requests);
        let answering = Arc::new(move |request: &HttpRequest| {
            noted.lock().unwrap().push(request.clone());
            HttpAnswer::ok(TEXT, request.path.clone())
        });
        let listener = HttpListener::start(listener, "rhumb-test-http", answering).unwrap();
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
