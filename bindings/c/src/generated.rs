//! Commands, records and kinds of events and requests of C.
//!
//! Made by `bindings/table` from `spec/tables/protocol.json`; do not edit.

use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::rhumb_client::scene::{
    ActiveEvents, Character, CharacterStep, Command, JumpFrom, Locomotion, Vehicle, Wheel,
    WheelInput,
};
use rhumb_bindings::{BindingError, EventKind, RequestKind, parse_packed_id};

use crate::border::{RhumbCode, elements, guard, one_of, value};
use crate::descriptions::RhumbBody;
use crate::scene::{RhumbScene, send};

/// Bit of `events`: its contacts begin and end.
pub const RHUMB_EVENTS_CONTACTS: u32 = 1;
/// Bit of `events`: `number` is the least force of a contact that is reported, in each tick, zero for all, kg times
/// units of length per s²: 0 to 1,000,000,000 N.
pub const RHUMB_EVENTS_FORCE: u32 = 2;
/// Bit of `events`: bodies enter and leave the sensor, or the body enters and leaves sensors.
pub const RHUMB_EVENTS_SENSORS: u32 = 4;
/// Bit of `events`: it falls asleep and wakes.
pub const RHUMB_EVENTS_SLEEP: u32 = 8;

/// FieldKind of a command.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbCommandKind {
    /// Removes a body, and its joints.
    RemoveBody = 3,
    /// Puts a fixed or dynamic body elsewhere at once, and moves a kinematic one there during the next tick. If poses
    /// of a kinematic body come more seldom than ticks, up to four a second, it moves evenly from one to the next,
    /// carries what lies on it, and stops at the last one. A pose that is farther than 100 m/s or a quarter of a turn
    /// in a tick from where its motion leads is a jump that shoves nothing. If a velocity is set after the pose, the
    /// body is there after one tick and continues at that velocity. `vector`: place of its centre of mass, or of the
    /// origin of a hull or compound added here, units of length: at most 100,000 m along each axis; `rotation`: unit
    /// quaternion x, y, z, w, body to world.
    SetPose = 4,
    /// Sets both velocities. A kinematic body keeps them, and a character walks by them. `vector`: velocity of the
    /// centre of mass, units of length per second: at most 1,000 m/s along each axis; `angular`: angular velocity about
    /// world axes: at most 100 rad/s along each axis.
    SetVelocity = 5,
    /// Applies a force at the centre of mass during the next tick; one that makes the body too fast is refused.
    /// `vector`: in world axes, kg times units of length per s²: at most 1,000,000,000 N along each axis.
    Force = 6,
    /// Applies a torque during the next tick; one that makes the body spin too fast is refused. `vector`: about world
    /// axes, kg times units of length² per s²: at most 1,000,000,000 N·m along each axis.
    Torque = 7,
    /// Applies an impulse at the centre of mass: the velocity changes at once; one that makes the body too fast is
    /// refused. `vector`: in world axes, kg times units of length per second: at most 1,000,000,000 N·s along each
    /// axis.
    Impulse = 8,
    /// Applies an angular impulse: the spin changes at once; one that makes the body spin too fast is refused.
    /// `vector`: about world axes, kg times units of length² per second: at most 1,000,000,000 N·m·s along each axis.
    TorqueImpulse = 9,
    /// Changes the gravity of the scene. `vector`: in world axes, units of length per s²: at most 1,000 m/s² along each
    /// axis.
    SetGravity = 10,
    /// Applies a force at a point during the next tick; one that makes the body too fast is refused. `vector`: in world
    /// axes, kg times units of length per s²: at most 1,000,000,000 N along each axis; `point`: point of the world
    /// where it acts, units of length: at most 100,000 m along each axis.
    ForceAt = 15,
    /// Applies an impulse at a point: both velocities change at once; one that makes the body too fast is refused.
    /// `vector`: in world axes, kg times units of length per second: at most 1,000,000,000 N·s along each axis;
    /// `point`: point of the world where it acts, units of length: at most 100,000 m along each axis.
    ImpulseAt = 16,
    /// Puts a dynamic body to sleep, until something that moves touches it.
    Sleep = 17,
    /// Wakes a dynamic body.
    Wake = 18,
    /// Turns the events of a body on; what is left out, off. A new body reports none.
    SetEvents = 19,
    /// Lets a character rise along its direction up. In the air nothing happens, unless it may jump from anywhere.
    /// `number`: speed with which it rises, units of length per second: -1,000 to 1,000 m/s; `choice`: ground that the
    /// jump needs.
    Jump = 21,
}

