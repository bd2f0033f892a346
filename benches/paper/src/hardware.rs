//! `rhumb-paper hardware`: threads, pinning and a slowed caller.
//!
//! Each row is a separate trial of one load. All rows must have equal truth; a row with a different one is void.

use std::collections::BTreeMap;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::Args;
use rhumb_bench::drive::{DriveError, ServerCpu};
use rhumb_bench::numbers::number;
use rhumb_bench::record::Mode;
use rhumb_bench::{machine, output};
use rhumb_scene::StepThreads;
use rhumb_server::{run_on_cores, usable_cores};
use serde::{Deserialize, Serialize};

use crate::page::{Table, page};
use crate::processor::CoreAssignment;
use crate::settings::{ModeOutcome, PaperError, Settings, parse, tolerance};
use crate::trial::{self, FRAMES_PER_SECOND, STEPS, Staging};

/// Arguments of the hardware task.
#[derive(Clone, Debug, Args)]
pub(crate) struct HardwareArguments {
    /// Number of balls. Default: 500,2000, or 100 with --fast.
    #[arg(long, value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..=100_000))]
    loads: Vec<u32>,
    /// Threads of the engine, such as 1,2,all. Default: all of these with the feature `parallel`, else 1.
    #[arg(long, value_delimiter = ',')]
    threads: Vec<Threads>,
    /// Percentage of a processor that the caller gets; 100 means no limit.
    #[arg(long, value_delimiter = ',', default_values_t = [100, 25], value_parser = clap::value_parser!(u32).range(10..=100))]
    caller_percent: Vec<u32>,
    /// Frames of each row. Default: 60, or 20 with --fast.
    #[arg(long)]
    frames: Option<NonZeroU32>,
    /// Tolerance of a copied body's surface error, metres.
    #[arg(long, default_value_t = 0.05, allow_negative_numbers = true)]
    tolerance: f64,
    /// Seed of the scene.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Use a small load and few frames.
    #[arg(long)]
    fast: bool,
    /// Folder for the results; created if missing.
    #[arg(long, default_value = "results/hardware")]
    out: PathBuf,
}

/// A number of threads, or one per core.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Threads {
    All,
    Of(NonZeroU32),
}

impl FromStr for Threads {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "all" => Ok(Self::All),
            _ => text
                .parse()
                .map(Self::Of)
                .map_err(|_| "must be a number of threads or \"all\"".to_owned()),
        }
    }
}

/// Results: `hardware.json`, of one machine or merged from several.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct HardwareResults {
    pub(crate) machines: Vec<MachineResults>,
}

/// Results of one machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct MachineResults {
    /// The command line; its paths have no folders.
    pub(crate) command: String,
    /// Processor, cores, operating system.
    pub(crate) machine: String,
    /// Build profile, version and commit.
    pub(crate) build: String,
    pub(crate) rows: Vec<HardwareRow>,
}

/// One mode in one setting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct HardwareRow {
    pub(crate) load: u32,
    pub(crate) seed: u64,
    pub(crate) threads: u32,
    /// Cores of the caller and the servers.
    pub(crate) cores: String,
    /// Share of a processor that the caller gets, and by which means.
    pub(crate) caller: String,
    pub(crate) outcome: ModeOutcome,
}

const MODES: [Mode; 3] = [Mode::Integrated, Mode::Rhumb, Mode::RhumbPipelined];

/// Runs every combination; writes the results after each.
pub(crate) fn run(arguments: &HardwareArguments) -> Result<(), PaperError> {
    let machine = machine::describe();
    let all = usable_cores();
    tolerance(arguments.tolerance)?;
    output::make_folder(&arguments.out)?;
    let threads = threads(arguments, all.len());
    for count in &threads {
        StepThreads::new(Some(*count)).map_err(DriveError::StepThreads)?;
    }
    let (loads, frames): (&[u32], u32) = if arguments.fast {
        (&[100], 20)
    } else {
        (&[500, 2_000], 60)
    };
    let loads = if arguments.loads.is_empty() {
        loads
    } else {
        &arguments.loads
    };
    let frames = arguments.frames.map_or(frames, NonZeroU32::get);
    let mut rows = Vec::new();
    let combinations = loads.len() * threads.len() * 2 * arguments.caller_percent.len();
    let bar = output::progress_bar(combinations as u64, machine.clone());
    for load in loads {
        for count in &threads {
            for places in [
                CoreAssignment::default(),
                places(&all, count.get() as usize),
            ] {
                // Undo the pinning of the previous combination.
                let own = if places.caller.is_empty() {
                    &all
                } else {
                    &places.caller
                };
                if !own.is_empty() {
                    run_on_cores(own).map_err(PaperError::Cores)?;
                }
                for percent in &arguments.caller_percent {
                    let settings = settings(arguments, *load, frames, *count, &places);
                    rows.extend(of_setting(&settings, &places, *count, *percent)?);
                    bar.inc(1);
                }
            }
        }
    }
    bar.finish_and_clear();
    mark_void(&mut rows);
    let results = HardwareResults {
        machines: vec![MachineResults {
            command: output::command_line(),
            machine,
            build: machine::build(),
            rows,
        }],
    };
    write(&arguments.out, &results)
}

