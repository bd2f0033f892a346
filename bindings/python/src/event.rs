//! Events.

use pyo3::prelude::*;
use rhumb_bindings::rhumb_client::BodyId;
use rhumb_bindings::{EventRecord, body_word};

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
            kind: record.kind.word(),
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
