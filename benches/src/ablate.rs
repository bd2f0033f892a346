//! `rhumb-bench ablate`: value and price of each mechanism on standard loads.
//!
//! Replays each load (a scene or a recording, with settings) with everything on and with each mechanism switched off,
//! over a perfect link and over one with delay and loss. Counts each mechanism's lines of code and requirements in the
//! checkout. The range coder is part of the wire format and stays on; its row counts the size of its numbers in plain
//! codes instead. In every row, grids follow from tolerances, and sleeping bodies are sent at rest. The results are
//! `ablation.json`, and its tables for a terminal or for Markdown.
//!
//! The standard loads, scenes or recordings with their settings, stand here too; other commands take them by name.

mod mechanisms;

use std::num::NonZeroU32;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;

use clap::Args;
use indicatif::ProgressBar;
use mechanisms::{Checkout, MECHANISMS, Mechanism, Switch};
use rhumb_netsim::LinkConfig;
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::scene::PublishSchedule;
use rhumb_reckoning::{Metres, Radians, Ticks, Tolerance};
use serde::{Deserialize, Serialize};

use crate::drive::{Cores, Defects, Plan, run_side_by_side};
use crate::numbers::{aligned, markdown, number};
use crate::output::{self, Failure, Provenance, ended};
use crate::record::{Cause, Mode, PacketDirection, Run};
use crate::recording::{self, ReadOptions, Recording, print_notes};
use crate::replay::{EnabledFeatures, Feature, ReplayConfig, run};

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
                        self.faults += faults(&run);
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

/// Content of `ablation.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ablation {
    /// Source of the figures.
    #[serde(flatten)]
    pub provenance: Provenance,
    /// The link with delay and loss.
    pub link: String,
    /// Seeds of that link, from 1 on.
    pub seeds: u64,
    /// The loads.
    pub loads: Vec<AblationLoad>,
    /// Body-ticks beyond the tolerance without a cause, in all replays: a defect.
    pub faults: u64,
    /// One row per mechanism.
    pub rows: Vec<AblationRow>,
}

/// One load.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AblationLoad {
    /// Its name.
    pub name: String,
    /// Scene or file.
    pub source: String,
    /// Number of dynamic bodies.
    pub bodies: u32,
    /// Number of ticks.
    pub ticks: u32,
    /// Tolerance, metres.
    pub tolerance_m: f64,
    /// Tolerance of the rotation, where it has one of its own, radians.
    pub turn_rad: Option<f64>,
    /// Ticks between publications.
    pub publish_interval: u32,
}

/// One mechanism.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AblationRow {
    /// The mechanism.
    pub name: String,
    /// The feature that users name, if the mechanism is one.
    pub feature: Option<String>,
    /// Name of the switch, as `replay --without` has it; `null` if the mechanism cannot be switched off.
    pub without: Option<String>,
    /// Ticks of lookahead with which it is measured.
    pub lookahead_ticks: u32,
    /// Lines of code.
    pub lines: u64,
    /// Requirements of the specification.
    pub requirements: u64,
    /// One per load.
    pub comparisons: Vec<Comparison>,
}

impl AblationRow {
    /// True if the mechanism can be switched off.
    #[must_use]
    pub const fn is_measured(&self) -> bool {
        self.without.is_some()
    }
}

/// One mechanism on one load.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Name of the load.
    pub load: String,
    /// Bytes with the mechanism: over a perfect link, and over the one with loss.
    pub with: [Sent; 2],
    /// The same without it.
    pub without: [Sent; 2],
}

/// Figures of a replay, or their means over several seeds; `null` where a replay failed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sent {
    /// Bytes handed to QUIC.
    pub payload_bytes: Option<f64>,
    /// Share of moving body-ticks beyond the tolerance.
    pub over_share: Option<f64>,
    /// Processor time of publishing, divided by the number of updates, nanoseconds.
    pub publish_ns_per_update: Option<f64>,
    /// Cause of a failure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failed: Option<String>,
}

