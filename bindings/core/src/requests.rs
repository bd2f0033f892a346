//! Requests of followers to the program that feeds their scene.

use glam::{Quat, Vec3};
use rhumb_client::scene::Command;
use rhumb_client::{BodyId, FedRequest};

use crate::coordinates::Coordinates;

/// A request: a command that another member gave. What its kind does not name is `None`.
#[derive(Clone, Debug, PartialEq)]
pub struct RequestRecord {
    /// The request itself, for the answer.
    pub request: FedRequest,
    /// The kind of its command, in words.
    pub kind: &'static str,
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
    /// A request in these coordinates.
    #[must_use]
    pub fn new(request: FedRequest, coordinates: Coordinates) -> Self {
        let mut record = Self {
            kind: kind(&request.command),
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
        record
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

/// The kind of a command, in words.
const fn kind(command: &Command) -> &'static str {
    match command {
        Command::AddBody { .. } => "add body",
        Command::RemoveBody { .. } => "remove body",
        Command::ChangeBody { .. } => "change body",
        Command::SetPose { .. } => "set pose",
        Command::SetVelocity { .. } => "set velocity",
        Command::Force { .. } | Command::ForceAt { .. } => "apply force",
        Command::Torque { .. } => "apply torque",
        Command::Impulse { .. } | Command::ImpulseAt { .. } => "apply impulse",
        Command::TorqueImpulse { .. } => "apply torque impulse",
        Command::Sleep { .. } => "sleep",
        Command::Wake { .. } => "wake",
        Command::SetGravity { .. } => "set gravity",
        Command::AddJoint { .. } => "add joint",
        Command::ChangeJoint { .. } => "change joint",
        Command::RemoveJoint { .. } => "remove joint",
        _ => "other",
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
                let shown = record.vector.expect("a push has a vector");
                assert!(shown.distance(vector) < 1e-5, "{coordinates:?}: {shown}");
                assert_eq!(record.body, Some(id));
            }
        }
    }
}
