//! The client's estimate of a free-running scene's clock.

use rhumb_reckoning::{Rate, Tick, Ticks};

use super::{ClientSession, ClientState};
use crate::scene::Stepping;
use crate::session::event::Event;
use crate::time::{Instant, Span};

impl ClientSession {
    pub(super) fn handle_pong(
        &mut self,
        now: Instant,
        sent: Instant,
        tick: Tick,
        since_tick: Span,
    ) {
        if sent > now {
            return;
        }
        let round_trip = now.since(sent);
        self.round_trip = round_trip;
        // Before the client joined, the scene may not have existed; its clock then has no meaning.
        if self.state != ClientState::Member {
            return;
        }
        let at = sent + Span::from_nanos(round_trip.as_nanos() / 2);
        if let Some(rate) = self.free_rate() {
            self.pings
                .note_sample(at, tick, since_tick, round_trip, rate);
        }
        self.events.push_back(Event::ClockSeen {
            at,
            tick,
            since_tick,
            round_trip,
        });
    }

    /// Notes that the stream has just reached a tick.
    pub(super) fn note_shown(&mut self, now: Instant, tick: Tick) {
        let config = self
            .config
            .filter(|config| config.stepping == Stepping::FreeRunning);
        if let Some(config) = config {
            let reached = tick + config.publish_schedule.lookahead;
            let slack = Ticks::new(config.publish_schedule.publish_interval.get());
            self.pings
                .shown(now, reached, slack, config.integrator.rate);
        }
    }

    /// The time of the next ping. None in a lockstep scene, whose members set the time.
    pub(super) fn ping_due(&self) -> Option<Instant> {
        self.free_rate().and(self.pings.due())
    }

    /// The tick rate of a free-running scene; None in a lockstep scene.
    fn free_rate(&self) -> Option<Rate> {
        let config = self
            .config
            .filter(|config| config.stepping == Stepping::FreeRunning);
        config.map(|config| config.integrator.rate)
    }
}
