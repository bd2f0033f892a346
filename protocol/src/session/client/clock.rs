//! The client's samples of a scene's clock, and its pings.
//!
//! Only a free-running scene has a clock; in lockstep its members set the time.

use rhumb_reckoning::{Rate, Tick, Ticks};

use crate::endpoint::{Instant, Span, Wake, WakeReason};
use crate::scene::{SceneConfig, Stepping};
use crate::session::event::Event;
use crate::session::pings::Pings;

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

    /// Takes in the answer to the ping of `sent`: the newest tick, and the time since it. Measures the round trip, and for
    /// a member the clock of its scene. Before the client joined, the scene may not have existed; its clock then has no
    /// meaning.
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
}
