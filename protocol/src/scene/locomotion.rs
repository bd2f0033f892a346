//! Locomotion of a body: a character that walks, or a vehicle on wheels.
//!
//! A character is a kinematic body that walks as far as it can: the server keeps its velocity, its fall and its
//! contact with the ground. A vehicle is a dynamic body on wheels, each a ray with a spring. A wheel is no body: a
//! client that draws it computes its place, see [`Wheel::ray`]. Nothing here depends on an engine.

use alloc::vec::Vec;
use core::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use glam::{Quat, Vec3};

use super::checks::{Invalid, Quantity, count, direction, scalar, vector};
use super::query::Query;
use crate::limits::{
    EXTENT_MAX, EXTENT_MIN, FORCE_MAX, FRICTION_MAX, MASS_MAX, STIFFNESS_MAX, WHEELS_MAX,
};
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

/// A character that walks: it moves by the velocity that was set last until something blocks it, and falls by gravity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Character {
    /// Direction away from the ground, world frame, of unit length; `None`: against the scene's gravity, or along y if
    /// there is none.
    pub up: Option<Vec3>,
    /// Gap that it keeps to its surroundings, metres.
    pub offset: f32,
    /// Steepest slope that it climbs, radians from level ground.
    pub climb_angle: f32,
    /// Slope from which on it slides down, radians from level ground.
    pub slide_angle: f32,
    /// Mass with which it pushes dynamic bodies, kg; at zero it pushes none.
    pub mass: f32,
    /// The steps that it climbs; `None`: it climbs none, which costs least.
    pub step: Option<CharacterStep>,
    /// Greatest drop of the ground that it follows without a fall, metres.
    pub snap: Option<f32>,
}

/// A step that a character climbs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CharacterStep {
    /// Greatest height, metres.
    pub height: f32,
    /// Free width that it needs on the step, metres.
    pub width: f32,
    /// True if it also climbs onto dynamic bodies; otherwise it pushes them.
    pub onto_dynamic: bool,
}

impl CharacterStep {
    /// A step of at most this height with at least this width, metres, that is no dynamic body.
    #[must_use]
    pub const fn new(height: f32, width: f32) -> Self {
        Self {
            height,
            width,
            onto_dynamic: false,
        }
    }

    /// Checks every number.
    fn check(&self) -> Result<(), Invalid> {
        let lengths = [
            (self.height, "height of a character's step"),
            (self.width, "width of a character's step"),
        ];
        lengths.into_iter().try_for_each(|(length, name)| {
            scalar(length, EXTENT_MIN, EXTENT_MAX, Quantity::Character)
                .map_err(|wrong| wrong.of(name, "m"))
        })
    }
}

impl Default for Character {
    /// A character of 80 kg that climbs slopes of up to 45 degrees, slides down steeper ones, climbs no steps, and
    /// follows the ground down 0.2 m.
    fn default() -> Self {
        Self {
            up: None,
            offset: 0.02,
            climb_angle: FRAC_PI_4,
            slide_angle: FRAC_PI_4,
            mass: 80.0,
            step: None,
            snap: Some(0.2),
        }
    }
}

impl Character {
    /// Sets the direction away from the ground in place of the one against gravity; of unit length.
    #[must_use]
    pub const fn up(mut self, up: Vec3) -> Self {
        self.up = Some(up);
        self
    }

    /// Sets the steps that it climbs.
    #[must_use]
    pub const fn step(mut self, step: CharacterStep) -> Self {
        self.step = Some(step);
        self
    }

    /// Sets the steepest slope that it climbs and on which it stands, radians from level ground.
    #[must_use]
    pub const fn slope(mut self, angle: f32) -> Self {
        self.climb_angle = angle;
        self.slide_angle = angle;
        self
    }

    /// Sets the mass with which it pushes dynamic bodies, kg.
    #[must_use]
    pub const fn mass(mut self, mass: f32) -> Self {
        self.mass = mass;
        self
    }

