//! Locomotion of a body: a character that walks, or a vehicle on wheels.

use super::character::Character;
use super::checks::Invalid;
use super::vehicle::Vehicle;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Locomotion of a body: the way in which the server moves it from step to step.
#[derive(Clone, Debug, PartialEq)]
pub enum Locomotion {
    /// None: the engine or commands move the body.
    None,
    /// A kinematic body walks.
    Character(Character),
    /// A dynamic body rolls on wheels.
    Vehicle(Vehicle),
}

impl Locomotion {
    /// Checks every number.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first that is wrong.
    pub fn check(&self) -> Result<(), Invalid> {
        match self {
            Self::None => Ok(()),
            Self::Character(character) => character.check(),
            Self::Vehicle(vehicle) => vehicle.check(),
        }
    }
}

impl From<Character> for Locomotion {
    fn from(character: Character) -> Self {
        Self::Character(character)
    }
}

impl From<Vehicle> for Locomotion {
    fn from(vehicle: Vehicle) -> Self {
        Self::Vehicle(vehicle)
    }
}

impl Wire for Locomotion {
    fn encode(&self, to: &mut Writer) {
        match self {
            Self::None => to.u8(0),
            Self::Character(character) => {
                to.u8(1);
                character.encode(to);
            }
            Self::Vehicle(vehicle) => {
                to.u8(2);
                vehicle.encode(to);
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(match from.u8()? {
            0 => Self::None,
            1 => Self::Character(Character::decode(from)?),
            2 => Self::Vehicle(Vehicle::decode(from)?),
            _ => return Err(Malformed::UnknownCode),
        })
    }
}
