//! Members with a copy: times of packets, errors, and when they are back.
//!
//! Each has a thread. What they note is shared, and evaluated by the caller at the end of a part. Invariant: a copy is compared
//! at a tick of which it has all, so that every breach is a fault.

use std::collections::hash_map::RandomState;
use std::collections::{BTreeMap, HashMap};
use std::hash::BuildHasher as _;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rhumb_client::{Client, Event, TapChannel};
use rhumb_protocol::scene::Command;
use rhumb_reckoning::{BodyId, Divergence, Metres, Motion, Tick, Tolerance, ToleranceScale};
use serde::{Deserialize, Serialize};

use super::member::Contents;
use super::rig::script;
use crate::output::Failure;

/// Time between two looks of a member at its copy.
const LOOK: Duration = Duration::from_millis(5);
/// What f32 numbers add to an error, as a share of the tolerance.
const ROUNDING: f64 = 1e-3;

/// Whose member it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Watch {
    Server,
    /// An edge's, by its number.
    Edge(usize),
}

/// The comparison of copies with the server's states.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Judged {
    /// Bodies of copies that were compared, once a tick.
    pub compared: u64,
    /// Those that were further off than their tolerance.
    pub breaches: u64,
    /// The greatest error, in tolerances.
    pub worst: f64,
    /// Checksums of copies that differed from the server's, in the whole run.
    pub mismatches: u64,
}

/// All members with a copy.
pub(super) struct Watchers {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    bodies: Vec<WatchedBody>,
}

#[derive(Clone, Copy, Debug)]
struct WatchedBody {
    id: BodyId,
    radius: Metres,
    scale: ToleranceScale,
}

/// The motion of each body at a tick; `None` for a body that is not there.
type Row = Vec<Option<Motion>>;

/// What members note.
#[derive(Default)]
struct Shared {
    hash: RandomState,
    stop: AtomicBool,
    /// Packets of the member of the server, by their bytes.
    direct: Mutex<HashMap<u64, Instant>>,
    /// Packets of the others.
    by_edges: Mutex<Vec<(u64, Instant)>>,
    packets: AtomicU64,
    interrupted: AtomicU64,
    mismatches: AtomicU64,
    compares: AtomicBool,
    truth: Mutex<BTreeMap<Tick, Row>>,
    shown: Mutex<Vec<(Tick, Row)>>,
    fault: Mutex<Option<(usize, Tick, Instant)>>,
    back: Mutex<Vec<Duration>>,
}

fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Watchers {
    pub(super) fn new(contents: &Contents) -> Result<Self, Failure> {
        let mut commands = Vec::new();
        let mut script = script(&contents.script, contents.bodies, contents.seed)?;
        script.commands(Tick::ZERO, &mut commands);
        let radius_of = |command: &Command| match command {
            Command::AddShape { id, shape } => Some((*id, shape.bounding_radius())),
            _ => None,
        };
        let radii: BTreeMap<_, _> = commands.iter().filter_map(radius_of).collect();
        let body = |command: &Command| match command {
            Command::AddBody { desc, .. } => Some(WatchedBody {
                id: desc.id,
                radius: *radii.get(&desc.shape)?,
                scale: desc.tolerance_scale,
            }),
            _ => None,
        };
        Ok(Self {
            shared: Arc::default(),
            threads: Vec::new(),
            bodies: commands.iter().filter_map(body).collect(),
        })
    }

    /// Follows a scene until the end.
    pub(super) fn watch(&mut self, mut client: Client, of: Watch) {
        let shared = Arc::clone(&self.shared);
        client.record(move |channel, bytes| {
            if channel == TapChannel::StateDown {
                shared.note_arrival(of, bytes);
            }
        });
        let shared = Arc::clone(&self.shared);
        let ids: Vec<_> = self.bodies.iter().map(|body| body.id).collect();
        self.threads.push(thread::spawn(move || {
            let mut member = WatchedMember {
                client,
                of,
                complete: Tick::ZERO,
                back_from: None,
            };
            // A look waits for what comes.
            while member.look(&shared, &ids) {
                if shared.stop.load(Ordering::Relaxed) {
                    break;
                }
            }
        }));
    }

    /// Packets of the member of the server so far.
    pub(super) fn packets(&self) -> u64 {
        self.shared.packets.load(Ordering::Relaxed)
    }

    /// Connections that were interrupted so far.
    pub(super) fn interrupted(&self) -> u64 {
        self.shared.interrupted.load(Ordering::Relaxed)
    }

    /// What has come until now is not timed.
    pub(super) fn forget_arrivals(&self) {
        lock(&self.shared.by_edges).clear();
        lock(&self.shared.direct).clear();
    }

    /// By how much later each packet came by an edge, nanoseconds.
    pub(super) fn added_ns(&self) -> Vec<u64> {
        let direct = lock(&self.shared.direct);
        let by_edges = lock(&self.shared.by_edges);
        let delays = by_edges.iter().filter_map(|(packet, at)| {
            let delay = at.saturating_duration_since(*direct.get(packet)?);
            u64::try_from(delay.as_nanos()).ok()
        });
        delays.collect()
    }

    /// Compares all copies with the states that a member with a full stream receives, for some time.
    pub(super) fn judge(
        &mut self,
        mut exact: Client,
        tolerance: Tolerance,
        duration: Duration,
    ) -> Result<Judged, Failure> {
        let (shared, begun) = (Arc::clone(&self.shared), Instant::now());
        let ids: Vec<_> = self.bodies.iter().map(|body| body.id).collect();
        shared.compares.store(true, Ordering::Relaxed);
        let mut complete = Tick::ZERO;
        while begun.elapsed() < duration {
            exact.idle(LOOK)?;
            while exact.poll_event().is_some() {}
            if exact.statistics().complete > complete {
                complete = exact.statistics().complete;
                lock(&shared.truth).insert(complete, row(&exact, &ids, complete));
            }
        }
        shared.compares.store(false, Ordering::Relaxed);
        let truth = std::mem::take(&mut *lock(&shared.truth));
        let shown = std::mem::take(&mut *lock(&shared.shown));
        let mut judged = Judged::default();
        for (tick, shown) in &shown {
            if let Some(truth) = truth.get(tick) {
                self.compare(truth, shown, tolerance, &mut judged);
            }
        }
        Ok(judged)
    }

    fn compare(&self, truth: &Row, shown: &Row, tolerance: Tolerance, judged: &mut Judged) {
        for ((body, truth), shown) in self.bodies.iter().zip(truth).zip(shown) {
            let share = match (truth, shown) {
                (None, None) => continue,
                (Some(truth), Some(shown)) => {
                    let apart = Divergence::between(&truth.pose(), &shown.pose());
                    tolerance.scaled(body.scale).share(&apart, body.radius)
                }
                // A body that one of them lacks.
                _ => f64::INFINITY,
            };
            judged.compared += 1;
            judged.breaches += u64::from(share > 1.0 + ROUNDING);
            judged.worst = judged.worst.max(share);
        }
    }

    /// Checksums of copies that differed so far.
    pub(super) fn mismatches(&self) -> u64 {
        self.shared.mismatches.load(Ordering::Relaxed)
    }

    /// From now on, members of an edge note when they have all of a tick later than this one.
    pub(super) fn begin_fault(&self, edge: usize, tick: Tick) {
        lock(&self.shared.back).clear();
        *lock(&self.shared.fault) = Some((edge, tick, Instant::now()));
    }

    /// The times that they noted.
    pub(super) fn back(&self) -> Vec<Duration> {
        lock(&self.shared.back).clone()
    }

    /// Ends all members.
    pub(super) fn end(self) -> Result<(), Failure> {
        self.shared.stop.store(true, Ordering::Relaxed);
        for thread in self.threads {
            let ended = thread.join();
            ended.map_err(|_| "the thread of a member panicked")?;
        }
        Ok(())
    }
}

impl Shared {
    fn note_arrival(&self, of: Watch, bytes: &[u8]) {
        let (packet, now) = (self.hash.hash_one(bytes), Instant::now());
        match of {
            Watch::Server => {
                self.packets.fetch_add(1, Ordering::Relaxed);
                lock(&self.direct).entry(packet).or_insert(now);
            }
            Watch::Edge(_) => lock(&self.by_edges).push((packet, now)),
        }
    }
}

/// The motions of bodies in a copy.
fn row(client: &Client, ids: &[BodyId], tick: Tick) -> Row {
    let stream = client.replica().map(rhumb_client::Replica::stream);
    let motion = |id: &BodyId| stream?.predicted_motion(*id, tick);
    ids.iter().map(motion).collect()
}

struct WatchedMember {
    client: Client,
    of: Watch,
    complete: Tick,
    /// The beginning of the last fault from which it came back.
    back_from: Option<Instant>,
}

impl WatchedMember {
    /// One look; false once the connection is over for good.
    fn look(&mut self, shared: &Shared, ids: &[BodyId]) -> bool {
        if self.client.idle(LOOK).is_err() {
            shared.interrupted.fetch_add(1, Ordering::Relaxed);
            return false;
        }
        while let Some((_, event)) = self.client.poll_event() {
            let count = match event {
                Event::ChecksumMismatch => &shared.mismatches,
                Event::Interrupted(_) => &shared.interrupted,
                _ => continue,
            };
            count.fetch_add(1, Ordering::Relaxed);
        }
        let complete = self.client.statistics().complete;
        if complete > self.complete && shared.compares.load(Ordering::Relaxed) {
            let shown = row(&self.client, ids, complete);
            lock(&shared.shown).push((complete, shown));
        }
        self.complete = complete;
        let fault = *lock(&shared.fault);
        if let Some((edge, tick, since)) = fault
            && self.of == Watch::Edge(edge)
            && complete > tick
            && self.back_from != Some(since)
        {
            self.back_from = Some(since);
            lock(&shared.back).push(since.elapsed());
        }
        true
    }
}
