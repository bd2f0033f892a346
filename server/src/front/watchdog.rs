//! Workers that do not answer: found, and parked.
//!
//! A thread cannot be killed. A parked one is left to itself with the lowest priority; its clients are
//! closed, its scenes are lost, and their names are free again when it ends by itself. Invariant: at most
//! `parked_scenes` threads are parked before new scenes are refused.

use std::time::Duration;

use rhumb_protocol::scene::SceneName;
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Instant, Span};

use super::message::{FromWorker, WorkerId};
use super::parked::Scope;
use super::{ADAPTER_SCENES, Front, Place, priority};
use crate::flight::{FlightCause, FlightRecorders};
use crate::pulse::Pulse;
#[cfg(feature = "record")]
use crate::recording::SceneTaps;

/// Time between two looks at the workers.
const INTERVAL: Span = Span::from_millis(250);
/// Time that threads have to end when the front ends.
const END: Duration = Duration::from_millis(500);

impl Front {
    /// Has the last moments of later scenes recorded.
    pub(crate) fn record_flights(&mut self, flights: FlightRecorders) {
        self.settings.recorders.flights = flights;
    }

    /// Has the states of later scenes handed to their readers.
    #[cfg(feature = "record")]
    pub(crate) fn tap(&mut self, taps: SceneTaps) {
        self.settings.recorders.taps = taps;
    }

    /// The time of the next check of the workers; never if none has a thread.
    pub(super) fn next_watch(&self) -> Option<Instant> {
        let watches = self.threads.is_some() && !self.workers.is_empty();
        watches.then_some(self.watchdog.next)
    }

    /// Parks the workers that have not answered for too long.
    pub(super) fn watch(&mut self, now: Instant) {
        if now < self.watchdog.next {
            return;
        }
        self.watchdog.next = now + INTERVAL;
        let stuck_for = self.settings.limits.stuck();
        let is_stuck = |pulse: &Pulse| pulse.busy_for() > stuck_for;
        let stuck = self
            .workers
            .iter()
            .filter(|(_, worker)| match &worker.place {
                Place::Thread(thread) => is_stuck(&thread.pulse),
                Place::Here(_) => false,
            });
        let stuck: Vec<WorkerId> = stuck.map(|(id, _)| *id).collect();
        for id in stuck {
            self.park(id);
        }
    }

    fn park(&mut self, id: WorkerId) {
        self.close_connections_of(id, CloseCode::SCENE_PARKED);
        let Some(worker) = self.workers.remove(&id) else {
            return;
        };
        let is_parked = |name: &SceneName| match &worker.scope {
            Scope::Scene(scene) => name == scene,
            Scope::Adapter => name.as_str().starts_with(ADAPTER_SCENES),
        };
        (self.settings.recorders.flights).write_where(is_parked, FlightCause::Parked);
        if let Place::Thread(thread) = &worker.place {
            priority::lower(&thread.thread_id);
        }
        self.watchdog.parked.insert(id, worker.scope.clone());
        let parked = self.watchdog.parked.len();
        self.settings.metrics.set_parked(parked);
        tracing::error!(scope = ?worker.scope, worker = id.0, parked, "a scene does not answer and is parked");
    }

    /// The thread of a worker has ended: by itself if it is no worker any more, else by a panic.
    pub(super) fn note_over(&mut self, id: WorkerId) {
        if let Some(scope) = self.watchdog.parked.remove(&id) {
            tracing::warn!(?scope, worker = id.0, "a parked thread has ended");
            self.by_scope.remove(&scope);
            (self.settings.metrics).set_parked(self.watchdog.parked.len());
        }
        if self.workers.contains_key(&id) {
            self.close_connections_of(id, CloseCode::SCENE_PARKED);
            self.drop_worker(id);
        }
    }

    /// Ends all workers; waits a little for the threads that are not parked.
    pub fn shut_down(&mut self) {
        let mut left: Vec<WorkerId> = self.workers.keys().copied().collect();
        self.workers.clear();
        let Some(threads) = &self.threads else {
            return;
        };
        let started = (threads.clock)();
        while !left.is_empty() {
            let waited = Duration::from_nanos((threads.clock)().since(started).as_nanos());
            let Ok((id, message)) = threads.received.recv_timeout(END.saturating_sub(waited))
            else {
                tracing::warn!(
                    threads = left.len(),
                    "threads of scenes did not end in time"
                );
                return;
            };
            if message == FromWorker::Over {
                left.retain(|other| *other != id);
            }
        }
    }
}
