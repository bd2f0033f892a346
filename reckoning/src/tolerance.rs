//! How far off a copy may be.
//!
//! One length per stream (a tier). How it becomes grids is decided in `lattice`.

use core::fmt;

use crate::units::Metres;

/// The promise of a stream: a length of at least 1 mm and at most 10 m, in whole micrometres.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Tolerance {
    micrometres: u32,
}

impl Tolerance {
    /// 5 mm.
    pub const EXACT: Self = Self { micrometres: 5_000 };
    /// 2 cm.
    pub const FINE: Self = Self {
        micrometres: 20_000,
    };
    /// 5 cm.
    pub const NORMAL: Self = Self {
        micrometres: 50_000,
    };
    /// 20 cm.
    pub const COARSE: Self = Self {
        micrometres: 200_000,
    };

    /// The smallest: below it, f32 engines disagree with themselves at a kilometre from the origin.
    pub const LEAST: Self = Self { micrometres: 1_000 };
    /// The largest.
    pub const MOST: Self = Self {
        micrometres: 10_000_000,
    };

    /// A tolerance of so many micrometres.
    ///
    /// # Errors
    ///
    /// [`InvalidTolerance`] outside [`Self::LEAST`] to [`Self::MOST`].
    pub const fn from_micrometres(micrometres: u32) -> Result<Self, InvalidTolerance> {
        if micrometres < Self::LEAST.micrometres || micrometres > Self::MOST.micrometres {
            return Err(InvalidTolerance);
        }
        Ok(Self { micrometres })
    }

    /// The tolerance nearest to a length.
    ///
    /// # Errors
    ///
    /// [`InvalidTolerance`] for what is not a number or outside [`Self::LEAST`] to [`Self::MOST`].
    pub fn from_metres(length: Metres) -> Result<Self, InvalidTolerance> {
        let micrometres = libm::round(length.metres() * 1e6);
        if !(0.0..=f64::from(u32::MAX)).contains(&micrometres) {
            return Err(InvalidTolerance);
        }
        Self::from_micrometres(micrometres as u32)
    }

    /// As it is said on the wire.
    #[must_use]
    pub const fn micrometres(self) -> u32 {
        self.micrometres
    }

    /// As a length: micrometres divided by a million (RECKONING 4.1).
    #[must_use]
    pub fn metres(self) -> Metres {
        Metres::new(f64::from(self.micrometres) / 1e6)
    }
}

/// A tolerance that no stream offers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InvalidTolerance;

impl fmt::Display for InvalidTolerance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("tolerance is outside 0.001 m to 10 m")
    }
}

impl core::error::Error for InvalidTolerance {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tolerance_is_whole_micrometres_within_bounds() {
        assert_eq!(
            Tolerance::from_metres(Metres::new(0.05)),
            Ok(Tolerance::NORMAL)
        );
        for wrong in [0.0, -1.0, f64::NAN, f64::INFINITY, 11.0, 0.0004] {
            assert_eq!(
                Tolerance::from_metres(Metres::new(wrong)),
                Err(InvalidTolerance)
            );
        }
    }
}
