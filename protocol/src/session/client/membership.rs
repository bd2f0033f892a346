//! A client's membership of a scene, and the scene's messages to it.
//!
//! Ends with the membership. Commands and their session are kept apart, because they outlive a connection.

use alloc::collections::VecDeque;

use super::body_events::HeldEvents;
use super::outbox::ClientOutbox;
use super::subscription::Subscription;
use super::upstream::ClientUpstream;
use crate::message::{SceneEvent, ServerMessage};
use crate::packet::LargestPacket;
use crate::scene::SceneConfig;
use crate::session::close::CloseCode;
use crate::session::event::Event;
use crate::session::replica_switch::EventTarget;

/// Subscription, upstream and events of a member.
#[derive(Debug)]
pub(super) struct ClientMembership {
    pub(super) subscription: Subscription,
    pub(super) upstream: ClientUpstream,
    held_events: HeldEvents,
    queries: u64,
    /// Messages of queries over the earlier connections of the session.
    queries_before: u64,
}

impl ClientMembership {
    /// The state of a client before it joins.
    pub(super) fn new(largest_packet: LargestPacket) -> Self {
        Self::with(ClientUpstream::new(largest_packet))
    }

    fn with(upstream: ClientUpstream) -> Self {
        Self {
            subscription: Subscription::new(),
            upstream,
            held_events: HeldEvents::new(),
            queries: 0,
            queries_before: 0,
        }
    }

    /// The membership over the next connection of the session, before it joins.
    pub(super) fn over_next_connection(self) -> Self {
        Self {
            queries_before: self.queries_before + self.queries,
            ..Self::with(self.upstream.over_next_connection())
        }
    }

    /// Ends the membership.
    pub(super) fn end(&mut self) {
        *self = Self::new(self.upstream.largest_packet());
    }

    /// Numbers queries from zero on, as the server does after a join.
    pub(super) const fn begin(&mut self) {
        self.queries = 0;
    }

    /// Counts queries that are sent together and returns their number. No other queries of the session have it.
    pub(super) const fn note_query(&mut self) -> u64 {
        self.queries += 1;
        self.queries_before + self.queries - 1
    }

    /// Moves the events of bodies that the shown replica has reached to the application's.
    pub(super) fn release_events(&mut self, events: &mut VecDeque<Event>) {
        if let Some(replica) = self.subscription.shown() {
            self.held_events
                .release(replica.stream().complete(), events);
        }
    }

    /// Handles a message about the scene of this config.
    pub(super) fn handle_message(
        &mut self,
        message: ServerMessage,
        config: Option<&SceneConfig>,
        outbox: &mut ClientOutbox,
        events: &mut VecDeque<Event>,
    ) -> Result<(), CloseCode> {
        match message {
            ServerMessage::SceneEvent(scene_event) => {
                self.handle_scene_event(&scene_event, events)?;
            }
            ServerMessage::Inspection(inspection) => {
                events.push_back(Event::Inspected(inspection));
            }
            ServerMessage::AuthorityGrant(grant) => {
                let replica = self.subscription.shown();
                let bodies = config
                    .and_then(|config| self.upstream.handle_grant(&grant, config, replica, outbox));
                events.extend(bodies.map(Event::AuthorityGrant));
            }
            ServerMessage::AuthorityDenied(error) => {
                let reason = self.upstream.handle_denied(error, outbox);
                events.extend(reason.map(Event::AuthorityDenied));
            }
            ServerMessage::TierChanged { to, cause } => {
                self.subscription.handle_tier_changed(to);
                events.push_back(Event::TierChanged { to, cause });
            }
            ServerMessage::QueryResult(mut result) => {
                result.number = result.number.saturating_add(self.queries_before);
                events.push_back(Event::QueryResult(result));
            }
            ServerMessage::TickEvents(tick_events) => self.held_events.push(tick_events),
            // The session handles these.
            ServerMessage::Welcome(_)
            | ServerMessage::Created
            | ServerMessage::Joined(_)
            | ServerMessage::SnapshotEnd
            | ServerMessage::Left
            | ServerMessage::Deleted
            | ServerMessage::Reserved(_)
            | ServerMessage::Denied(_)
            | ServerMessage::Applied { .. }
            | ServerMessage::Refused { .. }
            | ServerMessage::Pong { .. }
            | ServerMessage::Session(_)
            | ServerMessage::Durable { .. } => {}
        }
        Ok(())
    }

    fn handle_scene_event(
        &mut self,
        scene_event: &SceneEvent,
        events: &mut VecDeque<Event>,
    ) -> Result<(), CloseCode> {
        if self.subscription.handle_scene_event(scene_event)? == EventTarget::Snapshot {
            return Ok(());
        }
        match *scene_event {
            SceneEvent::PublisherSilent { since, ref bodies } => {
                let silent = bodies
                    .iter()
                    .map(|id| Event::PublisherSilent { id: *id, since });
                events.extend(silent);
            }
            SceneEvent::PublisherActive { tick, ref bodies } => {
                let active = bodies
                    .iter()
                    .map(|id| Event::PublisherActive { id: *id, tick });
                events.extend(active);
            }
            SceneEvent::BodyPlaced { desc, .. } => events.push_back(Event::BodyPlaced(desc.id)),
            SceneEvent::BodyRemoved { id, cause } => {
                self.upstream.remove(id);
                events.push_back(Event::BodyRemoved { id, cause });
            }
            SceneEvent::SceneFaulted { tick, cause } => {
                events.push_back(Event::SceneFaulted { tick, cause });
            }
            SceneEvent::SceneRestored { tick } => events.push_back(Event::SceneRestored(tick)),
            SceneEvent::ShapeAdded { .. }
            | SceneEvent::ShapeRemoved { .. }
            | SceneEvent::JointAdded { .. }
            | SceneEvent::JointRemoved { .. }
            | SceneEvent::Unknown { .. }
            | SceneEvent::GravityChanged { .. } => {}
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::LARGEST_PACKET_MIN;
    use rhumb_reckoning::Tolerance;

    #[test]
    fn the_bound_on_packets_is_the_transports_and_outlives_the_membership() {
        let mut membership = ClientMembership::new(LargestPacket::DEFAULT);
        let small = LargestPacket::new(LARGEST_PACKET_MIN as u32).expect("it is the least one");
        membership.upstream.set_largest_packet(small);
        membership.end();
        let request = membership.upstream.request(Tolerance::NORMAL, &[]);
        assert_eq!(request.map(|request| request.largest_packet), Ok(small));
    }

    #[test]
    fn queries_are_numbered_from_zero_in_each_membership() {
        let mut membership = ClientMembership::new(LargestPacket::DEFAULT);
        assert_eq!([membership.note_query(), membership.note_query()], [0, 1]);
        membership.begin();
        assert_eq!(membership.note_query(), 0);
    }
}
