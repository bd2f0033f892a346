//! `rhumb-paper`: runs trials in sequence and writes the results.
//!
//! Each finished trial is stored at once, and results are recomputed after it. An interruption loses only the running
//! trial. The sentences of the pages are computed from the results.

use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::num::NonZeroU32;
use std::path::PathBuf;

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use rhumb_bench::drive::{DriveError, ServerCpu, player};
use rhumb_bench::numbers::number;
use rhumb_bench::record::Mode;
use rhumb_bench::report::escape;
use rhumb_bench::{machine, output};
use rhumb_scene::StepThreads;
use rhumb_server::run_on_cores;

use crate::analysis::{ALPHA, Analysis, ModeAnalysis, PaperResults, rejected};
use crate::page::{Table, figure_html, page};
use crate::processor::CoreAssignment;
use crate::settings::{ExperimentTrial, Loads, PaperError, Settings, Store, tolerance};
use crate::trial::{self, FRAMES_PER_SECOND, STEPS, Staging};
use crate::{analysis, tables};

/// Arguments of the experiment.
#[derive(Clone, Debug, Args)]
pub(crate) struct ExperimentArguments {
    /// Number of trials, each with its own seed. Default: 30, or 3 with --fast.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    trials: Option<u32>,
    /// Balls in the pit, stage by stage, such as 500..10000 or 500,1000. Default: 500..10000, or 100..300 with --fast.
    #[arg(long)]
    loads: Option<Loads>,
    /// Simulated seconds of each stage. Default: 30, or 3 with --fast.
    #[arg(long, value_parser = stage_seconds, allow_negative_numbers = true)]
    stage_seconds: Option<f64>,
    /// Modes, including integrated. Default: all.
    #[arg(long, value_delimiter = ',', value_parser = mode_parser())]
    modes: Vec<Mode>,
    /// Tolerance of a copied body's surface error, metres.
    #[arg(long, default_value_t = 0.05, allow_negative_numbers = true)]
    tolerance: f64,
    /// Seed of the first trial; each later trial has the next one.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Threads of each engine; more than one needs the feature `parallel`.
    #[arg(long, default_value = "1")]
    threads: NonZeroU32,
    /// A short experiment: three trials of three small loads, three simulated seconds each.
    #[arg(long)]
    fast: bool,
    /// Folder for trials and results; an interrupted experiment continues there.
    #[arg(long, default_value = "results/paper")]
    out: PathBuf,
    /// Let the system choose the cores instead of separating servers from their caller.
    #[arg(long)]
    no_pin: bool,
}

/// Parses the name of a playable mode.
fn mode_parser() -> impl TypedValueParser<Value = Mode> {
    let names: Vec<_> = player::playable().map(Mode::name).collect();
    PossibleValuesParser::new(names).try_map(|name| {
        let found = player::playable().find(|mode| mode.name() == name);
        found.ok_or("no such mode")
    })
}

fn stage_seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if (0.1..=3_600.0).contains(&value) {
        Ok(value)
    } else {
        Err("must lie between 0.1 and 3600 seconds".to_owned())
    }
}

/// Runs the missing trials of the experiment and writes all results.
pub(crate) fn run(arguments: &ExperimentArguments) -> Result<(), PaperError> {
    // Read before this process pins itself to one core.
    let machine = machine::describe();
    let places = if arguments.no_pin {
        CoreAssignment::default()
    } else {
        CoreAssignment::apart()
    };
    let modes = modes(arguments)?;
    let settings = settings(arguments, &modes, &places, machine);
    let trials = arguments
        .trials
        .unwrap_or(if arguments.fast { 3 } else { 30 });
    tolerance(settings.tolerance_m)?;
    StepThreads::new(Some(arguments.threads)).map_err(DriveError::StepThreads)?;
    let store = Store::open(&arguments.out, &settings)?;
    if !places.caller.is_empty() {
        run_on_cores(&places.caller).map_err(PaperError::Cores)?;
    }
    let cpu = ServerCpu {
        cores: places.servers.clone(),
        threads: Some(arguments.threads),
    };
    let staging = Staging {
        cpu: &cpu,
        modes: &modes,
        caller_percent: 100,
    };
    // The folder may hold more trials than requested.
    let mut done = store.trials()?;
    done.retain(|number, _| *number <= trials);
    let missing: Vec<u32> = (1..=trials)
        .filter(|number| !done.contains_key(number))
        .collect();
    if missing.len() < trials as usize {
        let kept = trials as usize - missing.len();
        output::print_text(&format!("{kept} of {trials} trials are already finished\n"))?;
    }
    // The time of a frame is roughly proportional to the number of balls.
    let cost: u64 = settings.loads.iter().copied().map(u64::from).sum();
    let length = cost * u64::from(settings.frames_per_load) * missing.len() as u64;
    let bar = output::progress_bar(length, String::new());
    bar.set_style(output::share_style());
    for number in &missing {
        let mut stage = None;
        let trial = trial::run(&settings, *number, &staging, &mut |progress| {
            let here = format!("trial {number} of {trials}, {} balls", progress.load);
            bar.inc(u64::from(progress.load));
            // Without a terminal there is no bar, so each stage prints a line.
            if bar.is_hidden() && stage.replace(progress.load) != Some(progress.load) {
                let done = 100 * bar.position() / length.max(1);
                // If standard error is closed, no other place is left to report to.
                let _ = writeln!(io::stderr(), "{here}: {done} % done");
            }
            bar.set_message(here);
        })?;
        store.keep(&trial)?;
        let line = format!(
            "trial {number} of {trials}, seed {}: {:.0} s\n",
            trial.seed, trial.wall_s
        );
        bar.suspend(|| output::print_text(&line))?;
        done.insert(*number, trial);
        let ended = done.values().cloned().collect();
        write(arguments, &settings, ended)?;
    }
    bar.finish_and_clear();
    let results = write(arguments, &settings, done.into_values().collect())?;
    print_text(arguments, &results)
}

