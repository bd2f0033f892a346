//! The server of a load and the routers of its edges, its script, its figures.
//!
//! Processor time and memory are those that the system states for its processes.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::Command as Program;
use std::time::{Duration, Instant};

use clap::Args;
use rhumb_client::Client;
use rhumb_protocol::scene::Command;
use rhumb_sims::{Script, by_name};
use serde::{Deserialize, Serialize};

use crate::drive::{BesideListener, OwnProcess, ServerProcess, Signal};
use crate::machine::{memory_bytes, worked_us};
use crate::numbers;
use crate::output::Failure;

/// The server that is measured.
#[derive(Clone, Debug, Args)]
pub(super) struct ServerArguments {
    /// The server's program [default: rhumb-server beside this program].
    #[arg(long, value_name = "FILE")]
    server: Option<PathBuf>,
    /// Cores that the server may use [default: all].
    #[arg(long, value_name = "CORES", value_delimiter = ',')]
    server_cores: Vec<usize>,
    /// Address space of each process of the server, MiB; one that needs more ends [default: no limit].
    #[arg(long, value_name = "MIB")]
    address_space: Option<u64>,
    /// Further flags of the server, after `--`.
    #[arg(last = true)]
    flags: Vec<String>,
}

impl ServerArguments {
    fn path(&self) -> Result<PathBuf, Failure> {
        Ok(match &self.server {
            Some(program) => program.clone(),
            None => std::env::current_exe()?.with_file_name("rhumb-server"),
        })
    }

    /// A command of the server's program, without arguments.
    pub(super) fn program(&self) -> Result<Program, Failure> {
        Ok(Program::new(self.path()?))
    }

    /// Starts the server on a free port of loopback, and waits until it listens.
    pub(super) fn start(
        &self,
        more: &[&str],
        awaited: Option<BesideListener>,
    ) -> Result<ServerProcess, Failure> {
        let mut command = self.program()?;
        if let Some(mib) = self.address_space {
            // The shell becomes the server, which has its number and its limit.
            command = Program::new("sh");
            let limited = format!("ulimit -v {} && exec \"$0\" \"$@\"", mib * 1_024);
            command.args(["-c", &limited]).arg(self.path()?);
        }
        command.args(["--listen", "127.0.0.1:0"]).args(more);
        command.args(&self.flags);
        let cores = &self.server_cores;
        Ok(ServerProcess::run_on(cores, &mut command, awaited)?)
    }
}

/// Two routers of zenoh, and the hub that publishes by them: processes of the program of `edge/zenoh`. The hub is at the
/// first router, the edges are at the second, and each of them knows the other router too.
pub(super) struct Routers {
    program: PathBuf,
    endpoints: [String; 2],
    routers: [OwnProcess; 2],
    hub: ServerProcess,
}

impl Routers {
    /// Starts the routers, and the hub as a member of a server.
    pub(super) fn start(program: &Path, owner: &ServerProcess) -> Result<Self, Failure> {
        let endpoints = [free_endpoint()?, free_endpoint()?];
        let first = start_router(program, &endpoints, 0)?;
        let second = start_router(program, &endpoints, 1)?;
        let mut hub = edge_of(program, "hub", owner);
        hub.args(["--listen", "127.0.0.1:0"]);
        let [at_first, at_second] = &endpoints;
        hub.args(["--router", at_first, "--router", at_second]);
        Ok(Self {
            program: program.to_owned(),
            routers: [first, second],
            hub: ServerProcess::run(&mut hub, None)?,
            endpoints,
        })
    }

    /// A command that starts an edge of the hub.
    pub(super) fn edge(&self) -> Program {
        let mut edge = edge_of(&self.program, "edge", &self.hub);
        let [first, second] = &self.endpoints;
        edge.args(["--router", second, "--router", first]);
        edge
    }

    /// Sends a router a signal.
    pub(super) fn send(&self, router: usize, signal: Signal) -> Result<(), Failure> {
        Ok(self.routers[router].send(signal)?)
    }

    /// Starts a router again that has ended.
    pub(super) fn start_again(&mut self, router: usize) -> Result<(), Failure> {
        self.routers[router] = start_router(&self.program, &self.endpoints, router)?;
        Ok(())
    }

    /// The processes of the routers, and that of the hub.
    pub(super) fn ids(&self) -> impl Iterator<Item = u32> {
        let routers = self.routers.iter().map(OwnProcess::id);
        routers.chain([self.hub.id()])
    }
}

/// A command of the program for a task of an edge.
fn edge_of(program: &Path, task: &str, owner: &ServerProcess) -> Program {
    let mut edge = Program::new(program);
    edge.args([task, "--owner", &owner.address.to_string()]);
    edge.args(["--fingerprint", &owner.fingerprint.to_string()]);
    edge
}

