//! What a file says of a scene's engine: the parameters of predictions.
//!
//! Traces and recordings hold them as metadata, so that a reader needs no script and no server.

use std::collections::BTreeMap;
use std::num::NonZeroU32;
use std::str::FromStr;

use glam::Vec3;
use rhumb_protocol::scene::SceneConfig;
use rhumb_reckoning::{Damping, Integrator, Rate};

/// The log time of a tick, nanoseconds: the tick times the step, rounded to the nearest, from zero at tick 0.
///
/// This is the one rule of all traces and recordings, and of what is shown live.
#[must_use]
pub fn log_time_ns(rate: Rate, tick: u64) -> u64 {
    let (ticks, seconds) = (u128::from(rate.ticks()), u128::from(rate.seconds()));
    let ns = (u128::from(tick) * seconds * 1_000_000_000 + ticks / 2) / ticks;
    u64::try_from(ns).unwrap_or(u64::MAX)
}

/// The parameters of an engine that predictions need.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneFacts {
    /// Rate and substeps.
    pub integrator: Integrator,
    /// Gravity, m/s², world frame.
    pub gravity: Vec3,
    /// Damping of bodies without one of their own.
    pub damping: Damping,
}

impl SceneFacts {
    /// The facts of a scene's config.
    #[must_use]
    pub const fn of(config: &SceneConfig) -> Self {
        Self {
            integrator: config.integrator,
            gravity: config.gravity,
            damping: config.damping,
        }
    }

    /// The values of a metadata record.
    #[must_use]
    pub fn to_metadata(&self) -> BTreeMap<String, String> {
        let Integrator { rate, substeps } = self.integrator;
        let Vec3 { x, y, z } = self.gravity;
        let Damping { linear, angular } = self.damping;
        [
            ("rate", format!("{}/{}", rate.ticks(), rate.seconds())),
            ("step_s", rate.step().seconds().to_string()),
            ("substeps", substeps.to_string()),
            ("gravity", format!("{x} {y} {z}")),
            ("damping", format!("{linear} {angular}")),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into()
    }

    /// The facts of a metadata record; `None` if it lacks one of them, as those of earlier versions do.
    #[must_use]
    pub fn of_metadata(record: &BTreeMap<String, String>) -> Option<Self> {
        let (ticks, seconds) = record.get("rate")?.split_once('/')?;
        let [x, y, z] = numbers(record.get("gravity")?)?;
        let [linear, angular] = numbers(record.get("damping")?)?;
        let damped = [linear, angular].iter().all(|damping| *damping >= 0.0);
        let substeps: NonZeroU32 = record.get("substeps")?.parse().ok()?;
        damped.then_some(Self {
            integrator: Integrator {
                rate: Rate::new(ticks.parse().ok()?, seconds.parse().ok()?)?,
                substeps,
            },
            gravity: Vec3::new(x, y, z),
            damping: Damping { linear, angular },
        })
    }
}

/// So many finite numbers between spaces.
fn numbers<const COUNT: usize>(text: &str) -> Option<[f32; COUNT]> {
    let numbers: Vec<f32> = text
        .split_whitespace()
        .map(f32::from_str)
        .collect::<Result<_, _>>()
        .ok()?;
    let finite = numbers.iter().all(|number| number.is_finite());
    numbers.try_into().ok().filter(|_| finite)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts() -> SceneFacts {
        SceneFacts {
            integrator: Integrator {
                rate: Rate::new(30_000, 1_001).unwrap(),
                substeps: NonZeroU32::new(4).unwrap(),
            },
            gravity: Vec3::new(0.0, -9.806_65, 1e-7),
            damping: Damping {
                linear: 0.0,
                angular: 0.05,
            },
        }
    }

    #[test]
    fn facts_are_read_as_they_are_written() {
        let written = facts().to_metadata();
        assert_eq!(SceneFacts::of_metadata(&written), Some(facts()));
        for name in ["rate", "substeps", "gravity", "damping"] {
            for wrong in ["", "x", "0/0", "0", "NaN NaN NaN", "-1 -1"] {
                let mut spoiled = written.clone();
                spoiled.insert(name.to_owned(), wrong.to_owned());
                assert_eq!(SceneFacts::of_metadata(&spoiled), None, "{name} {wrong}");
            }
            let mut missing = written.clone();
            missing.remove(name);
            assert_eq!(SceneFacts::of_metadata(&missing), None, "{name}");
        }
    }

    #[test]
    fn log_times_do_not_drift() {
        assert_eq!(log_time_ns(Rate::HZ_60, 0), 0);
        assert_eq!(log_time_ns(Rate::HZ_60, 1), 16_666_667);
        assert_eq!(log_time_ns(Rate::HZ_60, 2), 33_333_333);
        assert_eq!(log_time_ns(Rate::HZ_60, 60_000_000), 1_000_000_000_000_000);
        let film = Rate::new(30_000, 1_001).unwrap();
        assert_eq!(log_time_ns(film, 30_000), 1_001_000_000_000);
        assert_eq!(log_time_ns(film, u64::MAX), u64::MAX);
    }
}
