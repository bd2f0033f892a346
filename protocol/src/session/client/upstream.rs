//! A member's authority over bodies, and the upstream of their states.
//!
//! In a free-running scene packets go as datagrams. In lockstep they go on the control stream, before the advance that
//! needs them.

use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::{BodyId, BodyState, Tick, Tolerance};

use super::ClientSession;
use crate::limits::AUTHORITY_BODIES_MAX;
use crate::message::{AuthorityError, AuthorityGrant, ClientMessage, TakeAuthority};
use crate::packet::{Datagram, LargestPacket};
use crate::scene::{Command, Stepping};
use crate::session::event::Event;
use crate::session::misuse::Misuse;
use crate::session::upstream_sender::{PublishOutcome, UpstreamSender};
use crate::stream::{PredictionParameters, PublisherStatistics};
use crate::time::Instant;

impl ClientSession {
    /// Bounds the packets of later upstreams. A transport that takes only smaller datagrams needs it.
    pub const fn set_largest_packet(&mut self, largest_packet: LargestPacket) {
        self.upstream_state.largest_packet = largest_packet;
    }

    /// Takes authority over these kinematic bodies in place of the earlier ones; an empty list ends it. Answered by
    /// `AuthorityGrant` or `AuthorityDenied`.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`], [`Misuse::NotNow`] while an earlier request is unanswered, and
    /// [`Misuse::TooManyAuthorityBodies`].
    pub fn take_authority(
        &mut self,
        tolerance: Tolerance,
        bodies: &[BodyId],
    ) -> Result<(), Misuse> {
        let mut bodies = bodies.to_vec();
        bodies.sort_unstable();
        bodies.dedup();
        if bodies.len() > AUTHORITY_BODIES_MAX {
            return Err(Misuse::TooManyAuthorityBodies(bodies.len()));
        }
        if self.upstream_state.requested_authority.is_some() {
            return Err(Misuse::NotNow);
        }
        let authority = TakeAuthority {
            tolerance,
            largest_packet: self.upstream_state.largest_packet,
            bodies,
        };
        self.as_member(&ClientMessage::TakeAuthority(authority.clone()))?;
        self.upstream_state.requested_authority = Some(authority);
        Ok(())
    }

    /// Publishes the states of the bodies under the member's authority, where the server's prediction exceeds the
    /// tolerance. A body without a state stands still at its last place.
    ///
    /// Returns whether the states were published: `false` before the authority is granted, and for a tick not after the
    /// last one.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`], [`Misuse::NoAuthority`], and [`Misuse::Invalid`] for a number out of range; nothing is sent
    /// then.
    pub fn publish(&mut self, tick: Tick, motions: &[(BodyId, BodyState)]) -> Result<bool, Misuse> {
        self.must_be(super::ClientState::Member)?;
        for (id, motion) in motions {
            if !self.upstream_state.covers(*id) {
                return Err(Misuse::NoAuthority(*id));
            }
            Command::check_motion(motion).map_err(Misuse::Invalid)?;
        }
        let Some(upstream_sender) = &mut self.upstream_state.upstream_sender else {
            return Ok(false);
        };
        let mut packets = Vec::new();
        match upstream_sender.publish(tick, motions, &mut packets) {
            PublishOutcome::Yes => {}
            PublishOutcome::Before => return Ok(false),
            PublishOutcome::TooFar => {
                self.request_again();
                return Ok(false);
            }
        }
        self.send_upstream(packets);
        Ok(true)
    }

    /// The bodies under the member's authority, in rising order.
    pub fn authority_bodies(&self) -> impl Iterator<Item = BodyId> {
        self.upstream_state
            .upstream_sender
            .iter()
            .flat_map(UpstreamSender::bodies)
    }

    /// Counters of the upstream since the authority was granted.
    #[must_use]
    pub fn upstream(&self) -> Option<PublisherStatistics> {
        self.upstream_state
            .upstream_sender
            .as_ref()
            .map(UpstreamSender::statistics)
    }

    fn send_upstream(&mut self, packets: Vec<Bytes>) {
        let is_lockstep = self
            .config
            .is_some_and(|config| config.stepping == Stepping::Lockstep);
        if !is_lockstep {
            return self.send_states(packets);
        }
        for packet in packets {
            self.send(&ClientMessage::Upstream(packet.to_vec()));
        }
    }

    /// Requests authority anew, so that the upstream starts again. A pending request has the same effect.
    fn request_again(&mut self) {
        self.upstream_state.upstream_sender = None;
        if self.upstream_state.requested_authority.is_some() {
            return;
        }
        let granted = self.upstream_state.granted.take();
        if let Some(authority) = granted.filter(|authority| !authority.bodies.is_empty()) {
            self.send(&ClientMessage::TakeAuthority(authority.clone()));
            self.upstream_state.requested_authority = Some(authority);
        }
    }

    pub(super) fn handle_authority_grant(&mut self, grant: &AuthorityGrant) {
        let (Some(requested_authority), Some(config)) =
            (self.upstream_state.requested_authority.take(), self.config)
        else {
            return;
        };
        let replica = self.replica_switch.shown();
        let parameters = |id: BodyId| {
            let body = replica?.body(id)?;
            let shape = replica?.shape(body.shape)?;
            Some(PredictionParameters::of(&body, shape, config.damping, None))
        };
        let upstream_sender =
            UpstreamSender::new(grant, &requested_authority, config.integrator, parameters);
        let bodies: Vec<BodyId> = upstream_sender.bodies().collect();
        self.upstream_state.upstream_sender = (!bodies.is_empty()).then_some(upstream_sender);
        self.upstream_state.granted = Some(requested_authority);
        self.events.push_back(Event::AuthorityGrant(bodies));
    }

    pub(super) fn handle_authority_denied(&mut self, error: AuthorityError) {
        if error == AuthorityError::LostSync {
            return self.request_again();
        }
        self.upstream_state.requested_authority = None;
        self.events.push_back(Event::AuthorityDenied(error));
        if self.upstream_state.upstream_sender.is_none() {
            self.request_again();
        }
    }

    /// True if a datagram is about this member's upstream; if so, answers it.
    pub(super) fn handle_upstream_feedback(
        &mut self,
        now: Instant,
        datagram: &Datagram<'_>,
    ) -> bool {
        let Some(upstream_sender) = self
            .upstream_state
            .upstream_sender
            .as_mut()
            .filter(|upstream_sender| upstream_sender.stream() == datagram.head().stream)
        else {
            return false;
        };
        let mut answers = Vec::new();
        upstream_sender.handle_datagram(now, self.round_trip, datagram, &mut answers);
        self.send_upstream(answers);
        true
    }
}