fn start_router(
    program: &Path,
    endpoints: &[String; 2],
    number: usize,
) -> Result<OwnProcess, Failure> {
    let mut router = Program::new(program);
    router.args(["router", "--listen", &endpoints[number]]);
    if number > 0 {
        router.args(["--connect", &endpoints[0]]);
    }
    let forwards = |line: &str| line.starts_with("forwarding").then_some(());
    let (process, ()) = OwnProcess::run(&mut router, forwards)?;
    Ok(process)
}

/// An endpoint of UDP that is free now.
fn free_endpoint() -> Result<String, Failure> {
    let socket = UdpSocket::bind("127.0.0.1:0")?;
    Ok(format!("udp/{}", socket.local_addr()?))
}

/// A key of tokens in a folder.
pub(super) struct TokenKey(PathBuf);

impl TokenKey {
    /// Makes a new key.
    pub(super) fn make(server: &ServerArguments, folder: &Path) -> Result<Self, Failure> {
        let key = folder.join("key");
        output_of(server.program()?.args(["token", "--new-key"]).arg(&key))?;
        Ok(Self(key))
    }

    /// The file that a server checks tokens by.
    pub(super) fn public(&self) -> PathBuf {
        self.0.with_extension("pub")
    }

    /// A token of a client for the scenes of a pattern.
    pub(super) fn token(
        &self,
        server: &ServerArguments,
        (client, role): (&str, &str),
        scenes: &str,
    ) -> Result<String, Failure> {
        let mut program = server.program()?;
        program.arg("token").arg("--key").arg(&self.0);
        program.args(["--client", client, "--scene", scenes, "--role", role]);
        output_of(&mut program)
    }
}

/// Runs a program to its end; returns its output.
fn output_of(program: &mut Program) -> Result<String, Failure> {
    let output = program.output()?;
    if output.status.success() {
        return Ok(String::from_utf8(output.stdout)?);
    }
    let cause = String::from_utf8_lossy(&output.stderr);
    Err(format!("{program:?} failed: {cause}").into())
}

/// Makes an empty folder for a server: what an earlier run left in it would be restored.
pub(super) fn empty_folder(folder: &Path) -> io::Result<()> {
    if folder.exists() {
        fs::remove_dir_all(folder)?;
    }
    fs::create_dir_all(folder)
}

/// Bytes of a file, or of all files below a folder; what the server has removed meanwhile has none.
pub(super) fn bytes_in(path: &Path) -> io::Result<u64> {
    match bytes_found(path) {
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => Ok(0),
        found => found,
    }
}

fn bytes_found(path: &Path) -> io::Result<u64> {
    let metadata = fs::symlink_metadata(path)?;
    if !metadata.is_dir() {
        return Ok(metadata.len());
    }
    let mut bytes = 0;
    for entry in fs::read_dir(path)? {
        bytes += bytes_in(&entry?.path())?;
    }
    Ok(bytes)
}

/// The script of this name.
pub(super) fn script(name: &str, bodies: u32, seed: u64) -> Result<Box<dyn Script>, Failure> {
    Ok(by_name(name, bodies, seed).ok_or_else(|| format!("no scene has the name {name}"))?)
}

/// Takes the ids that these commands of a script give to their bodies.
pub(super) fn take_ids(client: &mut Client, commands: &[Command]) -> Result<(), Failure> {
    let bodies = |command: &&Command| matches!(command, Command::AddBody { .. });
    let count = commands.iter().filter(bodies).count();
    if count > 0 {
        client.new_ids(u32::try_from(count)?)?;
    }
    Ok(())
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

impl FrameTimes {
    pub(super) fn of(frames: &[Duration]) -> Self {
        let nanoseconds = |frame: &Duration| u64::try_from(frame.as_nanos()).unwrap_or(u64::MAX);
        let mut frames: Vec<u64> = frames.iter().map(nanoseconds).collect();
        let mut percentile = |percent| {
            let ns = numbers::of_nanoseconds(&mut frames, percent);
            ns.map_or(0.0, |ns| ns as f64 * 1e-3)
        };
        Self {
            p50_us: percentile(50),
            p99_us: percentile(99),
            max_us: percentile(100),
        }
    }
}

/// Time for an answer.
pub(super) const LIMIT: Duration = Duration::from_secs(10);

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
pub(super) struct ServerMetrics {
    at: Instant,
    /// Each scene by its name.
    scenes: BTreeMap<String, SceneMetrics>,
    pub(super) worked_us: Option<u64>,
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
    pub(super) fn read(metrics: SocketAddr, process: u32) -> Result<Self, Failure> {
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

    /// The newest tick of all scenes.
    pub(super) fn newest_tick(&self) -> f64 {
        let ticks = self.scenes.values().map(|scene| scene.tick);
        ticks.fold(0.0, f64::max)
    }

    /// Bytes that all scenes have sent.
    pub(super) fn sent_bytes(&self) -> f64 {
        self.scenes.values().map(|scene| scene.sent_bytes).sum()
    }

    /// The row of the time since `before`; `begun` is the moment from which its end counts.
    pub(super) fn since(&self, before: &Self, begun: Instant) -> LoadRow {
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
