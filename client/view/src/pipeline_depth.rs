//! Number of ticks by which a lockstep client lets its server run ahead.

/// Number of published ticks that the server may compute beyond the tick that a lockstep client shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PipelineDepth(u32);

impl PipelineDepth {
    /// The client waits for each tick.
    pub const LOCKSTEP: Self = Self(0);
    /// The client shows a tick while the server computes the next.
    pub const PIPELINED: Self = Self(1);

    /// A depth in published ticks; [`Self::LOCKSTEP`] is 0, [`Self::PIPELINED`] is 1.
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