/// Ground that the jump needs, a choice of the command `Jump`.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbJumpFrom {
    /// The character jumps only if it stands on the ground.
    Ground,
    /// It jumps in the air too.
    Anywhere,
}

/// In the order of their numbers.
const JUMP_FROM: [JumpFrom; 2] = [JumpFrom::Ground, JumpFrom::Anywhere];

/// A command, for `rhumb_scene_command`. Fields that its kind does not name are ignored. Units are kilograms, seconds,
/// radians, and the scene's unit of length.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbCommand {
    /// A `RhumbCommandKind`.
    pub kind: u32,
    /// Bits of events.
    pub events: u32,
    /// The body.
    pub body: RhumbBody,
    /// A position, velocity, force, torque, impulse or gravity, in world axes, as the kind says.
    pub vector: [f32; 3],
    /// Where a force or an impulse acts, in world axes.
    pub point: [f32; 3],
    /// Angular velocity, rad/s about world axes.
    pub angular: [f32; 3],
    /// Unit quaternion x, y, z, w: body to world.
    pub rotation: [f32; 4],
    /// A number, as the kind says.
    pub number: f32,
    /// A number of an enumeration, as the kind says.
    pub choice: u32,
}

impl RhumbCommandKind {
    /// In the order of their numbers.
    pub(crate) const EACH: [Self; 14] = [
        Self::RemoveBody,
        Self::SetPose,
        Self::SetVelocity,
        Self::Force,
        Self::Torque,
        Self::Impulse,
        Self::TorqueImpulse,
        Self::SetGravity,
        Self::ForceAt,
        Self::ImpulseAt,
        Self::Sleep,
        Self::Wake,
        Self::SetEvents,
        Self::Jump,
    ];
}

impl RhumbCommand {
    /// The command, in the scene's coordinates.
    pub(crate) fn command(&self) -> Result<Command, BindingError> {
        let kind = RhumbCommandKind::EACH
            .into_iter()
            .find(|kind| *kind as u32 == self.kind);
        let needed = "one that RhumbCommandKind names";
        let kind = kind.ok_or_else(|| BindingError::value("command.kind", self.kind, needed))?;
        let id = || parse_packed_id(self.body.0);
        let vector = Vec3::from_array(self.vector);
        Ok(match kind {
            RhumbCommandKind::RemoveBody => Command::RemoveBody { id: id()? },
            RhumbCommandKind::SetPose => Command::SetPose {
                id: id()?,
                position: vector,
                rotation: Quat::from_array(self.rotation),
            },
            RhumbCommandKind::SetVelocity => Command::SetVelocity {
                id: id()?,
                linear: vector,
                angular: Vec3::from_array(self.angular),
            },
            RhumbCommandKind::Force => Command::Force {
                id: id()?,
                force: vector,
            },
            RhumbCommandKind::Torque => Command::Torque {
                id: id()?,
                torque: vector,
            },
            RhumbCommandKind::Impulse => Command::Impulse {
                id: id()?,
                impulse: vector,
            },
            RhumbCommandKind::TorqueImpulse => Command::TorqueImpulse {
                id: id()?,
                impulse: vector,
            },
            RhumbCommandKind::SetGravity => Command::SetGravity { gravity: vector },
            RhumbCommandKind::ForceAt => Command::ForceAt {
                id: id()?,
                force: vector,
                point: Vec3::from_array(self.point),
            },
            RhumbCommandKind::ImpulseAt => Command::ImpulseAt {
                id: id()?,
                impulse: vector,
                point: Vec3::from_array(self.point),
            },
            RhumbCommandKind::Sleep => Command::Sleep { id: id()? },
            RhumbCommandKind::Wake => Command::Wake { id: id()? },
            RhumbCommandKind::SetEvents => Command::SetEvents {
                id: id()?,
                events: self.active_events()?,
            },
            RhumbCommandKind::Jump => Command::Jump {
                id: id()?,
                speed: self.number,
                from: one_of(&JUMP_FROM, self.choice, "command.choice")?,
            },
        })
    }

