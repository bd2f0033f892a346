//! `rhumb-bench ablate`: value and price of each mechanism on standard loads.
//!
//! Replays each load (a scene or a recording, with settings) with everything on and with each mechanism switched off,
//! over a perfect link and over one with delay and loss. Counts each mechanism's lines of code and requirements in the
//! checkout. The range coder is part of the wire format and stays on; its row counts the size of its numbers in plain
//! codes instead. In every row, grids follow from tolerances, and sleeping bodies are sent at rest.

mod checkout;
mod mechanisms;
mod results;

use std::num::NonZeroU32;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;

use checkout::Checkout;
use clap::Args;
use indicatif::ProgressBar;
use mechanisms::{MECHANISMS, Mechanism, Switch};
use rhumb_netsim::LinkConfig;
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::scene::PublishSchedule;
use rhumb_reckoning::{Metres, Radians, Ticks, Tolerance};

use crate::drive::{Cores, Defects, Plan, run_side_by_side};
use crate::output;
use crate::record::Mode;
use crate::recording::{self, ReadOptions, Recording, print_notes};
use crate::replay::{EnabledFeatures, Feature, ReplayConfig, run};
use crate::summary::aligned;
use crate::task::{Failure, Provenance, ended};

pub use results::{Ablation, AblationLoad, AblationRow, Comparison, Sent};

/// Arguments: loads, seeds, checkout, output.
#[derive(Clone, Debug, Args)]
pub struct Ablate {
    /// Loads: cubes, pit, asteroids, ragdolls, tumbler. NAME=FILE replays a recording with the settings of that load
    /// instead of its scene.
    #[arg(long, value_delimiter = ',', default_values = NAMES)]
    load: Vec<LoadChoice>,
    /// Number of seeds of the link with loss, from 1 on; figures are means.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u64).range(1..=1_000))]
    seeds: u64,
    /// Seed of the scenes.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Folder of the checkout in which lines and requirements are counted.
    #[arg(long, default_value = ".")]
    checkout: PathBuf,
    /// Folder for ablation.json; created if missing.
    #[arg(long, default_value = "results/ablate")]
    out: PathBuf,
}

/// The link with delay and loss.
const LOSSY: &str = "rtt=100ms,loss=5%";

/// Ticks of lookahead in the rows that need it.
const LOOKAHEAD: Ticks = Ticks::new(6);

/// Runs the replays. Exit code 0 if everything was replayed and written, 1 otherwise.
pub fn ablate(arguments: &Ablate) -> ExitCode {
    ended(ablate_all(arguments))
}

fn ablate_all(arguments: &Ablate) -> Result<(), Failure> {
    // Before the replays, which take minutes.
    let checkout = Checkout::open(&arguments.checkout)?;
    let mut rows = MECHANISMS
        .iter()
        .map(|mechanism| row(mechanism, &checkout))
        .collect::<Result<Vec<_>, _>>()?;
    output::make_folder(&arguments.out)?;
    let lossy: LinkConfig = LOSSY.parse()?;
    let mut loads = Vec::new();
    let mut faults = 0;
    for choice in &arguments.load {
        let recording = choice.recording(arguments.seed)?;
        let measured = rows.iter().filter(|row| row.is_measured()).count() as u64;
        // Everything on, without lookahead and with it, comes first.
        let replays = (measured + 2) * (1 + arguments.seeds);
        let bar = output::progress_bar(replays, choice.name().to_owned());
        let mut stage = LoadStage {
            recording: &recording,
            base: choice.config()?,
            lossy,
            seeds: arguments.seeds,
            bar: &bar,
            faults: 0,
        };
        stage.compare_all(choice.name(), &mut rows);
        faults += stage.faults;
        bar.finish_and_clear();
        loads.push(choice.described(&recording));
    }
    let ablation = Ablation {
        provenance: Provenance::here(),
        link: LOSSY.to_owned(),
        seeds: arguments.seeds,
        loads,
        faults,
        rows,
    };
    output::write_json(&arguments.out.join("ablation.json"), &ablation)?;
    for (title, cells) in ablation.tables() {
        output::print_text(&format!("\n{title}\n{}", aligned(&cells)))?;
    }
    output::print_text(&format!("\nwritten to {}\n", arguments.out.display()))?;
    Ok(())
}

/// The row of a mechanism, without comparisons.
fn row(mechanism: &Mechanism, checkout: &Checkout) -> Result<AblationRow, Failure> {
    let sum = |counts: Result<Vec<u64>, Failure>| Ok::<u64, Failure>(counts?.into_iter().sum());
    let lines = mechanism.code.iter().map(|place| checkout.lines(place));
    let requirements = mechanism.requirements.iter();
    let requirements = requirements.map(|cited| checkout.requirements(cited));
    Ok(AblationRow {
        name: mechanism.name.to_owned(),
        feature: mechanism.feature.map(str::to_owned),
        lookahead_ticks: match mechanism.switch {
            Switch::OffWithLookahead(_) | Switch::Lookahead => LOOKAHEAD.count(),
            Switch::Off(_) | Switch::Fixed => 0,
        },
        without: match mechanism.switch {
            Switch::Off(feature) | Switch::OffWithLookahead(feature) => {
                Some(feature.name().to_owned())
            }
            Switch::Lookahead => Some("lookahead".to_owned()),
            Switch::Fixed => None,
        },
        lines: sum(lines.collect())?,
        requirements: sum(requirements.collect())?,
        comparisons: Vec::new(),
    })
}

