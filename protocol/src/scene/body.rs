//! What a body is, apart from where it is.

use rhumb_reckoning::{BodyId, Damping, ToleranceScale};

use super::checks::{Invalid, Quantity, scalar};
use super::config::check_damping;
use super::material::Material;
use super::shape::ShapeId;
use crate::limits::GRAVITY_SCALE_MAX;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Who moves a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BodyKind {
    /// Nobody.
    Static,
    /// The engine.
    Dynamic,
    /// Its member, by velocities and poses; it pushes others and is not pushed.
    Kinematic,
}

/// What everybody who copies a body must know of it once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyDesc {
    /// Its name.
    pub id: BodyId,
    /// Who moves it.
    pub kind: BodyKind,
    /// Its shape, one of the scene's.
    pub shape: ShapeId,
    /// The scene's, unless it brings its own.
    pub material: Option<Material>,
    /// The scene's, unless it brings its own.
    pub damping: Option<Damping>,
    /// Factor on the scene's gravity; one for most.
    pub gravity_scale: f32,
    /// Whether the axis of its spin wanders when its moments of inertia differ, as physics has it; true for most.
    pub gyroscopic: bool,
    /// How much closer or looser than its streams it is followed.
    pub tolerance_scale: ToleranceScale,
    /// Whether it can be turned by what touches it; true for most. What cannot is turned by commands alone.
    pub turns: bool,
}

/// Bits of the byte that says what follows.
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
    /// A body of the scene's own material and damping under the scene's own gravity.
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

    /// Whether its moments of inertia matter to how it moves when nothing touches it.
    #[must_use]
    pub const fn can_tumble(&self) -> bool {
        matches!(self.kind, BodyKind::Dynamic) && self.gyroscopic && self.turns
    }

    /// Checks every number.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first that is wrong.
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
