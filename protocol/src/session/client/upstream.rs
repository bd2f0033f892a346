//! A member's authority over bodies, and the upstream of their states.
//!
//! In a free-running scene packets are datagrams. In lockstep they are on the control stream, before the advance that
//! needs them. Invariant: at most one request for authority is unanswered.
//!
//! The server ends the authority with the connection. The next connection of a session requests it again.
//!
//! A body is predicted as its description says. A member by cells has no description of a body outside its cells. Nothing of
//! such a body is published, even if it was granted, until a cell tells of it.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;

use rhumb_reckoning::{BodyId, BodyState, Tick, Tolerance};

use super::outbox::ClientOutbox;
use crate::endpoint::{Instant, Span};
use crate::limits::AUTHORITY_BODIES_MAX;
use crate::message::{AuthorityError, AuthorityGrant, ClientMessage, TakeAuthority};
use crate::packet::{Datagram, LargestPacket};
use crate::scene::{Command, SceneConfig, Stepping};
use crate::session::Misuse;
use crate::session::replica::Replica;
use crate::session::upstream::{PublishOutcome, UpstreamSender};
use crate::stream::{PredictionParameters, PublisherStatistics};

/// The authority of a member and its upstream.
#[derive(Debug)]
pub(super) struct ClientUpstream {
    sender: Option<UpstreamSender>,
    /// The requested authority, while the answer is pending.
    requested: Option<TakeAuthority>,
    /// The authority granted last.
    granted: Option<TakeAuthority>,
    /// The authority that the session had before this connection, or that the application wants in its place, until the
    /// server has answered the request for it.
    regained: Option<TakeAuthority>,
    /// How the bodies of the newest grant were predicted: one that has left the cells that the member takes is in no copy.
    known: BTreeMap<BodyId, PredictionParameters>,
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
            regained: None,
            known: BTreeMap::new(),
            largest_packet,
        }
    }

    /// The upstream over the next connection of the session, before it joins. If the application wants another
    /// authority than it had, it has the earlier one again when that is denied.
    pub(super) fn over_next_connection(self) -> Self {
        let had = self.granted.filter(|granted| !granted.bodies.is_empty());
        let (regained, granted) = match self.regained.or(self.requested) {
            Some(wanted) => (Some(wanted), had),
            None => (had, None),
        };
        Self {
            regained,
            granted,
            known: self.known,
            ..Self::new(self.largest_packet)
        }
    }

    /// Requests the authority that the session had over the connection before.
    pub(super) fn regain(&mut self, outbox: &mut ClientOutbox) {
        if let Some(request) = self.regained.clone() {
            self.send(request, outbox);
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

    /// Requests authority over these bodies in place of the earlier ones. `outbox`: `None` between two connections, of
    /// which the next one sends the request.
    pub(super) fn take(
        &mut self,
        tolerance: Tolerance,
        bodies: &[BodyId],
        outbox: Option<&mut ClientOutbox>,
    ) -> Result<(), Misuse> {
        let request = self.request(tolerance, bodies)?;
        match outbox {
            // The request that is under way is not the one of the application, which follows the answer.
            Some(_) if self.regained.is_some() => self.regained = Some(request),
            None => self.regained = Some(request),
            Some(_) if self.requested.is_some() => return Err(Misuse::AuthorityUnanswered),
            Some(outbox) => self.send(request, outbox),
        }
        Ok(())
    }

    /// A request for authority over these bodies.
    pub(super) fn request(
        &self,
        tolerance: Tolerance,
        bodies: &[BodyId],
    ) -> Result<TakeAuthority, Misuse> {
        // Sorted as numbers, which other parts sort too: the client of browsers has one sort less.
        let number = |id: &BodyId| u64::from(id.index()) << 16 | u64::from(id.generation());
        let mut numbers: Vec<u64> = bodies.iter().map(number).collect();
        numbers.sort_unstable();
        numbers.dedup();
        let id = |number: u64| BodyId::new((number >> 16) as u32, number as u16);
        let bodies: Vec<_> = numbers.into_iter().map(id).collect();
        if bodies.len() > AUTHORITY_BODIES_MAX {
            return Err(Misuse::TooManyAuthorityBodies(bodies.len()));
        }
        Ok(TakeAuthority {
            tolerance,
            largest_packet: self.largest_packet,
            bodies,
        })
    }

    fn send(&mut self, request: TakeAuthority, outbox: &mut ClientOutbox) {
        outbox.send(&ClientMessage::TakeAuthority(request.clone()));
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
            Command::check_motion(motion).map_err(|cause| Misuse::State(*id, cause))?;
        }
        let Some(sender) = &mut self.sender else {
            return Ok(false);
        };
        let is_published = |id: BodyId| sender.bodies().any(|body| body == id);
        if !motions.is_empty() && !motions.iter().any(|(id, _)| is_published(*id)) {
            return Ok(false);
        }
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

    /// Starts the upstream that the server granted; returns the bodies that are published. `None` if nothing was requested, or
    /// if all bodies wait.
    pub(super) fn handle_grant(
        &mut self,
        grant: &AuthorityGrant,
        config: &SceneConfig,
        copies: &[&Replica],
        outbox: &mut ClientOutbox,
    ) -> Option<Vec<BodyId>> {
        let requested = self.requested.take()?;
        if let Some(other) = self.regained.take().filter(|other| *other != requested) {
            self.granted = Some(requested);
            self.send(other, outbox);
            return None;
        }
        let sender = UpstreamSender::new(grant, &requested, config.integrator);
        self.known.retain(|id, _| sender.has(*id));
        self.sender = (!grant.bodies.is_empty()).then_some(sender);
        self.granted = Some(requested);
        let bodies = self.learn(config, copies);
        bodies.or_else(|| grant.bodies.is_empty().then(Vec::new))
    }

    /// True while a granted body waits for its description.
    pub(super) fn waits(&self) -> bool {
        self.sender.as_ref().is_some_and(UpstreamSender::waits)
    }

    /// Begins to publish those of the waiting bodies that a copy has now; returns all that are published then.
    pub(super) fn learn(
        &mut self,
        config: &SceneConfig,
        copies: &[&Replica],
    ) -> Option<Vec<BodyId>> {
        let (sender, known) = (self.sender.as_mut()?, &self.known);
        let parameters = |id| parameters_of(id, config, copies).or_else(|| known.get(&id).copied());
        let learnt = sender.learn(parameters);
        if learnt.is_empty() {
            return None;
        }
        self.known.extend(learnt);
        Some(sender.bodies().collect())
    }

    /// Handles a denial; returns the reason for the application, if it concerns the application.
    pub(super) fn handle_denied(
        &mut self,
        error: AuthorityError,
        outbox: &mut ClientOutbox,
    ) -> Option<AuthorityError> {
        if error == AuthorityError::LostSync {
            if self.sender.as_ref().is_none_or(UpstreamSender::is_new) {
                // The server may have predicted a body otherwise.
                self.known.clear();
            }
            self.request_again(outbox);
            return None;
        }
        let requested = self.requested.take();
        if let Some(regained) = self.regained.take() {
            if requested.as_ref() != Some(&regained) {
                self.send(regained, outbox);
                return None;
            }
            if let Some(less) = without_named(regained, error) {
                self.regained = Some(less.clone());
                self.send(less, outbox);
                return None;
            }
        }
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
        let authorities = [&mut self.requested, &mut self.granted, &mut self.regained];
        for authority in authorities.into_iter().flatten() {
            authority.bodies.retain(|body| *body != id);
        }
        self.known.remove(&id);
        if let Some(sender) = &mut self.sender {
            sender.remove(id);
        }
    }

    /// True for a body of the upstream, published or not.
    pub(super) fn has(&self, id: BodyId) -> bool {
        self.sender.as_ref().is_some_and(|sender| sender.has(id))
    }

    /// The bodies under the member's authority that are published, in rising order.
    pub(super) fn bodies(&self) -> impl Iterator<Item = BodyId> {
        self.sender.iter().flat_map(UpstreamSender::bodies)
    }

    /// Counters of the upstream since the authority was granted.
    pub(super) fn statistics(&self) -> Option<PublisherStatistics> {
        self.sender.as_ref().map(UpstreamSender::statistics)
    }

    fn covers(&self, id: BodyId) -> bool {
        let authorities = [&self.requested, &self.granted, &self.regained];
        let mut authorities = authorities.into_iter().flatten();
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
            self.send(authority, outbox);
        }
    }
}

