//! Commands as methods of nodes, and the resources that they take.
//!
//! Made by `bindings/table` from `spec/tables/protocol.json`; do not edit.

use godot::global::Error;
use godot::prelude::*;
use rhumb_client::scene::{
    ActiveEvents, Character, CharacterStep, Command, JumpFrom, Locomotion, Vehicle, Wheel,
    WheelInput,
};

use crate::body::BodyNode;
use crate::conversion::{quat, vec3};
use crate::scene::SceneNode;

#[godot_api(secondary)]
impl BodyNode {
    /// Removes a body, and its joints.
    #[func]
    pub(crate) fn remove(&self) -> Error {
        self.command("remove", |id| Command::RemoveBody { id })
    }

    /// Puts a fixed or dynamic body elsewhere at once, and moves a kinematic one there during the next tick. If poses
    /// of a kinematic body come more seldom than ticks, up to four a second, it moves evenly from one to the next,
    /// carries what lies on it, and stops at the last one. A pose that is farther than 100 m/s or a quarter of a turn
    /// in a tick from where its motion leads is a jump that shoves nothing. If a velocity is set after the pose, the
    /// body is there after one tick and continues at that velocity.
    /// `position`: place of its centre of mass, or of the origin of a hull or compound added here: at most 100,000 m
    /// along each axis.
    /// `rotation`: unit quaternion x, y, z, w, body to world.
    #[func]
    pub(crate) fn set_pose(
        &self,
        position: Vector3,
        #[opt(default = Quaternion::default())] rotation: Quaternion,
    ) -> Error {
        self.command("set_pose", |id| Command::SetPose {
            id,
            position: vec3(position),
            rotation: quat(rotation),
        })
    }

    /// Sets both velocities. A kinematic body keeps them, and a character walks by them.
    /// `linear`: velocity of the centre of mass: at most 1,000 m/s along each axis.
    /// `angular`: angular velocity about world axes: at most 100 rad/s along each axis.
    #[func]
    pub(crate) fn set_velocity(
        &self,
        linear: Vector3,
        #[opt(default = Vector3::ZERO)] angular: Vector3,
    ) -> Error {
        self.command("set_velocity", |id| Command::SetVelocity {
            id,
            linear: vec3(linear),
            angular: vec3(angular),
        })
    }

    /// Applies a force at the centre of mass during the next tick; one that makes the body too fast is refused.
    /// `force`: in world axes: at most 1,000,000,000 N along each axis.
    #[func]
    pub(crate) fn apply_force(&self, force: Vector3) -> Error {
        self.command("apply_force", |id| Command::Force {
            id,
            force: vec3(force),
        })
    }

    /// Applies a force at a point during the next tick; one that makes the body too fast is refused.
    /// `force`: in world axes: at most 1,000,000,000 N along each axis.
    /// `point`: point of the world where it acts: at most 100,000 m along each axis.
    #[func]
    pub(crate) fn apply_force_at(&self, force: Vector3, point: Vector3) -> Error {
        self.command("apply_force_at", |id| Command::ForceAt {
            id,
            force: vec3(force),
            point: vec3(point),
        })
    }

    /// Applies a torque during the next tick; one that makes the body spin too fast is refused.
    /// `torque`: about world axes: at most 1,000,000,000 N·m along each axis.
    #[func]
    pub(crate) fn apply_torque(&self, torque: Vector3) -> Error {
        self.command("apply_torque", |id| Command::Torque {
            id,
            torque: vec3(torque),
        })
    }

    /// Applies an impulse at the centre of mass: the velocity changes at once; one that makes the body too fast is
    /// refused.
    /// `impulse`: in world axes: at most 1,000,000,000 N·s along each axis.
    #[func]
    pub(crate) fn apply_impulse(&self, impulse: Vector3) -> Error {
        self.command("apply_impulse", |id| Command::Impulse {
            id,
            impulse: vec3(impulse),
        })
    }

    /// Applies an impulse at a point: both velocities change at once; one that makes the body too fast is refused.
    /// `impulse`: in world axes: at most 1,000,000,000 N·s along each axis.
    /// `point`: point of the world where it acts: at most 100,000 m along each axis.
    #[func]
    pub(crate) fn apply_impulse_at(&self, impulse: Vector3, point: Vector3) -> Error {
        self.command("apply_impulse_at", |id| Command::ImpulseAt {
            id,
            impulse: vec3(impulse),
            point: vec3(point),
        })
    }

    /// Applies an angular impulse: the spin changes at once; one that makes the body spin too fast is refused.
    /// `impulse`: about world axes: at most 1,000,000,000 N·m·s along each axis.
    #[func]
    pub(crate) fn apply_torque_impulse(&self, impulse: Vector3) -> Error {
        self.command("apply_torque_impulse", |id| Command::TorqueImpulse {
            id,
            impulse: vec3(impulse),
        })
    }

