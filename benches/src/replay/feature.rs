//! The means of a replay that can be switched off, by name.

use clap::ValueEnum;
use rhumb_protocol::stream::Features;

/// What a replay may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EnabledFeatures {
    /// What its publisher may.
    pub publisher: Features,
    /// Whether packets take what they do; else it is counted what they would take in plain codes.
    pub coder: bool,
}

impl EnabledFeatures {
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
    /// Predicting that what is_torque_free goes on torque_free.
    TorqueFree,
    /// Letting bodies be attached by others.
    Attached,
    /// Leaving velocities to be implied.
    Derived,
    /// Leaving out of corrections what the tolerance does not need.
    Sparse,
    /// UpdatePayload velocities in coarser steps than the finest.
    Coarse,
    /// Predicting that what is accelerated steadily goes on being accelerated.
    ConstantAcceleration,
    /// StreamSelection corrections by what lookahead knows.
    ModeDecision,
    /// UpdatePayload motions as corrections.
    Residuals,
    /// Not speaking of what is within tolerance.
    Prefilter,
    /// UpdatePayload more than one body in a packet.
    Packing,
    /// Coding numbers by what is likely; without it, what they would take in plain codes is counted, nothing else changes.
    Coder,
    /// UpdatePayload repair_symbols of what is lost, and by themselves where much is.
    Fec,
}

impl Feature {
    /// Every one, in the order of the list.
    pub const ALL: [Self; 14] = [
        Self::Resting,
        Self::Ballistic,
        Self::TorqueFree,
        Self::Attached,
        Self::Derived,
        Self::Sparse,
        Self::Coarse,
        Self::ConstantAcceleration,
        Self::ModeDecision,
        Self::Residuals,
        Self::Prefilter,
        Self::Packing,
        Self::Coder,
        Self::Fec,
    ];

    /// As on the command line and in the summary.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Resting => "resting",
            Self::Ballistic => "ballistic",
            Self::TorqueFree => "torque-free",
            Self::Attached => "attached",
            Self::Derived => "derived",
            Self::Sparse => "sparse",
            Self::Coarse => "coarse",
            Self::ConstantAcceleration => "constant-acceleration",
            Self::ModeDecision => "mode-decision",
            Self::Residuals => "residuals",
            Self::Prefilter => "prefilter",
            Self::Packing => "packing",
            Self::Coder => "coder",
            Self::Fec => "fec",
        }
    }

    /// All but these.
    #[must_use]
    pub fn all_but(without: &[Self]) -> EnabledFeatures {
        let mut features = EnabledFeatures::ALL;
        for feature in without {
            *feature.switch(&mut features) = false;
        }
        features
    }

    /// Those that are switched off.
    pub fn without(features: &EnabledFeatures) -> impl Iterator<Item = Self> {
        let mut features = *features;
        Self::ALL
            .into_iter()
            .filter(move |feature| !*feature.switch(&mut features))
    }

    const fn switch(self, features: &mut EnabledFeatures) -> &mut bool {
        let publisher = &mut features.publisher;
        match self {
            Self::Resting => &mut publisher.resting,
            Self::Ballistic => &mut publisher.ballistic,
            Self::TorqueFree => &mut publisher.torque_free,
            Self::Attached => &mut publisher.attached,
            Self::Derived => &mut publisher.derived,
            Self::Sparse => &mut publisher.sparse,
            Self::Coarse => &mut publisher.coarse,
            Self::ConstantAcceleration => &mut publisher.accelerated,
            Self::ModeDecision => &mut publisher.mode_decision,
            Self::Residuals => &mut publisher.residuals,
            Self::Prefilter => &mut publisher.prefilter,
            Self::Packing => &mut publisher.packing,
            Self::Coder => &mut features.coder,
            Self::Fec => &mut publisher.redundancy,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_disabled_feature_is_listed_by_name() {
        assert_eq!(Feature::all_but(&[]), EnabledFeatures::ALL);
        for feature in Feature::ALL {
            let features = Feature::all_but(&[feature]);
            assert!(Feature::without(&features).eq([feature]));
            let value = feature.to_possible_value().expect("none is hidden");
            assert_eq!(value.get_name(), feature.name());
        }
        assert_eq!(Feature::value_variants(), Feature::ALL);
    }
}
