//! A member's authority over bodies, and the upstream of their states.
//!
//! In a free-running scene packets go as datagrams. In lockstep they go on the control stream, before the advance that
//! needs them. Invariant: at most one request for authority is unanswered.

use alloc::vec::Vec;

use rhumb_reckoning::{BodyId, BodyState, Tick, Tolerance};

use super::outbox::ClientOutbox;
use crate::limits::AUTHORITY_BODIES_MAX;
use crate::message::{AuthorityError, AuthorityGrant, ClientMessage, TakeAuthority};
use crate::packet::{Datagram, LargestPacket};
use crate::scene::{Command, SceneConfig, Stepping};
use crate::session::misuse::Misuse;
use crate::session::replica::Replica;
use crate::session::upstream_sender::{PublishOutcome, UpstreamSender};
use crate::stream::{PredictionParameters, PublisherStatistics};
use crate::time::{Instant, Span};

/// The authority of a member and its upstream.
#[derive(Debug)]
pub(super) struct ClientUpstream {
    sender: Option<UpstreamSender>,
    /// The requested authority, while the answer is pending.
    requested: Option<TakeAuthority>,
    /// The authority granted last.
    granted: Option<TakeAuthority>,
    /// Bound on the packets of later upstreams.
    largest_packet: LargestPacket,
}

impl ClientUpstream {
    /// No authority.
    pub(super) const fn new(largest_packet: LargestPacket) -> Self {
        Self {
            sender: None,
            requested: None,
            granted: None,
            largest_packet,
        }
    }

    /// Bounds the packets of later upstreams.
    pub(super) const fn set_largest_packet(&mut self, largest_packet: LargestPacket) {
        self.largest_packet = largest_packet;
    }

    /// Bound on the packets of later upstreams.
    pub(super) const fn largest_packet(&self) -> LargestPacket {
        self.largest_packet
    }

    /// A request for authority over these bodies; the caller sends it and calls [`Self::note_requested`].
    pub(super) fn request(
        &self,
        tolerance: Tolerance,
        bodies: &[BodyId],
    ) -> Result<TakeAuthority, Misuse> {
        let mut bodies = bodies.to_vec();
        bodies.sort_unstable();
        bodies.dedup();
        if bodies.len() > AUTHORITY_BODIES_MAX {
            return Err(Misuse::TooManyAuthorityBodies(bodies.len()));
        }
        if self.requested.is_some() {
            return Err(Misuse::NotNow);
        }
        Ok(TakeAuthority {
            tolerance,
            largest_packet: self.largest_packet,
            bodies,
        })
    }

    /// Notes that a request was sent.
    pub(super) fn note_requested(&mut self, request: TakeAuthority) {
        self.requested = Some(request);
    }

    /// Publishes the states of bodies at a tick; `false` if they were not published.
    pub(super) fn publish(
        &mut self,
        tick: Tick,
        motions: &[(BodyId, BodyState)],
        stepping: Stepping,
        outbox: &mut ClientOutbox,
    ) -> Result<bool, Misuse> {
        for (id, motion) in motions {
            if !self.covers(*id) {
                return Err(Misuse::NoAuthority(*id));
            }
            Command::check_motion(motion).map_err(Misuse::Invalid)?;
        }
        let Some(sender) = &mut self.sender else {
            return Ok(false);
        };
        let mut packets = Vec::new();
        match sender.publish(tick, motions, &mut packets) {
            PublishOutcome::Yes => {}
            PublishOutcome::Before => return Ok(false),
            PublishOutcome::TooFar => {
                self.request_again(outbox);
                return Ok(false);
            }
        }
        outbox.send_upstream(stepping, packets);
        Ok(true)
    }

    /// Starts the upstream that the server granted; returns its bodies. `None` if nothing was requested.
    pub(super) fn handle_grant(
        &mut self,
        grant: &AuthorityGrant,
        config: &SceneConfig,
        replica: Option<&Replica>,
    ) -> Option<Vec<BodyId>> {
        let requested = self.requested.take()?;
        let parameters = |id: BodyId| {
            let body = replica?.body(id)?;
            let shape = replica?.shape(body.shape)?;
            Some(PredictionParameters::of(&body, shape, config.damping, None))
        };
        let sender = UpstreamSender::new(grant, &requested, config.integrator, parameters);
        let bodies: Vec<BodyId> = sender.bodies().collect();
        self.sender = (!bodies.is_empty()).then_some(sender);
        self.granted = Some(requested);
        Some(bodies)
    }

    /// Goes on after a denial; returns the reason that the application is to know.
    pub(super) fn handle_denied(
        &mut self,
        error: AuthorityError,
        outbox: &mut ClientOutbox,
    ) -> Option<AuthorityError> {
        if error == AuthorityError::LostSync {
            self.request_again(outbox);
            return None;
        }
        self.requested = None;
        if self.sender.is_none() {
            self.request_again(outbox);
        }
        Some(error)
    }

