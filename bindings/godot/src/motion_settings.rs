//! When bodies fall asleep and how they touch edges, as properties of nodes.

use godot::prelude::*;
use rhumb_client::scene::{Edges, Sleep, SleepThresholds};

/// Condition under which a body falls asleep.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, GodotConvert, Var, Export)]
#[godot(via = i64)]
pub(crate) enum NodeSleep {
    /// Of a body: as the scene has it. Of a new scene: as `Settled`.
    #[default]
    Default,
    /// It is slow, and neither gravity nor a motor still moves it.
    Settled,
    /// It is slower than `sleep_speed` and `sleep_angular_speed` for `sleep_seconds`, whatever moves it.
    Below,
    /// It never falls asleep by itself, and neither does what it touches.
    Never,
}

impl NodeSleep {
    /// The rule with the thresholds of the other properties; `None` for the default.
    pub(crate) const fn rule(self, thresholds: SleepThresholds) -> Option<Sleep> {
        match self {
            Self::Default => None,
            Self::Settled => Some(Sleep::Settled),
            Self::Below => Some(Sleep::Below(thresholds)),
            Self::Never => Some(Sleep::Never),
        }
    }

    /// The property for a rule, and its thresholds if it has some.
    pub(crate) const fn of(rule: Option<Sleep>) -> (Self, Option<SleepThresholds>) {
        match rule {
            None => (Self::Default, None),
            Some(Sleep::Settled) => (Self::Settled, None),
            Some(Sleep::Below(thresholds)) => (Self::Below, Some(thresholds)),
            Some(Sleep::Never) => (Self::Never, None),
        }
    }
}

/// How bodies touch the edges that two triangles of a concave polygon or a height map share.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, GodotConvert, Var, Export)]
#[godot(via = i64)]
pub(crate) enum NodeEdges {
    /// Each triangle is touched as if it were alone: a body that slides over flat ground may catch on an edge.
    Plain,
    /// A body slides and rolls over flat ground as over one face. Heights are then touched from above only.
    #[default]
    Smooth,
}

impl NodeEdges {
    pub(crate) const fn edges(self) -> Edges {
        match self {
            Self::Plain => Edges::Plain,
            Self::Smooth => Edges::Smooth,
        }
    }

    pub(crate) const fn of(edges: Edges) -> Self {
        match edges {
            Edges::Plain => Self::Plain,
            Edges::Smooth => Self::Smooth,
        }
    }
}
