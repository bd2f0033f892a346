//! Metrics for operators.
//!
//! A metric is an atomic number: a tick stores some ten of them and waits for nothing. [`Metrics::text`] writes them in
//! the text format of Prometheus.
//!
//! Metrics of the process are those of the process that answers: worker processes have their own. A system without
//! `/proc` has none but the program's.

mod scene;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use hyper::StatusCode;
use rhumb_protocol::Span;
use rhumb_protocol::scene::SceneName;
use rhumb_scene::{Heartbeat, Limits, ServerLoad};

use self::scene::{MetricKind, SceneMeters, Text, lock};
use crate::durable::DataDir;
use crate::http::{HttpAnswer, HttpRequest, TEXT};

pub(crate) use self::scene::{SCENE_VALUES, SceneMeter, SceneValues};

/// A dispatcher that has worked on one piece for longer is stuck.
const DISPATCHER_STUCK: Span = Span::from_millis(2_000);

/// The metrics of one server; all clones are one.
#[derive(Clone, Default)]
pub(crate) struct Metrics(Arc<MetricValues>);

#[derive(Default)]
struct MetricValues {
    connections: AtomicU64,
    opened: AtomicU64,
    quarantined: AtomicU64,
    workers: AtomicU64,
    worker_deaths: AtomicU64,
    full_accounts: AtomicU64,
    /// Connections that the server closed, by code.
    closed: Mutex<BTreeMap<u32, u64>>,
    scenes: SceneMeters,
    /// The metrics of the dispatcher, once the server runs.
    dispatcher: Mutex<Option<WatchedDispatcher>>,
    data: Mutex<Option<DataDir>>,
}

/// Sign of life of the dispatcher, the load of all scenes, and the bounds on it.
struct WatchedDispatcher {
    heartbeat: Heartbeat,
    load: ServerLoad,
    scene_load_max: u64,
    load_max: u64,
}

impl Metrics {
    /// Sets what is read of a running server.
    pub(crate) fn set_dispatcher(&self, heartbeat: Heartbeat, load: ServerLoad, limits: &Limits) {
        *lock(&self.0.dispatcher) = Some(WatchedDispatcher {
            heartbeat,
            load,
            scene_load_max: limits.scene_load,
            load_max: limits.server_load(),
        });
    }

    /// Sets the data directory whose bytes are shown.
    pub(crate) fn set_data(&self, data: Option<DataDir>) {
        *lock(&self.0.data) = data;
    }

