//! Material of a body: surface and density.

use super::checks::{Invalid, Quantity, scalar};
use crate::limits::{DENSITY_MAX, DENSITY_MIN, FRICTION_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Friction, restitution and density.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Coulomb coefficient, ≥ 0.
    pub friction: f32,
    /// Share of the closing speed that is returned, in [0, 1].
    pub restitution: f32,
    /// Density, kg/m³.
    pub density: f32,
}

impl Material {
    /// Checks every number.
    ///
    /// # Errors
    /// [`Invalid`] names the first invalid number.
    /// [`Invalid`] names the first that is wrong.
    pub fn check(&self) -> Result<(), Invalid> {
        scalar(self.friction, 0.0, FRICTION_MAX, Quantity::Friction)?;
        scalar(self.restitution, 0.0, 1.0, Quantity::Restitution)?;
        scalar(self.density, DENSITY_MIN, DENSITY_MAX, Quantity::Density)
    }
}

impl Wire for Material {
    fn encode(&self, to: &mut Writer) {
        to.f32s(&[self.friction, self.restitution, self.density]);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let [friction, restitution, density] = from.f32s()?;
        Ok(Self {
            friction,
            restitution,
            density,
        })
    }
}
