//! The pairs of bodies that touch now, as far as events tell of them.
//!
//! Invariant: a pair is here from the event of its first contact until the event of its last one, in the order of ids. A
//! member that comes late, or that missed events, gets the events of the pairs that touch then. Invariant: at most
//! [`STANDING_PAIRS_MAX`] pairs, and none of a body that the copy has not.

use std::collections::BTreeMap;

use rhumb_protocol::limits::STANDING_PAIRS_MAX;
use rhumb_protocol::scene::{BodyEvent, Contact};
use rhumb_protocol::session::Event;
use rhumb_reckoning::{BodyId, Tick};

/// Two bodies that touch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TouchingPair {
    /// The body that was asked for, or that with the lesser id.
    pub body: BodyId,
    /// The deepest contact with the other body. Its point is on the body with the lesser id, its normal points from the other
    /// body towards `body`; metres, newtons.
    pub contact: Contact,
    /// The tick of the last event about the pair.
    pub tick: Tick,
}

/// The pairs of bodies that touch.
#[derive(Debug, Default)]
pub struct Contacts {
    pairs: BTreeMap<[BodyId; 2], (Contact, Tick)>,
    /// Pairs that found no place since the server last sent all.
    left_out: u64,
}

impl Contacts {
    /// Learns from an event of the session. `is_known`: whether the copy has a body.
    pub fn note(&mut self, event: &Event, is_known: impl Fn(BodyId) -> bool) {
        match *event {
            Event::Body { tick, event } => self.note_of_body(tick, event, is_known),
            Event::BodyRemoved { id, .. } => self.pairs.retain(|pair, _| !pair.contains(&id)),
            // The server tells anew what touches.
            Event::Resumed(_) | Event::SessionLost(_) | Event::SceneRestored(_) => {
                *self = Self::default();
            }
            Event::EventsMissed { untold, .. } => {
                *self = Self {
                    left_out: untold,
                    ..Self::default()
                };
            }
            _ => {}
        }
    }

    /// Pairs that began to touch, or bodies that came into a sensor, and found no place, since the server last sent all that
    /// stand. Zero if no pair is missing here.
    #[must_use]
    pub const fn left_out(&self) -> u64 {
        self.left_out
    }

    fn note_of_body(&mut self, tick: Tick, event: BodyEvent, is_known: impl Fn(BodyId) -> bool) {
        match event {
            BodyEvent::ContactBegan { body, contact } => {
                let pair = [body, contact.with];
                if !pair.into_iter().all(is_known) {
                    // The body went since; what its pairs report is over.
                    return;
                }
                if self.pairs.len() < STANDING_PAIRS_MAX || self.pairs.contains_key(&pair) {
                    self.pairs.insert(pair, (contact, tick));
                } else {
                    self.left_out += 1;
                }
            }
            BodyEvent::ContactForce { body, contact } => {
                // A pair whose bodies report forces alone does not tell when it ends.
                if let Some(known) = self.pairs.get_mut(&[body, contact.with]) {
                    *known = (contact, tick);
                }
            }
            BodyEvent::ContactEnded { body, with } => {
                self.pairs.remove(&[body, with]);
            }
            _ => {}
        }
    }

    /// The contacts of a body, or of all bodies.
    pub fn of(&self, body: Option<BodyId>) -> impl Iterator<Item = TouchingPair> {
        self.pairs
            .iter()
            .filter_map(move |(pair, (contact, tick))| {
                let [first, second] = *pair;
                let (body, contact) = match body {
                    Some(id) if id == second => {
                        let normal = -contact.normal;
                        let with = first;
                        let flipped = Contact {
                            with,
                            normal,
                            ..*contact
                        };
                        (second, flipped)
                    }
                    Some(id) if id != first => return None,
                    _ => (first, *contact),
                };
                Some(TouchingPair {
                    body,
                    contact,
                    tick: *tick,
                })
            })
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    const GONE: BodyId = BodyId::new(9, 0);

    fn id(index: u32) -> BodyId {
        BodyId::new(index, 0)
    }

    fn contact(with: u32, force: f32) -> Contact {
        Contact {
            with: id(with),
            point: Vec3::ZERO,
            normal: Vec3::Y,
            separation: 0.0,
            force,
        }
    }

    fn note(contacts: &mut Contacts, event: BodyEvent) {
        let tick = Tick::new(3);
        contacts.note(&Event::Body { tick, event }, |id| id != GONE);
    }

    fn began(contacts: &mut Contacts, body: u32, with: u32) {
        let (body, contact) = (id(body), contact(with, 1.0));
        note(contacts, BodyEvent::ContactBegan { body, contact });
    }

    fn force(contacts: &mut Contacts, body: u32, with: u32) {
        let (body, contact) = (id(body), contact(with, 7.0));
        note(contacts, BodyEvent::ContactForce { body, contact });
    }

    #[test]
    fn a_pair_touches_from_its_first_event_to_its_last() {
        let mut contacts = Contacts::default();
        began(&mut contacts, 1, 2);
        began(&mut contacts, 1, 3);
        force(&mut contacts, 1, 2);
        // Nothing tells when a pair ends of which forces alone are reported.
        force(&mut contacts, 4, 5);
        assert_eq!(contacts.of(None).count(), 2);
        let of_second = contacts.of(Some(id(2))).next().expect("the pair touches");
        assert_eq!((of_second.body, of_second.contact.with), (id(2), id(1)));
        assert_eq!(of_second.contact.normal, -Vec3::Y);
        assert_eq!(of_second.contact.force, 7.0);
        let (body, with) = (id(1), id(2));
        note(&mut contacts, BodyEvent::ContactEnded { body, with });
        assert_eq!(contacts.of(Some(id(2))).count(), 0);
        assert_eq!(contacts.of(Some(id(3))).count(), 1);
        let tick = Tick::new(4);
        contacts.note(
            &Event::EventsMissed {
                tick,
                count: 1,
                untold: 0,
            },
            |_| true,
        );
        assert_eq!(contacts.of(None).count(), 0);
    }

    #[test]
    fn no_pair_has_a_body_that_the_copy_has_not() {
        let mut contacts = Contacts::default();
        began(&mut contacts, 9, 10);
        began(&mut contacts, 1, 9);
        began(&mut contacts, 1, 2);
        assert_eq!(contacts.of(None).count(), 1);
        assert_eq!(contacts.left_out(), 0);
    }

    #[test]
    fn pairs_beyond_the_limit_are_counted() {
        let mut contacts = Contacts::default();
        let first = 10;
        let beyond = first + STANDING_PAIRS_MAX as u32;
        for with in first..beyond + 2 {
            began(&mut contacts, 1, with);
        }
        // A pair with a place keeps it.
        began(&mut contacts, 1, first);
        assert_eq!(contacts.of(None).count(), STANDING_PAIRS_MAX);
        assert_eq!(contacts.left_out(), 2);
        let tick = Tick::new(4);
        contacts.note(
            &Event::EventsMissed {
                tick,
                count: 1,
                untold: 0,
            },
            |_| true,
        );
        assert_eq!(contacts.left_out(), 0);
        // The session has left some out, too.
        let missed = Event::EventsMissed {
            tick,
            count: 1,
            untold: 5,
        };
        contacts.note(&missed, |_| true);
        assert_eq!(contacts.left_out(), 5);
    }
}
