//! The metrics of one scene, and the text format of Prometheus, version 0.0.4.

use std::collections::BTreeMap;
use std::fmt::{Display, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rhumb_protocol::Span;
use rhumb_protocol::scene::SceneName;
use rhumb_scene::{TickMetrics, Traffic};

/// Upper ends of the buckets of a step's duration, microseconds.
const BUCKETS_US: [u64; 8] = [500, 1_000, 2_000, 4_000, 8_000, 16_000, 33_000, 100_000];

/// Locks; a thread that panicked while it counted leaves the metrics as they are.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The metrics of all scenes that a meter has begun and not ended; all clones are one.
#[derive(Clone, Default)]
pub(super) struct SceneMeters(Arc<Mutex<SceneTable>>);

type SceneTable = BTreeMap<SceneName, Arc<SceneMetrics>>;

impl SceneMeters {
    pub(super) fn begin(&self, name: &SceneName) -> SceneMeter {
        let metrics = Arc::new(SceneMetrics::default());
        lock(&self.0).insert(name.clone(), Arc::clone(&metrics));
        SceneMeter {
            name: name.clone(),
            metrics,
            meters: self.clone(),
        }
    }

    fn end(&self, name: &SceneName, metrics: &Arc<SceneMetrics>) {
        let mut scenes = lock(&self.0);
        // A quarantined scene ends late: another one may have its name by then.
        if scenes
            .get(name)
            .is_some_and(|now| Arc::ptr_eq(now, metrics))
        {
            scenes.remove(name);
        }
    }

    pub(super) fn names(&self) -> Vec<SceneName> {
        lock(&self.0).keys().cloned().collect()
    }

    /// The metrics of all scenes.
    pub(super) fn values(&self) -> Vec<(SceneName, SceneValues)> {
        let scenes = lock(&self.0);
        let values = scenes.iter().map(|(name, metrics)| {
            let mut values = SceneValues::default();
            for (value, metric) in values.0.iter_mut().zip(metrics.each()) {
                *value = metric.load(Ordering::Relaxed);
            }
            (name.clone(), values)
        });
        values.collect()
    }

    pub(super) fn write(&self, text: &mut Text) {
        let scenes = lock(&self.0).clone();
        text.describe("rhumb_scenes", MetricKind::Gauge, "Scenes now.");
        text.sample("rhumb_scenes", &[], scenes.len() as u64);
        write(&scenes, text);
    }
}

/// Metrics of a scene; other threads read them.
#[derive(Debug, Default)]
struct SceneMetrics {
    tick: AtomicU64,
    members: AtomicU64,
    bodies: AtomicU64,
    awake: AtomicU64,
    steps: AtomicU64,
    step_ns: AtomicU64,
    publish_ns: AtomicU64,
    step_period_ns: AtomicU64,
    late: AtomicU64,
    slowed: AtomicU64,
    commands: AtomicU64,
    refused: AtomicU64,
    /// Bodies whose updates wait for a budget.
    waiting: AtomicU64,
    load: AtomicU64,
    restorations: AtomicU64,
    faulted: AtomicU64,
    traffic: Traffic,
    /// Steps within each bucket, and not within the one before.
    buckets: [AtomicU64; BUCKETS_US.len()],
}

/// The metrics of a scene, as a worker process hands them over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct SceneValues(pub(crate) [u64; SCENE_VALUES]);

/// Number of metrics of a scene.
pub(crate) const SCENE_VALUES: usize = 18 + BUCKETS_US.len();

impl SceneMetrics {
    /// All metrics, always in the same order.
    fn each(&self) -> impl Iterator<Item = &AtomicU64> {
        let plain = [
            &self.tick,
            &self.members,
            &self.bodies,
            &self.awake,
            &self.steps,
            &self.step_ns,
            &self.publish_ns,
            &self.step_period_ns,
            &self.late,
            &self.slowed,
            &self.commands,
            &self.refused,
            &self.waiting,
            &self.load,
            &self.restorations,
            &self.faulted,
            self.traffic.received(),
            self.traffic.sent(),
        ];
        plain.into_iter().chain(&self.buckets)
    }
}

/// Writes the metrics of a scene; dropping it ends them.
pub(crate) struct SceneMeter {
    name: SceneName,
    metrics: Arc<SceneMetrics>,
    meters: SceneMeters,
}

impl SceneMeter {
    /// Notes the simulated time of a step.
    pub(crate) fn note_step_period(&self, period: Span) {
        let metric = &self.metrics.step_period_ns;
        metric.store(period.as_nanos(), Ordering::Relaxed);
    }

    /// The bytes of the scene's members.
    pub(crate) fn traffic(&self) -> Traffic {
        self.metrics.traffic.clone()
    }

    pub(crate) fn note_tick(&self, tick: &TickMetrics) {
        let metrics = &*self.metrics;
        let set = |metric: &AtomicU64, value| metric.store(value, Ordering::Relaxed);
        set(&metrics.tick, tick.tick.value());
        set(&metrics.members, tick.members as u64);
        set(&metrics.bodies, tick.bodies as u64);
        set(&metrics.awake, tick.awake as u64);
        set(&metrics.waiting, tick.waiting as u64);
        set(&metrics.load, tick.load);
        add(&metrics.steps, 1);
        add(&metrics.step_ns, tick.step.as_nanos());
        add(&metrics.publish_ns, tick.publish.as_nanos());
        let fits = |end: &u64| tick.step.as_nanos() <= end * 1_000;
        if let Some(bucket) = BUCKETS_US.iter().position(fits) {
            add(&metrics.buckets[bucket], 1);
        }
    }

    /// Takes over the metrics of a scene in another process.
    pub(crate) fn show(&self, values: &SceneValues) {
        for (metric, value) in self.metrics.each().zip(values.0) {
            metric.store(value, Ordering::Relaxed);
        }
    }

    /// A step began more than a step after it was due.
    pub(crate) fn count_late(&self) {
        add(&self.metrics.late, 1);
    }

    /// The engine failed, and the scene went back to an earlier tick.
    pub(crate) fn count_restored(&self) {
        add(&self.metrics.restorations, 1);
    }

    /// The engine failed, and the scene stands still.
    pub(crate) fn note_faulted(&self) {
        self.metrics.faulted.store(1, Ordering::Relaxed);
    }

    /// The scene slows its clock: it is too late to catch up.
    pub(crate) fn count_slowed(&self) {
        add(&self.metrics.slowed, 1);
    }

    pub(crate) fn count_command(&self, refused: bool) {
        add(&self.metrics.commands, 1);
        add(&self.metrics.refused, u64::from(refused));
    }
}

impl Drop for SceneMeter {
    fn drop(&mut self) {
        self.meters.end(&self.name, &self.metrics);
    }
}

fn add(metric: &AtomicU64, value: u64) {
    metric.fetch_add(value, Ordering::Relaxed);
}

/// Reads one metric of a scene.
type Read = fn(&SceneMetrics) -> &AtomicU64;

/// The plain metrics of a scene.
const PLAIN: [(&str, MetricKind, &str, Read); 14] = [
    (
        "rhumb_scene_tick",
        MetricKind::Gauge,
        "Newest tick.",
        |of| &of.tick,
    ),
    ("rhumb_scene_members", MetricKind::Gauge, "Members.", |of| {
        &of.members
    }),
    ("rhumb_scene_bodies", MetricKind::Gauge, "Bodies.", |of| {
        &of.bodies
    }),
    (
        "rhumb_scene_bodies_awake",
        MetricKind::Gauge,
        "Bodies awake.",
        |of| &of.awake,
    ),
    (
        "rhumb_scene_late_total",
        MetricKind::Counter,
        "Steps that began more than a step late.",
        |of| &of.late,
    ),
    (
        "rhumb_scene_slowed_total",
        MetricKind::Counter,
        "Ticks too late to catch up: the scene's clock is slower.",
        |of| &of.slowed,
    ),
    (
        "rhumb_scene_commands_total",
        MetricKind::Counter,
        "Commands applied or refused.",
        |of| &of.commands,
    ),
    (
        "rhumb_scene_commands_refused_total",
        MetricKind::Counter,
        "Commands refused.",
        |of| &of.refused,
    ),
    (
        "rhumb_scene_received_bytes_total",
        MetricKind::Counter,
        "Bytes from members, without headers.",
        |of| of.traffic.received(),
    ),
    (
        "rhumb_scene_sent_bytes_total",
        MetricKind::Counter,
        "Bytes to members, without headers.",
        |of| of.traffic.sent(),
    ),
    (
        "rhumb_scene_bodies_waiting",
        MetricKind::Gauge,
        "Bodies whose updates wait for the budget of a stream.",
        |of| &of.waiting,
    ),
    (
        "rhumb_scene_load",
        MetricKind::Gauge,
        "Body steps in a second that the scene has reserved.",
        |of| &of.load,
    ),
    (
        "rhumb_scene_restorations_total",
        MetricKind::Counter,
        "Times that the scene was restored after its engine failed.",
        |of| &of.restorations,
    ),
    (
        "rhumb_scene_faulted",
        MetricKind::Gauge,
        "1 for a scene that stands still since its engine failed.",
        |of| &of.faulted,
    ),
];

/// The metrics of a scene that count nanoseconds, shown in seconds.
const TIMES: [(&str, MetricKind, &str, Read); 2] = [
    (
        "rhumb_scene_publish_seconds_total",
        MetricKind::Counter,
        "Time spent on observing and publishing.",
        |of| &of.publish_ns,
    ),
    (
        "rhumb_scene_step_period_seconds",
        MetricKind::Gauge,
        "Simulated time of a step.",
        |of| &of.step_period_ns,
    ),
];

fn write(scenes: &SceneTable, text: &mut Text) {
    let value = |metric: &AtomicU64| metric.load(Ordering::Relaxed);
    for (name, kind, help, read) in PLAIN {
        text.describe(name, kind, help);
        for (scene, metrics) in scenes {
            text.sample(name, &[("scene", scene.as_str())], value(read(metrics)));
        }
    }
    for (name, kind, help, read) in TIMES {
        text.describe(name, kind, help);
        for (scene, metrics) in scenes {
            let seconds = seconds(value(read(metrics)));
            text.sample(name, &[("scene", scene.as_str())], seconds);
        }
    }
    text.describe(
        "rhumb_scene_step_seconds",
        MetricKind::Histogram,
        "Duration of the engine's steps.",
    );
    for (scene, metrics) in scenes {
        let scene = ("scene", scene.as_str());
        let mut within = 0;
        for (end, bucket) in BUCKETS_US.iter().zip(&metrics.buckets) {
            within += value(bucket);
            let end = seconds(end * 1_000).to_string();
            text.sample(
                "rhumb_scene_step_seconds_bucket",
                &[scene, ("le", &end)],
                within,
            );
        }
        let steps = value(&metrics.steps);
        text.sample(
            "rhumb_scene_step_seconds_bucket",
            &[scene, ("le", "+Inf")],
            steps,
        );
        let sum = seconds(value(&metrics.step_ns));
        text.sample("rhumb_scene_step_seconds_sum", &[scene], sum);
        text.sample("rhumb_scene_step_seconds_count", &[scene], steps);
    }
}

fn seconds(nanos: u64) -> f64 {
    nanos as f64 / 1e9
}

/// Metrics as text, in order.
#[derive(Debug, Default)]
pub(super) struct Text(String);

/// The kind of a metric.
#[derive(Clone, Copy, Debug)]
pub(super) enum MetricKind {
    Counter,
    Gauge,
    Histogram,
}

impl Text {
    /// Begins a metric.
    pub(super) fn describe(&mut self, name: &str, kind: MetricKind, help: &str) {
        let kind = match kind {
            MetricKind::Counter => "counter",
            MetricKind::Gauge => "gauge",
            MetricKind::Histogram => "histogram",
        };
        self.line(format_args!("# HELP {name} {help}"));
        self.line(format_args!("# TYPE {name} {kind}"));
    }

    /// Writes one value of the metric. Values of labels must need no escape, as names of scenes and numbers.
    pub(super) fn sample(&mut self, name: &str, labels: &[(&str, &str)], value: impl Display) {
        let labels: Vec<String> = labels
            .iter()
            .map(|(label, value)| format!("{label}=\"{value}\""))
            .collect();
        if labels.is_empty() {
            self.line(format_args!("{name} {value}"));
        } else {
            self.line(format_args!("{name}{{{}}} {value}", labels.join(",")));
        }
    }

    pub(super) fn into_string(self) -> String {
        self.0
    }

    fn line(&mut self, line: std::fmt::Arguments<'_>) {
        // Writing to a text does not fail.
        let _ = writeln!(self.0, "{line}");
    }
}
