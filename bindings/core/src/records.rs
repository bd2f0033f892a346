//! Reports of a scene: ids, contacts, events and refusals, as plain fields.
//!
//! Positions, directions and lengths are in the coordinates of the application. A body's id is packed into one number, for
//! languages without such a type; the number of no body is zero, so that memory full of zeros names none.

use std::fmt;

use glam::Vec3;
use rhumb_client::scene::{BodyEvent, CommandError, Invalid, Quantity};
use rhumb_client::{
    BodyId, ClientError, Event, RefusalReason, RefusedRequest, RemovalCause, Tick, TouchingPair,
};

use crate::coordinates::Coordinates;
use crate::generated::EventKind;

/// The packed id of a body: one more than its index, with its generation above the low 33 bits.
#[must_use]
pub fn packed_id(id: BodyId) -> u64 {
    (u64::from(id.generation()) << INDEX_BITS) | (u64::from(id.index()) + 1)
}

/// The body of a packed id.
///
/// # Errors
///
/// [`InvalidPackedId`] for a number that names no body.
pub fn parse_packed_id(number: u64) -> Result<BodyId, InvalidPackedId> {
    let invalid = InvalidPackedId(number);
    let index = (number & INDEX_MASK).checked_sub(1).ok_or(invalid)?;
    let index = u32::try_from(index).map_err(|_| invalid)?;
    let generation = u16::try_from(number >> INDEX_BITS).map_err(|_| invalid)?;
    Ok(BodyId::new(index, generation))
}

/// An index has 32 bits, and one more than the greatest has 33.
const INDEX_BITS: u32 = 33;
const INDEX_MASK: u64 = (1 << INDEX_BITS) - 1;

/// A number that no body has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InvalidPackedId(pub u64);

impl fmt::Display for InvalidPackedId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:#x} is the id of no body", self.0)
    }
}

impl std::error::Error for InvalidPackedId {}

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

impl ContactRecord {
    pub(crate) fn new(pair: &TouchingPair, coordinates: Coordinates) -> Self {
        let contact = coordinates.contact_out(pair.contact);
        Self {
            body: pair.body,
            other: contact.with,
            point: contact.point,
            normal: contact.normal,
            separation: contact.separation,
            force: contact.force,
            tick: pair.tick,
        }
    }
}

/// One event. A field that the kind does not name is zero or `None`.
#[derive(Clone, Debug, PartialEq)]
pub struct EventRecord {
    /// Its kind.
    pub kind: EventKind,
    /// The newest complete tick when the data with which it arrived was read.
    pub after: Tick,
    /// The tick in which it happened, if the server says so; otherwise `after`.
    pub tick: Tick,
    /// The number that the kind names.
    pub number: u64,
    /// The body that the kind names.
    pub body: Option<BodyId>,
    /// The other body.
    pub other: Option<BodyId>,
    /// Of a contact: a point on the first body.
    pub point: Vec3,
    /// Of a contact: from the other body towards the first one, unit.
    pub normal: Vec3,
    /// Of a contact: units of length; negative if the bodies overlap.
    pub separation: f32,
    /// Of a contact: the sum of all forces between the bodies.
    pub force: f32,
    /// A reason, a plain sentence; empty for most kinds.
    pub text: String,
}

impl EventRecord {
    /// An event without other fields.
    #[must_use]
    pub const fn plain(kind: EventKind, after: Tick) -> Self {
        Self {
            kind,
            after,
            tick: after,
            number: 0,
            body: None,
            other: None,
            point: Vec3::ZERO,
            normal: Vec3::ZERO,
            separation: 0.0,
            force: 0.0,
            text: String::new(),
        }
    }

    /// The record of a client's event.
    #[must_use]
    pub fn new(after: Tick, event: Event, coordinates: Coordinates) -> Self {
        let plain = |kind| Self::plain(kind, after);
        let at = |kind, tick| Self {
            tick,
            ..plain(kind)
        };
        match event {
            Event::Applied { through, tick } => Self {
                number: through,
                tick,
                ..plain(EventKind::CommandsApplied)
            },
            Event::Refused { number, error } => Self {
                number,
                ..plain(EventKind::CommandRefused)
                    .refused(&sentence(RefusalReason::Command(error)), error.body())
            },
            Event::BodyPlaced(id) => plain(EventKind::BodyPlaced).about(id),
            Event::BodyRemoved { id, cause } => Self {
                text: removal(cause).to_owned(),
                ..plain(EventKind::BodyRemoved).about(id)
            },
            Event::Body { tick, event } => Self {
                tick,
                ..Self::of_body(after, event, coordinates)
            },
            Event::EventsMissed { tick, count, .. } => Self {
                tick,
                number: count,
                ..plain(EventKind::EventsMissed)
            },
            Event::SubscriptionChanged(_) | Event::TierChanged { .. } => {
                plain(EventKind::StreamChanged)
            }
            Event::PublisherSilent { id, since } => at(EventKind::PublisherSilent, since).about(id),
            Event::PublisherActive { id, tick } => at(EventKind::PublisherActive, tick).about(id),
            Event::SceneRestored(tick) => at(EventKind::SceneRestored, tick),
            Event::SceneFaulted { tick, .. } => at(EventKind::SceneFaulted, tick),
            Event::Deleted => plain(EventKind::SceneDeleted),
            Event::Interrupted(ending) => {
                plain(EventKind::Interrupted).because(&ClientError::Ended(ending))
            }
            Event::Ended(ending) => plain(EventKind::Ended).because(&ClientError::Ended(ending)),
            Event::Resumed(state) => Self {
                tick: state.tick,
                number: state.commands,
                ..plain(EventKind::Resumed)
            },
            Event::SessionLost(state) => at(EventKind::SessionLost, state.tick),
            Event::Durable { commands, tick } => Self {
                tick,
                number: commands,
                ..plain(EventKind::Durable)
            },
            Event::AuthorityGrant(bodies) => Self {
                number: bodies.len() as u64,
                ..plain(EventKind::AuthorityGranted)
            },
            Event::AuthorityDenied(error) => {
                plain(EventKind::AuthorityDenied).refused(&error, error.body())
            }
            Event::Denied(denial) => plain(EventKind::Denied).because(&denial),
            other => plain(EventKind::Other).because(&format_args!("{other:?}")),
        }
    }

