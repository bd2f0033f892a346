//! Moments of host time, as numbers that a test can make up.
//!
//! Nobody here reads a clock: the moment is an argument of every call that needs one.

use core::fmt;
use core::ops::Add;

/// A moment of one host's monotonic clock, in nanoseconds since a zero of its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Instant {
    ns: u64,
}

/// A length of host time in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Span {
    ns: u64,
}

impl Instant {
    /// The zero of the clock.
    pub const ZERO: Self = Self { ns: 0 };

    /// The moment so many nanoseconds after zero.
    #[must_use]
    pub const fn from_nanos(ns: u64) -> Self {
        Self { ns }
    }

    /// Nanoseconds since zero.
    #[must_use]
    pub const fn as_nanos(self) -> u64 {
        self.ns
    }

    /// The time since `earlier`, or none at all if that is in fact later.
    #[must_use]
    pub const fn since(self, earlier: Self) -> Span {
        Span {
            ns: self.ns.saturating_sub(earlier.ns),
        }
    }
}

impl Add<Span> for Instant {
    type Output = Self;

    fn add(self, span: Span) -> Self {
        Self {
            ns: self.ns.saturating_add(span.ns),
        }
    }
}

impl Span {
    /// No time.
    pub const ZERO: Self = Self { ns: 0 };

    /// So many nanoseconds.
    #[must_use]
    pub const fn from_nanos(ns: u64) -> Self {
        Self { ns }
    }

    /// So many milliseconds.
    #[must_use]
    pub const fn from_millis(ms: u64) -> Self {
        Self { ns: ms * 1_000_000 }
    }

    /// Nanoseconds.
    #[must_use]
    pub const fn as_nanos(self) -> u64 {
        self.ns
    }
}

impl fmt::Display for Span {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.3} ms", self.ns as f64 / 1e6)
    }
}
