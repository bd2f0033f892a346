//! Joints between two bodies, their motors, and the joints of a scene.
//!
//! Each body has a frame of the joint. A kind tells which motions of the second frame in the first are free, and
//! limits bound them. Frames are in the axes of their body, from its centre of mass. Server and client keep the same
//! table of joints. Invariant: a joint is found under its id and under both of its bodies, or not at all.

use alloc::collections::{BTreeMap, BTreeSet};
use alloc::vec::Vec;
use core::f32::consts::{PI, TAU};
use core::fmt;

use glam::{Quat, Vec3};
use rhumb_reckoning::BodyId;

use super::body::LockedAxes;
use super::checks::{Invalid, Quantity, rotation, scalar, vector};
use crate::limits::{
    ANGULAR_MAX, EXTENT_MAX, EXTENT_MIN, FORCE_MAX, JOINTS_MAX, LINEAR_MAX, STIFFNESS_MAX,
};
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

/// Limits of a free motion: radians or metres, inclusive. Angles are those of the rotation or a whole turn more or
/// less, and limits of one are at most a whole turn apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLimits {
    /// The least.
    pub least: f32,
    /// The most, not below the least.
    pub most: f32,
}

impl JointLimits {
    fn check(&self, axis: usize) -> Result<(), Invalid> {
        let (most, unit) = match is_translation(axis) {
            true => (EXTENT_MAX, "m"),
            false => (TAU, "rad"),
        };
        let number = |value, least, most, name| {
            let checked = scalar(value, least, most, Quantity::JointLimit);
            checked.map_err(|wrong| wrong.of(name, unit))
        };
        number(self.least, -most, most, "least limit of a joint")?;
        number(self.most, self.least, most, "greatest limit of a joint")?;
        if is_translation(axis) {
            return Ok(());
        }
        // Frames that a whole turn parts are the same: nothing tells them apart.
        let range =
            "range of a turn's limits (a joint counts no turns, and turns freely without limits)";
        number(self.most - self.least, 0.0, TAU, range)
    }
}

/// A spring between the anchors of a joint, whatever the directions of its frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spring {
    /// Distance at which it does not pull, metres.
    pub length: f32,
    /// N/m.
    pub stiffness: f32,
    /// N·s/m.
    pub damping: f32,
}

impl Spring {
    fn check(&self) -> Result<(), Invalid> {
        let number = |value, most, name, unit| {
            let checked = scalar(value, 0.0, most, Quantity::Spring);
            checked.map_err(|wrong| wrong.of(name, unit))
        };
        number(self.length, EXTENT_MAX, "length of a spring", "m")?;
        number(
            self.stiffness,
            STIFFNESS_MAX,
            "stiffness of a spring",
            "N/m",
        )?;
        number(self.damping, STIFFNESS_MAX, "damping of a spring", "N·s/m")
    }
}

/// Load at which a joint breaks: the server removes it after the step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointStrength {
    /// N.
    pub force: f32,
    /// N·m.
    pub torque: f32,
}

/// Free motions of the second frame in the first. Angles: twice the arc sine of a part of the turn's quaternion,
/// radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JointKind {
    /// No motion is free.
    Fixed,
    /// Every turn; limits about x, y and z.
    Spherical(Option<[JointLimits; 3]>),
    /// The turn about x.
    Revolute(Option<JointLimits>),
    /// The displacement along x.
    Prismatic(Option<JointLimits>),
    /// Everything, but the anchors are at most so far apart, metres.
    Rope(f32),
    /// Everything; a spring pulls the anchors.
    Spring(Spring),
    /// Every axis that is not locked; limits of the axes in order.
    Generic(LockedAxes, [Option<JointLimits>; 6]),
}

impl JointKind {
    /// The locked axes.
    #[must_use]
    pub fn locked(&self) -> LockedAxes {
        let all = LockedAxes::TRANSLATIONS | LockedAxes::ROTATIONS;
        let without = |axis: usize| {
            let free = LockedAxes::EACH[axis].bits();
            LockedAxes::new(all.bits() & !free).unwrap_or(all)
        };
        match self {
            Self::Fixed => all,
            Self::Spherical(_) => LockedAxes::TRANSLATIONS,
            Self::Revolute(_) => without(3),
            Self::Prismatic(_) => without(0),
            Self::Rope(_) | Self::Spring(_) => LockedAxes::NONE,
            Self::Generic(locked, _) => *locked,
        }
    }

