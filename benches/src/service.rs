//! `rhumb-bench service`: what tokens, durability and worker processes cost.
//!
//! Servers that differ in one setting step one script each. At each tick each of them has its frame in turn, so that a
//! change of the machine's speed meets all of them. The processor time is that of the server's processes together.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command as Program, ExitCode};
use std::time::{Duration, Instant};

use clap::Args;
use rhumb_client::{
    Client, JoinMode, JoinOptions, PipelineDepth, StreamChoice, Tolerance, Trust, WireStatistics,
};
use rhumb_protocol::scene::Command;
use rhumb_reckoning::Tick;
use rhumb_sims::{NAMES, by_name};
use serde::{Deserialize, Serialize};

use crate::drive::ServerProcess;
use crate::machine;
use crate::output;
use crate::processor::worked_us;
use crate::quantile;
use crate::replay::{Failure, ended};
use crate::summary::{aligned, markdown, number};

/// Arguments: server, scene, bodies, ticks, output.
#[derive(Clone, Debug, Args)]
pub struct ServiceArguments {
    /// The server's program [default: rhumb-server beside this program].
    #[arg(long, value_name = "FILE")]
    server: Option<PathBuf>,
    /// The scene.
    #[arg(long, default_value = "ball-pit", value_parser = clap::builder::PossibleValuesParser::new(NAMES))]
    scene: String,
    /// Number of bodies.
    #[arg(long, default_value = "500")]
    bodies: u32,
    /// Ticks of the scene.
    #[arg(long, default_value = "1800", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    ticks: u32,
    /// Seed of the scene.
    #[arg(long, default_value = "1")]
    seed: u64,
    /// Folder for service.json; created if missing.
    #[arg(long, default_value = "results/service")]
    out: PathBuf,
}

/// Content of `service.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ServiceCosts {
    /// The command line, as typed.
    pub command: String,
    /// Processor, cores, operating system.
    pub machine: String,
    /// Commit and optimisation of the build.
    pub build: String,
    /// Bodies of the script.
    pub bodies: u32,
    /// Each server, the plain one first.
    pub servers: Vec<ServerCosts>,
}

/// The costs of one server.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ServerCosts {
    /// Its settings.
    pub settings: String,
    /// UDP payload in both directions until the bodies are placed, bytes.
    pub join_bytes: u64,
    /// UDP payload to the client, bytes a tick.
    pub down_bytes: f64,
    /// UDP payload from the client, bytes a tick.
    pub up_bytes: f64,
    /// Median frame of the client, microseconds.
    pub frame_us: f64,
    /// Its 99th percentile.
    pub frame_p99_us: f64,
    /// Processor time of the server's processes, microseconds a tick; `None` where the system does not say.
    pub server_us: Option<f64>,
    /// Bytes in the data directory, a tick.
    pub disk_bytes: Option<f64>,
    /// True if the scene ended in the state of the first server's, to the bit.
    pub same_truth: bool,
}

/// Runs the measurements. Exit code 0 if everything was measured and written, 1 otherwise.
pub fn service(arguments: &ServiceArguments) -> ExitCode {
    ended(measure_all(arguments))
}

fn measure_all(arguments: &ServiceArguments) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let bar = output::progress_bar(u64::from(arguments.ticks), "service".to_owned());
    let measured = measure(arguments, &mut || bar.inc(1));
    let servers = measured.map_err(|error| Failure::Terms(error.to_string()))?;
    bar.finish_and_clear();
    let costs = ServiceCosts {
        command: output::command_line(),
        machine: machine::describe(),
        build: machine::build(),
        bodies: arguments.bodies,
        servers,
    };
    output::write_json(&arguments.out.join("service.json"), &costs)?;
    output::print_text(&aligned(&costs.rows()))?;
    output::print_text(&format!("\nwritten to {}\n", arguments.out.display()))?;
    Ok(())
}

type Error = Box<dyn std::error::Error>;

