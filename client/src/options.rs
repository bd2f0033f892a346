//! Where to connect, what to trust, which scene, and how closely to follow it.

use std::time::Duration;

use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{SceneConfig, SceneName};
use rhumb_reckoning::Tolerance;
use rhumb_transport::Trust;

/// How to come into the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JoinMode {
    /// It must not exist yet.
    Create(SceneConfig),
    /// It must exist.
    Join,
    /// Whichever.
    CreateOrJoin(SceneConfig),
}

/// What a client is opened with.
#[derive(Clone, Debug)]
pub struct Options {
    /// Host and port of the server.
    pub server: String,
    /// How to know it.
    pub trust: Trust,
    /// Which of its scenes.
    pub scene: SceneName,
    /// How to come in.
    pub join_mode: JoinMode,
    /// What to follow.
    pub stream: StreamChoice,
    /// How long a call may wait for an answer of the server; `Client::open` for each of several.
    pub patience: Duration,
    /// Free running only: how many ticks the view stays behind what the stream can speak of, which is the server's clock less
    /// the scene's lookahead. Zero lets prediction carry all of the channel.
    pub delay_ticks: f64,
    /// Free running only: how many ticks ahead of the server's clock bodies that this client drives are said to be. Zero
    /// lets the server predict over the channel there; as much as the channel takes, and a little more, lets it know. It can be
    /// changed by `Client::set_lead_ticks`.
    pub lead_ticks: f64,
    /// Free running only: whether only whole ticks are shown, as a simulator with ticks of its own may want.
    pub whole_ticks: bool,
    /// Free running only: whether corrections are shown as short glides.
    pub smooth: bool,
}

impl Options {
    /// The 5 cm tier, five seconds of patience, no delay, smooth.
    #[must_use]
    pub fn new(
        server: impl Into<String>,
        trust: Trust,
        scene: SceneName,
        join_mode: JoinMode,
    ) -> Self {
        Self {
            server: server.into(),
            trust,
            scene,
            join_mode,
            stream: StreamChoice::Within(Tolerance::NORMAL),
            patience: Duration::from_secs(5),
            delay_ticks: 0.0,
            lead_ticks: 0.0,
            whole_ticks: false,
            smooth: true,
        }
    }
}