    /// Limits of each axis: translations along x, y and z, then rotations about x, y and z.
    #[must_use]
    pub const fn limits(&self) -> [Option<JointLimits>; 6] {
        match *self {
            Self::Spherical(Some([x, y, z])) => [None, None, None, Some(x), Some(y), Some(z)],
            Self::Revolute(limits) => [None, None, None, limits, None, None],
            Self::Prismatic(limits) => [limits, None, None, None, None, None],
            Self::Generic(_, limits) => limits,
            Self::Fixed | Self::Spherical(None) | Self::Rope(_) | Self::Spring(_) => [None; 6],
        }
    }

    fn check(&self) -> Result<(), Invalid> {
        match *self {
            Self::Rope(length) => scalar(length, EXTENT_MIN, EXTENT_MAX, Quantity::JointLimit)
                .map_err(|wrong| wrong.of("length of a rope", "m"))?,
            Self::Spring(spring) => spring.check()?,
            Self::Fixed
            | Self::Spherical(_)
            | Self::Revolute(_)
            | Self::Prismatic(_)
            | Self::Generic(..) => {}
        }
        let limits = self.limits().into_iter().enumerate();
        for (axis, limits) in limits.filter_map(|(axis, limits)| Some((axis, limits?))) {
            if self.locked().locks(axis) {
                return Err(Invalid::of_axis(Quantity::JointLimit, axis));
            }
            limits.check(axis)?;
        }
        Ok(())
    }
}

/// Bound on a motor's position of an axis: metres of a translation, radians of a rotation, that of its limits if it has
/// some.
const fn reach(axis: usize, is_limited: bool) -> f32 {
    match (is_translation(axis), is_limited) {
        (true, _) => EXTENT_MAX,
        (false, true) => TAU,
        (false, false) => PI,
    }
}

const fn is_translation(axis: usize) -> bool {
    axis < 3
}

/// A joint of two bodies. It acts while both of them are enabled.
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
    /// Motors of free axes: translations along x, y and z, then rotations about x, y and z. A rope or a spring has
    /// none.
    pub motors: [Option<Motor>; 6],
    /// `None`: it never breaks.
    pub strength: Option<JointStrength>,
}

impl Joint {
    /// A joint without motors that never breaks, of bodies that do not collide.
    #[must_use]
    pub const fn plain(kind: JointKind, bodies: [BodyId; 2], frames: [JointFrame; 2]) -> Self {
        Self {
            kind,
            bodies,
            frames,
            collide: false,
            motors: [None; 6],
            strength: None,
        }
    }

    /// Checks every number.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first invalid number, or a limit or motor of an axis that has none.
    pub fn check(&self) -> Result<(), Invalid> {
        for frame in &self.frames {
            frame.check()?;
        }
        self.kind.check()?;
        let distant = matches!(self.kind, JointKind::Rope(_) | JointKind::Spring(_));
        let limits = self.kind.limits();
        let motors = self.motors.iter().enumerate();
        for (axis, motor) in motors.filter_map(|(axis, motor)| Some((axis, motor.as_ref()?))) {
            if distant {
                let distant = "a rope or a spring has none";
                return Err(Invalid::because(Quantity::Motor, distant));
            }
            if self.kind.locked().locks(axis) {
                return Err(Invalid::of_axis(Quantity::Motor, axis));
            }
            let fast = if is_translation(axis) {
                LINEAR_MAX
            } else {
                ANGULAR_MAX
            };
            motor.check(reach(axis, limits[axis].is_some()), fast)?;
        }
        if let Some(strength) = self.strength {
            let number = |value, name, unit| {
                let checked = scalar(value, 0.0, FORCE_MAX, Quantity::Strength);
                checked.map_err(|wrong| wrong.of(name, unit))
            };
            number(strength.force, "force at which a joint breaks", "N")?;
            number(strength.torque, "torque at which a joint breaks", "N·m")?;
        }
        Ok(())
    }
}

/// Bits of the number that tells which fields follow.
mod flag {
    pub(super) const KIND: u64 = 0b111;
    pub(super) const COLLIDE: u64 = 1 << 3;
    pub(super) const LIMITS: u64 = 1 << 4;
    pub(super) const ROTATIONS: [u64; 2] = [1 << 5, 1 << 6];
    pub(super) const MOTORS: u64 = 1 << 7;
    pub(super) const STRENGTH: u64 = 1 << 8;
    pub(super) const ALL: u64 = (1 << 9) - 1;
}

/// The bits of the identity quaternion, which encodings omit.
pub(super) const IDENTITY_BITS: [u32; 4] = [0, 0, 0, 1.0_f32.to_bits()];

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

/// Encodes a set of axes with values, and the values in order.
fn encode_axes<T: Wire>(values: &[Option<T>; 6], to: &mut Writer) {
    let bits = values.iter().zip(LockedAxes::EACH);
    let axes = bits.filter(|(value, _)| value.is_some());
    to.u8(axes.fold(0, |bits, (_, axis)| bits | axis.bits()));
    for value in values.iter().flatten() {
        value.encode(to);
    }
}

