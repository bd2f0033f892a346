//! Answers of a scene: hits of queries, events, requests of followers.

use pyo3::prelude::*;
use rhumb_bindings::rhumb_client::BodyId;
use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::rhumb_client::scene::{self, QueryKind};
use rhumb_bindings::{ContactRecord, EventRecord, HitRecord, RequestRecord, packed_id};

use crate::arguments::{rotation, single, vector};
use crate::body::{PyShape, written};
use crate::errors::{check_in_any, wrong, wrong_value};
use crate::number;

/// A question about where the bodies are, for Scene.query: Query.ray, shape_cast, projection, overlap or
/// contacts.
///
/// hits is the most bodies that it finds, 1 to 64. among changes which bodies count.
#[pyclass(frozen, name = "Query", module = "rhumb")]
pub(crate) struct PyQuery {
    pub(crate) query: scene::Query,
}

impl PyQuery {
    /// The query with its number of hits, if some scene can be asked it.
    fn checked(py: Python<'_>, query: scene::Query, hits: u32) -> PyResult<Self> {
        let allowed = 1..=scene::Query::HITS_MAX;
        let most = u8::try_from(hits)
            .ok()
            .filter(|hits| allowed.contains(hits));
        let needed = format_args!("1 to {}", scene::Query::HITS_MAX);
        let most = most.ok_or_else(|| wrong_value(py, "hits", hits, needed))?;
        let query = query.finding(most);
        check_in_any(py, |coordinates| {
            coordinates.query_in(query.clone())?.check()
        })?;
        Ok(Self { query })
    }
}

#[pymethods]
impl PyQuery {
    /// The nearest bodies along a line from origin to origin + translation. Sensors do not count.
    ///
    /// A body whose surface the line only reaches with its end is not hit.
    #[staticmethod]
    #[pyo3(signature = (origin, translation, *, hits = 1))]
    fn ray(
        py: Python<'_>,
        origin: &Bound<'_, PyAny>,
        translation: &Bound<'_, PyAny>,
        #[pyo3(from_py_with = number::whole::hits)] hits: u32,
    ) -> PyResult<Self> {
        let (origin, way) = (
            vector(origin, "origin")?,
            vector(translation, "translation")?,
        );
        Self::checked(py, scene::Query::ray(origin, way), hits)
    }

    /// The nearest bodies that a shape touches on its way: a ball, cuboid, rounded cuboid, capsule, cylinder or cone.
    #[staticmethod]
    #[pyo3(signature = (shape, position, translation, *, rotation = None, hits = 1))]
    fn shape_cast(
        py: Python<'_>,
        shape: &Bound<'_, PyShape>,
        position: &Bound<'_, PyAny>,
        translation: &Bound<'_, PyAny>,
        rotation: Option<&Bound<'_, PyAny>>,
        #[pyo3(from_py_with = number::whole::hits)] hits: u32,
    ) -> PyResult<Self> {
        let shape = simple(shape)?;
        let (position, turned) = (vector(position, "position")?, turned(rotation)?);
        let way = vector(translation, "translation")?;
        let query = scene::Query::shape_cast(shape, position, turned, way);
        Self::checked(py, query, hits)
    }

    /// The bodies whose surfaces are nearest to a point, within a distance.
    #[staticmethod]
    #[pyo3(signature = (point, distance, *, hits = 1))]
    fn projection(
        py: Python<'_>,
        point: &Bound<'_, PyAny>,
        #[pyo3(from_py_with = number::single::distance)] distance: f32,
        #[pyo3(from_py_with = number::whole::hits)] hits: u32,
    ) -> PyResult<Self> {
        let point = vector(point, "point")?;
        let query = scene::Query::projection(point, distance);
        Self::checked(py, query, hits)
    }

    /// The bodies that a shape overlaps: a ball, cuboid, rounded cuboid, capsule, cylinder or cone.
    #[staticmethod]
    #[pyo3(signature = (shape, position, *, rotation = None, hits = 64))]
    fn overlap(
        py: Python<'_>,
        shape: &Bound<'_, PyShape>,
        position: &Bound<'_, PyAny>,
        rotation: Option<&Bound<'_, PyAny>>,
        #[pyo3(from_py_with = number::whole::hits)] hits: u32,
    ) -> PyResult<Self> {
        let (position, turned) = (vector(position, "position")?, turned(rotation)?);
        let query = scene::Query::overlap(simple(shape)?, position, turned);
        Self::checked(py, query, hits)
    }

