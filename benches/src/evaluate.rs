//! `rhumb-bench evaluate`: runs the modes and writes what was measured.
//!
//! Measures nothing itself. What is written first is kept when what is written later fails.

use std::fmt;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use rhumb_reckoning::{Metres, Tolerance};
use rhumb_server::{RunError, run_on_core, usable_cores};
use rhumb_transport::LinkTerms;

use crate::drive::{Cores, DriveError, Plan, run_free, run_side_by_side};
use crate::machine;
use crate::record::{Experiment, Load, Mode};
use crate::report;
use crate::summary::Summary;
use crate::trace::{self, TraceError, TraceOptions};

/// What to run, and where to write it.
#[derive(Clone, Debug, Args)]
pub struct Evaluate {
    /// Which script: ball-pit, free-fall or zoo.
    #[arg(long, default_value = "ball-pit")]
    scene: String,
    /// How many bodies; several loads are run one after the other.
    #[arg(long, value_delimiter = ',', default_value = "500,1000,2000", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    bodies: Vec<u32>,
    /// Which modes to run side by side.
    #[arg(long, value_delimiter = ',', default_values_t = [ModeName::Integrated, ModeName::Naive, ModeName::Rhumb, ModeName::RhumbPipelined])]
    modes: Vec<ModeName>,
    /// Simulated seconds.
    #[arg(long, default_value = "10", value_parser = seconds, allow_negative_numbers = true)]
    seconds: f64,
    /// How far off a copied body may be, metres.
    #[arg(long, default_value = "0.05", value_parser = tolerance, allow_negative_numbers = true)]
    tolerance: Tolerance,
    /// Seed of the script and of the pretended link.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The link between the processes, such as rtt=100ms,loss=5%,jitter=10ms.
    #[arg(long, default_value_t = LinkTerms::PERFECT)]
    link: LinkTerms,
    /// Folder for summary.json, report.html, trace.mcap and its layout; made if it is not there.
    #[arg(long, default_value = "results")]
    out: PathBuf,
    /// Write no trace.
    #[arg(long)]
    no_trace: bool,
    /// Let the system choose the cores instead of keeping servers apart from their caller.
    #[arg(long)]
    no_pin: bool,
}

/// A mode as it is named on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ModeName {
    /// Stepped in the caller's own thread.
    Integrated,
    /// A server that sends everything.
    Naive,
    /// The reckoned stream, lockstep.
    Rhumb,
    /// The reckoned stream, one tick behind.
    RhumbPipelined,
    /// The reckoned stream of a server that runs by its own clock, in real time.
    RhumbFree,
}

impl ModeName {
    const fn mode(self) -> Mode {
        match self {
            Self::Integrated => Mode::Integrated,
            Self::Naive => Mode::Naive,
            Self::Rhumb => Mode::Rhumb,
            Self::RhumbPipelined => Mode::RhumbPipelined,
            Self::RhumbFree => Mode::RhumbFree,
        }
    }
}

impl fmt::Display for ModeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.mode().fmt(f)
    }
}

/// Longest run that is kept in memory: an hour.
const SECONDS_MAX: f64 = 3_600.0;

fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if (0.1..=SECONDS_MAX).contains(&value) {
        Ok(value)
    } else {
        Err(format!("must lie between 0.1 and {SECONDS_MAX} seconds"))
    }
}

fn tolerance(text: &str) -> Result<Tolerance, String> {
    let value: f64 = text
        .parse()
        .map_err(|_| "not a number of metres".to_owned())?;
    Tolerance::from_metres(Metres::new(value)).map_err(|error| error.to_string())
}

/// Why an evaluation did not come to its end.
#[derive(Debug)]
enum EvaluateError {
    /// A run failed.
    Drive(DriveError),
    /// The cores cannot be chosen.
    Cores(RunError),
    /// A file or folder cannot be written.
    Write { path: PathBuf, cause: io::Error },
    /// The trace cannot be written.
    Trace(TraceError),
    /// The engines of two modes did not do the same, so that nothing can be compared.
    Void { bodies: u32, mode: Mode },
}

impl fmt::Display for EvaluateError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Drive(cause) => cause.fmt(f),
            Self::Cores(cause) => write!(f, "{cause}; try --no-pin"),
            Self::Write { path, cause } => write!(f, "cannot write {}: {cause}", path.display()),
            Self::Trace(cause) => cause.fmt(f),
            Self::Void { bodies, mode } => write!(
                f,
                "the runs with {bodies} bodies are void: the truth of {mode} differs from that of the other modes"
            ),
        }
    }
}

impl From<DriveError> for EvaluateError {
    fn from(cause: DriveError) -> Self {
        Self::Drive(cause)
    }
}