fn decode_axes<T: Wire>(from: &mut Reader<'_>) -> Result<[Option<T>; 6], Malformed> {
    let axes = LockedAxes::decode(from)?;
    let mut values = [const { None }; 6];
    for (axis, value) in values.iter_mut().enumerate() {
        if axes.locks(axis) {
            *value = Some(T::decode(from)?);
        }
    }
    Ok(values)
}

impl JointKind {
    const fn code(&self) -> u64 {
        match self {
            Self::Fixed => 0,
            Self::Spherical(_) => 1,
            Self::Revolute(_) => 2,
            Self::Prismatic(_) => 3,
            Self::Rope(_) => 4,
            Self::Spring(_) => 5,
            Self::Generic(..) => 6,
        }
    }

    /// True if a bit tells that limits follow.
    const fn is_limited(&self) -> bool {
        matches!(
            self,
            Self::Spherical(Some(_)) | Self::Revolute(Some(_)) | Self::Prismatic(Some(_))
        )
    }

    fn encode(&self, to: &mut Writer) {
        match self {
            Self::Rope(length) => to.f32(*length),
            Self::Spring(spring) => to.f32s(&[spring.length, spring.stiffness, spring.damping]),
            Self::Generic(locked, limits) => {
                locked.encode(to);
                encode_axes(limits, to);
            }
            Self::Fixed | Self::Spherical(_) | Self::Revolute(_) | Self::Prismatic(_) => {
                for limits in self.limits().iter().flatten() {
                    limits.encode(to);
                }
            }
        }
    }

    fn decode(code: u64, limited: bool, from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let mut limits = || JointLimits::decode(from);
        Ok(match (code, limited) {
            (0, false) => Self::Fixed,
            (1, false) => Self::Spherical(None),
            (1, true) => Self::Spherical(Some([limits()?, limits()?, limits()?])),
            (2, false) => Self::Revolute(None),
            (2, true) => Self::Revolute(Some(limits()?)),
            (3, false) => Self::Prismatic(None),
            (3, true) => Self::Prismatic(Some(limits()?)),
            (4, false) => Self::Rope(from.f32()?),
            (5, false) => {
                let [length, stiffness, damping] = from.f32s()?;
                Self::Spring(Spring {
                    length,
                    stiffness,
                    damping,
                })
            }
            (6, false) => Self::Generic(LockedAxes::decode(from)?, decode_axes(from)?),
            _ => return Err(Malformed::UnknownCode),
        })
    }
}

