//! Requests of followers to the program that feeds their scene.
//!
//! A binding whose requests are objects keeps each in its own; one whose requests are flat keeps them in [`OpenRequests`], and
//! answers by number.

use std::collections::BTreeMap;

use glam::{Quat, Vec3};
use rhumb_client::scene::Command;
use rhumb_client::{BodyId, FedRequest};

use crate::coordinates::Coordinates;
use crate::error::BindingError;

/// The kind of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RequestKind {
    /// A new body, of an id that it has already.
    AddBody,
    /// The removal of a body.
    RemoveBody,
    /// Other properties of a body.
    ChangeBody,
    /// A body at a pose.
    SetPose,
    /// A body with these velocities.
    SetVelocity,
    /// A force for one tick.
    ApplyForce,
    /// A torque for one tick.
    ApplyTorque,
    /// A change of momentum.
    ApplyImpulse,
    /// A change of angular momentum.
    ApplyTorqueImpulse,
    /// A body asleep.
    Sleep,
    /// A body awake.
    Wake,
    /// Another gravity.
    SetGravity,
    /// A new joint.
    AddJoint,
    /// Other limits and motors of a joint.
    ChangeJoint,
    /// The removal of a joint.
    RemoveJoint,
}

impl RequestKind {
    /// In words, as languages without enumerations have it.
    #[must_use]
    pub const fn words(self) -> &'static str {
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

/// A request: a command that another member gave. What its kind does not name is `None`.
#[derive(Clone, Debug, PartialEq)]
pub struct RequestRecord {
    /// The request itself, for the answer.
    pub request: FedRequest,
    /// The kind of its command.
    pub kind: RequestKind,
    /// The body that it is about; of a joint the first one.
    pub body: Option<BodyId>,
    /// Centre of mass.
    pub position: Option<Vec3>,
    /// Body → world.
    pub rotation: Option<Quat>,
    /// Units of length per second.
    pub linear_velocity: Option<Vec3>,
    /// rad/s about world axes.
    pub angular_velocity: Option<Vec3>,
    /// The force, torque, impulse or gravity.
    pub vector: Option<Vec3>,
    /// Where a force or an impulse acts.
    pub point: Option<Vec3>,
}

impl RequestRecord {
    /// A request in these coordinates; `None` for a command of which a fed scene makes none.
    #[must_use]
    pub fn new(request: FedRequest, coordinates: Coordinates) -> Option<Self> {
        let mut record = Self {
            kind: kind(&request.command)?,
            body: request.command.body(),
            position: None,
            rotation: None,
            linear_velocity: None,
            angular_velocity: None,
            vector: None,
            point: None,
            request,
        };
        record.fill(coordinates);
        Some(record)
    }

