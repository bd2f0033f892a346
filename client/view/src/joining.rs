//! The way of a session into a scene, and over another connection.
//!
//! A function of the session's events: their arrival and the time limits are the caller's.

use std::time::Duration;

use rhumb_protocol::Ending;
use rhumb_protocol::message::{Denial, SessionKey, StreamChoice};
use rhumb_protocol::scene::{IdRange, SceneConfig};
use rhumb_protocol::session::{ClientSession, CloseCode, Event, Misuse, TransportCode};

/// The condition under which a client joins: the scene is new, exists already, or either.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JoinMode {
    /// Creates the scene, which must not exist yet.
    Create(SceneConfig),
    /// Joins the scene, which must exist.
    Join,
    /// Creates the scene unless it exists; an existing scene keeps its config.
    CreateOrJoin(SceneConfig),
}

impl Default for JoinMode {
    fn default() -> Self {
        Self::CreateOrJoin(SceneConfig::default())
    }
}

/// A session that is about to join its scene.
#[derive(Debug)]
pub struct Joining {
    mode: JoinMode,
    stream: StreamChoice,
    key: Option<SessionKey>,
    by_cells: bool,
    step: Step,
}

/// The answer that the server owes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Welcome,
    Creation,
    Scene,
}

/// Reason why a session does not join.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JoinError {
    /// The server denied it.
    Denied(Denial),
    /// The config or the stream is not one that the session may ask for.
    Misuse(Misuse),
}

impl From<Misuse> for JoinError {
    fn from(misuse: Misuse) -> Self {
        Self::Misuse(misuse)
    }
}

impl Joining {
    /// Before the welcome. `key`: that of a session that may continue over another connection; `None`: it may not.
    #[must_use]
    pub const fn new(mode: JoinMode, stream: StreamChoice, key: Option<SessionKey>) -> Self {
        Self {
            mode,
            stream,
            key,
            by_cells: false,
            step: Step::Welcome,
        }
    }

    /// Takes the scene by cells, if its server divides it.
    #[must_use]
    pub const fn by_cells(self) -> Self {
        Self {
            by_cells: true,
            ..self
        }
    }

    /// The answer that the server owes now, in words.
    #[must_use]
    pub const fn awaited(&self) -> &'static str {
        match self.step {
            Step::Welcome => "welcome",
            Step::Creation => "answer",
            Step::Scene => "scene",
        }
    }

    /// Takes the next step if the event allows it. Returns the body indices that the application may assign, once it
    /// has joined.
    ///
    /// # Errors
    ///
    /// [`JoinError`] when it will not join.
    pub fn handle(
        &mut self,
        session: &mut ClientSession,
        event: &Event,
    ) -> Result<Option<IdRange>, JoinError> {
        match (self.step, event) {
            (Step::Welcome, Event::Welcomed(welcome)) => {
                let create = match self.mode {
                    JoinMode::Create(config) => Some(config),
                    JoinMode::CreateOrJoin(config) if welcome.scene.is_none() => Some(config),
                    JoinMode::CreateOrJoin(_) | JoinMode::Join => None,
                };
                match create {
                    Some(config) => {
                        session.create(config)?;
                        self.step = Step::Creation;
                    }
                    None => self.join(session)?,
                }
            }
            (Step::Creation, Event::Created) => self.join(session)?,
            // Another client has created it since the welcome.
            (Step::Creation, Event::Denied(Denial::SceneExists))
                if matches!(self.mode, JoinMode::CreateOrJoin(_)) =>
            {
                self.join(session)?;
            }
            (Step::Creation | Step::Scene, Event::Denied(denial)) => {
                return Err(JoinError::Denied(*denial));
            }
            (Step::Scene, Event::Joined(granted)) => return Ok(Some(*granted)),
            _ => {}
        }
        Ok(None)
    }

    fn join(&mut self, session: &mut ClientSession) -> Result<(), Misuse> {
        if let Some(key) = self.key.take() {
            session.begin_session(key)?;
        }
        if self.by_cells {
            session.join_cells()?;
        }
        session.join(self.stream)?;
        self.step = Step::Scene;
        Ok(())
    }
}

/// Time for which a client of a durable scene tries to resume by default. A machine starts again within a minute, its
/// server in seconds, and a client notices within ten; the server keeps the session for five minutes.
pub const RESUME_WITHIN: Duration = Duration::from_secs(60);

/// True if another connection may continue after this end of one: the server has not refused the client.
#[must_use]
pub const fn may_resume(ending: Ending) -> bool {
    match ending {
        Ending::Closed(code) => {
            code == TransportCode::GOING_AWAY.0
                || code == CloseCode::BUSY.0
                // The application slept while a connection was opened for it.
                || code == CloseCode::HELLO_LATE.0
                || code == CloseCode::SCENE_RESTORING.0
                || code == CloseCode::SCENE_ELSEWHERE.0
        }
        Ending::TimedOut | Ending::Broken => true,
    }
}