    /// Puts a dynamic body to sleep, until something that moves touches it.
    #[func]
    pub(crate) fn put_to_sleep(&self) -> Error {
        self.command("put_to_sleep", |id| Command::Sleep { id })
    }

    /// Wakes a dynamic body.
    #[func]
    pub(crate) fn wake_up(&self) -> Error {
        self.command("wake_up", |id| Command::Wake { id })
    }

    /// Turns the events of a body on; what is left out, off. A new body reports none.
    /// `contacts`: its contacts begin and end.
    /// `sensors`: bodies enter and leave the sensor, or the body enters and leaves sensors.
    /// `sleep`: it falls asleep and wakes.
    /// `force`: least force of a contact that is reported, in each tick, zero for all: 0 to 1,000,000,000 N; none if it
    /// is negative.
    #[func]
    pub(crate) fn report_events(
        &self,
        #[opt(default = false)] contacts: bool,
        #[opt(default = false)] sensors: bool,
        #[opt(default = false)] sleep: bool,
        #[opt(default = -1.0)] force: f32,
    ) -> Error {
        self.command("report_events", |id| Command::SetEvents {
            id,
            events: ActiveEvents {
                contacts,
                sensors,
                sleep,
                force: (force >= 0.0).then_some(force),
            },
        })
    }

    /// Makes a character or a vehicle an ordinary body again.
    #[func]
    pub(crate) fn clear_locomotion(&self) -> Error {
        self.command("clear_locomotion", |id| Command::SetLocomotion {
            id,
            locomotion: Box::new(Locomotion::None),
        })
    }

    /// Makes a kinematic body a character, which walks by the velocity that is set, or gives a character other
    /// settings. Events report when it reaches the ground and when it leaves it.
    #[func]
    pub(crate) fn set_character(&self, character: Gd<CharacterResource>) -> Error {
        self.command("set_character", |id| Command::SetLocomotion {
            id,
            locomotion: Box::new(character.bind().character().into()),
        })
    }

    /// Makes a dynamic body a vehicle, whose wheels begin without inputs.
    #[func]
    pub(crate) fn set_vehicle(&self, wheels: Array<Gd<WheelResource>>) -> Error {
        self.command("set_vehicle", |id| Command::SetLocomotion {
            id,
            locomotion: Box::new(
                Vehicle {
                    wheels: wheels
                        .iter_shared()
                        .map(|wheel| wheel.bind().wheel())
                        .collect(),
                }
                .into(),
            ),
        })
    }

    /// Lets a character rise along its direction up. In the air nothing happens, unless it may jump from anywhere.
    /// `speed`: speed with which it rises: -1,000 to 1,000 m/s.
    /// `anywhere`: it jumps in the air too.
    #[func]
    pub(crate) fn jump(&self, speed: f32, #[opt(default = false)] anywhere: bool) -> Error {
        self.command("jump", |id| Command::Jump {
            id,
            speed,
            from: match anywhere {
                true => JumpFrom::Anywhere,
                false => JumpFrom::Ground,
            },
        })
    }

    /// Sets steering, force and brake of all wheels of a vehicle. It keeps them until the next ones.
    /// `inputs`: in the order of the wheels.
    #[func]
    pub(crate) fn set_wheels(&self, inputs: Array<Gd<WheelInputResource>>) -> Error {
        self.command("set_wheels", |id| Command::SetWheels {
            id,
            inputs: inputs
                .iter_shared()
                .map(|input| input.bind().wheel_input())
                .collect(),
        })
    }
}

#[godot_api(secondary)]
impl SceneNode {
    /// Changes the gravity of the scene.
    /// `gravity`: in world axes: at most 1,000 m/s² along each axis.
    #[func]
    pub(crate) fn change_gravity(&self, gravity: Vector3) -> Error {
        self.command(
            "change_gravity",
            Command::SetGravity {
                gravity: vec3(gravity),
            },
        )
    }
}

/// A character: a kinematic body that walks by its velocity, as far as the world lets it, and falls.
#[derive(GodotClass)]
#[class(init, base = Resource, rename = RhumbCharacter)]
pub(crate) struct CharacterResource {
    /// Gap that it keeps to its surroundings: 0.001 to 10,000 m.
    #[export]
    #[init(val = 0.02)]
    offset: f32,
    /// Steepest slope that it climbs, from level ground: 0 to π/2 rad.
    #[export]
    #[init(val = std::f32::consts::FRAC_PI_4)]
    climb_angle: f32,
    /// Slope from which on it slides down, from level ground: 0 to π/2 rad.
    #[export]
    #[init(val = std::f32::consts::FRAC_PI_4)]
    slide_angle: f32,
    /// Mass with which it pushes dynamic bodies, none at zero: 0 to 1,000,000 kg.
    #[export]
    #[init(val = 80.0)]
    mass: f32,
    /// Direction away from the ground, of unit length, instead of the one against gravity; none if it is zero.
    #[export]
    up: Vector3,
    /// Greatest height of a step that it climbs: 0.001 to 10,000 m; none if it is zero.
    #[export]
    step_height: f32,
    /// Free width that it needs on a step: 0.001 to 10,000 m.
    #[export]
    step_width: f32,
    /// It also climbs onto dynamic bodies; otherwise it pushes them.
    #[export]
    onto_dynamic: bool,
    /// Greatest drop of the ground that it follows without a fall: 0.001 to 10,000 m; none if it is zero.
    #[export]
    #[init(val = 0.2)]
    snap: f32,
}