    fn active_events(&self) -> Result<ActiveEvents, BindingError> {
        let is_on = |bit: u32| self.events & bit != 0;
        if self.events > 15 {
            let needed = "bits that the header names: 0 to 15";
            return Err(BindingError::value("command.events", self.events, needed));
        }
        Ok(ActiveEvents {
            contacts: is_on(RHUMB_EVENTS_CONTACTS),
            force: is_on(RHUMB_EVENTS_FORCE).then_some(self.number),
            sensors: is_on(RHUMB_EVENTS_SENSORS),
            sleep: is_on(RHUMB_EVENTS_SLEEP),
        })
    }
}

/// A character: a kinematic body that walks by its velocity, as far as the world lets it, and falls. Begin with
/// `rhumb_character_init`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbCharacter {
    /// Not zero: it has `up`.
    pub has_up: u8,
    /// Not zero: it has `step_height` and what belongs to it.
    pub has_step: u8,
    /// Not zero: it also climbs onto dynamic bodies; otherwise it pushes them.
    pub onto_dynamic: u8,
    /// Not zero: it has `snap`.
    pub has_snap: u8,
    /// Gap that it keeps to its surroundings, units of length: 0.001 to 10,000 m.
    pub offset: f32,
    /// Steepest slope that it climbs, from level ground: 0 to π/2 rad.
    pub climb_angle: f32,
    /// Slope from which on it slides down, from level ground: 0 to π/2 rad.
    pub slide_angle: f32,
    /// Mass with which it pushes dynamic bodies, none at zero: 0 to 1,000,000 kg.
    pub mass: f32,
    /// Direction away from the ground, of unit length, instead of the one against gravity.
    pub up: [f32; 3],
    /// Greatest height of a step that it climbs, units of length: 0.001 to 10,000 m.
    pub step_height: f32,
    /// Free width that it needs on a step, units of length: 0.001 to 10,000 m.
    pub step_width: f32,
    /// Greatest drop of the ground that it follows without a fall, units of length: 0.001 to 10,000 m.
    pub snap: f32,
}

impl From<Character> for RhumbCharacter {
    fn from(from: Character) -> Self {
        Self {
            offset: from.offset,
            climb_angle: from.climb_angle,
            slide_angle: from.slide_angle,
            mass: from.mass,
            has_up: u8::from(from.up.is_some()),
            up: from.up.unwrap_or_default().to_array(),
            has_step: u8::from(from.step.is_some()),
            step_height: from.step.map_or(0.0, |step| step.height),
            step_width: from.step.map_or(0.0, |step| step.width),
            onto_dynamic: u8::from(from.step.is_some_and(|step| step.onto_dynamic)),
            has_snap: u8::from(from.snap.is_some()),
            snap: from.snap.unwrap_or_default(),
        }
    }
}

impl From<&RhumbCharacter> for Character {
    fn from(from: &RhumbCharacter) -> Self {
        Self {
            offset: from.offset,
            climb_angle: from.climb_angle,
            slide_angle: from.slide_angle,
            mass: from.mass,
            up: (from.has_up != 0).then_some(Vec3::from_array(from.up)),
            step: (from.has_step != 0).then_some(CharacterStep {
                height: from.step_height,
                width: from.step_width,
                onto_dynamic: from.onto_dynamic != 0,
            }),
            snap: (from.has_snap != 0).then_some(from.snap),
        }
    }
}

