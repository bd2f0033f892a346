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

/// The commands that give bodies a locomotion.
pub(crate) fn set(bodies: &[BodyId], locomotion: &Locomotion) -> Vec<Command> {
    let set = |id: &BodyId| Command::SetLocomotion {
        id: *id,
        locomotion: Box::new(locomotion.clone()),
    };
    bodies.iter().map(set).collect()
}

/// A character: a kinematic body that walks.
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

impl PyCharacter {
    pub(crate) fn locomotion(&self, coordinates: Coordinates) -> Locomotion {
        let plain = coordinates.plain_character();
        let character = Character {
            up: self.up,
            offset: self.offset.unwrap_or(plain.offset),
            climb_angle: self.climb_angle,
            slide_angle: self.slide_angle,
            mass: self.mass,
            step: self.step,
            snap: self
                .snap
                .map_or(plain.snap, |snap| (snap != 0.0).then_some(snap)),
        };
        character.into()
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
        up: Option<&Bound<'_, PyAny>>,
        offset: Option<f32>,
        climb_angle: f32,
        slide_angle: f32,
        mass: f32,
        step: Option<(f32, f32)>,
        onto_dynamic: bool,
        snap: Option<f32>,
    ) -> PyResult<Self> {
        Ok(Self {
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
        })
    }

    fn __repr__(&self) -> String {
        format!("{self:?}").replacen("Py", "", 1)
    }
}

/// A wheel of a vehicle.
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
        position: &Bound<'_, PyAny>,
        radius: f32,
        direction: Option<&Bound<'_, PyAny>>,
        axle: Option<&Bound<'_, PyAny>>,
        rest_length: Option<f32>,
        travel: Option<f32>,
        stiffness: Option<f32>,
        compression: Option<f32>,
        relaxation: Option<f32>,
        force_max: Option<f32>,
        friction_slip: Option<f32>,
        side_friction: Option<f32>,
    ) -> PyResult<Self> {
        let optional = |argument: Option<&Bound<'_, PyAny>>, name| {
            argument.map(|argument| vector(argument, name)).transpose()
        };
        Ok(Self {
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
        })
    }

    fn __repr__(&self) -> String {
        format!("{self:?}").replacen("Py", "", 1)
    }
}

/// Steering, force and brake of a wheel.
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
    const fn new(steering: f32, force: f32, brake: f32) -> Self {
        let input = WheelInput {
            steering,
            force,
            brake,
        };
        Self { input }
    }

    fn __repr__(&self) -> String {
        format!("{:?}", self.input)
    }
}