/// The replays of one load.
#[derive(Debug)]
struct LoadStage<'a> {
    recording: &'a Recording,
    /// Everything on, a perfect link, no lookahead.
    base: ReplayConfig,
    lossy: LinkConfig,
    seeds: u64,
    bar: &'a ProgressBar,
    /// Body-ticks beyond the tolerance without a cause.
    faults: u64,
}

impl LoadStage<'_> {
    /// Adds the comparisons on this load to every measured row.
    fn compare_all(&mut self, load: &str, rows: &mut [AblationRow]) {
        let all = EnabledFeatures::ALL;
        let plain = self.over_both_links(all, Ticks::ZERO);
        let ahead = self.over_both_links(all, LOOKAHEAD);
        for (row, mechanism) in rows.iter_mut().zip(MECHANISMS) {
            let (with, without) = match mechanism.switch {
                Switch::Fixed => continue,
                Switch::Lookahead => (&ahead, plain.clone()),
                Switch::Off(feature) => {
                    let without = Feature::all_but(&[feature]);
                    (&plain, self.over_both_links(without, Ticks::ZERO))
                }
                Switch::OffWithLookahead(feature) => {
                    let without = Feature::all_but(&[feature]);
                    (&ahead, self.over_both_links(without, LOOKAHEAD))
                }
            };
            row.comparisons.push(Comparison {
                load: load.to_owned(),
                with: with.clone(),
                without,
            });
        }
    }

    /// Replays over the perfect link and over the one with loss.
    fn over_both_links(&mut self, features: EnabledFeatures, lookahead: Ticks) -> [Sent; 2] {
        let base = ReplayConfig {
            features,
            lookahead,
            ..self.base
        };
        let perfect = self.mean(std::iter::once(base));
        let link = self.lossy;
        let lossy = (1..=self.seeds).map(|seed| ReplayConfig { link, seed, ..base });
        [perfect, self.mean(lossy)]
    }

    /// The mean of some replays; the cause instead if one of them failed.
    fn mean(&mut self, configs: impl Iterator<Item = ReplayConfig>) -> Sent {
        let mut all = Vec::new();
        let mut failed = None;
        for config in configs {
            if failed.is_none() {
                match run(self.recording, &config, &mut |_| ()) {
                    Ok(run) => {
                        self.faults += results::faults(&run);
                        all.push(Sent::of(&run));
                    }
                    Err(error) => failed = Some(error.to_string()),
                }
            }
            self.bar.inc(1);
        }
        match failed {
            Some(cause) => Sent::failed(cause),
            None => Sent::mean(&all),
        }
    }
}

/// Names of the standard loads, in the order of the table.
const NAMES: [&str; 5] = ["cubes", "pit", "asteroids", "ragdolls", "tumbler"];

/// Settings of a standard load.
#[derive(Clone, Copy, Debug)]
struct StandardLoad {
    scene: &'static str,
    seconds: f64,
    tolerance_m: f64,
    /// Tolerance of the rotation, where it has one of its own.
    turn_rad: Option<f64>,
    publish_interval: NonZeroU32,
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
struct LoadChoice {
    name: &'static str,
    of: StandardLoad,
    file: Option<PathBuf>,
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
    const fn name(&self) -> &'static str {
        self.name
    }

    fn tolerance(&self) -> Result<Tolerance, Failure> {
        let metres = Metres::new(self.of.tolerance_m);
        let tolerance = match self.of.turn_rad {
            Some(turn) => Tolerance::parts(metres, Radians::new(turn)),
            None => Tolerance::from_metres(metres),
        };
        Ok(tolerance?)
    }

    /// Everything on, over a perfect link.
    fn config(&self) -> Result<ReplayConfig, Failure> {
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
    fn recording(&self, seed: u64) -> Result<Recording, Failure> {
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

    fn described(&self, recording: &Recording) -> AblationLoad {
        let file = self.file.as_ref().and_then(|file| file.file_name());
        AblationLoad {
            name: self.name.to_owned(),
            source: match file {
                Some(file) => file.to_string_lossy().into_owned(),
                None => format!("scene {}", self.of.scene),
            },
            bodies: recording.bodies(),
            ticks: recording.ticks(),
            tolerance_m: self.of.tolerance_m,
            turn_rad: self.of.turn_rad,
            publish_interval: self.of.publish_interval.get(),
        }
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
