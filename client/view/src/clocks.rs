//! The clocks of a member: of what it shows, and of what it publishes.
//!
//! Only this file of the client converts host time to ticks. Shown time never goes back. Its rate differs from real
//! time by 5 % at most, unless it is so far off that it must jump. Bodies under the member's authority are published by a
//! clock of their own, to which the delay of the view does not apply.

use core::fmt;

use rhumb_protocol::session::{ClientSession, Event, Misuse};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{BodyId, BodyState, Rate, Seconds, Tick};

use crate::moment::RenderTime;

/// Greatest relative difference between the rates of shown time and real time.
const SLEW: f64 = 0.05;
/// Error of the shown time, in seconds, beyond which it jumps.
const JUMP_SECONDS: f64 = 0.5;
/// Samples whose round trip exceeds this multiple of the best one tell nothing, unless the server's clock has slipped.
const ROUND_TRIP_SLACK: f64 = 2.0;
/// Ticks by which two clocks may drift apart between two samples.
const DRIFT_TICKS: f64 = 1.0;
/// Ticks by which a server may be late that still catches up (PROTOCOL 3.3-5), and those of the drift.
const LATE_TICKS: f64 = 5.0 + DRIFT_TICKS;

/// Estimate of a free-running scene's clock.
#[derive(Clone, Debug)]
pub struct SceneClock {
    ticks_per_ns: f64,
    /// The server's tick count at the client's zero moment, and the best round trip so far.
    origin: Option<(f64, Span)>,
    shown: Option<(Instant, f64)>,
    /// True if the estimate was so far off that the shown time jumps, or stands still until the server is there.
    jumps: bool,
    /// True if the limit holds the shown time back.
    is_held: bool,
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
            is_held: false,
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
                    // The samples so far were those of a bad moment, such as a member that did not poll. A rest
                    // of more than a tick that they left open is known now, and shown at once.
                    self.jumps |= half(best) > half(round_trip) + DRIFT_TICKS;
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

    /// Learns that the server has reached a tick. An estimate that is behind by more than clocks drift apart was made of bad
    /// samples.
    fn reach(&mut self, now: Instant, tick: f64) {
        let Some(server) = self.server(now) else {
            return;
        };
        if let Some((origin, _)) = &mut self.origin
            && tick > server
        {
            *origin += tick - server;
            self.jumps |= tick - server > DRIFT_TICKS;
        }
    }

    /// True if the last shown moment was at its limit, because nothing is known beyond it.
    #[must_use]
    pub const fn is_held(&self) -> bool {
        self.is_held
    }

