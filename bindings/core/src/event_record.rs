//! An event of a scene, as plain fields in the coordinates of the application.

use glam::Vec3;
use rhumb_client::scene::BodyEvent;
use rhumb_client::{BodyId, ClientError, Event, RemovalCause, Tick};

use crate::coordinates::Coordinates;
use crate::generated::EventKind;
use crate::refusal_record::with_words;

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
                ..plain(EventKind::CommandRefused).refused(&error, error.body())
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
            Event::EventsMissed { tick, count } => Self {
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
