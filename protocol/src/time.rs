//! Moments of wall-clock time, as plain numbers.
//!
//! No clock is read here: the moment is an argument of every call that needs it.

use core::fmt;
use core::ops::Add;

/// A moment of one machine's monotonic clock, in nanoseconds since the clock's own zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Instant {
    ns: u64,
}

/// A span of wall-clock time in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Span {
    ns: u64,
}

impl Instant {
    /// The zero of the clock.
    pub const ZERO: Self = Self { ns: 0 };

    /// The moment `ns` nanoseconds after zero.
    #[must_use]
    pub const fn from_nanos(ns: u64) -> Self {
        Self { ns }
    }

    /// Nanoseconds since zero.
    #[must_use]
    pub const fn as_nanos(self) -> u64 {
        self.ns
    }

    /// The time since `earlier`, or zero if that is later.
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

    /// A span of nanoseconds.
    #[must_use]
    pub const fn from_nanos(ns: u64) -> Self {
        Self { ns }
    }

    /// A span of milliseconds.
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
        let micros = self.ns / 1_000;
        write!(f, "{}.{:03} ms", micros / 1_000, micros % 1_000)
    }
}
