//! Clients of another protocol, served on the thread of their scenes.
//!
//! Compiled by the feature `app`.

use std::sync::mpsc::{Receiver, Sender, channel};

use rhumb_scene::SceneRouter;

use super::message::WorkerInput;
use super::worker::ServeOthers;

/// A listener of another protocol, and the queue that wakes its worker.
pub(crate) struct Adapter {
    pub(super) sender: Sender<WorkerInput>,
    pub(super) inputs: Receiver<WorkerInput>,
    /// Called in each turn of the worker, and after each wake.
    pub(super) serve: ServeOthers,
}

/// Wakes the worker of an adapter.
#[derive(Clone, Debug)]
pub(crate) struct AdapterWaker(Sender<WorkerInput>);

/// The queue of a worker that is not yet started.
#[derive(Debug)]
pub(crate) struct AdapterQueue {
    sender: Sender<WorkerInput>,
    inputs: Receiver<WorkerInput>,
}

impl AdapterQueue {
    pub(crate) fn new() -> Self {
        let (sender, inputs) = channel();
        Self { sender, inputs }
    }

    pub(crate) fn waker(&self) -> AdapterWaker {
        AdapterWaker(self.sender.clone())
    }

    /// The adapter whose worker calls `serve`.
    pub(crate) fn into_adapter(
        self,
        serve: impl FnMut(&mut SceneRouter) + Send + 'static,
    ) -> Adapter {
        let Self { sender, inputs } = self;
        Adapter {
            sender,
            inputs,
            serve: Box::new(serve),
        }
    }
}

impl AdapterWaker {
    /// Wakes the worker, which serves its clients then. A worker that has ended is not woken.
    pub(crate) fn wake(&self) {
        // An error means that the worker has ended.
        let _ = self.0.send(WorkerInput::Wake);
    }
}
