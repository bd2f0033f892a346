//! Members of a load with a copy: what they receive, and how right it is.
//!
//! Each has a thread, and is a member until the load ends. Their notes are shared, and evaluated by the caller at the end of
//! a part, or by a thread while they come. Invariant: a copy is compared at a tick of which it has all, so that every
//! breach is a fault.

use std::collections::hash_map::RandomState;
use std::collections::{BTreeMap, HashMap};
use std::hash::BuildHasher as _;
use std::ops::Range;
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
/// Time between two views of a member.
const FRAME: Duration = Duration::from_millis(50);
/// Rounding of f32 numbers in an error, as a share of the tolerance.
const ROUNDING: f64 = 1e-3;

/// The end to which a member is connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Watch {
    Server,
    /// An edge, by its number.
    Edge(usize),
}

/// The comparison of copies with the server's states.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Judged {
    /// Bodies of copies that were compared, once a tick.
    pub compared: u64,
    /// Samples that were further off than their tolerance.
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

/// The notes of members.
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
    shown: Mutex<Vec<(Tick, Row)>>,
    fault: Mutex<Option<(Range<usize>, Tick, Instant)>>,
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
                shown_at: Instant::now(),
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

    /// Packets that came until now are not timed.
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

    /// Compares all copies with the states that a member with a full stream receives, until [`Judge::end`].
    pub(super) fn judge(&self, exact: Client, tolerance: Tolerance) -> Judge {
        let (shared, stop) = (Arc::clone(&self.shared), Arc::new(AtomicBool::new(false)));
        let judging = Judging {
            shared,
            bodies: self.bodies.clone(),
            tolerance,
            truth: BTreeMap::new(),
            shown: Vec::new(),
            judged: Judged::default(),
        };
        let stopped = Arc::clone(&stop);
        let thread = thread::spawn(move || judging.run(exact, &stopped));
        Judge { stop, thread }
    }

    /// Checksums of copies that differed so far.
    pub(super) fn mismatches(&self) -> u64 {
        self.shared.mismatches.load(Ordering::Relaxed)
    }

    /// From now on, members of these edges note how long after a moment they have all of a tick later than this one.
    pub(super) fn begin_fault(&self, edges: &Range<usize>, since: Instant, tick: Tick) {
        lock(&self.shared.back).clear();
        *lock(&self.shared.fault) = Some((edges.clone(), tick, since));
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

/// A comparison that runs.
pub(super) struct Judge {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Result<Judged, Failure>>,
}

impl Judge {
    /// Ends it.
    pub(super) fn end(self) -> Result<Judged, Failure> {
        self.stop.store(true, Ordering::Relaxed);
        let ended = self.thread.join();
        ended.map_err(|_| "the thread of a comparison panicked")?
    }
}

/// Published ticks for which states of the server are kept: a copy that is later by more is not compared.
const TRUTHS: usize = 256;

/// States of the server, and copies that wait for them.
struct Judging {
    shared: Arc<Shared>,
    bodies: Vec<WatchedBody>,
    tolerance: Tolerance,
    truth: BTreeMap<Tick, Row>,
    shown: Vec<(Tick, Row)>,
    judged: Judged,
}

impl Judging {
    fn run(mut self, mut exact: Client, stop: &AtomicBool) -> Result<Judged, Failure> {
        let ids: Vec<_> = self.bodies.iter().map(|body| body.id).collect();
        self.shared.compares.store(true, Ordering::Relaxed);
        let mut complete = Tick::ZERO;
        while !stop.load(Ordering::Relaxed) {
            exact.idle(LOOK)?;
            while exact.poll_event().is_some() {}
            if exact.statistics().complete > complete {
                complete = exact.statistics().complete;
                self.truth.insert(complete, row(&exact, &ids, complete));
                self.compare_all(complete);
            }
        }
        self.shared.compares.store(false, Ordering::Relaxed);
        lock(&self.shared.shown).clear();
        Ok(self.judged)
    }

    /// Compares the copies of ticks up to the newest one of the server.
    fn compare_all(&mut self, complete: Tick) {
        self.shown.append(&mut lock(&self.shared.shown));
        for (tick, shown) in std::mem::take(&mut self.shown) {
            match self.truth.get(&tick) {
                Some(truth) => {
                    compare(
                        &self.bodies,
                        (truth, &shown),
                        self.tolerance,
                        &mut self.judged,
                    );
                }
                None if tick > complete => self.shown.push((tick, shown)),
                None => {}
            }
        }
        while self.truth.len() > TRUTHS {
            self.truth.pop_first();
        }
    }
}

fn compare(
    bodies: &[WatchedBody],
    (truth, shown): (&Row, &Row),
    tolerance: Tolerance,
    judged: &mut Judged,
) {
    for ((body, truth), shown) in bodies.iter().zip(truth).zip(shown) {
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
    /// When it computed its view.
    shown_at: Instant,
    /// The beginning of the last fault from which it came back.
    back_from: Option<Instant>,
}

impl WatchedMember {
    /// One look; false once the connection is over for good.
    fn look(&mut self, shared: &Shared, ids: &[BodyId]) -> bool {
        let mut is_open = self.client.idle(LOOK).is_ok();
        if is_open && self.shown_at.elapsed() >= FRAME {
            // As a member that shows the scene, it asks when it has no news.
            is_open = self.client.poll().is_ok();
            self.shown_at = Instant::now();
        }
        if !is_open {
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
        let fault = lock(&shared.fault).clone();
        if let Some((edges, tick, since)) = fault
            && let Watch::Edge(edge) = self.of
            && edges.contains(&edge)
            && complete > tick
            && self.back_from != Some(since)
        {
            self.back_from = Some(since);
            lock(&shared.back).push(since.elapsed());
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use std::slice;

    use rhumb_reckoning::Pose;

    use super::*;

    fn judged(truth: Option<Motion>, shown: Option<Motion>) -> Judged {
        let body = WatchedBody {
            id: BodyId::new(1, 0),
            radius: Metres::new(0.5),
            scale: ToleranceScale::USUAL,
        };
        let rows = (&vec![truth], &vec![shown]);
        let mut judged = Judged::default();
        compare(slice::from_ref(&body), rows, Tolerance::NORMAL, &mut judged);
        judged
    }

    fn moved_by(metres: f64) -> Motion {
        let mut pose = Pose::IDENTITY;
        pose.position.x += metres;
        Motion::new(pose, Motion::IDENTITY.twist()).unwrap()
    }

    #[test]
    fn a_copy_breaches_beyond_its_tolerance_and_by_a_body_that_it_lacks() {
        let truth = Some(Motion::IDENTITY);
        let near = judged(truth, Some(moved_by(0.04)));
        assert_eq!((near.compared, near.breaches), (1, 0));
        assert!((near.worst - 0.8).abs() < 1e-6, "{near:?}");
        assert_eq!(judged(truth, Some(moved_by(0.06))).breaches, 1);
        assert_eq!(judged(truth, None).breaches, 1);
        assert_eq!(judged(None, truth).breaches, 1);
        assert_eq!(judged(None, None), Judged::default());
    }

    #[test]
    fn the_delay_of_a_packet_counts_from_the_same_bytes_at_the_server() {
        let contents = Contents {
            script: "ball-pit".to_owned(),
            bodies: 4,
            seed: 1,
            reset: Duration::from_secs(1),
            publish_interval: 3.try_into().unwrap(),
        };
        let watchers = Watchers::new(&contents).unwrap();
        watchers.shared.note_arrival(Watch::Server, b"first");
        watchers.shared.note_arrival(Watch::Edge(0), b"first");
        watchers
            .shared
            .note_arrival(Watch::Edge(1), b"not the server's");
        assert_eq!((watchers.packets(), watchers.added_ns().len()), (1, 1));
        watchers.forget_arrivals();
        assert!(watchers.added_ns().is_empty());
    }
}