    fn of_body(after: Tick, event: BodyEvent, coordinates: Coordinates) -> Self {
        let plain = |kind, body| Self::plain(kind, after).about(body);
        let touching = |kind, body, contact| {
            let contact = coordinates.contact_out(contact);
            Self {
                other: Some(contact.with),
                point: contact.point,
                normal: contact.normal,
                separation: contact.separation,
                force: contact.force,
                ..plain(kind, body)
            }
        };
        match event {
            BodyEvent::ContactBegan { body, contact } => {
                touching(EventKind::ContactBegan, body, contact)
            }
            BodyEvent::ContactForce { body, contact } => {
                touching(EventKind::ContactForce, body, contact)
            }
            BodyEvent::ContactEnded { body, with } => {
                plain(EventKind::ContactEnded, body).with(with)
            }
            BodyEvent::SensorEntered { sensor, body } => {
                plain(EventKind::SensorEntered, sensor).with(body)
            }
            BodyEvent::SensorLeft { sensor, body } => {
                plain(EventKind::SensorLeft, sensor).with(body)
            }
            BodyEvent::FellAsleep(body) => plain(EventKind::FellAsleep, body),
            BodyEvent::Woke(body) => plain(EventKind::Woke, body),
            BodyEvent::Fault(body) => plain(EventKind::BodyFault, body),
            BodyEvent::ReachedGround(body) => plain(EventKind::ReachedGround, body),
            BodyEvent::LeftGround(body) => plain(EventKind::LeftGround, body),
        }
    }

    fn about(mut self, body: BodyId) -> Self {
        self.body = Some(body);
        self
    }

    fn with(mut self, other: BodyId) -> Self {
        self.other = Some(other);
        self
    }

    fn refused(mut self, reason: &impl ToString, body: Option<BodyId>) -> Self {
        self.body = body;
        self.text = with_words(&reason.to_string());
        self
    }

    fn because(mut self, reason: &impl ToString) -> Self {
        self.text = with_words(&reason.to_string());
        self
    }
}

const fn removal(cause: RemovalCause) -> &'static str {
    match cause {
        RemovalCause::Command => "a member removed it",
        RemovalCause::LeftWorld => "it left the bounds of the world",
        RemovalCause::NotFinite => "its state was no longer finite",
    }
}

/// A request that the server refused, and that changed nothing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RefusalRecord {
    /// The command's number; `None` for a request for authority, or of another member.
    pub number: Option<u64>,
    /// The refused request: [`RefusalReason::subject`].
    pub subject: &'static str,
    /// The body that the request is about, if that is known.
    pub body: Option<BodyId>,
    /// The reason in one or a few words, for programs.
    pub reason: &'static str,
    /// The reason, a plain sentence.
    pub text: String,
}

impl RefusalRecord {
    /// The record of a client's refusal.
    #[must_use]
    pub fn new(refusal: &RefusedRequest) -> Self {
        let (body, reason) = (refusal.body, refusal.reason);
        Self {
            number: refusal.number,
            subject: reason.subject(),
            body,
            reason: reason.word(),
            text: sentence(reason),
        }
    }
}

impl fmt::Display for RefusalRecord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the server refused {}", self.subject)?;
        if let Some(number) = self.number {
            write!(f, " {number}")?;
        }
        if let Some(body) = self.body {
            write!(f, " about body {}", packed_id(body))?;
        }
        write!(f, ": {}", self.text)
    }
}

/// The server's reason, in words of the application.
fn sentence(reason: RefusalReason) -> String {
    let count_wrong = CommandError::Invalid(Invalid::out_of_range(Quantity::Wheels));
    match reason {
        // Numbers of wheels that no vehicle has are refused before they are sent.
        RefusalReason::Command(error) if error == count_wrong => {
            "the inputs are not as many as the vehicle has wheels: give one for each wheel"
                .to_owned()
        }
        reason => with_words(&reason.to_string()),
    }
}

