//! Queries and what they find.

use pyo3::prelude::*;
use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::rhumb_client::scene::{self, QueryKind};
use rhumb_bindings::{HitRecord, packed_id};

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
