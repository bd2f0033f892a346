//! Bodies that the caller's own simulator moves, said to the server.
//!
//! The caller says once per frame where they are; what the server predicts anyway is not sent.

use glam::DQuat;
use rhumb_protocol::Instant;
use rhumb_protocol::scene::Stepping;
use rhumb_reckoning::{BodyId, BodyState, Tick, Tolerance};

use super::Client;
use crate::error::ClientError;

impl Client {
    /// Asks to drive these kinematic bodies, in place of those that it drove before, so that the server's bodies are within
    /// the tolerance of where [`Self::publish`] says they are. None at all ends it.
    ///
    /// Sends at once and does not wait: [`Event::AuthorityGrant`](crate::Event::AuthorityGrant) or
    /// [`Event::AuthorityDenied`](crate::Event::AuthorityDenied) tells what came of it. While they are driven, nobody can put
    /// them elsewhere by a command. They are driven no longer once they or this client leave the scene; then they stand
    /// still.
    ///
    /// # Errors
    ///
    /// [`ClientError::Misuse`] for more bodies than one member may drive, and while an earlier wish is not answered.
    pub fn take_authority(
        &mut self,
        bodies: &[BodyId],
        tolerance: Tolerance,
    ) -> Result<(), ClientError> {
        self.check_open()?;
        self.pump.session.take_authority(tolerance, bodies)?;
        self.pump.flush();
        Ok(())
    }

    /// Says where driven bodies are now, and how they move; call it once per frame. One that is not named stands still
    /// where it was named last. Sends nothing while the server predicts all of them well enough.
    ///
    /// Returns the tick that it was said of, or none if there is nobody to say it to: before the wish to drive is granted,
    /// before the server's clock was seen, or when a frame falls on the same tick as the one before. In lockstep that is
    /// the tick of the next [`Self::advance`]; in a free-running scene the one nearest to now by the server's clock, plus
    /// the `lead_ticks` of the options. There, positions are carried on to that tick by their velocities, half a tick at
    /// most.
    ///
    /// The view goes on showing the bodies as the server has them; a simulator shows its own.
    ///
    /// When a client falls silent, its bodies go on as predicted until it should have said something again and a second
    /// more, and then stand still.
    ///
    /// # Errors
    ///
    /// [`ClientError::Misuse`] for a body that this client did not ask to drive, or a number that no engine should be
    /// given; nothing is said then.
    pub fn publish(
        &mut self,
        motions: &[(BodyId, BodyState)],
    ) -> Result<Option<Tick>, ClientError> {
        self.check_open()?;
        let (tick, said) = match self.config.stepping {
            Stepping::Lockstep => {
                let newest = self.requested.max(self.watermark_tick());
                let tick = self.config.publish_schedule.next_published(newest);
                (tick, self.pump.session.publish(tick, motions)?)
            }
            Stepping::FreeRunning => {
                self.pump.turn(Instant::ZERO);
                self.take_events();
                self.check_open()?;
                let Some(present) = self.present() else {
                    return Ok(None);
                };
                let tick = Tick::new((present + 0.5) as u64);
                let seconds = (tick.value() as f64 - present) * self.step_seconds();
                let carried: Vec<(BodyId, BodyState)> = motions
                    .iter()
                    .map(|(id, motion)| (*id, carried(motion, seconds)))
                    .collect();
                (tick, self.pump.session.publish(tick, &carried)?)
            }
        };
        self.pump.flush();
        Ok(said.then_some(tick))
    }

    /// Changes how many ticks ahead of the server's clock driven bodies are said to be; see
    /// [`JoinOptions::lead_ticks`](crate::JoinOptions::lead_ticks). Half of the round trip that [`Self::statistics`] tells, and a
    /// tick or two for jitter, spares the server from predicting.
    pub const fn set_lead_ticks(&mut self, ticks: f64) {
        self.lead_ticks = ticks;
    }

    /// The bodies that the server lets this client drive, in rising order.
    pub fn authority_bodies(&self) -> impl Iterator<Item = BodyId> {
        self.pump.session.authority_bodies()
    }

    /// The moment of the scene at which driven bodies are now, in ticks; none before the server's clock was seen.
    fn present(&mut self) -> Option<f64> {
        let now = self.pump.now();
        self.upstream_clock.server(now)?;
        let shown = self
            .upstream_clock
            .show(now, -self.lead_ticks, 0.0, f64::INFINITY);
        Some(shown.ticks())
    }

    fn step_seconds(&self) -> f64 {
        self.config.integrator.rate.step().seconds()
    }

    fn watermark_tick(&self) -> Tick {
        self.replica()
            .map_or(Tick::ZERO, |replica| replica.stream().watermark_tick())
    }
}

/// A motion some seconds later or earlier, by its velocities; the same if that is none.
fn carried(motion: &BodyState, seconds: f64) -> BodyState {
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
    // Only what no engine should be given leads beyond all numbers, and that is refused as it was given.
    later.unwrap_or(*motion)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motion_is_carried_by_its_velocities_and_a_still_one_keeps_every_bit() {
        let upright = [0.0, 0.0, 0.0, 1.0];
        let still = BodyState::new([0.1, 0.2, 0.3], upright, [0.0; 3], [0.0; 3]).unwrap();
        assert_eq!(carried(&still, 0.5), still);
        let moving = BodyState::new([1.0, 0.0, 0.0], upright, [0.0, 2.0, 0.0], [0.0, 0.0, 4.0]);
        let later = carried(&moving.unwrap(), -0.25);
        assert_eq!(later.position(), [1.0, -0.5, 0.0]);
        let [_, _, z, w] = later.rotation();
        assert!((2.0 * z.atan2(w) + 1.0).abs() < 1e-6, "{z} {w}");
        assert_eq!(later.parts()[7..], moving.unwrap().parts()[7..]);
    }
}
