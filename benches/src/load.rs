//! `rhumb-bench load`: a server with many scenes and members, over minutes.
//!
//! Every scene runs by the server's clock. Its owner places the bodies, and puts them back where they began every so
//! many seconds, each scene at a moment of its own. The figures of the server are those that it states at its metrics
//! address, and the processor time and memory that the system states for its processes.

mod member;
mod server_figures;

use std::path::PathBuf;
use std::process::{Command as Program, ExitCode};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use rhumb_sims::NAMES;
use serde::{Deserialize, Serialize};

use self::member::{Contents, Error, Member, MemberEnd, Place};
pub use self::server_figures::LoadRow;
use self::server_figures::ServerFigures;
use crate::drive::{BesideListener, ServerProcess};
use crate::machine;
use crate::output;
use crate::replay::{Failure, ended};
use crate::summary::{aligned, markdown, number};

/// Arguments: server, scenes, members, duration, output.
#[derive(Clone, Debug, Args)]
pub struct LoadArguments {
    /// The server's program [default: rhumb-server beside this program].
    #[arg(long, value_name = "FILE")]
    server: Option<PathBuf>,
    /// Cores that the server may use [default: all].
    #[arg(long, value_name = "CORES", value_delimiter = ',')]
    server_cores: Vec<usize>,
    /// Number of scenes.
    #[arg(long, default_value = "64", value_parser = clap::value_parser!(u32).range(1..=1_000))]
    scenes: u32,
    /// Contents of each scene.
    #[arg(long, default_value = "ball-pit", value_parser = clap::builder::PossibleValuesParser::new(NAMES))]
    scene: String,
    /// Bodies of each scene.
    #[arg(long, default_value = "150")]
    bodies: u32,
    /// Members of each scene beside its owner, which only observe it.
    #[arg(long, default_value = "0", value_parser = clap::value_parser!(u32).range(..=10_000))]
    observers: u32,
    /// Duration, seconds.
    #[arg(long, default_value = "600", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    seconds: u32,
    /// Seconds after which the bodies are put back where they began.
    #[arg(long, default_value = "20", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    reset: u32,
    /// Seconds between two rows of the table.
    #[arg(long, default_value = "60", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    row: u32,
    /// Seed of the scenes.
    #[arg(long, default_value = "1")]
    seed: u64,
    /// Folder for load.json; created if missing.
    #[arg(long, default_value = "results/load")]
    out: PathBuf,
    /// Further flags of the server, after `--`.
    #[arg(last = true)]
    flags: Vec<String>,
}

/// Content of `load.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Load {
    /// The command line, as typed.
    pub command: String,
    /// Processor, cores, operating system.
    pub machine: String,
    /// Commit and optimisation of the build.
    pub build: String,
    /// Members that lost their connection or were refused, of all of them.
    pub lost: u32,
    /// All members.
    pub members: u32,
    /// UDP payload to a member, kbit/s, on average.
    pub member_kbit_s: f64,
    /// The time since the row before, for each row of the table.
    pub rows: Vec<LoadRow>,
}

/// Runs the load. Exit code 0 if it ran to its end and was written, 1 otherwise.
pub fn load(arguments: &LoadArguments) -> ExitCode {
    ended(run(arguments))
}

fn run(arguments: &LoadArguments) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let measured = measure(arguments).map_err(|error| Failure::Terms(error.to_string()))?;
    output::write_json(&arguments.out.join("load.json"), &measured)?;
    output::print_text(&aligned(&measured.table()))?;
    output::print_text(&format!(
        "\n{} of {} members lost; {:.1} kbit/s to a member\nwritten to {}\n",
        measured.lost,
        measured.members,
        measured.member_kbit_s,
        arguments.out.display()
    ))?;
    Ok(())
}

fn start(arguments: &LoadArguments) -> Result<ServerProcess, Error> {
    let program = match &arguments.server {
        Some(program) => program.clone(),
        None => std::env::current_exe()?.with_file_name("rhumb-server"),
    };
    let mut command = Program::new(program);
    command.args(["--open", "--listen", "127.0.0.1:0", "--log", "warn"]);
    command.args(["--metrics", "127.0.0.1:0"]);
    command.args(&arguments.flags);
    let metrics = Some(BesideListener::Metrics);
    Ok(ServerProcess::run_on(
        &arguments.server_cores,
        &mut command,
        metrics,
    )?)
}

