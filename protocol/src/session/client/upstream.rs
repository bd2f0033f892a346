//! How a member drives bodies of its scene: what it asked for, and its stream.
//!
//! Packets go as datagrams where the server's clock leads, and on the control stream, before the advance that they are
//! for, where members do.

use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::{BodyId, BodyState, Tick, Tolerance};

use super::ClientSession;
use crate::limits::AUTHORITY_BODIES_MAX;
use crate::message::{AuthorityError, AuthorityGrant, ClientMessage, TakeAuthority};
use crate::packet::Datagram;
use crate::scene::{Command, Stepping};
use crate::session::event::Event;
use crate::session::misuse::Misuse;
use crate::session::upstream_sender::{PublishOutcome, UpstreamSender};
use crate::stream::{PredictionParameters, PublisherStatistics};
use crate::time::Instant;

/// What a member drives.
#[derive(Debug)]
pub(super) struct UpstreamState {
    upstream_sender: Option<UpstreamSender>,
    /// What was asked for and is not answered yet.
    requested_authority: Option<TakeAuthority>,
    /// What was granted last.
    granted: Option<TakeAuthority>,
}

impl UpstreamState {
    pub(super) const fn new() -> Self {
        Self {
            upstream_sender: None,
            requested_authority: None,
            granted: None,
        }
    }

    /// A body has left the scene.
    pub(super) fn remove(&mut self, id: BodyId) {
        for drive in [&mut self.requested_authority, &mut self.granted]
            .into_iter()
            .flatten()
        {
            drive.bodies.retain(|body| *body != id);
        }
        if let Some(upstream_sender) = &mut self.upstream_sender {
            upstream_sender.remove(id);
        }
    }

    fn wishes(&self, id: BodyId) -> bool {
        let drives = [&self.requested_authority, &self.granted]
            .into_iter()
            .flatten();
        drives.into_iter().any(|drive| drive.bodies.contains(&id))
    }
}

impl ClientSession {
    /// AuthorityTable these kinematic bodies from now on, in place of those that it drove before; none ends it. Answered by
    /// `AuthorityGrant` or `AuthorityDenied`.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`], while an earlier wish is not answered, and [`Misuse::TooManyAuthorityBodies`].
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
        let drive = TakeAuthority { tolerance, bodies };
        self.as_member(&ClientMessage::TakeAuthority(drive.clone()))?;
        self.upstream_state.requested_authority = Some(drive);
        Ok(())
    }

    /// Says how the driven bodies move at a tick, as far as the server does not predict it; those that are not named stand
    /// still where they were named last. Returns whether the tick was taken: not before the wish to drive is granted, nor
    /// if one as new was taken before.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`], [`Misuse::NoAuthority`], and [`Misuse::Invalid`] for a number that no engine should be given;
    /// nothing is said then.
    pub fn publish(&mut self, tick: Tick, motions: &[(BodyId, BodyState)]) -> Result<bool, Misuse> {
        self.must_be(super::ClientState::Member)?;
        for (id, motion) in motions {
            if !self.upstream_state.wishes(*id) {
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
                self.ask_again();
                return Ok(false);
            }
        }
        self.send_upstream(packets);
        Ok(true)
    }

    /// The bodies that it drives, in rising order.
    pub fn authority_bodies(&self) -> impl Iterator<Item = BodyId> {
        self.upstream_state
            .upstream_sender
            .iter()
            .flat_map(UpstreamSender::bodies)
    }

    /// What it said of the bodies that it drives, since they were granted.
    #[must_use]
    pub fn upstream(&self) -> Option<PublisherStatistics> {
        self.upstream_state
            .upstream_sender
            .as_ref()
            .map(UpstreamSender::statistics)
    }

    fn send_upstream(&mut self, packets: Vec<Bytes>) {
        let led = self
            .config
            .is_some_and(|config| config.stepping == Stepping::Lockstep);
        if !led {
            return self.send_states(packets);
        }
        for packet in packets {
            self.send(&ClientMessage::Upstream(packet.to_vec()));
        }
    }

    /// A stream that goes on no more begins anew; what is asked for already will do that too.
    fn ask_again(&mut self) {
        self.upstream_state.upstream_sender = None;
        if self.upstream_state.requested_authority.is_some() {
            return;
        }
        let granted = self.upstream_state.granted.take();
        if let Some(drive) = granted.filter(|drive| !drive.bodies.is_empty()) {
            self.send(&ClientMessage::TakeAuthority(drive.clone()));
            self.upstream_state.requested_authority = Some(drive);
        }
    }

    pub(super) fn handle_authority_grant(&mut self, driving: &AuthorityGrant) {
        let (Some(requested_authority), Some(config)) =
            (self.upstream_state.requested_authority.take(), self.config)
        else {
            return;
        };
        let copy = self.replica_switch.shown();
        let parameters = |id: BodyId| {
            let body = copy?.body(id)?;
            let shape = copy?.shape(body.shape)?;
            Some(PredictionParameters::of(&body, shape, config.damping, None))
        };
        let upstream_sender = UpstreamSender::new(
            driving,
            requested_authority.tolerance,
            config.integrator,
            parameters,
        );
        let bodies: Vec<BodyId> = upstream_sender.bodies().collect();
        self.upstream_state.upstream_sender = (!bodies.is_empty()).then_some(upstream_sender);
        self.upstream_state.granted = Some(requested_authority);
        self.events.push_back(Event::AuthorityGrant(bodies));
    }

    pub(super) fn handle_authority_denied(&mut self, error: AuthorityError) {
        if error == AuthorityError::LostSync {
            return self.ask_again();
        }
        self.upstream_state.requested_authority = None;
        self.events.push_back(Event::AuthorityDenied(error));
        if self.upstream_state.upstream_sender.is_none() {
            self.ask_again();
        }
    }

    /// Whether a datagram is about the stream of what is driven; if so, answers it.
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
