//! Description of a body, apart from its motion.

use rhumb_reckoning::{BodyId, Damping, ToleranceScale};

use super::checks::{Invalid, Quantity, scalar};
use super::collision_groups::CollisionGroups;
use super::config::check_damping;
use super::locked_axes::LockedAxes;
use super::mass::Mass;
use super::material::Material;
use super::shape_id::ShapeId;
use super::sleep::Sleep;
use crate::limits::GRAVITY_SCALE_MAX;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Kind of a body's motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BodyKind {
    /// It does not move.
    Fixed,
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
    /// World axes along or about which the engine does not move it; none for most. Commands still do.
    pub locked: LockedAxes,
    /// `None`: its shape's volume times the density of its material. Only dynamic bodies use it.
    pub mass: Option<Mass>,
    /// Groups that decide which bodies it touches.
    pub groups: CollisionGroups,
    /// Of two touching dynamic bodies the one of lower dominance is pushed out as by a body that cannot move and stands
    /// still; zero for most.
    pub dominance: i8,
    /// True if bodies pass through it.
    pub sensor: bool,
    /// True if it is swept against moving bodies, swept ones too, so that it does not pass through them within a step. Every
    /// fast body is swept against fixed ones.
    pub swept: bool,
    /// `None`: the scene's conditions. Only dynamic bodies use it.
    pub sleep: Option<Sleep>,
    /// True if it takes part in the scene: a body that does not stays where it is, touches nothing, and its joints do not
    /// act.
    pub enabled: bool,
}

/// Bits of the number that tells which fields follow; the more common ones come first.
mod flag {
    pub(super) const KIND: u64 = 0b11;
    pub(super) const MATERIAL: u64 = 1 << 2;
    pub(super) const DAMPING: u64 = 1 << 3;
    pub(super) const GRAVITY_SCALE: u64 = 1 << 4;
    pub(super) const NOT_GYROSCOPIC: u64 = 1 << 5;
    pub(super) const TOLERANCE_SCALE: u64 = 1 << 6;
    pub(super) const LOCKED: u64 = 1 << 7;
    pub(super) const MASS: u64 = 1 << 8;
    pub(super) const GROUPS: u64 = 1 << 9;
    pub(super) const DOMINANCE: u64 = 1 << 10;
    pub(super) const SENSOR: u64 = 1 << 11;
    pub(super) const SWEPT: u64 = 1 << 12;
    pub(super) const DISABLED: u64 = 1 << 13;
    pub(super) const SLEEP: u64 = 1 << 14;
    pub(super) const ALL: u64 = (1 << 15) - 1;
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
            locked: LockedAxes::NONE,
            mass: None,
            groups: CollisionGroups::ALL,
            dominance: 0,
            sensor: false,
            swept: false,
            sleep: None,
            enabled: true,
        }
    }

    /// True if its moments of inertia matter to its free motion.
    #[must_use]
    pub(crate) const fn can_tumble(&self) -> bool {
        matches!(self.kind, BodyKind::Dynamic) && self.gyroscopic && self.locked.is_empty()
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
        )?;
        self.mass.map_or(Ok(()), |mass| mass.check())?;
        self.sleep.map_or(Ok(()), Sleep::check)
    }

    /// Bits for its fields that differ from their defaults.
    fn flags(&self) -> u64 {
        let kind = match self.kind {
            BodyKind::Fixed => 0,
            BodyKind::Dynamic => 1,
            BodyKind::Kinematic => 2,
        };
        let is_set = [
            (self.material.is_some(), flag::MATERIAL),
            (self.damping.is_some(), flag::DAMPING),
            (
                self.gravity_scale.to_bits() != 1.0_f32.to_bits(),
                flag::GRAVITY_SCALE,
            ),
            (!self.gyroscopic, flag::NOT_GYROSCOPIC),
            (
                self.tolerance_scale != ToleranceScale::USUAL,
                flag::TOLERANCE_SCALE,
            ),
            (!self.locked.is_empty(), flag::LOCKED),
            (self.mass.is_some(), flag::MASS),
            (self.groups != CollisionGroups::ALL, flag::GROUPS),
            (self.dominance != 0, flag::DOMINANCE),
            (self.sensor, flag::SENSOR),
            (self.swept, flag::SWEPT),
            (!self.enabled, flag::DISABLED),
            (self.sleep.is_some(), flag::SLEEP),
        ];
        let set = is_set.into_iter().filter(|(is_set, _)| *is_set);
        set.fold(kind, |flags, (_, bit)| flags | bit)
    }
}

impl Wire for BodyDesc {
    fn encode(&self, to: &mut Writer) {
        let flags = self.flags();
        self.id.encode(to);
        to.varint(flags);
        self.shape.encode(to);
        if let Some(material) = &self.material {
            material.encode(to);
        }
        if let Some(damping) = &self.damping {
            damping.encode(to);
        }
        if flags & flag::GRAVITY_SCALE != 0 {
            to.f32(self.gravity_scale);
        }
        if flags & flag::TOLERANCE_SCALE != 0 {
            to.u8(self.tolerance_scale.exponent().cast_unsigned());
        }
        if flags & flag::LOCKED != 0 {
            self.locked.encode(to);
        }
        if let Some(mass) = &self.mass {
            mass.encode(to);
        }
        if flags & flag::GROUPS != 0 {
            self.groups.encode(to);
        }
        if flags & flag::DOMINANCE != 0 {
            to.u8(self.dominance.cast_unsigned());
        }
        if let Some(sleep) = &self.sleep {
            sleep.encode(to);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let id = BodyId::decode(from)?;
        let flags = from.varint_to(flag::ALL)?;
        let kind = match flags & flag::KIND {
            0 => BodyKind::Fixed,
            1 => BodyKind::Dynamic,
            2 => BodyKind::Kinematic,
            _ => return Err(Malformed::UnknownCode),
        };
        let shape = ShapeId::decode(from)?;
        let mut desc = Self::plain(id, kind, shape);
        desc.gyroscopic = flags & flag::NOT_GYROSCOPIC == 0;
        desc.sensor = flags & flag::SENSOR != 0;
        desc.swept = flags & flag::SWEPT != 0;
        desc.enabled = flags & flag::DISABLED == 0;
        if flags & flag::MATERIAL != 0 {
            desc.material = Some(Material::decode(from)?);
        }
        if flags & flag::DAMPING != 0 {
            desc.damping = Some(Damping::decode(from)?);
        }
        if flags & flag::GRAVITY_SCALE != 0 {
            desc.gravity_scale = from.f32()?;
        }
        if flags & flag::TOLERANCE_SCALE != 0 {
            let exponent = from.u8()?.cast_signed();
            desc.tolerance_scale = ToleranceScale::new(exponent).ok_or(Malformed::OutOfRange)?;
        }
        if flags & flag::LOCKED != 0 {
            desc.locked = LockedAxes::decode(from)?;
        }
        if flags & flag::MASS != 0 {
            desc.mass = Some(Mass::decode(from)?);
        }
        if flags & flag::GROUPS != 0 {
            desc.groups = CollisionGroups::decode(from)?;
        }
        if flags & flag::DOMINANCE != 0 {
            desc.dominance = from.u8()?.cast_signed();
        }
        if flags & flag::SLEEP != 0 {
            desc.sleep = Some(Sleep::decode(from)?);
        }
        // A field that equals its default is not sent.
        if desc.flags() == flags {
            Ok(desc)
        } else {
            Err(Malformed::NotCanonical)
        }
    }
}