fn measure(arguments: &LoadArguments) -> Result<Load, Error> {
    let server = start(arguments)?;
    let metrics = server.beside.ok_or("the server names no metrics address")?;
    let stop = Arc::new(AtomicBool::new(false));
    let members = join_all(arguments, &server, &stop);
    let rows = members.as_ref().map(|_| watch(arguments, &server, metrics));
    stop.store(true, Ordering::Relaxed);
    let rows = rows.map_err(ToString::to_string)??;
    let members = members?;
    let count = members.len();
    let ends: Vec<MemberEnd> = members.into_iter().map(Member::end).collect();
    for error in ends.iter().filter_map(|end| end.error.as_ref()).take(3) {
        output::print_text(&format!("a member was lost: {error}\n"))?;
    }
    let received: u64 = ends.iter().map(|end| end.received_bytes).sum();
    let seconds: f64 = ends.iter().map(|end| end.seconds).sum();
    Ok(Load {
        command: output::command_line(),
        machine: machine::describe(),
        build: machine::build(),
        lost: u32::try_from(ends.iter().filter(|end| end.error.is_some()).count())?,
        members: u32::try_from(count)?,
        member_kbit_s: received as f64 * 8e-3 / seconds.max(f64::MIN_POSITIVE),
        rows,
    })
}

/// Joins all members: the owner of each scene, then its observers.
fn join_all(
    arguments: &LoadArguments,
    server: &ServerProcess,
    stop: &Arc<AtomicBool>,
) -> Result<Vec<Member>, Error> {
    let count = u64::from(arguments.scenes) * u64::from(arguments.observers + 1);
    let bar = output::progress_bar(count, "members".to_owned());
    let mut members = Vec::new();
    for scene in 0..arguments.scenes {
        let contents = Contents {
            script: arguments.scene.clone(),
            bodies: arguments.bodies,
            seed: arguments.seed + u64::from(scene),
            reset: Duration::from_secs(u64::from(arguments.reset)),
        };
        let place = Place {
            address: server.address,
            fingerprint: server.fingerprint,
            number: scene,
        };
        members.push(Member::own(&place, &contents, stop)?);
        bar.inc(1);
        for _ in 0..arguments.observers {
            members.push(Member::observe(&place, stop)?);
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    Ok(members)
}

/// Reads the server's figures at the end of each row's time.
fn watch(
    arguments: &LoadArguments,
    server: &ServerProcess,
    metrics: std::net::SocketAddr,
) -> Result<Vec<LoadRow>, Error> {
    let bar = output::progress_bar(u64::from(arguments.seconds), "seconds".to_owned());
    let begun = Instant::now();
    let mut before = ServerFigures::read(metrics, server.id())?;
    let mut rows = Vec::new();
    for second in 1..=arguments.seconds {
        let due = Duration::from_secs(u64::from(second));
        thread::sleep(due.saturating_sub(begun.elapsed()));
        bar.inc(1);
        if second % arguments.row == 0 || second == arguments.seconds {
            let now = ServerFigures::read(metrics, server.id())?;
            rows.push(now.since(&before, begun));
            before = now;
        }
    }
    bar.finish_and_clear();
    Ok(rows)
}

impl Load {
    /// Text of a block of the documents; `None` if the block does not exist.
    #[must_use]
    pub fn block(&self, what: &str) -> Option<String> {
        match what {
            "command" => Some(format!(
                "{}\n\n{} of {} members were lost. A member received {:.1} kbit/s.",
                machine::provenance(&self.command, &self.machine, &self.build),
                self.lost,
                self.members,
                self.member_kbit_s
            )),
            "table" => Some(markdown(&self.table())),
            _ => None,
        }
    }

    /// Rows of the table.
    pub fn table(&self) -> Vec<Vec<String>> {
        let titles = [
            "seconds",
            "least ticks %",
            "late %",
            "step us",
            "p99 <= us",
            "awake",
            "cores",
            "MB",
            "kB/s",
        ];
        let mut table = vec![titles.map(str::to_owned).to_vec()];
        for row in &self.rows {
            table.push(vec![
                format!("{:.0}", row.seconds),
                number(Some(row.least_ticks_share * 100.0)),
                number(Some(row.late_share * 100.0)),
                number(Some(row.step_mean_us)),
                number(row.step_p99_below_us),
                row.awake.to_string(),
                number(row.server_cores),
                number(row.server_mb),
                number(Some(row.sent_kb_s)),
            ]);
        }
        table
    }
}
