//! `rhumb-bench evaluate`: runs the modes and writes the measurements.
//!
//! Measures nothing itself. Outputs already written are kept when a later step fails.

use std::mem;
use std::num::NonZeroU32;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, ValueEnum};
use rhumb_netsim::LinkConfig;
use rhumb_protocol::scene::PublishSchedule;
use rhumb_protocol::stream::{Budget, LOOKAHEAD_MAX};
use rhumb_reckoning::{Metres, Ticks, Tolerance};
use rhumb_server::{run_on_cores, usable_cores};
use rhumb_sims::Script;

use crate::drive::{Cores, Defect, Defects, DriveError, Plan, run_free, run_side_by_side};
use crate::limit::set_beside_limits;
use crate::output::{self, Failure, ended};
use crate::record::{Experiment, Load, Mode, Run};
use crate::recording::Recording;
use crate::{machine, scripts};

/// Arguments: which modes to run, and where to write.
#[derive(Clone, Debug, Args)]
pub struct Evaluate {
    /// Name of the script, or a file: URDF, MJCF, glTF, or a JSON scene.
    #[arg(long, value_name = "NAME|FILE", default_value = "ball-pit", value_parser = scripts::parse)]
    scene: String,
    /// Number of bodies; several loads run one after the other. Default: as fits the scene.
    #[arg(long, value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..=100_000))]
    bodies: Vec<u32>,
    /// Modes to run side by side.
    #[arg(long, value_delimiter = ',', default_values_t = [Mode::Integrated, Mode::Naive, Mode::Rhumb, Mode::RhumbPipelined])]
    modes: Vec<Mode>,
    /// Simulated seconds.
    #[arg(long, default_value = "10", value_parser = seconds, allow_negative_numbers = true)]
    seconds: f64,
    /// Tolerance of a copied body's surface error, metres.
    #[arg(long, default_value = crate::recording::DEFAULT_TOLERANCE, value_parser = tolerance, allow_negative_numbers = true)]
    tolerance: Tolerance,
    /// Client of the paper's protocol: one without avoidable losses, or the published one.
    #[arg(
        long,
        value_enum,
        default_value = "sound",
        conflicts_with = "app_defects"
    )]
    app_client: AppClient,
    /// Client of the paper's protocol with these defects only.
    #[arg(long, value_enum, value_delimiter = ',')]
    app_defects: Vec<Defect>,
    /// Seed of the script and of the simulated link.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The link between the processes, such as rtt=100ms,loss=5%,jitter=10ms. Its parts: rtt or delay (of one way), jitter,
    /// loss, burst (mean run of losses, packets), dup, reorder, rate (as 1mbit), queue (as 64kB).
    #[arg(long, default_value_t = LinkConfig::PERFECT)]
    link: LinkConfig,
    /// Free running: ticks between publications.
    #[arg(long, default_value = "1")]
    publish_interval: NonZeroU32,
    /// Free running: ticks by which the encoder looks ahead; the copy lags by as many.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=i64::from(LOOKAHEAD_MAX.count())))]
    lookahead: u32,
    /// Free running: ticks by which the view lags behind the newest tick that can be shown. With 0, some ticks are
    /// shown shortly before their updates arrive.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=DELAY_TICKS_MAX))]
    delay: u32,
    /// Bandwidth limit of a predicted stream, bytes per second; unlimited by default.
    #[arg(long, value_name = "BYTES/S", value_parser = crate::replay::budget)]
    budget: Option<Budget>,
    /// Folder for summary.json, report.html, trace.mcap and its layout; created if missing.
    #[arg(long, default_value = "results")]
    out: PathBuf,
    /// Write no trace.
    #[arg(long)]
    no_trace: bool,
    /// Skip the comparison with the limit for a known future.
    #[arg(long)]
    no_limit: bool,
    /// Let the system choose the cores instead of separating servers from their caller.
    #[arg(long)]
    no_pin: bool,
}

/// Client of the paper's protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum AppClient {
    /// A client without avoidable losses.
    Sound,
    /// The published one, with all of its defects.
    AsPublished,
}

impl Evaluate {
    fn defects(&self) -> Defects {
        match self.app_client {
            _ if !self.app_defects.is_empty() => Defects::only(&self.app_defects),
            AppClient::Sound => Defects::SOUND,
            AppClient::AsPublished => Defects::AS_PUBLISHED,
        }
    }
}

/// Longest delay: the maximum lookahead, twice, with a margin.
const DELAY_TICKS_MAX: i64 = 60;

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

/// Runs an evaluation. Exit code 0 if everything was measured and written, 1 otherwise.
pub fn evaluate(arguments: &Evaluate) -> ExitCode {
    ended(run(arguments))
}

