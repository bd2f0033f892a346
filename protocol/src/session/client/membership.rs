//! A client's membership of a scene, and the scene's messages to it.
//!
//! Ends with the membership. Commands and their session are kept apart, because they outlive a connection. Events come
//! on the control stream and states in datagrams, so an event may be early. Invariant: at most [`EVENTS_HELD_MAX`]
//! events wait; beyond that the oldest tick's are dropped, and counted. The application gets what had begun by then.

use alloc::collections::{BTreeMap, VecDeque};

use rhumb_reckoning::{BodyId, Tick};

use super::outbox::ClientOutbox;
use super::subscription::{EventTarget, Subscription};
use super::upstream::ClientUpstream;
use crate::limits::EVENTS_HELD_MAX;
use crate::message::{SceneEvent, ServerMessage, TickEvents};
use crate::packet::LargestPacket;
use crate::scene::{BodyEvent, SceneConfig};
use crate::session::CloseCode;
use crate::session::event::Event;

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
            SceneEvent::SceneRestored { tick } => {
                self.held_events.standing.clear();
                events.push_back(Event::SceneRestored(tick));
            }
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

/// The waiting events, oldest tick first.
#[derive(Debug, Default)]
struct HeldEvents {
    ticks: VecDeque<TickEvents>,
    count: usize,
    /// Events that were dropped here and not yet counted for the application.
    dropped: u64,
    /// What began and has not ended, by the events before the waiting ones.
    standing: StandingEvents,
}

impl HeldEvents {
    const fn new() -> Self {
        Self {
            ticks: VecDeque::new(),
            count: 0,
            dropped: 0,
            standing: StandingEvents(BTreeMap::new()),
        }
    }

    /// Keeps the events of a tick.
    fn push(&mut self, events: TickEvents) {
        self.count += events.events.len();
        self.ticks.push_back(events);
        while self.count > EVENTS_HELD_MAX || self.ticks.len() > EVENTS_HELD_MAX {
            let Some(oldest) = self.pop() else { break };
            self.dropped += oldest.missed + oldest.events.len() as u64;
            self.standing.note(&oldest);
        }
    }

    /// Moves the events up to a complete tick to the application's.
    fn release(&mut self, complete: Tick, to: &mut VecDeque<Event>) {
        while self
            .ticks
            .front()
            .is_some_and(|events| events.tick <= complete)
        {
            let Some(events) = self.pop() else { break };
            let tick = events.tick;
            let dropped = core::mem::take(&mut self.dropped);
            let count = events.missed + dropped;
            if count > 0 {
                to.push_back(Event::EventsMissed { tick, count });
            }
            if dropped > 0 && events.missed == 0 {
                let standing = self.standing.0.values();
                to.extend(standing.map(|event| Event::Body {
                    tick,
                    event: *event,
                }));
            }
            self.standing.note(&events);
            let of_tick = events.events.into_iter();
            to.extend(of_tick.map(|event| Event::Body { tick, event }));
        }
    }

    fn pop(&mut self) -> Option<TickEvents> {
        let events = self.ticks.pop_front()?;
        self.count -= events.events.len();
        Some(events)
    }
}

/// The pairs that touch and the bodies in sensors, each by the event that tells so, in the order of events.
///
/// Invariant: at most [`EVENTS_HELD_MAX`].
#[derive(Debug, Default)]
struct StandingEvents(BTreeMap<(u8, BodyId, BodyId), BodyEvent>);

impl StandingEvents {
    /// Learns from the events of a tick. After missed ones the server tells anew what stands.
    fn note(&mut self, events: &TickEvents) {
        if events.missed > 0 {
            self.clear();
        }
        for event in &events.events {
            match *event {
                BodyEvent::ContactBegan { body, contact } => {
                    self.insert((0, body, contact.with), *event);
                }
                BodyEvent::ContactEnded { body, with } => drop(self.0.remove(&(0, body, with))),
                BodyEvent::ContactForce { body, contact } => {
                    if let Some(began) = self.0.get_mut(&(0, body, contact.with)) {
                        *began = BodyEvent::ContactBegan { body, contact };
                    }
                }
                BodyEvent::SensorEntered { sensor, body } => {
                    self.insert((1, sensor, body), *event);
                }
                BodyEvent::SensorLeft { sensor, body } => drop(self.0.remove(&(1, sensor, body))),
                BodyEvent::FellAsleep(_)
                | BodyEvent::Woke(_)
                | BodyEvent::Fault(_)
                | BodyEvent::ReachedGround(_)
                | BodyEvent::LeftGround(_) => {}
            }
        }
    }

