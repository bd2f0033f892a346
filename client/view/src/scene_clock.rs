//! Clock of a free-running scene: present tick, and moment to show.
//!
//! Only this file of the client converts host time to ticks. Shown time never goes back. Its rate differs from real
//! time by 5 % at most, unless it is so far off that it must jump.

use rhumb_protocol::session::Event;
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{Rate, Tick};

use crate::render_time::RenderTime;

/// Greatest relative difference between the rates of shown time and real time.
const SLEW: f64 = 0.05;
/// Error of the shown time, in seconds, beyond which it jumps.
const JUMP_SECONDS: f64 = 0.5;
/// Samples whose round trip exceeds this multiple of the best one tell nothing, unless the server's clock has slipped.
const ROUND_TRIP_SLACK: f64 = 2.0;
/// Ticks by which a server may be late that still catches up (PROTOCOL 3.3-5), and one by which two clocks may drift
/// apart between two samples.
const LATE_TICKS: f64 = 6.0;

/// Estimate of a free-running scene's clock.
#[derive(Clone, Debug)]
pub struct SceneClock {
    ticks_per_ns: f64,
    /// The server's tick count at the client's zero moment, and the best round trip so far.
    origin: Option<(f64, Span)>,
    shown: Option<(Instant, f64)>,
    /// True if the estimate was so far off that the shown time jumps, or stands still until the server is there.
    jumps: bool,
}

impl SceneClock {
    /// A clock without samples; `rate` is the scene's.
    #[must_use]
    pub fn new(rate: Rate) -> Self {
        Self {
            ticks_per_ns: f64::from(rate.ticks()) / (f64::from(rate.seconds()) * 1e9),
            origin: None,
            shown: None,
            jumps: false,
        }
    }

    /// Learns of the server's clock from the events of the session. A resumed session may be at an earlier tick, so its
    /// clock starts anew.
    pub fn note(&mut self, event: &Event) {
        match *event {
            Event::ClockSeen {
                at,
                tick,
                since_tick,
                round_trip,
            } => self.sample(at, tick, since_tick, round_trip),
            Event::Resumed(_) => (self.origin, self.shown) = (None, None),
            _ => {}
        }
    }

    /// Adds a sample: at the client's time `at`, the server had reached `tick` `since_tick` earlier.
    pub fn sample(&mut self, at: Instant, tick: Tick, since_tick: Span, round_trip: Span) {
        let ticks = tick.value() as f64 + since_tick.as_nanos() as f64 * self.ticks_per_ns;
        let origin = ticks - at.as_nanos() as f64 * self.ticks_per_ns;
        self.origin = Some(match self.origin {
            None => (origin, round_trip),
            Some((known, best)) => {
                let times = |one: Span, other: Span| {
                    one.as_nanos() as f64 <= other.as_nanos() as f64 * ROUND_TRIP_SLACK
                };
                let half = |trip: Span| trip.as_nanos() as f64 / 2.0 * self.ticks_per_ns;
                let open = half(round_trip) + half(best);
                let off = origin - known;
                let known = if off.abs() > open + LATE_TICKS {
                    // The server's clock itself has slipped: to the nearest moment that the sample allows.
                    self.jumps = true;
                    known.clamp(origin - half(round_trip), origin + half(round_trip))
                } else if !times(best, round_trip) {
                    // The samples so far were those of a bad moment, such as a member that did not poll.
                    self.jumps |= off.abs() > LATE_TICKS;
                    origin
                } else if times(round_trip, best) {
                    known + off * 0.25
                } else {
                    known
                };
                // The best round trip grows slowly, so that samples of a path that became longer are trusted in the
                // end.
                let remembered = Span::from_nanos(best.as_nanos() + best.as_nanos() / 8);
                (known, round_trip.min(remembered))
            }
        });
    }

    /// The server's tick count now; `None` before the first sample.
    pub fn server(&self, now: Instant) -> Option<f64> {
        let (origin, _) = self.origin?;
        Some(origin + now.as_nanos() as f64 * self.ticks_per_ns)
    }

    /// Learns that the server has reached a tick. An estimate that is behind by more than a server may be late was made of
    /// bad samples.
    fn reach(&mut self, now: Instant, tick: f64) {
        let Some(server) = self.server(now) else {
            return;
        };
        if let Some((origin, _)) = &mut self.origin
            && tick > server
        {
            *origin += tick - server;
            self.jumps |= tick - server > LATE_TICKS;
        }
    }

