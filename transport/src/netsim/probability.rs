//! A part of a whole, as a count of millionths.
//!
//! Not a float, so that it reads, prints and decides alike everywhere.

use std::fmt;

/// A share of packets, in [0, 1], kept in millionths.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Probability {
    millionths: u32,
}

impl Probability {
    /// None of them.
    pub const NONE: Self = Self { millionths: 0 };
    /// All of them.
    pub const ALL: Self = Self { millionths: WHOLE };

    /// So many of a million; more than all are all.
    #[must_use]
    pub const fn from_millionths(millionths: u32) -> Self {
        let millionths = if millionths > WHOLE {
            WHOLE
        } else {
            millionths
        };
        Self { millionths }
    }

    /// So many of a hundred; more than all are all.
    #[must_use]
    pub const fn from_percent(percent: u32) -> Self {
        Self::from_millionths(percent.saturating_mul(WHOLE / 100))
    }

    /// Millionths.
    #[must_use]
    pub const fn as_millionths(self) -> u32 {
        self.millionths
    }

    /// What is left of the whole.
    #[must_use]
    pub const fn rest(self) -> Self {
        Self {
            millionths: WHOLE - self.millionths,
        }
    }
}

/// The millionths of a whole.
const WHOLE: u32 = 1_000_000;

impl fmt::Display for Probability {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (percent, rest) = (self.millionths / 10_000, self.millionths % 10_000);
        if rest == 0 {
            return write!(f, "{percent}%");
        }
        let digits = format!("{rest:04}");
        write!(f, "{percent}.{}%", digits.trim_end_matches('0'))
    }
}