/// A sentence that names bodies by their words, as the application knows them, and not by index and generation.
pub(crate) fn with_words(sentence: &str) -> String {
    let mut parts = sentence.split("body ");
    let mut written = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        written.push_str("body ");
        let is_of_id = |c: char| c.is_ascii_digit() || c == '.';
        let (id, rest) = part.split_at(part.find(|c| !is_of_id(c)).unwrap_or(part.len()));
        let id = id.split_once('.').and_then(|(index, generation)| {
            Some(BodyId::new(index.parse().ok()?, generation.parse().ok()?))
        });
        match id {
            Some(id) => {
                written.push_str(&packed_id(id).to_string());
                written.push_str(rest);
            }
            None => written.push_str(part),
        }
    }
    written
}

/// A body that a query found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HitRecord {
    /// Place of the query in its batch.
    pub query: u32,
    /// The body.
    pub body: BodyId,
    /// Units of length along the way, or from the point to the surface; zero for an overlap.
    pub distance: f32,
    /// On the body's surface; zero for an overlap.
    pub point: Vec3,
    /// Outward from the surface, of unit length, or zero where there is none.
    pub normal: Vec3,
}

/// By index: one more than the latest generation, or zero.
#[derive(Debug, Default)]
pub(crate) struct KnownBodies(Vec<u32>);

impl KnownBodies {
    /// Adds a body, and those before it under its index.
    pub(crate) fn add(&mut self, body: BodyId) {
        let place = body.index() as usize;
        if place >= self.0.len() {
            self.0.resize(place + 1, 0);
        }
        self.0[place] = self.0[place].max(u32::from(body.generation()) + 1);
    }

    /// Learns from an event.
    pub(crate) fn note(&mut self, event: &EventRecord) {
        if let (EventKind::BodyPlaced | EventKind::BodyRemoved, Some(body)) =
            (event.kind, event.body)
        {
            self.add(body);
        }
    }

    /// True for a body that was added.
    pub(crate) fn has(&self, body: BodyId) -> bool {
        let latest = self.0.get(body.index() as usize);
        latest.is_some_and(|latest| u32::from(body.generation()) < *latest)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_body_has_one_number(index: u32, generation: u16) {
            let id = BodyId::new(index, generation);
            prop_assert_eq!(parse_packed_id(packed_id(id)), Ok(id));
        }

        #[test]
        fn a_number_that_names_a_body_is_that_bodys_number(number: u64) {
            if let Ok(id) = parse_packed_id(number) {
                prop_assert_eq!(packed_id(id), number);
            }
        }
    }

    #[test]
    fn a_refusal_of_too_many_inputs_of_wheels_does_not_speak_of_limits() {
        let wrong = CommandError::Invalid(Invalid::out_of_range(Quantity::Wheels));
        let text = "the inputs are not as many as the vehicle has wheels: give one for each wheel";
        assert_eq!(sentence(RefusalReason::Command(wrong)), text);
    }

    #[test]
    fn zero_and_numbers_out_of_range_name_no_body() {
        for number in [0, 1 << INDEX_BITS, 1 << 49 | 1, u64::MAX, 0x1_0000_0001] {
            assert_eq!(
                parse_packed_id(number),
                Err(InvalidPackedId(number)),
                "{number:#x}"
            );
        }
        assert_eq!(packed_id(BodyId::new(0, 0)), 1);
    }

    #[test]
    fn a_sentence_names_all_bodies_by_their_words() {
        let (one, other) = (BodyId::new(4, 0), BodyId::new(1, 2));
        let sentence = format!("a joint joins {one} to {other}; a body is 1.5 m long, body 3 not");
        let words = [one, other].map(packed_id);
        let expected = format!(
            "a joint joins body {} to body {}; a body is 1.5 m long, body 3 not",
            words[0], words[1]
        );
        assert_eq!(with_words(&sentence), expected);
        assert_eq!(with_words("the body is"), "the body is");
    }

    #[test]
    fn a_sentence_names_the_body_by_its_word() {
        let id = BodyId::new(4, 0);
        let refusal = RefusedRequest {
            number: Some(7),
            body: Some(id),
            reason: RefusalReason::Command(CommandError::UnknownBody(id)),
        };
        let record = RefusalRecord::new(&refusal);
        assert_eq!(record.reason, "unknown body");
        let text = "the server refused command 7 about body 5: the scene has no body 5";
        assert_eq!(record.to_string(), text);
    }

    #[test]
    fn a_body_is_known_with_those_before_it_and_not_with_later_ones() {
        let mut known = KnownBodies::default();
        known.add(BodyId::new(3, 1));
        let has = |index, generation| known.has(BodyId::new(index, generation));
        assert_eq!([has(3, 0), has(3, 1), has(3, 2)], [true, true, false]);
        assert_eq!([has(0, 0), has(4, 0)], [false, false]);
    }
}
