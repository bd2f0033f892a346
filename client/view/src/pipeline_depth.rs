//! How far a lockstep client lets its server run ahead.

/// How many ticks that are spoken of a lockstep client lets the server compute beyond the one it looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PipelineDepth(u32);

impl PipelineDepth {
    /// Waits for each tick.
    pub const LOCKSTEP: Self = Self(0);
    /// Looks at the tick before, while the server computes the next.
    pub const PIPELINED: Self = Self(1);

    /// Looks so many ticks back; [`Self::LOCKSTEP`] is 0, [`Self::PIPELINED`] is 1.
    #[must_use]
    pub const fn new(ticks: u32) -> Self {
        Self(ticks)
    }

    /// The number of published ticks.
    #[must_use]
    pub const fn ticks(self) -> u32 {
        self.0
    }
}
