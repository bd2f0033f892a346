//! Factor of one body on the tolerance of its streams.
//!
//! A power of two that is sent once, with the body's description. `tolerance` applies it.

/// Power of two by which the tolerance of a body differs from that of its stream.
///
/// A body in focus (an avatar) deserves a finer copy, a body that lies about (debris) a coarser one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ToleranceScale {
    exponent: i8,
}

impl ToleranceScale {
    /// Half of the stream's tolerance.
    pub const AVATAR: Self = Self { exponent: -1 };
    /// The stream's own tolerance.
    pub const USUAL: Self = Self { exponent: 0 };
    /// Twice the stream's tolerance.
    pub const DEBRIS: Self = Self { exponent: 1 };
    /// An eighth of the stream's tolerance.
    pub const FINEST: Self = Self { exponent: -3 };
    /// Eight times the stream's tolerance.
    pub const COARSEST: Self = Self { exponent: 3 };

    /// The scale two to the power of `exponent`; `None` outside [`Self::FINEST`] to [`Self::COARSEST`].
    #[must_use]
    pub const fn new(exponent: i8) -> Option<Self> {
        if exponent < Self::FINEST.exponent || exponent > Self::COARSEST.exponent {
            return None;
        }
        Some(Self { exponent })
    }

    /// The power of two.
    #[must_use]
    pub const fn exponent(self) -> i8 {
        self.exponent
    }

    /// Scales a whole number of millionths, rounds down, and clamps to the bounds (RECKONING 4.1).
    pub(crate) fn scale(self, millionths: u32, least: u32, most: u32) -> u32 {
        let wide = u64::from(millionths);
        let scaled = if self.exponent < 0 {
            wide >> self.exponent.unsigned_abs()
        } else {
            wide << self.exponent.unsigned_abs()
        };
        scaled.clamp(u64::from(least), u64::from(most)) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_are_the_powers_of_two_from_an_eighth_to_eight() {
        for exponent in i8::MIN..=i8::MAX {
            let tolerance_scale = ToleranceScale::new(exponent);
            assert_eq!(tolerance_scale.is_some(), (-3..=3).contains(&exponent));
            assert!(
                tolerance_scale
                    .is_none_or(|tolerance_scale| tolerance_scale.exponent() == exponent)
            );
        }
        assert_eq!(ToleranceScale::default(), ToleranceScale::USUAL);
    }

    #[test]
    fn scaling_rounds_down_and_clamps() {
        assert_eq!(
            ToleranceScale::AVATAR.scale(50_001, 1_000, 10_000_000),
            25_000
        );
        assert_eq!(
            ToleranceScale::DEBRIS.scale(50_001, 1_000, 10_000_000),
            100_002
        );
        assert_eq!(
            ToleranceScale::AVATAR.scale(1_500, 1_000, 10_000_000),
            1_000
        );
        assert_eq!(
            ToleranceScale::COARSEST.scale(u32::MAX, 1_000, 10_000_000),
            10_000_000
        );
    }
}
