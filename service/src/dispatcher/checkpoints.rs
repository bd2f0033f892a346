//! Questions of other threads to a server that runs: for checkpoints.
//!
//! A question goes through the dispatcher to the worker of the scene, behind all that the worker has been given before, and the
//! worker answers it. The caller of a question that is dropped gets an error.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

use rhumb_protocol::Instant;
use rhumb_protocol::scene::SceneName;
use rhumb_scene::{Checkpoint, CheckpointError, SceneLoop};
use rhumb_transport::Waker;

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