fn modes(arguments: &ExperimentArguments) -> Result<Vec<Mode>, PaperError> {
    if arguments.modes.is_empty() {
        return Ok(player::playable().collect());
    }
    if !arguments.modes.contains(&Mode::Integrated) {
        return Err(PaperError::NoIntegrated);
    }
    Ok(player::playable()
        .filter(|mode| arguments.modes.contains(mode))
        .collect())
}

fn settings(
    arguments: &ExperimentArguments,
    modes: &[Mode],
    places: &CoreAssignment,
    machine: String,
) -> Settings {
    let fast = arguments.fast;
    let usual = if fast {
        Loads::multiples(100, 3)
    } else {
        Loads::multiples(500, 20)
    };
    let loads = arguments.loads.clone().unwrap_or(usual);
    let seconds = arguments
        .stage_seconds
        .unwrap_or(if fast { 3.0 } else { 30.0 });
    Settings {
        scene: "ball-pit".to_owned(),
        loads: loads.as_slice().to_vec(),
        frames_per_load: (seconds * FRAMES_PER_SECOND).round().max(1.0) as u32,
        steps_per_frame: STEPS.get(),
        frames_per_second: FRAMES_PER_SECOND,
        tolerance_m: arguments.tolerance,
        modes: modes.iter().map(|mode| mode.name().to_owned()).collect(),
        seed: arguments.seed,
        cores: places.describe(),
        threads: arguments.threads.get(),
        build: machine::build(),
        machine,
    }
}

/// Computes all results from the finished trials and writes them.
fn write(
    arguments: &ExperimentArguments,
    settings: &Settings,
    trials: Vec<ExperimentTrial>,
) -> Result<PaperResults, PaperError> {
    let results = PaperResults {
        command: output::command_line(),
        settings: settings.clone(),
        analysis: Analysis::of(settings, &trials),
        trials,
    };
    let out = &arguments.out;
    output::write_json(&out.join("paper.json"), &results)?;
    let write = |name: &str, text: String| output::write_file(&out.join(name), text.as_bytes());
    write("trials.csv", tables::trials_csv(&results)?)?;
    write("analysis.csv", tables::analysis_csv(&results)?)?;
    write("paper.md", markdown(&results))?;
    write("paper.html", html(&results))?;
    Ok(results)
}

fn print_text(arguments: &ExperimentArguments, results: &PaperResults) -> Result<(), PaperError> {
    output::print_text(&tables::sim_fps(results).to_text())?;
    output::print_text(&tables::phys_ft(results).to_text())?;
    output::print_text(&tables::degradation(results).to_text())?;
    for sentence in tables::void(results) {
        output::print_text(&format!("{sentence}\n"))?;
    }
    let out = arguments.out.display();
    Ok(output::print_text(&format!("\nwritten to {out}\n"))?)
}

/// All tables, in order.
fn all_tables(results: &PaperResults) -> Vec<Table> {
    vec![
        tables::aims(results),
        tables::sim_fps(results),
        tables::phys_ft(results),
        tables::degradation(results),
        tables::sustained(results),
        tables::paired(results),
        tables::tests_frame(results),
        tables::tests_fps(results),
        tables::stages(results),
        tables::traffic(results),
    ]
}

/// The text of `paper.md`.
pub(crate) fn markdown(results: &PaperResults) -> String {
    let mut text = format!(
        "# The paper's experiment, run again\n\n`{}`\n\n",
        results.command
    );
    for sentence in sentences(results) {
        let _ = writeln!(text, "- {sentence}");
    }
    for table in all_tables(results) {
        let _ = write!(text, "\n## {}\n\n{}", table.title, table.to_markdown());
    }
    text
}

