//! Scalars with their unit, and ticks, the unit of simulated time.
//!
//! Arithmetic between units is not offered: callers take the number out, compute, and wrap the result. Ticks are the
//! exception. Invariant: point minus point is a span, point plus span is a point, and point plus point does not compile.
//! Wall-clock time does not appear here; only the server's step and the client's clock relate it to ticks.

use core::fmt;
use core::num::NonZeroU32;
use core::ops::{Add, Sub};

macro_rules! unit {
    ($(#[$doc:meta])* $name:ident, $read:ident, $suffix:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
        pub struct $name(f64);

        impl $name {
            #[doc = concat!("A quantity in ", stringify!($read), ".")]
            #[must_use]
            pub const fn new($read: f64) -> Self {
                Self($read)
            }

            #[doc = concat!("The number of ", stringify!($read), ".")]
            #[must_use]
            pub const fn $read(self) -> f64 {
                self.0
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!("{} ", $suffix), self.0)
            }
        }
    };
}

unit!(
    /// A length.
    Metres,
    metres,
    "m"
);
unit!(
    /// An angle.
    Radians,
    radians,
    "rad"
);
unit!(
    /// A span of simulated or displayed time.
    Seconds,
    seconds,
    "s"
);
unit!(
    /// A speed.
    MetresPerSecond,
    metres_per_second,
    "m/s"
);

/// A point in simulated time: the number of steps the scene has taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Tick(u64);

impl Tick {
    /// Before the first step.
    pub const ZERO: Self = Self(0);

    /// The point after `steps` steps.
    #[must_use]
    pub const fn new(steps: u64) -> Self {
        Self(steps)
    }

    /// Steps since the scene began.
    #[must_use]
    pub const fn value(self) -> u64 {
        self.0
    }

    /// The next point.
    #[must_use]
    pub const fn next(self) -> Self {
        Self(self.0 + 1)
    }

    /// The span since `earlier`, or `None` when `earlier` is in fact later or more than `u32::MAX` ticks back.
    #[must_use]
    pub fn since(self, earlier: Self) -> Option<Ticks> {
        let span = self.0.checked_sub(earlier.0)?;
        u32::try_from(span).ok().map(Ticks)
    }

    /// The point `span` before this one, or `None` before the scene began.
    #[must_use]
    pub fn before(self, span: Ticks) -> Option<Self> {
        self.0.checked_sub(u64::from(span.0)).map(Self)
    }
}

impl fmt::Display for Tick {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "tick {}", self.0)
    }
}

/// A span of simulated time in steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticks(u32);

impl Ticks {
    /// No time at all.
    pub const ZERO: Self = Self(0);

    /// A span of `count` steps.
    #[must_use]
    pub const fn new(count: u32) -> Self {
        Self(count)
    }

    /// The number of steps.
    #[must_use]
    pub const fn count(self) -> u32 {
        self.0
    }
}

impl Add<Ticks> for Tick {
    type Output = Tick;

    fn add(self, span: Ticks) -> Tick {
        Tick(self.0 + u64::from(span.0))
    }
}

impl Sub<Tick> for Tick {
    type Output = Ticks;

    /// # Panics
    ///
    /// If `earlier` is later. [`Tick::since`] does not panic.
    fn sub(self, earlier: Tick) -> Ticks {
        self.since(earlier)
            .expect("a span is taken from an earlier tick to a later one")
    }
}

/// Ticks per seconds of simulated time; the step is `seconds / ticks`.
///
/// A ratio, so that 11.33 Hz and 60 Hz are both exact on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Rate {
    ticks: NonZeroU32,
    seconds: NonZeroU32,
}

impl Rate {
    /// Sixty ticks a second.
    pub const HZ_60: Self = match Self::new(60, 1) {
        Some(rate) => rate,
        None => panic!("sixty and one are not zero"),
    };

    /// `ticks` steps in `seconds` seconds, or `None` when either is zero.
    #[must_use]
    pub const fn new(ticks: u32, seconds: u32) -> Option<Self> {
        match (NonZeroU32::new(ticks), NonZeroU32::new(seconds)) {
            (Some(ticks), Some(seconds)) => Some(Self { ticks, seconds }),
            _ => None,
        }
    }

    /// Numerator: ticks.
    #[must_use]
    pub const fn ticks(self) -> u32 {
        self.ticks.get()
    }

    /// Denominator: seconds.
    #[must_use]
    pub const fn seconds(self) -> u32 {
        self.seconds.get()
    }

    /// The length of one tick: `seconds / ticks`, one correctly rounded division (RECKONING 2.1).
    #[must_use]
    pub fn step(self) -> Seconds {
        Seconds::new(f64::from(self.seconds.get()) / f64::from(self.ticks.get()))
    }

    /// The length of one tick in nanoseconds, rounded down.
    #[must_use]
    pub fn step_ns(self) -> u64 {
        u64::from(self.seconds.get()) * 1_000_000_000 / u64::from(self.ticks.get())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_span_runs_from_the_earlier_to_the_later_point() {
        let (early, late) = (Tick::new(3), Tick::new(10));
        assert_eq!(late - early, Ticks::new(7));
        assert_eq!(early + Ticks::new(7), late);
        assert_eq!(early.since(late), None);
        assert_eq!(early.before(Ticks::new(4)), None);
    }

    #[test]
    fn a_rate_is_a_ratio() {
        assert_eq!(Rate::new(0, 1), None);
        assert_eq!(Rate::HZ_60.step_ns(), 16_666_666);
        let paper = Rate::new(1133, 100).unwrap();
        assert_eq!(paper.step().seconds(), 100.0 / 1133.0);
    }
}
