//! One reading of a server's metrics, columns, changes between readings.

use std::cmp::Ordering;
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

/// One column.
#[derive(Clone, Copy, Debug)]
pub(super) struct Column {
    pub(super) title: &'static str,
    /// Width on a screen, characters.
    pub(super) width: u16,
    /// On a narrow screen the columns of the lowest ranks are left out.
    rank: u8,
    value: fn(&SceneChange<'_>) -> Option<f64>,
    text: fn(Option<f64>) -> String,
}

/// The column of names stands before all others.
pub(super) const NAME_TITLE: &str = "SCENE";

/// All columns but that of the name.
pub(super) const COLUMNS: [Column; 12] = [
    column("CLIENTS", 7, 8, |of| of.value("members"), whole),
    column("BODIES", 7, 9, |of| of.value("bodies"), whole),
    column("AWAKE", 7, 4, |of| of.value("bodies_awake"), whole),
    column("TICK", 9, 6, |of| of.value("tick"), whole),
    column(
        "TICKS/s",
        7,
        10,
        |of| of.rate("tick"),
        |rate| number(rate, 1),
    ),
    column("p50ms", 6, 2, |of| of.step_quantile(0.5), milliseconds),
    column("p99ms", 6, 7, |of| of.step_quantile(0.99), milliseconds),
    column("BUSY%", 6, 12, busy, percent),
    column("LATE", 6, 3, |of| of.value("late_total"), whole),
    column(
        "INkB/s",
        7,
        5,
        |of| of.rate("received_bytes_total"),
        kilobytes,
    ),
    column(
        "OUTkB/s",
        8,
        11,
        |of| of.rate("sent_bytes_total"),
        kilobytes,
    ),
    column("WAIT", 5, 1, |of| of.value("bodies_waiting"), whole),
];

const fn column(
    title: &'static str,
    width: u16,
    rank: u8,
    value: fn(&SceneChange<'_>) -> Option<f64>,
    text: fn(Option<f64>) -> String,
) -> Column {
    Column {
        title,
        width,
        rank,
        value,
        text,
    }
}

/// Width of the column of names, characters; more if there is room.
pub(super) const NAME_WIDTH: u16 = 12;

/// Places of the columns that a screen of this width has room for whole, in their order. The sorted column stays longest.
pub(super) fn fitting(width: u16, sorted: Option<usize>) -> Vec<usize> {
    let mut places: Vec<usize> = (0..COLUMNS.len()).collect();
    let needed = |places: &[usize]| {
        let widths = places.iter().map(|place| COLUMNS[*place].width + 1);
        NAME_WIDTH + widths.sum::<u16>()
    };
    while needed(&places) > width {
        let rank = |place: &usize| (sorted == Some(*place), COLUMNS[*place].rank);
        let Some(least) = places.iter().copied().min_by_key(rank) else {
            break;
        };
        places.retain(|place| *place != least);
    }
    places
}

fn whole(value: Option<f64>) -> String {
    number(value, 0)
}

impl Column {
    /// The text of a cell.
    pub(super) fn cell(&self, scene: &SceneChange<'_>) -> String {
        (self.text)((self.value)(scene))
    }
}

/// The order of rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct SortOrder {
    /// `None` sorts by name.
    pub(super) column: Option<usize>,
    pub(super) is_reversed: bool,
}

impl SortOrder {
    /// The order after this one: by name, then by each column, greatest first.
    pub(super) fn next(self) -> Self {
        let column = match self.column {
            None => Some(0),
            Some(last) if last + 1 == COLUMNS.len() => None,
            Some(column) => Some(column + 1),
        };
        Self {
            column,
            is_reversed: column.is_some(),
        }
    }

    pub(super) const fn reversed(self) -> Self {
        Self {
            is_reversed: !self.is_reversed,
            ..self
        }
    }

    /// Sorts rows; those without the metric come last, and equal ones by name.
    pub(super) fn sort(self, rows: &mut [SceneChange<'_>]) {
        rows.sort_by(|a, b| {
            let by_column = self.column.and_then(|column| COLUMNS.get(column));
            let order = by_column.map_or(Ordering::Equal, |column| {
                let (a, b) = ((column.value)(a), (column.value)(b));
                match (a, b) {
                    (Some(a), Some(b)) if self.is_reversed => b.total_cmp(&a),
                    (Some(a), Some(b)) => a.total_cmp(&b),
                    (a, b) => b.is_some().cmp(&a.is_some()),
                }
            });
            let by_name = a.name.cmp(b.name);
            order.then(if self.is_reversed && by_column.is_none() {
                by_name.reverse()
            } else {
                by_name
            })
        });
    }
}

/// The share of the time that a scene's steps take, percent.
fn busy(of: &SceneChange<'_>) -> Option<f64> {
    of.busy()
}

/// A number with this many digits after the point; a dash for one that is unknown.
pub(super) fn number(value: Option<f64>, digits: usize) -> String {
    match value {
        Some(value) if value.is_finite() => format!("{value:.digits$}"),
        _ => "-".to_owned(),
    }
}

/// Seconds as milliseconds.
pub(super) fn milliseconds(seconds: Option<f64>) -> String {
    match seconds {
        // Beyond the last bucket of the histogram.
        Some(seconds) if seconds == f64::INFINITY => ">100".to_owned(),
        seconds => number(seconds.map(|seconds| seconds * 1e3), 2),
    }
}

/// Bytes as kilobytes of a thousand.
fn kilobytes(bytes: Option<f64>) -> String {
    number(bytes.map(|bytes| bytes / 1e3), 1)
}

/// A share as percent.
pub(super) fn percent(share: Option<f64>) -> String {
    number(share.map(|share| share * 1e2), 1)
}

/// `1 scene`, `2 scenes`.
pub(super) fn count(value: Option<f64>, one: &str) -> String {
    let plural = if value == Some(1.0) { "" } else { "s" };
    format!("{} {one}{plural}", number(value, 0))
}

/// A scene's metrics, and how they changed since the reading before.
#[derive(Clone, Copy, Debug)]
pub(super) struct SceneChange<'a> {
    pub(super) name: &'a str,
    now: &'a SceneReading,
    before: Option<&'a SceneReading>,
    /// Seconds between the readings.
    seconds: f64,
}

impl<'a> SceneChange<'a> {
    /// All scenes of a reading, in the order of names.
    pub(super) fn all(
        now: &'a Reading,
        before: Option<&'a Reading>,
    ) -> impl Iterator<Item = SceneChange<'a>> {
        let nanos = before.map_or(0, |before| now.at.since(before.at).as_nanos());
        now.scenes.iter().map(move |(name, scene)| SceneChange {
            name,
            now: scene,
            before: before.and_then(|before| before.scenes.get(name)),
            seconds: nanos as f64 / 1e9,
        })
    }