/// A wheel of a vehicle, in the axes of its chassis and from the origin of its shape: a ray with a spring. Begin with
/// `rhumb_wheel_init`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbWheel {
    /// Upper end of the suspension, units of length: at most 10,000 m along each axis.
    pub position: [f32; 3],
    /// Direction of the suspension, of unit length, towards the ground.
    pub direction: [f32; 3],
    /// Axis about which the wheel turns, of unit length, to the right of the way forward.
    pub axle: [f32; 3],
    /// Radius of the wheel, units of length: 0.001 to 10,000 m.
    pub radius: f32,
    /// Length of the suspension without load, from the position to the wheel's centre, units of length: 0 to 10,000 m.
    pub rest_length: f32,
    /// Greatest change of that length, units of length: 0 to 10,000 m.
    pub travel: f32,
    /// Acceleration of the chassis for a change of that length: 0 to 1,000,000 1/s².
    pub stiffness: f32,
    /// Damping while the spring is compressed: 0 to 1,000,000 1/s.
    pub compression: f32,
    /// Damping while the spring relaxes: 0 to 1,000,000 1/s.
    pub relaxation: f32,
    /// Greatest force of the suspension, kg times units of length per s²: 0 to 1,000,000,000 N.
    pub force_max: f32,
    /// Greatest force along the ground, as a share of the suspension's force, of which the part along the way forward
    /// counts half: 0 to 100.
    pub friction_slip: f32,
    /// Factor of the force along the axle that keeps the wheel from sliding sideways: 0 to 100.
    pub side_friction: f32,
}

impl From<Wheel> for RhumbWheel {
    fn from(from: Wheel) -> Self {
        Self {
            position: from.position.to_array(),
            direction: from.direction.to_array(),
            axle: from.axle.to_array(),
            radius: from.radius,
            rest_length: from.rest_length,
            travel: from.travel,
            stiffness: from.stiffness,
            compression: from.compression,
            relaxation: from.relaxation,
            force_max: from.force_max,
            friction_slip: from.friction_slip,
            side_friction: from.side_friction,
        }
    }
}

impl From<&RhumbWheel> for Wheel {
    fn from(from: &RhumbWheel) -> Self {
        Self {
            position: Vec3::from_array(from.position),
            direction: Vec3::from_array(from.direction),
            axle: Vec3::from_array(from.axle),
            radius: from.radius,
            rest_length: from.rest_length,
            travel: from.travel,
            stiffness: from.stiffness,
            compression: from.compression,
            relaxation: from.relaxation,
            force_max: from.force_max,
            friction_slip: from.friction_slip,
            side_friction: from.side_friction,
        }
    }
}

/// Steering, force and brake of a wheel. Without any, it rolls freely. All zeros are its default.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbWheelInput {
    /// Turn about the axis that points up, to the left if positive, in left-handed coordinates to the right: -π to π
    /// rad.
    pub steering: f32,
    /// Force along the way forward, backward if negative, kg times units of length per s²: -1,000,000,000 to
    /// 1,000,000,000 N.
    pub force: f32,
    /// Greatest force that stops it, while it has no force, kg times units of length per s²: 0 to 1,000,000,000 N.
    pub brake: f32,
}

impl From<&RhumbWheelInput> for WheelInput {
    fn from(from: &RhumbWheelInput) -> Self {
        Self {
            steering: from.steering,
            force: from.force,
            brake: from.brake,
        }
    }
}

/// Queues a command: makes a character or a vehicle an ordinary body again.
///
/// `last` may be null; otherwise it receives the number of the command, which events name.
///
/// # Safety
///
/// `last` is null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_clear_locomotion(
    scene: RhumbScene,
    body: RhumbBody,
    last: *mut u64,
) -> RhumbCode {
    // SAFETY: the caller promises what the pointers point to.
    guard(|| unsafe {
        let id = parse_packed_id(body.0)?;
        send(
            scene,
            Command::SetLocomotion {
                id,
                locomotion: Box::new(Locomotion::None),
            },
            last,
        )
    })
}

/// Queues a command: makes a kinematic body a character, which walks by the velocity that is set, or gives a character
/// other settings. Events report when it reaches the ground and when it leaves it.
///
/// `last` may be null; otherwise it receives the number of the command, which events name.
///
/// # Safety
///
/// `character` points to one; `last` is null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_set_character(
    scene: RhumbScene,
    body: RhumbBody,
    character: *const RhumbCharacter,
    last: *mut u64,
) -> RhumbCode {
    // SAFETY: the caller promises what the pointers point to.
    guard(|| unsafe {
        let id = parse_packed_id(body.0)?;
        let character = Character::from(value(character, "character")?);
        send(
            scene,
            Command::SetLocomotion {
                id,
                locomotion: Box::new(character.into()),
            },
            last,
        )
    })
}

