//! Messages between the dispatcher and a worker, or a process of several.
//!
//! Plain data: numbers, names and bytes, and nothing of the engine or of a session.

use std::sync::Arc;

use bytes::Bytes;
use rhumb_protocol::scene::SceneName;
use rhumb_protocol::{Ending, Endpoint, Instant, LinkReport, Peer, Span, Transmit};
use rhumb_scene::{Permit, SceneLoop};

use crate::durable::LogTail;
use crate::flight::FlightCause;
use crate::metrics::SceneValues;

/// Number of a worker; not used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct WorkerId(pub(super) u32);

/// Number of a worker process; not used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct ProcessId(pub(super) u32);

/// One input of a worker.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum WorkerInput {
    /// A connection that names the scene of this worker; its control bytes follow from the first on.
    Opened(Peer, Arc<Permit>),
    Control(Peer, Bytes),
    ControlTaken(Peer, usize),
    Datagram(Peer, Bytes),
    Link(Peer, LinkReport),
    Ended(Peer, Ending),
    /// The worker is to restore its scene from the data directory, if it is there.
    Restore(LogTail),
    /// The worker polls its scene again; the message itself says nothing.
    Wake,
    /// The dispatcher needs the worker no longer.
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
    /// True if its scene exists, damaged or not.
    pub(super) has_scene: bool,
}

/// A message of a worker's thread.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum FromWorker {
    Output(WorkerOutput),
    /// The thread has ended, by a panic or not; its last message.
    Over,
}

/// A message to a worker process.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum ToProcess {
    /// A worker of the process begins, for this scene.
    Begin(WorkerId, SceneName),
    Input(WorkerId, WorkerInput),
    /// The rest of the server's part of the things that all scenes share.
    Elsewhere {
        scenes: u64,
        load: u64,
    },
}

/// A message of a worker process.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum FromProcess {
    Worker(WorkerId, FromWorker),
    /// A sign of life, four times a second.
    Alive(Vitals),
    /// The metrics of all scenes of the process.
    Metrics(Vec<(SceneName, SceneValues)>),
    /// New entries of a scene's flight recorder.
    Flight(SceneName, Bytes),
    /// A scene has its flight recorder written.
    WriteFlight(SceneName, FlightCause),
}

/// State of a worker process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Vitals {
    /// The worker that has been at one piece of work for the longest time.
    pub(super) busiest: Option<(WorkerId, Span)>,
    /// Scenes of the process, and the load that they have reserved.
    pub(super) scenes: u64,
    pub(super) load: u64,
}

/// A message that reaches the dispatcher.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum WorkerReport {
    Worker(WorkerId, FromWorker),
    Process(ProcessId, FromProcess),
    /// A worker process has ended, and this is how: its last message.
    ProcessOver(ProcessId, String),
}

impl WorkerInput {
    /// Feeds the input to the scene of a worker, which restores it by itself.
    pub(super) fn apply(self, now: Instant, to: &mut SceneLoop) {
        match self {
            Self::Opened(peer, permit) => {
                to.handle_opened(now, peer);
                to.admit(peer, permit);
            }
            Self::Control(peer, bytes) => to.handle_control(now, peer, &bytes),
            Self::ControlTaken(peer, bytes) => to.handle_control_taken(now, peer, bytes),
            Self::Datagram(peer, bytes) => to.handle_datagram(now, peer, &bytes),
            Self::Link(peer, report) => to.handle_link(now, peer, &report),
            Self::Ended(peer, ending) => to.handle_ended(now, peer, ending),
            Self::Wake => to.handle_wake(now),
            Self::Restore(..) | Self::End => {}
        }
    }
}
