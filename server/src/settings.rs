//! The settings of scenes, and the limits that an operator may change.
//!
//! Settings are made once and shared by all that run with them. The reasons of limits are their doc comments, which the
//! generated configuration file repeats.

use core::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::available_parallelism;

use rhumb_protocol::limits::{
    BODIES_MAX, CONTROL_WAITING_BYTES_MAX, INDICES_MAX, MEMBERS_PER_SCENE_MAX, RATE_MAX, SCENES_MAX,
};
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::scene::{CellGrid, Command, SceneConfig, SceneName, Stepping};
use rhumb_protocol::{Instant, Span};
use serde::{Deserialize, Serialize};

use crate::baking::Bakers;
use crate::engine::{Engines, StepThreads};
use crate::feed::Feeds;
use crate::hook::{Hooks, ObserveScenes, Unobserved};
use crate::load::{self, Admission, SceneLoad, SceneSlot};
use crate::scene::Scene;
use crate::sessions::SceneStore;

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
    /// Divides scenes for the members that take them by cells; those with a lookahead are not divided.
    pub cells: Option<CellGrid>,
    /// Act on scenes before each step.
    pub hooks: Option<Hooks>,
    /// Scenes that begin when a client names them.
    pub provided: Option<ProvidedScenes>,
    /// Scenes that their owners feed.
    pub feeds: Feeds,
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
            cells: None,
            hooks: None,
            provided: None,
            feeds: Feeds::default(),
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
            Stepping::FreeRunning => load::ticks_in_second(config),
            Stepping::Lockstep => 0,
        };
        let substeps = u64::from(config.integrator.substeps.get());
        let (scene_max, server_max) = (self.limits.scene_load, self.limits.server_load());
        let load = &self.admission.load;
        load.of_scene((ticks, substeps), scene_max, server_max)
            .of_tenant(scene, &self.admission.tenants, self.limits.tenant_load())
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

/// One limit, as the configuration file describes it.
#[derive(Clone, Copy, Debug)]
pub struct LimitRow {
    /// Its key.
    pub name: &'static str,
    /// Its value unless the file has another one.
    pub default: u64,
    least: u64,
    most: u64,
    /// The reason for the limit.
    pub reason: &'static str,
}

/// A limit outside its bounds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InvalidLimit {
    name: &'static str,
    value: u64,
    least: u64,
    most: u64,
}

impl fmt::Display for InvalidLimit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            name,
            value,
            least,
            most,
        } = self;
        write!(f, "limits.{name} is {value}, not from {least} to {most}")
    }
}

impl std::error::Error for InvalidLimit {}

