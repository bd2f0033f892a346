//! Numbers of ticks by which nothing can be behind or ahead.

use core::fmt;

/// A number of ticks that is negative or not finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InvalidTicks {
    /// A view cannot be so far behind.
    Delay(f64),
    /// An upstream cannot be so far ahead.
    Lead(f64),
}

impl InvalidTicks {
    /// Checks the delay of a view.
    ///
    /// # Errors
    ///
    /// [`Self::Delay`].
    pub fn check_delay(ticks: f64) -> Result<(), Self> {
        is_valid(ticks).then_some(()).ok_or(Self::Delay(ticks))
    }

    /// Checks the lead of an upstream.
    ///
    /// # Errors
    ///
    /// [`Self::Lead`].
    pub fn check_lead(ticks: f64) -> Result<(), Self> {
        is_valid(ticks).then_some(()).ok_or(Self::Lead(ticks))
    }
}

/// The ticks, or none where they are invalid.
pub(crate) fn or_none(ticks: f64) -> f64 {
    if is_valid(ticks) { ticks } else { 0.0 }
}

fn is_valid(ticks: f64) -> bool {
    ticks.is_finite() && ticks >= 0.0
}

impl fmt::Display for InvalidTicks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (name, ticks) = match self {
            Self::Delay(ticks) => ("delay", ticks),
            Self::Lead(ticks) => ("lead", ticks),
        };
        write!(
            f,
            "the {name} in ticks is finite and not negative, not {ticks}"
        )
    }
}

impl std::error::Error for InvalidTicks {}
