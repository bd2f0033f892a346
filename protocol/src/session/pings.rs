//! The schedule of a client's pings, which sample the server's clock.
//!
//! Reads no clock itself. Two clocks drift apart slowly, so pings are rare. The stream also shows the server's time;
//! the next ping comes sooner only if that time contradicts the last sample.

use rhumb_reckoning::{Rate, Tick, Ticks};

use crate::endpoint::{Instant, Span};

/// A new member pings a few times in quick succession, so that one outlier does no harm.
const FIRST_PINGS: u32 = 5;
/// The pause between two of the first pings.
const FIRST_PAUSE: Span = Span::from_millis(50);
/// The pause between two pings while clock and stream agree. Clocks that differ by 100 ppm drift apart by 6 ms
/// meanwhile.
const PAUSE: Span = Span::from_millis(60_000);
/// The pause between two pings while the stream's time contradicts the last sample.
const PAUSE_WHILE_OFF: Span = Span::from_millis(1_000);
/// The allowed difference, seconds, between the stream's time and the sample: reordering, jitter, publication delay.
const SLACK_SECONDS: f64 = 0.1;

/// The ping schedule of one membership in a free-running scene.
#[derive(Clone, Debug)]
pub(crate) struct Pings {
    due: Option<Instant>,
    left: u32,
    last_sent: Instant,
    sample: Option<ClockSample>,
}

/// The latest sample of the server's clock.
#[derive(Clone, Copy, Debug)]
struct ClockSample {
    at: Instant,
    ticks: f64,
    /// The one-way delay that the sample includes.
    one_way: Span,
}

impl Pings {
    /// A schedule with no ping due.
    pub(crate) const fn new() -> Self {
        Self {
            due: None,
            left: 0,
            last_sent: Instant::ZERO,
            sample: None,
        }
    }

    /// The time of the next ping; None outside a membership.
    pub(crate) const fn due(&self) -> Option<Instant> {
        self.due
    }

    /// Starts the schedule of a membership. The caller sends the first ping now.
    pub(crate) fn begin(&mut self, now: Instant) {
        self.left = FIRST_PINGS;
        self.sample = None;
        self.note_sent(now);
    }

    /// Ends the schedule together with the membership.
    pub(crate) fn end(&mut self) {
        *self = Self::new();
    }

    /// Notes that a ping was sent.
    pub(crate) fn note_sent(&mut self, now: Instant) {
        self.last_sent = now;
        self.left = self.left.saturating_sub(1);
        let pause = if self.left > 0 { FIRST_PAUSE } else { PAUSE };
        self.due = Some(now + pause);
    }

    /// Takes a sample: at `at`, the server had reached its newest tick `since_tick` before.
    pub(crate) fn note_sample(
        &mut self,
        at: Instant,
        tick: Tick,
        since_tick: Span,
        round_trip: Span,
        rate: Rate,
    ) {
        let step = rate.step().seconds();
        let sample = ClockSample {
            at,
            ticks: tick.value() as f64 + since_tick.as_nanos() as f64 / 1e9 / step,
            one_way: Span::from_nanos(round_trip.as_nanos() / 2),
        };
        let is_off = |last: ClockSample| {
            let passed = at.as_nanos() as f64 - last.at.as_nanos() as f64;
            let expected = last.ticks + passed / 1e9 / step;
            (expected - sample.ticks).abs() * step > SLACK_SECONDS
        };
        // The answer may have waited for a member that polled late: others tell whether the clock itself has slipped.
        if self.sample.is_some_and(is_off) {
            self.left = FIRST_PINGS;
            let soon = self.last_sent + FIRST_PAUSE;
            self.due = Some(self.due.map_or(soon, |due| due.min(soon)));
        }
        self.sample = Some(sample);
    }

    /// Notes that the stream shows a tick, reached now or at most `slack` ticks before.
    pub(crate) fn shown(&mut self, now: Instant, tick: Tick, slack: Ticks, rate: Rate) {
        let Some(sample) = self.sample else {
            return;
        };
        let passed = now.since(sample.at).as_nanos() as f64 - sample.one_way.as_nanos() as f64;
        let step = rate.step().seconds();
        let expected = sample.ticks + passed / 1e9 / step;
        let off = (expected - tick.value() as f64).abs() * step;
        if off > SLACK_SECONDS + f64::from(slack.count()) * step {
            let soon = (self.last_sent + PAUSE_WHILE_OFF).max(now);
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
        for ping in 1..FIRST_PINGS {
            let due = pings.due().unwrap();
            assert_eq!(due, Instant::ZERO + Span::from_millis(u64::from(ping) * 50));
            pings.note_sent(due);
        }
        let (one_way, none) = (Span::from_millis(20), Span::ZERO);
        pings.note_sample(seconds(1), Tick::new(60), none, one_way, Rate::HZ_60);
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
    fn a_sample_that_contradicts_the_last_one_is_followed_by_others_at_once() {
        let mut pings = converged();
        pings.note_sent(seconds(10));
        let answer = |pings: &mut Pings, at, tick, round_trip| {
            pings.note_sample(at, Tick::new(tick), Span::ZERO, round_trip, Rate::HZ_60);
        };
        // 9 s after tick 60 the server is at tick 570 only, or the answer waited.
        answer(&mut pings, seconds(10), 570, Span::from_millis(900));
        for ping in 1..=FIRST_PINGS {
            let due = seconds(10) + Span::from_millis(u64::from(ping) * 50);
            assert_eq!(pings.due(), Some(due));
            pings.note_sent(due);
            answer(
                &mut pings,
                due,
                570 + 3 * u64::from(ping),
                Span::from_millis(1),
            );
        }
        assert!(pings.due() > Some(seconds(60)));
    }

    #[test]
    fn a_slowed_clock_is_pinged_again() {
        let mut pings = converged();
        pings.shown(seconds(10), Tick::new(570), ONE, Rate::HZ_60);
        assert_eq!(pings.due(), Some(seconds(10)));
        pings.note_sent(seconds(10));
        pings.shown(seconds(10), Tick::new(570), ONE, Rate::HZ_60);
        assert_eq!(pings.due(), Some(seconds(11)));
    }
}
