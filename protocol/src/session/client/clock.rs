//! The client's samples of a scene's clock, and the schedule of its pings.
//!
//! Only a free-running scene has a clock; in lockstep its members set the time. Reads no clock itself. Two clocks
//! drift apart slowly, so pings are rare. The stream also shows the server's time; the next ping comes sooner only if
//! that time contradicts the last sample.

use rhumb_reckoning::{Rate, Tick, Ticks};

use crate::endpoint::{Instant, Span, Wake, WakeReason};
use crate::scene::{SceneConfig, Stepping};
use crate::session::Event;

/// The round trip and the schedule of pings.
#[derive(Debug)]
pub(super) struct ClockSampler {
    pings: Pings,
    round_trip: Span,
}

impl ClockSampler {
    /// A schedule with no ping due, and the round trip that counts until one is measured.
    pub(super) const fn new(round_trip: Span) -> Self {
        Self {
            pings: Pings::new(),
            round_trip,
        }
    }

    /// Begins the schedule of a membership. The caller sends the first ping now.
    pub(super) fn begin(&mut self, now: Instant) {
        self.pings.begin(now);
    }

    /// Ends the schedule together with the membership.
    pub(super) fn end(&mut self) {
        self.pings.end();
    }

    /// True if a ping is due, which the caller then sends.
    pub(super) fn take_due(&mut self, now: Instant, config: Option<&SceneConfig>) -> bool {
        let is_due = self.due(config).is_some_and(|due| due.at <= now);
        if is_due {
            self.pings.note_sent(now);
        }
        is_due
    }

    /// Takes in the answer to the ping of `sent`: the newest tick, and the time since it. Measures the round trip, and
    /// for a member the clock of its scene. Before the client joined, the scene may not have existed; its clock then
    /// has no meaning.
    ///
    /// `scene`: the config of a member's scene.
    pub(super) fn handle_pong(
        &mut self,
        now: Instant,
        sent: Instant,
        (tick, since_tick): (Tick, Span),
        scene: Option<&SceneConfig>,
    ) -> Option<Event> {
        if sent > now {
            return None;
        }
        let round_trip = now.since(sent);
        self.round_trip = round_trip;
        let scene = scene?;
        let at = sent + Span::from_nanos(round_trip.as_nanos() / 2);
        if let Some(rate) = free_rate(Some(scene)) {
            self.pings
                .note_sample(at, tick, since_tick, round_trip, rate);
        }
        Some(Event::ClockSeen {
            at,
            tick,
            since_tick,
            round_trip,
        })
    }

    /// Notes that the stream has just reached a tick.
    pub(super) fn note_shown(&mut self, now: Instant, tick: Tick, config: Option<&SceneConfig>) {
        if let (Some(rate), Some(config)) = (free_rate(config), config) {
            let reached = tick + config.publish_schedule.lookahead;
            let slack = Ticks::new(config.publish_schedule.publish_interval.get());
            self.pings.shown(now, reached, slack, rate);
        }
    }

    /// The next ping. None in a lockstep scene, whose members set the time.
    pub(super) fn due(&self, config: Option<&SceneConfig>) -> Option<Wake> {
        let at = free_rate(config).and(self.pings.due())?;
        let reason = WakeReason::Ping;
        Some(Wake { at, reason })
    }

    /// The latest measured round trip.
    pub(super) const fn round_trip(&self) -> Span {
        self.round_trip
    }
}

/// The tick rate of a free-running scene; None in a lockstep scene.
fn free_rate(config: Option<&SceneConfig>) -> Option<Rate> {
    let config = config.filter(|config| config.stepping == Stepping::FreeRunning);
    config.map(|config| config.integrator.rate)
}

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
struct Pings {
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
    const fn new() -> Self {
        Self {
            due: None,
            left: 0,
            last_sent: Instant::ZERO,
            sample: None,
        }
    }

    /// The time of the next ping; None outside a membership.
    const fn due(&self) -> Option<Instant> {
        self.due
    }

    /// Starts the schedule of a membership. The caller sends the first ping now.
    fn begin(&mut self, now: Instant) {
        self.left = FIRST_PINGS;
        self.sample = None;
        self.note_sent(now);
    }

    /// Ends the schedule together with the membership.
    fn end(&mut self) {
        *self = Self::new();
    }

    /// Notes that a ping was sent.
    fn note_sent(&mut self, now: Instant) {
        self.last_sent = now;
        self.left = self.left.saturating_sub(1);
        let pause = if self.left > 0 { FIRST_PAUSE } else { PAUSE };
        self.due = Some(now + pause);
    }

    /// Takes a sample: at `at`, the server had reached its newest tick `since_tick` before.
    fn note_sample(
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
    fn shown(&mut self, now: Instant, tick: Tick, slack: Ticks, rate: Rate) {
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

    fn at(ms: u64) -> Instant {
        Instant::ZERO + Span::from_millis(ms)
    }

    fn scene(stepping: Stepping) -> SceneConfig {
        SceneConfig {
            stepping,
            ..SceneConfig::default()
        }
    }

    #[test]
    fn an_answer_measures_the_round_trip_and_for_a_member_the_clock_halfway() {
        let mut clock = ClockSampler::new(Span::from_millis(20));
        let (sent, tick, since_tick) = (at(100), Tick::new(5), Span::from_millis(3));
        let handle = |clock: &mut ClockSampler, now, scene| {
            clock.handle_pong(now, sent, (tick, since_tick), scene)
        };
        assert_eq!(handle(&mut clock, at(130), None), None);
        assert_eq!(clock.round_trip(), Span::from_millis(30));
        let scene = scene(Stepping::FreeRunning);
        let seen = handle(&mut clock, at(140), Some(&scene));
        let expected = Event::ClockSeen {
            at: at(120),
            tick,
            since_tick,
            round_trip: Span::from_millis(40),
        };
        assert_eq!(seen, Some(expected));
        // An answer from before the ping counts for nothing.
        assert_eq!(handle(&mut clock, at(99), Some(&scene)), None);
        assert_eq!(clock.round_trip(), Span::from_millis(40));
    }

    #[test]
    fn a_ping_is_due_only_in_a_free_running_scene() {
        for (stepping, pings) in [(Stepping::Lockstep, false), (Stepping::FreeRunning, true)] {
            let (mut clock, scene) = (ClockSampler::new(Span::ZERO), scene(stepping));
            clock.begin(at(0));
            assert_eq!(clock.due(Some(&scene)).is_some(), pings);
            assert_eq!(clock.take_due(at(10_000), Some(&scene)), pings);
            assert!(!clock.take_due(at(10_000), Some(&scene)));
            clock.end();
            assert_eq!(clock.due(Some(&scene)), None);
        }
    }

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