/// Queues a command: makes a dynamic body a vehicle, whose wheels begin without inputs. `count`: 1 to 16.
///
/// `last` may be null; otherwise it receives the number of the command, which events name.
///
/// # Safety
///
/// `wheels` points to `count` of them; `last` is null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_set_vehicle(
    scene: RhumbScene,
    body: RhumbBody,
    wheels: *const RhumbWheel,
    count: usize,
    last: *mut u64,
) -> RhumbCode {
    // SAFETY: the caller promises what the pointers point to.
    guard(|| unsafe {
        let id = parse_packed_id(body.0)?;
        let wheels = elements(wheels, count, "wheels")?;
        let wheels = wheels.iter().map(Wheel::from).collect();
        send(
            scene,
            Command::SetLocomotion {
                id,
                locomotion: Box::new(Vehicle { wheels }.into()),
            },
            last,
        )
    })
}

/// Queues a command: sets steering, force and brake of all wheels of a vehicle. It keeps them until the next ones.
/// `count`: 1 to 16. `inputs` are in the order of the wheels.
///
/// `last` may be null; otherwise it receives the number of the command, which events name.
///
/// # Safety
///
/// `inputs` points to `count` of them; `last` is null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_set_wheels(
    scene: RhumbScene,
    body: RhumbBody,
    inputs: *const RhumbWheelInput,
    count: usize,
    last: *mut u64,
) -> RhumbCode {
    // SAFETY: the caller promises what the pointers point to.
    guard(|| unsafe {
        let id = parse_packed_id(body.0)?;
        let inputs = elements(inputs, count, "inputs")?;
        let inputs = inputs.iter().map(WheelInput::from).collect();
        send(scene, Command::SetWheels { id, inputs }, last)
    })
}

/// The kind of an event.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbEventKind {
    /// There was no event.
    None,
    /// All commands up to `number` were applied or refused; they act in the step after `tick`.
    CommandsApplied,
    /// The command `number` was refused; `text` says why, and `body` is one that the reason names.
    CommandRefused,
    /// `body` was placed in the scene, or its description was replaced.
    BodyPlaced,
    /// `body` was removed; `text` says why.
    BodyRemoved,
    /// `body` and `other` began to touch.
    ContactBegan,
    /// `body` and `other` ceased to touch, or one of them was removed.
    ContactEnded,
    /// The force between `body` and `other` reached the threshold of one of them.
    ContactForce,
    /// `other` entered the sensor `body`.
    SensorEntered,
    /// `other` left the sensor `body`.
    SensorLeft,
    /// `body` fell asleep.
    FellAsleep,
    /// `body` woke.
    Woke,
    /// The state of `body` was not finite, and it was removed.
    BodyFault,
    /// The character `body` reached ground that carries it.
    ReachedGround,
    /// No ground carries the character `body` any more.
    LeftGround,
    /// So many events of bodies as `number` says were not kept.
    EventsMissed,
    /// The stream changed, by request or because of the link.
    StreamChanged,
    /// The server receives nothing from the member with authority over `body`: from `tick` on its pose is a guess, and
    /// its error bound is infinite.
    PublisherSilent,
    /// It receives from that member again, or its authority has ended: from `tick` on `body` has an error bound.
    PublisherActive,
    /// The engine failed, and the scene continues from `tick` without the commands that it failed on.
    SceneRestored,
    /// The engine failed, and the scene stands still after `tick`.
    SceneFaulted,
    /// The scene was deleted.
    SceneDeleted,
    /// The connection ended, and the client tries to resume.
    Interrupted,
    /// The client continues with its session over another connection.
    Resumed,
    /// The server does not know the session any more.
    SessionLost,
    /// The scene up to `tick` survives a crash of the server.
    Durable,
    /// The server granted authority: as many bodies as `number` says are published. Of a member by cells, more may
    /// follow.
    AuthorityGranted,
    /// The server denied authority; `text` says why, and `body` is one that the reason names.
    AuthorityDenied,
    /// The server denied a request; `text` says why.
    Denied,
    /// The connection ended; `text` says why.
    Ended,
    /// An event that bindings do not describe further; `text` names it.
    Other,
}

