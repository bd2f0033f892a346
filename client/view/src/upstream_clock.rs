//! The clock by which a member publishes the bodies under its authority.
//!
//! For free-running scenes. It is not that of the view, whose delay does not apply to it.

use glam::DQuat;
use rhumb_protocol::Instant;
use rhumb_protocol::session::{ClientSession, Event, Misuse};
use rhumb_reckoning::{BodyId, BodyState, Rate, Tick};

use crate::invalid_ticks;
use crate::scene_clock::SceneClock;

/// The clock of an upstream.
#[derive(Debug)]
pub struct UpstreamClock {
    clock: SceneClock,
    rate: Rate,
    /// Ticks ahead of the server's clock at which states are published, finite and not negative. Any other number counts as
    /// zero.
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
        let lead_ticks = invalid_ticks::or_none(self.lead_ticks);
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
    let turn = DQuat::from_scaled_axis(twist.angular * seconds);
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

#[cfg(test)]
mod tests {
    use rhumb_protocol::Span;

    use super::*;

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
