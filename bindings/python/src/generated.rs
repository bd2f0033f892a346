//! Values that commands take, as classes of Python.
//!
//! Made by `bindings/table` from `spec/tables/protocol.json`; do not edit. A setting that is left out is that of Rust, in
//! the units and axes of the scene that gets it.

use pyo3::prelude::*;
use rhumb_bindings::Coordinates;
use rhumb_bindings::rhumb_client::BodyId;
use rhumb_bindings::rhumb_client::glam::Vec3;
use rhumb_bindings::rhumb_client::scene::{
    Character, CharacterStep, Command, Vehicle, Wheel, WheelInput,
};

use crate::arguments::{call, number, triple, vector};
use crate::errors::check_in_any;
use crate::number::{optional_real, real, reals};

/// A character: a kinematic body that walks by its velocity, as far as the world lets it, and falls.
///
/// offset: gap that it keeps to its surroundings, units of length: 0.001 to 10,000 m; 0.02 m by default.
/// climb_angle: steepest slope that it climbs, from level ground: 0 to π/2 rad; π/4 rad by default.
/// slide_angle: slope from which on it slides down, from level ground: 0 to π/2 rad; π/4 rad by default.
/// mass: mass with which it pushes dynamic bodies, none at zero: 0 to 1,000,000 kg; 80 kg by default.
/// up: direction away from the ground, of unit length, instead of the one against gravity.
/// step: greatest height of a step that it climbs, units of length: 0.001 to 10,000 m, and free width that it
/// needs on a step, units of length: 0.001 to 10,000 m; None for none.
/// onto_dynamic: it also climbs onto dynamic bodies; otherwise it pushes them.
/// snap: greatest drop of the ground that it follows without a fall, units of length: 0.001 to 10,000 m; 0.2 m
/// by default; 0 for none.
#[pyclass(frozen, name = "Character", module = "rhumb")]
#[derive(Debug)]
pub(crate) struct PyCharacter {
    offset: Option<f32>,
    climb_angle: Option<f32>,
    slide_angle: Option<f32>,
    mass: Option<f32>,
    up: Option<Vec3>,
    step: Option<CharacterStep>,
    snap: Option<f32>,
}

impl PyCharacter {
    pub(crate) fn character(&self, coordinates: Coordinates) -> Character {
        let plain = coordinates.plain_character();
        Character {
            offset: self.offset.unwrap_or(plain.offset),
            climb_angle: self.climb_angle.unwrap_or(plain.climb_angle),
            slide_angle: self.slide_angle.unwrap_or(plain.slide_angle),
            mass: self.mass.unwrap_or(plain.mass),
            up: self.up,
            step: self.step,
            snap: self
                .snap
                .map_or(plain.snap, |snap| (snap != 0.0).then_some(snap)),
        }
    }
}

#[pymethods]
impl PyCharacter {
    #[new]
    #[pyo3(signature = (
        *, offset = None, climb_angle = None, slide_angle = None, mass = None, up = None, step = None,
        onto_dynamic = false, snap = None,
    ))]
    // Named parameters are the interface of Python.
    #[expect(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        offset: Option<&Bound<'_, PyAny>>,
        climb_angle: Option<&Bound<'_, PyAny>>,
        slide_angle: Option<&Bound<'_, PyAny>>,
        mass: Option<&Bound<'_, PyAny>>,
        up: Option<&Bound<'_, PyAny>>,
        step: Option<&Bound<'_, PyAny>>,
        onto_dynamic: bool,
        snap: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let made = Self {
            offset: optional_real(offset, "offset")?,
            climb_angle: optional_real(climb_angle, "climb_angle")?,
            slide_angle: optional_real(slide_angle, "slide_angle")?,
            mass: optional_real(mass, "mass")?,
            up: up.map(|up| vector(up, "up")).transpose()?,
            step: step
                .map(|step| {
                    let [height, width] = reals(step, "step")?;
                    Ok::<_, PyErr>(CharacterStep {
                        height,
                        width,
                        onto_dynamic,
                    })
                })
                .transpose()?,
            snap: optional_real(snap, "snap")?,
        };
        check_in_any(py, |coordinates| {
            let character = coordinates.character_in(made.character(coordinates));
            let id = BodyId::new(0, 0);
            Command::SetLocomotion {
                id,
                locomotion: Box::new(character.into()),
            }
            .check()
        })?;
        Ok(made)
    }

    fn __repr__(&self) -> String {
        call(
            "Character",
            &[
                ("offset", self.offset.map(number)),
                ("climb_angle", self.climb_angle.map(number)),
                ("slide_angle", self.slide_angle.map(number)),
                ("mass", self.mass.map(number)),
                ("up", self.up.map(triple)),
                (
                    "step",
                    self.step
                        .map(|step| format!("({}, {})", step.height, step.width)),
                ),
                (
                    "onto_dynamic",
                    self.step
                        .and_then(|step| step.onto_dynamic.then(|| "True".to_owned())),
                ),
                ("snap", self.snap.map(number)),
            ],
        )
    }
}

