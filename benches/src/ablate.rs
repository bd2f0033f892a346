//! `rhumb-bench ablate`: value and price of each mechanism on standard loads.
//!
//! Replays each load (a scene or a recording, with settings) with everything on and with each mechanism switched off,
//! over a perfect link and over one with delay and loss. Counts each mechanism's lines of code and requirements in the
//! checkout. The range coder is part of the wire format and stays on; its row counts the size of its numbers in plain
//! codes instead. In every row, grids follow from tolerances, and sleeping bodies are sent at rest.

mod checkout;
mod mechanisms;
mod results;

use std::path::PathBuf;
use std::process::ExitCode;

use checkout::Checkout;
use clap::Args;
use indicatif::ProgressBar;
use mechanisms::{MECHANISMS, Mechanism, Switch};
use rhumb_netsim::LinkConfig;
use rhumb_reckoning::Ticks;

use crate::output;
use crate::recording::Recording;
use crate::replay::{EnabledFeatures, Feature, ReplayConfig, run};
use crate::standard_load::{LoadChoice, NAMES};
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
        loads.push(described(choice, &recording));
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

/// The row of the table about a load.
fn described(choice: &LoadChoice, recording: &Recording) -> AblationLoad {
    let file = choice.file.as_ref().and_then(|file| file.file_name());
    AblationLoad {
        name: choice.name().to_owned(),
        source: match file {
            Some(file) => file.to_string_lossy().into_owned(),
            None => format!("scene {}", choice.of.scene),
        },
        bodies: recording.bodies(),
        ticks: recording.ticks(),
        tolerance_m: choice.of.tolerance_m,
        turn_rad: choice.of.turn_rad,
        publish_interval: choice.of.publish_interval.get(),
    }
}
