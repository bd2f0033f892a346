//! The factor by which a stream may exceed its tolerances, in one byte.
//!
//! Only streams with a budget send it, and only while the budget delays updates (PROTOCOL 5.17).

use crate::wire::Malformed;
use crate::wire::bytes::{Reader, Writer};

/// A factor on every tolerance of a stream: 2ⁿ (8 + k) / 8 with k below 8, rounded up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ErrorScale(u8);

impl ErrorScale {
    /// Every body is within its tolerance.
    pub const NONE: Self = Self(0);
    /// The factor is unknown and may have any size.
    pub const UNBOUNDED: Self = Self(255);

    /// The least error scale that covers an error of `share` tolerances.
    #[must_use]
    pub fn covering(share: f64) -> Self {
        let covers = |code: &u8| Self(*code).factor().is_none_or(|factor| share <= factor);
        (0..=255).find(covers).map_or(Self::UNBOUNDED, Self)
    }

    /// The factor; `None` for [`Self::UNBOUNDED`].
    #[must_use]
    pub fn factor(self) -> Option<f64> {
        if self == Self::UNBOUNDED {
            return None;
        }
        let eighths = 8 + u32::from(self.0 % 8);
        Some(f64::from(eighths) * f64::from(1_u32 << (self.0 / 8)) / 8.0)
    }

    /// Appends the byte.
    pub(super) fn encode(self, to: &mut Writer) {
        to.u8(self.0);
    }

    /// Reads the byte; [`Self::NONE`] is refused.
    pub(super) fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        match from.u8()? {
            0 => Err(Malformed::NotCanonical),
            code => Ok(Self(code)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factors_rise_from_one_by_an_eighth_at_most() {
        let mut last = ErrorScale::NONE.factor().unwrap();
        assert_eq!(last.to_bits(), 1.0_f64.to_bits());
        for code in 1..255 {
            let factor = ErrorScale(code).factor().unwrap();
            assert!(factor > last && factor <= last * 1.125, "{code}");
            assert_eq!(ErrorScale::covering(factor), ErrorScale(code));
            assert_eq!(
                ErrorScale::covering(last + (factor - last) * 0.5),
                ErrorScale(code)
            );
            last = factor;
        }
        assert_eq!(ErrorScale::UNBOUNDED.factor(), None);
    }

    #[test]
    fn nan_has_no_error_scale() {
        for share in [f64::NAN, f64::INFINITY, 1e300] {
            assert_eq!(ErrorScale::covering(share), ErrorScale::UNBOUNDED);
        }
        assert_eq!(ErrorScale::covering(0.3), ErrorScale::NONE);
    }
}
