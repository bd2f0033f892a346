//! Types of a scene that clients and servers share; its configuration.
//!
//! A scene's name and configuration are constant for its life: how it steps, when its streams publish, when its bodies
//! fall asleep. Commands and scene events act at every tick, whatever the schedule of its streams.

mod body;
mod body_builder;
mod body_event;
mod cell;
mod checks;
mod command;
mod command_error;
mod ids;
mod joint;
mod locomotion;
mod points;
pub(crate) mod query;
mod shape;

use alloc::string::String;
use core::fmt;
use core::num::NonZeroU32;
use core::str::FromStr;

use checks::{LOOKAHEAD_IN_LOCKSTEP, count, outside, scalar, vector};
use glam::Vec3;
use rhumb_reckoning::{Damping, Integrator, Rate, Tick, Ticks};

use crate::limits::{
    ANGULAR_MAX, DAMPING_MAX, DENSITY_MAX, DENSITY_MIN, FRICTION_MAX, GRAVITY_MAX,
    LOOKAHEAD_TICKS_MAX, PUBLISH_SECONDS_MAX, RATE_MAX, SCENE_NAME_BYTES_MAX, SLEEP_SECONDS_MAX,
    SLEEP_SPEED_MAX, STEP_SECONDS_MAX, SUBSTEPS_MAX,
};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

pub use body::{BodyDesc, BodyKind, CollisionGroups, LockedAxes, Mass};
pub use body_builder::BodyBuilder;
pub use body_event::{ActiveEvents, BodyEvent, Contact};
pub use cell::{Cell, CellGrid, InvalidCellGrid};
pub use checks::{Invalid, Quantity, Rule};
pub use command::Command;
pub use command_error::CommandError;
pub use ids::{IdOutOfRange, IdRange};
pub use joint::{
    Joint, JointFrame, JointId, JointKind, JointLimits, JointStrength, Joints, Motor, Spring,
};
pub use locomotion::{Character, CharacterStep, JumpFrom, Locomotion, Vehicle, Wheel, WheelInput};
pub use points::{Edges, Heights, Hull, Mesh};
pub use query::{Answer, Hit, Query, QueryCandidate, QueryFilter, QueryKind};
pub use shape::{Compound, Part, Shape, ShapeId};

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
    /// 60 ticks a second of four substeps in lockstep, the earth's gravity along −y, no damping, bodies as heavy as
    /// water.
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
fn check_damping(damping: Damping) -> Result<(), Invalid> {
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

/// One to 64 characters of `a`–`z`, `A`–`Z`, `0`–`9`, `-`, `_`, `.` and `/`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SceneName(String);

impl SceneName {
    /// As text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for SceneName {
    type Err = InvalidSceneName;

    fn from_str(text: &str) -> Result<Self, InvalidSceneName> {
        let fits = (1..=SCENE_NAME_BYTES_MAX).contains(&text.len());
        let allowed = |c: u8| c.is_ascii_alphanumeric() || b"-_./".contains(&c);
        if fits && text.bytes().all(allowed) {
            Ok(Self(text.into()))
        } else {
            Err(InvalidSceneName)
        }
    }
}

impl fmt::Display for SceneName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Wire for SceneName {
    fn encode(&self, to: &mut Writer) {
        to.sized(self.0.as_bytes());
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let bytes = from.sized(SCENE_NAME_BYTES_MAX)?;
        let text = core::str::from_utf8(bytes).map_err(|_| Malformed::Text)?;
        text.parse().map_err(|_| Malformed::Text)
    }
}

/// A text that cannot name a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InvalidSceneName;

impl fmt::Display for InvalidSceneName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a scene's name has 1 to 64 letters, digits, '-', '_', '.' or '/'")
    }
}

impl core::error::Error for InvalidSceneName {}

