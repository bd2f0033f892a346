//! `rhumb-bench load`: servers under load, as a service is judged.
//!
//! Plain, it runs many scenes and members over minutes. Its subcommands measure a frame by where the physics is, the
//! cost of a server's settings, what an abused scene does to its neighbour, a server with edges, and how fast a scene is
//! filled and joined.
//!
//! Each of the many scenes runs by the server's clock. Its owner places the bodies, and puts them back where they began
//! every few seconds, each scene at a moment of its own. Owners and observers are members, each in a thread. The figures of
//! the server are those that it states at its metrics address, and the processor time and memory that the system states
//! for its processes.

mod abuses;
mod attacker;
mod edges;
mod filling;
mod frames;
mod member;
mod neighbour;
mod rig;
mod service;
mod watchers;

use std::net::SocketAddr;
use std::num::NonZeroU32;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use clap::{Args, Subcommand};
use rhumb_sims::NAMES;
use serde::{Deserialize, Serialize};

use crate::drive::{BesideListener, ServerProcess};
use crate::numbers::{markdown, number};
use crate::output::{self, Failure, Provenance, ended, write};
use member::{Contents, Member, MemberEnd, Place};
use rig::{ServerArguments, ServerMetrics};

pub use edges::{EdgesLoad, Fault, Faults};
pub use filling::Filling;
pub use frames::Frames;
pub use member::Commanded;
pub use neighbour::Neighbour;
pub use rig::LoadRow;
pub use service::ServiceCosts;
pub use watchers::Judged;

/// Arguments: those of many scenes, or another measurement.
#[derive(Clone, Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct LoadArguments {
    #[command(subcommand)]
    other: Option<OtherLoad>,
    #[command(flatten)]
    scenes: ScenesArguments,
}

#[derive(Clone, Debug, Subcommand)]
enum OtherLoad {
    /// Measure a simulator's frame with its physics in process, in another process and behind a socket.
    Frames(frames::FramesArguments),
    /// Measure what tokens, durability and worker processes of a server cost.
    Service(service::ServiceArguments),
    /// Measure a scene's ticks while another client abuses the server.
    Neighbour(neighbour::NeighbourArguments),
    /// Measure what members cost a server that has edges, and how they come back when an edge is killed or frozen.
    Edges(edges::EdgesArguments),
    /// Measure how fast a scene is filled and joined, and a neighbour's frames meanwhile.
    Filling(filling::FillingArguments),
}

/// Runs a measurement. Exit code 0 if everything was measured and written, 1 otherwise.
pub fn load(arguments: &LoadArguments) -> ExitCode {
    ended(match &arguments.other {
        None => run(&arguments.scenes),
        Some(OtherLoad::Frames(arguments)) => frames::run(arguments),
        Some(OtherLoad::Service(arguments)) => service::run(arguments),
        Some(OtherLoad::Neighbour(arguments)) => neighbour::run(arguments),
        Some(OtherLoad::Edges(arguments)) => edges::run(arguments),
        Some(OtherLoad::Filling(arguments)) => filling::run(arguments),
    })
}

/// Arguments: server, scenes, members, duration, output.
#[derive(Clone, Debug, Args)]
struct ScenesArguments {
    #[command(flatten)]
    server: ServerArguments,
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
}

/// Content of `load.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Load {
    /// Source of the figures.
    #[serde(flatten)]
    pub provenance: Provenance,
    /// Members that lost their connection or were refused, of all of them.
    pub lost: u32,
    /// All members.
    pub members: u32,
    /// UDP payload to a member, kbit/s, on average.
    pub member_kbit_s: f64,
    /// The time since the row before, for each row of the table.
    pub rows: Vec<LoadRow>,
}

/// Runs the load to its end.
fn run(arguments: &ScenesArguments) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let measured = measure(arguments)?;
    let table = [("", measured.table())];
    write(&arguments.out, "load.json", &measured, &table)?;
    output::print_text(&format!(
        "{} of {} members lost; {:.1} kbit/s to a member\n",
        measured.lost, measured.members, measured.member_kbit_s
    ))?;
    Ok(())
}

fn measure(arguments: &ScenesArguments) -> Result<Load, Failure> {
    let open = ["--open", "--log", "warn", "--metrics", "127.0.0.1:0"];
    let server = arguments
        .server
        .start(&open, Some(BesideListener::Metrics))?;
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
        provenance: Provenance::here(),
        lost: u32::try_from(ends.iter().filter(|end| end.error.is_some()).count())?,
        members: u32::try_from(count)?,
        member_kbit_s: received as f64 * 8e-3 / seconds.max(f64::MIN_POSITIVE),
        rows,
    })
}

/// Joins all members: the owner of each scene, then its observers.
fn join_all(
    arguments: &ScenesArguments,
    server: &ServerProcess,
    stop: &Arc<AtomicBool>,
) -> Result<Vec<Member>, Failure> {
    let count = u64::from(arguments.scenes) * u64::from(arguments.observers + 1);
    let bar = output::progress_bar(count, "members".to_owned());
    let mut members = Vec::new();
    for scene in 0..arguments.scenes {
        let contents = Contents {
            script: arguments.scene.clone(),
            bodies: arguments.bodies,
            seed: arguments.seed + u64::from(scene),
            reset: Duration::from_secs(u64::from(arguments.reset)),
            publish_interval: NonZeroU32::MIN,
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

/// Reads the server's metrics at the end of each row's time.
fn watch(
    arguments: &ScenesArguments,
    server: &ServerProcess,
    metrics: SocketAddr,
) -> Result<Vec<LoadRow>, Failure> {
    let bar = output::progress_bar(u64::from(arguments.seconds), "seconds".to_owned());
    let begun = Instant::now();
    let mut before = ServerMetrics::read(metrics, server.id())?;
    let mut rows = Vec::new();
    for second in 1..=arguments.seconds {
        let due = Duration::from_secs(u64::from(second));
        thread::sleep(due.saturating_sub(begun.elapsed()));
        bar.inc(1);
        if second % arguments.row == 0 || second == arguments.seconds {
            let now = ServerMetrics::read(metrics, server.id())?;
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
                self.provenance.paragraph(),
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