impl CharacterResource {
    fn character(&self) -> Character {
        Character {
            offset: self.offset,
            climb_angle: self.climb_angle,
            slide_angle: self.slide_angle,
            mass: self.mass,
            up: given(self.up),
            step: (self.step_height != 0.0).then_some(CharacterStep {
                height: self.step_height,
                width: self.step_width,
                onto_dynamic: self.onto_dynamic,
            }),
            snap: (self.snap != 0.0).then_some(self.snap),
        }
    }
}

/// A wheel of a vehicle, in the axes of its chassis and from the origin of its shape: a ray with a spring.
#[derive(GodotClass)]
#[class(init, base = Resource, rename = RhumbWheel)]
pub(crate) struct WheelResource {
    /// Upper end of the suspension: at most 10,000 m along each axis.
    #[export]
    position: Vector3,
    /// Direction of the suspension, of unit length, towards the ground.
    #[export]
    #[init(val = Vector3::new(0.0, -1.0, 0.0))]
    direction: Vector3,
    /// Axis about which the wheel turns, of unit length, to the right of the way forward.
    #[export]
    #[init(val = Vector3::new(1.0, 0.0, 0.0))]
    axle: Vector3,
    /// Radius of the wheel: 0.001 to 10,000 m.
    #[export]
    radius: f32,
    /// Length of the suspension without load, from the position to the wheel's centre: 0 to 10,000 m.
    #[export]
    #[init(val = 0.3)]
    rest_length: f32,
    /// Greatest change of that length: 0 to 10,000 m.
    #[export]
    #[init(val = 0.25)]
    travel: f32,
    /// Acceleration of the chassis for a change of that length: 0 to 1,000,000 1/s².
    #[export]
    #[init(val = 50.0)]
    stiffness: f32,
    /// Damping while the spring is compressed: 0 to 1,000,000 1/s.
    #[export]
    #[init(val = 4.0)]
    compression: f32,
    /// Damping while the spring relaxes: 0 to 1,000,000 1/s.
    #[export]
    #[init(val = 6.0)]
    relaxation: f32,
    /// Greatest force of the suspension: 0 to 1,000,000,000 N.
    #[export]
    #[init(val = 1000000000.0)]
    force_max: f32,
    /// Greatest force along the ground, as a share of the suspension's force, of which the part along the way forward
    /// counts half: 0 to 100.
    #[export]
    #[init(val = 2.0)]
    friction_slip: f32,
    /// Factor of the force along the axle that keeps the wheel from sliding sideways: 0 to 100.
    #[export]
    #[init(val = 1.0)]
    side_friction: f32,
}

impl WheelResource {
    fn wheel(&self) -> Wheel {
        Wheel {
            position: vec3(self.position),
            direction: vec3(self.direction),
            axle: vec3(self.axle),
            radius: self.radius,
            rest_length: self.rest_length,
            travel: self.travel,
            stiffness: self.stiffness,
            compression: self.compression,
            relaxation: self.relaxation,
            force_max: self.force_max,
            friction_slip: self.friction_slip,
            side_friction: self.side_friction,
        }
    }
}

/// Steering, force and brake of a wheel. Without any, it rolls freely.
#[derive(GodotClass)]
#[class(init, base = Resource, rename = RhumbWheelInput)]
pub(crate) struct WheelInputResource {
    /// Turn about the axis that points up, to the left if positive: -π to π rad.
    #[export]
    steering: f32,
    /// Force along the way forward, backward if negative: -1,000,000,000 to 1,000,000,000 N.
    #[export]
    force: f32,
    /// Greatest force that stops it, while it has no force: 0 to 1,000,000,000 N.
    #[export]
    brake: f32,
}

impl WheelInputResource {
    fn wheel_input(&self) -> WheelInput {
        WheelInput {
            steering: self.steering,
            force: self.force,
            brake: self.brake,
        }
    }
}

/// The vector, unless it is zero.
fn given(vector: Vector3) -> Option<rhumb_client::glam::Vec3> {
    (vector != Vector3::ZERO).then(|| vec3(vector))
}