/// Published ticks of a scene's streams, and the delay of their publication.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PublishSchedule {
    /// Published ticks are the multiples of this number.
    pub publish_interval: NonZeroU32,
    /// Steps that the scene takes before a tick is published. The publisher knows what follows the tick, so that
    /// updates stay valid for longer. All copies are later by these ticks.
    pub lookahead: Ticks,
}

impl PublishSchedule {
    /// Every tick, at once.
    pub const EACH_TICK: Self = Self {
        publish_interval: NonZeroU32::MIN,
        lookahead: Ticks::ZERO,
    };

    /// True if a tick is published.
    #[must_use]
    pub const fn publishes(&self, tick: Tick) -> bool {
        tick.value()
            .is_multiple_of(self.publish_interval.get() as u64)
    }

    /// Checks both numbers for a scene of this rate.
    fn check(self, rate: Rate) -> Result<(), Invalid> {
        let seconds = u64::from(self.publish_interval.get()) * u64::from(rate.seconds());
        let rare = seconds > u64::from(rate.ticks()) * u64::from(PUBLISH_SECONDS_MAX);
        if rare && self.publish_interval > NonZeroU32::MIN {
            let most = rate.ticks() / rate.seconds() * PUBLISH_SECONDS_MAX;
            let numbers = [self.publish_interval.get(), 1, most.max(1)].map(f64::from);
            return Err(outside(
                Rule::OutOfRange,
                Quantity::PublishInterval,
                numbers,
            ));
        }
        let lookahead = self.lookahead.count() as usize;
        count(
            lookahead,
            0,
            LOOKAHEAD_TICKS_MAX as usize,
            Quantity::Lookahead,
        )
    }

    /// The first published tick after another tick.
    #[must_use]
    pub fn next_published(self, after: Tick) -> Tick {
        let publish_interval = u64::from(self.publish_interval.get());
        Tick::new((after.value() / publish_interval + 1) * publish_interval)
    }

    /// Checks that members of a lockstep scene get each tick before they advance further.
    fn check_lockstep(self) -> Result<(), Invalid> {
        if self.lookahead == Ticks::ZERO {
            Ok(())
        } else {
            Err(Invalid::because(
                Quantity::LockstepPublishing,
                LOOKAHEAD_IN_LOCKSTEP,
            ))
        }
    }
}

impl Wire for PublishSchedule {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.publish_interval.get()));
        to.varint(u64::from(self.lookahead.count()));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(Self {
            publish_interval: NonZeroU32::new(from.varint32()?).ok_or(Malformed::OutOfRange)?,
            lookahead: Ticks::new(from.varint32()?),
        })
    }
}

/// Conditions under which a body falls asleep. It does so only together with all that it touches or is joined to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Sleep {
    /// It sleeps once it has settled: the engine finds it slow, and neither gravity nor a motor still moves it.
    #[default]
    Settled,
    /// It never falls asleep by itself, nor does a body that touches it.
    Never,
    /// It sleeps once it is slow, whatever moves it.
    Below(SleepThresholds),
}

/// Thresholds below which a body is slow, and the time for which it must be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SleepThresholds {
    /// Greatest speed of any point of it, m/s.
    pub speed: f32,
    /// Greatest angular speed, rad/s.
    pub angular_speed: f32,
    /// Time for which it must be as slow as that, seconds.
    pub seconds: f32,
}

impl SleepThresholds {
    /// Thresholds by the speed of any point alone, m/s, and seconds.
    #[must_use]
    pub const fn by_speed(speed: f32, seconds: f32) -> Self {
        Self {
            speed,
            angular_speed: ANGULAR_MAX,
            seconds,
        }
    }
}

impl Sleep {
    /// Checks every number.
    fn check(self) -> Result<(), Invalid> {
        let Self::Below(thresholds) = self else {
            return Ok(());
        };
        let SleepThresholds {
            speed,
            angular_speed,
            seconds,
        } = thresholds;
        scalar(speed, 0.0, SLEEP_SPEED_MAX, Quantity::SleepSpeed)?;
        scalar(angular_speed, 0.0, ANGULAR_MAX, Quantity::SleepAngularSpeed)?;
        scalar(seconds, 0.0, SLEEP_SECONDS_MAX, Quantity::SleepSeconds)
    }
}

