//! Motor of a joint along or about one of its free axes.

use super::checks::{Invalid, Quantity, scalar};
use crate::limits::{FORCE_MAX, STIFFNESS_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// A motor: accelerates the second body against the first by `stiffness` times what the position lacks plus `damping`
/// times what the velocity lacks, whatever their masses and the distance of the axis from their centres. What is fixed to
/// either body, or held there by motors, moves along. A motor too stiff for the engine is slower, at the same damping ratio.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motor {
    /// Metres or radians: from −π to π, or within ±2π on an axis with limits, where the motor takes the way within these.
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
    pub(super) fn check(&self, position: f32, velocity: f32) -> Result<(), Invalid> {
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