    /// Fills in the numbers of the command.
    fn fill(&mut self, coordinates: Coordinates) {
        let out = |vector| Some(coordinates.vector_out(vector));
        match self.request.command {
            Command::AddBody { motion, .. } => {
                let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = motion.parts();
                self.position = out(Vec3::new(px, py, pz));
                self.rotation = Some(coordinates.rotation_out(Quat::from_xyzw(x, y, z, w)));
                self.linear_velocity = out(Vec3::new(vx, vy, vz));
                let angular = Vec3::new(wx, wy, wz);
                self.angular_velocity = Some(coordinates.angular_out(angular));
            }
            Command::SetPose {
                position, rotation, ..
            } => {
                self.position = out(position);
                self.rotation = Some(coordinates.rotation_out(rotation));
            }
            Command::SetVelocity {
                linear, angular, ..
            } => {
                self.linear_velocity = out(linear);
                self.angular_velocity = Some(coordinates.angular_out(angular));
            }
            Command::Force { force: vector, .. }
            | Command::Impulse {
                impulse: vector, ..
            }
            | Command::SetGravity { gravity: vector } => self.vector = out(vector),
            Command::ForceAt { force, point, .. } => {
                (self.vector, self.point) = (out(force), out(point));
            }
            Command::ImpulseAt { impulse, point, .. } => {
                (self.vector, self.point) = (out(impulse), out(point));
            }
            Command::Torque { torque: vector, .. }
            | Command::TorqueImpulse {
                impulse: vector, ..
            } => self.vector = Some(coordinates.torque_out(vector)),
            _ => {}
        }
    }
}

/// The kind of a command that a fed scene hands to its owner; `None` for the others, which it applies or refuses itself.
const fn kind(command: &Command) -> Option<RequestKind> {
    Some(match command {
        Command::AddBody { .. } => RequestKind::AddBody,
        Command::RemoveBody { .. } => RequestKind::RemoveBody,
        Command::ChangeBody { .. } => RequestKind::ChangeBody,
        Command::SetPose { .. } => RequestKind::SetPose,
        Command::SetVelocity { .. } => RequestKind::SetVelocity,
        Command::Force { .. } | Command::ForceAt { .. } => RequestKind::ApplyForce,
        Command::Torque { .. } => RequestKind::ApplyTorque,
        Command::Impulse { .. } | Command::ImpulseAt { .. } => RequestKind::ApplyImpulse,
        Command::TorqueImpulse { .. } => RequestKind::ApplyTorqueImpulse,
        Command::Sleep { .. } => RequestKind::Sleep,
        Command::Wake { .. } => RequestKind::Wake,
        Command::SetGravity { .. } => RequestKind::SetGravity,
        Command::AddJoint { .. } => RequestKind::AddJoint,
        Command::ChangeJoint { .. } => RequestKind::ChangeJoint,
        Command::RemoveJoint { .. } => RequestKind::RemoveJoint,
        Command::AddShape { .. }
        | Command::RemoveShape { .. }
        | Command::SetEvents { .. }
        | Command::SetLocomotion { .. }
        | Command::Jump { .. }
        | Command::SetWheels { .. } => return None,
    })
}

/// Requests that a program has read and may still answer, by numbers that count them.
#[derive(Debug, Default)]
pub struct OpenRequests {
    last: u64,
    kept: BTreeMap<u64, RequestRecord>,
}

impl OpenRequests {
    /// Requests that are kept. The oldest are dropped: most are answered by what is fed.
    const KEPT_MAX: usize = 65_536;

    /// Keeps a request; returns its number, from 1 on.
    pub fn keep(&mut self, request: RequestRecord) -> u64 {
        self.last += 1;
        self.kept.insert(self.last, request);
        if self.kept.len() > Self::KEPT_MAX {
            self.kept.pop_first();
        }
        self.last
    }

    /// Takes a request for its answer.
    ///
    /// # Errors
    ///
    /// [`BindingError::Value`] for a number of no request, of one that was answered, and of one that was dropped.
    pub fn take(&mut self, number: u64) -> Result<RequestRecord, BindingError> {
        let request = self.kept.remove(&number);
        request.ok_or_else(|| {
            let needed = "the number of a request that was read and not answered yet";
            BindingError::value("request", number, needed)
        })
    }
}

#[cfg(test)]
mod tests {
    use rhumb_client::Peer;

    use super::*;

    #[test]
    fn a_push_is_the_one_that_a_client_of_these_coordinates_gave() {
        let id = BodyId::new(3, 0);
        for coordinates in Coordinates::EACH {
            let (impulse, torque) = (Vec3::new(1.0, 2.0, 3.0), Vec3::new(4.0, 5.0, 6.0));
            let given = [
                (Command::Impulse { id, impulse }, impulse),
                (Command::Torque { id, torque }, torque),
            ];
            for (command, vector) in given {
                let command = coordinates.command_in(command);
                let request = FedRequest::new(None, Peer(1), (0, command));
                let record = RequestRecord::new(request, coordinates);
                let record = record.expect("a push is a request");
                let shown = record.vector.expect("a push has a vector");
                assert!(shown.distance(vector) < 1e-5, "{coordinates:?}: {shown}");
                assert_eq!(record.body, Some(id));
            }
        }
    }

    #[test]
    fn a_request_is_answered_once_and_the_oldest_of_too_many_are_dropped() {
        let id = BodyId::new(0, 0);
        let request = FedRequest::new(None, Peer(1), (7, Command::Wake { id }));
        let record = RequestRecord::new(request, Coordinates::Rhumb).expect("a request");
        let mut open = OpenRequests::default();
        let count = OpenRequests::KEPT_MAX as u64 + 1;
        for number in 1..=count {
            assert_eq!(open.keep(record.clone()), number);
        }
        assert_eq!(open.take(2).expect("it is kept"), record);
        for number in [0, 1, 2, count + 1] {
            let error = open.take(number).expect_err("not to be answered");
            let error = error.to_string();
            assert!(
                error.starts_with("request is ") && error.contains("read"),
                "{error}"
            );
        }
        assert!(open.take(count).is_ok());
    }
}
