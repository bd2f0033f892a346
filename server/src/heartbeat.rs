//! Sign of life of a thread, for a watchdog.
//!
//! A thread notes when it begins a piece of work that must be short, and when it waits. Invariant: reading it never
//! waits for the thread.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rhumb_protocol::{Instant, Span};

/// The sign of life of one thread; all clones are one.
#[derive(Clone, Default)]
pub struct Heartbeat(Option<Arc<Beats>>);

struct Beats {
    clock: Box<dyn Fn() -> Instant + Send + Sync>,
    /// Nanoseconds of the clock at the begin of the present work; [`RESTING`] while it waits.
    busy_since: AtomicU64,
}

const RESTING: u64 = u64::MAX;

impl Heartbeat {
    /// A heartbeat that is read against this clock. The default one is never read and costs nothing.
    pub fn new(clock: impl Fn() -> Instant + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(Beats {
            clock: Box::new(clock),
            busy_since: AtomicU64::new(RESTING),
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
