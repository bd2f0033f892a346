//! The state that all threads of scene workers share.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use rhumb_protocol::Instant;

use super::message::{FromWorker, WorkerId};

/// The clock of a server's threads.
pub(super) type SharedClock = Arc<dyn Fn() -> Instant + Send + Sync>;

/// Outputs that wait for the front, of all workers; beyond them a worker waits.
const OUTPUTS_WAITING_MAX: usize = 1_024;

/// The way back from the workers' threads to the front.
pub(super) struct Threads {
    pub(super) clock: SharedClock,
    pub(super) outputs: SyncSender<(WorkerId, FromWorker)>,
    pub(super) received: Receiver<(WorkerId, FromWorker)>,
    /// Wakes the front.
    pub(super) waker: Arc<dyn Fn() + Send + Sync>,
}

impl Threads {
    pub(super) fn new(clock: SharedClock, waker: impl Fn() + Send + Sync + 'static) -> Self {
        let (outputs, received) = sync_channel(OUTPUTS_WAITING_MAX);
        Self {
            clock,
            outputs,
            received,
            waker: Arc::new(waker),
        }
    }
}
