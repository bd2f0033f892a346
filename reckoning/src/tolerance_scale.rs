//! How much closer or looser than its stream a body is followed.
//!
//! A power of two on whatever tolerance a stream has, told once with the body. What is done with it is `tolerance`'s matter.

/// By which power of two a body's tolerance differs from that of any stream that it is in.
///
/// What people look at (an avatar) is worth a finer copy, what lies about (debris) a coarser one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ToleranceScale {
    exponent: i8,
}

impl ToleranceScale {
    /// Half of the stream's tolerance.
    pub const AVATAR: Self = Self { exponent: -1 };
    /// The stream's own.
    pub const USUAL: Self = Self { exponent: 0 };
    /// Twice the stream's.
    pub const DEBRIS: Self = Self { exponent: 1 };
    /// An eighth of the stream's.
    pub const FINEST: Self = Self { exponent: -3 };
    /// Eight times the stream's.
    pub const COARSEST: Self = Self { exponent: 3 };

    /// The tolerance_scale that scales by two to this power; `None` outside [`Self::FINEST`] to [`Self::COARSEST`].
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

    /// A whole number of millionths scaled, rounded down, and kept within bounds (RECKONING 4.1).
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
    fn classes_are_the_powers_of_two_from_an_eighth_to_eight() {
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
