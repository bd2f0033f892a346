//! Solids of large shapes, which are made beside the steps of their scene.
//!
//! A command that adds such a shape waits for its solid, and the rest of its client's messages behind it. It is applied
//! like every other command, so that a log has it at the tick at which it acts, and a replay makes the same solid.
//! Without threads, a solid is made at once.

use std::collections::VecDeque;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rhumb_protocol::scene::{Shape, ShapeId};
use rhumb_protocol::{Instant, Span};

use crate::engine::{BakedShape, Baker, UnusableShape};

/// The predicted time from which on a solid is made beside the steps, microseconds: a sixteenth of a tick at 60 Hz.
const HEAVY_US: u64 = 1_000;
/// Solids of one scene that are made at one time.
const RUNNING_MAX: usize = 2;
/// Solids of a scene that wait for their commands: those of clients that are gone give way.
const WAITING_MAX: usize = 8;

/// The outcome of making a solid.
type Baked = Result<BakedShape, UnusableShape>;

/// True if the solid of a shape takes so long that it is made beside the steps.
pub(crate) fn is_heavy(shape: &Shape) -> bool {
    predicted_us(shape) >= HEAVY_US
}

/// The time that the solid of a shape takes, roughly, microseconds: a tree of a mesh's triangles, the faces of a hull.
fn predicted_us(shape: &Shape) -> u64 {
    match shape {
        Shape::Mesh(mesh) => mesh.triangles().len() as u64,
        Shape::Hull(hull) => hull.points().len() as u64 * 8,
        Shape::Heights(heights) => heights.heights().len() as u64 / 64,
        Shape::Compound(compound) => {
            let parts = compound.parts().iter();
            parts.map(|part| predicted_us(&part.shape)).sum()
        }
        Shape::Ball { .. }
        | Shape::Cuboid { .. }
        | Shape::Capsule { .. }
        | Shape::Cylinder { .. }
        | Shape::RoundedCuboid { .. }
        | Shape::Cone { .. }
        | Shape::HalfSpace { .. } => 0,
    }
}

/// One solid that is to be made.
pub struct BakeJob(Box<dyn FnOnce() + Send>);

impl BakeJob {
    /// Makes it, on the calling thread.
    pub fn run(self) {
        (self.0)();
    }
}

impl fmt::Debug for BakeJob {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("BakeJob")
    }
}

/// Takes jobs; by default, each runs at once on the thread that gives it.
#[derive(Clone, Default)]
pub struct Bakers(Option<Arc<dyn TakeJob>>);

/// The function type of bakers.
trait TakeJob: Fn(BakeJob) + Send + Sync {}

impl<F: Fn(BakeJob) + Send + Sync> TakeJob for F {}

impl Bakers {
    /// Bakers that are given to a function, which must not wait for them.
    pub fn new(take: impl Fn(BakeJob) + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(take)))
    }
}

impl fmt::Debug for Bakers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Bakers")
    }
}

/// The solids that a scene has made.
pub(crate) struct Bakery {
    bakers: Bakers,
    /// Jobs that have not ended, also those that are not waited for any more.
    running: Arc<AtomicUsize>,
}

/// A solid that is to be made.
#[derive(Debug)]
pub(crate) struct Bake {
    /// When it was wanted, and then when it was begun.
    since: Instant,
    /// `None` while it waits for others.
    outcome: Option<Arc<Mutex<Option<Baked>>>>,
}

/// Counts a job until it has ended, or was lost.
struct Running(Arc<AtomicUsize>);

impl Drop for Running {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Release);
    }
}

impl Bakery {
    pub(crate) fn new(bakers: Bakers) -> Self {
        Self {
            bakers,
            running: Arc::default(),
        }
    }

    /// True if solids are being made.
    pub(crate) fn is_busy(&self) -> bool {
        self.running.load(Ordering::Acquire) > 0
    }

    /// Begins to make a solid, unless it is begun or as many as may be are being made.
    pub(crate) fn begin(&self, bake: &mut Bake, now: Instant, shape: &Shape, baker: Baker) {
        if bake.outcome.is_some() || self.running.load(Ordering::Acquire) >= RUNNING_MAX {
            return;
        }
        self.running.fetch_add(1, Ordering::Release);
        let running = Running(Arc::clone(&self.running));
        let outcome = Arc::new(Mutex::new(None));
        let (to, shape) = (Arc::clone(&outcome), shape.clone());
        let job = BakeJob(Box::new(move || {
            let _running = running;
            let baked = catch_unwind(AssertUnwindSafe(|| baker(&shape)));
            *lock(&to) = Some(baked.unwrap_or(Err(UnusableShape)));
        }));
        match &self.bakers.0 {
            Some(take) => take(job),
            None => job.run(),
        }
        *bake = Bake {
            since: now,
            outcome: Some(outcome),
        };
    }
}

impl Bake {
    /// A solid that is wanted from now on.
    pub(crate) const fn wanted(now: Instant) -> Self {
        Self {
            since: now,
            outcome: None,
        }
    }

    /// The moment since which it waits for others; `None` once it is begun.
    pub(crate) fn waits_since(&self) -> Option<Instant> {
        self.outcome.is_none().then_some(self.since)
    }

    /// The outcome, once.
    pub(crate) fn take(&self) -> Option<Baked> {
        lock(self.outcome.as_ref()?).take()
    }

    /// True if it has waited, or has been made, for longer than that.
    pub(crate) fn takes_longer_than(&self, limit: Span, now: Instant) -> bool {
        now.since(self.since) > limit
    }
}

/// Solids of a scene that wait for the commands that add their shapes.
#[derive(Debug, Default)]
pub(crate) struct BakedShapes(VecDeque<(ShapeId, Shape, Baked)>);

impl BakedShapes {
    pub(crate) fn put(&mut self, id: ShapeId, shape: Shape, baked: Baked) {
        if self.0.len() == WAITING_MAX {
            self.0.pop_front();
        }
        self.0.push_back((id, shape, baked));
    }

    /// Takes the solid of a shape.
    pub(crate) fn take(&mut self, id: ShapeId, shape: &Shape) -> Option<Baked> {
        let place = self
            .0
            .iter()
            .position(|(of, baked, _)| *of == id && baked == shape)?;
        self.0.remove(place).map(|(_, _, baked)| baked)
    }
}

fn lock(outcome: &Mutex<Option<Baked>>) -> MutexGuard<'_, Option<Baked>> {
    // It is set in one piece.
    outcome.lock().unwrap_or_else(PoisonError::into_inner)
}
