//! `rhumb-bench load neighbour`: a scene's frames while another one is abused.
//!
//! A lockstep client steps one script again and again: alone, and beside each abuse by members of another scene. Both
//! take turns, so that a change of the machine's speed meets both. A frame sends the commands and waits for the tick.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use clap::Args;
use glam::Vec3;
use rhumb_client::scene::{BodyDesc, SceneConfig, Shape, Stepping};
use rhumb_client::{
    BodyId, Client, ClientError, JoinMode, JoinOptions, PipelineDepth, Refusals, Trust,
};
use rhumb_protocol::scene::{Command, Query};
use rhumb_reckoning::Tick;
use rhumb_sims::NAMES;
use rhumb_transport::Fingerprint;
use serde::{Deserialize, Serialize};

use super::rig::{FrameTimes, ServerArguments, script, take_ids};
use crate::drive::ServerProcess;
use crate::numbers::{markdown, number};
use crate::output::{self, Failure, Provenance, write};

/// Arguments: server, scene, repetitions, output.
#[derive(Clone, Debug, Args)]
pub(super) struct NeighbourArguments {
    #[command(flatten)]
    server: ServerArguments,
    #[command(flatten)]
    measured: MeasuredScene,
    /// Folder for neighbour.json; created if missing.
    #[arg(long, default_value = "results/neighbour")]
    out: PathBuf,
}

/// The scene whose frames are measured, alone and beside another.
#[derive(Clone, Debug, Args)]
pub(super) struct MeasuredScene {
    /// The scene that is measured.
    #[arg(long, default_value = "ball-pit", value_parser = clap::builder::PossibleValuesParser::new(NAMES))]
    scene: String,
    /// Its number of bodies.
    #[arg(long, default_value = "150")]
    bodies: u32,
    /// Ticks of each run.
    #[arg(long, default_value = "600", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    ticks: u32,
    /// Runs alone, and as many beside each other scene.
    #[arg(long, default_value = "5", value_parser = clap::value_parser!(u32).range(1..=1_000))]
    pub(super) runs: u32,
    /// Seed of the scene.
    #[arg(long, default_value = "1")]
    seed: u64,
}

/// Content of `neighbour.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Neighbour {
    /// Source of the figures.
    #[serde(flatten)]
    pub provenance: Provenance,
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

/// Runs the measurement.
pub(super) fn run(arguments: &NeighbourArguments) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let abuses = measure(arguments)?;
    let measured = Neighbour {
        provenance: Provenance::here(),
        abuses,
    };
    let table = [("", measured.table())];
    Ok(write(&arguments.out, "neighbour.json", &measured, &table)?)
}

fn measure(arguments: &NeighbourArguments) -> Result<Vec<AbuseFrames>, Failure> {
    let server = arguments
        .server
        .start(&["--open", "--log", "error"], None)?;
    let runs = u64::from(arguments.measured.runs) * 2 * Abuse::ALL.len() as u64;
    let bar = output::progress_bar(runs, "neighbour".to_owned());
    let mut measured = Vec::new();
    for abuse in Abuse::ALL {
        let (mut alone, mut beside, mut done) = (Vec::new(), Vec::new(), 0);
        for _ in 0..arguments.measured.runs {
            arguments.measured.step(&server, &mut alone)?;
            bar.inc(1);
            let running = RunningAbuse::start(abuse, &server)?;
            let stepped = arguments.measured.step(&server, &mut beside);
            done += running.end()?;
            stepped?;
            bar.inc(1);
        }
        measured.push(AbuseFrames {
            abuse: abuse.text().to_owned(),
            done,
            alone: FrameTimes::of(&alone),
            beside: FrameTimes::of(&beside),
        });
    }
    bar.finish_and_clear();
    Ok(measured)
}

impl MeasuredScene {
    /// Steps the script once in a scene of its own, and adds the time of each frame behind the first.
    pub(super) fn step(
        &self,
        server: &ServerProcess,
        took: &mut Vec<Duration>,
    ) -> Result<(), Failure> {
        let mut script = script(&self.scene, self.bodies, self.seed)?;
        let options = JoinOptions {
            mode: JoinMode::Create(script.config()),
            ..JoinOptions::default()
        };
        let trust = Trust::Fingerprint(server.fingerprint);
        let connection = Client::connect(&server.address.to_string(), trust)?;
        let mut client = connection.join_with("measured/scene", options)?;
        for tick in 0..u64::from(self.ticks) {
            let mut commands = Vec::new();
            script.commands(Tick::new(tick), &mut commands);
            take_ids(&mut client, &commands)?;
            let begun = Instant::now();
            for command in commands {
                client.command(command)?;
            }
            client.advance(PipelineDepth::LOCKSTEP)?;
            if tick > 0 {
                took.push(begun.elapsed());
            }
            while client.poll_event().is_some() {}
        }
        Ok(client.delete()?)
    }
}

