//! Shapes, bodies and joints to add, and rows of bodies' states.

use std::collections::BTreeMap;

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::rhumb_client::scene::{
    self, BodyKind, CollisionGroups, Command, Compound, Edges, Heights, Hull, Invalid, Joint,
    JointFrame, JointId, JointLimits, JointStrength, LockedAxes, Material, Mesh, Motor, Part,
};
use rhumb_bindings::rhumb_client::{Damping, ToleranceScale};
use rhumb_bindings::{
    BodyParams, FedArrays, JointFreedom, JointParams, Rows, StateRecord, packed_id,
};

use crate::arguments::{
    GivenRows, bodies, heights, one_of, optional_rows, packed_bodies, points, rotation, rows,
    single, sleep, triangles, vector,
};
use crate::errors::{check_in_any, exception, wrong_value};
use crate::number::{self, flag, real, reals, whole, within};

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

const KINDS: [(&str, BodyKind); 3] = [
    ("dynamic", BodyKind::Dynamic),
    ("fixed", BodyKind::Fixed),
    ("kinematic", BodyKind::Kinematic),
];

/// A body at the origin with the fields of keywords.
pub(crate) fn plain_body(
    shape: &Bound<'_, PyShape>,
    kind: &str,
    keywords: Option<&Bound<'_, PyDict>>,
) -> PyResult<BodyParams> {
    let py = shape.py();
    let kind = one_of(py, &KINDS, kind, "kind")?;
    let mut body = BodyParams::new(kind, shape.get().shape.clone());
    let Some(keywords) = keywords else {
        return Ok(body);
    };
    for (key, value) in keywords {
        let key: String = key.extract()?;
        match key.as_str() {
            "mass" => body.mass = optional(&value, "mass", real)?,
            "moments" => body.moments = optional(&value, "moments", reals)?.map(Vec3::from_array),
            "material" => {
                let numbers = optional(&value, "material", reals)?;
                body.material = numbers.map(|[friction, restitution, density]| Material {
                    friction,
                    restitution,
                    density,
                });
            }
            "damping" => {
                let numbers = optional(&value, "damping", reals)?;
                body.damping = numbers.map(|[linear, angular]| Damping { linear, angular });
            }
            "gravity_scale" => body.gravity_scale = real(&value, "gravity_scale")?,
            "locked_axes" => {
                let bits = whole::locked_axes(&value)?;
                let needed = "six bits: 0 to 63";
                body.locked_axes = LockedAxes::new(bits)
                    .ok_or_else(|| wrong_value(py, "locked_axes", bits, needed))?;
            }
            "groups" => {
                let needed = "two numbers of 32 bits: 0 to 4294967295";
                let (members, touches) = within(&value, "groups", value.extract(), needed)?;
                body.groups = CollisionGroups { members, touches };
            }
            "tolerance_exponent" => {
                let needed = "-3 to 3";
                let exponent = within(&value, "tolerance_exponent", value.extract(), needed)?;
                body.tolerance_scale = ToleranceScale::new(exponent)
                    .ok_or_else(|| wrong_value(py, "tolerance_exponent", exponent, needed))?;
            }
            "sensor" => body.sensor = flag(&value, "sensor")?,
            "swept" => body.swept = flag(&value, "swept")?,
            "gyroscopic" => body.gyroscopic = flag(&value, "gyroscopic")?,
            "sleep" => body.sleep = sleep(&value)?,
            _ => {
                let text = format!("{key} is no keyword of a body");
                return Err(PyTypeError::new_err(text));
            }
        }
    }
    Ok(body)
}

/// The value of a keyword that may be `None`.
fn optional<T>(
    value: &Bound<'_, PyAny>,
    name: &'static str,
    read: impl FnOnce(&Bound<'_, PyAny>, &'static str) -> PyResult<T>,
) -> PyResult<Option<T>> {
    match value.is_none() {
        true => Ok(None),
        false => read(value, name).map(Some),
    }
}

