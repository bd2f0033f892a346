//! The word that ends a running server, said from any thread.
//!
//! Not safe inside a signal handler itself: it locks. Once said it stays said.

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard};

/// Asks a running server to stop; all clones are one.
#[derive(Clone, Default)]
pub struct Stop {
    shared: Arc<Mutex<Shared>>,
}

#[derive(Default)]
struct Shared {
    asked: bool,
    wakes: Vec<Box<dyn Fn() + Send>>,
}

impl Stop {
    /// A word not yet said.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Says it. Servers that run with this word close their connections and return; later ones return at once.
    pub fn stop(&self) {
        let mut shared = self.lock();
        shared.asked = true;
        for wake in shared.wakes.drain(..) {
            wake();
        }
    }

    /// Whether it was said.
    #[must_use]
    pub fn is_asked(&self) -> bool {
        self.lock().asked
    }

    /// Calls `wake` once when the word is said, or now if it was.
    pub(super) fn on_stop(&self, wake: impl Fn() + Send + 'static) {
        let mut shared = self.lock();
        if shared.asked {
            wake();
        } else {
            shared.wakes.push(Box::new(wake));
        }
    }

    fn lock(&self) -> MutexGuard<'_, Shared> {
        self.shared.lock().expect("a wake-up never panics")
    }
}

impl fmt::Debug for Stop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Stop")
            .field("asked", &self.is_asked())
            .finish()
    }
}
