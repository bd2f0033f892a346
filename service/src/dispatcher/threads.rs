//! The state that all threads of scene workers share.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use rhumb_scene::SharedClock;

use super::message::{FromWorker, WorkerId, WorkerReport};

/// Hands a message of a worker's thread over; false if the receiver has ended.
pub(super) type SendFromWorker = Arc<dyn Fn(WorkerId, FromWorker) -> bool + Send + Sync>;

/// Messages that wait for the dispatcher, of all workers; beyond them a worker waits.
const REPORTS_WAITING_MAX: usize = 1_024;

/// Needs of a worker's thread.
#[derive(Clone)]
pub(super) struct WorkerThreads {
    pub(super) clock: SharedClock,
    pub(super) send: SendFromWorker,
}

/// The way back from the workers' threads and processes to the dispatcher.
pub(super) struct Threads {
    pub(super) workers: WorkerThreads,
    pub(super) received: Receiver<WorkerReport>,
    pub(super) reports: ReportSender,
}

/// Hands reports to the dispatcher, and wakes it.
#[derive(Clone)]
pub(super) struct ReportSender {
    reports: SyncSender<WorkerReport>,
    waker: Arc<dyn Fn() + Send + Sync>,
}

impl ReportSender {
    /// Hands a report over; false if the dispatcher has ended.
    pub(super) fn send(&self, report: WorkerReport) -> bool {
        // A dispatcher that has ended needs no output.
        let sent = self.reports.send(report).is_ok();
        (self.waker)();
        sent
    }
}

impl Threads {
    pub(super) fn new(clock: SharedClock, waker: impl Fn() + Send + Sync + 'static) -> Self {
        let (reports, received) = sync_channel(REPORTS_WAITING_MAX);
        let reports = ReportSender {
            reports,
            waker: Arc::new(waker),
        };
        let of_workers = reports.clone();
        let send = move |id, message| of_workers.send(WorkerReport::Worker(id, message));
        Self {
            workers: WorkerThreads {
                clock,
                send: Arc::new(send),
            },
            received,
            reports,
        }
    }
}
