//! A probability, as a count of millionths.
//!
//! An integer, so that parsing, printing and decisions are equal on every platform.

use std::fmt;

/// A share of packets, in [0, 1], in millionths.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Probability {
    millionths: u32,
}

impl Probability {
    /// Zero: no packet.
    pub const NONE: Self = Self { millionths: 0 };
    /// One: every packet.
    pub const ALL: Self = Self { millionths: WHOLE };

    /// A share in millionths; greater values count as a million.
    #[must_use]
    pub const fn from_millionths(millionths: u32) -> Self {
        let millionths = if millionths > WHOLE {
            WHOLE
        } else {
            millionths
        };
        Self { millionths }
    }

    /// A share in percent; greater values count as a hundred.
    #[must_use]
    pub const fn from_percent(percent: u32) -> Self {
        Self::from_millionths(percent.saturating_mul(WHOLE / 100))
    }

    /// The share in millionths.
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