/// A body like a plain one for each row of positions. Rotations and velocities, linear then angular, may be left out.
pub(crate) fn bodies_at(
    plain: &BodyParams,
    positions: &Bound<'_, PyAny>,
    rotations: Option<&Bound<'_, PyAny>>,
    [linear, angular]: [Option<&Bound<'_, PyAny>>; 2],
) -> PyResult<Vec<BodyParams>> {
    let positions = points(positions, "positions")?;
    let count = positions.len();
    let vectors = |argument, name| optional_rows(argument, count, name, [0.0; 3]);
    let linear = vectors(linear, "linear_velocities")?;
    let angular = vectors(angular, "angular_velocities")?;
    let turned = optional_rows(rotations, count, "rotations", [0.0, 0.0, 0.0, 1.0])?;
    let bodies = positions.into_iter().enumerate();
    let bodies = bodies.map(|(place, position)| BodyParams {
        position,
        rotation: Quat::from_array(turned[place]),
        linear_velocity: Vec3::from_array(linear[place]),
        angular_velocity: Vec3::from_array(angular[place]),
        ..plain.clone()
    });
    Ok(bodies.collect())
}

/// A state for each body: positions, and rotations, velocities and spins if there are any.
pub(crate) fn states(
    body: &Bound<'_, PyAny>,
    position: &Bound<'_, PyAny>,
    [rotation, linear, angular]: [Option<&Bound<'_, PyAny>>; 3],
) -> PyResult<Vec<StateRecord>> {
    let ids = bodies(body)?.ids;
    let count = ids.len();
    let at = rows::<3>(position, count, "position")?;
    let turned = optional_rows(rotation, count, "rotation", Quat::IDENTITY.to_array())?;
    let linear = optional_rows(linear, count, "linear", [0.0; 3])?;
    let angular = optional_rows(angular, count, "angular", [0.0; 3])?;
    let state = |(place, body)| StateRecord {
        body,
        position: Vec3::from_array(at[place]),
        rotation: Quat::from_array(turned[place]),
        linear_velocity: Vec3::from_array(linear[place]),
        angular_velocity: Vec3::from_array(angular[place]),
    };
    Ok(ids.into_iter().enumerate().map(state).collect())
}

/// The same as arrays, without a copy of each row.
pub(crate) struct GivenStates {
    bodies: Vec<u64>,
    positions: GivenRows<3>,
    rotations: Option<GivenRows<4>>,
    linear: Option<GivenRows<3>>,
    angular: Option<GivenRows<3>>,
}

impl GivenStates {
    pub(crate) fn of(
        body: &Bound<'_, PyAny>,
        position: &Bound<'_, PyAny>,
        [rotation, linear, angular]: [Option<&Bound<'_, PyAny>>; 3],
    ) -> PyResult<Self> {
        let bodies = packed_bodies(body)?;
        let count = bodies.len();
        Ok(Self {
            positions: GivenRows::of(position, count, "position")?,
            rotations: GivenRows::of_optional(rotation, count, "rotation")?,
            linear: GivenRows::of_optional(linear, count, "linear")?,
            angular: GivenRows::of_optional(angular, count, "angular")?,
            bodies,
        })
    }

    pub(crate) fn arrays(&self) -> FedArrays<'_> {
        let unturned = Rows::All(Quat::IDENTITY.to_array());
        FedArrays {
            bodies: &self.bodies,
            positions: self.positions.rows(),
            rotations: (self.rotations.as_ref()).map_or(unturned, GivenRows::rows),
            linear_velocities: self.linear.as_ref().map(GivenRows::rows),
            angular_velocities: self.angular.as_ref().map(GivenRows::rows),
        }
    }
}

const FREEDOMS: [(&str, JointFreedom); 7] = [
    ("fixed", JointFreedom::Fixed),
    ("spherical", JointFreedom::Spherical),
    ("revolute", JointFreedom::Revolute),
    ("prismatic", JointFreedom::Prismatic),
    ("rope", JointFreedom::Rope),
    ("spring", JointFreedom::Spring),
    ("generic", JointFreedom::Generic),
];

/// Least and most by axis.
type Limits = BTreeMap<usize, (f32, f32)>;
/// Position, velocity, stiffness, damping, and the greatest force if there is one, by axis.
type Motors = BTreeMap<usize, (f32, f32, f32, f32, Option<f32>)>;

/// A joint of two bodies, for Scene.add_joint and Scene.change_joint.
///
/// kind: "fixed"; "spherical", which leaves every turn free; "revolute", a hinge, which leaves the turn about x of its
/// frames; "prismatic", a slider, which leaves the displacement along x; "rope", with a greatest length; "spring", with a
/// length, a stiffness in N/m and a damping in N s/m; "generic", which leaves every axis but the locked_axes, bits in the
/// order below.
///
/// Each body has a frame of the joint: first_anchor and second_anchor, from the origin of its shape, and first_rotation and
/// second_rotation, a quaternion x, y, z, w. To hinge about another axis than x, turn both frames.
///
/// limits and motors are by axis: 0 to 2 along x, y, z, 3 to 5 about them. A limit is the least and the most, in units
/// of length or in radians from -2 pi to 2 pi, at most a whole turn apart: limits={3: (0, 4.7)} is 270 degrees. A motor
/// is (position, velocity, stiffness, damping, force): what it drives to, its stiffness in 1/s², its damping in 1/s,
/// and its greatest force or torque, or None for any. For a motor that keeps a speed, the stiffness is 0:
/// motors={3: (0, 2.0, 0, 10.0, None)} turns a hinge at 2 rad/s.
///
/// collide: whether the two bodies also collide with each other. breaks_at: the force and the torque at which it breaks, N and
/// N m, or kg cm/s² and kg cm²/s² in Unreal's coordinates.
#[pyclass(frozen, name = "Joint", module = "rhumb")]
pub(crate) struct PyJoint {
    kind: String,
    joint: Joint,
}

const BY_AXIS: &str = "by axes 0 to 5, with finite numbers";

fn limits(value: &Bound<'_, PyAny>) -> PyResult<Option<Limits>> {
    within(value, "limits", value.extract(), BY_AXIS)
}

fn motors(value: &Bound<'_, PyAny>) -> PyResult<Option<Motors>> {
    within(value, "motors", value.extract(), BY_AXIS)
}

fn breaks_at(value: &Bound<'_, PyAny>) -> PyResult<Option<(f32, f32)>> {
    let needed = "a force and a torque, both finite";
    within(value, "breaks_at", value.extract(), needed)
}

impl PyJoint {
    pub(crate) fn addition(&self, id: u32) -> Command {
        Command::AddJoint {
            id: JointId(id),
            joint: Box::new(self.joint),
        }
    }

    pub(crate) fn change(&self, id: u32) -> Command {
        Command::ChangeJoint {
            id: JointId(id),
            joint: Box::new(self.joint),
        }
    }
}

#[pymethods]
impl PyJoint {
    #[new]
    #[pyo3(signature = (
        kind, first, second, *, first_anchor = None, second_anchor = None, first_rotation = None,
        second_rotation = None, locked_axes = 0, limits = None, motors = None, length = 1.0,
        stiffness = 0.0, damping = 0.0, collide = false, breaks_at = None,
    ))]
    // Named parameters are the interface of Python.
    #[expect(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        kind: &str,
        first: &Bound<'_, PyAny>,
        second: &Bound<'_, PyAny>,
        first_anchor: Option<&Bound<'_, PyAny>>,
        second_anchor: Option<&Bound<'_, PyAny>>,
        first_rotation: Option<&Bound<'_, PyAny>>,
        second_rotation: Option<&Bound<'_, PyAny>>,
        #[pyo3(from_py_with = whole::locked_axes)] locked_axes: u8,
        #[pyo3(from_py_with = limits)] limits: Option<Limits>,
        #[pyo3(from_py_with = motors)] motors: Option<Motors>,
        #[pyo3(from_py_with = number::single::length)] length: f32,
        #[pyo3(from_py_with = number::single::stiffness)] stiffness: f32,
        #[pyo3(from_py_with = number::single::damping)] damping: f32,
        collide: bool,
        #[pyo3(from_py_with = breaks_at)] breaks_at: Option<(f32, f32)>,
    ) -> PyResult<Self> {
        let freedom = one_of(py, &FREEDOMS, kind, "kind")?;
        let pair = [single(first)?, single(second)?];
        let locked = LockedAxes::new(locked_axes);
        let params = JointParams {
            frames: [
                frame(first_anchor, first_rotation)?,
                frame(second_anchor, second_rotation)?,
            ],
            locked: locked
                .ok_or_else(|| wrong_value(py, "locked_axes", locked_axes, "six bits: 0 to 63"))?,
            limits: by_axis(py, limits, |(least, most)| JointLimits { least, most })?,
            motors: by_axis(
                py,
                motors,
                |(position, velocity, stiffness, damping, force)| Motor {
                    force: force.unwrap_or(Motor::with_velocity(0.0, 0.0).force),
                    position,
                    velocity,
                    stiffness,
                    damping,
                },
            )?,
            length,
            stiffness,
            damping,
            collide,
            strength: breaks_at.map(|(force, torque)| JointStrength { force, torque }),
            ..JointParams::new(freedom, pair)
        };
        let joint = params.joint().map_err(|error| exception(py, &error))?;
        check_in_any(py, |coordinates| coordinates.joint_in(&joint).check())?;
        let kind = kind.to_owned();
        Ok(Self { kind, joint })
    }

    fn __repr__(&self) -> String {
        let [first, second] = self.joint.bodies.map(packed_id);
        let mut text = format!("Joint({:?}, {first}, {second}", self.kind);
        let axes = |values: [Option<String>; 6]| {
            let each = values.into_iter().enumerate();
            let each = each.filter_map(|(axis, value)| Some(format!("{axis}: {}", value?)));
            each.collect::<Vec<_>>().join(", ")
        };
        let limits =
            axes(self.joint.kind.limits().map(|limits| {
                limits.map(|JointLimits { least, most }| format!("({least}, {most})"))
            }));
        if !limits.is_empty() {
            text += &format!(", limits={{{limits}}}");
        }
        let motors = axes(self.joint.motors.map(|motor| {
            motor.map(|motor| {
                let Motor {
                    position,
                    velocity,
                    stiffness,
                    damping,
                    force,
                } = motor;
                format!("({position}, {velocity}, {stiffness}, {damping}, {force})")
            })
        }));
        if !motors.is_empty() {
            text += &format!(", motors={{{motors}}}");
        }
        text + ")"
    }
}

fn frame(
    anchor: Option<&Bound<'_, PyAny>>,
    turned: Option<&Bound<'_, PyAny>>,
) -> PyResult<JointFrame> {
    Ok(JointFrame {
        anchor: anchor.map_or(Ok(Vec3::ZERO), |anchor| vector(anchor, "anchor"))?,
        rotation: turned.map_or(Ok(Quat::IDENTITY), |turned| rotation(turned, "rotation"))?,
    })
}

/// Values at their axes.
fn by_axis<V, T: Copy>(
    py: Python<'_>,
    values: Option<BTreeMap<usize, V>>,
    value: impl Fn(V) -> T,
) -> PyResult<[Option<T>; 6]> {
    let mut axes = [None; 6];
    for (axis, given) in values.unwrap_or_default() {
        let place = axes.get_mut(axis);
        let needed = "0 to 5: translations along x, y, z, then rotations about them";
        *place.ok_or_else(|| wrong_value(py, "axis", axis, needed))? = Some(value(given));
    }
    Ok(axes)
}
