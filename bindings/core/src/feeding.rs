//! A scene that a program feeds: its states in, requests of followers out.
//!
//! A binding whose requests are objects keeps each in its own; one whose requests are flat keeps them in
//! [`OpenRequests`], and answers by number.
//!
//! The client checks that bodies are in the scene, that none has two states, and the limits of numbers.
//! Invariant: a feed of no more bodies than one before allocates nothing here.

use std::collections::BTreeMap;

use glam::{Quat, Vec3};
use rhumb_client::scene::Command;
use rhumb_client::{BodyCentres, BodyId, BodyState, FedRequest, FedVelocities};

use crate::coordinates::Coordinates;
use crate::descriptions::StateRecord;
use crate::error::BindingError;
use crate::generated::RequestKind;
use crate::records::parse_packed_id;

/// A request: a command that another member gave. Fields that its kind does not name are `None`.
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

/// Rows of numbers: one for each body, or one that stands for all.
#[derive(Clone, Copy, Debug)]
pub enum Rows<'a, const WIDTH: usize> {
    /// One for each body.
    Each(&'a [[f32; WIDTH]]),
    /// The same for all.
    All([f32; WIDTH]),
}

impl<const WIDTH: usize> Rows<'_, WIDTH> {
    /// The row of a body, whose place is below the number of bodies.
    const fn at(&self, place: usize) -> [f32; WIDTH] {
        match self {
            Self::Each(rows) => rows[place],
            Self::All(row) => *row,
        }
    }

    fn check(&self, count: usize, name: &'static str) -> Result<(), BindingError> {
        match self {
            Self::Each(rows) if rows.len() != count => {
                let needed = format_args!("{count} rows: as many as there are bodies");
                Err(BindingError::value(name, rows.len(), needed))
            }
            _ => Ok(()),
        }
    }
}

/// States of bodies as arrays, in the application's coordinates.
#[derive(Clone, Copy, Debug)]
pub struct FedArrays<'a> {
    /// Packed ids.
    pub bodies: &'a [u64],
    /// Centres of mass, or origins of hulls and compounds that this client added.
    pub positions: Rows<'a, 3>,
    /// Body → world: x, y, z, w.
    pub rotations: Rows<'a, 4>,
    /// Units of length per second.
    pub linear_velocities: Option<Rows<'a, 3>>,
    /// rad/s about world axes.
    pub angular_velocities: Option<Rows<'a, 3>>,
}

impl FedArrays<'_> {
    /// The source of the velocities: the engine, or, without any, the poses.
    #[must_use]
    pub const fn velocities(&self) -> FedVelocities {
        match (self.linear_velocities, self.angular_velocities) {
            (None, None) => FedVelocities::FromPoses,
            _ => FedVelocities::Given,
        }
    }

    fn check(&self) -> Result<(), BindingError> {
        let count = self.bodies.len();
        let still = Rows::All([0.0; 3]);
        self.positions.check(count, "positions")?;
        self.rotations.check(count, "rotations")?;
        let linear = self.linear_velocities.unwrap_or(still);
        linear.check(count, "linear velocities")?;
        let angular = self.angular_velocities.unwrap_or(still);
        angular.check(count, "angular velocities")
    }
}

/// Memory for the states of one feed.
#[derive(Debug, Default)]
pub(crate) struct FedStates {
    states: Vec<(BodyId, BodyState)>,
}