    /// A metric of the newest reading.
    pub(super) fn value(&self, metric: &str) -> Option<f64> {
        self.now.value(metric)
    }

    /// Growth of a count in a second. `None` without a reading before, and for a count that began anew.
    pub(super) fn rate(&self, metric: &str) -> Option<f64> {
        let grown = self.growth(metric)?;
        (self.seconds > 0.0).then(|| grown / self.seconds)
    }

    fn growth(&self, metric: &str) -> Option<f64> {
        let grown = self.now.value(metric)? - self.before?.value(metric)?;
        (grown >= 0.0).then_some(grown)
    }

    /// Duration within which this share of the steps was done since the reading before, seconds, interpolated within the
    /// buckets of the histogram; infinite beyond the last. Without such steps: of all steps so far.
    pub(super) fn step_quantile(&self, share: f64) -> Option<f64> {
        let before = self.before.map_or(&[][..], |before| &before.steps_within);
        let fits = before.len() == self.now.steps_within.len();
        let recent = self.now.steps_within.iter().enumerate().map(|(at, now)| {
            let earlier = if fits { before[at].1 } else { 0.0 };
            (now.0, now.1 - earlier)
        });
        quantile(recent, share).or_else(|| quantile(self.now.steps_within.iter().copied(), share))
    }

    /// Time on the scene's thread for steps and publishing, as a share of the time of a second.
    pub(super) fn busy(&self) -> Option<f64> {
        let publish = self.rate("publish_seconds_total")?;
        Some(self.rate("step_seconds_sum")? + publish)
    }

    /// Mean time of publishing a tick, seconds.
    pub(super) fn publish_mean(&self) -> Option<f64> {
        let steps = self.growth("step_seconds_count")?;
        let publish = self.growth("publish_seconds_total")?;
        (steps > 0.0).then(|| publish / steps)
    }
}

/// A quantile of a histogram of cumulative counts.
fn quantile(within: impl Iterator<Item = (f64, f64)> + Clone, share: f64) -> Option<f64> {
    let total = within.clone().last()?.1;
    if total <= 0.0 {
        return None;
    }
    let rank = total * share;
    let (mut start, mut below) = (0.0, 0.0);
    for (end, count) in within {
        if count >= rank && count > below {
            let part = (rank - below) / (count - below);
            return Some(if end.is_finite() {
                start + (end - start) * part
            } else {
                end
            });
        }
        (start, below) = (end, count);
    }
    None
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rhumb_protocol::{Instant, Span};

    use super::*;

    fn reading(seconds: u64, tick: u64, steps: [u64; 3]) -> Reading {
        let [first, second, all] = steps;
        let bucket = |end: &str, count| {
            format!("rhumb_scene_step_seconds_bucket{{scene=\"pit\",le=\"{end}\"}} {count}\n")
        };
        let text = format!(
            "rhumb_scenes 1\nrhumb_scene_tick{{scene=\"pit\"}} {tick}\n{}{}{}",
            bucket("0.001", first),
            bucket("0.002", second),
            bucket("+Inf", all)
        );
        let at = Instant::ZERO + Span::from_millis(seconds * 1_000);
        Reading::parse(at, true, &text).unwrap()
    }

    fn of<'a>(now: &'a Reading, before: Option<&'a Reading>) -> SceneChange<'a> {
        SceneChange::all(now, before).next().unwrap()
    }

    #[test]
    fn a_rate_is_growth_over_time_and_unknown_without_two_readings() {
        let (before, now) = (reading(1, 100, [0; 3]), reading(3, 220, [0; 3]));
        assert_eq!(of(&now, Some(&before)).rate("tick"), Some(60.0));
        assert_eq!(of(&now, None).rate("tick"), None);
        assert_eq!(of(&before, Some(&now)).rate("tick"), None, "it began anew");
    }

    #[test]
    fn quantiles_are_of_the_steps_since_the_reading_before() {
        let before = reading(1, 0, [1_000, 1_000, 1_000]);
        let now = reading(2, 60, [1_000, 1_080, 1_100]);
        let change = of(&now, Some(&before));
        let median = change.step_quantile(0.5).unwrap();
        assert!((median - 0.001_625).abs() < 1e-12, "{median}");
        assert_eq!(change.step_quantile(0.99), Some(f64::INFINITY));
        let idle = of(&before, Some(&before));
        assert_eq!(idle.step_quantile(0.5), Some(0.000_5), "of all steps");
        let none = reading(1, 0, [0; 3]);
        assert_eq!(of(&none, None).step_quantile(0.5), None);
    }

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