    /// Checks every number.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first invalid number.
    pub fn check(&self) -> Result<(), Invalid> {
        let number = |value, [least, most]: [f32; 2], name, unit| {
            let checked = scalar(value, least, most, Quantity::Character);
            checked.map_err(|wrong| wrong.of(name, unit))
        };
        let (lengths, slopes) = ([EXTENT_MIN, EXTENT_MAX], [0.0, FRAC_PI_2]);
        number(self.offset, lengths, "offset of a character", "m")?;
        number(
            self.climb_angle,
            slopes,
            "climb angle of a character",
            "rad",
        )?;
        number(
            self.slide_angle,
            slopes,
            "slide angle of a character",
            "rad",
        )?;
        number(self.mass, [0.0, MASS_MAX], "mass of a character", "kg")?;
        self.up
            .map_or(Ok(()), |up| direction(up, "direction up of a character"))?;
        self.step.map_or(Ok(()), |step| step.check())?;
        self.snap.map_or(Ok(()), |snap| {
            number(snap, lengths, "snap of a character", "m")
        })
    }
}

/// The ground that a jump needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum JumpFrom {
    /// Only a character on the ground jumps; otherwise the command changes nothing.
    Ground,
    /// The character jumps in the air too.
    Anywhere,
}

impl Wire for JumpFrom {
    fn encode(&self, to: &mut Writer) {
        to.u8(match self {
            Self::Ground => 0,
            Self::Anywhere => 1,
        });
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        match from.u8()? {
            0 => Ok(Self::Ground),
            1 => Ok(Self::Anywhere),
            _ => Err(Malformed::OutOfRange),
        }
    }
}

/// Bits that tell which fields follow.
mod flag {
    pub(super) const UP: u8 = 1;
    pub(super) const STEP: u8 = 1 << 1;
    pub(super) const ONTO_DYNAMIC: u8 = 1 << 2;
    pub(super) const SNAP: u8 = 1 << 3;
    pub(super) const ALL: u8 = (1 << 4) - 1;
}

impl Wire for Character {
    fn encode(&self, to: &mut Writer) {
        let onto_dynamic = self.step.is_some_and(|step| step.onto_dynamic);
        let mut flags = 0;
        for (set, bit) in [
            (self.up.is_some(), flag::UP),
            (self.step.is_some(), flag::STEP),
            (onto_dynamic, flag::ONTO_DYNAMIC),
            (self.snap.is_some(), flag::SNAP),
        ] {
            if set {
                flags |= bit;
            }
        }
        to.u8(flags);
        to.f32s(&[self.offset, self.climb_angle, self.slide_angle, self.mass]);
        if let Some(up) = self.up {
            to.f32s(&up.to_array());
        }
        if let Some(step) = self.step {
            to.f32s(&[step.height, step.width]);
        }
        if let Some(snap) = self.snap {
            to.f32(snap);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let flags = from.u8()?;
        if flags > flag::ALL {
            return Err(Malformed::UnknownCode);
        }
        let onto_dynamic = flags & flag::ONTO_DYNAMIC != 0;
        let [offset, climb_angle, slide_angle, mass] = from.f32s()?;
        let mut character = Self {
            up: None,
            offset,
            climb_angle,
            slide_angle,
            mass,
            step: None,
            snap: None,
        };
        if flags & flag::UP != 0 {
            character.up = Some(Vec3::from_array(from.f32s()?));
        }
        if flags & flag::STEP != 0 {
            let [height, width] = from.f32s()?;
            character.step = Some(CharacterStep {
                height,
                width,
                onto_dynamic,
            });
        }
        if flags & flag::SNAP != 0 {
            character.snap = Some(from.f32()?);
        }
        if onto_dynamic && character.step.is_none() {
            return Err(Malformed::UnknownCode);
        }
        Ok(character)
    }
}

/// The wheels of a vehicle. Its chassis is the body.
#[derive(Clone, Debug, PartialEq)]
pub struct Vehicle {
    /// From 1 to [`WHEELS_MAX`] wheels.
    pub wheels: Vec<Wheel>,
}

/// A wheel, in the axes of its chassis and from its centre of mass.
///
/// A ray from the wheel's position along its suspension finds the ground. The spring pushes the chassis away from it by
/// its mass times stiffness · (rest length − length), less the damping. The wheel rolls across its axle: along the
/// cross product of the ground's normal and the axle. With the axle along x and y upwards, forward is −z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wheel {
    /// Upper end of the suspension, metres.
    pub position: Vec3,
    /// Direction of the suspension, of unit length, towards the ground.
    pub direction: Vec3,
    /// Axis about which the wheel turns, of unit length.
    pub axle: Vec3,
    /// Metres.
    pub radius: f32,
    /// Length of the suspension without load, from the position to the wheel's centre, metres.
    pub rest_length: f32,
    /// Greatest change of that length, metres.
    pub travel: f32,
    /// 1/s².
    pub stiffness: f32,
    /// Damping while the spring is compressed, 1/s.
    pub compression: f32,
    /// Damping while the spring relaxes, 1/s.
    pub relaxation: f32,
    /// Greatest force of the suspension, N.
    pub force_max: f32,
    /// Greatest force along the ground, as a share of the suspension's force. The part along the rolling direction
    /// counts half.
    pub friction_slip: f32,
    /// Factor of the force along the axle that keeps the wheel from sliding sideways.
    pub side_friction: f32,
}

