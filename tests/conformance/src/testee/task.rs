//! The task of a client under test, from its environment.
//!
//! An unknown task is *unsupported*: this shows the suite whether a client can declare so.

use std::env;
use std::net::SocketAddr;

use rhumb_protocol::message::{StreamChoice, Token};
use rhumb_protocol::scene::SceneName;
use rhumb_protocol::stream::Budget;
use rhumb_reckoning::{LengthBound, Tolerance};
use rhumb_transport::Fingerprint;

/// The task after the welcome.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TesteeTask {
    /// Subscribe to the scene with a tolerance in micrometres.
    Subscribe {
        /// The surface tolerance.
        within: u32,
    },
    /// Subscribe to its full stream.
    Full,
    /// Subscribe with a byte budget.
    Capped {
        /// The surface tolerance.
        within: u32,
        /// Bytes per second.
        rate: u32,
    },
    /// Subscribe, and request each next tick when the one before is complete.
    Advance {
        /// The surface tolerance.
        within: u32,
        /// The last requested tick.
        ticks: u64,
    },
    /// Subscribe, and change to another stream after joining.
    Change {
        /// The first surface tolerance.
        within: u32,
        /// The second one.
        to: u32,
    },
    /// Subscribe to the full stream, and publish a body along a trajectory.
    TakeAuthority {
        /// The surface tolerance of the upstream.
        within: u32,
    },
}

/// The environment of a client under test.
#[derive(Clone, Debug)]
pub struct TesteeEnvironment {
    /// Address of the server.
    pub server: SocketAddr,
    /// Fingerprint to pin.
    pub fingerprint: Fingerprint,
    /// Name of the scene.
    pub scene: SceneName,
    /// The task.
    pub task: TesteeTask,
    /// The token to show, if the server asks for one.
    pub token: Option<Token>,
}

/// Burst size of a stream with a budget, in bytes.
const BURST: u32 = 4_000;

impl TesteeTask {
    /// Parses a task; `None` if it is unknown.
    #[must_use]
    pub fn read(text: &str) -> Option<Self> {
        let words: Vec<_> = text.split(' ').collect();
        let bound = |text: &str| {
            let micrometres = text.parse().ok()?;
            LengthBound::from_micrometres(micrometres).ok()?;
            Some(micrometres)
        };
        Some(match words[..] {
            ["subscribe", "full"] => Self::Full,
            ["upstream", within] => Self::TakeAuthority {
                within: bound(within)?,
            },
            ["subscribe", within] => Self::Subscribe {
                within: bound(within)?,
            },
            ["subscribe", within, "budget", rate] => Self::Capped {
                within: bound(within)?,
                rate: rate.parse().ok()?,
            },
            ["subscribe", within, "advance", ticks] => Self::Advance {
                within: bound(within)?,
                ticks: ticks.parse().ok()?,
            },
            ["subscribe", within, "change", to] => Self::Change {
                within: bound(within)?,
                to: bound(to)?,
            },
            _ => return None,
        })
    }

    /// The stream that the client joins first.
    ///
    /// # Panics
    ///
    /// Never: parsed numbers are in range.
    #[must_use]
    pub fn choice(self) -> StreamChoice {
        let surface = |micrometres| {
            let length = LengthBound::from_micrometres(micrometres).expect("a length in range");
            Tolerance::Surface(length)
        };
        match self {
            Self::Full | Self::TakeAuthority { .. } => StreamChoice::Full,
            Self::Capped { within, rate } => StreamChoice::Capped {
                tolerance: surface(within),
                budget: Budget::new(rate, BURST).expect("a valid budget"),
            },
            Self::Subscribe { within }
            | Self::Advance { within, .. }
            | Self::Change { within, .. } => StreamChoice::Within(surface(within)),
        }
    }
}

impl TesteeEnvironment {
    /// Reads the environment; `Err(None)` when the task is unknown.
    ///
    /// # Errors
    ///
    /// The variable that is missing or invalid.
    pub fn from_environment() -> Result<Self, Option<String>> {
        let sent = |name: &str| env::var(name).map_err(|_| Some(format!("{name} is missing")));
        let wrong = |name: &'static str| move |_| Some(format!("{name} is invalid"));
        let task = sent("RHUMB_TASK")?;
        Ok(Self {
            server: sent("RHUMB_ADDR")?
                .parse()
                .map_err(|_| Some("RHUMB_ADDR is invalid".to_owned()))?,
            fingerprint: sent("RHUMB_FINGERPRINT")?
                .parse()
                .map_err(|_| Some("RHUMB_FINGERPRINT is invalid".to_owned()))?,
            scene: sent("RHUMB_SCENE")?.parse().map_err(wrong("RHUMB_SCENE"))?,
            token: match env::var("RHUMB_TOKEN") {
                Ok(token) => Some(
                    token
                        .parse()
                        .map_err(|_| Some("RHUMB_TOKEN is invalid".to_owned()))?,
                ),
                Err(_) => None,
            },
            task: TesteeTask::read(&task).ok_or(None)?,
        })
    }
}
