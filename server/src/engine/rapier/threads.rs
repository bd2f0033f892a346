//! Threads that step and publish scenes: the caller's own, or a pool.
//!
//! Results are equal to the bit on any number of threads. Without the feature `parallel` there is one thread.

use std::fmt;
use std::num::NonZeroU32;
#[cfg(feature = "parallel")]
use std::sync::Arc;

use rapier3d::prelude::PhysicsWorld;
#[cfg(feature = "parallel")]
use rapier3d::rayon::{ScopeFifo, ThreadPool, ThreadPoolBuilder, scope_fifo};

/// Threads that several scenes may share. By default one, or, with the feature, one for each core.
#[derive(Clone, Debug, Default)]
pub struct StepThreads {
    #[cfg(feature = "parallel")]
    pool: Option<Arc<ThreadPool>>,
}

/// Reason why the requested threads are not available.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StepThreadsError {
    /// This program was built to step on one thread.
    OneOnly {
        /// The requested number.
        asked: NonZeroU32,
    },
    /// The system refuses more threads.
    Denied {
        /// The requested number.
        asked: NonZeroU32,
    },
}

impl fmt::Display for StepThreadsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OneOnly { asked } => write!(
                f,
                "cannot step on {asked} threads: this program was built without the feature \"parallel\""
            ),
            Self::Denied { asked } => write!(f, "the system does not provide {asked} threads"),
        }
    }
}

impl std::error::Error for StepThreadsError {}

impl StepThreads {
    /// A pool of so many threads; one by default.
    ///
    /// # Errors
    ///
    /// [`StepThreadsError`] when the number is not available.
    #[cfg(feature = "parallel")]
    pub fn new(threads: Option<NonZeroU32>) -> Result<Self, StepThreadsError> {
        let asked = threads.unwrap_or(NonZeroU32::MIN);
        let pool = ThreadPoolBuilder::new()
            .num_threads(asked.get() as usize)
            .build();
        match pool {
            Ok(pool) => Ok(Self {
                pool: Some(Arc::new(pool)),
            }),
            Err(_) => Err(StepThreadsError::Denied { asked }),
        }
    }

    /// A pool of so many threads; one by default.
    ///
    /// # Errors
    ///
    /// [`StepThreadsError`] when the number is not available.
    #[cfg(not(feature = "parallel"))]
    pub fn new(threads: Option<NonZeroU32>) -> Result<Self, StepThreadsError> {
        match threads {
            Some(asked) if asked > NonZeroU32::MIN => Err(StepThreadsError::OneOnly { asked }),
            _ => Ok(Self::default()),
        }
    }

    /// True if this program was built to step on more than one thread.
    #[must_use]
    pub const fn may_be_many() -> bool {
        cfg!(feature = "parallel")
    }

    /// Does the same work on each item, on these threads; a single item stays on the caller's own.
    ///
    /// The items do not depend on each other, so that the results do not depend on the number of threads.
    #[cfg(feature = "parallel")]
    pub(crate) fn on_each<T: Send>(&self, items: &mut [T], work: impl Fn(&mut T) + Send + Sync) {
        let one_thread = |pool: &Arc<ThreadPool>| pool.current_num_threads() == 1;
        if items.len() < 2 || self.pool.as_ref().is_some_and(one_thread) {
            return items.iter_mut().for_each(work);
        }
        let work = &work;
        match &self.pool {
            Some(pool) => pool.scope_fifo(|scope| spawn(scope, items, work)),
            None => scope_fifo(|scope| spawn(scope, items, work)),
        }
    }

    /// Does the same work on each item.
    #[cfg(not(feature = "parallel"))]
    pub(crate) fn on_each<T>(&self, items: &mut [T], work: impl Fn(&mut T)) {
        items.iter_mut().for_each(work);
    }

    /// Makes a world use these threads.
    #[cfg(feature = "parallel")]
    pub(super) fn install(&self, world: &mut PhysicsWorld) {
        world.set_thread_pool(self.pool.clone());
    }

    /// Makes a world use these threads.
    #[cfg(not(feature = "parallel"))]
    pub(super) fn install(&self, _: &mut PhysicsWorld) {}
}

/// Hands each item to the next free thread: items may need very different times.
#[cfg(feature = "parallel")]
fn spawn<'s, T: Send>(
    scope: &ScopeFifo<'s>,
    items: &'s mut [T],
    work: &'s (impl Fn(&mut T) + Send + Sync),
) {
    for item in items {
        scope.spawn_fifo(move |_| work(item));
    }
}
