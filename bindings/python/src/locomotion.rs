//! Characters, wheels of vehicles, and their inputs.
//!
//! A setting that is left out is that of Rust, in the units and axes of the scene that gets it.

use std::f32::consts::FRAC_PI_4;

use pyo3::prelude::*;
use rhumb_bindings::Coordinates;
use rhumb_bindings::rhumb_client::BodyId;
use rhumb_bindings::rhumb_client::glam::Vec3;
use rhumb_bindings::rhumb_client::scene::{
    Character, CharacterStep, Command, Locomotion, Vehicle, Wheel, WheelInput,
};

use crate::arguments::vector;
use crate::errors::check_in_any;
use crate::number;

/// The commands that give bodies a locomotion.
pub(crate) fn set(bodies: &[BodyId], locomotion: &Locomotion) -> Vec<Command> {
    let set = |id: &BodyId| Command::SetLocomotion {
        id: *id,
        locomotion: Box::new(locomotion.clone()),
    };
    bodies.iter().map(set).collect()
}

/// A character, for Scene.set_character: a kinematic body that walks, as far as the world lets it, and falls.
///
/// Up is the direction away from the ground, of unit length; against gravity if it is left out.
///
/// The offset is the gap that it keeps to its surroundings, 0.02 m if it is left out. It climbs slopes of up to the
/// first angle, and slides down from the second one on; both are radians from level ground, 45 degrees if they are left
/// out. It pushes dynamic bodies with its mass, in kilograms.
///
/// A step is the greatest height that it climbs, and the free width that it needs there; without one it climbs none.
/// It climbs onto dynamic bodies too if it is set so, and pushes them otherwise. The snap is the greatest drop of the
/// ground that it follows without a fall, 0.2 m if it is left out, and none at 0.
#[pyclass(frozen, name = "Character", module = "rhumb")]
#[derive(Debug)]
pub(crate) struct PyCharacter {
    up: Option<Vec3>,
    offset: Option<f32>,
    climb_angle: f32,
    slide_angle: f32,
    mass: f32,
    step: Option<CharacterStep>,
    snap: Option<f32>,
}

fn step(value: &Bound<'_, PyAny>) -> PyResult<Option<(f32, f32)>> {
    let needed = "a height and a width, both finite";
    number::within(value, "step", value.extract(), needed)
}

impl PyCharacter {
    pub(crate) fn locomotion(&self, coordinates: Coordinates) -> Locomotion {
        self.character(coordinates).into()
    }

    fn character(&self, coordinates: Coordinates) -> Character {
        let plain = coordinates.plain_character();
        Character {
            up: self.up,
            offset: self.offset.unwrap_or(plain.offset),
            climb_angle: self.climb_angle,
            slide_angle: self.slide_angle,
            mass: self.mass,
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
        *, up = None, offset = None, climb_angle = FRAC_PI_4, slide_angle = FRAC_PI_4, mass = 80.0, step = None,
        onto_dynamic = false, snap = None,
    ))]
    // Named parameters are the interface of Python.
    #[expect(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        up: Option<&Bound<'_, PyAny>>,
        #[pyo3(from_py_with = number::optional::offset)] offset: Option<f32>,
        #[pyo3(from_py_with = number::single::climb_angle)] climb_angle: f32,
        #[pyo3(from_py_with = number::single::slide_angle)] slide_angle: f32,
        #[pyo3(from_py_with = number::single::mass)] mass: f32,
        #[pyo3(from_py_with = step)] step: Option<(f32, f32)>,
        onto_dynamic: bool,
        #[pyo3(from_py_with = number::optional::snap)] snap: Option<f32>,
    ) -> PyResult<Self> {
        let character = Self {
            up: up.map(|up| vector(up, "up")).transpose()?,
            offset,
            climb_angle,
            slide_angle,
            mass,
            step: step.map(|(height, width)| CharacterStep {
                height,
                width,
                onto_dynamic,
            }),
            snap,
        };
        check_in_any(py, |coordinates| {
            coordinates
                .character_in(character.character(coordinates))
                .check()
        })?;
        Ok(character)
    }

    fn __repr__(&self) -> String {
        let step = self.step;
        let step_size = step.map(|step| format!("({}, {})", step.height, step.width));
        let onto = step.and_then(|step| step.onto_dynamic.then(|| "True".to_owned()));
        call(
            "Character",
            &[
                ("up", self.up.map(triple)),
                ("offset", self.offset.map(number)),
                ("climb_angle", Some(number(self.climb_angle))),
                ("slide_angle", Some(number(self.slide_angle))),
                ("mass", Some(number(self.mass))),
                ("step", step_size),
                ("onto_dynamic", onto),
                ("snap", self.snap.map(number)),
            ],
        )
    }
}

