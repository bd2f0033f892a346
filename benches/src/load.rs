//! `rhumb-bench load`: servers under load, as a service is judged.
//!
//! Plain, it runs many scenes and members over minutes. Its subcommands measure a frame by where the physics is, the
//! cost of a server's settings, and what an abused scene does to its neighbour.
//!
//! Each of the many scenes runs by the server's clock. Its owner places the bodies, and puts them back where they began
//! every few seconds, each scene at a moment of its own. Owners and observers are members, each in a thread. The figures of
//! the server are those that it states at its metrics address, and the processor time and memory that the system states
//! for its processes.

mod frames;
mod neighbour;
mod rig;
mod service;

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use clap::{Args, Subcommand};
use glam::{Quat, Vec3};
use rhumb_client::{Client, JoinMode, JoinOptions, Trust};
use rhumb_protocol::scene::{BodyKind, Command, SceneConfig, Stepping};
use rhumb_reckoning::{BodyId, BodyState, Tick};
use rhumb_sims::NAMES;
use rhumb_transport::Fingerprint;
use serde::{Deserialize, Serialize};

use crate::drive::{BesideListener, ServerProcess};
use crate::machine::{memory_bytes, worked_us};
use crate::numbers::{markdown, number};
use crate::output::{self, Failure, Provenance, ended, write};
use rig::{ServerArguments, script, take_ids};

pub use frames::Frames;
pub use neighbour::Neighbour;
pub use service::ServiceCosts;

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
    /// Measure a scene's frames while another scene of the server is abused.
    Neighbour(neighbour::NeighbourArguments),
}

