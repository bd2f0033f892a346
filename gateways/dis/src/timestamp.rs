//! Timestamps of PDUs: time past the hour, absolute or relative.
//!
//! The unit is 3600 s / 2^31, or 1.676 µs. The lowest bit says whether the sender's clock is absolute. No clock is read
//! here.

use core::time::Duration;

/// Length of an hour, in nanoseconds.
const HOUR_NS: u128 = 3_600_000_000_000;
/// Units in an hour.
const UNITS: u128 = 1 << 31;

/// Whether a timestamp counts from the true hour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeBase {
    /// From a moment that only the sender knows.
    Relative,
    /// From the last full hour of UTC.
    Absolute,
}

/// A timestamp as it is on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Timestamp(pub u32);

impl Timestamp {
    /// The timestamp of a moment, rounded to the nearest unit. Only its part past the hour is kept.
    #[must_use]
    pub const fn at(moment: Duration, base: TimeBase) -> Self {
        let units = ((moment.as_nanos() % HOUR_NS) * UNITS + HOUR_NS / 2) / HOUR_NS % UNITS;
        Self(((units as u32) << 1) | matches!(base, TimeBase::Absolute) as u32)
    }

    /// The origin from which it counts.
    #[must_use]
    pub const fn base(self) -> TimeBase {
        match self.0 & 1 {
            0 => TimeBase::Relative,
            _ => TimeBase::Absolute,
        }
    }

    /// Time past the hour, rounded down to a nanosecond; below one hour.
    #[must_use]
    pub const fn past_hour(self) -> Duration {
        Duration::from_nanos(((self.0 >> 1) as u128 * HOUR_NS / UNITS) as u64)
    }

    /// Seconds from `earlier` to this one by the shorter way around the hour, in [−1800, 1800).
    #[must_use]
    pub const fn seconds_since(self, earlier: Self) -> f64 {
        // The lowest bits are no part of the time. The difference of 31-bit counts keeps its sign in 32 bits.
        let units = (self.0 & !1).wrapping_sub(earlier.0 & !1).cast_signed() >> 1;
        units as f64 * (3600.0 / UNITS as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moment_is_within_half_a_unit_of_its_timestamp() {
        for nanos in [
            0,
            1,
            837,
            838,
            1_800_000_000_000,
            3_599_999_998_000,
            5_000_000_000_123,
        ] {
            let moment = Duration::from_nanos(nanos);
            let back = Timestamp::at(moment, TimeBase::Absolute).past_hour();
            let error = back.as_nanos().abs_diff(moment.as_nanos() % HOUR_NS);
            assert!(error <= 839, "{nanos} ns is read as {back:?}");
        }
    }

    #[test]
    fn the_last_unit_of_an_hour_rounds_to_the_next_hour() {
        let end = Duration::from_nanos(3_599_999_999_999);
        assert_eq!(Timestamp::at(end, TimeBase::Relative), Timestamp(0));
        assert_eq!(Timestamp::at(end, TimeBase::Absolute), Timestamp(1));
    }

    #[test]
    fn differences_go_the_short_way_over_the_full_hour() {
        let at = |seconds| Timestamp::at(Duration::from_secs(seconds), TimeBase::Absolute);
        assert!((at(3601).seconds_since(at(3599)) - 2.0).abs() < 1e-5);
        assert!((at(3599).seconds_since(at(3601)) + 2.0).abs() < 1e-5);
        let relative = Timestamp::at(Duration::from_secs(2), TimeBase::Relative);
        assert!((at(3).seconds_since(relative) - 1.0).abs() < 1e-5);
    }
}
