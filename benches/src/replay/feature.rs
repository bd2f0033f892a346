//! The means of a replay that can be switched off, by name.

use clap::ValueEnum;
use rhumb_protocol::stream::Features;

/// What a replay may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Means {
    /// What its publisher may.
    pub publisher: Features,
    /// Whether packets take what they do; else it is counted what they would take in plain codes.
    pub coder: bool,
}

impl Means {
    /// Everything.
    pub const ALL: Self = Self::of(Features::ALL);

    /// What this publisher may use, and the coder.
    #[must_use]
    pub const fn of(publisher: Features) -> Self {
        Self {
            publisher,
            coder: true,
        }
    }
}

/// A means, as it is named on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Feature {
    /// Predicting that what lies still while it is awake goes on lying.
    Resting,
    /// Predicting that what falls goes on falling.
    Ballistic,
    /// Predicting that what tumbles goes on tumbling.
    Tumbling,
    /// Letting bodies be held by others.
    Held,
    /// Leaving velocities to be implied.
    Derived,
    /// Leaving out of corrections what the tolerance does not need.
    Sparse,
    /// Saying velocities in coarser steps than the finest.
    Coarse,
    /// Predicting that what is pushed steadily goes on being pushed.
    Pushed,
    /// Choosing corrections by what hindsight knows.
    Foresight,
    /// Saying motions as corrections.
    Residuals,
    /// Not speaking of what is within tolerance.
    Gate,
    /// Saying more than one body in a packet.
    Packing,
    /// Coding numbers by what is likely; without it, what they would take in plain codes is counted, nothing else changes.
    Coder,
    /// Saying parities of what is lost, and by themselves where much is.
    Redundancy,
}

impl Feature {
    /// Every one, in the order of the list.
    pub const ALL: [Self; 14] = [
        Self::Resting,
        Self::Ballistic,
        Self::Tumbling,
        Self::Held,
        Self::Derived,
        Self::Sparse,
        Self::Coarse,
        Self::Pushed,
        Self::Foresight,
        Self::Residuals,
        Self::Gate,
        Self::Packing,
        Self::Coder,
        Self::Redundancy,
    ];

    /// As on the command line and in the summary.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Resting => "resting",
            Self::Ballistic => "ballistic",
            Self::Tumbling => "tumbling",
            Self::Held => "held",
            Self::Derived => "derived",
            Self::Sparse => "sparse",
            Self::Coarse => "coarse",
            Self::Pushed => "pushed",
            Self::Foresight => "foresight",
            Self::Residuals => "residuals",
            Self::Gate => "gate",
            Self::Packing => "packing",
            Self::Coder => "coder",
            Self::Redundancy => "redundancy",
        }
    }

    /// All but these.
    #[must_use]
    pub fn all_but(without: &[Self]) -> Means {
        let mut means = Means::ALL;
        for feature in without {
            *feature.switch(&mut means) = false;
        }
        means
    }

    /// Those that are switched off.
    pub fn without(means: &Means) -> impl Iterator<Item = Self> {
        let mut means = *means;
        Self::ALL
            .into_iter()
            .filter(move |feature| !*feature.switch(&mut means))
    }

    const fn switch(self, means: &mut Means) -> &mut bool {
        let publisher = &mut means.publisher;
        match self {
            Self::Resting => &mut publisher.resting,
            Self::Ballistic => &mut publisher.ballistic,
            Self::Tumbling => &mut publisher.tumbling,
            Self::Held => &mut publisher.held,
            Self::Derived => &mut publisher.derived,
            Self::Sparse => &mut publisher.sparse,
            Self::Coarse => &mut publisher.coarse,
            Self::Pushed => &mut publisher.pushed,
            Self::Foresight => &mut publisher.foresight,
            Self::Residuals => &mut publisher.residuals,
            Self::Gate => &mut publisher.gate,
            Self::Packing => &mut publisher.packing,
            Self::Coder => &mut means.coder,
            Self::Redundancy => &mut publisher.redundancy,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_switched_off_is_named_so() {
        assert_eq!(Feature::all_but(&[]), Means::ALL);
        for feature in Feature::ALL {
            let means = Feature::all_but(&[feature]);
            assert!(Feature::without(&means).eq([feature]));
            let value = feature.to_possible_value().expect("none is hidden");
            assert_eq!(value.get_name(), feature.name());
        }
        assert_eq!(Feature::value_variants(), Feature::ALL);
    }
}