impl Wire for Sleep {
    fn encode(&self, to: &mut Writer) {
        match *self {
            Self::Settled => to.u8(0),
            Self::Below(SleepThresholds {
                speed,
                angular_speed,
                seconds,
            }) => {
                to.u8(1);
                to.f32s(&[speed, angular_speed, seconds]);
            }
            Self::Never => to.u8(2),
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        match from.u8()? {
            0 => Ok(Self::Settled),
            1 => {
                let [speed, angular_speed, seconds] = from.f32s()?;
                Ok(Self::Below(SleepThresholds {
                    speed,
                    angular_speed,
                    seconds,
                }))
            }
            2 => Ok(Self::Never),
            _ => Err(Malformed::UnknownCode),
        }
    }
}

/// Friction, restitution and density.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Coulomb coefficient, ≥ 0.
    pub friction: f32,
    /// Share of the closing speed that is returned, in [0, 1].
    pub restitution: f32,
    /// Density, kg/m³.
    pub density: f32,
}

impl Material {
    /// Checks every number.
    ///
    /// # Errors
    /// [`Invalid`] names the first invalid number.
    /// [`Invalid`] names the first that is wrong.
    pub fn check(&self) -> Result<(), Invalid> {
        scalar(self.friction, 0.0, FRICTION_MAX, Quantity::Friction)?;
        scalar(self.restitution, 0.0, 1.0, Quantity::Restitution)?;
        scalar(self.density, DENSITY_MIN, DENSITY_MAX, Quantity::Density)
    }
}

impl Wire for Material {
    fn encode(&self, to: &mut Writer) {
        to.f32s(&[self.friction, self.restitution, self.density]);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let [friction, restitution, density] = from.f32s()?;
        Ok(Self {
            friction,
            restitution,
            density,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_rule_round_trips_and_others_are_refused() {
        let below = Sleep::Below(SleepThresholds {
            speed: 0.1,
            angular_speed: 0.2,
            seconds: 0.5,
        });
        for (sleep, length) in [(Sleep::Settled, 1), (Sleep::Never, 1), (below, 13)] {
            let mut writer = Writer::new();
            sleep.encode(&mut writer);
            let bytes = writer.into_bytes();
            assert_eq!(bytes.len(), length);
            assert_eq!(Sleep::decode(&mut Reader::new(&bytes)), Ok(sleep));
            for cut in 0..length {
                let cut = Sleep::decode(&mut Reader::new(&bytes[..cut]));
                assert_eq!(cut, Err(Malformed::Truncated));
            }
        }
        let unknown = Sleep::decode(&mut Reader::new(&[3]));
        assert_eq!(unknown, Err(Malformed::UnknownCode));
    }

    #[test]
    fn an_invalid_threshold_is_named() {
        let error = |speed, angular_speed, seconds| {
            let thresholds = SleepThresholds {
                speed,
                angular_speed,
                seconds,
            };
            Sleep::Below(thresholds).check()
        };
        let range = |quantity| Err(Invalid::out_of_range(quantity));
        assert_eq!(error(0.0, 0.0, 0.0), Ok(()));
        assert_eq!(error(-1.0, 0.0, 0.0), range(Quantity::SleepSpeed));
        assert_eq!(error(0.0, 101.0, 0.0), range(Quantity::SleepAngularSpeed));
        assert_eq!(error(0.0, 0.0, 1e4), range(Quantity::SleepSeconds));
        let none = Err(Invalid::not_finite(Quantity::SleepAngularSpeed));
        assert_eq!(error(0.0, f32::NAN, 0.0), none);
    }
}
