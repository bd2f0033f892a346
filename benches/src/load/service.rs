//! `rhumb-bench load service`: the cost of tokens, durability and processes.
//!
//! Servers that differ in one setting step one script each. At each tick each of them has its frame in turn, so that a
//! change of the machine's speed meets all of them. The processor time is that of the server's processes together.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args;
use rhumb_client::{
    Client, JoinMode, JoinOptions, PipelineDepth, StreamChoice, Tolerance, Trust, WireStatistics,
};
use rhumb_protocol::scene::Command;
use rhumb_reckoning::Tick;
use rhumb_sims::NAMES;
use serde::{Deserialize, Serialize};

use super::rig::{FrameTimes, ServerArguments, TokenKey, bytes_in, empty_folder, script, take_ids};
use crate::drive::ServerProcess;
use crate::machine::worked_us;
use crate::numbers::{markdown, number};
use crate::output::{self, Failure, Provenance, write};

/// Arguments: server, scene, bodies, ticks, output.
#[derive(Clone, Debug, Args)]
pub(super) struct ServiceArguments {
    #[command(flatten)]
    server: ServerArguments,
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
    /// Source of the figures.
    #[serde(flatten)]
    pub provenance: Provenance,
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

/// Runs the measurements.
pub(super) fn run(arguments: &ServiceArguments) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let bar = output::progress_bar(u64::from(arguments.ticks), "service".to_owned());
    let servers = measure(arguments, &mut || bar.inc(1))?;
    bar.finish_and_clear();
    let costs = ServiceCosts {
        provenance: Provenance::here(),
        bodies: arguments.bodies,
        servers,
    };
    let table = [("", costs.rows())];
    Ok(write(&arguments.out, "service.json", &costs, &table)?)
}

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
) -> Result<Vec<ServerCosts>, Failure> {
    let mut script = script(&arguments.scene, arguments.bodies, arguments.seed)?;
    let options = JoinOptions {
        mode: JoinMode::Create(script.config()),
        stream: StreamChoice::Within(Tolerance::NORMAL),
        ..JoinOptions::default()
    };
    let mut servers = Vec::new();
    for (place, kind) in KINDS.into_iter().enumerate() {
        let folder = arguments.out.join(format!("server-{place}"));
        servers.push(Measured::start(&arguments.server, kind, folder, options)?);
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
        server: &ServerArguments,
        kind: Kind,
        folder: PathBuf,
        options: JoinOptions,
    ) -> Result<Self, Failure> {
        empty_folder(&folder)?;
        let path = |path: &Path| path.display().to_string();
        let mut flags = vec!["--log".to_owned(), "warn".to_owned()];
        let key = (kind.tokens).then(|| TokenKey::make(server, &folder));
        let key = key.transpose()?;
        match &key {
            Some(key) => flags.extend(["--token-key".to_owned(), path(&key.public())]),
            None => flags.push("--open".to_owned()),
        }
        if kind.durable {
            flags.extend(["--data".to_owned(), path(&folder.join("data"))]);
        }
        let workers = if kind.processes {
            "processes"
        } else {
            "threads"
        };
        flags.extend(["--workers", workers].map(str::to_owned));
        let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
        let process = server.start(&flags, None)?;
        let trust = Trust::Fingerprint(process.fingerprint);
        let mut connection = Client::connect(&process.address.to_string(), trust)?;
        if let Some(key) = &key {
            connection = connection.token(&key.token(server, ("bench", "owner"), SCENE)?);
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

    fn frame(&mut self, commands: &[Command], is_first: bool) -> Result<(), Failure> {
        if is_first {
            take_ids(&mut self.client, commands)?;
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

    fn end(mut self, ticks: u32, truth: u64) -> Result<ServerCosts, Failure> {
        let ticks = f64::from(ticks.max(2) - 1);
        let wire = self.client.statistics().wire;
        let worked = worked_us(self.process.id()).zip(self.worked_before);
        let same_truth = self.client.inspect()?.truth == truth;
        let disk = self
            .kind
            .durable
            .then(|| bytes_in(&self.folder.join("data")));
        let each = |now: u64, before: u64| now.saturating_sub(before) as f64 / ticks;
        let frames = FrameTimes::of(&self.took);
        let costs = ServerCosts {
            settings: self.kind.name.to_owned(),
            join_bytes: self.joined.received_bytes + self.joined.sent_bytes,
            down_bytes: each(wire.received_bytes, self.joined.received_bytes),
            up_bytes: each(wire.sent_bytes, self.joined.sent_bytes),
            frame_us: frames.p50_us,
            frame_p99_us: frames.p99_us,
            server_us: worked.map(|(now, before)| each(now, before)),
            disk_bytes: disk.transpose()?.map(|bytes| bytes as f64 / ticks),
            same_truth,
        };
        self.client.delete()?;
        Ok(costs)
    }
}

impl ServiceCosts {
    /// Text of a block of the documents; `None` if the block does not exist.
    #[must_use]
    pub fn block(&self, what: &str) -> Option<String> {
        match what {
            "command" => Some(self.provenance.paragraph()),
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
