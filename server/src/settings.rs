//! The settings of scenes, made once and shared by all that run with them.

use core::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::scene::{Command, SceneConfig, SceneName, Stepping};
use rhumb_protocol::{Instant, Span};

use crate::admission::{self, Admission, SceneLoad, SceneSlot};
use crate::baking::Bakers;
use crate::command_log::SceneStore;
use crate::engine::{Engines, StepThreads};
use crate::hook::Hooks;
use crate::limits::Limits;
use crate::observer::{ObserveScenes, Unobserved};
use crate::scene::Scene;

/// A clock that threads share.
pub type SharedClock = Arc<dyn Fn() -> Instant + Send + Sync>;

/// Settings of scenes.
#[derive(Clone)]
pub struct SceneSettings {
    /// Limits of connections and scenes. By default no scene expires.
    pub limits: Limits,
    /// The engine of each scene.
    pub engines: Engines,
    /// Threads that divide a step, and the streams of a scene.
    pub threads: StepThreads,
    /// Bounds the packets of streams.
    pub largest_packet: LargestPacket,
    /// Act on scenes before each step.
    pub hooks: Option<Hooks>,
    /// Scenes that begin when a client names them.
    pub provided: Option<ProvidedScenes>,
    /// The threads that make solids of large shapes; by default each is made at once.
    pub bakers: Bakers,
    /// Shares the bounds on scenes and on their load with others.
    pub admission: Admission,
    /// Observe scenes.
    pub observers: Arc<dyn ObserveScenes>,
    /// Keeps the scenes that clients create.
    pub store: Option<Arc<dyn SceneStore>>,
    /// Shows that a long work makes progress.
    pub heartbeat: Heartbeat,
    /// Measures the stages of a tick, and nothing else; it need not be the clock of the driver.
    pub clock: SharedClock,
}

impl SceneSettings {
    /// The defaults.
    #[must_use]
    pub fn new(clock: impl Fn() -> Instant + Send + Sync + 'static) -> Self {
        Self {
            limits: Limits {
                empty_scene_seconds: 0,
                ..Limits::default()
            },
            engines: Engines::default(),
            threads: StepThreads::default(),
            largest_packet: LargestPacket::DEFAULT,
            hooks: None,
            provided: None,
            bakers: Bakers::default(),
            admission: Admission::default(),
            observers: Arc::new(Unobserved),
            store: None,
            heartbeat: Heartbeat::default(),
            clock: Arc::new(clock),
        }
    }

    /// The place of another scene; `None` if the server has as many as may be.
    pub(crate) fn take_slot(&self) -> Option<SceneSlot> {
        let scenes = self.limits.scenes as usize;
        self.admission.slots.take(scenes)
    }

    /// A scene's share of the server's time, none of it taken.
    pub(crate) fn load_of(&self, scene: &SceneName, config: &SceneConfig) -> SceneLoad {
        let ticks = match config.stepping {
            Stepping::FreeRunning => admission::ticks_in_second(config),
            Stepping::Lockstep => 0,
        };
        let substeps = u64::from(config.integrator.substeps.get());
        let (scene_max, server_max) = (self.limits.scene_load, self.limits.server_load);
        let load = &self.admission.load;
        load.of_scene((ticks, substeps), scene_max, server_max)
            .of_tenant(scene, &self.admission.tenants, self.limits.tenant_load)
    }
}

impl fmt::Debug for SceneSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SceneSettings")
            .field("limits", &self.limits)
            .finish_non_exhaustive()
    }
}

/// The sign of life of one thread; all clones are one.
#[derive(Clone, Default)]
pub struct Heartbeat(Option<Arc<Beats>>);

struct Beats {
    clock: Box<dyn Fn() -> Instant + Send + Sync>,
    /// Nanoseconds of the clock at the begin of the present work; [`RESTING`] while it waits.
    busy_since: AtomicU64,
    /// True once the thread was given up.
    is_abandoned: AtomicBool,
}

const RESTING: u64 = u64::MAX;