fn threads(arguments: &HardwareArguments, cores: usize) -> Vec<NonZeroU32> {
    let all = NonZeroU32::new(cores as u32).unwrap_or(NonZeroU32::MIN);
    let two = NonZeroU32::MIN.saturating_add(1);
    let usual = [Threads::Of(NonZeroU32::MIN), Threads::Of(two), Threads::All];
    let asked = match (arguments.threads.is_empty(), StepThreads::may_be_many()) {
        (false, _) => &arguments.threads[..],
        (true, true) => &usual,
        (true, false) => &usual[..1],
    };
    let mut counts: Vec<NonZeroU32> = asked
        .iter()
        .map(|threads| match threads {
            Threads::All => all,
            Threads::Of(count) => *count,
        })
        .collect();
    counts.sort_unstable();
    counts.dedup();
    counts
}

/// The caller on the first cores, the servers on the last ones, one core per engine thread each.
fn places(all: &[usize], threads: usize) -> CoreAssignment {
    let count = threads.min(all.len());
    CoreAssignment {
        caller: all[..count].to_vec(),
        servers: all[all.len() - count..].to_vec(),
    }
}

fn settings(
    arguments: &HardwareArguments,
    load: u32,
    frames: u32,
    threads: NonZeroU32,
    places: &CoreAssignment,
) -> Settings {
    Settings {
        scene: "ball-pit".to_owned(),
        loads: vec![load],
        frames_per_load: frames,
        steps_per_frame: STEPS.get(),
        frames_per_second: FRAMES_PER_SECOND,
        tolerance_m: arguments.tolerance,
        modes: MODES.map(|mode| mode.name().to_owned()).into(),
        seed: arguments.seed,
        cores: places.describe(),
        threads: threads.get(),
        build: machine::build(),
        machine: machine::describe(),
    }
}

fn of_setting(
    settings: &Settings,
    places: &CoreAssignment,
    threads: NonZeroU32,
    caller_percent: u32,
) -> Result<Vec<HardwareRow>, PaperError> {
    let cpu = ServerCpu {
        cores: places.servers.clone(),
        threads: Some(threads),
    };
    let staging = Staging {
        cpu: &cpu,
        modes: &MODES,
        caller_percent,
    };
    let mut caller = String::new();
    let trial = trial::run(settings, 1, &staging, &mut |progress| {
        if caller.is_empty() {
            progress.caller.clone_into(&mut caller);
        }
    })?;
    let outcomes = trial.loads.into_iter().flat_map(|found| found.modes);
    let row = |outcome| HardwareRow {
        load: settings.loads[0],
        seed: trial.seed,
        threads: settings.threads,
        cores: settings.cores.clone(),
        caller: caller.clone(),
        outcome,
    };
    Ok(outcomes.map(row).collect())
}

/// Marks rows as void whose truth differs from the first row of their load; threads must not change the truth.
fn mark_void(rows: &mut [HardwareRow]) {
    let mut truths: BTreeMap<(u32, u64, u32), String> = BTreeMap::new();
    for row in rows {
        let scene = (row.load, row.seed, row.outcome.frames);
        let truth = truths
            .entry(scene)
            .or_insert_with(|| row.outcome.truth.clone());
        row.outcome.void |= *truth != row.outcome.truth;
    }
}