/// How a body of a copy is predicted; `None` if no copy has it.
fn parameters_of(
    id: BodyId,
    config: &SceneConfig,
    copies: &[&Replica],
) -> Option<PredictionParameters> {
    let mut found = copies.iter();
    let (copy, body) = found.find_map(|copy| Some((copy, copy.body_of_scene(id)?)))?;
    let shape = copy.shape(body.shape)?;
    Some(PredictionParameters::of(&body, shape, config.damping, None))
}

/// The request without the body that a denial names; `None` if it names none, or the only one.
fn without_named(mut request: TakeAuthority, error: AuthorityError) -> Option<TakeAuthority> {
    let named = match error {
        AuthorityError::UnknownBody(id)
        | AuthorityError::NotYours(id)
        | AuthorityError::NotKinematic(id)
        | AuthorityError::HeldByAnother(id) => id,
        AuthorityError::SceneFaulted
        | AuthorityError::LostSync
        | AuthorityError::NotAllowed
        | AuthorityError::Other(_) => return None,
    };
    let count = request.bodies.len();
    request.bodies.retain(|id| *id != named);
    let is_less = request.bodies.len() < count && !request.bodies.is_empty();
    is_less.then_some(request)
}

#[cfg(test)]
mod tests {
    use rhumb_reckoning::{Metres, Ticks};

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

