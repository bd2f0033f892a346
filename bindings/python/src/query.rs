//! Queries and what they find.

use pyo3::prelude::*;
use rhumb_bindings::rhumb_client::glam::Quat;
use rhumb_bindings::rhumb_client::scene;
use rhumb_bindings::{HitRecord, body_word};

use crate::arguments::{rotation, single, vector};
use crate::errors::wrong;
use crate::shape::PyShape;

/// A question about where the bodies are.
#[pyclass(frozen, name = "Query", module = "rhumb")]
pub(crate) struct PyQuery {
    pub(crate) query: scene::Query,
}

#[pymethods]
impl PyQuery {
    #[staticmethod]
    #[pyo3(signature = (origin, translation, *, hits = 1))]
    fn ray(origin: &Bound<'_, PyAny>, translation: &Bound<'_, PyAny>, hits: u8) -> PyResult<Self> {
        let (origin, way) = (
            vector(origin, "origin")?,
            vector(translation, "translation")?,
        );
        let query = scene::Query::ray(origin, way).finding(hits);
        Ok(Self { query })
    }

    #[staticmethod]
    #[pyo3(signature = (shape, position, translation, *, rotation = None, hits = 1))]
    fn shape_cast(
        shape: &Bound<'_, PyShape>,
        position: &Bound<'_, PyAny>,
        translation: &Bound<'_, PyAny>,
        rotation: Option<&Bound<'_, PyAny>>,
        hits: u8,
    ) -> PyResult<Self> {
        let shape = simple(shape)?;
        let (position, turned) = (vector(position, "position")?, turned(rotation)?);
        let way = vector(translation, "translation")?;
        let query = scene::Query::shape_cast(shape, position, turned, way).finding(hits);
        Ok(Self { query })
    }

    #[staticmethod]
    #[pyo3(signature = (point, distance, *, hits = 1))]
    fn projection(point: &Bound<'_, PyAny>, distance: f32, hits: u8) -> PyResult<Self> {
        let point = vector(point, "point")?;
        let query = scene::Query::projection(point, distance).finding(hits);
        Ok(Self { query })
    }

    #[staticmethod]
    #[pyo3(signature = (shape, position, *, rotation = None, hits = 64))]
    fn overlap(
        shape: &Bound<'_, PyShape>,
        position: &Bound<'_, PyAny>,
        rotation: Option<&Bound<'_, PyAny>>,
        hits: u8,
    ) -> PyResult<Self> {
        let (position, turned) = (vector(position, "position")?, turned(rotation)?);
        let query = scene::Query::overlap(simple(shape)?, position, turned).finding(hits);
        Ok(Self { query })
    }

    /// The same question about other bodies.
    #[pyo3(signature = (*, fixed = true, dynamic = true, kinematic = true, sensors = false, groups = 4_294_967_295, excluding = None))]
    fn among(
        &self,
        fixed: bool,
        dynamic: bool,
        kinematic: bool,
        sensors: bool,
        groups: u32,
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
        format!("{:?}", self.query)
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
    body: u64,
    distance: f32,
    point: (f32, f32, f32),
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
            body: body_word(record.body),
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
