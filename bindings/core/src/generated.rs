//! Commands in other coordinates, and the kinds of events and requests.
//!
//! Made by `bindings/table` from `spec/tables/protocol.json`; do not edit.

use rhumb_client::scene::{
    ActiveEvents, Character, CharacterStep, Command, Locomotion, Vehicle, Wheel, WheelInput,
};

use crate::coordinates::Coordinates;

impl Coordinates {
    /// A command in Rhumb's coordinates.
    ///
    /// Descriptions of bodies and shapes pass as they are: no binding offers such commands.
    #[must_use]
    pub fn command_in(self, mut command: Command) -> Command {
        match &mut command {
            Command::SetPose {
                position, rotation, ..
            } => {
                *position = self.vector_in(*position);
                *rotation = self.rotation_in(*rotation);
            }
            Command::SetVelocity {
                linear, angular, ..
            } => {
                *linear = self.vector_in(*linear);
                *angular = self.angular_in(*angular);
            }
            Command::Force { force, .. } => {
                *force = self.vector_in(*force);
            }
            Command::Torque { torque, .. } => {
                *torque = self.torque_in(*torque);
            }
            Command::Impulse { impulse, .. } => {
                *impulse = self.vector_in(*impulse);
            }
            Command::TorqueImpulse { impulse, .. } => {
                *impulse = self.torque_in(*impulse);
            }
            Command::SetGravity { gravity, .. } => {
                *gravity = self.vector_in(*gravity);
            }
            Command::ForceAt { force, point, .. } => {
                *force = self.vector_in(*force);
                *point = self.vector_in(*point);
            }
            Command::ImpulseAt { impulse, point, .. } => {
                *impulse = self.vector_in(*impulse);
                *point = self.vector_in(*point);
            }
            Command::SetEvents { events, .. } => {
                *events = self.active_events_in(*events);
            }
            Command::Jump { speed, .. } => {
                *speed = self.length_in(*speed);
            }
            Command::SetWheels { inputs, .. } => {
                for input in inputs {
                    *input = self.wheel_input_in(*input);
                }
            }
            Command::AddJoint { joint, .. } | Command::ChangeJoint { joint, .. } => {
                **joint = self.joint_in(joint);
            }
            Command::SetLocomotion { locomotion, .. } => match &mut **locomotion {
                Locomotion::None => {}
                Locomotion::Character(character) => *character = self.character_in(*character),
                Locomotion::Vehicle(Vehicle { wheels }) => {
                    for wheel in wheels {
                        *wheel = self.wheel_in(*wheel);
                    }
                }
            },
            // The others have no axes and no lengths.
            _ => {}
        }
        command
    }

    /// The character in Rhumb's coordinates.
    #[must_use]
    pub fn character_in(self, character: Character) -> Character {
        Character {
            offset: self.length_in(character.offset),
            up: character.up.map(|up| self.direction_in(up)),
            step: character.step.map(|step| CharacterStep {
                height: self.length_in(step.height),
                width: self.length_in(step.width),
                ..step
            }),
            snap: character.snap.map(|snap| self.length_in(snap)),
            ..character
        }
    }

    /// The wheel in Rhumb's coordinates.
    #[must_use]
    pub fn wheel_in(self, wheel: Wheel) -> Wheel {
        Wheel {
            position: self.vector_in(wheel.position),
            direction: self.direction_in(wheel.direction),
            axle: self.direction_in(wheel.axle),
            radius: self.length_in(wheel.radius),
            rest_length: self.length_in(wheel.rest_length),
            travel: self.length_in(wheel.travel),
            force_max: self.length_in(wheel.force_max),
            ..wheel
        }
    }

    /// The input of a wheel in Rhumb's coordinates.
    #[must_use]
    pub fn wheel_input_in(self, wheel_input: WheelInput) -> WheelInput {
        WheelInput {
            steering: self.turn_in(wheel_input.steering),
            force: self.length_in(wheel_input.force),
            brake: self.length_in(wheel_input.brake),
        }
    }

    /// The events that a body reports in Rhumb's coordinates.
    #[must_use]
    pub fn active_events_in(self, active_events: ActiveEvents) -> ActiveEvents {
        ActiveEvents {
            force: active_events.force.map(|force| self.length_in(force)),
            ..active_events
        }
    }
}

/// The kind of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EventKind {
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
    /// The server receives nothing from the member with authority over `body`: from `tick` on its pose is a guess, and its
    /// error bound is infinite.
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
    /// The server granted authority: as many bodies as `number` says are published. Of a member by cells, more may follow.
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

impl EventKind {
    /// Each of them, in the order of their numbers in C.
    pub const EACH: [Self; 30] = [
        Self::CommandsApplied,
        Self::CommandRefused,
        Self::BodyPlaced,
        Self::BodyRemoved,
        Self::ContactBegan,
        Self::ContactEnded,
        Self::ContactForce,
        Self::SensorEntered,
        Self::SensorLeft,
        Self::FellAsleep,
        Self::Woke,
        Self::BodyFault,
        Self::ReachedGround,
        Self::LeftGround,
        Self::EventsMissed,
        Self::StreamChanged,
        Self::PublisherSilent,
        Self::PublisherActive,
        Self::SceneRestored,
        Self::SceneFaulted,
        Self::SceneDeleted,
        Self::Interrupted,
        Self::Resumed,
        Self::SessionLost,
        Self::Durable,
        Self::AuthorityGranted,
        Self::AuthorityDenied,
        Self::Denied,
        Self::Ended,
        Self::Other,
    ];

    /// Its name in languages without enumerations.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::CommandsApplied => "commands applied",
            Self::CommandRefused => "command refused",
            Self::BodyPlaced => "body placed",
            Self::BodyRemoved => "body removed",
            Self::ContactBegan => "contact began",
            Self::ContactEnded => "contact ended",
            Self::ContactForce => "contact force",
            Self::SensorEntered => "sensor entered",
            Self::SensorLeft => "sensor left",
            Self::FellAsleep => "fell asleep",
            Self::Woke => "woke",
            Self::BodyFault => "body fault",
            Self::ReachedGround => "reached ground",
            Self::LeftGround => "left ground",
            Self::EventsMissed => "events missed",
            Self::StreamChanged => "stream changed",
            Self::PublisherSilent => "publisher silent",
            Self::PublisherActive => "publisher active",
            Self::SceneRestored => "scene restored",
            Self::SceneFaulted => "scene faulted",
            Self::SceneDeleted => "scene deleted",
            Self::Interrupted => "interrupted",
            Self::Resumed => "resumed",
            Self::SessionLost => "session lost",
            Self::Durable => "durable",
            Self::AuthorityGranted => "authority granted",
            Self::AuthorityDenied => "authority denied",
            Self::Denied => "denied",
            Self::Ended => "ended",
            Self::Other => "other",
        }
    }
}

/// The kind of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RequestKind {
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

impl RequestKind {
    /// Its name in languages without enumerations.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::AddBody => "add body",
            Self::RemoveBody => "remove body",
            Self::ChangeBody => "change body",
            Self::SetPose => "set pose",
            Self::SetVelocity => "set velocity",
            Self::ApplyForce => "apply force",
            Self::ApplyTorque => "apply torque",
            Self::ApplyImpulse => "apply impulse",
            Self::ApplyTorqueImpulse => "apply torque impulse",
            Self::Sleep => "sleep",
            Self::Wake => "wake",
            Self::SetGravity => "set gravity",
            Self::AddJoint => "add joint",
            Self::ChangeJoint => "change joint",
            Self::RemoveJoint => "remove joint",
        }
    }
}
