//! A connection to a server before it joins a scene.
//!
//! Joining takes up to three answers: welcome, creation, snapshot. Each must arrive within the connection's timeout.

use std::thread;
use std::time::Duration;

use rhumb_link::ClientTransport;
#[cfg(feature = "quic")]
use rhumb_link::random_bytes;
use rhumb_protocol::Ending;
#[cfg(feature = "quic")]
use rhumb_protocol::message::SessionKey;
use rhumb_protocol::message::{Denial, Token};
use rhumb_protocol::scene::{IdRange, SceneName};
use rhumb_protocol::session::{ClientSession, CloseCode, Event};
#[cfg(feature = "local")]
use rhumb_view::JoinMode;
use rhumb_view::{JoinError, Joining};

use crate::client::Client;
use crate::connection::{ATTEMPT, BoxedConnection, FOLLOWED_MAX, PAUSE_FIRST, Pump, Redial, span};
#[cfg(feature = "local")]
use crate::error::FeedError;
use crate::error::{ClientError, OpenError};
#[cfg(feature = "local")]
use crate::feeding::Feeding;
use crate::join_options::JoinOptions;

/// Default time limit for an answer of the server.
pub(crate) const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);

/// A connection to a server that has joined no scene yet.
pub struct ServerConnection {
    connection: BoxedConnection,
    redial: Option<Redial>,
    timeout: Duration,
    token: Option<String>,
    /// Of the client that will feed its scene.
    #[cfg(feature = "local")]
    feeding: Option<Feeding>,
}

impl ServerConnection {
    /// A connection that another program carries, such as one to a server in the same process. A client that loses it
    /// does not reconnect.
    #[must_use]
    pub fn over(connection: impl ClientTransport + 'static) -> Self {
        Self {
            connection: Box::new(connection),
            redial: None,
            timeout: ANSWER_TIMEOUT,
            token: None,
            #[cfg(feature = "local")]
            feeding: None,
        }
    }

    /// A connection whose server `redial` reaches again.
    #[cfg(any(test, feature = "quic"))]
    pub(crate) fn with_redial(connection: BoxedConnection, redial: Redial) -> Self {
        Self {
            connection,
            redial: Some(redial),
            timeout: ANSWER_TIMEOUT,
            token: None,
            #[cfg(feature = "local")]
            feeding: None,
        }
    }

    /// With the owner's end of the scene that its client will make and feed.
    #[cfg(feature = "local")]
    pub(crate) fn feeding(self, feeding: Feeding) -> Self {
        let feeding = Some(feeding);
        Self { feeding, ..self }
    }

    /// Sets the time limit for each answer of the server; without this, five seconds.
    #[must_use]
    pub fn timeout(self, timeout: Duration) -> Self {
        Self { timeout, ..self }
    }

    /// Shows this token, which `rhumb-server token` made, when it joins. Only a server started with `--open` needs none.
    #[must_use]
    pub fn token(mut self, token: &str) -> Self {
        self.token = Some(token.to_owned());
        self
    }

    /// Checks what the caller gives to [`Self::join_with`]: the name of the scene, and the token. An error of the join
    /// itself comes after the connection is used up.
    ///
    /// # Errors
    ///
    /// [`OpenError::SceneName`] or [`OpenError::Token`].
    pub fn check_join(&self, scene: &str) -> Result<(), OpenError> {
        self.check_name(&scene_name(scene)?)?;
        self.parsed_token().map(drop)
    }

    /// Checks the scene that is joined: of a connection for feeding, it is the fed one.
    #[cfg(feature = "local")]
    fn check_name(&self, name: &SceneName) -> Result<(), OpenError> {
        let fed = self.feeding.as_ref();
        fed.map_or(Ok(()), |fed| fed.check_join(name).map_err(OpenError::Feed))
    }

    /// Any scene may be joined.
    #[cfg(not(feature = "local"))]
    const fn check_name(&self, _name: &SceneName) -> Result<(), OpenError> {
        Ok(())
    }

    /// Joins a scene of this name with [`JoinOptions::default`], which creates the scene unless it exists.
    ///
    /// # Errors
    ///
    /// As [`Self::join_with`].
    pub fn join(self, scene: &str) -> Result<Client, OpenError> {
        self.join_with(scene, JoinOptions::default())
    }