/// A wheel of a vehicle, for Scene.set_vehicle: a ray with a spring, in the axes of its chassis.
///
/// The position is the upper end of its suspension, from the origin of the chassis' shape.
///
/// The direction of the suspension, of unit length, is down if it is left out. The axle, of unit length, points to the
/// right of the way forward. It is along x if it is left out, in Unreal's coordinates along y: forward is then -z in
/// Rhumb's coordinates, z in Unity's, x in Unreal's, and y where z is up.
///
/// The suspension has its rest length without load, 0.3 m, and changes by at most its travel, 0.25 m. Its stiffness is
/// an acceleration for a length, 50/s²; its damping is 4/s in compression, and 6/s in relaxation. It pushes with any
/// force unless a greatest one is set.
///
/// The greatest force along the ground is a share of the suspension's force, the friction slip, 2; the part along the
/// way forward counts half. The side friction, 1, is a factor of the force that keeps the wheel from sliding sideways.
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
    fn wheel(&self, coordinates: Coordinates) -> Wheel {
        let plain = coordinates.plain_wheel(self.position, self.radius);
        Wheel {
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
            ..plain
        }
    }

    /// The vehicle of these wheels.
    pub(crate) fn locomotion(wheels: &[PyRef<'_, Self>], coordinates: Coordinates) -> Locomotion {
        let wheels = wheels.iter().map(|wheel| wheel.wheel(coordinates));
        let wheels = wheels.collect();
        Vehicle { wheels }.into()
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
        #[pyo3(from_py_with = number::single::radius)] radius: f32,
        direction: Option<&Bound<'_, PyAny>>,
        axle: Option<&Bound<'_, PyAny>>,
        #[pyo3(from_py_with = number::optional::rest_length)] rest_length: Option<f32>,
        #[pyo3(from_py_with = number::optional::travel)] travel: Option<f32>,
        #[pyo3(from_py_with = number::optional::stiffness)] stiffness: Option<f32>,
        #[pyo3(from_py_with = number::optional::compression)] compression: Option<f32>,
        #[pyo3(from_py_with = number::optional::relaxation)] relaxation: Option<f32>,
        #[pyo3(from_py_with = number::optional::force_max)] force_max: Option<f32>,
        #[pyo3(from_py_with = number::optional::friction_slip)] friction_slip: Option<f32>,
        #[pyo3(from_py_with = number::optional::side_friction)] side_friction: Option<f32>,
    ) -> PyResult<Self> {
        let optional = |argument: Option<&Bound<'_, PyAny>>, name| {
            argument.map(|argument| vector(argument, name)).transpose()
        };
        let wheel = Self {
            position: vector(position, "position")?,
            radius,
            direction: optional(direction, "direction")?,
            axle: optional(axle, "axle")?,
            rest_length,
            travel,
            stiffness,
            compression,
            relaxation,
            force_max,
            friction_slip,
            side_friction,
        };
        check_in_any(py, |coordinates| {
            let wheels = vec![coordinates.wheel_in(wheel.wheel(coordinates))];
            Vehicle { wheels }.check()
        })?;
        Ok(wheel)
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

/// Steering, force and brake of a wheel, for Scene.set_wheels.
///
/// A positive steering, in radians, turns left; in left-handed coordinates it turns right.
///
/// The force acts forward, a negative one backward. The brake is the greatest force that stops the wheel; one with a
/// force does not brake.
#[pyclass(frozen, name = "WheelInput", module = "rhumb")]
pub(crate) struct PyWheelInput {
    input: WheelInput,
}

impl PyWheelInput {
    /// The commands that set the inputs of all wheels of vehicles.
    pub(crate) fn commands(bodies: &[BodyId], inputs: &[PyRef<'_, Self>]) -> Vec<Command> {
        let set = |id: &BodyId| Command::SetWheels {
            id: *id,
            inputs: inputs.iter().map(|input| input.input).collect(),
        };
        bodies.iter().map(set).collect()
    }
}

#[pymethods]
impl PyWheelInput {
    #[new]
    #[pyo3(signature = (steering = 0.0, force = 0.0, brake = 0.0))]
    fn new(
        py: Python<'_>,
        #[pyo3(from_py_with = number::single::steering)] steering: f32,
        #[pyo3(from_py_with = number::single::force)] force: f32,
        #[pyo3(from_py_with = number::single::brake)] brake: f32,
    ) -> PyResult<Self> {
        let input = WheelInput {
            steering,
            force,
            brake,
        };
        check_in_any(py, |coordinates| {
            let inputs = vec![coordinates.wheel_input_in(input)];
            let id = BodyId::new(0, 0);
            Command::SetWheels { id, inputs }.check()
        })?;
        Ok(Self { input })
    }

    fn __repr__(&self) -> String {
        let WheelInput {
            steering,
            force,
            brake,
        } = self.input;
        format!("WheelInput(steering={steering}, force={force}, brake={brake})")
    }
}

/// A call as Python writes it, without the keywords that were left out.
fn call(name: &str, keywords: &[(&str, Option<String>)]) -> String {
    let given = keywords.iter().filter_map(|(keyword, value)| {
        let value = value.as_ref()?;
        Some(format!("{keyword}={value}"))
    });
    format!("{name}({})", given.collect::<Vec<_>>().join(", "))
}

fn number(value: f32) -> String {
    value.to_string()
}

fn triple(v: Vec3) -> String {
    format!("({}, {}, {})", v.x, v.y, v.z)
}
