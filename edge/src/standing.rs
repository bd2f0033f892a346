//! What stands between bodies, for members that join (PROTOCOL 4.15-11).
//!
//! Follows the events that the owner sends. Invariant: a pair is kept from its beginning to its end, or until one of its bodies
//! has left the scene.

use std::collections::BTreeMap;

use rhumb_protocol::limits::{EVENTS_PER_TICK_MAX, STANDING_PAIRS_MAX};
use rhumb_protocol::message::TickEvents;
use rhumb_protocol::scene::BodyEvent;
use rhumb_reckoning::{BodyId, Tick};

/// The pairs in contact, and the bodies in sensors, each with the event in which it began.
#[derive(Debug, Default)]
pub(crate) struct Standing {
    pairs: BTreeMap<(u8, BodyId, BodyId), BodyEvent>,
}

impl Standing {
    /// Takes the events of a tick.
    pub(crate) fn handle(&mut self, events: &TickEvents) {
        for event in &events.events {
            match *event {
                BodyEvent::ContactBegan { body, contact } => {
                    self.insert((0, body, contact.with), *event);
                }
                BodyEvent::ContactEnded { body, with } => {
                    self.pairs.remove(&(0, body, with));
                }
                BodyEvent::SensorEntered { sensor, body } => {
                    self.insert((1, sensor, body), *event);
                }
                BodyEvent::SensorLeft { sensor, body } => {
                    self.pairs.remove(&(1, sensor, body));
                }
                _ => {}
            }
        }
    }

    /// Forgets the pairs of a body that has left.
    pub(crate) fn remove(&mut self, id: BodyId) {
        self.pairs
            .retain(|(_, first, second), _| *first != id && *second != id);
    }

    /// What stands, as the events of a tick; `None` if nothing does. A tick has one message, and what finds no place in it is left
    /// out.
    pub(crate) fn events(&self, tick: Tick) -> Option<TickEvents> {
        let events = self.pairs.values().take(EVENTS_PER_TICK_MAX);
        let events: Vec<_> = events.copied().collect();
        (!events.is_empty()).then_some(TickEvents {
            tick,
            missed: 0,
            events,
        })
    }

    fn insert(&mut self, pair: (u8, BodyId, BodyId), event: BodyEvent) {
        if self.pairs.len() < STANDING_PAIRS_MAX {
            self.pairs.insert(pair, event);
        }
    }
}
