//! The features of a publisher: all are on, except in measurements.

/// Switches of a publisher's choices. They change what it sends, never how a packet is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Features {
    /// Predicts rest for a body that is awake and still.
    pub resting: bool,
    /// Predicts ballistic motion for falling bodies.
    pub ballistic: bool,
    /// Predicts torque-free rotation for bodies with unequal moments of inertia.
    pub torque_free: bool,
    /// Attaches bodies to others.
    pub attached: bool,
    /// Omits velocities that follow from two poses, where that is cheaper.
    pub derived: bool,
    /// Omits the parts of a correction that the tolerance does not need.
    pub sparse: bool,
    /// Encodes velocities in coarser steps, where that is cheaper.
    pub coarse: bool,
    /// Predicts constant acceleration.
    pub accelerated: bool,
    /// Chooses corrections by mode decision, with the observations of the lookahead.
    pub mode_decision: bool,
    /// Encodes motions as corrections of the prediction.
    pub residuals: bool,
    /// Skips bodies that the prefilter finds within tolerance.
    pub prefilter: bool,
    /// Packs several bodies into a packet. Off, a tick may take more packets than are kept for refreshes; measure that
    /// without loss.
    pub packing: bool,
    /// Sends repair symbols to recover lost packets.
    pub redundancy: bool,
    /// Sends repair symbols without a request where packets are lost.
    pub unsolicited: bool,
    /// Splits large ticks in two packets where packets are lost.
    pub halves: bool,
    /// Encodes exact rest poses as corrections of the prediction.
    pub rest_corrections: bool,
    /// Gives short aliases to the bodies that are updated often. Off, the alias of a body is its index.
    pub aliases: bool,
    /// Sends checksums over all tracks.
    pub checksums: bool,
}

impl Features {
    /// All features.
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
        unsolicited: true,
        halves: true,
        rest_corrections: true,
        aliases: true,
        checksums: true,
    };

    /// The exponents of velocity steps to try: `doubled`, or only the finest.
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
