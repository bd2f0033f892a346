//! Body events that wait until the replica shows their tick.
//!
//! Events come on the control stream and states in datagrams, so that an event may be early. Invariant: at most
//! [`EVENTS_HELD_MAX`] events wait; beyond that the oldest tick's are dropped, and counted.

use alloc::collections::VecDeque;

use rhumb_reckoning::Tick;

use crate::limits::EVENTS_HELD_MAX;
use crate::message::TickEvents;
use crate::session::event::Event;

/// The waiting events, oldest tick first.
#[derive(Debug, Default)]
pub(super) struct HeldEvents {
    ticks: VecDeque<TickEvents>,
    count: usize,
    /// Events that were dropped here and not yet counted for the application.
    dropped: u64,
}

impl HeldEvents {
    pub(super) const fn new() -> Self {
        Self {
            ticks: VecDeque::new(),
            count: 0,
            dropped: 0,
        }
    }

    /// Keeps the events of a tick.
    pub(super) fn push(&mut self, events: TickEvents) {
        self.count += events.events.len();
        self.ticks.push_back(events);
        while self.count > EVENTS_HELD_MAX || self.ticks.len() > EVENTS_HELD_MAX {
            let Some(oldest) = self.pop() else { break };
            self.dropped += oldest.missed + oldest.events.len() as u64;
        }
    }

    /// Moves the events up to a complete tick to the application's.
    pub(super) fn release(&mut self, complete: Tick, to: &mut VecDeque<Event>) {
        while self
            .ticks
            .front()
            .is_some_and(|events| events.tick <= complete)
        {
            let Some(events) = self.pop() else { break };
            let tick = events.tick;
            let count = events.missed + core::mem::take(&mut self.dropped);
            if count > 0 {
                to.push_back(Event::EventsMissed { tick, count });
            }
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

#[cfg(test)]
mod tests {
    use alloc::vec::Vec;

    use rhumb_reckoning::BodyId;

    use super::*;
    use crate::scene::BodyEvent;

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
}