    /// The moment to show now: `delay` ticks behind the server, never beyond `limit`; `known` before the first sample.
    ///
    /// `known`: a tick that the server has reached.
    pub fn show(&mut self, now: Instant, delay: f64, known: f64, limit: f64) -> RenderTime {
        self.reach(now, known);
        let wanted = self.server(now).map_or(known, |server| server - delay);
        let wanted = wanted.min(limit);
        let shown = match self.shown {
            Some((last, shown)) => {
                let passed = now.since(last).as_nanos() as f64 * self.ticks_per_ns;
                let off = wanted - (shown + passed);
                if self.jumps || off.abs() > JUMP_SECONDS * 1e9 * self.ticks_per_ns {
                    // Shown time that is ahead stands still until it is no longer.
                    self.jumps &= wanted < shown;
                    wanted.max(shown)
                } else {
                    let (least, most) = (passed * (1.0 - SLEW), passed * (1.0 + SLEW));
                    (shown + (wanted - shown).clamp(least, most))
                        .min(limit)
                        .max(shown)
                }
            }
            None => wanted,
        };
        self.shown = Some((now, shown));
        RenderTime::from_ticks(shown)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clock() -> SceneClock {
        let mut clock = SceneClock::new(Rate::HZ_60);
        clock.sample(
            Instant::ZERO,
            Tick::new(600),
            Span::ZERO,
            Span::from_millis(1),
        );
        clock
    }

    fn seconds(s: f64) -> Instant {
        Instant::from_nanos((s * 1e9) as u64)
    }

    #[test]
    fn a_server_that_has_slipped_is_followed_at_once() {
        let mut clock = clock();
        let (late, round_trip) = (seconds(10.0), Span::from_millis(20));
        clock.sample(late, Tick::new(600), Span::ZERO, round_trip);
        // Half of the round trip is 0.6 ticks.
        assert!((clock.server(late).unwrap() - 600.0).abs() < 0.601);
        let shown = clock.show(late, 0.0, 600.0, 631.0);
        assert!((shown.ticks() - 600.0).abs() < 0.601);
    }

    #[test]
    fn a_view_that_is_ahead_of_a_server_that_has_slipped_stands_still_until_it_is_not() {
        let mut clock = clock();
        assert!((clock.show(seconds(10.0), 0.0, 0.0, 1e9).ticks() - 1_200.0).abs() < 1e-6);
        // A member that did not poll for ten seconds learns of 20 ticks that were lost.
        let sample = |clock: &mut SceneClock, at: f64| {
            let tick = Tick::new((580.0 + 60.0 * at) as u64);
            clock.sample(seconds(at), tick, Span::ZERO, Span::from_millis(1));
        };
        sample(&mut clock, 10.05);
        let stands = [10.1, 10.2, 10.3].map(|at| clock.show(seconds(at), 0.0, 0.0, 1e9).ticks());
        assert_eq!(stands, [1_200.0; 3]);
        let goes_on = clock.show(seconds(10.5), 0.0, 0.0, 1e9).ticks();
        assert!((goes_on - 1_210.0).abs() < 0.1, "{goes_on}");
        let later = clock.show(seconds(10.6), 0.0, 0.0, 1e9).ticks();
        assert!((later - 1_216.0).abs() < 0.1, "{later}");
    }

    #[test]
    fn a_late_step_that_is_caught_up_moves_the_clock_a_little() {
        let mut clock = clock();
        let (later, round_trip) = (seconds(1.0), Span::from_millis(1));
        clock.sample(later, Tick::new(655), Span::ZERO, round_trip);
        let server = clock.server(later).unwrap();
        assert!((658.0..659.0).contains(&server), "{server}");
    }

    #[test]
    fn a_sample_within_its_round_trip_moves_the_clock_a_little() {
        let mut clock = clock();
        let (later, round_trip) = (seconds(1.0), Span::from_millis(100));
        clock.sample(later, Tick::new(657), Span::ZERO, round_trip);
        let server = clock.server(later).unwrap();
        assert_eq!(
            server, 660.0,
            "a worse sample changes nothing after a better one"
        );
    }

    #[test]
    fn a_good_sample_replaces_those_of_a_member_that_polled_late() {
        let mut clock = SceneClock::new(Rate::HZ_60);
        // The answer had waited for 600 ms when the member took it.
        let round_trip = Span::from_millis(600);
        clock.sample(seconds(0.3), Tick::new(600), Span::ZERO, round_trip);
        let begun = clock.show(seconds(0.6), 0.0, 0.0, 1e9).ticks();
        assert!((begun - 618.0).abs() < 1e-6);
        // At 0.7 s the server is at tick 642.
        clock.sample(
            seconds(0.7),
            Tick::new(642),
            Span::ZERO,
            Span::from_millis(2),
        );
        assert!((clock.server(seconds(0.7)).unwrap() - 642.0).abs() < 0.1);
        let shown = clock.show(seconds(0.7), 0.0, 0.0, 1e9).ticks();
        assert!((shown - 642.0).abs() < 0.1, "{shown}");
    }

    #[test]
    fn the_clock_is_not_behind_a_tick_that_has_arrived() {
        let mut clock = SceneClock::new(Rate::HZ_60);
        clock.sample(
            seconds(0.3),
            Tick::new(600),
            Span::ZERO,
            Span::from_millis(600),
        );
        let shown = clock.show(seconds(0.6), 0.0, 635.0, 1e9).ticks();
        assert!((shown - 635.0).abs() < 1e-6, "{shown}");
        let later = clock.show(seconds(0.7), 0.0, 635.0, 1e9).ticks();
        assert!((later - 641.0).abs() < 0.7, "{later}");
    }

    #[test]
    fn server_time_advances_between_samples() {
        let ticks = clock().server(seconds(2.0)).unwrap();
        assert!((ticks - 720.0).abs() < 1e-6);
    }

    #[test]
    fn render_time_never_goes_back_nor_runs_away() {
        let mut clock = clock();
        let mut last = clock.show(seconds(0.0), 0.0, 0.0, 1e9).ticks();
        for frame in 1..200 {
            let jolt = if frame % 50 == 0 { 5 } else { 0 };
            clock.sample(
                seconds(f64::from(frame) / 60.0),
                Tick::new(600 + frame as u64 - jolt),
                Span::ZERO,
                Span::from_millis(1),
            );
            let shown = clock
                .show(seconds(f64::from(frame) / 60.0), 0.0, 0.0, 1e9)
                .ticks();
            assert!(shown >= last);
            assert!(shown - last <= 1.0 + SLEW + 1e-6);
            last = shown;
        }
        assert!((last - 799.0).abs() < 3.0);
    }

    #[test]
    fn nothing_is_rendered_beyond_the_limit() {
        let mut clock = clock();
        assert!(clock.show(seconds(0.0), 0.0, 0.0, 590.0).ticks() <= 590.0);
        assert!(clock.show(seconds(1.0), 0.0, 0.0, 590.0).ticks() <= 590.0);
    }
}
