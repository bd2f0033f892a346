//! Description of a body, apart from its motion.

use rhumb_reckoning::{BodyId, Damping, ToleranceScale};

use super::checks::{Invalid, Quantity, scalar};
use super::config::check_damping;
use super::material::Material;
use super::shape_id::ShapeId;
use crate::limits::GRAVITY_SCALE_MAX;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Kind of a body's motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BodyKind {
    /// It does not move.
    Static,
    /// The engine moves it.
    Dynamic,
    /// Its member moves it by velocities and poses; it pushes others and is not pushed.
    Kinematic,
}

/// Description of a body: everything constant that a copy needs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyDesc {
    /// Its id.
    pub id: BodyId,
    /// Kind of its motion.
    pub kind: BodyKind,
    /// Its shape, which must exist in the scene.
    pub shape: ShapeId,
    /// `None`: the scene's default.
    pub material: Option<Material>,
    /// `None`: the scene's default.
    pub damping: Option<Damping>,
    /// Factor on the scene's gravity; one for most.
    pub gravity_scale: f32,
    /// True if its axis of spin wanders when its moments of inertia differ, as in physics; true for most.
    pub gyroscopic: bool,
    /// Factor on the tolerance of its streams.
    pub tolerance_scale: ToleranceScale,
    /// True if contacts can turn it; true for most. Otherwise only commands turn it.
    pub turns: bool,
}

/// Bits of the byte that tells which fields follow.
mod flag {
    pub(super) const KIND: u8 = 0b11;
    pub(super) const MATERIAL: u8 = 1 << 2;
    pub(super) const DAMPING: u8 = 1 << 3;
    pub(super) const GRAVITY_SCALE: u8 = 1 << 4;
    pub(super) const NOT_GYROSCOPIC: u8 = 1 << 5;
    pub(super) const CLASS: u8 = 1 << 6;
    pub(super) const DOES_NOT_TURN: u8 = 1 << 7;
}

impl BodyDesc {
    /// A body with the scene's default material and damping, under the scene's gravity.
    #[must_use]
    pub const fn plain(id: BodyId, kind: BodyKind, shape: ShapeId) -> Self {
        Self {
            id,
            kind,
            shape,
            material: None,
            damping: None,
            gravity_scale: 1.0,
            gyroscopic: true,
            tolerance_scale: ToleranceScale::USUAL,
            turns: true,
        }
    }

    /// True if its moments of inertia matter to its free motion.
    #[must_use]
    pub const fn can_tumble(&self) -> bool {
        matches!(self.kind, BodyKind::Dynamic) && self.gyroscopic && self.turns
    }

    /// Checks every number.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first invalid number.
    pub fn check(&self) -> Result<(), Invalid> {
        if let Some(material) = &self.material {
            material.check()?;
        }
        if let Some(damping) = self.damping {
            check_damping(damping)?;
        }
        scalar(
            self.gravity_scale,
            -GRAVITY_SCALE_MAX,
            GRAVITY_SCALE_MAX,
            Quantity::GravityScale,
        )
    }
}

impl Wire for BodyDesc {
    fn encode(&self, to: &mut Writer) {
        let mut flags = match self.kind {
            BodyKind::Static => 0,
            BodyKind::Dynamic => 1,
            BodyKind::Kinematic => 2,
        };
        let scaled = self.gravity_scale.to_bits() != 1.0_f32.to_bits();
        for (set, bit) in [
            (self.material.is_some(), flag::MATERIAL),
            (self.damping.is_some(), flag::DAMPING),
            (scaled, flag::GRAVITY_SCALE),
            (!self.gyroscopic, flag::NOT_GYROSCOPIC),
            (self.tolerance_scale != ToleranceScale::USUAL, flag::CLASS),
            (!self.turns, flag::DOES_NOT_TURN),
        ] {
            if set {
                flags |= bit;
            }
        }
        self.id.encode(to);
        to.u8(flags);
        self.shape.encode(to);
        if let Some(material) = &self.material {
            material.encode(to);
        }
        if let Some(damping) = &self.damping {
            damping.encode(to);
        }
        if scaled {
            to.f32(self.gravity_scale);
        }
        if self.tolerance_scale != ToleranceScale::USUAL {
            to.u8(self.tolerance_scale.exponent().cast_unsigned());
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let id = BodyId::decode(from)?;
        let flags = from.u8()?;
        let kind = match flags & flag::KIND {
            0 => BodyKind::Static,
            1 => BodyKind::Dynamic,
            2 => BodyKind::Kinematic,
            _ => return Err(Malformed::UnknownCode),
        };
        let shape = ShapeId::decode(from)?;
        let mut desc = Self::plain(id, kind, shape);
        desc.gyroscopic = flags & flag::NOT_GYROSCOPIC == 0;
        desc.turns = flags & flag::DOES_NOT_TURN == 0;
        if flags & flag::MATERIAL != 0 {
            desc.material = Some(Material::decode(from)?);
        }
        if flags & flag::DAMPING != 0 {
            desc.damping = Some(Damping::decode(from)?);
        }
        if flags & flag::GRAVITY_SCALE != 0 {
            desc.gravity_scale = from.f32()?;
            if desc.gravity_scale.to_bits() == 1.0_f32.to_bits() {
                return Err(Malformed::NotCanonical);
            }
        }
        if flags & flag::CLASS != 0 {
            let tolerance_scale =
                ToleranceScale::new(from.u8()?.cast_signed()).ok_or(Malformed::OutOfRange)?;
            if tolerance_scale == ToleranceScale::USUAL {
                return Err(Malformed::NotCanonical);
            }
            desc.tolerance_scale = tolerance_scale;
        }
        Ok(desc)
    }
}