    /// A connection came of a tenant or client that has as many scenes as it may.
    pub(crate) fn count_full_account(&self) {
        self.0.full_accounts.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn count_opened(&self) {
        self.0.opened.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn set_connections(&self, count: usize) {
        self.0.connections.store(count as u64, Ordering::Relaxed);
    }

    pub(crate) fn set_quarantined(&self, count: usize) {
        self.0.quarantined.store(count as u64, Ordering::Relaxed);
    }

    pub(crate) fn count_closed(&self, code: u32) {
        *lock(&self.0.closed).entry(code).or_default() += 1;
    }

    /// The metrics of all scenes, for the dispatcher of a worker process.
    pub(crate) fn scene_values(&self) -> Vec<(SceneName, SceneValues)> {
        self.0.scenes.values()
    }

    pub(crate) fn set_workers(&self, count: usize) {
        self.0.workers.store(count as u64, Ordering::Relaxed);
    }

    /// A worker process has ended by itself, or did not answer and was killed.
    pub(crate) fn count_worker_death(&self) {
        self.0.worker_deaths.fetch_add(1, Ordering::Relaxed);
    }

    /// The meter of a new scene, whose metrics are shown until it is dropped.
    pub(crate) fn begin_scene(&self, name: &SceneName) -> SceneMeter {
        self.0.scenes.begin(name)
    }

    /// Names of the scenes that exist.
    pub(crate) fn scene_names(&self) -> Vec<SceneName> {
        self.0.scenes.names()
    }

    /// False if the dispatcher has not answered for two seconds. A stuck scene does not matter here.
    pub(crate) fn is_healthy(&self) -> bool {
        let dispatcher = lock(&self.0.dispatcher);
        dispatcher
            .as_ref()
            .is_some_and(|dispatcher| dispatcher.heartbeat.busy_for() <= DISPATCHER_STUCK)
    }

    /// All metrics, as Prometheus reads them.
    pub(crate) fn text(&self) -> String {
        let metrics = &self.0;
        let read = |metric: &AtomicU64| metric.load(Ordering::Relaxed);
        let mut text = Text::default();
        let plain = [
            (
                "rhumb_connections",
                MetricKind::Gauge,
                "Connections now.",
                read(&metrics.connections),
            ),
            (
                "rhumb_connections_total",
                MetricKind::Counter,
                "Connections so far.",
                read(&metrics.opened),
            ),
            (
                "rhumb_scenes_quarantined",
                MetricKind::Gauge,
                "Scenes that did not answer and are quarantined.",
                read(&metrics.quarantined),
            ),
            (
                "rhumb_workers",
                MetricKind::Gauge,
                "Worker processes now.",
                read(&metrics.workers),
            ),
            (
                "rhumb_worker_deaths_total",
                MetricKind::Counter,
                "Worker processes that ended by themselves, or did not answer and were killed.",
                read(&metrics.worker_deaths),
            ),
            (
                "rhumb_full_tenants_total",
                MetricKind::Counter,
                "Connections of tenants that had as many scenes as they may.",
                read(&metrics.full_accounts),
            ),
        ];
        for (name, kind, help, value) in plain {
            text.describe(name, kind, help);
            text.sample(name, &[], value);
        }
        self.write_load(&mut text);
        self.write_data(&mut text);
        let name = "rhumb_closed_total";
        text.describe(
            name,
            MetricKind::Counter,
            "Connections that the server closed, by code (PROTOCOL 3.4).",
        );
        for (code, count) in lock(&metrics.closed).iter() {
            text.sample(name, &[("code", &code.to_string())], *count);
        }
        metrics.scenes.write(&mut text);
        write(&mut text);
        text.into_string()
    }

    /// Bytes of the data directory, if there is one that can be read.
    fn write_data(&self, text: &mut Text) {
        let data = lock(&self.0.data).clone();
        if let Some(Ok(bytes)) = data.map(|data| data.bytes()) {
            let name = "rhumb_data_bytes";
            let help = "Bytes of all scenes in the data directory.";
            text.describe(name, MetricKind::Gauge, help);
            text.sample(name, &[], bytes);
        }
    }

    fn write_load(&self, text: &mut Text) {
        let dispatcher = lock(&self.0.dispatcher);
        let dispatcher = dispatcher.as_ref();
        let rows = [
            (
                "rhumb_load",
                "Body steps in a second that free-running scenes have reserved.",
                dispatcher.map(|dispatcher| dispatcher.load.reserved()),
            ),
            (
                "rhumb_load_limit",
                "The most that all scenes together may reserve.",
                dispatcher.map(|dispatcher| dispatcher.load_max),
            ),
            (
                "rhumb_scene_load_limit",
                "The most that one scene may reserve.",
                dispatcher.map(|dispatcher| dispatcher.scene_load_max),
            ),
        ];
        for (name, help, value) in rows {
            text.describe(name, MetricKind::Gauge, help);
            text.sample(name, &[], value.unwrap_or(0));
        }
    }
}

/// The type of metrics, as Prometheus reads them.
const FIGURES: &str = "text/plain; version=0.0.4";

impl Metrics {
    /// The answer to a request. `named`: requests for any host name are answered too, not only those for an address or
    /// `localhost`. Otherwise a web page whose name points at this machine could read the names of scenes.
    pub(crate) fn answer(&self, request: &HttpRequest, named: bool) -> HttpAnswer {
        if request.host.is_some() && request.host(named).is_none() {
            return HttpAnswer::refusal(
                StatusCode::FORBIDDEN,
                "ask by the address that the server printed, not by another name",
            );
        }
        if let Some(origin) = request.foreign_origin() {
            return HttpAnswer::refusal(
                StatusCode::FORBIDDEN,
                format!("a page of {origin} may not read these figures"),
            );
        }
        match request.path.as_str() {
            "/metrics" => HttpAnswer::ok(FIGURES, self.text()),
            "/health" if self.is_healthy() => HttpAnswer::ok(TEXT, "ok\n"),
            "/health" => HttpAnswer::refusal(
                StatusCode::SERVICE_UNAVAILABLE,
                "the dispatcher does not answer",
            ),
            _ => HttpAnswer::refusal(StatusCode::NOT_FOUND, "there are /metrics and /health"),
        }
    }
}

/// Writes the version, and what the system says of the process.
fn write(text: &mut Text) {
    let name = "rhumb_build_info";
    text.describe(
        name,
        MetricKind::Gauge,
        "1, with the version of the program.",
    );
    let profile = if cfg!(debug_assertions) {
        "debug"
    } else {
        "release"
    };
    let labels = [("version", env!("CARGO_PKG_VERSION")), ("profile", profile)];
    text.sample(name, &labels, 1);
    #[cfg(target_os = "linux")]
    if let Some(metrics) = system::ProcessMetrics::read() {
        metrics.write(text);
    }
}

#[cfg(target_os = "linux")]
mod system {
    use std::fs;

    use super::scene::{MetricKind, Text};

    /// Units of processor time in a second, which Linux has fixed for programs.
    const TICKS_PER_SECOND: f64 = 100.0;

    /// The entries of `/proc` about this process.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub(super) struct ProcessMetrics {
        cpu_s: f64,
        start_s: f64,
        resident_bytes: u64,
        virtual_bytes: u64,
        open_files: u64,
        files_max: Option<u64>,
    }

    impl ProcessMetrics {
        pub(super) fn read() -> Option<Self> {
            let read = |name: &str| fs::read_to_string(format!("/proc/{name}")).ok();
            let open_files = fs::read_dir("/proc/self/fd").ok()?.count() as u64;
            let (stat, status) = (read("self/stat")?, read("self/status")?);
            let (system, limits) = (read("stat")?, read("self/limits")?);
            Self::of(&stat, &status, &system, &limits).map(|metrics| Self {
                // The folder that is read is one of them.
                open_files: open_files.saturating_sub(1),
                ..metrics
            })
        }

        /// From the texts of `stat`, `status` and `limits` of the process, and the system's `stat` (proc(5)).
        fn of(stat: &str, status: &str, system: &str, limits: &str) -> Option<Self> {
            // The name of the program, in brackets, may hold anything.
            let (_, fields) = stat.rsplit_once(')')?;
            let fields: Vec<&str> = fields.split_whitespace().collect();
            // The state is field 3.
            let field = |number: usize| fields.get(number - 3)?.parse::<u64>().ok();
            let kilobytes = |name: &str| {
                let line = status.lines().find_map(|line| line.strip_prefix(name))?;
                line.trim().strip_suffix(" kB")?.parse::<u64>().ok()
            };
            let booted = system
                .lines()
                .find_map(|line| line.strip_prefix("btime "))?;
            let booted_s: f64 = booted.trim().parse().ok()?;
            let files_max = limits
                .lines()
                .find_map(|line| line.strip_prefix("Max open files"));
            Some(Self {
                cpu_s: (field(14)? + field(15)?) as f64 / TICKS_PER_SECOND,
                start_s: booted_s + field(22)? as f64 / TICKS_PER_SECOND,
                virtual_bytes: kilobytes("VmSize:")? * 1_024,
                resident_bytes: kilobytes("VmRSS:")? * 1_024,
                open_files: 0,
                files_max: files_max.and_then(|line| line.split_whitespace().next()?.parse().ok()),
            })
        }

        pub(super) fn write(&self, text: &mut Text) {
            use MetricKind::{Counter, Gauge};
            let mut put = |name: &str, kind, help: &str, value: f64| {
                text.describe(name, kind, help);
                text.sample(name, &[], value);
            };
            put(
                "process_cpu_seconds_total",
                Counter,
                "Processor time of the process.",
                self.cpu_s,
            );
            put(
                "process_start_time_seconds",
                Gauge,
                "Start of the process, seconds since 1970.",
                self.start_s,
            );
            put(
                "process_resident_memory_bytes",
                Gauge,
                "Memory in use.",
                self.resident_bytes as f64,
            );
            put(
                "process_virtual_memory_bytes",
                Gauge,
                "Address space in use.",
                self.virtual_bytes as f64,
            );
            put(
                "process_open_fds",
                Gauge,
                "Open files and sockets.",
                self.open_files as f64,
            );
            if let Some(files_max) = self.files_max {
                put(
                    "process_max_fds",
                    Gauge,
                    "Most open files and sockets.",
                    files_max as f64,
                );
            }
        }
    }

    #[cfg(test)]
    mod tests {
        use super::*;

        #[test]
        fn metrics_are_those_of_the_fields_whatever_the_program_is_called() {
            let stat =
                "7 (a) b (c) S 1 7 7 0 -1 4194304 100 0 0 0 250 150 0 0 20 0 9 0 1234 4096000 25";
            let status = "Name:\ta) b (c\nVmSize:\t    4000 kB\nVmRSS:\t     100 kB\n";
            let system = "cpu  1 2 3\nbtime 1700000000\nprocesses 5\n";
            let limits = "Limit  Soft Limit  Hard Limit  Units\nMax open files            1024    4096    files\n";
            let metrics = ProcessMetrics::of(stat, status, system, limits).unwrap();
            assert_eq!((metrics.cpu_s, metrics.start_s), (4.0, 1_700_000_012.34));
            assert_eq!(
                (metrics.virtual_bytes, metrics.resident_bytes),
                (4_096_000, 102_400)
            );
            assert_eq!(metrics.files_max, Some(1_024));
            assert_eq!(
                ProcessMetrics::of("7 (a) S 1", status, system, limits),
                None
            );
        }

        #[test]
        fn this_process_has_metrics() {
            let metrics = ProcessMetrics::read().unwrap();
            assert!(metrics.resident_bytes > 0 && metrics.open_files > 0 && metrics.start_s > 1e9);
        }
    }
}

#[cfg(test)]
mod tests {
    use rhumb_scene::TickMetrics;