impl Sent {
    /// Figures of one replay.
    fn of(run: &Run) -> Self {
        let down = [PacketDirection::StateDown, PacketDirection::ControlDown];
        let down = run
            .captured
            .iter()
            .filter(|captured| down.contains(&captured.direction));
        let bytes: u64 = down.map(|captured| captured.counted).sum();
        let body_ticks: usize = run.frames.iter().map(|f| f.moving_errors_m.len()).sum();
        let updates: u64 = run.frames.iter().map(|frame| frame.updates).sum();
        let ratio = |part: f64, all: f64| (all > 0.0).then(|| part / all);
        Self {
            payload_bytes: Some(bytes as f64),
            over_share: ratio(run.breaches.len() as f64, body_ticks as f64),
            publish_ns_per_update: ratio(run.publish_ns_total as f64, updates as f64),
            failed: None,
        }
    }

    /// No figures.
    fn failed(cause: String) -> Self {
        Self {
            failed: Some(cause),
            ..Self::default()
        }
    }

    /// The means of some replays.
    fn mean(all: &[Self]) -> Self {
        let mean = |figure: fn(&Self) -> Option<f64>| {
            let figures: Option<Vec<f64>> = all.iter().map(figure).collect();
            let figures = figures.filter(|figures| !figures.is_empty())?;
            Some(figures.iter().sum::<f64>() / figures.len() as f64)
        };
        Self {
            payload_bytes: mean(|sent| sent.payload_bytes),
            over_share: mean(|sent| sent.over_share),
            publish_ns_per_update: mean(|sent| sent.publish_ns_per_update),
            failed: None,
        }
    }
}

/// Body-ticks beyond the tolerance without a cause.
fn faults(run: &Run) -> u64 {
    let unexplained = run
        .breaches
        .iter()
        .filter(|breach| breach.cause == Cause::Fault);
    unexplained.count() as u64
}

/// Share of the bytes of one load that a mechanism must save to stay for its bytes.
const WORTH: f64 = 0.03;