impl Neighbour {
    /// Text of a block of the documents; `None` if the block does not exist.
    #[must_use]
    pub fn block(&self, what: &str) -> Option<String> {
        match what {
            "command" => Some(self.provenance.paragraph()),
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

/// One abuse of a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Abuse {
    Overlap,
    Commands,
    Queries,
    Joins,
}

impl Abuse {
    const ALL: [Self; 4] = [Self::Overlap, Self::Commands, Self::Queries, Self::Joins];

    const fn text(self) -> &'static str {
        match self {
            Self::Overlap => "200 balls in one place",
            Self::Commands => "impulses without a pause",
            Self::Queries => "rays without a pause",
            Self::Joins => "joins of 5,000 bodies without a pause",
        }
    }

    /// Number of balls in the scene.
    const fn balls(self) -> u32 {
        match self {
            Self::Overlap => 200,
            Self::Commands | Self::Queries => 100,
            Self::Joins => 5_000,
        }
    }

    /// Distance between two balls, metres.
    const fn distance(self) -> f32 {
        match self {
            Self::Overlap => 1e-3,
            _ => 2.0,
        }
    }
}

/// Commands or queries of one turn.
const BATCH: usize = 500;
/// Scenes of this server that abuse it.
const SCENE: &str = "abusing/scene";

/// An abuse that runs until it is stopped.
struct RunningAbuse {
    stop: Arc<AtomicBool>,
    worker: JoinHandle<Result<u64, Failure>>,
}

/// The address of a server.
#[derive(Clone, Copy)]
struct Target(SocketAddr, Fingerprint);

impl Target {
    fn join(self, mode: JoinMode) -> Result<Client, Failure> {
        let options = JoinOptions {
            mode,
            refusals: Refusals::Events,
            ..JoinOptions::default()
        };
        let connection = Client::connect(&self.0.to_string(), Trust::Fingerprint(self.1))?;
        Ok(connection.join_with(SCENE, options)?)
    }
}

impl RunningAbuse {
    /// Makes the scene, then begins.
    fn start(abuse: Abuse, server: &ServerProcess) -> Result<Self, Failure> {
        let target = Target(server.address, server.fingerprint);
        let config = SceneConfig {
            stepping: Stepping::FreeRunning,
            ..SceneConfig::default()
        };
        let mut client = target.join(JoinMode::Create(config))?;
        client.add_body(BodyDesc::fixed(Shape::cuboid(200.0, 0.5, 200.0)).at(0.0, -0.5, 0.0))?;
        let across = (f64::from(abuse.balls()).sqrt().ceil()) as u32;
        let balls = (0..abuse.balls()).map(|ball| {
            let [x, z] =
                [ball % across, ball / across].map(|place| place as f32 * abuse.distance());
            BodyDesc::dynamic(Shape::ball(0.5)).at(x, 0.5, z)
        });
        let ids = client.add_bodies(balls)?;
        client.flush();
        client.idle(Duration::from_millis(100))?;
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let worker = thread::spawn(move || {
            let mut done = 0;
            while !stopped.load(Ordering::Relaxed) {
                done += turn(abuse, target, &mut client, &ids)?;
                while client.poll_event().is_some() {}
            }
            client.delete()?;
            Ok(done)
        });
        Ok(Self { stop, worker })
    }

    /// Ends it; returns the number of what was done.
    fn end(self) -> Result<u64, Failure> {
        self.stop.store(true, Ordering::Relaxed);
        let ended = self.worker.join();
        ended.unwrap_or_else(|_| Err("the thread of the abuse panicked".into()))
    }
}

/// One turn of an abuse; returns the number of what was done.
fn turn(abuse: Abuse, target: Target, client: &mut Client, ids: &[BodyId]) -> Result<u64, Failure> {
    let pause = Duration::from_millis(1);
    match abuse {
        Abuse::Overlap => {
            client.idle(Duration::from_millis(20))?;
            Ok(1)
        }
        Abuse::Commands => {
            for id in ids.iter().cycle().take(BATCH) {
                let (id, impulse) = (*id, Vec3::new(0.0, 0.1, 0.0));
                client.command(Command::Impulse { id, impulse })?;
            }
            client.flush();
            client.idle(pause)?;
            Ok(BATCH as u64)
        }
        Abuse::Queries => {
            let ray = Query::ray(Vec3::new(0.0, 0.5, 0.0), Vec3::new(100.0, 0.0, 100.0));
            // Refused queries are answered too.
            match client.ask(vec![ray; BATCH]) {
                Ok(_) => Ok(BATCH as u64),
                Err(ClientError::Timeout { .. }) => Ok(0),
                Err(error) => Err(error.into()),
            }
        }
        Abuse::Joins => {
            target.join(JoinMode::Join)?.close();
            client.idle(pause)?;
            Ok(1)
        }
    }
}
