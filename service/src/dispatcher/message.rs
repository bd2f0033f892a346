//! Messages between dispatcher and workers, and questions of other threads.
//!
//! Plain data: numbers, names and bytes, and nothing of the engine or of a session.
//!
//! A question goes through the dispatcher to the worker of the scene, behind all that the worker has been given before,
//! and the worker answers it. The caller of a question that is dropped gets an error.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

use bytes::Bytes;
use rhumb_protocol::scene::SceneName;
use rhumb_protocol::{Ending, Endpoint, Instant, LinkReport, Peer, Span, Transmit};
use rhumb_scene::{Checkpoint, CheckpointError, Permit, SceneLoop};
use rhumb_transport::Waker;

use crate::directory::ServerPlace;
use crate::durable::{Generation, LogTail};
use crate::flight::FlightCause;
use crate::metrics::SceneValues;

/// Number of a worker; not used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct WorkerId(pub(super) u32);

/// Number of a worker process; not used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct ProcessId(pub(super) u32);

/// The part of a worker in a move from server to server.
pub(super) enum Duty {
    /// None.
    Serve,
    /// It follows the scene of another server, and has no connections.
    StandBy,
    /// It gives its scene up to this server, by the input of this number.
    Leave(ServerPlace, u64),
}

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
    /// The worker is to restore its scene from the data directory, if it is there. With a directory of scenes, from these
    /// files alone.
    Restore(LogTail, Option<Generation>),
    /// The worker is to have its scene as another server's log has it, from now on, until it is to restore it.
    Follow,
    /// The worker is to give its scene up to the server at a place.
    Move(ServerPlace),
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
    /// True if it follows a scene and is hardly behind.
    pub(super) is_ready: bool,
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
            Self::Move(place) => to.move_to(now, &place.0),
            Self::Restore(..) | Self::Follow | Self::End => {}
        }
    }
}

/// Longest wait for an answer: the thread of a scene that hangs has none, and is given up long before.
const ANSWER_TIME: Duration = Duration::from_secs(60);

/// Saves and restores the scenes of a server that runs in this process. All clones ask the same server.
#[derive(Clone, Debug)]
pub struct Checkpoints {
    questions: Sender<Question>,
    waker: Waker,
}

/// A question to a scene's worker, with the way back of the answer. A caller that waits no longer needs none.
#[derive(Debug)]
pub(crate) enum Question {
    Save(SceneName, Sender<Result<Checkpoint, CheckpointError>>),
    Restore(
        SceneName,
        Box<Checkpoint>,
        Sender<Result<(), CheckpointError>>,
    ),
}

impl Checkpoints {
    /// With the questions of it and its clones.
    pub(crate) fn new(waker: Waker) -> (Self, Receiver<Question>) {
        let (questions, asked) = channel();
        (Self { questions, waker }, asked)
    }

    /// The state of a scene, with everything that its worker has been given so far.
    ///
    /// # Errors
    ///
    /// [`CheckpointError`] for a name that no scene has, for a scene that cannot be saved, and for a server that has ended or
    /// whose scenes run in worker processes, and for a scene that does not answer for a minute.
    pub fn save(&self, scene: &str) -> Result<Checkpoint, CheckpointError> {
        self.ask(scene, Question::Save)
    }

    /// Makes a scene that continues from a checkpoint, to be joined by its name.
    ///
    /// # Errors
    ///
    /// [`CheckpointError`] for a name that a scene has, for a server whose limits or configuration do not take it, that has a
    /// data directory (it would not have the scene), that has ended, or whose scenes run in worker processes.
    pub fn restore(&self, scene: &str, checkpoint: &Checkpoint) -> Result<(), CheckpointError> {
        let checkpoint = Box::new(checkpoint.clone());
        self.ask(scene, |name, answer| {
            Question::Restore(name, checkpoint, answer)
        })
    }

    fn ask<T>(
        &self,
        scene: &str,
        question: impl FnOnce(SceneName, Sender<Result<T, CheckpointError>>) -> Question,
    ) -> Result<T, CheckpointError> {
        let name: SceneName = scene.parse().map_err(|cause| CheckpointError::SceneName {
            scene: scene.to_owned(),
            cause,
        })?;
        let (sender, answer) = channel();
        let sent = self.questions.send(question(name.clone(), sender));
        sent.map_err(|_| CheckpointError::NoServer)?;
        self.waker.wake();
        answer
            .recv_timeout(ANSWER_TIME)
            .unwrap_or_else(|error| match error {
                RecvTimeoutError::Timeout => Err(CheckpointError::NoAnswer(name)),
                RecvTimeoutError::Disconnected => Err(CheckpointError::NoServer),
            })
    }
}

impl Question {
    pub(super) const fn scene(&self) -> &SceneName {
        match self {
            Self::Save(name, _) | Self::Restore(name, ..) => name,
        }
    }

    pub(super) fn refuse(self, error: CheckpointError) {
        let _ = match self {
            Self::Save(_, answer) => answer.send(Err(error)).is_ok(),
            Self::Restore(_, _, answer) => answer.send(Err(error)).is_ok(),
        };
    }

    /// Answers by the scene of a worker.
    pub(super) fn answer(self, now: Instant, scene: &mut SceneLoop) {
        let _ = match self {
            Self::Save(_, answer) => answer.send(scene.save()).is_ok(),
            Self::Restore(_, checkpoint, answer) => {
                answer.send(scene.restore(now, &checkpoint)).is_ok()
            }
        };
    }
}
