//! Application code beside a scene: hooks before each step, and observers.
//!
//! Hooks are for programs that embed a server: thrusters, drivers, scripts. A hook moves bodies and nothing else; only
//! members change the bodies of a scene, and learn of it by scene events.
//!
//! Observers are for metrics, recordings, fault reports. A scene calls its observer while it works, so that an observer
//! must not wait. Invariant: nothing that an observer does changes the scene.

use core::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use bytes::Bytes;
use rhumb_protocol::message::{SceneEvent, StageTimes};
use rhumb_protocol::scene::{Command, CommandError, SceneConfig, SceneName};
use rhumb_protocol::{Instant, Peer, Span};
use rhumb_reckoning::Tick;

use crate::record::TickMetrics;
use crate::scene::Scene;

/// Reads a scene before each step and commands its bodies: forces, velocities, poses.
///
/// A run stays a function of its commands as long as the hook is a function of the scene.
pub struct Hook {
    act: Box<dyn Act>,
    /// The commands of one step, kept for their memory.
    commands: Vec<Command>,
}

/// The function type of a hook.
trait Act: FnMut(&Scene, &mut Vec<Command>) + Send {}

impl<F: FnMut(&Scene, &mut Vec<Command>) + Send> Act for F {}

impl Hook {
    /// A hook that adds commands that move bodies: `SetPose`, `SetVelocity`, `Force`, `Torque`, the impulses, `Sleep`,
    /// `Wake`, `Jump` and `SetWheels`.
    pub fn new(act: impl FnMut(&Scene, &mut Vec<Command>) + Send + 'static) -> Self {
        Self {
            act: Box::new(act),
            commands: Vec::new(),
        }
    }

    /// Acts on a scene before its next step; returns why commands were not done.
    ///
    /// A scene whose engine failed is left alone.
    pub fn act(&mut self, scene: &mut Scene) -> Vec<HookError> {
        let mut refused = Vec::new();
        if scene.is_sound() {
            (self.act)(scene, &mut self.commands);
            for command in self.commands.drain(..) {
                refused.extend(apply(scene, &command).err());
            }
        }
        refused
    }
}

/// Applies a command that moves a body.
fn apply(scene: &mut Scene, command: &Command) -> Result<(), HookError> {
    match command {
        Command::SetPose { .. }
        | Command::SetVelocity { .. }
        | Command::Force { .. }
        | Command::Torque { .. }
        | Command::Impulse { .. }
        | Command::TorqueImpulse { .. }
        | Command::ForceAt { .. }
        | Command::ImpulseAt { .. }
        | Command::Sleep { .. }
        | Command::Wake { .. }
        | Command::Jump { .. }
        | Command::SetWheels { .. } => scene.apply(command).map_err(HookError::Refused),
        Command::AddShape { .. }
        | Command::RemoveShape { .. }
        | Command::AddBody { .. }
        | Command::RemoveBody { .. }
        | Command::SetGravity { .. }
        | Command::ChangeBody { .. }
        | Command::AddJoint { .. }
        | Command::ChangeJoint { .. }
        | Command::RemoveJoint { .. }
        | Command::SetEvents { .. }
        | Command::SetLocomotion { .. } => Err(HookError::NotAMotion),
    }
}

impl fmt::Debug for Hook {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Hook")
    }
}

/// Gives a scene its hook when it is created; all clones are one.
#[derive(Clone)]
pub struct Hooks(Arc<Mutex<dyn Give>>);

/// The function type of [`Hooks`].
trait Give: FnMut(&SceneName, &SceneConfig) -> Option<Hook> + Send {}

impl<F: FnMut(&SceneName, &SceneConfig) -> Option<Hook> + Send> Give for F {}

impl Hooks {
    /// `make` is called once for each new scene.
    pub fn new(
        make: impl FnMut(&SceneName, &SceneConfig) -> Option<Hook> + Send + 'static,
    ) -> Self {
        Self(Arc::new(Mutex::new(make)))
    }

    pub(crate) fn of(&self, name: &SceneName, config: &SceneConfig) -> Option<Hook> {
        // A call that panicked before has ended its own scene only.
        let mut make = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        make(name, config)
    }
}

impl fmt::Debug for Hooks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Hooks")
    }
}

/// Reason why a hook's command was refused; it had no effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum HookError {
    /// The scene refuses the command.
    Refused(CommandError),
    /// The command would change the bodies of the scene, or its gravity.
    NotAMotion,
}

impl fmt::Display for HookError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused(error) => write!(f, "a hook's command was refused: {error}"),
            Self::NotAMotion => f.write_str("a hook's command is reserved for members"),
        }
    }
}

impl core::error::Error for HookError {}

/// Gives each scene its observer when it begins.
pub trait ObserveScenes: Send + Sync {
    /// The observer of a scene that begins. `period`: simulated time of a step.
    fn begin(&self, scene: &SceneName, period: Span) -> Box<dyn SceneObserver>;
}

