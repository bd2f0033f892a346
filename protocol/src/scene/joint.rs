//! Joints between two bodies.
//!
//! Each body has a frame of the joint. A kind tells which motions of the second frame in the first are free, and
//! limits bound them. Frames are in the axes of their body, from its centre of mass.

use core::f32::consts::PI;
use core::fmt;

use glam::{Quat, Vec3};
use rhumb_reckoning::BodyId;

use super::checks::{Invalid, Quantity, rotation, scalar, vector};
use crate::limits::{EXTENT_MAX, JOINTS_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Names a joint of one scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct JointId(pub u32);

impl fmt::Display for JointId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "joint {}", self.0)
    }
}

impl Wire for JointId {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.0));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let number = from.varint_to(u64::from(JOINTS_MAX) - 1)?;
        Ok(Self(number as u32))
    }
}

/// Frame of a joint in one of its bodies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointFrame {
    /// From the body's centre of mass, along its axes, metres.
    pub anchor: Vec3,
    /// Frame → body.
    pub rotation: Quat,
}

impl JointFrame {
    /// A frame with the axes of its body.
    #[must_use]
    pub const fn at(anchor: Vec3) -> Self {
        Self {
            anchor,
            rotation: Quat::IDENTITY,
        }
    }

    fn check(&self) -> Result<(), Invalid> {
        vector(self.anchor, EXTENT_MAX, Quantity::Anchor)?;
        rotation(self.rotation)
    }
}

/// Limits of a free motion: radians or metres, inclusive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLimits {
    /// The least.
    pub least: f32,
    /// The most, not below the least.
    pub most: f32,
}

impl JointLimits {
    fn check(&self, most: f32) -> Result<(), Invalid> {
        scalar(self.least, -most, most, Quantity::JointLimit)?;
        scalar(self.most, self.least, most, Quantity::JointLimit)
    }
}

/// Free motions of the second frame in the first. Angles: twice the arc sine of a part of the turn's quaternion,
/// radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JointKind {
    /// Nothing.
    Fixed,
    /// Every turn; limits about x, y and z.
    Spherical(Option<[JointLimits; 3]>),
    /// The turn about x.
    Revolute(Option<JointLimits>),
    /// The displacement along x.
    Prismatic(Option<JointLimits>),
}

impl JointKind {
    /// Its limits, if it has any.
    #[must_use]
    pub const fn limits(&self) -> &[JointLimits] {
        match self {
            Self::Spherical(Some(limits)) => limits,
            Self::Revolute(Some(limits)) | Self::Prismatic(Some(limits)) => {
                core::slice::from_ref(limits)
            }
            Self::Fixed | Self::Spherical(None) | Self::Revolute(None) | Self::Prismatic(None) => {
                &[]
            }
        }
    }
}

/// A joint of two bodies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// Its free motions.
    pub kind: JointKind,
    /// The bodies, two different ones.
    pub bodies: [BodyId; 2],
    /// Its frame in each body.
    pub frames: [JointFrame; 2],
    /// True if the two bodies also collide with each other.
    pub collide: bool,
}

impl Joint {
    /// Checks every number.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first invalid number.
    pub fn check(&self) -> Result<(), Invalid> {
        for frame in &self.frames {
            frame.check()?;
        }
        let most = match self.kind {
            JointKind::Prismatic(_) => EXTENT_MAX,
            JointKind::Fixed | JointKind::Spherical(_) | JointKind::Revolute(_) => PI,
        };
        let mut limits = self.kind.limits().iter();
        limits.try_for_each(|limits| limits.check(most))
    }
}

/// Bits of the byte that tells which fields follow.
mod flag {
    pub(super) const KIND: u8 = 0b11;
    pub(super) const COLLIDE: u8 = 1 << 2;
    pub(super) const LIMITS: u8 = 1 << 3;
    pub(super) const ROTATIONS: [u8; 2] = [1 << 4, 1 << 5];
    pub(super) const ALL: u8 = (1 << 6) - 1;
}

/// Bits of the rotation that the encoding omits.
const IDENTITY_BITS: [u32; 4] = [0, 0, 0, 1.0_f32.to_bits()];

fn is_identity(rotation: Quat) -> bool {
    rotation.to_array().map(f32::to_bits) == IDENTITY_BITS
}

impl Wire for JointLimits {
    fn encode(&self, to: &mut Writer) {
        to.f32s(&[self.least, self.most]);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let [least, most] = from.f32s()?;
        Ok(Self { least, most })
    }
}