/// Declares the limits once: field, default, bounds, and the reason as its doc comment.
macro_rules! limits {
    ($($(#[doc = $reason:literal])+ $name:ident = $default:literal, $least:literal to $most:expr;)+) => {
        /// Limits of a server.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct Limits {
            $($(#[doc = $reason])+ pub $name: u64,)+
        }

        impl Default for Limits {
            fn default() -> Self {
                Self { $($name: $default,)+ }
            }
        }

        impl Limits {
            /// All limits, in the order of the file.
            pub const ROWS: &[LimitRow] = &[$(LimitRow {
                name: stringify!($name),
                default: $default,
                least: $least,
                most: $most,
                reason: concat!($($reason, "\n"),+),
            },)+];

            fn values(&self) -> impl Iterator<Item = u64> {
                [$(self.$name,)+].into_iter()
            }
        }
    };
}

limits! {
    /// Scenes at one time. Each has a thread with a stack of 8 MiB, of which it uses what it needs.
    scenes = 256, 1 to SCENES_MAX as u64;
    /// Members of a scene. Each costs one datagram per packet of its stream.
    members_per_scene = 64, 1 to MEMBERS_PER_SCENE_MAX as u64;
    /// Bodies of a scene. The engine needs about a kilobyte for each, and each stream 120 bytes.
    bodies_per_scene = 131072, 1 to BODIES_MAX as u64;
    /// Indices of a scene's bodies. Tables by index are as long as the highest one that was used, some 300 bytes for each.
    /// A third is left for reservations, but no more than the largest one; the members share the rest, at most 4096 for
    /// each. With less, clients of the ARCHIMEDES protocol, which take the largest range, find no scene.
    indices_per_scene = 393216, 4096 to INDICES_MAX as u64;
    /// Ticks in a second of a free-running scene. A scene that asks for more is refused.
    scene_ticks_per_second = 1000, 1 to RATE_MAX as u64;
    /// Ticks in a second, times substeps, times bodies, of a free-running scene: 80000 bodies at 60 ticks of 4 substeps.
    /// A scene that asks for more would only run slower than its clock.
    scene_load = 20000000, 1 to u64::MAX;
    /// The same of all free-running scenes together; 0 stands for 20000000 for each processor core that the server may use.
    /// A core does a million where all bodies touch, and many times that where they rest. A tick by itself counts as 500
    /// steps of one body.
    server_load = 0, 0 to u64::MAX;
    /// Pairs of bodies of a scene that may overlap when a step begins and did not before it, beyond 32 of each: some 215
    /// equal bodies at one point. A step beyond them takes seconds and gigabytes, and cannot be cancelled.
    scene_crowding = 16384, 1024 to 4294967295;
    /// Seconds after which a scene without members ends; 0 keeps it until a client deletes it.
    empty_scene_seconds = 600, 0 to 31536000;
    /// Seconds for a connection's first message. A client on a bad link needs a few round trips.
    hello_seconds = 8, 1 to 60;
    /// Scenes of one tenant at one time, unless a token says otherwise. Where tokens are asked for, scenes without a tenant
    /// count for the client that names them first.
    tenant_scenes = 128, 1 to SCENES_MAX as u64;
    /// The part of `server_load` that the free-running scenes of one tenant may have together; 0 stands for half of it.
    tenant_load = 0, 0 to u64::MAX;
    /// MiB of a durable scene's log since its last snapshot. A scene of which there can be no snapshot, as it is not
    /// stepped, takes no more commands beyond them; at twice as many nothing more is durable until the next snapshot.
    scene_log_mib = 64, 8 to 1048576;
    /// MiB of one tenant's scenes in the data directory. Beyond them nothing more of the tenant is durable until there is
    /// room, as on a full disk. They are counted anew after each 4 MiB of a log.
    tenant_data_mib = 16384, 1 to 1073741824;
    /// The same of all scenes together.
    data_mib = 32768, 1 to 1073741824;
    /// Milliseconds by the clock that one tick or one command may take before its scene is quarantined. On Linux the time
    /// for which its thread waits for a processor core does not count.
    stuck_milliseconds = 2000, 100 to 60000;
    /// Milliseconds that the solid of one shape may take to be made, beside the steps of its scene. The largest mesh takes
    /// some 100; one that takes longer is refused, and one that has waited as long.
    bake_milliseconds = 1000, 1 to 60000;
    /// Quarantined scenes from which on no scene begins: each may take a core until the server is restarted.
    quarantined_scenes = 8, 1 to 256;
    /// Quarantined scenes of one tenant from which on no scene of it begins; more of them do not count for others.
    tenant_quarantined_scenes = 2, 1 to 256;
    /// MiB of private memory of a worker process, with 8 for the stack of each scene; 0 sets no limit. A process that
    /// needs more ends, and no other one does.
    worker_memory_mib = 4096, 0 to 1048576;
    /// Times in ten minutes that the worker process of a tenant is started again after it ended by itself or was killed.
    /// Beyond them its scenes are refused until the ten minutes are over.
    worker_restarts = 3, 0 to 1000;
    /// Times in ten minutes that a scene whose engine failed is restored; 0 keeps no copy of scenes to restore them from.
    /// A client that makes the engine fail again and again slows the scene down.
    restorations = 3, 0 to 1000;
    /// MiB that wait for a client beside its snapshot before it is closed.
    waiting_mib = 12, 1 to (CONTROL_WAITING_BYTES_MAX >> 20) as u64;
    /// Seconds after which a client that reads nothing is closed.
    stall_seconds = 30, 1 to 3600;
    /// MiB of snapshots for one client in a second, on average; more than most links take.
    snapshot_mib_per_second = 16, 1 to 1024;
    /// KiB of the newest events that a scene's flight recorder holds: some 50 s of three packets a tick at 60 Hz.
    flight_kib = 256, 4 to 65536;
    /// Files of flight recorders; beyond them the oldest are removed.
    flight_files = 64, 1 to 10000;
    /// MiB after which a recording continues in another file.
    record_file_mib = 256, 1 to 1048576;
    /// Minutes after which a recording continues in another file.
    record_file_minutes = 60, 1 to 525600;
    /// MiB of all recordings; beyond them the oldest files are removed.
    record_total_mib = 4096, 1 to 1073741824;
    /// MiB of ticks that wait for the thread of recordings, and for that of Foxglove's viewers; beyond them a recording
    /// lacks ticks.
    record_waiting_mib = 64, 1 to 65536;
    /// Log lines of one cause in a second, except at level trace.
    log_lines_per_second = 10, 1 to 100000;
}

/// The load that a processor core is admitted by itself.
const LOAD_OF_CORE: u64 = 20_000_000;

/// Processor cores that this process may use.
fn cores() -> u64 {
    available_parallelism().map_or(1, |cores| cores.get() as u64)
}

impl Limits {
    /// Checks every limit against its bounds.
    ///
    /// # Errors
    ///
    /// [`InvalidLimit`] for the first that is outside.
    pub fn check(&self) -> Result<(), InvalidLimit> {
        for (row, value) in Self::ROWS.iter().zip(self.values()) {
            let LimitRow {
                name, least, most, ..
            } = *row;
            if !(least..=most).contains(&value) {
                return Err(InvalidLimit {
                    name,
                    value,
                    least,
                    most,
                });
            }
        }
        Ok(())
    }

    /// The latest time of a connection's first message.
    #[must_use]
    pub const fn hello(&self) -> Span {
        Span::from_millis(self.hello_seconds.saturating_mul(1_000))
    }

    /// The time after which a scene that does not answer is stuck.
    #[must_use]
    pub const fn stuck(&self) -> Span {
        Span::from_millis(self.stuck_milliseconds)
    }

    /// The load of all free-running scenes together. A worker process gets the number of the whole server.
    #[must_use]
    pub fn server_load(&self) -> u64 {
        match self.server_load {
            0 => LOAD_OF_CORE.saturating_mul(cores()),
            load => load,
        }
    }

    /// The part of one tenant.
    pub(crate) fn tenant_load(&self) -> u64 {
        match self.tenant_load {
            0 => self.server_load() / 2,
            load => load,
        }
    }

    pub(crate) fn crowding(&self) -> u32 {
        u32::try_from(self.scene_crowding).unwrap_or(u32::MAX)
    }

    pub(crate) const fn bake(&self) -> Span {
        Span::from_millis(self.bake_milliseconds)
    }

    pub(crate) const fn stall(&self) -> Span {
        Span::from_millis(self.stall_seconds * 1_000)
    }

    /// The lifetime of a scene without members; `None` for ever.
    pub(crate) fn empty_scene(&self) -> Option<Span> {
        (self.empty_scene_seconds > 0).then(|| Span::from_millis(self.empty_scene_seconds * 1_000))
    }

    /// Bytes of a scene's log without a snapshot from which on it takes no commands.
    pub(crate) const fn scene_log_bytes(&self) -> usize {
        (self.scene_log_mib << 20) as usize
    }

    pub(crate) const fn waiting_bytes(&self) -> usize {
        (self.waiting_mib << 20) as usize
    }

    pub(crate) const fn snapshot_bytes_per_second(&self) -> u64 {
        self.snapshot_mib_per_second << 20
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_within_their_bounds_and_each_has_a_reason() {
        Limits::default().check().unwrap();
        for row in Limits::ROWS {
            assert!(row.reason.len() > 20, "{}", row.name);
        }
    }

    #[test]
    fn the_load_follows_from_the_cores_unless_it_is_set() {
        let default = Limits::default();
        assert_eq!(default.server_load(), cores() * 20_000_000);
        assert_eq!(default.tenant_load(), cores() * 10_000_000);
        let set = Limits {
            server_load: 3_000,
            ..default
        };
        assert_eq!((set.server_load(), set.tenant_load()), (3_000, 1_500));
        let both = Limits {
            tenant_load: 7,
            ..set
        };
        assert_eq!(both.tenant_load(), 7);
    }

    #[test]
    fn a_limit_outside_its_bounds_is_named() {
        let limits = Limits {
            members_per_scene: 257,
            ..Limits::default()
        };
        let refused = limits.check().unwrap_err().to_string();
        assert_eq!(
            refused,
            "limits.members_per_scene is 257, not from 1 to 256"
        );
    }
}
