//! States that a program feeds: from its arrays to those of the client.
//!
//! Whether bodies are in the scene, whether one has two states, and the limits of numbers are checked by the client. Invariant:
//! a feed of no more bodies than one before allocates nothing here.

use glam::{Quat, Vec3};
use rhumb_client::{BodyCentres, BodyId, BodyState, FedVelocities};

use crate::coordinates::Coordinates;
use crate::descriptions::StateRecord;
use crate::error::BindingError;
use crate::records::parse_packed_id;

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
    /// Whether the velocities are the engine's: without any, they follow from the poses.
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
    use super::*;
    use crate::records::packed_id;

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
