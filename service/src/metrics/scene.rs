//! The figures of one scene.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rhumb_protocol::Span;
use rhumb_protocol::scene::SceneName;
use rhumb_scene::{TickFigures, Traffic};

use super::text::{MetricKind, Text};

/// Upper ends of the buckets of a step's duration, microseconds.
const BUCKETS_US: [u64; 8] = [500, 1_000, 2_000, 4_000, 8_000, 16_000, 33_000, 100_000];

/// Locks; a thread that panicked while it counted leaves the figures as they are.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The figures of all scenes that a meter has begun and not ended; all clones are one.
#[derive(Clone, Default)]
pub(super) struct SceneMeters(Arc<Mutex<SceneTable>>);

type SceneTable = BTreeMap<SceneName, Arc<SceneFigures>>;

impl SceneMeters {
    pub(super) fn begin(&self, name: &SceneName) -> SceneMeter {
        let figures = Arc::new(SceneFigures::default());
        lock(&self.0).insert(name.clone(), Arc::clone(&figures));
        SceneMeter {
            name: name.clone(),
            figures,
            meters: self.clone(),
        }
    }

    fn end(&self, name: &SceneName, figures: &Arc<SceneFigures>) {
        let mut scenes = lock(&self.0);
        // A quarantined scene ends late: another one may have its name by then.
        if scenes
            .get(name)
            .is_some_and(|now| Arc::ptr_eq(now, figures))
        {
            scenes.remove(name);
        }
    }

    #[cfg(feature = "view")]
    pub(super) fn names(&self) -> Vec<SceneName> {
        lock(&self.0).keys().cloned().collect()
    }

    /// The figures of all scenes.
    pub(super) fn values(&self) -> Vec<(SceneName, SceneValues)> {
        let scenes = lock(&self.0);
        let values = scenes.iter().map(|(name, figures)| {
            let mut values = SceneValues::default();
            for (value, figure) in values.0.iter_mut().zip(figures.each()) {
                *value = figure.load(Ordering::Relaxed);
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

/// Figures of a scene; other threads read them.
#[derive(Debug, Default)]
struct SceneFigures {
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

/// The figures of a scene, as a worker process hands them over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct SceneValues(pub(crate) [u64; SCENE_VALUES]);

/// Number of figures of a scene.
pub(crate) const SCENE_VALUES: usize = 18 + BUCKETS_US.len();

impl SceneFigures {
    /// All figures, always in the same order.
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

/// Writes the figures of a scene; dropping it ends them.
pub(crate) struct SceneMeter {
    name: SceneName,
    figures: Arc<SceneFigures>,
    meters: SceneMeters,
}

impl SceneMeter {
    /// Notes the simulated time of a step.
    pub(crate) fn note_step_period(&self, period: Span) {
        let figure = &self.figures.step_period_ns;
        figure.store(period.as_nanos(), Ordering::Relaxed);
    }

    /// The bytes of the scene's members.
    pub(crate) fn traffic(&self) -> Traffic {
        self.figures.traffic.clone()
    }

    pub(crate) fn note_tick(&self, tick: &TickFigures) {
        let figures = &*self.figures;
        let set = |figure: &AtomicU64, value| figure.store(value, Ordering::Relaxed);
        set(&figures.tick, tick.tick.value());
        set(&figures.members, tick.members as u64);
        set(&figures.bodies, tick.bodies as u64);
        set(&figures.awake, tick.awake as u64);
        set(&figures.waiting, tick.waiting as u64);
        set(&figures.load, tick.load);
        add(&figures.steps, 1);
        add(&figures.step_ns, tick.step.as_nanos());
        add(&figures.publish_ns, tick.publish.as_nanos());
        let fits = |end: &u64| tick.step.as_nanos() <= end * 1_000;
        if let Some(bucket) = BUCKETS_US.iter().position(fits) {
            add(&figures.buckets[bucket], 1);
        }
    }

    /// Takes over the figures of a scene in another process.
    pub(crate) fn show(&self, values: &SceneValues) {
        for (figure, value) in self.figures.each().zip(values.0) {
            figure.store(value, Ordering::Relaxed);
        }
    }

    /// A step began more than a step after it was due.
    pub(crate) fn count_late(&self) {
        add(&self.figures.late, 1);
    }

    /// The engine failed, and the scene went back to an earlier tick.
    pub(crate) fn count_restored(&self) {
        add(&self.figures.restorations, 1);
    }

    /// The engine failed, and the scene stands still.
    pub(crate) fn note_faulted(&self) {
        self.figures.faulted.store(1, Ordering::Relaxed);
    }

    /// The scene slows its clock: it is too late to catch up.
    pub(crate) fn count_slowed(&self) {
        add(&self.figures.slowed, 1);
    }

    pub(crate) fn count_command(&self, refused: bool) {
        add(&self.figures.commands, 1);
        add(&self.figures.refused, u64::from(refused));
    }
}

impl Drop for SceneMeter {
    fn drop(&mut self) {
        self.meters.end(&self.name, &self.figures);
    }
}

fn add(figure: &AtomicU64, value: u64) {
    figure.fetch_add(value, Ordering::Relaxed);
}

/// Reads one figure of a scene.
type Read = fn(&SceneFigures) -> &AtomicU64;

/// The plain figures of a scene.
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

/// The figures of a scene that count nanoseconds, shown in seconds.
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
    let value = |figure: &AtomicU64| figure.load(Ordering::Relaxed);
    for (name, kind, help, read) in PLAIN {
        text.describe(name, kind, help);
        for (scene, figures) in scenes {
            text.sample(name, &[("scene", scene.as_str())], value(read(figures)));
        }
    }
    for (name, kind, help, read) in TIMES {
        text.describe(name, kind, help);
        for (scene, figures) in scenes {
            let seconds = seconds(value(read(figures)));
            text.sample(name, &[("scene", scene.as_str())], seconds);
        }
    }
    text.describe(
        "rhumb_scene_step_seconds",
        MetricKind::Histogram,
        "Duration of the engine's steps.",
    );
    for (scene, figures) in scenes {
        let scene = ("scene", scene.as_str());
        let mut within = 0;
        for (end, bucket) in BUCKETS_US.iter().zip(&figures.buckets) {
            within += value(bucket);
            let end = seconds(end * 1_000).to_string();
            text.sample(
                "rhumb_scene_step_seconds_bucket",
                &[scene, ("le", &end)],
                within,
            );
        }
        let steps = value(&figures.steps);
        text.sample(
            "rhumb_scene_step_seconds_bucket",
            &[scene, ("le", "+Inf")],
            steps,
        );
        let sum = seconds(value(&figures.step_ns));
        text.sample("rhumb_scene_step_seconds_sum", &[scene], sum);
        text.sample("rhumb_scene_step_seconds_count", &[scene], steps);
    }
}

fn seconds(nanos: u64) -> f64 {
    nanos as f64 / 1e9
}
