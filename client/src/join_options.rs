//! Options for joining a scene: its creation, the stream, and the view.

use std::time::Duration;

use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::session::ClientSession;
use rhumb_reckoning::Tolerance;
use rhumb_view::{InvalidTicks, JoinMode, RESUME_WITHIN, ViewOptions};

/// Options for joining a scene.
///
/// The default creates the scene with the default config unless it exists, subscribes to the 5 cm tier, computes the
/// view without delay, and smooths corrections.
#[derive(Clone, Copy, Debug)]
pub struct JoinOptions {
    /// Create the scene, join an existing one, or accept both.
    pub mode: JoinMode,
    /// The stream to subscribe to.
    pub stream: StreamChoice,
    /// Take the scene by cells, if its server divides it: see [`Client::take_cells`](crate::Client::take_cells). The view then
    /// has the bodies of the cells that are taken, and those that are in none, such as floors. Default: the whole scene.
    pub cells: bool,
    /// Free running only: how many ticks the view stays behind the newest tick that the server can have published,
    /// which is its clock less the scene's lookahead. At zero, prediction covers all of the network's delay, and no bound is
    /// known. With half of the round trip and a tick or two, the news of each shown moment has arrived: the bounds are the
    /// tolerance, and what a glide has still to cover. The client keeps as many tracks of each body as the delay needs, 256
    /// at most. From 0 to 3,600.
    pub delay_ticks: f64,
    /// Free running only: how many ticks ahead of the server's clock this client publishes the bodies that it has
    /// authority over. At zero, the server predicts them over the network's delay; with that delay and a little more,
    /// it need not. From 0 to 3,600; `Client::set_lead_ticks` changes it.
    pub lead_ticks: f64,
    /// Free running only: whether only whole ticks are shown, for a simulator with ticks of its own.
    pub whole_ticks: bool,
    /// Free running only: whether corrections are shown as short glides, of 0.1 s.
    ///
    /// A body that a command places elsewhere is shown at one of its places, and never on a glide between them: a push
    /// brings a body to where the change of its velocity leads it within one tick, give or take three tolerances. What
    /// lies beyond that was placed. A shorter way, and one together with a change of velocity that explains it, looks
    /// like a push, and glides.
    pub smooth: bool,
    /// The server's refusals are errors of calls, or events alone.
    pub refusals: Refusals,
    /// Time for which the client tries to continue its session over another connection when one ends without its doing.
    /// Commands meanwhile are queued. At zero, the first connection is the only one, and there is no session.
    ///
    /// `None`: [`RESUME_WITHIN`] if the server keeps the scene over its own end, else zero, for a scene that is gone is
    /// not waited for.
    pub resume_within: Option<Duration>,
}

impl JoinOptions {
    /// Refuses a delay or a lead outside its limits.
    pub(crate) fn check(&self) -> Result<(), InvalidTicks> {
        InvalidTicks::check_delay(self.delay_ticks)?;
        InvalidTicks::check_lead(self.lead_ticks)
    }

    /// The options of the view.
    pub(crate) const fn view_options(&self) -> ViewOptions {
        ViewOptions {
            delay_ticks: self.delay_ticks,
            whole_ticks: self.whole_ticks,
            smooth: self.smooth,
        }
    }

    /// Time for attempts to resume.
    pub(crate) fn resumption_time(&self, session: &ClientSession) -> Duration {
        let default = match session.is_durable() {
            true => RESUME_WITHIN,
            false => Duration::ZERO,
        };
        self.resume_within.unwrap_or(default)
    }
}

impl Default for JoinOptions {
    fn default() -> Self {
        Self {
            mode: JoinMode::default(),
            stream: StreamChoice::Within(Tolerance::NORMAL),
            cells: false,
            delay_ticks: 0.0,
            lead_ticks: 0.0,
            whole_ticks: false,
            smooth: true,
            refusals: Refusals::Errors,
            resume_within: None,
        }
    }
}

/// The way in which a client reports the requests that the server refuses: commands, and requests for authority.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Refusals {
    /// The next call that computes the view returns [`ClientError::Refused`](crate::ClientError::Refused), after it has
    /// done its work. They are events as well.
    #[default]
    Errors,
    /// They are events alone, for an application that reads all events, and expects refusals such as those of two clients
    /// who remove one body.
    Events,
}
