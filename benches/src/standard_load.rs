//! The standard loads: scenes or recordings with their settings.

use std::num::NonZeroU32;
use std::path::PathBuf;
use std::str::FromStr;

use rhumb_netsim::LinkConfig;
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::scene::PublishSchedule;
use rhumb_reckoning::{Metres, Radians, Ticks, Tolerance};

use crate::drive::{Cores, Defects, Plan, run_side_by_side};
use crate::output::{self, Failure};
use crate::record::Mode;
use crate::recording::{self, ReadOptions, Recording, print_notes};
use crate::replay::{EnabledFeatures, ReplayConfig};

/// Names of the standard loads, in the order of the table.
pub(crate) const NAMES: [&str; 5] = ["cubes", "pit", "asteroids", "ragdolls", "tumbler"];

/// Settings of a standard load.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StandardLoad {
    pub(crate) scene: &'static str,
    pub(crate) seconds: f64,
    pub(crate) tolerance_m: f64,
    /// Tolerance of the rotation, where it has one of its own.
    pub(crate) turn_rad: Option<f64>,
    pub(crate) publish_interval: NonZeroU32,
}

const EVERY_TICK: NonZeroU32 = NonZeroU32::MIN;
const EVERY_SECOND_TICK: NonZeroU32 = EVERY_TICK.saturating_add(1);

/// The standard loads, in the order of [`NAMES`].
const LOADS: [StandardLoad; 5] = [
    within("cubes", 20.0, 0.01),
    within("ball-pit", 30.0, 0.05),
    StandardLoad {
        turn_rad: Some(0.002),
        publish_interval: EVERY_SECOND_TICK,
        ..within("asteroids", 120.0, 0.01)
    },
    within("ragdolls", 20.0, 0.05),
    within("tumbler", 20.0, 0.05),
];

const fn within(scene: &'static str, seconds: f64, tolerance_m: f64) -> StandardLoad {
    StandardLoad {
        scene,
        seconds,
        tolerance_m,
        turn_rad: None,
        publish_interval: EVERY_TICK,
    }
}

/// A load on the command line: `NAME`, or `NAME=FILE` for a recording.
#[derive(Clone, Debug)]
pub(crate) struct LoadChoice {
    name: &'static str,
    pub(crate) of: StandardLoad,
    pub(crate) file: Option<PathBuf>,
}

impl FromStr for LoadChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, file) = match text.split_once('=') {
            Some((name, file)) => (name, Some(PathBuf::from(file))),
            None => (text, None),
        };
        let mut known = NAMES.into_iter().zip(LOADS);
        let (name, of) = known
            .find(|(known, _)| *known == name)
            .ok_or_else(|| format!("{name} is none of {}", NAMES.join(", ")))?;
        Ok(Self { name, of, file })
    }
}

impl LoadChoice {
    pub(crate) const fn name(&self) -> &'static str {
        self.name
    }

    pub(crate) fn tolerance(&self) -> Result<Tolerance, Failure> {
        let metres = Metres::new(self.of.tolerance_m);
        let tolerance = match self.of.turn_rad {
            Some(turn) => Tolerance::parts(metres, Radians::new(turn)),
            None => Tolerance::from_metres(metres),
        };
        Ok(tolerance?)
    }

    /// Everything on, over a perfect link.
    pub(crate) fn config(&self) -> Result<ReplayConfig, Failure> {
        Ok(ReplayConfig {
            tolerance: self.tolerance()?,
            largest_packet: LargestPacket::DEFAULT,
            link: LinkConfig::PERFECT,
            publish_interval: self.of.publish_interval,
            seed: 1,
            lookahead: Ticks::ZERO,
            features: EnabledFeatures::ALL,
            budget: None,
        })
    }

    /// Reads the recording, or steps the scene in this thread.
    pub(crate) fn recording(&self, seed: u64) -> Result<Recording, Failure> {
        if let Some(file) = &self.file {
            let recording = recording::read(file, &ReadOptions::default())?;
            print_notes(&recording);
            return Ok(recording);
        }
        let bodies = rhumb_sims::default_bodies(self.of.scene).and_then(|all| all.first());
        let bodies = *bodies.ok_or("a scene of a load is unknown")?;
        let script = rhumb_sims::by_name(self.of.scene, bodies, seed);
        let mut script = script.ok_or("a scene of a load is unknown")?;
        let step_s = script.config().integrator.rate.step().seconds();
        let ticks = (self.of.seconds / step_s).round() as u32;
        let plan = Plan {
            scene: self.of.scene.to_owned(),
            bodies,
            seed,
            ticks,
            tolerance: self.tolerance()?,
            budget: None,
            link: LinkConfig::PERFECT,
            modes: vec![Mode::Integrated],
            defects: Defects::SOUND,
            publish_schedule: PublishSchedule {
                publish_interval: EVERY_TICK,
                lookahead: Ticks::ZERO,
            },
            delay: Ticks::ZERO,
            cores: Cores::default(),
        };
        let bar = output::progress_bar(u64::from(ticks), format!("{}, scene", self.name));
        let load = run_side_by_side(&plan, &mut |_| bar.inc(1))?;
        bar.finish_and_clear();
        Ok(Recording::of_play(&mut *script, load.truth))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_load_is_a_known_name_with_or_without_a_file() {
        let plain: LoadChoice = "pit".parse().unwrap();
        assert_eq!((plain.name(), plain.file), ("pit", None));
        let recorded: LoadChoice = "cubes=a/b.rhtrace.zst".parse().unwrap();
        assert_eq!(recorded.file, Some(PathBuf::from("a/b.rhtrace.zst")));
        assert!("pits".parse::<LoadChoice>().is_err());
    }

    #[test]
    fn every_standard_load_is_a_scene_with_a_valid_tolerance() {
        for name in NAMES {
            let load: LoadChoice = name.parse().unwrap();
            assert!(load.config().is_ok(), "{name}");
            assert!(rhumb_sims::NAMES.contains(&load.of.scene), "{name}");
        }
    }
}
