//! Commands as methods of a scene, their values as classes of Python.
//!
//! Made by `bindings/table` from `spec/tables/protocol.json`; do not edit. A setting that is left out is that of Rust, in
//! the units and axes of the scene that gets it.

use pyo3::prelude::*;
use rhumb_bindings::Coordinates;
use rhumb_bindings::rhumb_client::BodyId;
use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::rhumb_client::scene::{
    ActiveEvents, Character, CharacterStep, Command, JumpFrom, Locomotion, Vehicle, Wheel,
    WheelInput,
};

use crate::arguments::{bodies, call, number, optional_rows, rows, triple, vector};
use crate::errors::check_in_any;
use crate::number::{optional_real, real, reals};
use crate::scene::PyScene;

#[pymethods]
impl PyScene {
    /// Removes a body, and its joints.
    fn remove(&self, py: Python<'_>, body: &Bound<'_, PyAny>) -> PyResult<Option<u64>> {
        let ids = bodies(body)?.ids;
        self.each(py, &ids, |id, _| Command::RemoveBody { id })
    }

    /// Puts a fixed or dynamic body elsewhere at once, and moves a kinematic one there during the next tick.
    ///
    /// If poses of a kinematic body come more seldom than ticks, up to four a second, it moves evenly from one to
    /// the next, carries what lies on it, and stops at the last one. A pose that is farther than 100 m/s or a
    /// quarter of a turn in a tick from where its motion leads is a jump that shoves nothing. If a velocity is set
    /// after the pose, the body is there after one tick and continues at that velocity.
    ///
    /// position: place of its centre of mass, or of the origin of a hull or compound added here, units of length:
    /// at most 100,000 m along each axis.
    /// rotation: unit quaternion x, y, z, w, body to world.
    #[pyo3(signature = (body, position, rotation = None))]
    fn set_pose(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        position: &Bound<'_, PyAny>,
        rotation: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Option<u64>> {
        let ids = bodies(body)?.ids;
        let position = rows(position, ids.len(), "position")?;
        let rotation = optional_rows(rotation, ids.len(), "rotation", Quat::IDENTITY.to_array())?;
        self.each(py, &ids, |id, place| Command::SetPose {
            id,
            position: Vec3::from_array(position[place]),
            rotation: Quat::from_array(rotation[place]),
        })
    }

    /// Sets both velocities.
    ///
    /// A kinematic body keeps them, and a character walks by them.
    ///
    /// linear: velocity of the centre of mass, units of length per second: at most 1,000 m/s along each axis.
    /// angular: angular velocity about world axes: at most 100 rad/s along each axis.
    #[pyo3(signature = (body, linear, angular = None))]
    fn set_velocity(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        linear: &Bound<'_, PyAny>,
        angular: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Option<u64>> {
        let ids = bodies(body)?.ids;
        let linear = rows(linear, ids.len(), "linear")?;
        let angular = optional_rows(angular, ids.len(), "angular", [0.0; 3])?;
        self.each(py, &ids, |id, place| Command::SetVelocity {
            id,
            linear: Vec3::from_array(linear[place]),
            angular: Vec3::from_array(angular[place]),
        })
    }

    /// Applies a force at the centre of mass during the next tick; one that makes the body too fast is refused.
    ///
    /// With a point, it acts there.
    ///
    /// force: in world axes, kg times units of length per s²: at most 1,000,000,000 N along each axis.
    /// point: point of the world where it acts, units of length: at most 100,000 m along each axis.
    #[pyo3(signature = (body, force, point = None))]
    fn apply_force(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        force: &Bound<'_, PyAny>,
        point: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Option<u64>> {
        let ids = bodies(body)?.ids;
        let force = rows(force, ids.len(), "force")?;
        let point = point
            .map(|point| rows(point, ids.len(), "point"))
            .transpose()?;
        self.each(py, &ids, |id, place| match &point {
            Some(point) => Command::ForceAt {
                id,
                force: Vec3::from_array(force[place]),
                point: Vec3::from_array(point[place]),
            },
            None => Command::Force {
                id,
                force: Vec3::from_array(force[place]),
            },
        })
    }

    /// Applies a torque during the next tick; one that makes the body spin too fast is refused.
    ///
    /// torque: about world axes, kg times units of length² per s²: at most 1,000,000,000 N·m along each axis.
    fn apply_torque(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        torque: &Bound<'_, PyAny>,
    ) -> PyResult<Option<u64>> {
        let ids = bodies(body)?.ids;
        let torque = rows(torque, ids.len(), "torque")?;
        self.each(py, &ids, |id, place| Command::Torque {
            id,
            torque: Vec3::from_array(torque[place]),
        })
    }

    /// Applies an impulse at the centre of mass: the velocity changes at once; one that makes the body too fast
    /// is refused.
    ///
    /// With a point, it acts there.
    ///
    /// impulse: in world axes, kg times units of length per second: at most 1,000,000,000 N·s along each axis.
    /// point: point of the world where it acts, units of length: at most 100,000 m along each axis.
    #[pyo3(signature = (body, impulse, point = None))]
    fn apply_impulse(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        impulse: &Bound<'_, PyAny>,
        point: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Option<u64>> {
        let ids = bodies(body)?.ids;
        let impulse = rows(impulse, ids.len(), "impulse")?;
        let point = point
            .map(|point| rows(point, ids.len(), "point"))
            .transpose()?;
        self.each(py, &ids, |id, place| match &point {
            Some(point) => Command::ImpulseAt {
                id,
                impulse: Vec3::from_array(impulse[place]),
                point: Vec3::from_array(point[place]),
            },
            None => Command::Impulse {
                id,
                impulse: Vec3::from_array(impulse[place]),
            },
        })
    }

    /// Applies an angular impulse: the spin changes at once; one that makes the body spin too fast is refused.
    ///
    /// impulse: about world axes, kg times units of length² per second: at most 1,000,000,000 N·m·s along each
    /// axis.
    fn apply_torque_impulse(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        impulse: &Bound<'_, PyAny>,
    ) -> PyResult<Option<u64>> {
        let ids = bodies(body)?.ids;
        let impulse = rows(impulse, ids.len(), "impulse")?;
        self.each(py, &ids, |id, place| Command::TorqueImpulse {
            id,
            impulse: Vec3::from_array(impulse[place]),
        })
    }

    /// Puts a dynamic body to sleep, until something that moves touches it.
    fn sleep(&self, py: Python<'_>, body: &Bound<'_, PyAny>) -> PyResult<Option<u64>> {
        let ids = bodies(body)?.ids;
        self.each(py, &ids, |id, _| Command::Sleep { id })
    }

    /// Wakes a dynamic body.
    fn wake(&self, py: Python<'_>, body: &Bound<'_, PyAny>) -> PyResult<Option<u64>> {
        let ids = bodies(body)?.ids;
        self.each(py, &ids, |id, _| Command::Wake { id })
    }

    /// Turns the events of a body on; what is left out, off.
    ///
    /// A new body reports none.
    ///
    /// contacts: its contacts begin and end.
    /// sensors: bodies enter and leave the sensor, or the body enters and leaves sensors.
    /// sleep: it falls asleep and wakes.
    /// force: least force of a contact that is reported, in each tick, zero for all, kg times units of length per
    /// s²: 0 to 1,000,000,000 N.
    #[pyo3(signature = (body, *, contacts = false, sensors = false, sleep = false, force = None))]
    fn report_events(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        contacts: bool,
        sensors: bool,
        sleep: bool,
        force: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Option<u64>> {
        let ids = bodies(body)?.ids;
        let force = optional_real(force, "force")?;
        self.each(py, &ids, |id, _| Command::SetEvents {
            id,
            events: ActiveEvents {
                contacts,
                sensors,
                sleep,
                force,
            },
        })
    }

    /// Makes a character or a vehicle an ordinary body again.
    fn clear_locomotion(&self, py: Python<'_>, body: &Bound<'_, PyAny>) -> PyResult<Option<u64>> {
        let ids = bodies(body)?.ids;
        self.each(py, &ids, |id, _| Command::SetLocomotion {
            id,
            locomotion: Box::new(Locomotion::None),
        })
    }

    /// Makes a kinematic body a character, which walks by the velocity that is set, or gives a character other
    /// settings.
    ///
    /// Events report when it reaches the ground and when it leaves it.
    fn set_character(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        character: &Bound<'_, PyCharacter>,
    ) -> PyResult<Option<u64>> {
        let ids = bodies(body)?.ids;
        self.each_in(py, &ids, |id, coordinates| Command::SetLocomotion {
            id,
            locomotion: Box::new(character.get().character(coordinates).into()),
        })
    }

    /// Makes a dynamic body a vehicle, whose wheels begin without inputs.
    fn set_vehicle(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        wheels: Vec<PyRef<'_, PyWheel>>,
    ) -> PyResult<Option<u64>> {
        let ids = bodies(body)?.ids;
        self.each_in(py, &ids, |id, coordinates| Command::SetLocomotion {
            id,
            locomotion: Box::new(
                Vehicle {
                    wheels: wheels
                        .iter()
                        .map(|wheel| wheel.wheel(coordinates))
                        .collect(),
                }
                .into(),
            ),
        })
    }

    /// Lets a character rise along its direction up.
    ///
    /// In the air nothing happens, unless it may jump from anywhere.
    ///
    /// speed: speed with which it rises, units of length per second: -1,000 to 1,000 m/s.
    /// anywhere: it jumps in the air too.
    #[pyo3(signature = (body, speed, *, anywhere = false))]
    fn jump(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        speed: &Bound<'_, PyAny>,
        anywhere: bool,
    ) -> PyResult<Option<u64>> {
        let ids = bodies(body)?.ids;
        let speed = real(speed, "speed")?;
        let from = match anywhere {
            true => JumpFrom::Anywhere,
            false => JumpFrom::Ground,
        };
        self.each(py, &ids, |id, _| Command::Jump { id, speed, from })
    }

    /// Sets steering, force and brake of all wheels of a vehicle.
    ///
    /// It keeps them until the next ones.
    ///
    /// inputs: in the order of the wheels.
    fn set_wheels(
        &self,
        py: Python<'_>,
        body: &Bound<'_, PyAny>,
        inputs: Vec<PyRef<'_, PyWheelInput>>,
    ) -> PyResult<Option<u64>> {
        let ids = bodies(body)?.ids;
        self.each_in(py, &ids, |id, coordinates| Command::SetWheels {
            id,
            inputs: inputs
                .iter()
                .map(|input| input.wheel_input(coordinates))
                .collect(),
        })
    }

    /// Changes the gravity of the scene.
    ///
    /// gravity: in world axes, units of length per s²: at most 1,000 m/s² along each axis.
    fn set_gravity(&self, py: Python<'_>, gravity: &Bound<'_, PyAny>) -> PyResult<Option<u64>> {
        let gravity = vector(gravity, "gravity")?;
        self.one(py, Command::SetGravity { gravity })
    }
}

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