/// Runs an evaluation. Exit code 0 when everything was measured and written, 1 otherwise.
pub fn evaluate(arguments: &Evaluate) -> ExitCode {
    match run(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Nowhere is left to say that standard error is closed.
            let _ = writeln!(io::stderr(), "error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Evaluate) -> Result<(), EvaluateError> {
    std::fs::create_dir_all(&arguments.out).map_err(|cause| EvaluateError::Write {
        path: arguments.out.clone(),
        cause,
    })?;
    // Asked before this process keeps to one of them.
    let machine = machine::describe();
    let cores = choose_cores(arguments)?;
    let mut loads = Vec::new();
    for bodies in &arguments.bodies {
        loads.extend(run_load(arguments, *bodies, cores)?);
    }
    let experiment = Experiment {
        command: std::env::args()
            .skip(1)
            .fold("rhumb-bench".to_owned(), |line, word| line + " " + &word),
        seed: arguments.seed,
        machine,
        loads,
    };
    let summary = Summary::of(&experiment);
    let table = summary.table().to_string();
    write_file(
        &arguments.out.join("summary.json"),
        summary.to_json().as_bytes(),
    )?;
    say(&table)?;
    let page = report::html(&experiment, &summary);
    write_file(&arguments.out.join("report.html"), page.as_bytes())?;
    if !arguments.no_trace {
        // Drawing is most of a trace, and one load is enough to look at.
        let scene_bodies_max = arguments.bodies.iter().copied().min().unwrap_or(0);
        let options = TraceOptions {
            scene_bodies_max,
            ..TraceOptions::default()
        };
        write_trace(&arguments.out, &experiment, &options)?;
    }
    say(&format!("\nwritten to {}\n", arguments.out.display()))?;
    check_truth(&experiment)
}

/// Keeps the servers on a core of their own where there is more than one.
fn choose_cores(arguments: &Evaluate) -> Result<Cores, EvaluateError> {
    let usable = usable_cores();
    let (Some(caller), Some(server)) = (usable.first(), usable.get(1)) else {
        return Ok(Cores::default());
    };
    if arguments.no_pin {
        return Ok(Cores::default());
    }
    run_on_core(*caller).map_err(EvaluateError::Cores)?;
    Ok(Cores {
        server: Some(*server),
    })
}

/// Runs all modes at one load; the free-running one by itself, since it has a truth of its own.
fn run_load(arguments: &Evaluate, bodies: u32, cores: Cores) -> Result<Vec<Load>, EvaluateError> {
    let modes: Vec<Mode> = arguments.modes.iter().map(|name| name.mode()).collect();
    let plan = Plan {
        scene: arguments.scene.clone(),
        bodies,
        seed: arguments.seed,
        ticks: (arguments.seconds * 60.0).round() as u32,
        tolerance: arguments.tolerance,
        link: arguments.link,
        modes: modes.clone(),
        cores,
    };
    let mut loads = Vec::new();
    if modes.iter().any(|mode| *mode != Mode::RhumbFree) {
        let bar = progress_bar(u64::from(plan.ticks), format!("{bodies} bodies"));
        loads.push(run_side_by_side(&plan, &mut |_| bar.inc(1))?);
        bar.finish_and_clear();
    }
    if modes.contains(&Mode::RhumbFree) {
        let bar = progress_bar(
            u64::from(plan.ticks),
            format!("{bodies} bodies, free running"),
        );
        loads.push(run_free(&plan, &mut |_| bar.inc(1))?);
        bar.finish_and_clear();
    }
    Ok(loads)
}

/// On standard error, and only if that is a terminal.
fn progress_bar(length: u64, what: String) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(length), ProgressDrawTarget::stderr());
    let style = ProgressStyle::with_template("{msg:28} {bar:32} {pos}/{len} {elapsed} left {eta}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.with_message(what)
}

fn write_trace(
    out: &Path,
    experiment: &Experiment,
    options: &TraceOptions,
) -> Result<(), EvaluateError> {
    let bar = progress_bar(0, "trace".to_owned());
    let path = out.join("trace.mcap");
    let written = trace::write(&path, experiment, options, &mut |progress| {
        bar.set_length(progress.of);
        bar.set_position(progress.done);
    });
    bar.finish_and_clear();
    written.map_err(EvaluateError::Trace)?;
    write_file(
        &out.join("layout.json"),
        trace::layout(experiment).as_bytes(),
    )
}

/// Writes a whole file beside its place, then gives it its name, so that no half file is ever taken for a whole one.
fn write_file(path: &Path, bytes: &[u8]) -> Result<(), EvaluateError> {
    let partial = path.with_extension("partial");
    let written = std::fs::write(&partial, bytes).and_then(|()| std::fs::rename(&partial, path));
    written.map_err(|cause| {
        // It may never have come to be.
        let _ = std::fs::remove_file(&partial);
        EvaluateError::Write {
            path: path.to_owned(),
            cause,
        }
    })
}

fn say(text: &str) -> Result<(), EvaluateError> {
    let mut out = io::stdout().lock();
    let said = out.write_all(text.as_bytes()).and_then(|()| out.flush());
    said.map_err(|cause| EvaluateError::Write {
        path: "standard output".into(),
        cause,
    })
}

/// A run whose truth differs between modes is void.
fn check_truth(experiment: &Experiment) -> Result<(), EvaluateError> {
    for load in &experiment.loads {
        for run in &load.runs {
            if run.truth_digest != load.truth.digest {
                return Err(EvaluateError::Void {
                    bodies: run.terms.bodies,
                    mode: run.terms.mode,
                });
            }
        }
    }
    Ok(())
}
