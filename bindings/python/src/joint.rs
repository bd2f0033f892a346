//! Joints.

use std::collections::BTreeMap;

use pyo3::prelude::*;
use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::rhumb_client::scene::{
    Command, Joint, JointFrame, JointId, JointLimits, JointStrength, LockedAxes, Motor,
};
use rhumb_bindings::{JointFreedom, JointParams, packed_id};

use crate::arguments::{one_of, rotation, single, vector};
use crate::errors::{check_in_any, exception, wrong_value};
use crate::number;

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
    number::within(value, "limits", value.extract(), BY_AXIS)
}

fn motors(value: &Bound<'_, PyAny>) -> PyResult<Option<Motors>> {
    number::within(value, "motors", value.extract(), BY_AXIS)
}

fn breaks_at(value: &Bound<'_, PyAny>) -> PyResult<Option<(f32, f32)>> {
    let needed = "a force and a torque, both finite";
    number::within(value, "breaks_at", value.extract(), needed)
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
        #[pyo3(from_py_with = number::whole::locked_axes)] locked_axes: u8,
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
