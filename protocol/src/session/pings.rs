//! When to look at the server's clock.
//!
//! Reads no clock itself. Two clocks unforced apart slowly, so that looking is rare; what the stream shows of the server's
//! time is held against what was seen, and only when that is off is the clock sampled at sooner.

use rhumb_reckoning::{Rate, Tick, Ticks};

use crate::time::{Instant, Span};

/// A new member looks a few times soon after one another, so that one odd answer does no harm.
const LOOKS_AT_FIRST: u32 = 5;
/// See [`LOOKS_AT_FIRST`].
const PAUSE_AT_FIRST: Span = Span::from_millis(50);
/// The pause between two looks while nothing seems off: clocks that differ by 100 millionths unforced 6 ms apart.
const PAUSE: Span = Span::from_millis(60_000);
/// The pause between two looks while the stream's time is not the one seen.
const PAUSE_WHILE_OFF: Span = Span::from_millis(1_000);
/// The stream's time may differ from the one seen by this: disorder, jitter, and a tick that is published when due.
const SLACK_SECONDS: f64 = 0.1;

/// The looks of one membership in a free-running scene.
#[derive(Clone, Debug)]
pub(crate) struct Pings {
    due: Option<Instant>,
    left: u32,
    asked: Instant,
    seen: Option<ClockSample>,
}

/// The server's clock, as it was seen last.
#[derive(Clone, Copy, Debug)]
struct ClockSample {
    at: Instant,
    ticks: f64,
    /// How long what it says is under one_way.
    one_way: Span,
}

impl Pings {
    /// Nothing to look at yet.
    pub(crate) const fn new() -> Self {
        Self {
            due: None,
            left: 0,
            asked: Instant::ZERO,
            seen: None,
        }
    }

    /// When the next look is due, if it is.
    pub(crate) const fn due(&self) -> Option<Instant> {
        self.due
    }

    /// A membership begins, with a look that is taken now.
    pub(crate) fn begin(&mut self, now: Instant) {
        self.left = LOOKS_AT_FIRST;
        self.seen = None;
        self.asked(now);
    }

    /// A membership is over.
    pub(crate) fn end(&mut self) {
        *self = Self::new();
    }

    /// A look was taken.
    pub(crate) fn asked(&mut self, now: Instant) {
        self.asked = now;
        self.left = self.left.saturating_sub(1);
        let pause = if self.left > 0 { PAUSE_AT_FIRST } else { PAUSE };
        self.due = Some(now + pause);
    }

    /// At `at`, the server's newest tick had been reached `since_tick` before.
    pub(crate) fn seen(
        &mut self,
        at: Instant,
        tick: Tick,
        since_tick: Span,
        round_trip: Span,
        rate: Rate,
    ) {
        let since = since_tick.as_nanos() as f64 / 1e9 / rate.step().seconds();
        self.seen = Some(ClockSample {
            at,
            ticks: tick.value() as f64 + since,
            one_way: Span::from_nanos(round_trip.as_nanos() / 2),
        });
    }

    /// The stream has just shown that the server has reached a tick, or did so at most `slack` before.
    pub(crate) fn shown(&mut self, now: Instant, tick: Tick, slack: Ticks, rate: Rate) {
        let Some(seen) = self.seen else {
            return;
        };
        let passed = now.since(seen.at).as_nanos() as f64 - seen.one_way.as_nanos() as f64;
        let step = rate.step().seconds();
        let expected = seen.ticks + passed / 1e9 / step;
        let off = (expected - tick.value() as f64).abs() * step;
        if off > SLACK_SECONDS + f64::from(slack.count()) * step {
            let soon = (self.asked + PAUSE_WHILE_OFF).max(now);
            self.due = Some(self.due.map_or(soon, |due| due.min(soon)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: Ticks = Ticks::new(1);

    fn seconds(count: u64) -> Instant {
        Instant::from_nanos(count * 1_000_000_000)
    }

    fn converged() -> Pings {
        let mut pings = Pings::new();
        pings.begin(Instant::ZERO);
        for look in 1..LOOKS_AT_FIRST {
            let due = pings.due().unwrap();
            assert_eq!(due, Instant::ZERO + Span::from_millis(u64::from(look) * 50));
            pings.asked(due);
        }
        let (one_way, none) = (Span::from_millis(20), Span::ZERO);
        pings.seen(seconds(1), Tick::new(60), none, one_way, Rate::HZ_60);
        pings
    }

    #[test]
    fn a_steady_clock_is_pinged_rarely() {
        let mut pings = converged();
        let due = pings.due().unwrap();
        for second in 2..60 {
            pings.shown(seconds(second), Tick::new(60 * second), ONE, Rate::HZ_60);
        }
        assert_eq!(pings.due(), Some(due));
        assert!(due > seconds(60));
    }

    #[test]
    fn a_slowed_clock_is_pinged_again() {
        let mut pings = converged();
        pings.shown(seconds(10), Tick::new(570), ONE, Rate::HZ_60);
        assert_eq!(pings.due(), Some(seconds(10)));
        pings.asked(seconds(10));
        pings.shown(seconds(10), Tick::new(570), ONE, Rate::HZ_60);
        assert_eq!(pings.due(), Some(seconds(11)));
    }
}
