//! A client's membership of a scene, and the scene's messages to it.
//!
//! Ends with the membership. Commands and their session are kept apart, because they outlive a connection. Events come
//! on the control stream and states in datagrams, so an event may be early. Invariant: at most [`EVENTS_HELD_MAX`]
//! events wait; beyond that the oldest tick's are dropped, and counted. The application gets what had begun by then, as far as
//! it is kept; the rest is counted, too. It learns that the scene was restored between the events before that and those after
//! it.

use alloc::collections::{BTreeMap, VecDeque};
use alloc::vec::Vec;

use rhumb_reckoning::{BodyId, Tick};

use super::cells::CellSubscriptions;
use super::outbox::ClientOutbox;
use super::subscription::{EventTarget, Subscription};
use super::upstream::ClientUpstream;
use crate::endpoint::{Instant, Span, Wake};
use crate::limits::{EVENTS_HELD_MAX, STANDING_PAIRS_MAX};
use crate::message::{
    AuthorityError, CellNews, Joined, RemovalCause, SceneEvent, ServerMessage, TickEvents,
};
use crate::packet::{Datagram, LargestPacket};
use crate::scene::{BodyEvent, Cell, SceneConfig};
use crate::session::replica::Replica;
use crate::session::{CloseCode, Event};

/// Subscription, upstream and events of a member.
#[derive(Debug)]
pub(super) struct ClientMembership {
    pub(super) subscription: Subscription,
    pub(super) cells: CellSubscriptions,
    pub(super) upstream: ClientUpstream,
    /// Bodies under authority whose removal a member by cells knows by scene events; a denial is to say it once more.
    removed: Vec<BodyId>,
    /// True after a message of which a body under authority may be known that was not before.
    has_news: bool,
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
            cells: CellSubscriptions::default(),
            upstream,
            removed: Vec::new(),
            has_news: false,
            held_events: HeldEvents::default(),
            queries: 0,
            queries_before: 0,
        }
    }

    /// The membership over the next connection of the session, before it joins.
    pub(super) fn over_next_connection(self) -> Self {
        Self {
            queries_before: self.queries_before + self.queries,
            cells: self.cells.over_next_connection(),
            ..Self::with(self.upstream.over_next_connection())
        }
    }

    /// Ends the membership.
    pub(super) fn end(&mut self) {
        *self = Self {
            cells: self.cells.after_membership(),
            ..Self::new(self.upstream.largest_packet())
        };
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

    /// Begins a copy of the scene, and asks for the cells of an earlier connection.
    pub(super) fn begin_snapshot(&mut self, joined: &Joined, outbox: &mut ClientOutbox) {
        self.subscription.begin_snapshot(joined, outbox);
        self.cells.begin(&joined.extensions, outbox);
    }

    /// Lets the copies wait for a tick that is requested now.
    pub(super) fn advance(&mut self, now: Instant, to: Tick) {
        self.subscription.advance(now, to);
        self.cells.advance(now, to);
    }

    /// Asks for the watermarks, unless they were asked for within `pause`.
    pub(super) fn query(&mut self, now: Instant, pause: Span, outbox: &mut ClientOutbox) {
        self.subscription.query(now, pause, outbox);
        self.cells.query(now, pause, outbox);
    }

    /// Awaits a tick that was requested over another connection.
    pub(super) fn await_also(&mut self, to: Tick) {
        self.subscription.await_also(to);
        self.cells.await_also(to);
    }

    /// Shows copies that have caught up, publishes bodies that waited for them, and restarts the timers.
    pub(super) fn update(
        &mut self,
        now: Instant,
        config: Option<&SceneConfig>,
        outbox: &mut ClientOutbox,
        events: &mut VecDeque<Event>,
    ) {
        self.subscription.update(now, outbox, events);
        self.cells
            .update(now, self.subscription.shown(), outbox, events);
        let learns = core::mem::take(&mut self.has_news) && self.upstream.waits();
        if let Some(config) = config.filter(|_| learns) {
            let copies: Vec<_> = copies(&self.subscription, &self.cells).collect();
            let bodies = self.upstream.learn(config, &copies);
            events.extend(bodies.map(Event::AuthorityGrant));
        }
    }

    /// Sends the reports that are due.
    pub(super) fn report(
        &mut self,
        now: Instant,
        round_trip: Span,
        outbox: &mut ClientOutbox,
        events: &mut VecDeque<Event>,
    ) {
        self.subscription.report(now, round_trip, outbox, events);
        self.cells.report(now, round_trip, outbox, events);
    }

    /// The next moments at which [`Self::report`] has something to do.
    pub(super) fn due(&self) -> impl Iterator<Item = Wake> {
        self.subscription.due().into_iter().chain(self.cells.due())
    }

    /// The newest tick up to which all copies are complete; `None` without one of the scene.
    pub(super) fn complete(&self) -> Option<Tick> {
        let of_scene = self.subscription.shown()?.stream().complete();
        let of_cells = self.cells.copies();
        let of_cells = of_cells.map(|(_, copy)| copy.stream().complete());
        Some(of_cells.fold(of_scene, Tick::min))
    }

    /// Applies a datagram of the stream of a cell; `false` for another one.
    pub(super) fn handle_cell_datagram(
        &mut self,
        now: Instant,
        datagram: &Datagram<'_>,
        outbox: &mut ClientOutbox,
        events: &mut VecDeque<Event>,
    ) -> bool {
        let scene = self.subscription.shown();
        self.cells
            .handle_datagram(now, (datagram, scene), outbox, events)
    }

    /// Handles news of a cell of the scene of this config.
    pub(super) fn handle_cell(
        &mut self,
        (cell, news): (Cell, &CellNews),
        config: Option<&SceneConfig>,
        outbox: &mut ClientOutbox,
        events: &mut VecDeque<Event>,
    ) -> Result<(), CloseCode> {
        self.has_news = true;
        let scene = self.subscription.shown().zip(config);
        let scene = scene.ok_or(CloseCode::VIOLATION)?;
        let bodies = self.cells.handle_news(cell, news, scene, outbox)?;
        for id in bodies {
            match *news {
                CellNews::Placed { .. } => events.push_back(Event::BodyPlaced(id)),
                CellNews::SceneEvent(SceneEvent::BodyRemoved { cause, .. }) => {
                    self.remove_body(id);
                    events.push_back(Event::BodyRemoved { id, cause });
                }
                CellNews::SceneEvent(SceneEvent::PublisherSilent { since, .. }) => {
                    events.push_back(Event::PublisherSilent { id, since });
                }
                CellNews::SceneEvent(SceneEvent::PublisherActive { tick, .. }) => {
                    events.push_back(Event::PublisherActive { id, tick });
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Handles a message about the scene of this config.
    pub(super) fn handle_message(
        &mut self,
        message: ServerMessage,
        config: Option<&SceneConfig>,
        outbox: &mut ClientOutbox,
        events: &mut VecDeque<Event>,
    ) -> Result<(), CloseCode> {
        self.has_news = true;
        match message {
            ServerMessage::SceneEvent(scene_event) => {
                self.handle_scene_event(&scene_event, events)?;
            }
            ServerMessage::Inspection(inspection) => {
                events.push_back(Event::Inspected(inspection));
            }
            ServerMessage::AuthorityGrant(grant) => {
                self.removed.clear();
                if let Some(config) = config {
                    let copies: Vec<_> = copies(&self.subscription, &self.cells).collect();
                    let bodies = (self.upstream).handle_grant(&grant, config, &copies, outbox);
                    events.extend(bodies.map(Event::AuthorityGrant));
                }
            }
            ServerMessage::AuthorityDenied(AuthorityError::UnknownBody(id))
                if self.cells.grid().is_some() && self.is_removal(id) =>
            {
                self.handle_removal(id, events);
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
            ServerMessage::TickEvents(tick_events) => {
                self.held_events.push(Held::Tick(tick_events));
            }
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
            | ServerMessage::Durable { .. }
            | ServerMessage::Moved { .. }
            | ServerMessage::OfCell { .. } => {}
        }
        Ok(())
    }

    /// The copy with the newest track of a body, and the body's id there.
    pub(super) fn copy_of(&self, body: BodyId) -> Option<(&Replica, BodyId)> {
        let copies = copies(&self.subscription, &self.cells);
        let found = copies.filter_map(|copy| Some((copy, copy.id_here(body)?)));
        found.max_by_key(|(copy, local)| copy.stream().track(*local).map(|track| track.origin))
    }

    /// True if a denial that names a body is no answer: the body was under authority, and has left the scene (PROTOCOL 15-15).
    fn is_removal(&self, id: BodyId) -> bool {
        self.removed.contains(&id) || self.upstream.has(id)
    }

    /// Handles such a denial, unless scene events have said the same.
    fn handle_removal(&mut self, id: BodyId, events: &mut VecDeque<Event>) {
        if self.upstream.has(id) {
            self.upstream.remove(id);
            let cause = RemovalCause::Command;
            events.push_back(Event::BodyRemoved { id, cause });
        }
        self.removed.retain(|removed| *removed != id);
    }

    /// Forgets a body that has left the scene by its scene events.
    fn remove_body(&mut self, id: BodyId) {
        let comes_again = self.cells.grid().is_some() && self.upstream.has(id);
        self.removed.extend(comes_again.then_some(id));
        self.upstream.remove(id);
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
                self.remove_body(id);
                events.push_back(Event::BodyRemoved { id, cause });
            }
            SceneEvent::SceneFaulted { tick, cause } => {
                events.push_back(Event::SceneFaulted { tick, cause });
            }
            SceneEvent::SceneRestored { tick } => {
                self.held_events.push(Held::Restored(tick));
                self.release_events(events);
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

/// The copies of the scene and of its cells.
fn copies<'a>(
    subscription: &'a Subscription,
    cells: &'a CellSubscriptions,
) -> impl Iterator<Item = &'a Replica> {
    let of_scene = subscription.shown().into_iter();
    of_scene.chain(cells.complete_copies())
}

/// One of the waiting pieces of news.
#[derive(Debug)]
enum Held {
    /// Events of a tick. They wait until the copy is complete up to it.
    Tick(TickEvents),
    /// The scene was restored at this tick: the server tells anew what stands.
    Restored(Tick),
}

impl Held {
    fn events(&self) -> usize {
        match self {
            Self::Tick(events) => events.events.len(),
            Self::Restored(_) => 0,
        }
    }

    /// True if this can be released as soon as nothing waits before it.
    fn is_due(&self, complete: Tick) -> bool {
        match self {
            Self::Tick(events) => events.tick <= complete,
            Self::Restored(_) => true,
        }
    }
}

/// The waiting events, in the order of their messages.
#[derive(Debug, Default)]
struct HeldEvents {
    waiting: VecDeque<Held>,
    /// Number of events in all that waits.
    count: usize,
    /// Events that were dropped here and not yet counted for the application.
    dropped: u64,
    /// The newest restoration among what was dropped, unreported so far.
    restored: Option<Tick>,
    /// The contacts and stays in sensors that have not ended, by the events before the waiting ones.
    standing: StandingEvents,
}

impl HeldEvents {
    /// Keeps the events of a tick, or a restoration in its place among them.
    fn push(&mut self, held: Held) {
        self.count += held.events();
        self.waiting.push_back(held);
        while self.count > EVENTS_HELD_MAX || self.waiting.len() > EVENTS_HELD_MAX {
            match self.pop() {
                Some(Held::Tick(oldest)) => {
                    self.dropped += oldest.missed + oldest.events.len() as u64;
                    self.standing.note(&oldest);
                }
                Some(Held::Restored(tick)) => {
                    self.restored = Some(tick);
                    self.standing.clear();
                }
                None => break,
            }
        }
    }

    /// Moves what is due at a complete tick to the application's events.
    fn release(&mut self, complete: Tick, to: &mut VecDeque<Event>) {
        to.extend(self.restored.take().map(Event::SceneRestored));
        while self
            .waiting
            .front()
            .is_some_and(|held| held.is_due(complete))
        {
            match self.pop() {
                Some(Held::Tick(events)) => self.release_tick(events, to),
                Some(Held::Restored(tick)) => {
                    to.push_back(Event::SceneRestored(tick));
                    self.standing.clear();
                }
                None => break,
            }
        }
    }

    fn release_tick(&mut self, events: TickEvents, to: &mut VecDeque<Event>) {
        let tick = events.tick;
        let dropped = core::mem::take(&mut self.dropped);
        let count = events.missed + dropped;
        // After missed events the server tells anew what stands; after dropped ones this does.
        let retells = dropped > 0 && events.missed == 0;
        if count > 0 {
            let untold = if retells { self.standing.untold() } else { 0 };
            to.push_back(Event::EventsMissed {
                tick,
                count,
                untold,
            });
        }
        if retells {
            let standing = self.standing.events();
            to.extend(standing.map(|event| Event::Body { tick, event }));
        }
        self.standing.note(&events);
        let of_tick = events.events.into_iter();
        to.extend(of_tick.map(|event| Event::Body { tick, event }));
    }

    fn pop(&mut self) -> Option<Held> {
        let held = self.waiting.pop_front()?;
        self.count -= held.events();
        Some(held)
    }
}

/// The pairs that touch and the bodies in sensors, each by the event that tells so, in the order of events.
#[derive(Debug, Default)]
pub struct StandingEvents {
    pairs: BTreeMap<(u8, BodyId, BodyId), BodyEvent>,
    untold: u64,
}

impl StandingEvents {
    /// Learns from the events of a tick. After missed ones the server tells anew what stands.
    pub fn note(&mut self, events: &TickEvents) {
        if events.missed > 0 {
            self.clear();
        }
        for event in &events.events {
            match *event {
                BodyEvent::ContactBegan { body, contact } => {
                    self.insert((0, body, contact.with), *event);
                }
                BodyEvent::ContactEnded { body, with } => {
                    self.pairs.remove(&(0, body, with));
                }
                BodyEvent::ContactForce { body, contact } => {
                    if let Some(began) = self.pairs.get_mut(&(0, body, contact.with)) {
                        *began = BodyEvent::ContactBegan { body, contact };
                    }
                }
                BodyEvent::SensorEntered { sensor, body } => {
                    self.insert((1, sensor, body), *event);
                }
                BodyEvent::SensorLeft { sensor, body } => {
                    self.pairs.remove(&(1, sensor, body));
                }
                BodyEvent::FellAsleep(_)
                | BodyEvent::Woke(_)
                | BodyEvent::Fault(_)
                | BodyEvent::ReachedGround(_)
                | BodyEvent::LeftGround(_) => {}
            }
        }
    }

    /// Forgets everything: the server tells anew what stands.
    pub fn clear(&mut self) {
        self.pairs.clear();
        self.untold = 0;
    }

    /// Each pair, by the event that tells of it.
    pub fn events(&self) -> impl Iterator<Item = BodyEvent> {
        self.pairs.values().copied()
    }

    /// Pairs that began and found no place, since the server began anew.
    #[must_use]
    pub const fn untold(&self) -> u64 {
        self.untold
    }

    fn insert(&mut self, pair: (u8, BodyId, BodyId), event: BodyEvent) {
        if self.pairs.len() < STANDING_PAIRS_MAX || self.pairs.contains_key(&pair) {
            self.pairs.insert(pair, event);
        } else {
            self.untold += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use rhumb_reckoning::{BodyId, Tolerance};

    use super::*;
    use crate::limits::{LARGEST_PACKET_MIN, STANDING_PAIRS_MAX};
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

    fn at(tick: u64, missed: u64, count: usize) -> Held {
        Held::Tick(TickEvents {
            tick: Tick::new(tick),
            missed,
            events: alloc::vec![BodyEvent::Woke(BodyId::new(0, 0)); count],
        })
    }

    fn released(held: &mut HeldEvents, complete: u64) -> Vec<Event> {
        let mut events = VecDeque::new();
        held.release(Tick::new(complete), &mut events);
        events.into()
    }

    #[test]
    fn events_wait_for_their_tick() {
        let mut held = HeldEvents::default();
        held.push(at(3, 0, 2));
        held.push(at(5, 7, 1));
        assert_eq!(released(&mut held, 2), []);
        assert_eq!(released(&mut held, 4).len(), 2);
        let rest = released(&mut held, 5);
        let missed = Event::EventsMissed {
            tick: Tick::new(5),
            count: 7,
            untold: 0,
        };
        assert_eq!((rest.len(), &rest[0]), (2, &missed));
    }

    #[test]
    fn the_oldest_events_are_dropped_and_counted() {
        let mut held = HeldEvents::default();
        held.push(at(1, 1, 10));
        held.push(at(2, 0, EVENTS_HELD_MAX));
        let events = released(&mut held, 2);
        let missed = Event::EventsMissed {
            tick: Tick::new(2),
            count: 11,
            untold: 0,
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
        let of = |tick, missed, events: &[BodyEvent]| {
            Held::Tick(TickEvents {
                tick: Tick::new(tick),
                missed,
                events: events.to_vec(),
            })
        };
        let mut held = HeldEvents::default();
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

    fn entered(index: u32) -> BodyEvent {
        BodyEvent::SensorEntered {
            sensor: BodyId::new(0, 0),
            body: BodyId::new(index, 0),
        }
    }

    fn all(tick: u64, events: Vec<BodyEvent>) -> Held {
        Held::Tick(TickEvents {
            tick: Tick::new(tick),
            missed: 0,
            events,
        })
    }

    #[test]
    fn a_restoration_comes_after_the_events_before_it_and_nothing_stands_then() {
        let mut held = HeldEvents::default();
        held.push(all(1, alloc::vec![entered(1)]));
        held.push(all(5, alloc::vec![entered(2)]));
        held.push(Held::Restored(Tick::new(5)));
        held.push(all(6, alloc::vec![entered(3)]));
        assert_eq!(released(&mut held, 4).len(), 1);
        let body = |tick, event| Event::Body {
            tick: Tick::new(tick),
            event,
        };
        let restored = Event::SceneRestored(Tick::new(5));
        assert_eq!(
            released(&mut held, 5),
            [body(5, entered(2)), restored.clone()]
        );
        // Contacts that stood before do not come again, also where later events are dropped.
        held.push(at(7, 0, EVENTS_HELD_MAX));
        let events = released(&mut held, 7);
        assert!(matches!(events[0], Event::EventsMissed { count: 1, .. }));
        assert_eq!(events[1], body(7, entered(3)));
        assert_eq!(events.len(), 2 + EVENTS_HELD_MAX);
        // With nothing before it, a restoration comes at once; also if what was before it was dropped.
        held.push(Held::Restored(Tick::new(8)));
        assert_eq!(released(&mut held, 7), [Event::SceneRestored(Tick::new(8))]);
        held.push(all(9, alloc::vec![entered(4)]));
        held.push(Held::Restored(Tick::new(9)));
        held.push(at(10, 0, EVENTS_HELD_MAX + 1));
        assert_eq!(released(&mut held, 8), [Event::SceneRestored(Tick::new(9))]);
    }

    #[test]
    fn pairs_that_stand_beyond_the_limit_are_counted() {
        let mut held = HeldEvents::default();
        let pairs = STANDING_PAIRS_MAX as u32 + 3;
        for index in 0..pairs {
            held.push(all(1, alloc::vec![entered(index)]));
            held.release(Tick::new(1), &mut VecDeque::new());
        }
        let left = |index| BodyEvent::SensorLeft {
            sensor: BodyId::new(0, 0),
            body: BodyId::new(index, 0),
        };
        held.push(all(2, alloc::vec![left(pairs - 1)]));
        held.push(at(3, 0, EVENTS_HELD_MAX));
        let events = released(&mut held, 3);
        // One event was dropped, and three pairs began that do not come again.
        let missed = Event::EventsMissed {
            tick: Tick::new(3),
            count: 1,
            untold: 3,
        };
        assert_eq!(events[0], missed);
        assert_eq!(events.len(), 1 + STANDING_PAIRS_MAX + EVENTS_HELD_MAX);
    }
}
