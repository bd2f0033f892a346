//! Shapes.

use pyo3::prelude::*;
use rhumb_bindings::rhumb_client::glam::Quat;
use rhumb_bindings::rhumb_client::scene::{
    self, Compound, Edges, Heights, Hull, Invalid, Mesh, Part,
};

use crate::arguments::{heights, one_of, points, rotation, triangles, vector};
use crate::errors::{check_in_any, exception};
use crate::number;

/// A part of a compound: shape, position, and rotation if it is turned.
#[derive(FromPyObject)]
enum PartTuple<'py> {
    Turned(Bound<'py, PyShape>, Bound<'py, PyAny>, Bound<'py, PyAny>),
    Plain(Bound<'py, PyShape>, Bound<'py, PyAny>),
}

/// A shape. Its origin is its body's centre of mass, but for hulls and compounds: see centre. Long axes point up. Lengths are in
/// the scene's unit.
///
/// Make one with Shape.ball, cuboid, rounded_cuboid, capsule, cylinder, cone, half_space, hull, mesh, heights or compound.
/// Each extent is 0.001 to 10,000 metres.
#[pyclass(frozen, name = "Shape", module = "rhumb")]
pub(crate) struct PyShape {
    pub(crate) shape: scene::Shape,
}

impl PyShape {
    fn checked(py: Python<'_>, shape: Result<scene::Shape, Invalid>) -> PyResult<Self> {
        let shape = shape.map_err(|invalid| exception(py, &invalid.into()))?;
        check_in_any(py, |coordinates| {
            coordinates.shape_in(shape.clone())?.check()
        })?;
        Ok(Self { shape })
    }
}

const EDGES: [(&str, Edges); 2] = [("plain", Edges::Plain), ("smooth", Edges::Smooth)];

fn edges_of(py: Python<'_>, word: Option<&str>) -> PyResult<Edges> {
    word.map_or(Ok(Edges::default()), |word| {
        one_of(py, &EDGES, word, "edges")
    })
}

#[pymethods]
impl PyShape {
    /// A sphere.
    #[staticmethod]
    fn ball(
        py: Python<'_>,
        #[pyo3(from_py_with = number::single::radius)] radius: f32,
    ) -> PyResult<Self> {
        let shape = scene::Shape::ball(radius);
        Self::checked(py, Ok(shape))
    }

    /// A box, by half its edge lengths: cuboid(0.5, 0.5, 0.5) is a cube of edge 1.
    #[staticmethod]
    fn cuboid(
        py: Python<'_>,
        #[pyo3(from_py_with = number::single::x)] x: f32,
        #[pyo3(from_py_with = number::single::y)] y: f32,
        #[pyo3(from_py_with = number::single::z)] z: f32,
    ) -> PyResult<Self> {
        let shape = scene::Shape::cuboid(x, y, z);
        Self::checked(py, Ok(shape))
    }

    /// A box with round edges: every point within the radius of a box, which is given by half its edge lengths.
    #[staticmethod]
    fn rounded_cuboid(
        py: Python<'_>,
        #[pyo3(from_py_with = number::single::x)] x: f32,
        #[pyo3(from_py_with = number::single::y)] y: f32,
        #[pyo3(from_py_with = number::single::z)] z: f32,
        #[pyo3(from_py_with = number::single::radius)] radius: f32,
    ) -> PyResult<Self> {
        let half_extents = [x, y, z].into();
        let shape = scene::Shape::RoundedCuboid {
            half_extents,
            radius,
        };
        Self::checked(py, Ok(shape))
    }

    /// A cylinder with half balls on its ends, by half the length of its straight part.
    #[staticmethod]
    fn capsule(
        py: Python<'_>,
        #[pyo3(from_py_with = number::single::half_height)] half_height: f32,
        #[pyo3(from_py_with = number::single::radius)] radius: f32,
    ) -> PyResult<Self> {
        let shape = scene::Shape::capsule(half_height, radius);
        Self::checked(py, Ok(shape))
    }

    /// A cylinder, by half its length.
    #[staticmethod]
    fn cylinder(
        py: Python<'_>,
        #[pyo3(from_py_with = number::single::half_height)] half_height: f32,
        #[pyo3(from_py_with = number::single::radius)] radius: f32,
    ) -> PyResult<Self> {
        let shape = scene::Shape::cylinder(half_height, radius);
        Self::checked(py, Ok(shape))
    }

    /// A cone whose tip points up, by half its height.
    #[staticmethod]
    fn cone(
        py: Python<'_>,
        #[pyo3(from_py_with = number::single::half_height)] half_height: f32,
        #[pyo3(from_py_with = number::single::radius)] radius: f32,
    ) -> PyResult<Self> {
        let shape = scene::Shape::cone(half_height, radius);
        Self::checked(py, Ok(shape))
    }

    /// Everything behind a plane, whose normal points out of it. For fixed bodies.
    #[staticmethod]
    fn half_space(py: Python<'_>, normal: &Bound<'_, PyAny>) -> PyResult<Self> {
        let normal = vector(normal, "normal")?;
        Self::checked(py, Ok(scene::Shape::HalfSpace { normal }))
    }

