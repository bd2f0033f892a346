//! Errors of a client that feeds its scene, or would.

use std::fmt;

use rhumb_protocol::scene::SceneName;
use rhumb_reckoning::{BodyId, Tick};

/// Reason why states are not taken. Nothing was handed over.
#[derive(Clone, Debug, PartialEq)]
pub enum FeedError {
    /// The client does not own a fed scene.
    NotOwner,
    /// The server runs elsewhere, or by a driver of its own.
    NoServer,
    /// Another client feeds a scene of this name.
    Taken(SceneName),
    /// The connection is one for feeding another scene.
    OtherScene(SceneName),
    /// The client that feeds a scene would join one that is there.
    Joins,
    /// The scene steps by what its owner feeds.
    StepsByFeed,
    /// The states are of a tick that was fed already, or before it.
    TickNotLater {
        /// Theirs.
        tick: Tick,
        /// The newest one that was fed.
        newest: Tick,
    },
    /// The states are of a tick too long after the newest one.
    TicksApart {
        /// Theirs.
        tick: Tick,
        /// The newest one that was fed.
        newest: Tick,
        /// The most ticks from one to the next.
        most: u64,
    },
    /// The scene has no such body.
    UnknownBody {
        /// The place among the states.
        place: usize,
        /// The body.
        body: BodyId,
    },
    /// A body has two states.
    Twice(BodyId),
    /// A number beyond its limit.
    OutOfRange(OutOfRange),
    /// The request was accepted or refused before.
    Answered,
}

/// A number of a fed state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum FedQuantity {
    /// A coordinate, m.
    Position,
    /// A component of a linear velocity, m/s.
    Linear,
    /// A component of an angular velocity, rad/s.
    Angular,
}

/// A number of a fed state beyond its limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutOfRange {
    /// The place among the states, and the body.
    pub state: (usize, BodyId),
    /// The quantity.
    pub quantity: FedQuantity,
    /// Its value.
    pub value: f32,
    /// The greatest one that is allowed, of either sign.
    pub most: f32,
}

impl fmt::Display for FeedError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotOwner => f.write_str(
                "this client does not feed its scene: join over the connection that `feed` of a server in this process returns",
            ),
            Self::NoServer => f.write_str(
                "the server takes no fed scenes: only one in this process without a driver of its own does",
            ),
            Self::Taken(name) => write!(f, "another client feeds the scene {name}"),
            Self::OtherScene(name) => {
                write!(f, "the connection is for feeding the scene {name}: join that one")
            }
            Self::Joins => f.write_str(
                "the client that feeds a scene makes it, and a scene that is there has an engine already: join with the condition to create it",
            ),
            Self::Answered => f.write_str("the request has an answer already: answer each once"),
            Self::StepsByFeed => f.write_str(
                "the scene steps by what this client feeds: feed the states of the next tick instead of advancing",
            ),
            Self::TickNotLater { tick, newest } => write!(
                f,
                "the states are of {tick}, and those of {newest} were fed before: each tick must be later than the one before"
            ),
            Self::TicksApart { tick, newest, most } => write!(
                f,
                "the states are of {tick}, and the newest fed ones of {newest}: the next may be {most} ticks later at most, so feed more often, or count from 1"
            ),
            Self::UnknownBody { place, body } => write!(
                f,
                "state {place} is of {body}, which is not in the scene: add it first, and feed no body that was removed"
            ),
            Self::Twice(body) => write!(f, "{body} has two states: feed each body once a tick"),
            Self::OutOfRange(wrong) => wrong.fmt(f),
        }
    }
}

impl fmt::Display for OutOfRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (place, body) = self.state;
        let Self { value, most, .. } = self;
        let (name, unit, advice) = match self.quantity {
            FedQuantity::Position => ("position", "m", "remove the body that left the world"),
            FedQuantity::Linear => (
                "linear velocity",
                "m/s",
                "leave velocities out if the engine's are of no use",
            ),
            FedQuantity::Angular => (
                "angular velocity",
                "rad/s",
                "leave velocities out if the engine's are of no use",
            ),
        };
        write!(
            f,
            "state {place}, of {body}, has a {name} of {value} {unit} along an axis, and {most} {unit} is the most: {advice}"
        )
    }
}

impl std::error::Error for FeedError {}
