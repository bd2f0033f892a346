//! The pairs of bodies that touch now, as far as events tell of them.
//!
//! Invariant: a pair is here from the event of its first contact until the event of its last one, in the order of ids.

use std::collections::BTreeMap;

use glam::Vec3;
use rhumb_client::{BodyId, Tick};

use crate::event_record::EventRecord;
use crate::generated::EventKind;

/// Two bodies that touch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactRecord {
    /// The body that was asked for, or that with the lesser id.
    pub body: BodyId,
    /// The body that it touches.
    pub other: BodyId,
    /// A point of the deepest contact, on the body with the lesser id.
    pub point: Vec3,
    /// From the other body towards the body, unit.
    pub normal: Vec3,
    /// Units of length; negative if the bodies overlap.
    pub separation: f32,
    /// The sum of all forces between the bodies.
    pub force: f32,
    /// The tick of the last event about the pair.
    pub tick: Tick,
}

/// The pairs of bodies that touch.
#[derive(Debug, Default)]
pub(crate) struct Contacts(BTreeMap<[BodyId; 2], ContactRecord>);

impl Contacts {
    /// Learns from an event.
    pub(crate) fn note(&mut self, event: &EventRecord) {
        match (event.kind, event.body, event.other) {
            (EventKind::ContactBegan | EventKind::ContactForce, Some(body), Some(other)) => {
                let contact = ContactRecord {
                    body,
                    other,
                    point: event.point,
                    normal: event.normal,
                    separation: event.separation,
                    force: event.force,
                    tick: event.tick,
                };
                self.0.insert(pair(body, other), contact);
            }
            (EventKind::ContactEnded, Some(body), Some(other)) => {
                self.0.remove(&pair(body, other));
            }
            (EventKind::BodyRemoved, Some(body), _) => self.forget(body),
            // No event reports what ended meanwhile.
            (
                EventKind::Resumed
                | EventKind::SessionLost
                | EventKind::SceneRestored
                | EventKind::EventsMissed,
                ..,
            ) => self.0.clear(),
            _ => {}
        }
    }

    /// Forgets the pairs of a body, whose events are no longer sent.
    pub(crate) fn forget(&mut self, body: BodyId) {
        self.0.retain(|pair, _| !pair.contains(&body));
    }

    /// The contacts of a body, or of all bodies.
    pub(crate) fn of(&self, body: Option<BodyId>) -> impl Iterator<Item = ContactRecord> {
        self.0.values().filter_map(move |contact| match body {
            Some(id) if id == contact.other => Some(ContactRecord {
                body: contact.other,
                other: contact.body,
                normal: -contact.normal,
                ..*contact
            }),
            Some(id) => (id == contact.body).then_some(*contact),
            None => Some(*contact),
        })
    }
}

fn pair(body: BodyId, other: BodyId) -> [BodyId; 2] {
    [body.min(other), body.max(other)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(kind: EventKind, bodies: [u32; 2]) -> EventRecord {
        let [body, other] = bodies.map(|index| BodyId::new(index, 0));
        EventRecord {
            body: Some(body),
            other: Some(other),
            normal: Vec3::Y,
            ..EventRecord::plain(kind, Tick::new(3))
        }
    }

    #[test]
    fn a_pair_touches_from_its_first_event_to_its_last() {
        let mut contacts = Contacts::default();
        contacts.note(&event(EventKind::ContactBegan, [1, 2]));
        contacts.note(&event(EventKind::ContactBegan, [1, 3]));
        contacts.note(&event(EventKind::ContactForce, [1, 2]));
        assert_eq!(contacts.of(None).count(), 2);
        let of_second = contacts.of(Some(BodyId::new(2, 0))).next();
        let of_second = of_second.expect("the pair touches");
        assert_eq!(of_second.other, BodyId::new(1, 0));
        assert_eq!(of_second.normal, -Vec3::Y);
        contacts.note(&event(EventKind::ContactEnded, [1, 2]));
        assert_eq!(contacts.of(Some(BodyId::new(2, 0))).count(), 0);
        assert_eq!(contacts.of(None).count(), 1);
        contacts.forget(BodyId::new(3, 0));
        assert_eq!(contacts.of(None).count(), 0);
        contacts.note(&event(EventKind::ContactBegan, [1, 2]));
        contacts.note(&event(EventKind::EventsMissed, [0, 0]));
        assert_eq!(contacts.of(None).count(), 0);
    }
}
