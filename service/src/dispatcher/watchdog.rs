//! Workers that do not answer: found, and quarantined.
//!
//! A thread cannot be killed. A quarantined one is left to itself with the lowest priority; its clients are
//! closed, its scenes are lost, and their names are free again when it ends by itself. Invariant: at most
//! `quarantined_scenes` threads are quarantined before new scenes are refused.

use std::time::Duration;

use rhumb_protocol::scene::SceneName;
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Instant, Span};
use rhumb_scene::Heartbeat;

use super::message::{FromWorker, WorkerId, WorkerReport};
use super::worker;
use super::{Dispatcher, Place};
use crate::flight::FlightCause;

/// Time between two looks at the workers.
const INTERVAL: Span = Span::from_millis(250);
/// Looks without a sign of life beyond the time that a thread has: a process may be late with its own.
const LOOKS_MORE: u64 = 2;
/// Time that threads have to end when the dispatcher ends.
const END: Duration = Duration::from_millis(500);
/// Time that processes have, whose threads have as long.
const END_OF_PROCESSES: Duration = Duration::from_millis(800);
/// Time after which processes that did not end by themselves are killed and gone.
const KILLED: Duration = Duration::from_millis(1_200);

impl Dispatcher {
    /// The time of the next check of the workers; never if there are none.
    pub(super) fn next_watch(&self) -> Option<Instant> {
        let processes = self.processes.as_ref();
        let has_process = processes.is_some_and(|processes| !processes.is_empty());
        let watches = !self.workers.is_empty() || has_process;
        watches.then_some(self.watchdog.next)
    }

    /// Quarantines the workers that have not answered for too long.
    pub(super) fn watch(&mut self, now: Instant) {
        if now < self.watchdog.next {
            return;
        }
        self.watchdog.next = now + INTERVAL;
        let stuck_for = self.settings.scenes.limits.stuck();
        if let Some(processes) = &mut self.processes {
            let looks = stuck_for.as_nanos() / INTERVAL.as_nanos() + LOOKS_MORE;
            processes.look(u32::try_from(looks).unwrap_or(u32::MAX));
        }
        let is_stuck = |heartbeat: &Heartbeat| heartbeat.busy_for() > stuck_for;
        let stuck = self
            .workers
            .iter()
            .filter(|(_, worker)| match &worker.place {
                Place::Thread(thread) => is_stuck(&thread.heartbeat),
                // A process watches its threads itself.
                Place::Process(_) => false,
            });
        let stuck: Vec<WorkerId> = stuck.map(|(id, _)| *id).collect();
        for id in stuck {
            self.quarantine(id);
        }
    }

    fn quarantine(&mut self, id: WorkerId) {
        self.close_connections_of(id, CloseCode::SCENE_QUARANTINED);
        let Some(worker) = self.workers.remove(&id) else {
            return;
        };
        let scene = worker.scene;
        let is_quarantined = |name: &SceneName| *name == scene;
        (self.settings.recorders.flights).write_where(is_quarantined, FlightCause::Quarantined);
        if let Place::Thread(thread) = &worker.place {
            worker::lower(&thread.thread_id);
        }
        self.watchdog.quarantined.insert(id, scene.clone());
        let quarantined = self.watchdog.quarantined.len();
        self.settings.recorders.metrics.set_quarantined(quarantined);
        tracing::error!(%scene, worker = id.0, quarantined, "a scene does not answer and is quarantined");
    }

    /// The thread of a worker has ended: by itself if it is no worker any more, else by a panic.
    pub(super) fn note_over(&mut self, id: WorkerId) {
        if let Some(scene) = self.watchdog.quarantined.remove(&id) {
            tracing::warn!(%scene, worker = id.0, "a quarantined thread has ended");
            self.by_scene.remove(&scene);
            (self.settings.recorders.metrics).set_quarantined(self.watchdog.quarantined.len());
        }
        if self.workers.contains_key(&id) {
            self.close_connections_of(id, CloseCode::SCENE_QUARANTINED);
            self.drop_worker(id);
        }
    }

    /// Ends all workers; waits a little for the threads that are not quarantined, and for all processes.
    pub fn shut_down(&mut self) {
        let is_thread = |worker: &super::Worker| matches!(worker.place, Place::Thread(_));
        let of_threads = self.workers.iter();
        let mut left: Vec<WorkerId> = of_threads
            .filter(|(_, worker)| is_thread(worker))
            .map(|(id, _)| *id)
            .collect();
        self.workers.clear();
        let threads = &self.threads;
        let mut processes = self.processes.as_mut();
        let mut running = processes
            .as_mut()
            .map_or(0, |processes| processes.end_all());
        let mut until = if running > 0 { END_OF_PROCESSES } else { END };
        let started = (threads.workers.clock)();
        while !left.is_empty() || running > 0 {
            let waited = (threads.workers.clock)().since(started);
            let waited = Duration::from_nanos(waited.as_nanos());
            match threads.received.recv_timeout(until.saturating_sub(waited)) {
                Ok(WorkerReport::Worker(id, FromWorker::Over)) => left.retain(|other| *other != id),
                Ok(WorkerReport::ProcessOver(..)) => running -= 1,
                Ok(WorkerReport::Worker(..) | WorkerReport::Process(..)) => {}
                Err(_) if running > 0 && until < KILLED => {
                    tracing::warn!(running, "worker processes did not end in time");
                    until = KILLED;
                    processes
                        .iter_mut()
                        .for_each(|processes| processes.kill_all());
                }
                Err(_) => {
                    let threads = left.len();
                    return tracing::warn!(threads, "threads of scenes did not end in time");
                }
            }
        }
    }
}