    /// True if a datagram is about this upstream; if so, answers it.
    pub(super) fn handle_feedback(
        &mut self,
        now: Instant,
        round_trip: Span,
        datagram: &Datagram<'_>,
        stepping: Stepping,
        outbox: &mut ClientOutbox,
    ) -> bool {
        let sender = self.sender.as_mut();
        let Some(sender) = sender.filter(|sender| sender.stream() == datagram.head().stream) else {
            return false;
        };
        let mut answers = Vec::new();
        sender.handle_datagram(now, round_trip, datagram, &mut answers);
        outbox.send_upstream(stepping, answers);
        true
    }

    /// Removes a body that left the scene.
    pub(super) fn remove(&mut self, id: BodyId) {
        let authorities = [&mut self.requested, &mut self.granted];
        for authority in authorities.into_iter().flatten() {
            authority.bodies.retain(|body| *body != id);
        }
        if let Some(sender) = &mut self.sender {
            sender.remove(id);
        }
    }

    /// The bodies under the member's authority, in rising order.
    pub(super) fn bodies(&self) -> impl Iterator<Item = BodyId> {
        self.sender.iter().flat_map(UpstreamSender::bodies)
    }

    /// Counters of the upstream since the authority was granted.
    pub(super) fn statistics(&self) -> Option<PublisherStatistics> {
        self.sender.as_ref().map(UpstreamSender::statistics)
    }

    fn covers(&self, id: BodyId) -> bool {
        let mut authorities = [&self.requested, &self.granted].into_iter().flatten();
        authorities.any(|authority| authority.bodies.contains(&id))
    }

    /// Requests authority anew, so that the upstream starts again. A pending request has the same effect.
    fn request_again(&mut self, outbox: &mut ClientOutbox) {
        self.sender = None;
        if self.requested.is_some() {
            return;
        }
        let granted = self.granted.take();
        if let Some(authority) = granted.filter(|authority| !authority.bodies.is_empty()) {
            outbox.send(&ClientMessage::TakeAuthority(authority.clone()));
            self.requested = Some(authority);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::packet::StreamId;

    const BODY: BodyId = BodyId::new(3, 0);

    fn grant(bodies: Vec<(BodyId, BodyState)>) -> AuthorityGrant {
        AuthorityGrant {
            stream: StreamId(9),
            tick: Tick::new(5),
            bodies,
        }
    }

    /// An upstream whose authority over the body was granted, though its replica has no such body.
    fn granted() -> ClientUpstream {
        let mut upstream = ClientUpstream::new(LargestPacket::DEFAULT);
        let request = upstream.request(Tolerance::NORMAL, &[BODY, BODY]);
        let request = request.expect("nothing is pending");
        assert_eq!(request.bodies, [BODY]);
        upstream.note_requested(request);
        let bodies = upstream.handle_grant(&grant(Vec::new()), &SceneConfig::default(), None);
        assert_eq!(bodies, Some(Vec::new()));
        upstream
    }

    #[test]
    fn a_request_waits_for_the_answer_to_the_one_before() {
        let mut upstream = ClientUpstream::new(LargestPacket::DEFAULT);
        let request = upstream.request(Tolerance::NORMAL, &[BODY]);
        upstream.note_requested(request.expect("nothing is pending"));
        let second = upstream.request(Tolerance::NORMAL, &[BODY]);
        assert_eq!(second, Err(Misuse::NotNow));
    }

    #[test]
    fn a_grant_that_was_not_requested_starts_nothing() {
        let mut upstream = ClientUpstream::new(LargestPacket::DEFAULT);
        let bodies = upstream.handle_grant(&grant(Vec::new()), &SceneConfig::default(), None);
        assert_eq!(bodies, None);
        assert_eq!(upstream.statistics(), None);
    }

    #[test]
    fn an_upstream_that_lost_sync_is_requested_again_unless_its_bodies_are_gone() {
        for is_gone in [false, true] {
            let (mut upstream, mut outbox) = (granted(), ClientOutbox::new());
            if is_gone {
                upstream.remove(BODY);
            }
            let reason = upstream.handle_denied(AuthorityError::LostSync, &mut outbox);
            assert_eq!(reason, None);
            assert_eq!(outbox.poll().is_some(), !is_gone);
            assert_eq!(upstream.requested.is_some(), !is_gone);
        }
    }

    #[test]
    fn only_bodies_under_authority_are_published() {
        let (mut upstream, mut outbox) = (granted(), ClientOutbox::new());
        let still = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        let still = still.expect("it is finite");
        let mut publish = |id| {
            let states = [(id, still)];
            upstream.publish(Tick::new(9), &states, Stepping::FreeRunning, &mut outbox)
        };
        let other = BodyId::new(4, 0);
        assert_eq!(publish(other), Err(Misuse::NoAuthority(other)));
        assert_eq!(publish(BODY), Ok(false), "the server granted no body");
    }
}