    use super::*;

    #[test]
    fn the_text_names_scenes_until_they_end() {
        let metrics = Metrics::default();
        metrics.count_opened();
        metrics.count_closed(18);
        let meter = metrics.begin_scene(&"team/pit".parse().unwrap());
        meter.note_tick(&TickMetrics {
            tick: rhumb_reckoning::Tick::new(7),
            members: 2,
            bodies: 30,
            awake: 4,
            waiting: 1,
            load: 960,
            step: Span::from_millis(3),
            publish: Span::from_millis(1),
        });
        meter.traffic().add_sent(1_100);
        meter.count_late();
        meter.note_step_period(Span::from_millis(20));
        let text = metrics.text();
        for line in [
            "rhumb_scene_sent_bytes_total{scene=\"team/pit\"} 1100",
            "rhumb_scene_received_bytes_total{scene=\"team/pit\"} 0",
            "rhumb_scene_late_total{scene=\"team/pit\"} 1",
            "rhumb_scene_step_period_seconds{scene=\"team/pit\"} 0.02",
            "rhumb_scene_bodies_waiting{scene=\"team/pit\"} 1",
            "rhumb_scene_load{scene=\"team/pit\"} 960",
            "rhumb_connections_total 1",
            "rhumb_scene_publish_seconds_total{scene=\"team/pit\"} 0.001",
            "rhumb_closed_total{code=\"18\"} 1",
            "rhumb_scenes 1",
            "rhumb_scene_tick{scene=\"team/pit\"} 7",
            "rhumb_scene_bodies_awake{scene=\"team/pit\"} 4",
            "rhumb_scene_step_seconds_bucket{scene=\"team/pit\",le=\"0.002\"} 0",
            "rhumb_scene_step_seconds_bucket{scene=\"team/pit\",le=\"0.004\"} 1",
            "rhumb_scene_step_seconds_bucket{scene=\"team/pit\",le=\"+Inf\"} 1",
            "rhumb_scene_step_seconds_sum{scene=\"team/pit\"} 0.003",
        ] {
            assert!(text.lines().any(|have| have == line), "{line} in\n{text}");
        }
        drop(meter);
        assert!(!metrics.text().contains("team/pit"));
    }