    /// The bodies that touch a body after the last step, the deepest contact first: the points of its hits lie on the body
    /// that is asked about.
    #[staticmethod]
    #[pyo3(signature = (body, *, hits = 64))]
    fn contacts(
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        #[pyo3(from_py_with = number::whole::hits)] hits: u32,
    ) -> PyResult<Self> {
        Self::checked(py, scene::Query::contacts(single(body)?), hits)
    }

    /// The same question about some bodies: of these kinds, of a group in the bits of groups, but not the one excluded.
    #[pyo3(signature = (*, fixed = true, dynamic = true, kinematic = true, sensors = false, groups = 4_294_967_295, excluding = None))]
    fn among(
        &self,
        fixed: bool,
        dynamic: bool,
        kinematic: bool,
        sensors: bool,
        #[pyo3(from_py_with = number::whole::groups)] groups: u32,
        excluding: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let except = excluding.map(single);
        let filter = scene::QueryFilter {
            with_fixed: fixed,
            with_dynamic: dynamic,
            with_kinematic: kinematic,
            with_sensors: sensors,
            except: except.transpose()?,
            groups,
        };
        let query = self.query.clone().among(filter);
        Ok(Self { query })
    }

    fn __repr__(&self) -> String {
        let way = |from: Vec3| format!("({}, {}, {})", from.x, from.y, from.z);
        let hits = self.query.hits;
        let mut text = match &self.query.kind {
            QueryKind::Ray {
                origin,
                translation,
            } => format!(
                "Query.ray({}, {}, hits={hits})",
                way(*origin),
                way(*translation)
            ),
            QueryKind::ShapeCast {
                shape,
                position,
                translation,
                ..
            } => format!(
                "Query.shape_cast({}, {}, {}, hits={hits})",
                written(shape),
                way(*position),
                way(*translation)
            ),
            QueryKind::Projection { point, distance } => {
                format!("Query.projection({}, {distance}, hits={hits})", way(*point))
            }
            QueryKind::Overlap {
                shape, position, ..
            } => format!(
                "Query.overlap({}, {}, hits={hits})",
                written(shape),
                way(*position)
            ),
            QueryKind::Contacts { body } => {
                format!("Query.contacts({}, hits={hits})", packed_id(*body))
            }
        };
        if self.query.filter != scene::QueryFilter::DEFAULT {
            text += ".among(...)";
        }
        text
    }
}

fn turned(rotation: Option<&Bound<'_, PyAny>>) -> PyResult<Quat> {
    rotation.map_or(Ok(Quat::IDENTITY), |turned| {
        self::rotation(turned, "rotation")
    })
}

fn simple(shape: &Bound<'_, PyShape>) -> PyResult<scene::Shape> {
    let simple = &shape.get().shape;
    match scene::Query::allows(simple) {
        true => Ok(simple.clone()),
        false => Err(wrong(shape.py(), "shape", "of a simple kind for a query")),
    }
}

/// A body that a query found.
#[pyclass(frozen, get_all, name = "Hit", module = "rhumb")]
pub(crate) struct PyHit {
    /// The body's id.
    body: u64,
    /// Along the way, from the point to the surface, or from surface to surface, negative inside; zero for an overlap.
    distance: f32,
    /// On the body's surface; zero for an overlap.
    point: (f32, f32, f32),
    /// Outward from the surface, of unit length; zero where there is none, as for a ray that begins inside.
    normal: (f32, f32, f32),
}

impl PyHit {
    /// The hits of each of so many queries.
    pub(crate) fn of_each(queries: usize, records: &[HitRecord]) -> Vec<Vec<Self>> {
        let mut hits: Vec<_> = (0..queries).map(|_| Vec::new()).collect();
        for record in records {
            hits[record.query as usize].push(Self::new(record));
        }
        hits
    }

    fn new(record: &HitRecord) -> Self {
        Self {
            body: packed_id(record.body),
            distance: record.distance,
            point: record.point.into(),
            normal: record.normal.into(),
        }
    }
}

#[pymethods]
impl PyHit {
    fn __repr__(&self) -> String {
        let Self {
            body,
            distance,
            point,
            normal,
        } = self;
        format!("Hit(body={body}, distance={distance}, point={point:?}, normal={normal:?})")
    }
}

/// Something that happened, or the answer to a command. A field that its kind does not name is zero, None or empty.
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

/// A request of another member of a scene that this program feeds, of Scene.requests. A field that its kind does not name is None.
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
        self.record.kind.word()
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