impl Wheel {
    /// A wheel at this place of the chassis, metres, on a suspension of 0.3 m along −y, with its axle along x.
    ///
    /// Four of them let a chassis sink by 5 cm.
    #[must_use]
    pub const fn at(position: Vec3, radius: f32) -> Self {
        Self {
            position,
            direction: Vec3::NEG_Y,
            axle: Vec3::X,
            radius,
            rest_length: 0.3,
            travel: 0.25,
            stiffness: 50.0,
            compression: 4.0,
            relaxation: 6.0,
            force_max: FORCE_MAX,
            friction_slip: 2.0,
            side_friction: 1.0,
        }
    }

    /// Sets the length of its suspension without load, and the greatest change of it, metres.
    #[must_use]
    pub const fn suspension(mut self, rest_length: f32, travel: f32) -> Self {
        self.rest_length = rest_length;
        self.travel = travel;
        self
    }

    /// Sets the stiffness of its spring, 1/s², and the damping of both directions, 1/s.
    #[must_use]
    pub const fn spring(mut self, stiffness: f32, damping: f32) -> Self {
        self.stiffness = stiffness;
        self.compression = damping;
        self.relaxation = damping;
        self
    }

    /// Sets the greatest force along the ground, as a share of the suspension's force.
    #[must_use]
    pub const fn friction_slip(mut self, share: f32) -> Self {
        self.friction_slip = share;
        self
    }

    /// The ray by which the wheel finds the ground, for a chassis of this pose, world frame. It finds one body; the
    /// caller excepts the chassis.
    #[must_use]
    pub fn ray(&self, position: Vec3, rotation: Quat) -> Query {
        let reach = self.rest_length + self.radius;
        let from = position + rotation * self.position;
        Query::ray(from, rotation * self.direction * reach)
    }

    /// Length of the suspension, metres, if the ray found the ground at this distance: the wheel's centre lies so far
    /// from its position.
    #[must_use]
    pub fn length(&self, distance: Option<f32>) -> f32 {
        let least = self.rest_length - self.travel;
        let most = self.rest_length + self.travel;
        distance.map_or(self.rest_length, |distance| {
            (distance - self.radius).max(least).min(most)
        })
    }

    fn check(&self) -> Result<(), Invalid> {
        vector(self.position, EXTENT_MAX, Quantity::Wheel)
            .map_err(|wrong| wrong.of("position of a wheel", "m"))?;
        direction(self.direction, "direction of a wheel")?;
        direction(self.axle, "axle of a wheel")?;
        for (value, most, name, unit) in [
            (self.rest_length, EXTENT_MAX, "rest length of a wheel", "m"),
            (self.travel, EXTENT_MAX, "travel of a wheel", "m"),
            (
                self.stiffness,
                STIFFNESS_MAX,
                "stiffness of a wheel",
                "1/s²",
            ),
            (
                self.compression,
                STIFFNESS_MAX,
                "compression of a wheel",
                "1/s",
            ),
            (
                self.relaxation,
                STIFFNESS_MAX,
                "relaxation of a wheel",
                "1/s",
            ),
            (self.force_max, FORCE_MAX, "greatest force of a wheel", "N"),
            (
                self.friction_slip,
                FRICTION_MAX,
                "friction slip of a wheel",
                "",
            ),
            (
                self.side_friction,
                FRICTION_MAX,
                "side friction of a wheel",
                "",
            ),
        ] {
            number(value, [0.0, most], name, unit)?;
        }
        let radii = [EXTENT_MIN, EXTENT_MAX];
        number(self.radius, radii, "radius of a wheel", "m")
    }
}