    /// Hands a grant without bodies to an upstream.
    fn take_grant(upstream: &mut ClientUpstream, outbox: &mut ClientOutbox) -> Option<Vec<BodyId>> {
        upstream.handle_grant(&grant(Vec::new()), &SceneConfig::default(), &[], outbox)
    }

    /// An upstream whose authority over bodies was granted, though its replica has no such body.
    fn granted(bodies: &[BodyId]) -> ClientUpstream {
        let mut upstream = ClientUpstream::new(LargestPacket::DEFAULT);
        let mut outbox = ClientOutbox::new();
        let taken = upstream.take(Tolerance::NORMAL, bodies, Some(&mut outbox));
        assert_eq!(taken, Ok(()));
        assert_eq!(take_grant(&mut upstream, &mut outbox), Some(Vec::new()));
        upstream
    }

    /// The bodies of the pending request.
    fn requested(upstream: &ClientUpstream) -> Option<&[BodyId]> {
        let requested = upstream.requested.as_ref();
        requested.map(|requested| &requested.bodies[..])
    }

    #[test]
    fn a_request_waits_for_the_answer_to_the_one_before() {
        let mut upstream = ClientUpstream::new(LargestPacket::DEFAULT);
        let mut outbox = ClientOutbox::new();
        let first = upstream.take(Tolerance::NORMAL, &[BODY, BODY], Some(&mut outbox));
        assert_eq!((first, requested(&upstream)), (Ok(()), Some(&[BODY][..])));
        let second = upstream.take(Tolerance::NORMAL, &[BODY], Some(&mut outbox));
        assert_eq!(second, Err(Misuse::AuthorityUnanswered));
    }

    #[test]
    fn a_grant_that_was_not_requested_starts_nothing() {
        let mut upstream = ClientUpstream::new(LargestPacket::DEFAULT);
        assert_eq!(take_grant(&mut upstream, &mut ClientOutbox::new()), None);
        assert_eq!(upstream.statistics(), None);
    }

