//! Events, and requests of followers.

use pyo3::prelude::*;
use rhumb_bindings::rhumb_client::BodyId;
use rhumb_bindings::{ContactRecord, EventRecord, RequestRecord, packed_id};

/// Something that happened, or the answer to a command. What its kind does not name is zero, None or empty.
#[pyclass(frozen, get_all, name = "Event", module = "rhumb")]
pub(crate) struct PyEvent {
    /// One of: "commands applied", "command refused", "body placed", "body removed", "contact began", "contact
    /// ended", "contact force", "sensor entered", "sensor left", "fell asleep", "woke", "body fault", "reached
    /// ground", "left ground", "events missed", "stream changed", "publisher silent", "publisher active", "scene
    /// restored", "scene faulted", "scene deleted", "interrupted", "resumed", "session lost", "durable",
    /// "authority granted", "authority denied", "denied", "ended", "other".
    kind: &'static str,
    /// The newest complete tick when the event was read: no view of an earlier tick shows its effect.
    after: u64,
    /// The tick in which it happened, if the server says so; otherwise the same as `after`.
    tick: u64,
    /// The command's number, or the count that the kind names.
    number: u64,
    /// The body that the kind names; of a contact the first one, of a sensor the sensor.
    body: Option<u64>,
    /// The other body.
    other: Option<u64>,
    /// Of a contact: a point on the body.
    point: (f32, f32, f32),
    /// Of a contact: from the other body towards the body, of unit length.
    normal: (f32, f32, f32),
    /// Of a contact: units of length; negative where the bodies overlap.
    separation: f32,
    /// Of a contact: the sum of all forces between the bodies.
    force: f32,
    /// A reason, a sentence; empty for most kinds.
    text: String,
}

impl PyEvent {
    pub(crate) fn new(record: EventRecord) -> Self {
        let word = |id: Option<BodyId>| id.map(packed_id);
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
        let mut fields = format!("Event({:?}, tick={}", self.kind, self.tick);
        let mut field = |name: &str, value: String| fields.extend([", ", name, "=", &value]);
        if self.number != 0 {
            field("number", self.number.to_string());
        }
        for (name, body) in [("body", self.body), ("other", self.other)] {
            if let Some(body) = body {
                field(name, body.to_string());
            }
        }
        if self.normal != (0.0, 0.0, 0.0) {
            field("point", format!("{:?}", self.point));
            field("normal", format!("{:?}", self.normal));
            field("separation", self.separation.to_string());
            field("force", self.force.to_string());
        }
        if !self.text.is_empty() {
            field("text", format!("{:?}", self.text));
        }
        fields + ")"
    }
}

/// Two bodies that touch now, of Scene.contacts.
#[pyclass(frozen, get_all, name = "Contact", module = "rhumb")]
pub(crate) struct PyContact {
    /// The body that was asked for, or the first one.
    body: u64,
    /// The body that it touches.
    other: u64,
    /// Of the deepest contact: a point on the first body, as of the last event about the two.
    point: (f32, f32, f32),
    /// From the other body towards this one, of unit length.
    normal: (f32, f32, f32),
    /// Units of length; negative where they overlap.
    separation: f32,
    /// The sum of all forces between the two.
    force: f32,
    /// The tick of the last event about the two.
    tick: u64,
}

impl PyContact {
    pub(crate) fn new(record: &ContactRecord) -> Self {
        Self {
            body: packed_id(record.body),
            other: packed_id(record.other),
            point: record.point.into(),
            normal: record.normal.into(),
            separation: record.separation,
            force: record.force,
            tick: record.tick.value(),
        }
    }
}

#[pymethods]
impl PyContact {
    fn __repr__(&self) -> String {
        let Self {
            body,
            other,
            point,
            normal,
            separation,
            force,
            tick,
        } = self;
        format!(
            "Contact(body={body}, other={other}, point={point:?}, normal={normal:?}, separation={separation}, \
             force={force}, tick={tick})"
        )
    }
}

/// A request of another member of a scene that this program feeds, of Scene.requests. What its kind does not name is None.
#[pyclass(frozen, name = "Request", module = "rhumb")]
pub(crate) struct PyRequest {
    pub(crate) record: RequestRecord,
}

impl PyRequest {
    pub(crate) const fn new(record: RequestRecord) -> Self {
        Self { record }
    }
}

#[pymethods]
impl PyRequest {
    /// One of: "add body", "remove body", "change body", "set pose", "set velocity", "apply force", "apply torque",
    /// "apply impulse", "apply torque impulse", "sleep", "wake", "set gravity", "add joint", "change joint", "remove joint".
    #[getter]
    const fn kind(&self) -> &'static str {
        self.record.kind.words()
    }

    /// The body that it is about; of a joint the first one.
    #[getter]
    fn body(&self) -> Option<u64> {
        self.record.body.map(packed_id)
    }

    /// The client that the member's token names, if it has one.
    #[getter]
    fn client(&self) -> Option<String> {
        let client = self.record.request.client.as_ref();
        client.map(ToString::to_string)
    }

    /// The number of the member's command.
    #[getter]
    const fn number(&self) -> u64 {
        self.record.request.number
    }

    /// Of a body or a pose: the centre of mass.
    #[getter]
    fn position(&self) -> Option<(f32, f32, f32)> {
        self.record.position.map(Into::into)
    }

    /// Of a body or a pose: a unit quaternion x, y, z, w, body to world.
    #[getter]
    fn rotation(&self) -> Option<(f32, f32, f32, f32)> {
        self.record.rotation.map(Into::into)
    }

    /// Of a body or a velocity: units of length per second.
    #[getter]
    fn linear_velocity(&self) -> Option<(f32, f32, f32)> {
        self.record.linear_velocity.map(Into::into)
    }

    /// Of a body or a velocity: rad/s about world axes.
    #[getter]
    fn angular_velocity(&self) -> Option<(f32, f32, f32)> {
        self.record.angular_velocity.map(Into::into)
    }

    /// The force, torque, impulse or gravity.
    #[getter]
    fn vector(&self) -> Option<(f32, f32, f32)> {
        self.record.vector.map(Into::into)
    }

    /// The point of the world where a force or an impulse acts, if not at the centre of mass.
    #[getter]
    fn point(&self) -> Option<(f32, f32, f32)> {
        self.record.point.map(Into::into)
    }

    fn __repr__(&self) -> String {
        let body = self.body().map(|body| format!(", body={body}"));
        let (kind, number) = (self.kind(), self.number());
        format!(
            "Request({kind:?}, number={number}{})",
            body.unwrap_or_default()
        )
    }
}