/// A wheel of a vehicle, in the axes of its chassis and from the origin of its shape: a ray with a spring.
///
/// position: upper end of the suspension, units of length: at most 10,000 m along each axis.
/// radius: radius of the wheel, units of length: 0.001 to 10,000 m.
/// direction: direction of the suspension, of unit length, towards the ground; down by default.
/// axle: axis about which the wheel turns, of unit length, to the right of the way forward; along x by default,
/// in Unreal's coordinates along y.
/// rest_length: length of the suspension without load, from the position to the wheel's centre, units of
/// length: 0 to 10,000 m; 0.3 m by default.
/// travel: greatest change of that length, units of length: 0 to 10,000 m; 0.25 m by default.
/// stiffness: acceleration of the chassis for a change of that length: 0 to 1,000,000 1/s²; 50 1/s² by default.
/// compression: damping while the spring is compressed: 0 to 1,000,000 1/s; 4 1/s by default.
/// relaxation: damping while the spring relaxes: 0 to 1,000,000 1/s; 6 1/s by default.
/// force_max: greatest force of the suspension, kg times units of length per s²: 0 to 1,000,000,000 N; any by
/// default.
/// friction_slip: greatest force along the ground, as a share of the suspension's force, of which the part
/// along the way forward counts half: 0 to 100; 2 by default.
/// side_friction: factor of the force along the axle that keeps the wheel from sliding sideways: 0 to 100; 1 by
/// default.
#[pyclass(frozen, name = "Wheel", module = "rhumb")]
#[derive(Debug)]
pub(crate) struct PyWheel {
    position: Vec3,
    radius: f32,
    direction: Option<Vec3>,
    axle: Option<Vec3>,
    rest_length: Option<f32>,
    travel: Option<f32>,
    stiffness: Option<f32>,
    compression: Option<f32>,
    relaxation: Option<f32>,
    force_max: Option<f32>,
    friction_slip: Option<f32>,
    side_friction: Option<f32>,
}

impl PyWheel {
    pub(crate) fn wheel(&self, coordinates: Coordinates) -> Wheel {
        let plain = coordinates.plain_wheel(self.position, self.radius);
        Wheel {
            position: self.position,
            radius: self.radius,
            direction: self.direction.unwrap_or(plain.direction),
            axle: self.axle.unwrap_or(plain.axle),
            rest_length: self.rest_length.unwrap_or(plain.rest_length),
            travel: self.travel.unwrap_or(plain.travel),
            stiffness: self.stiffness.unwrap_or(plain.stiffness),
            compression: self.compression.unwrap_or(plain.compression),
            relaxation: self.relaxation.unwrap_or(plain.relaxation),
            force_max: self.force_max.unwrap_or(plain.force_max),
            friction_slip: self.friction_slip.unwrap_or(plain.friction_slip),
            side_friction: self.side_friction.unwrap_or(plain.side_friction),
        }
    }
}