/// The text of `paper.html`, which is self-contained.
pub(crate) fn html(results: &PaperResults) -> String {
    let mut body = format!("<pre>{}</pre>\n<ul>\n", escape(&results.command));
    for sentence in sentences(results) {
        let _ = writeln!(body, "<li>{}</li>", escape(&sentence));
    }
    body.push_str("</ul>\n");
    for figure in [analysis::sim_fps(results), analysis::phys_ft(results)] {
        body.push_str(&figure_html(&figure));
    }
    for table in all_tables(results) {
        body.push_str(&table.to_html());
    }
    page("The paper's experiment, run again", &body)
}

/// Smallest load of which the paper states that its distributed engine is always slower.
const FROM: u32 = 1_000;

/// One sentence on the experiment, one per mode except integrated, and one per void outcome.
pub(crate) fn sentences(results: &PaperResults) -> Vec<String> {
    let settings = &results.settings;
    let mut sentences = vec![format!(
        "{} trials of {} to {} balls, {} frames per stage, seeds {} to {}, on {} ({}; {} build).",
        results.trials.len(),
        settings.loads.first().copied().unwrap_or_default(),
        settings.loads.last().copied().unwrap_or_default(),
        settings.frames_per_load,
        settings.seed,
        settings.seed_of(results.trials.len().max(1) as u32),
        settings.machine,
        settings.cores,
        settings.build,
    )];
    let others = settings
        .modes
        .iter()
        .filter(|mode| *mode != Mode::Integrated.name());
    sentences.extend(others.filter_map(|mode| of_mode(results, mode)));
    if results.trials.len() > 1 {
        sentences.push(format!(
            "Significant: by paired t-tests of the trials' ratios, α = {ALPHA} for all these loads of a mode \
             together (Holm)."
        ));
    }
    sentences.extend(tables::void(results));
    sentences
}

/// Compares a mode's frame with the integrated one over the loads from a thousand on, or over all if there are none.
fn of_mode(results: &PaperResults, mode: &str) -> Option<String> {
    let reaches = results.settings.loads.iter().any(|load| *load >= FROM);
    let least = if reaches { FROM } else { 0 };
    let loads = results
        .analysis
        .loads
        .iter()
        .filter(|load| load.load >= least);
    let found: Vec<(u32, &ModeAnalysis)> = loads
        .filter_map(|load| Some((load.load, results.analysis.mode(load.load, mode)?)))
        .collect();
    let ratios: Vec<f64> = found
        .iter()
        .filter_map(|(_, own)| Some(own.against_integrated?.paired?.ratio))
        .collect();
    let (best, worst) = (
        ratios.iter().copied().reduce(f64::min)?,
        ratios.iter().copied().reduce(f64::max)?,
    );
    let tests: Vec<(u32, f64, f64)> = found
        .iter()
        .filter_map(|(load, own)| {
            let paired = own.against_integrated?.paired?;
            Some((*load, paired.ratio, paired.test?.p))
        })
        .collect();
    let p: Vec<f64> = tests.iter().map(|(.., p)| *p).collect();
    let significant = rejected(&p, ALPHA);
    let those = |longer: bool| {
        let selected = tests
            .iter()
            .zip(&significant)
            .filter(|(_, significant)| **significant);
        let these = selected.filter(|((_, ratio, _), _)| (*ratio > 1.0) == longer);
        let loads: Vec<u32> = these.map(|((load, ..), _)| *load).collect();
        at_loads(&loads, found.len())
    };
    let range = if reaches {
        format!("from {FROM} balls on")
    } else {
        "at these loads".to_owned()
    };
    let significance = if tests.is_empty() {
        String::new()
    } else {
        format!(
            "; significantly longer {}, significantly shorter {}",
            those(true),
            those(false)
        )
    };
    Some(format!(
        "{mode}: a frame takes {} to {} times the integrated one {range}{significance}.",
        number(Some(best)),
        number(Some(worst)),
    ))
}

/// Lists the loads, or counts them if there are many.
fn at_loads(loads: &[u32], of: usize) -> String {
    /// Longest list of loads; longer ones are counted.
    const NAMED: usize = 5;
    match loads {
        [] => "nowhere".to_owned(),
        _ if loads.len() == of => "everywhere".to_owned(),
        _ if loads.len() > NAMED => format!("at {} of {of} loads", loads.len()),
        _ => {
            let names: Vec<String> = loads.iter().map(u32::to_string).collect();
            format!("at {}", names.join(", "))
        }
    }
}
