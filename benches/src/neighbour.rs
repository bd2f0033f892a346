//! `rhumb-bench neighbour`: a scene's frames while another one is abused.
//!
//! A lockstep client steps one script again and again: alone, and beside each abuse. Both take turns, so that a change of
//! the machine's speed meets both. A frame sends the commands and waits for the tick.

mod abuse;

use std::path::PathBuf;
use std::process::{Command as Program, ExitCode};
use std::time::{Duration, Instant};

use clap::Args;
use rhumb_client::{Client, JoinMode, JoinOptions, PipelineDepth, Trust};
use rhumb_protocol::scene::Command;
use rhumb_reckoning::Tick;
use rhumb_sims::{NAMES, by_name};
use serde::{Deserialize, Serialize};

use self::abuse::{Abuse, Error, RunningAbuse};
use crate::drive::ServerProcess;
use crate::machine;
use crate::output;
use crate::quantile;
use crate::replay::{Failure, ended};
use crate::summary::{aligned, markdown, number};

/// Arguments: server, scene, repetitions, output.
#[derive(Clone, Debug, Args)]
pub struct NeighbourArguments {
    /// The server's program [default: rhumb-server beside this program].
    #[arg(long, value_name = "FILE")]
    server: Option<PathBuf>,
    /// Cores that the server may use [default: all].
    #[arg(long, value_name = "CORES", value_delimiter = ',')]
    server_cores: Vec<usize>,
    /// The scene that is measured.
    #[arg(long, default_value = "ball-pit", value_parser = clap::builder::PossibleValuesParser::new(NAMES))]
    scene: String,
    /// Its number of bodies.
    #[arg(long, default_value = "150")]
    bodies: u32,
    /// Ticks of each run.
    #[arg(long, default_value = "600", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    ticks: u32,
    /// Runs alone, and as many beside each abuse.
    #[arg(long, default_value = "5", value_parser = clap::value_parser!(u32).range(1..=1_000))]
    runs: u32,
    /// Seed of the scene.
    #[arg(long, default_value = "1")]
    seed: u64,
    /// Folder for neighbour.json; created if missing.
    #[arg(long, default_value = "results/neighbour")]
    out: PathBuf,
    /// Further flags of the server, after `--`.
    #[arg(last = true)]
    flags: Vec<String>,
}

/// Content of `neighbour.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Neighbour {
    /// The command line, as typed.
    pub command: String,
    /// Processor, cores, operating system.
    pub machine: String,
    /// Commit and optimisation of the build.
    pub build: String,
    /// Each abuse.
    pub abuses: Vec<AbuseFrames>,
}

/// The frames alone and beside one abuse.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AbuseFrames {
    /// The abuse, in words.
    pub abuse: String,
    /// Number of things that its members did during the runs.
    pub done: u64,
    /// Frames alone.
    pub alone: FrameTimes,
    /// Frames beside it.
    pub beside: FrameTimes,
}

/// Times of frames, microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameTimes {
    /// The median.
    pub p50_us: f64,
    /// The 99th percentile.
    pub p99_us: f64,
    /// The greatest.
    pub max_us: f64,
}

/// Runs the measurement. Exit code 0 if everything was measured and written, 1 otherwise.
pub fn neighbour(arguments: &NeighbourArguments) -> ExitCode {
    ended(run(arguments))
}

fn run(arguments: &NeighbourArguments) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let abuses = measure(arguments).map_err(|error| Failure::Terms(error.to_string()))?;
    let measured = Neighbour {
        command: output::command_line(),
        machine: machine::describe(),
        build: machine::build(),
        abuses,
    };
    output::write_json(&arguments.out.join("neighbour.json"), &measured)?;
    output::print_text(&aligned(&measured.table()))?;
    output::print_text(&format!("\nwritten to {}\n", arguments.out.display()))?;
    Ok(())
}

