//! Standing contacts and sensors, by the events that a server tells.
//!
//! The pairs in contact and the bodies in sensors (PROTOCOL 4.15-11), each with the event that tells so. For clients, and for edges,
//! which tell it anew. Invariant: at most [`STANDING_PAIRS_MAX`]; what exceeds that is counted.

use alloc::collections::BTreeMap;

use rhumb_reckoning::BodyId;

use crate::limits::STANDING_PAIRS_MAX;
use crate::message::TickEvents;
use crate::scene::BodyEvent;

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
