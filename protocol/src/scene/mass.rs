//! Mass and moments of inertia that do not follow from shape and density.

use glam::Vec3;

use super::checks::{Invalid, Quantity, scalar};
use crate::limits::{GYRATION_MAX, GYRATION_MIN, MASS_MAX, MASS_MIN};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Mass of a body in place of its shape's volume times the density of its material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mass {
    /// kg.
    pub mass: f32,
    /// Moments of inertia about the body's own axes, kg·m²; `None`: those of its shape, in proportion to the mass.
    pub moments: Option<Vec3>,
}

impl Mass {
    /// Checks every number.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first invalid number.
    pub fn check(&self) -> Result<(), Invalid> {
        scalar(self.mass, MASS_MIN, MASS_MAX, Quantity::Mass)?;
        let (least, most) = (self.mass * GYRATION_MIN, self.mass * GYRATION_MAX);
        for moment in self.moments.iter().flat_map(Vec3::to_array) {
            scalar(moment, least, most, Quantity::Moments)
                .map_err(|wrong| wrong.of("moment of inertia of a body of this mass", "kg·m²"))?;
        }
        Ok(())
    }
}

impl Wire for Mass {
    fn encode(&self, to: &mut Writer) {
        to.f32(self.mass);
        to.u8(u8::from(self.moments.is_some()));
        if let Some(moments) = self.moments {
            to.f32s(&moments.to_array());
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(Self {
            mass: from.f32()?,
            moments: match from.u8()? {
                0 => None,
                1 => Some(Vec3::from_array(from.f32s()?)),
                _ => return Err(Malformed::UnknownCode),
            },
        })
    }
}