impl RhumbEventKind {
    pub(crate) const fn of(kind: EventKind) -> Self {
        match kind {
            EventKind::CommandsApplied => Self::CommandsApplied,
            EventKind::CommandRefused => Self::CommandRefused,
            EventKind::BodyPlaced => Self::BodyPlaced,
            EventKind::BodyRemoved => Self::BodyRemoved,
            EventKind::ContactBegan => Self::ContactBegan,
            EventKind::ContactEnded => Self::ContactEnded,
            EventKind::ContactForce => Self::ContactForce,
            EventKind::SensorEntered => Self::SensorEntered,
            EventKind::SensorLeft => Self::SensorLeft,
            EventKind::FellAsleep => Self::FellAsleep,
            EventKind::Woke => Self::Woke,
            EventKind::BodyFault => Self::BodyFault,
            EventKind::ReachedGround => Self::ReachedGround,
            EventKind::LeftGround => Self::LeftGround,
            EventKind::EventsMissed => Self::EventsMissed,
            EventKind::StreamChanged => Self::StreamChanged,
            EventKind::PublisherSilent => Self::PublisherSilent,
            EventKind::PublisherActive => Self::PublisherActive,
            EventKind::SceneRestored => Self::SceneRestored,
            EventKind::SceneFaulted => Self::SceneFaulted,
            EventKind::SceneDeleted => Self::SceneDeleted,
            EventKind::Interrupted => Self::Interrupted,
            EventKind::Resumed => Self::Resumed,
            EventKind::SessionLost => Self::SessionLost,
            EventKind::Durable => Self::Durable,
            EventKind::AuthorityGranted => Self::AuthorityGranted,
            EventKind::AuthorityDenied => Self::AuthorityDenied,
            EventKind::Denied => Self::Denied,
            EventKind::Ended => Self::Ended,
            EventKind::Other => Self::Other,
        }
    }
}

/// The kind of a request. Those that move a body are answered by what is fed; those that add, change or remove
/// something change the scene once they are accepted.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbRequestKind {
    /// There was no request.
    None,
    /// A new body, of an id that it has already: `body`, `position`, `rotation`, `linear_velocity`, `angular_velocity`.
    /// Once it is accepted, feed it.
    AddBody,
    /// The removal of `body`.
    RemoveBody,
    /// Other properties of `body`.
    ChangeBody,
    /// `body` at `position` and `rotation`.
    SetPose,
    /// `body` with `linear_velocity` and `angular_velocity`.
    SetVelocity,
    /// A force for one tick: `vector`, at `point` if it has one.
    ApplyForce,
    /// A torque for one tick: `vector`.
    ApplyTorque,
    /// A change of momentum: `vector`, at `point` if it has one.
    ApplyImpulse,
    /// A change of angular momentum: `vector`.
    ApplyTorqueImpulse,
    /// `body` asleep.
    Sleep,
    /// `body` awake.
    Wake,
    /// Another gravity: `vector`.
    SetGravity,
    /// A new joint; `body` is its first one.
    AddJoint,
    /// Other limits and motors of a joint; `body` is its first one.
    ChangeJoint,
    /// The removal of a joint.
    RemoveJoint,
}

impl RhumbRequestKind {
    pub(crate) const fn of(kind: RequestKind) -> Self {
        match kind {
            RequestKind::AddBody => Self::AddBody,
            RequestKind::RemoveBody => Self::RemoveBody,
            RequestKind::ChangeBody => Self::ChangeBody,
            RequestKind::SetPose => Self::SetPose,
            RequestKind::SetVelocity => Self::SetVelocity,
            RequestKind::ApplyForce => Self::ApplyForce,
            RequestKind::ApplyTorque => Self::ApplyTorque,
            RequestKind::ApplyImpulse => Self::ApplyImpulse,
            RequestKind::ApplyTorqueImpulse => Self::ApplyTorqueImpulse,
            RequestKind::Sleep => Self::Sleep,
            RequestKind::Wake => Self::Wake,
            RequestKind::SetGravity => Self::SetGravity,
            RequestKind::AddJoint => Self::AddJoint,
            RequestKind::ChangeJoint => Self::ChangeJoint,
            RequestKind::RemoveJoint => Self::RemoveJoint,
        }
    }
}
