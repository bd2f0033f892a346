//! Messages between the front and a scene worker.
//!
//! Plain data: numbers, names and bytes, and nothing of the engine or of a session. A worker could be another process.

use std::sync::Arc;

use bytes::Bytes;
use rhumb_protocol::scene::SceneName;
use rhumb_protocol::{Ending, Endpoint, Instant, LinkReport, Peer, Transmit};

use crate::access::Permit;
use crate::server_loop::ServerLoop;

/// Number of a worker; not used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct WorkerId(pub(super) u32);

/// One input of a worker.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum WorkerInput {
    /// A connection that names a scene of this worker; its control bytes follow from the first on.
    Opened(Peer, Arc<Permit>),
    Control(Peer, Bytes),
    ControlTaken(Peer, usize),
    Datagram(Peer, Bytes),
    Link(Peer, LinkReport),
    Ended(Peer, Ending),
    /// The worker is to restore a scene from the data directory.
    Restore(SceneName),
    /// Input of an adapter waits: nothing of the front's.
    Wake,
    /// The front needs the worker no longer.
    End,
}

/// The output of one turn of a worker.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct WorkerOutput {
    pub(super) transmits: Vec<Transmit>,
    /// Control bytes of each connection that were handled.
    pub(super) handled: Vec<(Peer, usize)>,
    /// Inputs taken so far.
    pub(super) inputs: u64,
    /// Scenes of the worker.
    pub(super) scenes: usize,
}

/// A message of a worker's thread.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum FromWorker {
    Output(WorkerOutput),
    /// The thread has ended, by a panic or not; its last message.
    Over,
}

impl WorkerInput {
    /// Feeds the input to the server loop of a worker.
    pub(super) fn apply(self, now: Instant, to: &mut ServerLoop) {
        match self {
            Self::Opened(peer, permit) => {
                to.handle_opened(now, peer);
                to.set_permit(peer, permit);
            }
            Self::Control(peer, bytes) => to.handle_control(now, peer, &bytes),
            Self::ControlTaken(peer, bytes) => to.handle_control_taken(now, peer, bytes),
            Self::Datagram(peer, bytes) => to.handle_datagram(now, peer, &bytes),
            Self::Link(peer, report) => to.handle_link(now, peer, &report),
            Self::Ended(peer, ending) => to.handle_ended(now, peer, ending),
            Self::Restore(scene) => to.restore(&scene),
            Self::Wake | Self::End => {}
        }
    }
}