/// Name of the scene at each server: its tenant, and a name.
const SCENE: &str = "bench/service";

/// Settings of a server.
#[derive(Clone, Copy)]
struct Kind {
    name: &'static str,
    tokens: bool,
    durable: bool,
    processes: bool,
}

const KINDS: [Kind; 5] = {
    let plain = Kind {
        name: "open",
        tokens: false,
        durable: false,
        processes: false,
    };
    [
        plain,
        Kind {
            name: "tokens",
            tokens: true,
            ..plain
        },
        Kind {
            name: "durable",
            durable: true,
            ..plain
        },
        Kind {
            name: "worker processes",
            processes: true,
            ..plain
        },
        Kind {
            name: "all three",
            tokens: true,
            durable: true,
            processes: true,
        },
    ]
};

/// A server, its client, and what they took.
struct Measured {
    kind: Kind,
    process: ServerProcess,
    client: Client,
    folder: PathBuf,
    took: Vec<Duration>,
    joined: WireStatistics,
    worked_before: Option<u64>,
}

fn measure(
    arguments: &ServiceArguments,
    progress: &mut dyn FnMut(),
) -> Result<Vec<ServerCosts>, Error> {
    let script = by_name(&arguments.scene, arguments.bodies, arguments.seed);
    let mut script = script.ok_or("no scene has this name")?;
    let program = match &arguments.server {
        Some(program) => program.clone(),
        None => std::env::current_exe()?.with_file_name("rhumb-server"),
    };
    let options = JoinOptions {
        mode: JoinMode::Create(script.config()),
        stream: StreamChoice::Within(Tolerance::NORMAL),
        ..JoinOptions::default()
    };
    let mut servers = Vec::new();
    for (place, kind) in KINDS.into_iter().enumerate() {
        let folder = arguments.out.join(format!("server-{place}"));
        servers.push(Measured::start(&program, kind, folder, options)?);
    }
    for tick in 0..u64::from(arguments.ticks) {
        let mut commands = Vec::new();
        script.commands(Tick::new(tick), &mut commands);
        for server in &mut servers {
            server.frame(&commands, tick == 0)?;
        }
        progress();
    }
    let truth = servers[0].client.inspect()?.truth;
    let ticks = arguments.ticks;
    let ended = servers.into_iter().map(|server| server.end(ticks, truth));
    ended.collect()
}

impl Measured {
    fn start(
        program: &Path,
        kind: Kind,
        folder: PathBuf,
        options: JoinOptions,
    ) -> Result<Self, Error> {
        // An earlier run's state would be restored.
        if folder.exists() {
            fs::remove_dir_all(&folder)?;
        }
        fs::create_dir_all(&folder)?;
        let mut command = Program::new(program);
        command.args(["--listen", "127.0.0.1:0", "--log", "warn"]);
        let key = folder.join("key");
        if kind.tokens {
            run(Program::new(program).args(["token", "--new-key"]).arg(&key))?;
            command.arg("--token-key").arg(folder.join("key.pub"));
        } else {
            command.arg("--open");
        }
        if kind.durable {
            command.arg("--data").arg(folder.join("data"));
        }
        if kind.processes {
            command.args(["--workers", "processes"]);
        }
        let process = ServerProcess::run(&mut command, None)?;
        let trust = Trust::Fingerprint(process.fingerprint);
        let mut connection = Client::connect(&process.address.to_string(), trust)?;
        if kind.tokens {
            let mut token = Program::new(program);
            token.arg("token").arg("--key").arg(&key);
            token.args(["--client", "bench", "--scene", SCENE, "--role", "owner"]);
            connection = connection.token(&run(&mut token)?);
        }
        Ok(Self {
            kind,
            client: connection.join_with(SCENE, options)?,
            process,
            folder,
            took: Vec::new(),
            joined: WireStatistics::default(),
            worked_before: None,
        })
    }