impl Wire for Joint {
    fn encode(&self, to: &mut Writer) {
        let mut flags = match self.kind {
            JointKind::Fixed => 0,
            JointKind::Spherical(_) => 1,
            JointKind::Revolute(_) => 2,
            JointKind::Prismatic(_) => 3,
        };
        let turned = self.frames.map(|frame| !is_identity(frame.rotation));
        for (present, bit) in [
            (self.collide, flag::COLLIDE),
            (!self.kind.limits().is_empty(), flag::LIMITS),
            (turned[0], flag::ROTATIONS[0]),
            (turned[1], flag::ROTATIONS[1]),
        ] {
            if present {
                flags |= bit;
            }
        }
        to.u8(flags);
        for ((body, frame), turned) in self.bodies.iter().zip(&self.frames).zip(turned) {
            body.encode(to);
            to.f32s(&frame.anchor.to_array());
            if turned {
                to.f32s(&frame.rotation.to_array());
            }
        }
        for limits in self.kind.limits() {
            limits.encode(to);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let flags = from.u8()?;
        if flags & !flag::ALL != 0 {
            return Err(Malformed::UnknownCode);
        }
        let mut side = |bit| {
            let body = BodyId::decode(from)?;
            let mut frame = JointFrame::at(Vec3::from_array(from.f32s()?));
            if flags & bit != 0 {
                frame.rotation = Quat::from_array(from.f32s()?);
                if is_identity(frame.rotation) {
                    return Err(Malformed::NotCanonical);
                }
            }
            Ok((body, frame))
        };
        let [(first, first_frame), (second, second_frame)] =
            [side(flag::ROTATIONS[0])?, side(flag::ROTATIONS[1])?];
        let limited = flags & flag::LIMITS != 0;
        let mut limits = || JointLimits::decode(from);
        let kind = match (flags & flag::KIND, limited) {
            (0, false) => JointKind::Fixed,
            (0, true) => return Err(Malformed::UnknownCode),
            (1, false) => JointKind::Spherical(None),
            (1, true) => JointKind::Spherical(Some([limits()?, limits()?, limits()?])),
            (2, false) => JointKind::Revolute(None),
            (2, true) => JointKind::Revolute(Some(limits()?)),
            (_, false) => JointKind::Prismatic(None),
            (_, true) => JointKind::Prismatic(Some(limits()?)),
        };
        Ok(Self {
            kind,
            bodies: [first, second],
            frames: [first_frame, second_frame],
            collide: flags & flag::COLLIDE != 0,
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn number() -> impl Strategy<Value = f32> {
        prop_oneof![
            any::<f32>().prop_filter("NaN equals nothing", |x| !x.is_nan()),
            Just(0.0)
        ]
    }

    fn limits() -> impl Strategy<Value = JointLimits> {
        (number(), number()).prop_map(|(least, most)| JointLimits { least, most })
    }

    fn frame() -> impl Strategy<Value = JointFrame> {
        let rotation = prop_oneof![
            Just(Quat::IDENTITY),
            (number(), number()).prop_map(|(x, w)| Quat::from_xyzw(x, 0.0, 1.0, w)),
        ];
        let anchor = (number(), number()).prop_map(|(x, z)| Vec3::new(x, 1.0, z));
        (anchor, rotation).prop_map(|(anchor, rotation)| JointFrame { anchor, rotation })
    }

    fn joint() -> impl Strategy<Value = Joint> {
        let kind = prop_oneof![
            Just(JointKind::Fixed),
            prop::option::of([limits(), limits(), limits()]).prop_map(JointKind::Spherical),
            prop::option::of(limits()).prop_map(JointKind::Revolute),
            prop::option::of(limits()).prop_map(JointKind::Prismatic),
        ];
        let body = || (0..1_u32 << 20, any::<u16>()).prop_map(|(i, g)| BodyId::new(i, g));
        (kind, [body(), body()], [frame(), frame()], any::<bool>()).prop_map(
            |(kind, bodies, frames, collide)| Joint {
                kind,
                bodies,
                frames,
                collide,
            },
        )
    }

    proptest! {
        #[test]
        fn a_joint_round_trips_and_truncations_are_refused(joint in joint()) {
            let mut writer = Writer::new();
            joint.encode(&mut writer);
            let bytes = writer.into_bytes();
            let mut reader = Reader::new(&bytes);
            prop_assert_eq!(Joint::decode(&mut reader), Ok(joint));
            prop_assert_eq!(reader.finish(), Ok(()));
            for cut in 0..bytes.len() {
                let cut = Joint::decode(&mut Reader::new(&bytes[..cut]));
                prop_assert_eq!(cut, Err(Malformed::Truncated));
            }
        }

        #[test]
        fn a_decoded_joint_encodes_to_the_same_bytes(bytes in prop::collection::vec(any::<u8>(), 0..120)) {
            let mut reader = Reader::new(&bytes);
            if let Ok(joint) = Joint::decode(&mut reader) {
                let mut writer = Writer::new();
                joint.encode(&mut writer);
                prop_assert_eq!(&writer.into_bytes()[..], &bytes[..bytes.len() - reader.rest().len()]);
            }
        }
    }

    #[test]
    fn limits_that_cross_are_refused() {
        let limits = |least, most| JointLimits { least, most };
        let wrong = Err(Invalid::OutOfRange(Quantity::JointLimit));
        assert_eq!(limits(0.5, 0.4).check(PI), wrong);
        assert_eq!(limits(-4.0, 0.4).check(PI), wrong);
        assert_eq!(limits(0.5, 0.5).check(PI), Ok(()));
    }
}