    /// Joins a scene of this name, and returns when the client's copy of the scene is complete.
    ///
    /// # Errors
    ///
    /// [`OpenError`] for an invalid scene name, token, delay or lead, a request that the server denies, and an answer that
    /// does not arrive in time.
    pub fn join_with(self, scene: &str, options: JoinOptions) -> Result<Client, OpenError> {
        self.check_join(scene)?;
        let name = scene_name(scene)?;
        options.check().map_err(OpenError::Ticks)?;
        let timeout = self.timeout;
        let denied = |denial| OpenError::Denied {
            scene: name.clone(),
            denial,
        };
        let token = self.parsed_token()?;
        let fresh = || {
            let mut session = ClientSession::new(name.clone());
            if let Some(token) = token.clone() {
                session.set_token(token);
            }
            session
        };
        let session = fresh();
        #[cfg(feature = "quic")]
        let key = self.session_key(&options)?;
        // A link within one process does not break, so that no session outlives it.
        #[cfg(not(feature = "quic"))]
        let key = None;
        // A scene that is there already is fed by no one.
        #[cfg(feature = "local")]
        let mode = match (&self.feeding, options.mode) {
            (Some(_), JoinMode::CreateOrJoin(config)) => JoinMode::Create(config),
            (Some(_), JoinMode::Join) => return Err(OpenError::Feed(FeedError::Joins)),
            (_, mode) => mode,
        };
        #[cfg(not(feature = "local"))]
        let mode = options.mode;
        let mut pump = Pump::new(session, self.connection, self.redial);
        let begun = pump.now();
        let mut followed = 0;
        let mut pause = PAUSE_FIRST;
        let granted = loop {
            let joining = Joining::new(mode, options.stream, key);
            let mut joining = match options.cells {
                true => joining.by_cells(),
                false => joining,
            };
            match await_scene(&mut pump, timeout, &mut joining) {
                Err(ClientError::Ended(ending))
                    if is_elsewhere(ending) && followed < FOLLOWED_MAX =>
                {
                    followed += 1;
                    if pump.follow(fresh(), timeout.min(ATTEMPT)) {
                        continue;
                    }
                    // It may just have ended: one of the others has the scene before long.
                    thread::sleep(pause);
                    pause *= 2;
                    let is_over = pump.now() >= begun + span(timeout);
                    if is_over || !pump.ask_again(fresh(), timeout) {
                        return Err(ClientError::Ended(ending).into());
                    }
                }
                granted => break granted?.map_err(denied)?,
            }
        };
        let client = Client::joined(pump, timeout, &options, granted);
        #[cfg(feature = "local")]
        let client = client.feeding(self.feeding);
        Ok(client)
    }

    /// The key of a session that may continue over another connection; `None` for one that ends with this one.
    #[cfg(feature = "quic")]
    fn session_key(&self, options: &JoinOptions) -> Result<Option<SessionKey>, OpenError> {
        if self.redial.is_none() || options.resume_within == Some(Duration::ZERO) {
            return Ok(None);
        }
        let key = random_bytes().map_err(OpenError::Random)?;
        Ok(Some(SessionKey(key)))
    }

    fn parsed_token(&self) -> Result<Option<Token>, OpenError> {
        let token = self.token.as_ref().map(|token| token.parse::<Token>());
        token.transpose().map_err(OpenError::Token)
    }
}

/// True if a server has closed because another one has the scene.
fn is_elsewhere(ending: Ending) -> bool {
    ending == Ending::Closed(CloseCode::SCENE_ELSEWHERE.0)
}

/// Waits until the session has joined; each answer has the whole time limit. The inner error is the server's.
fn await_scene(
    pump: &mut Pump,
    timeout: Duration,
    joining: &mut Joining,
) -> Result<Result<IdRange, Denial>, ClientError> {
    let mut awaited = joining.awaited();
    let mut deadline = pump.now() + span(timeout);
    loop {
        pump.turn(deadline);
        while let Some(event) = pump.session.poll_event() {
            if let Event::Ended(ending) = event {
                return Err(ClientError::Ended(ending));
            }
            match joining.handle(&mut pump.session, &event) {
                Ok(None) => {}
                Ok(Some(granted)) => return Ok(Ok(granted)),
                Err(JoinError::Denied(denial)) => return Ok(Err(denial)),
                Err(JoinError::Misuse(misuse)) => return Err(misuse.into()),
            }
        }
        if awaited != joining.awaited() {
            awaited = joining.awaited();
            deadline = pump.now() + span(timeout);
        }
        if pump.now() >= deadline {
            return Err(ClientError::Timeout { awaited, timeout });
        }
    }
}

fn scene_name(scene: &str) -> Result<SceneName, OpenError> {
    scene.parse().map_err(|cause| OpenError::SceneName {
        scene: scene.to_owned(),
        cause,
    })
}
