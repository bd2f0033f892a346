//! A probability, as a count of millionths.
//!
//! Not a float: it parses, prints and decides alike on every platform.

use std::fmt;

/// A share of packets, in [0, 1], in millionths.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Probability {
    millionths: u32,
}

impl Probability {
    /// No packet.
    pub const NONE: Self = Self { millionths: 0 };
    /// Every packet.
    pub const ALL: Self = Self { millionths: WHOLE };

    /// A share in millionths; more than a million counts as all.
    #[must_use]
    pub const fn from_millionths(millionths: u32) -> Self {
        let millionths = if millionths > WHOLE {
            WHOLE
        } else {
            millionths
        };
        Self { millionths }
    }

    /// A share in percent; more than a hundred counts as all.
    #[must_use]
    pub const fn from_percent(percent: u32) -> Self {
        Self::from_millionths(percent.saturating_mul(WHOLE / 100))
    }

    /// Millionths.
    #[must_use]
    pub const fn as_millionths(self) -> u32 {
        self.millionths
    }

    /// One minus this share.
    #[must_use]
    pub const fn rest(self) -> Self {
        Self {
            millionths: WHOLE - self.millionths,
        }
    }
}

/// Millionths in one.
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