    /// The convex hull of rows of three numbers, from any origin: see centre. At most 255 corners; other points are left out.
    #[staticmethod]
    #[pyo3(name = "hull")]
    fn of_points(py: Python<'_>, points: &Bound<'_, PyAny>) -> PyResult<Self> {
        let points = self::points(points, "points")?;
        Self::checked(py, Hull::new(&points).map(scene::Shape::Hull))
    }

    /// A mesh of triangles, each a row of three places of points. For fixed and kinematic bodies.
    ///
    /// edges: "smooth", the default: bodies slide and roll over flat ground as over one face; "plain": each triangle is
    /// touched as if it were alone, so that they may catch on its edges.
    #[staticmethod]
    #[pyo3(name = "mesh", signature = (points, triangles, *, edges = None))]
    fn of_triangles(
        py: Python<'_>,
        points: &Bound<'_, PyAny>,
        triangles: &Bound<'_, PyAny>,
        edges: Option<&str>,
    ) -> PyResult<Self> {
        let (points, triangles) = (self::points(points, "points")?, self::triangles(triangles)?);
        let edges = edges_of(py, edges)?;
        let mesh = Mesh::new(&points, &triangles).map(|mesh| mesh.with_edges(edges));
        Self::checked(py, mesh.map(scene::Shape::Mesh))
    }

    /// A field of heights by row and column. For fixed and kinematic bodies.
    ///
    /// The first post is at the body's origin; the rows follow each other along x, the columns along the other axis of the
    /// ground. edges: as of a mesh; with "smooth" ones the field is touched from above only.
    #[staticmethod]
    #[pyo3(name = "heights", signature = (heights, row_spacing = 1.0, column_spacing = 1.0, *, edges = None))]
    fn of_heights(
        py: Python<'_>,
        heights: &Bound<'_, PyAny>,
        #[pyo3(from_py_with = number::single::row_spacing)] row_spacing: f32,
        #[pyo3(from_py_with = number::single::column_spacing)] column_spacing: f32,
        edges: Option<&str>,
    ) -> PyResult<Self> {
        let (rows, heights) = self::heights(heights)?;
        let edges = edges_of(py, edges)?;
        let field = Heights::new(rows, row_spacing, column_spacing, &heights);
        let field = field.map(|field| field.with_edges(edges));
        Self::checked(py, field.map(scene::Shape::Heights))
    }

    /// Several shapes in the axes of a body: shape, position, and a rotation if it is turned.
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

    /// The centre of mass at an even density, from the origin of the shape and in its axes.
    ///
    /// Hulls and compounds alone have another than the origin. A body of such a shape is placed by the origin, and so is
    /// every pose of it that this client gives and gets; forces act at the centre. Other members see the body from its
    /// centre of mass.
    #[getter]
    fn centre(&self) -> (f32, f32, f32) {
        self.shape.centre().unwrap_or_default().into()
    }

    /// The shape moved so that its centre of mass is the origin, and the centre: where that was.
    fn centred(&self) -> (Self, (f32, f32, f32)) {
        let (shape, centre) = self.shape.centred();
        (Self { shape }, centre.into())
    }

    fn __repr__(&self) -> String {
        written(&self.shape)
    }
}

/// A shape as Python writes it; of many numbers only how many.
pub(crate) fn written(shape: &scene::Shape) -> String {
    match shape {
        scene::Shape::Ball { radius } => format!("Shape.ball({radius})"),
        scene::Shape::Cuboid { half_extents: half } => {
            format!("Shape.cuboid({}, {}, {})", half.x, half.y, half.z)
        }
        scene::Shape::RoundedCuboid {
            half_extents: half,
            radius,
        } => format!(
            "Shape.rounded_cuboid({}, {}, {}, {radius})",
            half.x, half.y, half.z
        ),
        scene::Shape::Capsule {
            half_height,
            radius,
        } => format!("Shape.capsule({half_height}, {radius})"),
        scene::Shape::Cylinder {
            half_height,
            radius,
        } => format!("Shape.cylinder({half_height}, {radius})"),
        scene::Shape::Cone {
            half_height,
            radius,
        } => format!("Shape.cone({half_height}, {radius})"),
        scene::Shape::HalfSpace { normal } => {
            format!(
                "Shape.half_space(({}, {}, {}))",
                normal.x, normal.y, normal.z
            )
        }
        scene::Shape::Hull(hull) => format!("Shape.hull(<{} points>)", hull.points().len()),
        scene::Shape::Mesh(mesh) => format!(
            "Shape.mesh(<{} points>, <{} triangles>)",
            mesh.points().len(),
            mesh.triangles().len()
        ),
        scene::Shape::Heights(field) => format!(
            "Shape.heights(<{} by {} heights>, {}, {})",
            field.rows(),
            field.columns(),
            field.row_spacing(),
            field.column_spacing()
        ),
        scene::Shape::Compound(compound) => {
            let parts = compound.parts().iter().map(|part| written(&part.shape));
            format!("Shape.compound(<{}>)", parts.collect::<Vec<_>>().join(", "))
        }
    }
}
