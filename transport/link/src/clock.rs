//! The monotonic clock.
//!
//! It has the protocol's units, no wall time and no ticks. It never goes backwards; all copies of one clock agree.

use std::time::{Duration, Instant as HostInstant};

use rhumb_protocol::{Instant, Span};

/// A monotonic clock whose zero is its own creation.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    zero: HostInstant,
}

impl Clock {
    /// Starts a clock at zero.
    #[must_use]
    pub fn start() -> Self {
        Self {
            zero: HostInstant::now(),
        }
    }

    /// The present moment.
    #[must_use]
    pub fn now(&self) -> Instant {
        let ns = self.zero.elapsed().as_nanos();
        Instant::from_nanos(u64::try_from(ns).unwrap_or(u64::MAX))
    }

    /// The time until `moment`; zero if it has passed.
    #[must_use]
    pub fn until(&self, moment: Instant) -> Duration {
        duration(moment.since(self.now()))
    }
}

impl Default for Clock {
    fn default() -> Self {
        Self::start()
    }
}

/// A span as the standard library's type.
fn duration(span: Span) -> Duration {
    Duration::from_nanos(span.as_nanos())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_never_goes_backwards_and_its_copies_agree() {
        let clock = Clock::start();
        let copy = clock;
        let mut last = clock.now();
        for _ in 0..1_000 {
            let next = copy.now();
            assert!(next >= last);
            last = clock.now();
            assert!(last >= next);
        }
    }

    #[test]
    fn the_time_until_a_past_moment_is_zero() {
        let clock = Clock::start();
        assert_eq!(clock.until(Instant::ZERO), Duration::ZERO);
        let far = Instant::from_nanos(u64::MAX);
        assert!(clock.until(far) > Duration::from_secs(1));
    }
}
