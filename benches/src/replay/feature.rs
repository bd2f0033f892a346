//! The means of a publisher that can be switched off, by name.

use clap::ValueEnum;
use rhumb_protocol::stream::Features;

/// A means of the publisher, as it is named on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Feature {
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
    /// Predicting that what is pushed steadily goes on being pushed.
    Pushed,
    /// Choosing corrections by what hindsight knows.
    Foresight,
    /// Saying motions as corrections.
    Residuals,
    /// Not speaking of what is within tolerance.
    Gate,
    /// Saying parities of what is lost, and by themselves where much is.
    Redundancy,
}

impl Feature {
    /// Every one, in the order of the list.
    pub const ALL: [Self; 10] = [
        Self::Ballistic,
        Self::Tumbling,
        Self::Held,
        Self::Derived,
        Self::Sparse,
        Self::Pushed,
        Self::Foresight,
        Self::Residuals,
        Self::Gate,
        Self::Redundancy,
    ];

    /// As on the command line and in the summary.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ballistic => "ballistic",
            Self::Tumbling => "tumbling",
            Self::Held => "held",
            Self::Derived => "derived",
            Self::Sparse => "sparse",
            Self::Pushed => "pushed",
            Self::Foresight => "foresight",
            Self::Residuals => "residuals",
            Self::Gate => "gate",
            Self::Redundancy => "redundancy",
        }
    }

    /// All but these.
    #[must_use]
    pub fn all_but(without: &[Self]) -> Features {
        let mut features = Features::ALL;
        for feature in without {
            *feature.switch(&mut features) = false;
        }
        features
    }

    /// Those that are switched off.
    pub fn without(features: &Features) -> impl Iterator<Item = Self> {
        let mut features = *features;
        Self::ALL
            .into_iter()
            .filter(move |feature| !*feature.switch(&mut features))
    }

    const fn switch(self, features: &mut Features) -> &mut bool {
        match self {
            Self::Ballistic => &mut features.ballistic,
            Self::Tumbling => &mut features.tumbling,
            Self::Held => &mut features.held,
            Self::Derived => &mut features.derived,
            Self::Sparse => &mut features.sparse,
            Self::Pushed => &mut features.pushed,
            Self::Foresight => &mut features.foresight,
            Self::Residuals => &mut features.residuals,
            Self::Gate => &mut features.gate,
            Self::Redundancy => &mut features.redundancy,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_switched_off_is_named_so() {
        assert_eq!(Feature::all_but(&[]), Features::ALL);
        for feature in Feature::ALL {
            let features = Feature::all_but(&[feature]);
            assert!(Feature::without(&features).eq([feature]));
            let value = feature.to_possible_value().expect("none is hidden");
            assert_eq!(value.get_name(), feature.name());
        }
        assert_eq!(Feature::value_variants(), Feature::ALL);
    }
}
