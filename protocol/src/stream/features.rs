//! What a publisher may use: all, unless a measurement switches it off.

/// Switches of a publisher's choices. They change what is said, never how it is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Features {
    /// What lies still while it is awake is predicted to go on lying.
    pub resting: bool,
    /// Bodies that fall are predicted to fall.
    pub ballistic: bool,
    /// Bodies of unequal moments are predicted to tumble.
    pub torque_free: bool,
    /// Bodies may be attached by others.
    pub attached: bool,
    /// Velocities are left to be implied where that serves.
    pub derived: bool,
    /// Corrections leave out what the tolerance does not need.
    pub sparse: bool,
    /// Velocities are said in coarser steps than the finest where that serves.
    pub coarse: bool,
    /// Bodies that something accelerations steadily are predicted to be accelerated on.
    pub accelerated: bool,
    /// What lookahead knows decides which corrections are said.
    pub mode_decision: bool,
    /// Motions are said as corrections of what was predicted.
    pub residuals: bool,
    /// What is still within tolerance is not spoken of.
    pub prefilter: bool,
    /// A packet says more than one body. Without it a tick may take more packets than are remembered: to be measured without loss.
    pub packing: bool,
    /// What is lost can be had back from repair_symbols.
    pub redundancy: bool,
}

impl Features {
    /// Everything.
    pub const ALL: Self = Self {
        resting: true,
        ballistic: true,
        torque_free: true,
        attached: true,
        derived: true,
        sparse: true,
        coarse: true,
        accelerated: true,
        mode_decision: true,
        residuals: true,
        prefilter: true,
        packing: true,
        redundancy: true,
    };

    /// How often steps of velocities may be doubled, of what could be tried.
    pub(super) fn steps<const N: usize>(&self, doubled: [u32; N]) -> impl Iterator<Item = u32> {
        let coarse = self.coarse;
        doubled
            .into_iter()
            .filter(move |times| coarse || *times == 0)
    }
}

impl Default for Features {
    fn default() -> Self {
        Self::ALL
    }
}