/// Merges files of several machines into one table.
pub(crate) fn merge(files: &[PathBuf], out: &Path) -> Result<(), PaperError> {
    let mut merged = HardwareResults {
        machines: Vec::new(),
    };
    for path in files {
        let bytes = std::fs::read(path).map_err(|cause| PaperError::Read {
            path: path.clone(),
            cause,
        })?;
        let results: HardwareResults = parse(path, &bytes)?;
        for machine in results.machines {
            if merged.machines.contains(&machine) {
                let why = format!(
                    "{} contains a machine that was already given: {}",
                    path.display(),
                    machine.machine
                );
                return Err(PaperError::Merge { why });
            }
            merged.machines.push(machine);
        }
    }
    // The truth must also agree between machines.
    let mut rows: Vec<HardwareRow> = merged
        .machines
        .iter()
        .flat_map(|one| one.rows.clone())
        .collect();
    mark_void(&mut rows);
    let mut rows = rows.into_iter();
    for machine in &mut merged.machines {
        machine.rows = rows.by_ref().take(machine.rows.len()).collect();
    }
    output::make_folder(out)?;
    write(out, &merged)
}

fn write(out: &Path, results: &HardwareResults) -> Result<(), PaperError> {
    output::write_json(&out.join("hardware.json"), results)?;
    let table = table(results);
    let text = format!("# What hardware gives\n\n{}", table.to_markdown());
    output::write_file(&out.join("hardware.md"), text.as_bytes())?;
    let html = page("What hardware gives", &table.to_html());
    output::write_file(&out.join("hardware.html"), html.as_bytes())?;
    output::print_text(&table.to_text())?;
    Ok(output::print_text(&format!(
        "\nwritten to {}\n",
        out.display()
    ))?)
}

/// The table of all machines.
pub(crate) fn table(results: &HardwareResults) -> Table {
    let columns = [
        "machine",
        "balls",
        "threads",
        "cores",
        "caller share",
        "mode",
        "PhysFT, ms",
        "p99, ms",
        "caller's own work, ms",
        "engine, ms",
        "SimFPS",
        "sustained",
    ];
    let mut table = Table::new("What hardware gives", columns);
    for machine in &results.machines {
        for row in &machine.rows {
            let found = &row.outcome;
            let mode = &found.mode;
            let mut cells = vec![
                machine.machine.clone(),
                row.load.to_string(),
                row.threads.to_string(),
                row.cores.clone(),
                row.caller.clone(),
                if found.void {
                    format!("{mode}, void")
                } else {
                    mode.clone()
                },
            ];
            let values = [
                Some(found.phys_ft_ms),
                Some(found.phys_ft_p99_ms),
                found.work_ms,
                Some(found.step_ms),
            ];
            cells.extend(values.map(number));
            cells.extend([found.sim_fps, found.sustained_fps].map(|fps| format!("{fps:.2}")));
            table.rows.push(cells);
        }
    }
    table.note = "Threads step the engine, in process and at the server alike. A caller with less than 100 % is \
                  slowed as its cell states; the servers are not. All rows step in four SIMD lanes, because the \
                  engine excludes eight in deterministic mode. Void: the engine diverged from other rows."
        .to_owned();
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(load: u32, threads: u32, truth: &str) -> HardwareRow {
        HardwareRow {
            load,
            seed: 1,
            threads,
            cores: "not pinned".to_owned(),
            caller: "100 %".to_owned(),
            outcome: ModeOutcome {
                mode: "rhumb".to_owned(),
                frames: 20,
                truth: truth.to_owned(),
                ..ModeOutcome::default()
            },
        }
    }

    #[test]
    fn a_row_with_another_truth_is_void_on_any_machine() {
        let mut rows = [
            row(100, 1, "a"),
            row(100, 2, "a"),
            row(200, 1, "b"),
            row(200, 2, "c"),
        ];
        mark_void(&mut rows);
        let void: Vec<_> = rows.iter().map(|row| row.outcome.void).collect();
        assert_eq!(void, [false, false, false, true]);
    }

    #[test]
    fn caller_and_servers_get_separate_cores_where_there_are_enough() {
        let cores: Vec<usize> = (0..16).collect();
        let two = places(&cores, 2);
        assert_eq!((two.caller, two.servers), (vec![0, 1], vec![14, 15]));
        let all = places(&cores[..2], 8);
        assert_eq!((all.caller, all.servers), (vec![0, 1], vec![0, 1]));
    }

    #[test]
    fn threads_are_a_number_or_all() {
        assert_eq!("all".parse(), Ok(Threads::All));
        assert_eq!("3".parse(), Ok(Threads::Of(NonZeroU32::new(3).unwrap())));
        for wrong in ["0", "many", ""] {
            assert!(wrong.parse::<Threads>().is_err(), "{wrong}");
        }
    }
}