    #[test]
    fn pages_of_others_read_no_figures() {
        let metrics = Metrics::default();
        let status = |host: Option<&str>, origin: Option<&str>, named| {
            let request = HttpRequest {
                method: hyper::Method::GET,
                path: "/metrics".into(),
                host: host.map(str::to_owned),
                origin: origin.map(str::to_owned),
                body: bytes::Bytes::new(),
            };
            metrics.answer(&request, named).status.as_u16()
        };
        assert_eq!(status(Some("127.0.0.1:9464"), None, false), 200);
        assert_eq!(status(Some("localhost:9464"), None, false), 200);
        assert_eq!(status(None, None, false), 200);
        assert_eq!(status(Some("scenes.example:9464"), None, false), 403);
        assert_eq!(status(Some("scenes.example:9464"), None, true), 200);
        let other = Some("http://other.example");
        assert_eq!(status(Some("127.0.0.1:9464"), other, false), 403);
        assert_eq!(status(Some("scenes.example:9464"), other, true), 403);
    }

    #[test]
    fn a_quarantined_scene_s_late_end_leaves_its_successor() {
        let metrics = Metrics::default();
        let name = "pit".parse().unwrap();
        let quarantined = metrics.begin_scene(&name);
        let _successor = metrics.begin_scene(&name);
        drop(quarantined);
        assert!(metrics.text().contains("rhumb_scenes 1\n"));
    }
}
