//! Settings of a character: a kinematic body that walks as far as it can.
//!
//! The server keeps its velocity, its fall and its contact with the ground; nothing here depends on an engine.

use core::f32::consts::{FRAC_PI_2, FRAC_PI_4};

use glam::Vec3;

use super::checks::{Invalid, Quantity, direction, scalar};
use crate::limits::{EXTENT_MAX, EXTENT_MIN, MASS_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// How a character walks. It moves by the velocity that was set last, as far as the world lets it, and falls by gravity.
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