    fn insert(&mut self, pair: (u8, BodyId, BodyId), event: BodyEvent) {
        if self.0.len() < EVENTS_HELD_MAX {
            self.0.insert(pair, event);
        }
    }

    fn clear(&mut self) {
        self.0.clear();
    }
}

#[cfg(test)]
mod tests {
    use alloc::vec::Vec;

    use rhumb_reckoning::{BodyId, Tolerance};

    use super::*;
    use crate::limits::LARGEST_PACKET_MIN;
    use crate::scene::BodyEvent;

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

    fn at(tick: u64, missed: u64, count: usize) -> TickEvents {
        TickEvents {
            tick: Tick::new(tick),
            missed,
            events: alloc::vec![BodyEvent::Woke(BodyId::new(0, 0)); count],
        }
    }

    fn released(held: &mut HeldEvents, complete: u64) -> Vec<Event> {
        let mut events = VecDeque::new();
        held.release(Tick::new(complete), &mut events);
        events.into()
    }

    #[test]
    fn events_wait_for_their_tick() {
        let mut held = HeldEvents::new();
        held.push(at(3, 0, 2));
        held.push(at(5, 7, 1));
        assert_eq!(released(&mut held, 2), []);
        assert_eq!(released(&mut held, 4).len(), 2);
        let rest = released(&mut held, 5);
        let missed = Event::EventsMissed {
            tick: Tick::new(5),
            count: 7,
        };
        assert_eq!((rest.len(), &rest[0]), (2, &missed));
    }

    #[test]
    fn the_oldest_events_are_dropped_and_counted() {
        let mut held = HeldEvents::new();
        held.push(at(1, 1, 10));
        held.push(at(2, 0, EVENTS_HELD_MAX));
        let events = released(&mut held, 2);
        let missed = Event::EventsMissed {
            tick: Tick::new(2),
            count: 11,
        };
        assert_eq!((events.len(), &events[0]), (EVENTS_HELD_MAX + 1, &missed));
    }

    #[test]
    fn what_stands_comes_again_after_dropped_events() {
        let pair = |index| (BodyId::new(0, 0), BodyId::new(index, 0));
        let entered = |index| BodyEvent::SensorEntered {
            sensor: pair(index).0,
            body: pair(index).1,
        };
        let left = |index| BodyEvent::SensorLeft {
            sensor: pair(index).0,
            body: pair(index).1,
        };
        let of = |tick, missed, events: &[BodyEvent]| TickEvents {
            tick: Tick::new(tick),
            missed,
            events: events.to_vec(),
        };
        let mut held = HeldEvents::new();
        held.push(of(1, 0, &[entered(1), entered(2)]));
        assert_eq!(released(&mut held, 1).len(), 2);
        held.push(of(2, 0, &[entered(3), left(1)]));
        held.push(at(3, 0, EVENTS_HELD_MAX));
        let events = released(&mut held, 3);
        let body = |event| Event::Body {
            tick: Tick::new(3),
            event,
        };
        assert!(matches!(events[0], Event::EventsMissed { count: 2, .. }));
        assert_eq!(events[1..3], [body(entered(2)), body(entered(3))]);
        assert_eq!(events.len(), EVENTS_HELD_MAX + 3);
        // After events that the server left out, it tells itself what stands.
        held.push(of(4, 1, &[entered(4)]));
        held.push(at(5, 0, EVENTS_HELD_MAX));
        let events = released(&mut held, 5);
        assert_eq!(
            events[1],
            Event::Body {
                tick: Tick::new(5),
                event: entered(4)
            }
        );
    }
}
