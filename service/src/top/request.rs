//! Requests of a server's figures.

use std::fmt;
use std::io;
use std::str::FromStr;
use std::time::Duration;

use bytes::Bytes;
use http_body_util::{BodyExt, Empty, Limited};
use hyper::client::conn::http1;
use hyper::header::HOST;
use hyper::{Request, StatusCode, Uri};
use hyper_util::rt::TokioIo;
use rhumb_protocol::Instant;
use rhumb_transport::{Clock, io_runtime};
use tokio::net::TcpStream;
use tokio::runtime::Runtime;
use tokio::time::timeout;

use super::reading::{NoFigures, Reading};

/// Time for one answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);
/// Longest answer: figures of many thousand scenes.
const ANSWER_BYTES_MAX: usize = 64 << 20;
/// The port of figures unless the URL names one.
const DEFAULT_PORT: u16 = 9464;

/// The URL of a server's figures: a host and a port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct MetricsUrl {
    host: String,
    port: u16,
}

impl FromStr for MetricsUrl {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        const FORM: &str = "is no URL such as http://127.0.0.1:9464";
        let uri: Uri = text.parse().map_err(|_| FORM)?;
        let is_http = uri.scheme_str().is_none_or(|scheme| scheme == "http");
        if !is_http {
            return Err("a server answers by http, not by another scheme");
        }
        let is_root = matches!(uri.path(), "" | "/" | "/metrics" | "/health");
        let authority = uri.authority().filter(|_| is_root).ok_or(FORM)?;
        Ok(Self {
            host: authority.host().to_owned(),
            port: authority.port_u16().unwrap_or(DEFAULT_PORT),
        })
    }
}

impl fmt::Display for MetricsUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "http://{}:{}", self.host, self.port)
    }
}

/// Reason why a server cannot be read.
#[derive(Debug)]
pub(super) enum ReadError {
    Connect(io::Error),
    Answer(hyper::Error),
    TooLong,
    TimedOut,
    Status(StatusCode),
    NoFigures(NoFigures),
}

impl fmt::Display for ReadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Connect(cause) => write!(f, "cannot connect: {cause}"),
            Self::Answer(cause) => write!(f, "the answer broke off: {cause}"),
            Self::TooLong => write!(f, "the answer is longer than {ANSWER_BYTES_MAX} bytes"),
            Self::TimedOut => f.write_str("no answer within five seconds"),
            Self::Status(status) => write!(f, "the answer is {status}"),
            Self::NoFigures(cause) => cause.fmt(f),
        }
    }
}

/// Reads the figures of one server.
pub(super) struct FiguresReader {
    url: MetricsUrl,
    runtime: Runtime,
    clock: Clock,
}

impl FiguresReader {
    pub(super) fn new(url: MetricsUrl) -> io::Result<Self> {
        Ok(Self {
            url,
            runtime: io_runtime()?,
            clock: Clock::start(),
        })
    }

    /// Reads the figures and the health.
    pub(super) fn read(&self) -> Result<Reading, ReadError> {
        let (status, figures) = self.get("/metrics")?;
        if status != StatusCode::OK {
            return Err(ReadError::Status(status));
        }
        let at: Instant = self.clock.now();
        let (health, _) = self.get("/health")?;
        let text = String::from_utf8_lossy(&figures);
        Reading::parse(at, health == StatusCode::OK, &text).map_err(ReadError::NoFigures)
    }

    fn get(&self, path: &str) -> Result<(StatusCode, Bytes), ReadError> {
        let answer = async { timeout(ANSWER_TIMEOUT, get(&self.url, path)).await };
        let answer = self.runtime.block_on(answer);
        answer.unwrap_or(Err(ReadError::TimedOut))
    }
}

async fn get(url: &MetricsUrl, path: &str) -> Result<(StatusCode, Bytes), ReadError> {
    // An address of IPv6 stands in brackets within a URL only.
    let host = url.host.trim_matches(['[', ']']);
    let stream = TcpStream::connect((host, url.port)).await;
    let stream = TokioIo::new(stream.map_err(ReadError::Connect)?);
    let (mut sender, connection) = http1::handshake(stream).await.map_err(ReadError::Answer)?;
    let request = Request::get(path).header(HOST, format!("{}:{}", url.host, url.port));
    let request = request
        .body(Empty::<Bytes>::new())
        .expect("the path is constant, and the host was parsed");
    let exchange = async move {
        let answer = sender.send_request(request).await;
        let answer = answer.map_err(ReadError::Answer)?;
        let status = answer.status();
        let body = Limited::new(answer.into_body(), ANSWER_BYTES_MAX).collect();
        match body.await {
            Ok(body) => Ok((status, body.to_bytes())),
            Err(cause) => Err(match cause.downcast::<hyper::Error>() {
                Ok(cause) => ReadError::Answer(*cause),
                Err(_) => ReadError::TooLong,
            }),
        }
    };
    let (answer, _) = tokio::join!(exchange, connection);
    answer
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn urls_name_a_host_and_a_port() {
        for (text, url) in [
            ("http://127.0.0.1:9464", "http://127.0.0.1:9464"),
            ("127.0.0.1:9000", "http://127.0.0.1:9000"),
            ("http://server/metrics", "http://server:9464"),
            ("http://[::1]:1/", "http://[::1]:1"),
        ] {
            assert_eq!(text.parse::<MetricsUrl>().unwrap().to_string(), url);
        }
        for text in ["https://a:1", "http://a:1/other", "", "a b", "http://"] {
            assert!(text.parse::<MetricsUrl>().is_err(), "{text}");
        }
    }
}