#[pymethods]
impl PyWheel {
    #[new]
    #[pyo3(signature = (
        position, radius, *, direction = None, axle = None, rest_length = None, travel = None, stiffness = None,
        compression = None, relaxation = None, force_max = None, friction_slip = None, side_friction = None,
    ))]
    // Named parameters are the interface of Python.
    #[expect(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        position: &Bound<'_, PyAny>,
        radius: &Bound<'_, PyAny>,
        direction: Option<&Bound<'_, PyAny>>,
        axle: Option<&Bound<'_, PyAny>>,
        rest_length: Option<&Bound<'_, PyAny>>,
        travel: Option<&Bound<'_, PyAny>>,
        stiffness: Option<&Bound<'_, PyAny>>,
        compression: Option<&Bound<'_, PyAny>>,
        relaxation: Option<&Bound<'_, PyAny>>,
        force_max: Option<&Bound<'_, PyAny>>,
        friction_slip: Option<&Bound<'_, PyAny>>,
        side_friction: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let made = Self {
            position: vector(position, "position")?,
            radius: real(radius, "radius")?,
            direction: direction
                .map(|direction| vector(direction, "direction"))
                .transpose()?,
            axle: axle.map(|axle| vector(axle, "axle")).transpose()?,
            rest_length: optional_real(rest_length, "rest_length")?,
            travel: optional_real(travel, "travel")?,
            stiffness: optional_real(stiffness, "stiffness")?,
            compression: optional_real(compression, "compression")?,
            relaxation: optional_real(relaxation, "relaxation")?,
            force_max: optional_real(force_max, "force_max")?,
            friction_slip: optional_real(friction_slip, "friction_slip")?,
            side_friction: optional_real(side_friction, "side_friction")?,
        };
        check_in_any(py, |coordinates| {
            let wheel = coordinates.wheel_in(made.wheel(coordinates));
            let id = BodyId::new(0, 0);
            Command::SetLocomotion {
                id,
                locomotion: Box::new(
                    Vehicle {
                        wheels: vec![wheel],
                    }
                    .into(),
                ),
            }
            .check()
        })?;
        Ok(made)
    }

    fn __repr__(&self) -> String {
        call(
            "Wheel",
            &[
                ("position", Some(triple(self.position))),
                ("radius", Some(number(self.radius))),
                ("direction", self.direction.map(triple)),
                ("axle", self.axle.map(triple)),
                ("rest_length", self.rest_length.map(number)),
                ("travel", self.travel.map(number)),
                ("stiffness", self.stiffness.map(number)),
                ("compression", self.compression.map(number)),
                ("relaxation", self.relaxation.map(number)),
                ("force_max", self.force_max.map(number)),
                ("friction_slip", self.friction_slip.map(number)),
                ("side_friction", self.side_friction.map(number)),
            ],
        )
    }
}

/// Steering, force and brake of a wheel.
///
/// Without any, it rolls freely.
///
/// steering: turn about the axis that points up, to the left if positive, in left-handed coordinates to the
/// right: -π to π rad.
/// force: force along the way forward, backward if negative, kg times units of length per s²: -1,000,000,000 to
/// 1,000,000,000 N.
/// brake: greatest force that stops it, while it has no force, kg times units of length per s²: 0 to
/// 1,000,000,000 N.
#[pyclass(frozen, name = "WheelInput", module = "rhumb")]
#[derive(Debug)]
pub(crate) struct PyWheelInput {
    steering: f32,
    force: f32,
    brake: f32,
}

impl PyWheelInput {
    pub(crate) fn wheel_input(&self, _coordinates: Coordinates) -> WheelInput {
        WheelInput {
            steering: self.steering,
            force: self.force,
            brake: self.brake,
        }
    }
}

#[pymethods]
impl PyWheelInput {
    #[new]
    #[pyo3(signature = (steering = None, force = None, brake = None))]
    fn new(
        py: Python<'_>,
        steering: Option<&Bound<'_, PyAny>>,
        force: Option<&Bound<'_, PyAny>>,
        brake: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let made = Self {
            steering: optional_real(steering, "steering")?.unwrap_or_default(),
            force: optional_real(force, "force")?.unwrap_or_default(),
            brake: optional_real(brake, "brake")?.unwrap_or_default(),
        };
        check_in_any(py, |coordinates| {
            let wheel_input = coordinates.wheel_input_in(made.wheel_input(coordinates));
            let id = BodyId::new(0, 0);
            Command::SetWheels {
                id,
                inputs: vec![wheel_input],
            }
            .check()
        })?;
        Ok(made)
    }

    fn __repr__(&self) -> String {
        call(
            "WheelInput",
            &[
                ("steering", Some(number(self.steering))),
                ("force", Some(number(self.force))),
                ("brake", Some(number(self.brake))),
            ],
        )
    }
}
