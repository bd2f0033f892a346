//! Description of a body, apart from its motion and its shape.
//!
//! Its kind, mass, surface, collision groups, locked axes and settings. Nothing here depends on an engine.

use core::ops::BitOr;

use glam::Vec3;
use rhumb_reckoning::{BodyId, Damping, ToleranceScale};

use super::checks::{Invalid, Quantity, Rule, outside, scalar};
use super::shape::ShapeId;
use super::{Material, Sleep, check_damping};
use crate::limits::{GRAVITY_SCALE_MAX, GYRATION_MAX, GYRATION_MIN, MASS_MAX, MASS_MIN};
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
    /// True if it is swept against moving bodies, swept ones too, so that it does not pass through them within a step.
    /// Every fast body is swept against fixed ones.
    pub swept: bool,
    /// `None`: the scene's conditions. Only dynamic bodies use it.
    pub sleep: Option<Sleep>,
    /// True if it takes part in the scene: a body that does not stays where it is, touches nothing, and its joints do
    /// not act.
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
        self.moments.map_or(Ok(()), check_sums)
    }
}

/// Checks that no moment is greater than the other two together, but for a thousandth: no body has such moments.
fn check_sums(moments: Vec3) -> Result<(), Invalid> {
    let [x, y, z] = moments.to_array().map(f64::from);
    for (moment, others) in [(x, y + z), (y, x + z), (z, x + y)] {
        if 1000.0 * moment > 1001.0 * others {
            let wrong = outside(Rule::OutOfRange, Quantity::Moments, [moment, 0.0, others]);
            let wrong = wrong.of("moment of inertia of a body with the other two", "kg·m²");
            return Err(wrong.advised(
                "no moment exceeds the sum of the other two; leave them out to have those of the shape",
            ));
        }
    }
    Ok(())
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

/// Two bodies touch each other if each is a member of a group that the other one touches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CollisionGroups {
    /// One bit for each group of the body.
    pub members: u32,
    /// One bit for each group that the body touches.
    pub touches: u32,
}

impl CollisionGroups {
    /// A member of every group that touches every group.
    pub const ALL: Self = Self {
        members: u32::MAX,
        touches: u32::MAX,
    };
}

impl Wire for CollisionGroups {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.members));
        to.varint(u64::from(self.touches));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(Self {
            members: from.varint32()?,
            touches: from.varint32()?,
        })
    }
}

/// Axes without motion: translations along x, y and z, then rotations about x, y and z.
///
/// The axes of a body's set are those of the world, the axes of a joint's set those of its first frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct LockedAxes(u8);

impl LockedAxes {
    /// Every motion is free.
    pub const NONE: Self = Self(0);
    /// No rotation.
    pub const ROTATIONS: Self = Self(0b11_1000);
    /// No translation.
    pub const TRANSLATIONS: Self = Self(0b00_0111);
    /// Each axis, in order.
    pub const EACH: [Self; 6] = [
        Self(1),
        Self(1 << 1),
        Self(1 << 2),
        Self(1 << 3),
        Self(1 << 4),
        Self(1 << 5),
    ];

    /// The set of these bits, one per axis in order; `None` beyond six bits.
    #[must_use]
    pub const fn new(bits: u8) -> Option<Self> {
        if bits < 1 << 6 {
            Some(Self(bits))
        } else {
            None
        }
    }

    /// One bit per axis, in order.
    #[must_use]
    pub const fn bits(self) -> u8 {
        self.0
    }

    /// True if no axis is locked.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// True if the axis of this number, below six, is locked.
    #[must_use]
    pub const fn locks(self, axis: usize) -> bool {
        self.0 & (1 << axis) != 0
    }
}

impl BitOr for LockedAxes {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl Wire for LockedAxes {
    fn encode(&self, to: &mut Writer) {
        to.u8(self.0);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Self::new(from.u8()?).ok_or(Malformed::UnknownCode)
    }
}

#[cfg(test)]
mod tests {
    use alloc::string::ToString;

    use super::*;

    fn checked(moments: [f32; 3]) -> Result<(), Invalid> {
        let moments = Some(Vec3::from_array(moments));
        Mass { mass: 1.0, moments }.check()
    }

    #[test]
    fn moments_that_no_body_has_are_refused_with_the_value_the_limit_and_the_way_out() {
        // A plate's greatest moment is the sum of the others, and may be rounded.
        for sound in [[0.1, 0.2, 0.3], [1.0, 1.0, 1.0], [0.333, 0.167, 0.5003]] {
            assert_eq!(checked(sound), Ok(()), "{sound:?}");
        }
        for place in 0..3 {
            let mut moments = [1.0; 3];
            moments[place] = 2.5;
            let wrong = checked(moments).unwrap_err();
            assert_eq!(wrong, Invalid::out_of_range(Quantity::Moments));
            assert_eq!(
                wrong.to_string(),
                "moment of inertia of a body with the other two is 2.5 kg·m², and must be 0 to 2 kg·m²: no moment exceeds the sum of the other two; leave them out to have those of the shape"
            );
        }
    }
}
