//! Events.

use pyo3::prelude::*;
use rhumb_bindings::rhumb_client::BodyId;
use rhumb_bindings::{EventKind, EventRecord, body_word};

/// Something that happened, or the answer to a command.
#[pyclass(frozen, get_all, name = "Event", module = "rhumb")]
pub(crate) struct PyEvent {
    kind: &'static str,
    after: u64,
    tick: u64,
    number: u64,
    body: Option<u64>,
    other: Option<u64>,
    point: (f32, f32, f32),
    normal: (f32, f32, f32),
    separation: f32,
    force: f32,
    text: String,
}

impl PyEvent {
    pub(crate) fn new(record: EventRecord) -> Self {
        let word = |id: Option<BodyId>| id.map(body_word);
        Self {
            kind: word_of(record.kind),
            after: record.after.value(),
            tick: record.tick.value(),
            number: record.number,
            body: word(record.body),
            other: word(record.other),
            point: record.point.into(),
            normal: record.normal.into(),
            separation: record.separation,
            force: record.force,
            text: record.text,
        }
    }
}

#[pymethods]
impl PyEvent {
    fn __repr__(&self) -> String {
        let Self {
            kind,
            tick,
            number,
            body,
            other,
            text,
            ..
        } = self;
        let word = |body: &Option<u64>| body.map_or("None".to_owned(), |body| body.to_string());
        let (body, other) = (word(body), word(other));
        format!(
            "Event({kind:?}, tick={tick}, number={number}, body={body}, other={other}, text={text:?})"
        )
    }
}

const fn word_of(kind: EventKind) -> &'static str {
    match kind {
        EventKind::CommandsApplied => "commands applied",
        EventKind::CommandRefused => "command refused",
        EventKind::BodyPlaced => "body placed",
        EventKind::BodyRemoved => "body removed",
        EventKind::ContactBegan => "contact began",
        EventKind::ContactEnded => "contact ended",
        EventKind::ContactForce => "contact force",
        EventKind::SensorEntered => "sensor entered",
        EventKind::SensorLeft => "sensor left",
        EventKind::FellAsleep => "fell asleep",
        EventKind::Woke => "woke",
        EventKind::BodyFault => "body fault",
        EventKind::EventsMissed => "events missed",
        EventKind::StreamChanged => "stream changed",
        EventKind::SceneRestored => "scene restored",
        EventKind::SceneFaulted => "scene faulted",
        EventKind::SceneDeleted => "scene deleted",
        EventKind::Interrupted => "interrupted",
        EventKind::Resumed => "resumed",
        EventKind::SessionLost => "session lost",
        EventKind::Durable => "durable",
        EventKind::AuthorityGranted => "authority granted",
        EventKind::AuthorityDenied => "authority denied",
        EventKind::Denied => "denied",
        EventKind::Ended => "ended",
        EventKind::Other => "other",
    }
}