    fn frame(&mut self, commands: &[Command], is_first: bool) -> Result<(), Error> {
        if is_first {
            let bodies = |command: &&Command| matches!(command, Command::AddBody { .. });
            let count = commands.iter().filter(bodies).count();
            self.client.new_ids(u32::try_from(count)?)?;
        }
        let begun = Instant::now();
        for command in commands {
            self.client.command(command.clone())?;
        }
        self.client.advance(PipelineDepth::LOCKSTEP)?;
        if is_first {
            self.joined = self.client.statistics().wire;
            self.worked_before = worked_us(self.process.id());
        } else {
            self.took.push(begun.elapsed());
        }
        while self.client.poll_event().is_some() {}
        Ok(())
    }

    fn end(mut self, ticks: u32, truth: u64) -> Result<ServerCosts, Error> {
        let ticks = f64::from(ticks.max(2) - 1);
        let wire = self.client.statistics().wire;
        let worked = worked_us(self.process.id()).zip(self.worked_before);
        let same_truth = self.client.inspect()?.truth == truth;
        let disk = self
            .kind
            .durable
            .then(|| bytes_in(&self.folder.join("data")));
        let each = |now: u64, before: u64| now.saturating_sub(before) as f64 / ticks;
        let mut took: Vec<u64> = (self.took.iter())
            .map(|took| u64::try_from(took.as_nanos()).unwrap_or(u64::MAX))
            .collect();
        let mut percentile = |percent| {
            let ns = quantile::of_nanoseconds(&mut took, percent);
            ns.map_or(0.0, |ns| ns as f64 / 1e3)
        };
        let costs = ServerCosts {
            settings: self.kind.name.to_owned(),
            join_bytes: self.joined.received_bytes + self.joined.sent_bytes,
            down_bytes: each(wire.received_bytes, self.joined.received_bytes),
            up_bytes: each(wire.sent_bytes, self.joined.sent_bytes),
            frame_us: percentile(50),
            frame_p99_us: percentile(99),
            server_us: worked.map(|(now, before)| each(now, before)),
            disk_bytes: disk.transpose()?.map(|bytes| bytes as f64 / ticks),
            same_truth,
        };
        self.client.delete()?;
        Ok(costs)
    }
}

/// Runs a program to its end; returns its output.
fn run(program: &mut Program) -> Result<String, Error> {
    let output = program.output()?;
    if output.status.success() {
        return Ok(String::from_utf8(output.stdout)?);
    }
    let cause = String::from_utf8_lossy(&output.stderr);
    Err(format!("{program:?} failed: {cause}").into())
}

/// Bytes of all files below a folder.
fn bytes_in(folder: &Path) -> std::io::Result<u64> {
    let mut bytes = 0;
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        bytes += match entry.file_type()?.is_dir() {
            true => bytes_in(&entry.path())?,
            false => entry.metadata()?.len(),
        };
    }
    Ok(bytes)
}

impl ServiceCosts {
    /// Text of a block of the documents; `None` if the block does not exist.
    #[must_use]
    pub fn block(&self, what: &str) -> Option<String> {
        match what {
            "command" => Some(machine::provenance(
                &self.command,
                &self.machine,
                &self.build,
            )),
            "costs" => Some(markdown(&self.rows())),
            _ => None,
        }
    }

    /// Rows of the table: one for each server.
    pub fn rows(&self) -> Vec<Vec<String>> {
        let titles = [
            "server",
            "join B",
            "down B",
            "up B",
            "frame us",
            "p99 us",
            "server us",
            "disk B",
            "same truth",
        ];
        let mut rows = vec![titles.map(str::to_owned).to_vec()];
        for server in &self.servers {
            rows.push(vec![
                server.settings.clone(),
                server.join_bytes.to_string(),
                number(Some(server.down_bytes)),
                number(Some(server.up_bytes)),
                number(Some(server.frame_us)),
                number(Some(server.frame_p99_us)),
                number(server.server_us),
                number(server.disk_bytes),
                if server.same_truth { "yes" } else { "NO" }.to_owned(),
            ]);
        }
        rows
    }
}
