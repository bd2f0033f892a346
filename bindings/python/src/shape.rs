//! Shapes.

use pyo3::prelude::*;
use rhumb_bindings::rhumb_client::glam::Quat;
use rhumb_bindings::rhumb_client::scene::{self, Compound, Heights, Hull, Invalid, Mesh, Part};

use crate::arguments::{heights, points, rotation, triangles, vector};
use crate::errors::exception;

/// A part of a compound: shape, position, and rotation if it is turned.
#[derive(FromPyObject)]
enum PartTuple<'py> {
    Turned(Bound<'py, PyShape>, Bound<'py, PyAny>, Bound<'py, PyAny>),
    Plain(Bound<'py, PyShape>, Bound<'py, PyAny>),
}

/// A shape, centred on its body's centre of mass; long axes point up.
#[pyclass(frozen, name = "Shape", module = "rhumb")]
pub(crate) struct PyShape {
    pub(crate) shape: scene::Shape,
}

impl PyShape {
    fn checked(py: Python<'_>, shape: Result<scene::Shape, Invalid>) -> PyResult<Self> {
        let shape = shape.map_err(|invalid| exception(py, &invalid.into()))?;
        Ok(Self { shape })
    }
}

#[pymethods]
impl PyShape {
    #[staticmethod]
    const fn ball(radius: f32) -> Self {
        let shape = scene::Shape::ball(radius);
        Self { shape }
    }

    #[staticmethod]
    const fn cuboid(x: f32, y: f32, z: f32) -> Self {
        let shape = scene::Shape::cuboid(x, y, z);
        Self { shape }
    }

    #[staticmethod]
    fn rounded_cuboid(x: f32, y: f32, z: f32, radius: f32) -> Self {
        let half_extents = [x, y, z].into();
        let shape = scene::Shape::RoundedCuboid {
            half_extents,
            radius,
        };
        Self { shape }
    }

    #[staticmethod]
    const fn capsule(half_height: f32, radius: f32) -> Self {
        let shape = scene::Shape::capsule(half_height, radius);
        Self { shape }
    }

    #[staticmethod]
    const fn cylinder(half_height: f32, radius: f32) -> Self {
        let shape = scene::Shape::cylinder(half_height, radius);
        Self { shape }
    }

    #[staticmethod]
    const fn cone(half_height: f32, radius: f32) -> Self {
        let shape = scene::Shape::cone(half_height, radius);
        Self { shape }
    }

    #[staticmethod]
    fn half_space(normal: &Bound<'_, PyAny>) -> PyResult<Self> {
        let normal = vector(normal, "normal")?;
        let shape = scene::Shape::HalfSpace { normal };
        Ok(Self { shape })
    }

    #[staticmethod]
    #[pyo3(name = "hull")]
    fn of_points(py: Python<'_>, points: &Bound<'_, PyAny>) -> PyResult<Self> {
        let points = self::points(points, "points")?;
        Self::checked(py, Hull::new(&points).map(scene::Shape::Hull))
    }

    #[staticmethod]
    #[pyo3(name = "mesh")]
    fn of_triangles(
        py: Python<'_>,
        points: &Bound<'_, PyAny>,
        triangles: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let (points, triangles) = (self::points(points, "points")?, self::triangles(triangles)?);
        Self::checked(py, Mesh::new(&points, &triangles).map(scene::Shape::Mesh))
    }

    #[staticmethod]
    #[pyo3(name = "heights", signature = (heights, row_spacing = 1.0, column_spacing = 1.0))]
    fn of_heights(
        py: Python<'_>,
        heights: &Bound<'_, PyAny>,
        row_spacing: f32,
        column_spacing: f32,
    ) -> PyResult<Self> {
        let (rows, heights) = self::heights(heights)?;
        let field = Heights::new(rows, row_spacing, column_spacing, &heights);
        Self::checked(py, field.map(scene::Shape::Heights))
    }

    #[staticmethod]
    #[pyo3(name = "compound")]
    fn of_parts(py: Python<'_>, parts: Vec<PartTuple<'_>>) -> PyResult<Self> {
        let parts = parts.into_iter().map(|part| {
            let (shape, at, turned) = match part {
                PartTuple::Turned(shape, at, turned) => (shape, at, Some(turned)),
                PartTuple::Plain(shape, at) => (shape, at, None),
            };
            let turned = turned.as_ref();
            Ok(Part {
                position: vector(&at, "position")?,
                rotation: turned
                    .map_or(Ok(Quat::IDENTITY), |turned| rotation(turned, "rotation"))?,
                shape: shape.get().shape.clone(),
            })
        });
        let parts = parts.collect::<PyResult<Vec<_>>>()?;
        Self::checked(py, Compound::new(parts).map(scene::Shape::Compound))
    }

    fn __repr__(&self) -> String {
        format!("{:?}", self.shape)
    }
}