    #[test]
    fn an_upstream_that_lost_sync_is_requested_again_unless_its_bodies_are_gone() {
        for is_gone in [false, true] {
            let (mut upstream, mut outbox) = (granted(&[BODY]), ClientOutbox::new());
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
    fn a_body_in_no_copy_is_published_again_unless_the_upstream_was_lost_soon() {
        let still = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        let states = [(BODY, still.expect("it is finite"))];
        for (ticks, published) in [(60, None), (700, Some(alloc::vec![BODY]))] {
            let mut upstream = ClientUpstream::new(LargestPacket::DEFAULT);
            let mut outbox = ClientOutbox::new();
            let parameters = PredictionParameters::plain(Metres::new(1.0));
            upstream.known.insert(BODY, parameters);
            let taken = upstream.take(Tolerance::NORMAL, &[BODY], Some(&mut outbox));
            assert_eq!(taken, Ok(()));
            let (grant, config) = (grant(states.to_vec()), SceneConfig::default());
            let bodies = upstream.handle_grant(&grant, &config, &[], &mut outbox);
            assert_eq!(bodies, Some(alloc::vec![BODY]));
            let at = grant.tick + Ticks::new(ticks);
            let sent = upstream.publish(at, &states, Stepping::FreeRunning, &mut outbox);
            assert_eq!(sent, Ok(true));
            let reason = upstream.handle_denied(AuthorityError::LostSync, &mut outbox);
            assert_eq!(reason, None);
            let bodies = upstream.handle_grant(&grant, &config, &[], &mut outbox);
            assert_eq!(bodies, published, "after {ticks}");
            assert_eq!(upstream.waits(), published.is_none());
        }
    }

    #[test]
    fn only_bodies_under_authority_are_published() {
        let (mut upstream, mut outbox) = (granted(&[BODY]), ClientOutbox::new());
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

    #[test]
    fn the_next_connection_requests_the_authority_without_bodies_that_it_cannot_have() {
        let ids = [3, 4, 5].map(|index| BodyId::new(index, 0));
        let mut upstream = granted(&ids).over_next_connection();
        let mut outbox = ClientOutbox::new();
        let still = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        let states = [(BODY, still.expect("it is finite"))];
        let published = upstream.publish(Tick::new(9), &states, Stepping::FreeRunning, &mut outbox);
        assert_eq!(published, Ok(false));
        assert_eq!(requested(&upstream), None);
        upstream.regain(&mut outbox);
        assert_eq!(requested(&upstream), Some(&ids[..]));
        for (id, left) in [(ids[0], &ids[1..]), (ids[1], &ids[2..])] {
            let error = AuthorityError::UnknownBody(id);
            assert_eq!(upstream.handle_denied(error, &mut outbox), None);
            assert_eq!(requested(&upstream), Some(left));
        }
        let error = AuthorityError::HeldByAnother(ids[2]);
        assert_eq!(upstream.handle_denied(error, &mut outbox), Some(error));
        assert_eq!(requested(&upstream), None);
        assert!(!ids.iter().any(|id| upstream.covers(*id)));
    }

    #[test]
    fn a_request_that_was_pending_at_the_end_of_a_connection_leaves_the_earlier_authority() {
        let other = BodyId::new(4, 0);
        let (mut upstream, mut outbox) = (granted(&[BODY]), ClientOutbox::new());
        let taken = upstream.take(Tolerance::NORMAL, &[other], Some(&mut outbox));
        assert_eq!(taken, Ok(()));
        let mut upstream = upstream.over_next_connection();
        assert!(upstream.covers(BODY) && upstream.covers(other));
        upstream.regain(&mut outbox);
        assert_eq!(requested(&upstream), Some(&[other][..]));
        let error = AuthorityError::HeldByAnother(other);
        assert_eq!(upstream.handle_denied(error, &mut outbox), Some(error));
        assert_eq!(requested(&upstream), Some(&[BODY][..]));
        assert!(!upstream.covers(other));
    }

    #[test]
    fn a_request_between_two_connections_and_one_while_authority_is_regained_are_the_last_word() {
        let other = BodyId::new(4, 0);
        let mut outbox = ClientOutbox::new();
        let mut upstream = granted(&[BODY]).over_next_connection();
        let taken = upstream.take(Tolerance::NORMAL, &[other], None);
        assert_eq!((taken, requested(&upstream)), (Ok(()), None));
        upstream.regain(&mut outbox);
        assert_eq!(requested(&upstream), Some(&[other][..]));
        let taken = upstream.take(Tolerance::NORMAL, &[BODY], Some(&mut outbox));
        assert_eq!((taken, requested(&upstream)), (Ok(()), Some(&[other][..])));
        assert_eq!(take_grant(&mut upstream, &mut outbox), None);
        assert_eq!(requested(&upstream), Some(&[BODY][..]));
        assert_eq!(take_grant(&mut upstream, &mut outbox), Some(Vec::new()));
        assert_eq!(requested(&upstream), None);
    }
}