impl Ablation {
    /// Titles and tables.
    fn tables(&self) -> [(&'static str, Vec<Vec<String>>); 3] {
        [
            (
                "payload without the mechanism, % more than with it",
                self.bytes(),
            ),
            ("moving body-ticks beyond the tolerance, %", self.errors()),
            ("what it costs", self.price()),
        ]
    }

    /// Text of a block of the documents; `None` if the block does not exist.
    #[must_use]
    pub fn block(&self, what: &str) -> Option<String> {
        Some(match what {
            "command" => self.provenance.paragraph(),
            "loads" => markdown(&self.load_rows()),
            "bytes" => markdown(&self.bytes()),
            "errors" => markdown(&self.errors()),
            "price" => markdown(&self.price()),
            _ => return None,
        })
    }

    fn load_rows(&self) -> Vec<Vec<String>> {
        let titles = [
            "load",
            "source",
            "bodies",
            "ticks",
            "tolerance mm",
            "mrad",
            "interval",
        ];
        let mut rows = vec![titles.map(str::to_owned).to_vec()];
        rows.extend(self.loads.iter().map(|load| {
            vec![
                load.name.clone(),
                load.source.clone(),
                load.bodies.to_string(),
                load.ticks.to_string(),
                number(Some(load.tolerance_m * 1e3)),
                number(load.turn_rad.map(|turn| turn * 1e3)),
                load.publish_interval.to_string(),
            ]
        }));
        rows
    }

    /// A column for each load and link, after the name of the mechanism.
    fn titles(&self) -> Vec<String> {
        let each = self.loads.iter();
        let each = each.flat_map(|load| [load.name.clone(), format!("{}, loss", load.name)]);
        std::iter::once("mechanism".to_owned())
            .chain(each)
            .collect()
    }

    fn measured(&self) -> impl Iterator<Item = &AblationRow> {
        self.rows.iter().filter(|row| row.is_measured())
    }

    fn bytes(&self) -> Vec<Vec<String>> {
        let mut rows = vec![self.titles()];
        let kilobytes = |sent: &Sent| number(sent.payload_bytes.map(|bytes| bytes / 1e3));
        rows.extend(self.base("everything on, kB", false, kilobytes));
        rows.extend(self.base("with lookahead, kB", true, kilobytes));
        rows.extend(self.measured().map(|row| {
            let cells = row.comparisons.iter().flat_map(Comparison::saved);
            let percent = |saved: Option<f64>| match saved {
                Some(saved) => format!("{:+.1}", saved * 100.0),
                None => "–".to_owned(),
            };
            let name = std::iter::once(row.name.clone());
            name.chain(cells.map(percent)).collect()
        }));
        rows
    }

    /// The row of everything on, with lookahead or without it.
    fn base(
        &self,
        title: &str,
        ahead: bool,
        cell: impl Fn(&Sent) -> String,
    ) -> Option<Vec<String>> {
        let mut rows = self.measured();
        let row = rows.find(|row| (row.lookahead_ticks > 0) == ahead)?;
        let cells = row.comparisons.iter().flat_map(|of| &of.with);
        let name = std::iter::once(title.to_owned());
        Some(name.chain(cells.map(cell)).collect())
    }

    fn errors(&self) -> Vec<Vec<String>> {
        let mut rows = vec![self.titles()];
        let percent = |sent: &Sent| number(sent.over_share.map(|share| share * 100.0));
        rows.extend(self.base("everything on", false, percent));
        rows.extend(self.base("with lookahead", true, percent));
        rows.extend(self.measured().map(|row| {
            let cells = row.comparisons.iter().flat_map(|of| &of.without);
            let name = std::iter::once(row.name.clone());
            name.chain(cells.map(percent)).collect()
        }));
        rows
    }

    fn price(&self) -> Vec<Vec<String>> {
        let titles = [
            "mechanism",
            "most saved, %",
            "time/update without it",
            "lines of code",
            "requirements",
            "stays for",
        ];
        let mut rows = vec![titles.map(str::to_owned).to_vec()];
        rows.extend(self.rows.iter().map(|row| {
            let saved = row.most_saved();
            let stays = match (saved.is_some_and(|saved| saved >= WORTH), &row.feature) {
                (true, None) => "bytes".to_owned(),
                (true, Some(feature)) => format!("{feature}, bytes"),
                (false, Some(feature)) => feature.clone(),
                (false, None) => "nothing".to_owned(),
            };
            vec![
                row.name.clone(),
                saved.map_or("–".to_owned(), |saved| format!("{:+.1}", saved * 100.0)),
                number(row.time_ratio()),
                row.lines.to_string(),
                row.requirements.to_string(),
                stays,
            ]
        }));
        rows
    }
}

impl AblationRow {
    /// Greatest share of the bytes that it saves, over loads and links.
    fn most_saved(&self) -> Option<f64> {
        let saved = self.comparisons.iter().flat_map(Comparison::saved);
        saved.flatten().reduce(f64::max)
    }

    /// Publishing time per update without it over that with it, without loss: the mean over the loads.
    fn time_ratio(&self) -> Option<f64> {
        let ratio = |of: &Comparison| {
            let [with, without] = [&of.with[0], &of.without[0]].map(|of| of.publish_ns_per_update);
            Some(without? / with?)
        };
        let ratios: Option<Vec<f64>> = self.comparisons.iter().map(ratio).collect();
        let ratios = ratios.filter(|ratios| !ratios.is_empty())?;
        Some(ratios.iter().sum::<f64>() / ratios.len() as f64)
    }
}

impl Comparison {
    /// The share by which the bytes without the mechanism exceed those with it, over each link.
    fn saved(&self) -> [Option<f64>; 2] {
        [0, 1].map(|link| {
            let (with, without) = (&self.with[link], &self.without[link]);
            Some(without.payload_bytes? / with.payload_bytes? - 1.0)
        })
    }
}

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