impl Heartbeat {
    /// A heartbeat that is read against this clock. The default one is never read and costs nothing.
    pub fn new(clock: impl Fn() -> Instant + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(Beats {
            clock: Box::new(clock),
            busy_since: AtomicU64::new(RESTING),
            is_abandoned: AtomicBool::new(false),
        })))
    }

    /// The thread begins a piece of work.
    pub fn beat(&self) {
        if let Some(beats) = &self.0 {
            let now = (beats.clock)().as_nanos();
            beats.busy_since.store(now, Ordering::Relaxed);
        }
    }

    /// The thread waits.
    pub fn rest(&self) {
        if let Some(beats) = &self.0 {
            beats.busy_since.store(RESTING, Ordering::Relaxed);
        }
    }

    /// The thread is given up: what it does from now on is not to be durable.
    pub fn abandon(&self) {
        if let Some(beats) = &self.0 {
            beats.is_abandoned.store(true, Ordering::Relaxed);
        }
    }

    /// True once the thread was given up.
    pub(crate) fn is_abandoned(&self) -> bool {
        (self.0.as_ref()).is_some_and(|beats| beats.is_abandoned.load(Ordering::Relaxed))
    }

    /// The begin of the present piece of work; `None` while the thread waits.
    #[must_use]
    pub fn busy_since(&self) -> Option<Instant> {
        let since = self.0.as_ref()?.busy_since.load(Ordering::Relaxed);
        (since != RESTING).then(|| Instant::from_nanos(since))
    }

    /// The duration of the present piece of work so far; zero while the thread waits.
    #[must_use]
    pub fn busy_for(&self) -> Span {
        let Some(beats) = &self.0 else {
            return Span::ZERO;
        };
        let since = beats.busy_since.load(Ordering::Relaxed);
        // A thread that waits is busy since the end of time.
        (beats.clock)().since(Instant::from_nanos(since))
    }
}

/// Commands a scene before each step, and once before its first member joins.
pub struct SceneScript(Box<dyn Commanding>);

/// The function type of a script.
trait Commanding: FnMut(&Scene, &mut Vec<Command>) + Send {}

impl<F: FnMut(&Scene, &mut Vec<Command>) + Send> Commanding for F {}

impl SceneScript {
    /// A script that adds commands of any kind. It assigns the ids of its bodies, and of its shapes and joints, from zero
    /// upward, and the first time it runs it adds the body with the greatest index that it will ever use.
    pub fn new(act: impl FnMut(&Scene, &mut Vec<Command>) + Send + 'static) -> Self {
        Self(Box::new(act))
    }

    /// The commands before the next step.
    pub fn commands(&mut self, scene: &Scene) -> Vec<Command> {
        let mut commands = Vec::new();
        (self.0)(scene, &mut commands);
        commands
    }
}

impl fmt::Debug for SceneScript {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SceneScript")
    }
}

/// A scene to begin.
#[derive(Debug)]
pub struct ProvidedScene {
    /// Its config.
    pub config: SceneConfig,
    /// Its script.
    pub script: SceneScript,
}

/// Provides scenes by their names; all clones are one.
#[derive(Clone)]
pub struct ProvidedScenes(Arc<dyn Provide>);

/// The function type of [`ProvidedScenes`].
trait Provide: Fn(&SceneName) -> Option<ProvidedScene> + Send + Sync {}

impl<F: Fn(&SceneName) -> Option<ProvidedScene> + Send + Sync> Provide for F {}

impl ProvidedScenes {
    /// `provide` is called whenever a client names a scene that does not exist.
    pub fn new(
        provide: impl Fn(&SceneName) -> Option<ProvidedScene> + Send + Sync + 'static,
    ) -> Self {
        Self(Arc::new(provide))
    }

    pub(crate) fn of(&self, name: &SceneName) -> Option<ProvidedScene> {
        (self.0)(name)
    }
}

impl fmt::Debug for ProvidedScenes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("ProvidedScenes")
    }
}
