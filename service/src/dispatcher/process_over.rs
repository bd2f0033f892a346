//! The dispatcher handles the messages and the ends of worker processes.
//!
//! The clients of a process that died are closed. Its scenes begin again from what is durable, in a new process; without
//! a data directory they are lost, and their names are free.

use rhumb_protocol::session::CloseCode;

use super::message::{FromProcess, FromWorker, ProcessId, WorkerId};
use super::quarantined::Scope;
use super::{Dispatcher, Place};
use crate::durable::LogTail;

impl Dispatcher {
    pub(super) fn take_process_message(&mut self, id: ProcessId, message: FromProcess) {
        let Some(processes) = &mut self.processes else {
            return;
        };
        let Some((worker, message)) = processes.take(id, message, &self.settings) else {
            return;
        };
        if message == FromWorker::Over {
            processes.note_worker_over(id);
        }
        // A broken process's words about another one's workers do not count.
        let is_its = |place: &Place| matches!(place, Place::Process(of) if *of == id);
        if (self.workers.get(&worker)).is_some_and(|worker| is_its(&worker.place)) {
            self.take_message(worker, message);
        }
    }

    pub(super) fn note_process_over(&mut self, id: ProcessId, status: &str) {
        let now = (self.settings.scenes.clock)();
        let Some(processes) = &mut self.processes else {
            return;
        };
        let Some(death) = processes.note_over(now, (id, status), &self.settings) else {
            return;
        };
        let code = match self.settings.data {
            Some(_) => CloseCode::SCENE_RESTORING,
            None => CloseCode::SCENE_LOST,
        };
        let workers = self.workers.iter();
        let died: Vec<(WorkerId, Scope)> = workers
            .filter(|(_, worker)| matches!(worker.place, Place::Process(of) if of == id))
            .map(|(id, worker)| (*id, worker.scope.clone()))
            .collect();
        for (worker, _) in &died {
            self.close_connections_of(*worker, code);
            self.drop_worker(*worker);
        }
        if self.settings.data.is_none() {
            return;
        }
        for (worker, scope) in died {
            let tail = if death.stuck == Some(worker) {
                LogTail::LeftOut
            } else {
                LogTail::Kept
            };
            if let Err(code) = self.start_worker(scope.clone(), tail) {
                tracing::error!(?scope, %code, "the scene stays in the data directory");
            }
        }
    }
}
