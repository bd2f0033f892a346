//! One reading of a server's metrics: the request, its text, the values.

use std::collections::BTreeMap;
use std::str::FromStr;
use std::time::Duration;
use std::{fmt, io};

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

/// A server's metrics at a moment.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Reading {
    pub(super) at: Instant,
    /// True if `/health` answered so.
    pub(super) is_healthy: bool,
    samples: Samples,
    pub(super) scenes: BTreeMap<String, SceneReading>,
}

/// Metrics of one scene, by the names that `/metrics` has for them without `rhumb_scene_`.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct SceneReading {
    values: BTreeMap<String, f64>,
    /// Steps that took at most so many seconds, for rising durations.
    pub(super) steps_within: Vec<(f64, f64)>,
}

/// Reason why an answer is not a server's metrics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NoMetrics {
    Unreadable(UnreadableMetrics),
    /// Another program answers there.
    NotAServer,
}

impl fmt::Display for NoMetrics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreadable(cause) => cause.fmt(f),
            Self::NotAServer => f.write_str("the answer has no metrics of a rhumb-server"),
        }
    }
}

/// The beginning of the names of a scene's metrics.
const OF_SCENE: &str = "rhumb_scene_";
/// The histogram of the durations of steps.
const STEP_BUCKETS: &str = "step_seconds_bucket";

impl Reading {
    /// Reads the answer of `/metrics`.
    pub(super) fn parse(at: Instant, is_healthy: bool, text: &str) -> Result<Self, NoMetrics> {
        let samples = Samples::parse(text).map_err(NoMetrics::Unreadable)?;
        if samples.plain("rhumb_scenes").is_none() {
            return Err(NoMetrics::NotAServer);
        }
        let mut scenes: BTreeMap<String, SceneReading> = BTreeMap::new();
        for (name, sample) in samples.iter() {
            let (Some(name), Some(scene)) = (name.strip_prefix(OF_SCENE), sample.label("scene"))
            else {
                continue;
            };
            let scene = scenes.entry(scene.to_owned()).or_default();
            if name == STEP_BUCKETS {
                let end = sample.label("le").and_then(|end| end.parse().ok());
                (scene.steps_within).extend(end.map(|end: f64| (end, sample.value)));
            } else {
                scene.values.insert(name.to_owned(), sample.value);
            }
        }
        for scene in scenes.values_mut() {
            scene.steps_within.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        Ok(Self {
            at,
            is_healthy,
            samples,
            scenes,
        })
    }

    /// A metric of the server.
    pub(super) fn value(&self, name: &str) -> Option<f64> {
        self.samples.plain(name)
    }

    /// Connections that the server closed, by code.
    pub(super) fn closed(&self) -> impl Iterator<Item = (&str, f64)> {
        let closed = self.samples.of("rhumb_closed_total").iter();
        closed.filter_map(|sample| Some((sample.label("code")?, sample.value)))
    }
}

impl SceneReading {
    /// A metric; `None` for one that this server does not have.
    pub(super) fn value(&self, name: &str) -> Option<f64> {
        self.values.get(name).copied()
    }
}

/// Values by name of metric.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Samples(BTreeMap<String, Vec<Sample>>);

/// One value of a metric.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Sample {
    labels: Vec<(String, String)>,
    pub(super) value: f64,
}

/// A line that is no metric, counted from one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct UnreadableMetrics {
    line: usize,
}

impl fmt::Display for UnreadableMetrics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {} of the answer is no metric", self.line)
    }
}

impl Samples {
    /// Reads a whole answer.
    pub(super) fn parse(text: &str) -> Result<Self, UnreadableMetrics> {
        let mut samples = Self::default();
        for (place, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let unreadable = UnreadableMetrics { line: place + 1 };
            let (name, sample) = sample(line).ok_or(unreadable)?;
            samples.0.entry(name).or_default().push(sample);
        }
        Ok(samples)
    }

    /// All values of a metric.
    pub(super) fn of(&self, name: &str) -> &[Sample] {
        self.0.get(name).map_or(&[], Vec::as_slice)
    }

    /// The value of a metric without labels.
    pub(super) fn plain(&self, name: &str) -> Option<f64> {
        self.of(name).first().map(|sample| sample.value)
    }

    /// Every metric with its values, in the order of names.
    pub(super) fn iter(&self) -> impl Iterator<Item = (&str, &Sample)> {
        let metrics = self.0.iter();
        metrics.flat_map(|(name, all)| all.iter().map(|one| (name.as_str(), one)))
    }
}

impl Sample {
    /// The value of a label.
    pub(super) fn label(&self, name: &str) -> Option<&str> {
        let label = self.labels.iter().find(|(of, _)| of == name);
        label.map(|(_, value)| value.as_str())
    }
}

