//! Authority over bodies that the caller's own simulator moves.
//!
//! The caller publishes their states once per frame. States that the server predicts within tolerance are not sent.

use rhumb_protocol::scene::{IdOutOfRange, Stepping};
use rhumb_reckoning::{BodyId, BodyState, Tick, Tolerance};
use rhumb_view::InvalidTicks;

use super::Client;
use crate::error::ClientError;

impl Client {
    /// Requests authority over these kinematic bodies, in place of the bodies that this client has authority over now.
    ///
    /// The server's bodies are then within `tolerance` of the states of [`Self::publish`]. Another member's copy is within the
    /// sum of this tolerance and that of its stream; its error bound is about the server's body. One member may have
    /// authority over 256 bodies. An empty list ends the authority.
    ///
    /// Sends at once and does not wait: [`Event::AuthorityGrant`](crate::Event::AuthorityGrant) or
    /// [`Event::AuthorityDenied`](crate::Event::AuthorityDenied) reports the result. During the authority, no command
    /// can move these bodies. The authority over a body ends when the body or this client leaves the scene; the body
    /// then stands still.
    ///
    /// A client whose session was interrupted requests the authority again when the session continues, without bodies that
    /// it cannot have any more; the same events report the result. What it requests meanwhile is sent then.
    ///
    /// # Errors
    ///
    /// [`ClientError::Misuse`] for more bodies than one member may have authority over, and while an earlier request is
    /// unanswered. [`ClientError::Id`] for a body that no scene can have.
    pub fn take_authority(
        &mut self,
        bodies: &[BodyId],
        tolerance: Tolerance,
    ) -> Result<(), ClientError> {
        self.check_open()?;
        let mut ids = bodies.iter().copied();
        ids.try_for_each(IdOutOfRange::check_body)?;
        self.pump.session.take_authority(tolerance, bodies)?;
        self.pump.flush();
        Ok(())
    }

    /// Publishes the present states of bodies under this client's authority; call it once per frame.
    ///
    /// A body that is left out stands still at its last published pose. Nothing is sent while the server predicts all
    /// of the bodies within tolerance.
    ///
    /// Returns the tick of the states. Returns `None`, and publishes nothing, before the authority is granted, while the
    /// session is interrupted and until it has the authority again, before the server's clock is known, and when a frame
    /// falls on the same tick as the frame before. In lockstep the tick
    /// is that of the next [`Self::advance`]. In a free-running scene it is the tick nearest to now by the server's
    /// clock, plus the `lead_ticks` of the options; positions are extrapolated to it by their velocities, by half a
    /// tick at most.
    ///
    /// The view shows these bodies as the server has them; a simulator shows its own states.
    ///
    /// When a client becomes silent, its bodies move as predicted until one second after its next update is due. Then
    /// they stand still.
    ///
    /// # Errors
    ///
    /// [`ClientError::Misuse`] for a body without requested authority or an invalid number; then nothing is published.
    pub fn publish(
        &mut self,
        motions: &[(BodyId, BodyState)],
    ) -> Result<Option<Tick>, ClientError> {
        self.check_open()?;
        let config = *self.config();
        let published = match config.stepping {
            Stepping::Lockstep => {
                let newest = self.requested.max(self.watermark_tick());
                let tick = config.publish_schedule.next_published(newest);
                (self.pump.session.publish(tick, motions)?).then_some(tick)
            }
            Stepping::FreeRunning => {
                self.read_waiting();
                self.check_open()?;
                let now = self.pump.now();
                self.upstream_clock
                    .publish(&mut self.pump.session, now, motions)?
            }
        };
        self.pump.flush();
        Ok(published)
    }

    /// Changes [`JoinOptions::lead_ticks`](crate::JoinOptions::lead_ticks): how many ticks ahead of the server's clock
    /// this client publishes.
    ///
    /// With half of the round trip of [`Self::statistics`], plus a tick or two for jitter, the server need not predict.
    ///
    /// # Errors
    ///
    /// [`InvalidTicks`] for a number that is not 0 to [`SHIFT_TICKS_MAX`](crate::SHIFT_TICKS_MAX); the lead stays as it was.
    pub fn set_lead_ticks(&mut self, ticks: f64) -> Result<(), InvalidTicks> {
        InvalidTicks::check_lead(ticks)?;
        self.upstream_clock.lead_ticks = ticks;
        Ok(())
    }

    /// The bodies under this client's authority, in rising order.
    pub fn authority_bodies(&self) -> impl Iterator<Item = BodyId> {
        self.pump.session.authority_bodies()
    }

    fn watermark_tick(&self) -> Tick {
        self.replica()
            .map_or(Tick::ZERO, |replica| replica.stream().watermark_tick())
    }
}