    /// The moment to show now: `delay` ticks behind the server, never beyond `limit`; `known` before the first sample.
    ///
    /// `known`: a tick that the server has reached.
    pub fn show(&mut self, now: Instant, delay: f64, known: f64, limit: f64) -> RenderTime {
        self.reach(now, known);
        let unheld = self.server(now).map_or(known, |server| server - delay);
        let wanted = unheld.min(limit);
        // A present that was held back is shown at once when it may be.
        let was_held = std::mem::replace(&mut self.is_held, unheld > limit);
        let shown = match self.shown {
            Some((last, shown)) => {
                let passed = now.since(last).as_nanos() as f64 * self.ticks_per_ns;
                let off = wanted - (shown + passed);
                if self.jumps || was_held || off.abs() > JUMP_SECONDS * 1e9 * self.ticks_per_ns {
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

/// The clock of an upstream.
#[derive(Debug)]
pub struct UpstreamClock {
    clock: SceneClock,
    rate: Rate,
    /// Ticks ahead of the server's clock at which states are published, from zero to [`SHIFT_TICKS_MAX`]. Any other number
    /// counts as zero.
    pub lead_ticks: f64,
}

impl UpstreamClock {
    /// A clock without samples; `rate` is the scene's.
    #[must_use]
    pub fn new(rate: Rate, lead_ticks: f64) -> Self {
        Self {
            clock: SceneClock::new(rate),
            rate,
            lead_ticks,
        }
    }

    /// Learns of the server's clock from the events of the session.
    pub fn note(&mut self, event: &Event) {
        self.clock.note(event);
    }

    /// Publishes the present states, extrapolated to the nearest tick; returns that tick, or `None` if nothing was
    /// published.
    ///
    /// # Errors
    ///
    /// [`Misuse`] for a body without requested authority or an invalid number; then nothing is published.
    pub fn publish(
        &mut self,
        session: &mut ClientSession,
        now: Instant,
        motions: &[(BodyId, BodyState)],
    ) -> Result<Option<Tick>, Misuse> {
        let Some(present) = self.present(now) else {
            return Ok(None);
        };
        let tick = Tick::new((present + 0.5) as u64);
        let seconds = (tick.value() as f64 - present) * self.rate.step().seconds();
        let extrapolated: Vec<(BodyId, BodyState)> = motions
            .iter()
            .map(|(id, motion)| (*id, extrapolate(motion, seconds)))
            .collect();
        let published = session.publish(tick, &extrapolated)?;
        Ok(published.then_some(tick))
    }

    /// The moment of the scene that is published now, in ticks; `None` before the server's clock is known.
    fn present(&mut self, now: Instant) -> Option<f64> {
        self.clock.server(now)?;
        let lead_ticks = ticks_or_none(self.lead_ticks);
        let shown = self.clock.show(now, -lead_ticks, 0.0, f64::INFINITY);
        Some(shown.ticks())
    }
}

/// A state extrapolated by its velocities over `seconds`, which may be negative; unchanged if it does not move.
fn extrapolate(motion: &BodyState, seconds: f64) -> BodyState {
    if *motion == motion.stilled() {
        return *motion;
    }
    let (pose, twist) = (motion.motion().pose(), motion.motion().twist());
    let position = pose.position + twist.linear * seconds;
    let turn = twist.turn_over(Seconds::new(seconds));
    let rotation = (turn * pose.rotation).normalize();
    let later = BodyState::new(
        position.as_vec3().to_array(),
        rotation.as_quat().to_array(),
        twist.linear.as_vec3().to_array(),
        twist.angular.as_vec3().to_array(),
    );
    // Only an invalid state overflows here. The session refuses it as it is.
    later.unwrap_or(*motion)
}

/// Most ticks by which a view stays behind, or an upstream leads: a minute at 60 Hz.
pub const SHIFT_TICKS_MAX: f64 = 3_600.0;

/// Most published ticks by which a view of a lockstep scene stays behind the tick that was requested last.
pub const DEPTH_MAX: u32 = 64;

/// A number of ticks outside its limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InvalidTicks {
    /// A view cannot be so far behind.
    Delay(f64),
    /// An upstream cannot be so far ahead.
    Lead(f64),
    /// A pipeline is not so deep.
    Depth(u32),
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

    /// Checks the depth of a pipeline.
    ///
    /// # Errors
    ///
    /// [`Self::Depth`].
    pub fn check_depth(ticks: u32) -> Result<(), Self> {
        (ticks <= DEPTH_MAX).then_some(()).ok_or(Self::Depth(ticks))
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
pub(crate) fn ticks_or_none(ticks: f64) -> f64 {
    if is_valid(ticks) { ticks } else { 0.0 }
}

fn is_valid(ticks: f64) -> bool {
    (0.0..=SHIFT_TICKS_MAX).contains(&ticks)
}

impl fmt::Display for InvalidTicks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (name, ticks, most) = match *self {
            Self::Delay(ticks) => ("delay in ticks", ticks, SHIFT_TICKS_MAX),
            Self::Lead(ticks) => ("lead in ticks", ticks, SHIFT_TICKS_MAX),
            Self::Depth(ticks) => ("pipeline depth", f64::from(ticks), f64::from(DEPTH_MAX)),
        };
        write!(f, "the {name} is {ticks}, and must be 0 to {most}")
    }
}

impl std::error::Error for InvalidTicks {}

#[cfg(test)]
mod tests {
    use rhumb_protocol::Span;

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
    fn a_view_whose_only_samples_were_bad_has_its_clock_right_at_the_first_good_one() {
        for wrong in [-8, -5, -3, -1, 1, 3, 5, 8_i32] {
            let mut clock = SceneClock::new(Rate::HZ_60);
            // Two answers waited for up to 400 ms when the member took them.
            for (at, round_trip) in [(0.3, 400), (0.35, 350)] {
                let tick = Tick::new((600.0 + 60.0 * at - f64::from(wrong)) as u64);
                clock.sample(seconds(at), tick, Span::ZERO, Span::from_millis(round_trip));
                clock.show(seconds(at), 0.0, 0.0, 1e9);
            }
            let good = |clock: &mut SceneClock, at: f64| {
                let tick = Tick::new((600.0 + 60.0 * at).round() as u64);
                clock.sample(seconds(at), tick, Span::ZERO, Span::from_millis(30));
                clock.show(seconds(at), 0.0, 0.0, 1e9).ticks()
            };
            good(&mut clock, 0.5);
            // A view that was ahead stands still until it is not.
            let shown = good(&mut clock, 0.7);
            assert!((shown - 642.0).abs() < 0.1, "{wrong} ticks: {shown}");
        }
    }

    #[test]
    fn an_estimate_that_is_behind_an_arrived_tick_is_corrected_at_once() {
        let mut clock = SceneClock::new(Rate::HZ_60);
        clock.sample(
            seconds(0.3),
            Tick::new(600),
            Span::ZERO,
            Span::from_millis(600),
        );
        let begun = clock.show(seconds(0.6), 0.0, 0.0, 1e9).ticks();
        assert!((begun - 618.0).abs() < 1e-6);
        let shown = clock.show(seconds(0.7), 0.0, 628.0, 1e9).ticks();
        assert!((shown - 628.0).abs() < 1e-6, "{shown}");
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

    #[test]
    fn a_view_that_its_limit_held_back_shows_the_present_as_soon_as_it_may() {
        let mut clock = clock();
        for (at, limit, expected) in [(0.0, 1e9, 600.0), (0.5, 610.0, 610.0), (0.51, 1e9, 630.6)] {
            let shown = clock.show(seconds(at), 0.0, 0.0, limit).ticks();
            assert!((shown - expected).abs() < 1e-6, "{shown}");
            assert_eq!(clock.is_held(), limit < 1e9);
        }
    }

    #[test]
    fn a_lead_that_is_no_number_of_ticks_is_none() {
        let sample = Event::ClockSeen {
            at: Instant::ZERO,
            tick: Tick::new(60),
            since_tick: Span::ZERO,
            round_trip: Span::ZERO,
        };
        for lead_ticks in [0.0, f64::NAN, f64::INFINITY, -5.0] {
            let mut clock = UpstreamClock::new(Rate::HZ_60, lead_ticks);
            clock.note(&sample);
            assert_eq!(clock.present(Instant::ZERO), Some(60.0), "{lead_ticks}");
        }
    }

    #[test]
    fn a_state_is_extrapolated_by_its_velocities_and_a_still_one_keeps_every_bit() {
        let upright = [0.0, 0.0, 0.0, 1.0];
        let still = BodyState::new([0.1, 0.2, 0.3], upright, [0.0; 3], [0.0; 3]).unwrap();
        assert_eq!(extrapolate(&still, 0.5), still);
        let moving = BodyState::new([1.0, 0.0, 0.0], upright, [0.0, 2.0, 0.0], [0.0, 0.0, 4.0]);
        let later = extrapolate(&moving.unwrap(), -0.25);
        assert_eq!(later.position(), [1.0, -0.5, 0.0]);
        let [_, _, z, w] = later.rotation();
        assert!((2.0 * z.atan2(w) + 1.0).abs() < 1e-6, "{z} {w}");
        assert_eq!(later.parts()[7..], moving.unwrap().parts()[7..]);
    }
}