/// Observes one scene, on the thread of the scene, and is dropped there when the scene ends.
pub trait SceneObserver: Send {
    /// A client became a member. `client`: its name, if it has shown a token.
    fn joined(&mut self, _peer: Peer, _client: Option<&str>) {}

    /// A member left, or its connection ended.
    fn left(&mut self, _peer: Peer) {}

    /// A member's command is about to be checked and applied.
    fn command(&mut self, _peer: Peer, _number: u64, _command: &Command) {}

    /// A member's command was applied, or refused for a reason.
    fn commanded(&mut self, _refused: Option<&CommandError>) {}

    /// The scene has an event for its members.
    fn scene_event(&mut self, _event: &SceneEvent) {}

    /// A step begins.
    fn step_began(&mut self, _at: Instant, _tick: Tick) {}

    /// A step and its publication have ended. `packets`: of all streams.
    fn stepped(
        &mut self,
        _metrics: &TickMetrics,
        _scene: &Scene,
        _packets: &mut dyn Iterator<Item = &Bytes>,
    ) {
    }

    /// Something happened that an operator looks for.
    fn incident(&mut self, _incident: Incident) {}

    /// The counters of the bytes of the scene's members.
    fn traffic(&self) -> Traffic {
        Traffic::default()
    }
}

/// Observes nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unobserved;

impl SceneObserver for Unobserved {}

impl ObserveScenes for Unobserved {
    fn begin(&self, _scene: &SceneName, _period: Span) -> Box<dyn SceneObserver> {
        Box::new(Self)
    }
}

/// Something that happened to a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Incident {
    /// A step began more than a step after it was due.
    Late,
    /// The scene slows its clock: it is too late to catch up.
    Slowed,
    /// The engine panicked.
    EnginePanicked,
    /// After that, the scene went back to an earlier tick, and continues.
    Restored,
    /// The engine failed for good, and the scene stands still.
    Faulted,
    /// The engine removed a body whose state was not finite.
    NotFinite,
    /// A checksum of a client's copy differs from that of its stream.
    ChecksumMismatch,
}

/// Bytes that the members of a scene send and receive; all clones are one.
///
/// They count what the server hands to the links and takes from them: control streams and datagrams, without the headers
/// of QUIC. A count is an addition to a number; nothing waits.
#[derive(Clone, Debug, Default)]
pub struct Traffic(Arc<TrafficCounts>);

#[derive(Debug, Default)]
struct TrafficCounts {
    received: AtomicU64,
    sent: AtomicU64,
}

impl Traffic {
    /// Members sent so many bytes.
    pub fn add_received(&self, bytes: usize) {
        self.0.received.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    /// Members were sent so many bytes.
    pub fn add_sent(&self, bytes: usize) {
        self.0.sent.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    /// Bytes that members sent.
    #[must_use]
    pub fn received(&self) -> &AtomicU64 {
        &self.0.received
    }

    /// Bytes that members were sent.
    #[must_use]
    pub fn sent(&self) -> &AtomicU64 {
        &self.0.sent
    }
}

/// Steps for the median and the 99th percentile.
const RECENT: usize = 4_096;

/// Time of the stages of all ticks so far.
#[derive(Debug, Default)]
pub(crate) struct Times {
    step_total: u64,
    observe_total: u64,
    publish_total: u64,
    /// Duration of the last steps in nanoseconds; a ring once it is full.
    recent: Vec<u64>,
    next: usize,
    /// Median and 99th percentile of the recent steps, until another step is added: a scene answers more often than
    /// it steps.
    percentiles: Option<(u64, u64)>,
}

/// The moments between the stages of one tick.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Timestamps {
    pub(crate) begun: Instant,
    pub(crate) stepped: Instant,
    pub(crate) observed: Instant,
    pub(crate) published: Instant,
}

impl Times {
    pub(crate) fn add(&mut self, timestamps: Timestamps) {
        let step = timestamps.stepped.since(timestamps.begun).as_nanos();
        self.step_total += step;
        self.observe_total += timestamps.observed.since(timestamps.stepped).as_nanos();
        self.publish_total += timestamps.published.since(timestamps.observed).as_nanos();
        if self.recent.len() < RECENT {
            self.recent.push(step);
        } else {
            self.recent[self.next] = step;
        }
        self.next = (self.next + 1) % RECENT;
        self.percentiles = None;
    }

    pub(crate) fn summary(&mut self) -> StageTimes {
        let recent = &self.recent;
        let (step_median, step_p99) = *self.percentiles.get_or_insert_with(|| {
            let mut steps = recent.clone();
            steps.sort_unstable();
            let at = |share: usize| steps.get(steps.len() * share / 100).copied().unwrap_or(0);
            (at(50), at(99))
        });
        StageTimes {
            step_total: self.step_total,
            step_median,
            step_p99,
            observe_total: self.observe_total,
            publish_total: self.publish_total,
        }
    }
}
