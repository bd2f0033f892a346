//! How workers begin: on the caller's thread, on their own, or in a process.

use std::sync::Arc;
use std::sync::mpsc::channel;

use rhumb_protocol::session::CloseCode;

#[cfg(feature = "app")]
use super::Adapter;
use super::message::{WorkerId, WorkerInput};
use super::quarantined::Scope;
use super::worker::{InlineWorker, ThreadWorker};
use super::{Dispatcher, Place, Worker};
use crate::durable::LogTail;

impl Dispatcher {
    /// The worker of some scenes, started if there is none.
    pub(super) fn worker_of(&mut self, scope: Scope) -> Result<WorkerId, CloseCode> {
        if let Some(id) = self.by_scope.get(&scope) {
            let quarantined = self.watchdog.is_quarantined(*id);
            return if quarantined {
                Err(CloseCode::SCENE_QUARANTINED)
            } else {
                Ok(*id)
            };
        }
        if self.watchdog.quarantined.len() as u64 >= self.settings.scenes.limits.quarantined_scenes
        {
            return Err(CloseCode::BUSY);
        }
        self.start_worker(scope, LogTail::Kept)
    }

    /// Starts a worker, which restores its scene if a data directory has it.
    pub(super) fn start_worker(
        &mut self,
        scope: Scope,
        tail: LogTail,
    ) -> Result<WorkerId, CloseCode> {
        let id = WorkerId(self.next_worker);
        let place = match (&self.threads, &mut self.processes, &scope) {
            (None, ..) => Place::Inline(Box::new(InlineWorker::new(
                &self.settings.scenes,
                self.settings.data.as_ref(),
                Arc::new(|| {}),
            ))),
            (Some(threads), Some(processes), Scope::Scene(scene)) => {
                Place::Process(processes.begin(id, scene, threads, &self.settings)?)
            }
            (Some(threads), ..) => {
                let scenes = (&self.settings.scenes, self.settings.data.as_ref());
                let started = ThreadWorker::start(id, scenes, None, channel(), &threads.workers);
                Place::Thread(started.map_err(|cause| {
                    tracing::error!(%cause, "no thread for a scene");
                    CloseCode::BUSY
                })?)
            }
        };
        let stored = self.settings.data.as_ref().and(scope.scene().cloned());
        self.add_worker(id, scope, place);
        if let Some(scene) = stored {
            let now = (self.settings.scenes.clock)();
            self.route(now, id, WorkerInput::Restore(scene, tail));
        }
        Ok(id)
    }

    fn add_worker(&mut self, id: WorkerId, scope: Scope, place: Place) {
        self.next_worker += 1;
        self.by_scope.insert(scope.clone(), id);
        let worker = Worker {
            scope,
            place,
            connections: 0,
            sent: 0,
            taken: 0,
            scenes: 0,
        };
        self.workers.insert(id, worker);
    }

    /// Starts the worker of an adapter; without threads there is none.
    ///
    /// # Errors
    ///
    /// The system's, if the thread cannot start.
    #[cfg(feature = "app")]
    pub(crate) fn serve_also(&mut self, adapter: Adapter) -> std::io::Result<()> {
        let Some(threads) = &self.threads else {
            return Ok(());
        };
        let id = WorkerId(self.next_worker);
        let Adapter {
            sender,
            inputs,
            serve,
        } = adapter;
        let (scenes, queue) = ((&self.settings.scenes, None), (sender, inputs));
        let thread = ThreadWorker::start(id, scenes, Some(serve), queue, &threads.workers)?;
        self.add_worker(id, Scope::Adapter, Place::Thread(thread));
        Ok(())
    }
}