impl FedStates {
    /// The states of arrays, in Rhumb's coordinates and of the centres of mass.
    pub(crate) fn convert(
        &mut self,
        arrays: &FedArrays<'_>,
        coordinates: Coordinates,
        centres: &BodyCentres,
    ) -> Result<&[(BodyId, BodyState)], BindingError> {
        arrays.check()?;
        let still = Rows::All([0.0; 3]);
        let linear = arrays.linear_velocities.unwrap_or(still);
        let angular = arrays.angular_velocities.unwrap_or(still);
        let are_centred = centres.is_empty();
        self.states.clear();
        self.states.reserve(arrays.bodies.len());
        for (place, word) in arrays.bodies.iter().enumerate() {
            let body = parse_packed_id(*word)?;
            let position = coordinates.vector_in(Vec3::from_array(arrays.positions.at(place)));
            let rotation = coordinates.rotation_in(Quat::from_array(arrays.rotations.at(place)));
            let record = StateRecord {
                body,
                position: match are_centred {
                    true => position,
                    false => centres.position_in(body, position, rotation),
                },
                rotation,
                linear_velocity: coordinates.vector_in(Vec3::from_array(linear.at(place))),
                angular_velocity: coordinates.angular_in(Vec3::from_array(angular.at(place))),
            };
            self.states.push((body, state_of(&record)?));
        }
        Ok(&self.states)
    }
}

fn state_of(record: &StateRecord) -> Result<BodyState, BindingError> {
    let state = BodyState::new(
        record.position.to_array(),
        record.rotation.to_array(),
        record.linear_velocity.to_array(),
        record.angular_velocity.to_array(),
    );
    // The check of a record names the body.
    state.map_err(|cause| record.check().err().unwrap_or_else(|| cause.into()))
}

#[cfg(test)]
mod tests {
    use rhumb_client::Peer;

    use super::*;
    use crate::records::packed_id;

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

    const IDS: [BodyId; 2] = [BodyId::new(4, 1), BodyId::new(0, 0)];

    fn arrays<'a>(bodies: &'a [u64], positions: &'a [[f32; 3]]) -> FedArrays<'a> {
        FedArrays {
            bodies,
            positions: Rows::Each(positions),
            rotations: Rows::All([0.0, 0.0, 0.0, 1.0]),
            linear_velocities: None,
            angular_velocities: Some(Rows::All([0.0, 0.0, 2.0])),
        }
    }

    #[test]
    fn states_are_those_of_the_arrays_in_the_coordinates_of_rhumb() {
        let bodies = IDS.map(packed_id);
        let positions = [[100.0, 200.0, 300.0], [0.0; 3]];
        let given = arrays(&bodies, &positions);
        let mut fed = FedStates::default();
        let mut centres = BodyCentres::default();
        let states = fed.convert(&given, Coordinates::Unreal, &centres);
        let states = states.expect("they are right");
        assert_eq!(states.iter().map(|(id, _)| *id).collect::<Vec<_>>(), IDS);
        let parts = states[0].1.parts();
        assert_eq!(parts[..3], [1.0, 3.0, 2.0]);
        assert_eq!(parts[7..], [0.0, 0.0, 0.0, 0.0, -2.0, 0.0]);
        assert_eq!(given.velocities(), FedVelocities::Given);
        centres.keep(&IDS, &[Vec3::ZERO, Vec3::X]);
        let states = fed.convert(&given, Coordinates::Rhumb, &centres);
        assert_eq!(
            states.expect("they are right")[1].1.position(),
            [1.0, 0.0, 0.0]
        );
    }

    #[test]
    fn what_is_wrong_is_named() {
        let bodies = IDS.map(packed_id);
        let mut fed = FedStates::default();
        let mut error = |arrays: FedArrays<'_>| {
            let centres = BodyCentres::default();
            let converted = fed.convert(&arrays, Coordinates::Rhumb, &centres);
            converted.expect_err("an array is wrong").to_string()
        };
        assert_eq!(
            error(arrays(&bodies, &[[0.0; 3]])),
            "positions is 1, and must be 2 rows: as many as there are bodies"
        );
        let nan = error(arrays(&bodies, &[[0.0; 3], [0.0, f32::NAN, 0.0]]));
        assert!(nan.contains("body 1") && nan.contains("position"), "{nan}");
        let unknown = error(arrays(&[1, 0], &[[0.0; 3]; 2]));
        assert_eq!(unknown, "0x0 is the id of no body");
    }
}