fn run(arguments: &Evaluate) -> Result<(), Failure> {
    let has_publish_interval =
        arguments.publish_interval.get() > 1 || arguments.lookahead > 0 || arguments.delay > 0;
    if has_publish_interval && !arguments.modes.iter().any(|mode| mode.is_free()) {
        return Err("--publish-interval, --lookahead and --delay apply to free-running modes: select one by --modes, such as rhumb-free,naive-free".into());
    }
    output::make_folder(&arguments.out)?;
    // Read before this process pins itself to one core.
    let machine = machine::describe();
    let cores = choose_cores(arguments)?;
    let mut experiment = Experiment {
        command: output::command_line(),
        seed: arguments.seed,
        machine,
        loads: Vec::new(),
    };
    let bodies = bodies(arguments);
    for bodies in &bodies {
        let mut loads = run_load(arguments, *bodies, cores)?;
        if !arguments.no_limit {
            for load in &mut loads {
                set_beside_limit(arguments, *bodies, load)?;
            }
        }
        experiment.loads.extend(loads);
        // Completed loads are written even if a later one fails.
        output::write_figures(&arguments.out, &experiment)?;
    }
    // Drawing takes most of a trace, and one load is enough to look at.
    let least = bodies.iter().copied().min().unwrap_or(0);
    let drawn = (!arguments.no_trace).then_some(least);
    output::write_all(&arguments.out, &experiment, drawn)?;
    check_truth(&experiment)
}

/// The requested loads, or those that fit the scene.
fn bodies(arguments: &Evaluate) -> Vec<u32> {
    if arguments.bodies.is_empty() {
        scripts::default_bodies(&arguments.scene)
    } else {
        arguments.bodies.clone()
    }
}

/// Pins caller and servers to different cores where there are two.
fn choose_cores(arguments: &Evaluate) -> Result<Cores, Failure> {
    let usable = usable_cores();
    let (Some(caller), Some(server)) = (usable.first(), usable.get(1)) else {
        return Ok(Cores::default());
    };
    if arguments.no_pin {
        return Ok(Cores::default());
    }
    run_on_cores(&[*caller]).map_err(|cause| format!("{cause}; try --no-pin"))?;
    Ok(Cores {
        server: Some(*server),
    })
}

fn script(arguments: &Evaluate, bodies: u32) -> Result<Box<dyn Script>, DriveError> {
    let script = scripts::by_name(&arguments.scene, bodies, arguments.seed);
    script.ok_or_else(|| DriveError::NoSuchScene {
        name: arguments.scene.clone(),
    })
}

/// Ticks of the scene nearest to the requested seconds, at least one.
fn ticks(arguments: &Evaluate, bodies: u32) -> Result<u32, Failure> {
    let config = script(arguments, bodies)?.config();
    let step_s = config.integrator.rate.step().seconds();
    Ok((arguments.seconds / step_s).round().max(1.0) as u32)
}

/// Adds the computed limit to the predicted runs of a load.
fn set_beside_limit(arguments: &Evaluate, bodies: u32, load: &mut Load) -> Result<(), Failure> {
    let mut script = script(arguments, bodies)?;
    let recording = Recording::of_play(&mut *script, mem::take(&mut load.truth));
    let promised = |run: &Run| {
        let publish_interval = match run.config.mode.is_free() {
            true => arguments.publish_interval,
            false => NonZeroU32::MIN,
        };
        run.config
            .tolerance_m
            .map(|_| (arguments.tolerance, publish_interval))
    };
    let runs = load.runs.iter_mut().map(|run| {
        let promised = promised(run);
        (run, promised)
    });
    set_beside_limits(&recording, runs);
    load.truth = recording.truth;
    Ok(())
}

/// Runs all modes at one load; the free-running ones separately, because they have a truth of their own.
fn run_load(arguments: &Evaluate, bodies: u32, cores: Cores) -> Result<Vec<Load>, Failure> {
    let modes = &arguments.modes;
    let plan = Plan {
        scene: arguments.scene.clone(),
        bodies,
        seed: arguments.seed,
        ticks: ticks(arguments, bodies)?,
        tolerance: arguments.tolerance,
        budget: arguments.budget,
        link: arguments.link,
        modes: modes.clone(),
        defects: arguments.defects(),
        publish_schedule: PublishSchedule {
            publish_interval: arguments.publish_interval,
            lookahead: Ticks::new(arguments.lookahead),
        },
        delay: Ticks::new(arguments.delay),
        cores,
    };
    let mut loads = Vec::new();
    if modes.iter().any(|mode| !mode.is_free()) {
        let bar = output::progress_bar(u64::from(plan.ticks), format!("{bodies} bodies"));
        loads.push(run_side_by_side(&plan, &mut |_| bar.inc(1))?);
        bar.finish_and_clear();
    }
    if modes.iter().any(|mode| mode.is_free()) {
        let bar = output::progress_bar(
            u64::from(plan.ticks),
            format!("{bodies} bodies, free running"),
        );
        loads.push(run_free(&plan, &mut |_| bar.inc(1))?);
        bar.finish_and_clear();
    }
    Ok(loads)
}

/// Fails if the truth differs between modes.
fn check_truth(experiment: &Experiment) -> Result<(), Failure> {
    for load in &experiment.loads {
        for run in &load.runs {
            if run.truth_checksum != load.truth.digest {
                let (bodies, mode) = (run.config.bodies, run.config.mode);
                return Err(format!(
                    "the runs with {bodies} bodies are void: the truth of {mode} differs from that of the other modes"
                )
                .into());
            }
        }
    }
    Ok(())
}