impl Wire for Joint {
    fn encode(&self, to: &mut Writer) {
        let mut flags = self.kind.code();
        let turned = self.frames.map(|frame| !is_identity(frame.rotation));
        for (present, bit) in [
            (self.collide, flag::COLLIDE),
            (self.kind.is_limited(), flag::LIMITS),
            (turned[0], flag::ROTATIONS[0]),
            (turned[1], flag::ROTATIONS[1]),
            (self.motors != [None; 6], flag::MOTORS),
            (self.strength.is_some(), flag::STRENGTH),
        ] {
            if present {
                flags |= bit;
            }
        }
        to.varint(flags);
        for ((body, frame), turned) in self.bodies.iter().zip(&self.frames).zip(turned) {
            body.encode(to);
            to.f32s(&frame.anchor.to_array());
            if turned {
                to.f32s(&frame.rotation.to_array());
            }
        }
        self.kind.encode(to);
        if flags & flag::MOTORS != 0 {
            encode_axes(&self.motors, to);
        }
        if let Some(JointStrength { force, torque }) = self.strength {
            to.f32s(&[force, torque]);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let flags = from.varint_to(flag::ALL)?;
        let limited = flags & flag::LIMITS != 0;
        if flags & flag::KIND == flag::KIND || (limited && !(1..4).contains(&(flags & flag::KIND)))
        {
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
        let kind = JointKind::decode(flags & flag::KIND, limited, from)?;
        let mut joint = Self::plain(kind, [first, second], [first_frame, second_frame]);
        joint.collide = flags & flag::COLLIDE != 0;
        if flags & flag::MOTORS != 0 {
            joint.motors = decode_axes(from)?;
            if joint.motors == [None; 6] {
                return Err(Malformed::NotCanonical);
            }
        }
        if flags & flag::STRENGTH != 0 {
            let [force, torque] = from.f32s()?;
            joint.strength = Some(JointStrength { force, torque });
        }
        Ok(joint)
    }
}

/// All joints of one scene.
#[derive(Clone, Debug, Default)]
pub struct Joints {
    by_id: BTreeMap<JointId, Joint>,
    by_body: BTreeSet<(BodyId, JointId)>,
}

impl Joints {
    /// Sets the joint of an id; returns the one that had it before.
    pub fn insert(&mut self, id: JointId, joint: Joint) -> Option<Joint> {
        let before = self.remove(id);
        self.by_id.insert(id, joint);
        self.by_body.extend(joint.bodies.map(|body| (body, id)));
        before
    }

    /// Removes a joint.
    pub fn remove(&mut self, id: JointId) -> Option<Joint> {
        let joint = self.by_id.remove(&id)?;
        for body in joint.bodies {
            self.by_body.remove(&(body, id));
        }
        Some(joint)
    }

    /// Removes all joints of a removed body; returns their ids in order.
    pub fn remove_body(&mut self, body: BodyId) -> Vec<JointId> {
        let removed: Vec<_> = self.of_body(body).map(|(id, _)| id).collect();
        for id in &removed {
            self.remove(*id);
        }
        removed
    }

    /// The joint of an id.
    #[must_use]
    pub fn get(&self, id: JointId) -> Option<&Joint> {
        self.by_id.get(&id)
    }

    /// The joints of a body, in the order of ids.
    pub fn of_body(&self, body: BodyId) -> impl Iterator<Item = (JointId, &Joint)> {
        let all = (body, JointId(0))..=(body, JointId(u32::MAX));
        let ids = self.by_body.range(all).map(|(_, id)| *id);
        ids.filter_map(|id| Some((id, self.by_id.get(&id)?)))
    }

    /// Number of joints.
    #[must_use]
    pub fn len(&self) -> usize {
        self.by_id.len()
    }

    /// True if there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.by_id.is_empty()
    }

    /// All joints, in the order of ids.
    pub fn iter(&self) -> impl Iterator<Item = (JointId, &Joint)> {
        self.by_id.iter().map(|(id, joint)| (*id, joint))
    }
}

/// A motor: accelerates the second body against the first by `stiffness` times what the position lacks plus `damping`
/// times what the velocity lacks, whatever their masses and the distance of the axis from their centres. What is fixed
/// to either body, or held there by motors, moves along. A motor too stiff for the engine is slower, at the same
/// damping ratio.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motor {
    /// Metres or radians: from −π to π, or within ±2π on an axis with limits, where the motor takes the way within
    /// these.
    pub position: f32,
    /// m/s or rad/s.
    pub velocity: f32,
    /// 1/s²; zero for a motor that drives the velocity alone.
    pub stiffness: f32,
    /// 1/s.
    pub damping: f32,
    /// Greatest force or torque, N or N·m.
    pub force: f32,
}

impl Motor {
    /// A motor that keeps a velocity, m/s or rad/s, with this damping, 1/s, and any force.
    #[must_use]
    pub const fn with_velocity(velocity: f32, damping: f32) -> Self {
        Self {
            position: 0.0,
            velocity,
            stiffness: 0.0,
            damping,
            force: FORCE_MAX,
        }
    }

    /// A motor that keeps a position, metres or radians, with this stiffness, 1/s², damping, 1/s, and any force.
    #[must_use]
    pub const fn at_position(position: f32, stiffness: f32, damping: f32) -> Self {
        Self {
            position,
            velocity: 0.0,
            stiffness,
            damping,
            force: FORCE_MAX,
        }
    }

    /// Checks every number. `position` and `velocity`: bounds of the axis.
    fn check(&self, position: f32, velocity: f32) -> Result<(), Invalid> {
        let number = |value, [least, most]: [f32; 2], name, unit| {
            let checked = scalar(value, least, most, Quantity::Motor);
            checked.map_err(|wrong| wrong.of(name, unit))
        };
        let stiff = [0.0, STIFFNESS_MAX];
        number(
            self.position,
            [-position, position],
            "position of a motor",
            "m or rad",
        )?;
        number(
            self.velocity,
            [-velocity, velocity],
            "velocity of a motor",
            "m/s or rad/s",
        )?;
        number(self.stiffness, stiff, "stiffness of a motor", "1/s²")?;
        number(self.damping, stiff, "damping of a motor", "1/s")?;
        number(self.force, [0.0, FORCE_MAX], "force of a motor", "N or N·m")
    }
}

impl Wire for Motor {
    fn encode(&self, to: &mut Writer) {
        to.f32s(&[
            self.position,
            self.velocity,
            self.stiffness,
            self.damping,
            self.force,
        ]);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let [position, velocity, stiffness, damping, force] = from.f32s()?;
        Ok(Self {
            position,
            velocity,
            stiffness,
            damping,
            force,
        })
    }
}

#[cfg(test)]
mod tests;
