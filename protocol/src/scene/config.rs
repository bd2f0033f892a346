//! Configuration of a scene, constant for its life.

use core::num::NonZeroU32;

use glam::Vec3;
use rhumb_reckoning::{Damping, Integrator, Rate};

use super::checks::{Invalid, Quantity, Rule, count, outside, scalar, vector};
use super::material::Material;
use super::publish_schedule::PublishSchedule;
use super::sleep::Sleep;
use crate::limits::{DAMPING_MAX, GRAVITY_MAX, RATE_MAX, STEP_SECONDS_MAX, SUBSTEPS_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Source of a scene's next tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stepping {
    /// A member: the scene takes steps only when a member advances it.
    Lockstep,
    /// The server's clock, while the scene has members.
    FreeRunning,
}

/// Configuration of a scene: steps, gravity, and the defaults of its bodies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneConfig {
    /// Tick length and substeps.
    pub integrator: Integrator,
    /// Gravity at the start, m/s², world frame.
    pub gravity: Vec3,
    /// Source of the next tick.
    pub stepping: Stepping,
    /// Default material of bodies.
    pub material: Material,
    /// Default damping of bodies.
    pub damping: Damping,
    /// Conditions under which bodies fall asleep that have none of their own.
    pub sleep: Sleep,
    /// Publication times of its streams.
    pub publish_schedule: PublishSchedule,
}

impl Default for SceneConfig {
    /// 60 ticks a second of four substeps in lockstep, the earth's gravity along −y, no damping, bodies as heavy as water.
    fn default() -> Self {
        Self {
            integrator: Integrator {
                rate: Rate::HZ_60,
                substeps: NonZeroU32::MIN.saturating_add(3),
            },
            gravity: Vec3::new(0.0, -9.806_65, 0.0),
            stepping: Stepping::Lockstep,
            material: Material {
                friction: 0.5,
                restitution: 0.0,
                density: 1_000.0,
            },
            damping: Damping::default(),
            sleep: Sleep::Settled,
            publish_schedule: PublishSchedule::EACH_TICK,
        }
    }
}

impl SceneConfig {
    /// Checks every number.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first invalid number.
    pub fn check(&self) -> Result<(), Invalid> {
        let rate = self.integrator.rate;
        let fast = u64::from(rate.ticks()) > u64::from(rate.seconds()) * u64::from(RATE_MAX);
        let slow =
            u64::from(rate.seconds()) > u64::from(rate.ticks()) * u64::from(STEP_SECONDS_MAX);
        if fast || slow {
            let per_second = f64::from(rate.ticks()) / f64::from(rate.seconds());
            let least = 1.0 / f64::from(STEP_SECONDS_MAX);
            let numbers = [per_second, least, f64::from(RATE_MAX)];
            return Err(outside(Rule::OutOfRange, Quantity::Rate, numbers));
        }
        let substeps = self.integrator.substeps.get() as usize;
        count(substeps, 1, SUBSTEPS_MAX as usize, Quantity::Substeps)?;
        vector(self.gravity, GRAVITY_MAX, Quantity::Gravity)?;
        self.material.check()?;
        check_damping(self.damping)?;
        self.sleep.check()?;
        self.publish_schedule.check(rate)?;
        match self.stepping {
            Stepping::Lockstep => self.publish_schedule.check_lockstep(),
            Stepping::FreeRunning => Ok(()),
        }
    }
}

/// Checks both numbers.
pub(super) fn check_damping(damping: Damping) -> Result<(), Invalid> {
    let number = |value, name| {
        let checked = scalar(value, 0.0, DAMPING_MAX, Quantity::Damping);
        checked.map_err(|wrong| wrong.of(name, "1/s"))
    };
    number(damping.linear, "linear damping")?;
    number(damping.angular, "angular damping")
}

impl Wire for Damping {
    fn encode(&self, to: &mut Writer) {
        to.f32s(&[self.linear, self.angular]);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let [linear, angular] = from.f32s()?;
        Ok(Self { linear, angular })
    }
}

impl Wire for SceneConfig {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.integrator.rate.ticks()));
        to.varint(u64::from(self.integrator.rate.seconds()));
        to.varint(u64::from(self.integrator.substeps.get()));
        to.f32s(&self.gravity.to_array());
        to.u8(match self.stepping {
            Stepping::Lockstep => 0,
            Stepping::FreeRunning => 1,
        });
        self.material.encode(to);
        self.damping.encode(to);
        self.sleep.encode(to);
        self.publish_schedule.encode(to);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let rate = Rate::new(from.varint32()?, from.varint32()?).ok_or(Malformed::OutOfRange)?;
        let substeps = NonZeroU32::new(from.varint32()?).ok_or(Malformed::OutOfRange)?;
        Ok(Self {
            integrator: Integrator { rate, substeps },
            gravity: Vec3::from_array(from.f32s()?),
            stepping: match from.u8()? {
                0 => Stepping::Lockstep,
                1 => Stepping::FreeRunning,
                _ => return Err(Malformed::UnknownCode),
            },
            material: Material::decode(from)?,
            damping: Damping::decode(from)?,
            sleep: Sleep::decode(from)?,
            publish_schedule: PublishSchedule::decode(from)?,
        })
    }
}