fn measure(arguments: &NeighbourArguments) -> Result<Vec<AbuseFrames>, Error> {
    let program = match &arguments.server {
        Some(program) => program.clone(),
        None => std::env::current_exe()?.with_file_name("rhumb-server"),
    };
    let mut command = Program::new(program);
    command.args(["--open", "--listen", "127.0.0.1:0", "--log", "error"]);
    command.args(&arguments.flags);
    let server = ServerProcess::run_on(&arguments.server_cores, &mut command, None)?;
    let runs = u64::from(arguments.runs) * 2 * Abuse::ALL.len() as u64;
    let bar = output::progress_bar(runs, "neighbour".to_owned());
    let mut measured = Vec::new();
    for abuse in Abuse::ALL {
        let (mut alone, mut beside, mut done) = (Vec::new(), Vec::new(), 0);
        for _ in 0..arguments.runs {
            step(arguments, &server, &mut alone)?;
            bar.inc(1);
            let running = RunningAbuse::start(abuse, &server)?;
            let stepped = step(arguments, &server, &mut beside);
            done += running.end()?;
            stepped?;
            bar.inc(1);
        }
        measured.push(AbuseFrames {
            abuse: abuse.text().to_owned(),
            done,
            alone: FrameTimes::of(&mut alone),
            beside: FrameTimes::of(&mut beside),
        });
    }
    bar.finish_and_clear();
    Ok(measured)
}

/// Steps the script once in a scene of its own, and adds the time of each frame behind the first.
fn step(
    arguments: &NeighbourArguments,
    server: &ServerProcess,
    took: &mut Vec<u64>,
) -> Result<(), Error> {
    let script = by_name(&arguments.scene, arguments.bodies, arguments.seed);
    let mut script = script.ok_or("no scene has this name")?;
    let options = JoinOptions {
        mode: JoinMode::Create(script.config()),
        ..JoinOptions::default()
    };
    let trust = Trust::Fingerprint(server.fingerprint);
    let connection = Client::connect(&server.address.to_string(), trust)?;
    let mut client = connection.join_with("measured/scene", options)?;
    for tick in 0..u64::from(arguments.ticks) {
        let mut commands = Vec::new();
        script.commands(Tick::new(tick), &mut commands);
        let bodies = |command: &&Command| matches!(command, Command::AddBody { .. });
        let count = u32::try_from(commands.iter().filter(bodies).count())?;
        if count > 0 {
            client.new_ids(count)?;
        }
        let begun = Instant::now();
        for command in commands {
            client.command(command)?;
        }
        client.advance(PipelineDepth::LOCKSTEP)?;
        if tick > 0 {
            took.push(nanoseconds(begun.elapsed()));
        }
        while client.poll_event().is_some() {}
    }
    Ok(client.delete()?)
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

impl FrameTimes {
    fn of(took: &mut [u64]) -> Self {
        let mut percentile = |percent| {
            let ns = quantile::of_nanoseconds(took, percent);
            ns.map_or(0.0, |ns| ns as f64 * 1e-3)
        };
        Self {
            p50_us: percentile(50),
            p99_us: percentile(99),
            max_us: percentile(100),
        }
    }
}

impl Neighbour {
    /// Text of a block of the documents; `None` if the block does not exist.
    #[must_use]
    pub fn block(&self, what: &str) -> Option<String> {
        match what {
            "command" => Some(machine::provenance(
                &self.command,
                &self.machine,
                &self.build,
            )),
            "table" => Some(markdown(&self.table())),
            _ => None,
        }
    }

    /// Rows of the table.
    pub fn table(&self) -> Vec<Vec<String>> {
        let titles = [
            "abuse", "done", "p50 us", "beside", "p99 us", "beside", "ratio", "max us", "beside",
        ];
        let mut table = vec![titles.map(str::to_owned).to_vec()];
        for row in &self.abuses {
            let ratio = row.beside.p99_us / row.alone.p99_us;
            let mut cells = vec![row.abuse.clone(), row.done.to_string()];
            let figures = [
                row.alone.p50_us,
                row.beside.p50_us,
                row.alone.p99_us,
                row.beside.p99_us,
                ratio,
                row.alone.max_us,
                row.beside.max_us,
            ];
            cells.extend(figures.map(|figure| number(Some(figure))));
            table.push(cells);
        }
        table
    }
}
