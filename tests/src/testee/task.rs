//! What a client under test is ordered to do, by its environment.
//!
//! A word that means nothing here is *unsupported*: that is how the suite sees whether a client can say so.

use std::env;
use std::net::SocketAddr;

use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::SceneName;
use rhumb_protocol::stream::Budget;
use rhumb_reckoning::{LengthBound, Tolerance};
use rhumb_transport::Fingerprint;

/// What it is to do once it is welcomed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TesteeTask {
    /// To follow the scene within so many micrometres.
    Subscribe {
        /// The surface tolerance.
        within: u32,
    },
    /// To follow its full stream.
    Full,
    /// To follow it within as many bytes as a budget has.
    Capped {
        /// The surface tolerance.
        within: u32,
        /// Bytes a second.
        rate: u32,
    },
    /// To follow it, and ask for each next tick once it has the one before.
    Advance {
        /// The surface tolerance.
        within: u32,
        /// The last tick that it asks for.
        ticks: u64,
    },
    /// To follow it, and as soon as it is a member another stream of it.
    Change {
        /// The surface tolerance at first.
        within: u32,
        /// The one afterwards.
        to: u32,
    },
    /// To follow its full stream, and drive a body of its own along a course.
    TakeAuthority {
        /// The surface tolerance of what it drives.
        within: u32,
    },
}

/// All that it is told.
#[derive(Clone, Debug)]
pub struct TesteeOrders {
    /// Where the server is.
    pub server: SocketAddr,
    /// What to pin.
    pub fingerprint: Fingerprint,
    /// What the connection is about.
    pub scene: SceneName,
    /// What to do.
    pub task: TesteeTask,
}

/// Bytes at once of a stream within a budget.
const BURST: u32 = 4_000;

impl TesteeTask {
    /// What words mean, if they mean something.
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

    /// The stream that it joins.
    ///
    /// # Panics
    ///
    /// Never: what is read is in range.
    #[must_use]
    pub fn choice(self) -> StreamChoice {
        let surface = |micrometres| {
            let length = LengthBound::from_micrometres(micrometres).expect("it is in range");
            Tolerance::Surface(length)
        };
        match self {
            Self::Full | Self::TakeAuthority { .. } => StreamChoice::Full,
            Self::Capped { within, rate } => StreamChoice::Capped {
                tolerance: surface(within),
                budget: Budget::new(rate, BURST).expect("the suite asks for what may be"),
            },
            Self::Subscribe { within }
            | Self::Advance { within, .. }
            | Self::Change { within, .. } => StreamChoice::Within(surface(within)),
        }
    }
}

impl TesteeOrders {
    /// What the environment says; `Err(None)` when it wishes what is not known here.
    ///
    /// # Errors
    ///
    /// What is missing, or is none of what it should be.
    pub fn from_environment() -> Result<Self, Option<String>> {
        let sent = |name: &str| env::var(name).map_err(|_| Some(format!("no {name}")));
        let wrong = |name: &'static str| move |_| Some(format!("{name} is none"));
        let task = sent("RHUMB_TASK")?;
        Ok(Self {
            server: sent("RHUMB_ADDR")?
                .parse()
                .map_err(|_| Some("RHUMB_ADDR is none".to_owned()))?,
            fingerprint: sent("RHUMB_FINGERPRINT")?
                .parse()
                .map_err(|_| Some("RHUMB_FINGERPRINT is none".to_owned()))?,
            scene: sent("RHUMB_SCENE")?.parse().map_err(wrong("RHUMB_SCENE"))?,
            task: TesteeTask::read(&task).ok_or(None)?,
        })
    }
}
