//! Moment of a scene that a view shows.

use rhumb_reckoning::Tick;

/// A moment of the scene between two ticks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderTime {
    /// The tick at or before the moment.
    pub tick: Tick,
    /// Fraction of the step to the next tick, in [0, 1).
    pub fraction: f64,
}

impl RenderTime {
    /// The moment of a tick.
    #[must_use]
    pub const fn at(tick: Tick) -> Self {
        Self {
            tick,
            fraction: 0.0,
        }
    }

    pub(crate) fn from_ticks(ticks: f64) -> Self {
        let whole = ticks.max(0.0).floor();
        Self {
            tick: Tick::new(whole as u64),
            fraction: ticks.max(0.0) - whole,
        }
    }

    /// The moment in ticks since tick zero.
    #[must_use]
    pub fn ticks(&self) -> f64 {
        self.tick.value() as f64 + self.fraction
    }
}
