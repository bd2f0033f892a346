//! Request to stop a running server, from any thread.
//!
//! Not safe inside a signal handler, since it locks. A request cannot be withdrawn.

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard};

/// Requests a running server to stop; all clones are one request.
#[derive(Clone, Default)]
pub struct Stop {
    shared: Arc<Mutex<StopState>>,
}

#[derive(Default)]
struct StopState {
    requested: bool,
    wakes: Vec<Box<dyn Fn() + Send>>,
}

impl Stop {
    /// No request yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Requests the stop. Servers that run with it close their connections and return; later ones return at once.
    pub fn stop(&self) {
        let mut shared = self.lock();
        shared.requested = true;
        for wake in shared.wakes.drain(..) {
            wake();
        }
    }

    /// True if the stop was requested.
    #[must_use]
    pub fn is_requested(&self) -> bool {
        self.lock().requested
    }

    /// Calls `wake` once at the request, or now if it was made already.
    pub(super) fn on_stop(&self, wake: impl Fn() + Send + 'static) {
        let mut shared = self.lock();
        if shared.requested {
            wake();
        } else {
            shared.wakes.push(Box::new(wake));
        }
    }

    fn lock(&self) -> MutexGuard<'_, StopState> {
        self.shared.lock().expect("a wake-up never panics")
    }
}

impl fmt::Debug for Stop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Stop")
            .field("requested", &self.is_requested())
            .finish()
    }
}
