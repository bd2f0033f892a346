//! Conditions under which bodies fall asleep.

use super::checks::{Invalid, Quantity, scalar};
use crate::limits::{ANGULAR_MAX, SLEEP_SECONDS_MAX, SLEEP_SPEED_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Conditions under which a body falls asleep. It does so only together with all that it touches or is joined to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Sleep {
    /// It sleeps once it has settled: the engine finds it slow, and neither gravity nor a motor still moves it.
    #[default]
    Settled,
    /// It never falls asleep by itself, and neither does what it touches.
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
    pub(super) fn check(self) -> Result<(), Invalid> {
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