/// Runs a measurement. Exit code 0 if everything was measured and written, 1 otherwise.
pub fn load(arguments: &LoadArguments) -> ExitCode {
    ended(match &arguments.other {
        None => run(&arguments.scenes),
        Some(OtherLoad::Frames(arguments)) => frames::run(arguments),
        Some(OtherLoad::Service(arguments)) => service::run(arguments),
        Some(OtherLoad::Neighbour(arguments)) => neighbour::run(arguments),
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

/// Time between two looks of a member at the clock.
const PAUSE: Duration = Duration::from_millis(50);

/// A scene of a server.
#[derive(Clone, Debug)]
struct Place {
    address: SocketAddr,
    fingerprint: Fingerprint,
    number: u32,
}

/// Contents of a scene.
struct Contents {
    script: String,
    bodies: u32,
    seed: u64,
    /// Time after which the bodies are put back where they began.
    reset: Duration,
}

impl Place {
    fn join(&self, mode: JoinMode) -> Result<Client, Failure> {
        let trust = Trust::Fingerprint(self.fingerprint);
        let options = JoinOptions {
            mode,
            ..JoinOptions::default()
        };
        let connection = Client::connect(&self.address.to_string(), trust)?;
        Ok(connection.join_with(&format!("load/{}", self.number), options)?)
    }
}

/// A member that follows its scene until the load ends.
struct Member(JoinHandle<MemberEnd>);

/// The end of a member.
#[derive(Debug)]
struct MemberEnd {
    /// Cause of its end, unless the load ended it.
    error: Option<String>,
    /// UDP payload received.
    received_bytes: u64,
    /// Time that it was a member, seconds.
    seconds: f64,
}

impl Member {
    /// Creates the scene and places its bodies; then puts them back again and again.
    fn own(place: &Place, contents: &Contents, stop: &Arc<AtomicBool>) -> Result<Self, Failure> {
        let mut script = script(&contents.script, contents.bodies, contents.seed)?;
        let config = SceneConfig {
            stepping: Stepping::FreeRunning,
            ..script.config()
        };
        let mut client = place.join(JoinMode::Create(config))?;
        let mut commands = Vec::new();
        script.commands(Tick::ZERO, &mut commands);
        let mut resets = Resets::new(&commands);
        take_ids(&mut client, &commands)?;
        for command in commands {
            client.command(command)?;
        }
        client.flush();
        let period = contents.reset;
        // The scenes' resets are spread over the period.
        let first = period * (place.number % 16 + 1) / 16;
        let mut due = Instant::now() + first;
        Ok(Self::follow(client, stop, move |client| {
            if Instant::now() < due {
                return Ok(());
            }
            due += period;
            resets.reset(client)
        }))
    }

    /// Follows a scene, and commands nothing.
    fn observe(place: &Place, stop: &Arc<AtomicBool>) -> Result<Self, Failure> {
        let client = place.join(JoinMode::Join)?;
        Ok(Self::follow(client, stop, |_| Ok(())))
    }

    fn follow(
        mut client: Client,
        stop: &Arc<AtomicBool>,
        mut work: impl FnMut(&mut Client) -> Result<(), Failure> + Send + 'static,
    ) -> Self {
        let stop = Arc::clone(stop);
        Self(thread::spawn(move || {
            let begun = Instant::now();
            let before = client.statistics().wire.received_bytes;
            let mut error = None;
            while error.is_none() && !stop.load(Ordering::Relaxed) {
                let turn = work(&mut client).and_then(|()| Ok(client.idle(PAUSE)?));
                error = turn.err().map(|error| error.to_string());
                while client.poll_event().is_some() {}
            }
            MemberEnd {
                error,
                received_bytes: client.statistics().wire.received_bytes - before,
                seconds: begun.elapsed().as_secs_f64(),
            }
        }))
    }

    /// Waits until the member has seen the end of the load.
    fn end(self) -> MemberEnd {
        self.0.join().unwrap_or_else(|_| MemberEnd {
            error: Some("its thread panicked".to_owned()),
            received_bytes: 0,
            seconds: 0.0,
        })
    }
}

/// The states in which the bodies of a scene began.
struct Resets(Vec<(BodyId, BodyState)>);

impl Resets {
    fn new(commands: &[Command]) -> Self {
        let movable = commands.iter().filter_map(|command| match command {
            Command::AddBody { desc, motion } if desc.kind == BodyKind::Dynamic => {
                Some((desc.id, *motion))
            }
            _ => None,
        });
        Self(movable.collect())
    }

    fn reset(&mut self, client: &mut Client) -> Result<(), Failure> {
        for &(id, motion) in &self.0 {
            let position = Vec3::from_array(motion.position());
            let rotation = Quat::from_array(motion.rotation());
            client.command(Command::SetPose {
                id,
                position,
                rotation,
            })?;
            let [.., lx, ly, lz, ax, ay, az] = motion.parts();
            let (linear, angular) = (Vec3::new(lx, ly, lz), Vec3::new(ax, ay, az));
            client.command(Command::SetVelocity {
                id,
                linear,
                angular,
            })?;
        }
        client.flush();
        Ok(())
    }
}

/// Time for an answer.
const LIMIT: Duration = Duration::from_secs(10);

/// The figures of a part of the time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoadRow {
    /// Its end, seconds since the last member joined.
    pub seconds: f64,
    /// Ticks of the scene that stepped least, as a share of those due by its step.
    pub least_ticks_share: f64,
    /// Steps that began more than a step late, as a share of all.
    pub late_share: f64,
    /// Mean step of the engine, microseconds.
    pub step_mean_us: f64,
    /// Bound below which 99 % of the steps lie, microseconds; `None` beyond the greatest bound that the server counts.
    pub step_p99_below_us: Option<f64>,
    /// Bodies awake at its end, in all scenes.
    pub awake: u64,
    /// Processor time of the server, cores.
    pub server_cores: Option<f64>,
    /// Memory of the server at its end, megabytes.
    pub server_mb: Option<f64>,
    /// Packets and control messages to all members, kilobytes a second.
    pub sent_kb_s: f64,
}

/// The metrics at one moment.
struct ServerMetrics {
    at: Instant,
    /// Each scene by its name.
    scenes: BTreeMap<String, SceneMetrics>,
    worked_us: Option<u64>,
    memory_bytes: Option<u64>,
}

/// The metrics of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
struct SceneMetrics {
    tick: f64,
    late: f64,
    awake: f64,
    sent_bytes: f64,
    step_period: f64,
    steps: f64,
    step_seconds: f64,
    /// Steps of at most this many microseconds.
    within: BTreeMap<u64, f64>,
}

impl ServerMetrics {
    /// Asks the server at its metrics address, and the system.
    fn read(metrics: SocketAddr, process: u32) -> Result<Self, Failure> {
        let mut stream = TcpStream::connect_timeout(&metrics, LIMIT)?;
        stream.set_read_timeout(Some(LIMIT))?;
        write!(
            stream,
            "GET /metrics HTTP/1.1\r\nHost: {metrics}\r\nConnection: close\r\n\r\n"
        )?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer)?;
        Ok(Self {
            at: Instant::now(),
            scenes: scenes(&answer),
            worked_us: worked_us(process),
            memory_bytes: memory_bytes(process),
        })
    }

    /// The row of the time since `before`; `begun` is the moment from which its end counts.
    fn since(&self, before: &Self, begun: Instant) -> LoadRow {
        let seconds = (self.at - before.at).as_secs_f64();
        let (mut least, mut steps, mut late, mut step_seconds, mut sent) =
            (f64::INFINITY, 0.0, 0.0, 0.0, 0.0);
        let mut within: BTreeMap<u64, f64> = BTreeMap::new();
        for (name, now) in &self.scenes {
            let earlier = before.scenes.get(name).cloned().unwrap_or_default();
            let due = seconds / now.step_period;
            least = least.min((now.tick - earlier.tick) / due);
            steps += now.steps - earlier.steps;
            late += now.late - earlier.late;
            step_seconds += now.step_seconds - earlier.step_seconds;
            sent += now.sent_bytes - earlier.sent_bytes;
            for (bound, count) in &now.within {
                let earlier = earlier.within.get(bound).copied().unwrap_or_default();
                *within.entry(*bound).or_default() += count - earlier;
            }
        }
        let p99 = within.iter().find(|(_, count)| **count >= steps * 0.99);
        let worked = self.worked_us.zip(before.worked_us);
        LoadRow {
            seconds: (self.at - begun).as_secs_f64(),
            least_ticks_share: least,
            late_share: late / steps.max(1.0),
            step_mean_us: step_seconds * 1e6 / steps.max(1.0),
            step_p99_below_us: p99.map(|(bound, _)| *bound as f64),
            awake: self.scenes.values().map(|scene| scene.awake as u64).sum(),
            server_cores: worked
                .map(|(now, before)| now.saturating_sub(before) as f64 * 1e-6 / seconds),
            server_mb: self.memory_bytes.map(|bytes| bytes as f64 * 1e-6),
            sent_kb_s: sent * 1e-3 / seconds,
        }
    }
}

/// The scenes in the text of an answer.
fn scenes(text: &str) -> BTreeMap<String, SceneMetrics> {
    let mut scenes: BTreeMap<String, SceneMetrics> = BTreeMap::new();
    for line in text.lines() {
        let Some((name, rest)) = line.split_once("{scene=\"") else {
            continue;
        };
        let Some((labels, value)) = rest.rsplit_once("} ") else {
            continue;
        };
        let (Some((scene, more)), Ok(value)) = (labels.split_once('"'), value.parse()) else {
            continue;
        };
        let metrics = scenes.entry(scene.to_owned()).or_default();
        match name {
            "rhumb_scene_tick" => metrics.tick = value,
            "rhumb_scene_late_total" => metrics.late = value,
            "rhumb_scene_bodies_awake" => metrics.awake = value,
            "rhumb_scene_sent_bytes_total" => metrics.sent_bytes = value,
            "rhumb_scene_step_period_seconds" => metrics.step_period = value,
            "rhumb_scene_step_seconds_count" => metrics.steps = value,
            "rhumb_scene_step_seconds_sum" => metrics.step_seconds = value,
            "rhumb_scene_step_seconds_bucket" => {
                let bound = more.trim_start_matches(",le=").trim_matches('"');
                // Steps beyond the greatest bound are those that none of the others has.
                if let Ok(seconds) = bound.parse::<f64>()
                    && seconds.is_finite()
                {
                    metrics.within.insert((seconds * 1e6).round() as u64, value);
                }
            }
            _ => {}
        }
    }
    scenes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_metrics_of_each_scene_are_found_in_an_answer() {
        let text = "HTTP/1.1 200 OK\r\n\r\n# TYPE rhumb_scene_tick gauge\n\
            rhumb_connections 3\n\
            rhumb_scene_tick{scene=\"load/1\"} 70\n\
            rhumb_scene_tick{scene=\"load/2\"} 80\n\
            rhumb_scene_step_period_seconds{scene=\"load/1\"} 0.02\n\
            rhumb_scene_step_seconds_bucket{scene=\"load/1\",le=\"0.0005\"} 60\n\
            rhumb_scene_step_seconds_bucket{scene=\"load/1\",le=\"+Inf\"} 70\n\
            rhumb_scene_step_seconds_count{scene=\"load/1\"} 70\n";
        let scenes = scenes(text);
        assert_eq!(scenes["load/2"].tick, 80.0);
        let expected = SceneMetrics {
            tick: 70.0,
            step_period: 0.02,
            steps: 70.0,
            within: BTreeMap::from([(500, 60.0)]),
            ..SceneMetrics::default()
        };
        assert_eq!(scenes["load/1"], expected);
    }

    #[test]
    fn a_row_holds_the_difference_of_two_moments() {
        let begun = Instant::now();
        let scene = |tick: f64, steps: f64| SceneMetrics {
            tick,
            steps,
            step_period: 0.02,
            step_seconds: steps * 0.001,
            within: BTreeMap::from([(500, steps / 2.0), (2_000, steps)]),
            ..SceneMetrics::default()
        };
        let moment = |seconds, scenes: [(f64, f64); 2], worked| ServerMetrics {
            at: begun + Duration::from_secs(seconds),
            scenes: (["a", "b"].into_iter().zip(scenes))
                .map(|(name, (tick, steps))| (name.to_owned(), scene(tick, steps)))
                .collect(),
            worked_us: Some(worked),
            memory_bytes: Some(7_000_000),
        };
        let before = moment(1, [(10.0, 10.0), (0.0, 0.0)], 500_000);
        let row = moment(3, [(110.0, 110.0), (50.0, 50.0)], 1_500_000).since(&before, begun);
        assert_eq!(row.seconds, 3.0);
        // 100 ticks are due in two seconds.
        assert_eq!(row.least_ticks_share, 0.5);
        assert!((row.step_mean_us - 1_000.0).abs() < 1e-6);
        assert_eq!(row.step_p99_below_us, Some(2_000.0));
        assert_eq!(row.server_cores, Some(0.5));
        assert_eq!(row.server_mb, Some(7.0));
    }
}