/// `name value` or `name{label="value",…} value`.
fn sample(line: &str) -> Option<(String, Sample)> {
    let (name, labels, rest) = match line.split_once('{') {
        Some((name, rest)) => {
            let (labels, rest) = rest.split_once('}')?;
            (name, labels, rest)
        }
        None => {
            let (name, rest) = line.split_once(char::is_whitespace)?;
            (name, "", rest)
        }
    };
    let value = rest.split_whitespace().next()?.parse().ok()?;
    let labels = labels.split(',').filter(|label| !label.is_empty());
    let labels = labels.map(|label| {
        let (name, value) = label.split_once('=')?;
        let value = value.strip_prefix('"')?.strip_suffix('"')?;
        Some((name.trim().to_owned(), value.to_owned()))
    });
    let labels = labels.collect::<Option<_>>()?;
    Some((name.trim().to_owned(), Sample { labels, value }))
}

/// Time for one answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);
/// Longest answer: metrics of many thousand scenes.
const ANSWER_BYTES_MAX: usize = 64 << 20;
/// The port of metrics unless the URL names one.
const DEFAULT_PORT: u16 = 9464;

/// The URL of a server's metrics: a host and a port.
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
    NoMetrics(NoMetrics),
}

impl fmt::Display for ReadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Connect(cause) => write!(f, "cannot connect: {cause}"),
            Self::Answer(cause) => write!(f, "the answer broke off: {cause}"),
            Self::TooLong => write!(f, "the answer is longer than {ANSWER_BYTES_MAX} bytes"),
            Self::TimedOut => f.write_str("no answer within five seconds"),
            Self::Status(status) => write!(f, "the answer is {status}"),
            Self::NoMetrics(cause) => cause.fmt(f),
        }
    }
}

/// Reads the metrics of one server.
pub(super) struct MetricsReader {
    url: MetricsUrl,
    runtime: Runtime,
    clock: Clock,
}

impl MetricsReader {
    pub(super) fn new(url: MetricsUrl) -> io::Result<Self> {
        Ok(Self {
            url,
            runtime: io_runtime()?,
            clock: Clock::start(),
        })
    }

    /// Reads the metrics and the health.
    pub(super) fn read(&self) -> Result<Reading, ReadError> {
        let (status, metrics) = self.get("/metrics")?;
        if status != StatusCode::OK {
            return Err(ReadError::Status(status));
        }
        let at: Instant = self.clock.now();
        let (health, _) = self.get("/health")?;
        let text = String::from_utf8_lossy(&metrics);
        Reading::parse(at, health == StatusCode::OK, &text).map_err(ReadError::NoMetrics)
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
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn scenes_are_read_with_their_histograms() {
        let text = "rhumb_scenes 1\nrhumb_scene_tick{scene=\"pit\"} 9\n\
            rhumb_scene_step_seconds_bucket{scene=\"pit\",le=\"+Inf\"} 9\n\
            rhumb_scene_step_seconds_bucket{scene=\"pit\",le=\"0.001\"} 8\n\
            rhumb_closed_total{code=\"18\"} 2\n";
        let reading = Reading::parse(Instant::ZERO, true, text).unwrap();
        let pit = &reading.scenes["pit"];
        assert_eq!(pit.value("tick"), Some(9.0));
        assert_eq!(pit.value("wind"), None);
        assert_eq!(pit.steps_within, [(0.001, 8.0), (f64::INFINITY, 9.0)]);
        assert_eq!(reading.closed().collect::<Vec<_>>(), [("18", 2.0)]);
    }

    #[test]
    fn metrics_of_another_program_are_refused() {
        let refused = Reading::parse(Instant::ZERO, true, "process_cpu_seconds_total 3\n");
        assert_eq!(refused, Err(NoMetrics::NotAServer));
        let page = Reading::parse(Instant::ZERO, true, "<!doctype html>\n<p>Hello</p>");
        assert!(matches!(page, Err(NoMetrics::Unreadable(_))), "{page:?}");
    }

    #[test]
    fn metrics_with_and_without_labels_are_read() {
        let text = "# HELP a An a.\n# TYPE a gauge\na 3\n\nb{scene=\"team/pit\",le=\"+Inf\"} 4.5 1700\n\
                    b{scene=\"pit\",le=\"0.1\"} NaN\n";
        let samples = Samples::parse(text).unwrap();
        assert_eq!(samples.plain("a"), Some(3.0));
        let [first, second] = samples.of("b") else {
            panic!("b has two values");
        };
        assert_eq!(first.label("scene"), Some("team/pit"));
        assert_eq!(first.label("le"), Some("+Inf"));
        assert!(first.value == 4.5 && second.value.is_nan());
        assert_eq!(samples.plain("c"), None);
    }

    #[test]
    fn a_line_that_is_no_figure_is_named() {
        for (text, line) in [("a 1\nhello", 2), ("a{b} 1", 1), ("a{b=\"c\" 1", 1)] {
            let refused = Samples::parse(text);
            assert_eq!(refused, Err(UnreadableMetrics { line }), "{text}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in ".*") {
            let _ = Samples::parse(&text);
        }
    }

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