impl Vehicle {
    /// Checks the number of wheels, and every number of each.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first that is wrong.
    pub fn check(&self) -> Result<(), Invalid> {
        check_count(self.wheels.len())?;
        self.wheels.iter().try_for_each(Wheel::check)
    }
}

/// Steering, force and brake of a wheel. The vehicle keeps them until the next ones.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WheelInput {
    /// Turn against the suspension's direction, radians: with the suspension along −y, a positive one steers left.
    pub steering: f32,
    /// Force of the engine forward, N; a negative one acts backward.
    pub force: f32,
    /// Greatest force that stops it, N. A wheel with a force does not brake.
    pub brake: f32,
}

impl WheelInput {
    /// Checks the inputs of all wheels of a vehicle.
    pub(super) fn check_all(inputs: &[Self]) -> Result<(), Invalid> {
        check_count(inputs.len())?;
        inputs.iter().try_for_each(Self::check)
    }

    fn check(&self) -> Result<(), Invalid> {
        number(self.steering, [-PI, PI], "steering of a wheel", "rad")?;
        let forces = [-FORCE_MAX, FORCE_MAX];
        number(self.force, forces, "force of a wheel", "N")?;
        number(self.brake, [0.0, FORCE_MAX], "brake of a wheel", "N")
    }
}

fn check_count(wheels: usize) -> Result<(), Invalid> {
    count(wheels, 1, WHEELS_MAX, Quantity::Wheels)
}

/// Checks a number of a wheel against inclusive bounds.
fn number(
    value: f32,
    [least, most]: [f32; 2],
    name: &'static str,
    unit: &'static str,
) -> Result<(), Invalid> {
    let checked = scalar(value, least, most, Quantity::Wheel);
    checked.map_err(|wrong| wrong.of(name, unit))
}

/// Encodes this many values. A number that no vehicle has stands for itself or for 255, which is refused either way.
pub(super) fn encode_each<T: Wire>(values: &[T], to: &mut Writer) {
    to.u8(u8::try_from(values.len()).unwrap_or(u8::MAX));
    for value in values {
        value.encode(to);
    }
}

pub(super) fn decode_each<T: Wire>(from: &mut Reader<'_>) -> Result<Vec<T>, Malformed> {
    let count = usize::from(from.u8()?);
    if !(1..=WHEELS_MAX).contains(&count) {
        return Err(Malformed::OutOfRange);
    }
    (0..count).map(|_| T::decode(from)).collect()
}

impl Wire for Vehicle {
    fn encode(&self, to: &mut Writer) {
        encode_each(&self.wheels, to);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(Self {
            wheels: decode_each(from)?,
        })
    }
}

impl Wire for Wheel {
    fn encode(&self, to: &mut Writer) {
        for vector in [self.position, self.direction, self.axle] {
            to.f32s(&vector.to_array());
        }
        to.f32s(&[
            self.radius,
            self.rest_length,
            self.travel,
            self.stiffness,
            self.compression,
            self.relaxation,
            self.force_max,
            self.friction_slip,
            self.side_friction,
        ]);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let mut vector = || from.f32s().map(Vec3::from_array);
        let [position, direction, axle] = [vector()?, vector()?, vector()?];
        let numbers: [f32; 9] = from.f32s()?;
        let [
            radius,
            rest_length,
            travel,
            stiffness,
            compression,
            relaxation,
            ..,
        ] = numbers;
        let [.., force_max, friction_slip, side_friction] = numbers;
        Ok(Self {
            position,
            direction,
            axle,
            radius,
            rest_length,
            travel,
            stiffness,
            compression,
            relaxation,
            force_max,
            friction_slip,
            side_friction,
        })
    }
}

impl Wire for WheelInput {
    fn encode(&self, to: &mut Writer) {
        to.f32s(&[self.steering, self.force, self.brake]);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let [steering, force, brake] = from.f32s()?;
        Ok(Self {
            steering,
            force,
            brake,
        })
    }
}
