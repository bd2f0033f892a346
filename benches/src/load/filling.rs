//! `rhumb-bench load filling`: how fast a scene is filled and joined.
//!
//! One client adds many bodies to a scene that runs by the server's clock; then others join it, and a smaller scene. A
//! body is added once its adder sees it. Meanwhile the frames of a lockstep client of another scene are measured as by
//! `load neighbour`: alone, and beside a client that fills a scene again and again.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use glam::Vec3;
use rhumb_client::scene::{BodyBuilder, BodyDesc, SceneConfig, Shape, Stepping};
use rhumb_client::{Client, Event, JoinMode, JoinOptions, PipelineDepth, Trust};
use rhumb_reckoning::Tick;
use rhumb_sims::NAMES;
use serde::{Deserialize, Serialize};

use super::rig::{FrameTimes, ServerArguments, script, take_ids};
use crate::drive::ServerProcess;
use crate::numbers::{self, markdown, number};
use crate::output::{self, Failure, Provenance, write};

/// Arguments: server, scenes, repetitions, output.
#[derive(Clone, Debug, Args)]
pub(super) struct FillingArguments {
    #[command(flatten)]
    server: ServerArguments,
    /// Bodies of the scene that is filled.
    #[arg(long, default_value = "80000", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    filled: u32,
    /// Bodies of the scene that is joined again and again.
    #[arg(long, default_value = "2000", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    joined: u32,
    /// Seconds of joins.
    #[arg(long, default_value = "20", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    join_seconds: u32,
    #[command(flatten)]
    measured: MeasuredScene,
    /// Folder for filling.json; created if missing.
    #[arg(long, default_value = "results/filling")]
    out: PathBuf,
}

/// The scene whose frames are measured, alone and beside another.
#[derive(Clone, Debug, Args)]
struct MeasuredScene {
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
    runs: u32,
    /// Seed of the scene.
    #[arg(long, default_value = "1")]
    seed: u64,
}

/// Content of `filling.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Filling {
    /// Source of the figures.
    #[serde(flatten)]
    pub provenance: Provenance,
    /// Bodies of the scene that is filled.
    pub bodies: u32,
    /// Each kind of bodies.
    pub scenes: Vec<FilledScene>,
    /// Bodies of the scene that is joined again and again.
    pub joined_bodies: u32,
    /// Joins of it in a minute, one after the other.
    pub joins_per_minute: f64,
    /// Frames of another scene alone.
    pub alone: FrameTimes,
    /// Frames of it beside the filling of a scene.
    pub beside: FrameTimes,
    /// Number of times that the scene was filled meanwhile.
    pub filled: u64,
}

/// The times of one kind of bodies, medians.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FilledScene {
    /// The kind, in words.
    pub kind: String,
    /// Time until the adder has seen the last body, seconds.
    pub fill_s: f64,
    /// Ticks of the scene meanwhile.
    pub ticks: u64,
    /// UDP payload from the adder, and to it, megabytes.
    pub up_mb: f64,
    /// See `up_mb`.
    pub down_mb: f64,
    /// Time to connect and to have the whole scene, seconds.
    pub join_s: f64,
}

/// Runs the measurement.
pub(super) fn run(arguments: &FillingArguments) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let filling = measure(arguments)?;
    let table = [("", filling.table()), ("", filling.others())];
    Ok(write(&arguments.out, "filling.json", &filling, &table)?)
}

fn measure(arguments: &FillingArguments) -> Result<Filling, Failure> {
    let server = arguments
        .server
        .start(&["--open", "--log", "error"], None)?;
    let runs = arguments.measured.runs;
    let bar = output::progress_bar(u64::from(runs) * 4, "filling".to_owned());
    let mut scenes = Vec::new();
    for kind in Kind::ALL {
        let mut fills = Vec::new();
        for _ in 0..runs {
            fills.push(fill_and_join(&server, kind, arguments.filled)?);
            bar.inc(1);
        }
        scenes.push(FilledScene::of(kind, &fills));
    }
    let (mut alone, mut beside, mut filled) = (Vec::new(), Vec::new(), 0);
    for _ in 0..runs {
        arguments.measured.step(&server, &mut alone)?;
        bar.inc(1);
        filled += beside_filling(arguments, &server, &mut beside)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(Filling {
        provenance: Provenance::here(),
        bodies: arguments.filled,
        scenes,
        joined_bodies: arguments.joined,
        joins_per_minute: joins_per_minute(arguments, &server)?,
        alone: FrameTimes::of(&alone),
        beside: FrameTimes::of(&beside),
        filled,
    })
}

impl MeasuredScene {
    /// Steps the script once in a scene of its own, and adds the time of each frame behind the first.
    fn step(&self, server: &ServerProcess, took: &mut Vec<Duration>) -> Result<(), Failure> {
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

/// The bodies of a scene that is filled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Fixed,
    Awake,
}

impl Kind {
    const ALL: [Self; 2] = [Self::Fixed, Self::Awake];

    const fn text(self) -> &'static str {
        match self {
            Self::Fixed => "fixed boxes",
            Self::Awake => "boxes that fall",
        }
    }

    /// The bodies, each for itself.
    fn bodies(self, count: u32) -> impl Iterator<Item = BodyBuilder> {
        let across = f64::from(count).sqrt().ceil() as u32;
        (0..count).map(move |number| {
            let shape = Shape::cuboid(0.5, 0.25, 0.5);
            let [x, z] = [number % across, number / across].map(|place| place as f32 * 2.0);
            let desc = match self {
                Self::Fixed => BodyDesc::fixed(shape),
                Self::Awake => BodyDesc::dynamic(shape),
            };
            desc.at(x, 0.0, z)
        })
    }
}

/// Scenes that are filled.
const SCENE: &str = "filled/scene";
/// Time between two looks at the events.
const PAUSE: Duration = Duration::from_millis(5);
/// Time in which a scene must be filled.
const LIMIT: Duration = Duration::from_secs(300);

/// One filling.
struct Fill {
    took: Duration,
    ticks: u64,
    up_bytes: u64,
    down_bytes: u64,
    join: Duration,
}

fn connect(server: &ServerProcess, mode: JoinMode) -> Result<Client, Failure> {
    let options = JoinOptions {
        mode,
        ..JoinOptions::default()
    };
    let trust = Trust::Fingerprint(server.fingerprint);
    let connection = Client::connect(&server.address.to_string(), trust)?;
    Ok(connection.join_with(SCENE, options)?)
}

/// A scene without bodies.
fn begin(server: &ServerProcess) -> Result<Client, Failure> {
    connect(
        server,
        JoinMode::Create(SceneConfig {
            gravity: Vec3::new(0.0, -1.0, 0.0),
            stepping: Stepping::FreeRunning,
            ..SceneConfig::default()
        }),
    )
}

/// Adds the bodies, and waits until the client has seen all, or until it is stopped.
fn fill(client: &mut Client, kind: Kind, bodies: u32, stop: &AtomicBool) -> Result<(), Failure> {
    let begun = Instant::now();
    client.add_bodies(kind.bodies(bodies))?;
    client.flush();
    let mut placed = 0;
    while placed < bodies && !stop.load(Ordering::Relaxed) {
        client.idle(PAUSE)?;
        while let Some((_, event)) = client.poll_event() {
            match event {
                Event::BodyPlaced(_) => placed += 1,
                Event::Refused { error, .. } => {
                    return Err(format!("body {placed} of {bodies} was refused: {error}").into());
                }
                _ => {}
            }
        }
        if begun.elapsed() > LIMIT {
            return Err(format!("{placed} of {bodies} bodies after {LIMIT:?}").into());
        }
    }
    Ok(())
}

fn fill_and_join(server: &ServerProcess, kind: Kind, bodies: u32) -> Result<Fill, Failure> {
    let mut client = begin(server)?;
    let (before, tick) = (client.statistics().wire, client.inspect()?.tick);
    let begun = Instant::now();
    fill(&mut client, kind, bodies, &AtomicBool::new(false))?;
    let took = begun.elapsed();
    let (after, ended) = (client.statistics().wire, client.inspect()?.tick);
    let begun = Instant::now();
    let other = connect(server, JoinMode::Join)?;
    let join = begun.elapsed();
    let found = other
        .replica()
        .map_or(0, |replica| replica.bodies().count());
    if found != bodies as usize {
        return Err(format!("a member that joined found {found} of {bodies} bodies").into());
    }
    other.close();
    client.delete()?;
    Ok(Fill {
        took,
        ticks: ended.value() - tick.value(),
        up_bytes: after.sent_bytes - before.sent_bytes,
        down_bytes: after.received_bytes - before.received_bytes,
        join,
    })
}

/// Steps the measured scene beside a client that fills a scene; returns how often it did.
fn beside_filling(
    arguments: &FillingArguments,
    server: &ServerProcess,
    took: &mut Vec<Duration>,
) -> Result<u64, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    thread::scope(|scope| {
        let stopped = Arc::clone(&stop);
        let filler = scope.spawn(move || {
            let mut filled = 0;
            while !stopped.load(Ordering::Relaxed) {
                let mut client = begin(server)?;
                fill(&mut client, Kind::Fixed, arguments.filled, &stopped)?;
                filled += u64::from(!stopped.load(Ordering::Relaxed));
                client.delete()?;
            }
            Ok::<_, Failure>(filled)
        });
        let stepped = arguments.measured.step(server, took);
        stop.store(true, Ordering::Relaxed);
        let filled = filler.join();
        stepped?;
        filled.unwrap_or_else(|_| Err("the thread that fills a scene panicked".into()))
    })
}

/// Joins of a scene in a minute, by one client after the other.
fn joins_per_minute(arguments: &FillingArguments, server: &ServerProcess) -> Result<f64, Failure> {
    let mut client = begin(server)?;
    let never = AtomicBool::new(false);
    fill(&mut client, Kind::Fixed, arguments.joined, &never)?;
    let until = Duration::from_secs(u64::from(arguments.join_seconds));
    let (begun, mut joins) = (Instant::now(), 0.0);
    while begun.elapsed() < until {
        connect(server, JoinMode::Join)?.close();
        joins += 1.0;
    }
    let minutes = begun.elapsed().as_secs_f64() / 60.0;
    client.delete()?;
    Ok(joins / minutes)
}

impl FilledScene {
    fn of(kind: Kind, fills: &[Fill]) -> Self {
        let median = |value: &dyn Fn(&Fill) -> f64| {
            let mut values: Vec<f64> = fills.iter().map(value).collect();
            let place = numbers::rank(50, values.len());
            place.map_or(0.0, |place| {
                *values.select_nth_unstable_by(place, f64::total_cmp).1
            })
        };
        Self {
            kind: kind.text().to_owned(),
            fill_s: median(&|fill| fill.took.as_secs_f64()),
            ticks: median(&|fill| fill.ticks as f64) as u64,
            up_mb: median(&|fill| fill.up_bytes as f64 * 1e-6),
            down_mb: median(&|fill| fill.down_bytes as f64 * 1e-6),
            join_s: median(&|fill| fill.join.as_secs_f64()),
        }
    }
}

impl Filling {
    /// Text of a block of the documents; `None` if the block does not exist.
    #[must_use]
    pub fn block(&self, what: &str) -> Option<String> {
        match what {
            "command" => Some(self.provenance.paragraph()),
            "table" => Some(markdown(&self.table())),
            "others" => Some(markdown(&self.others())),
            _ => None,
        }
    }

    /// Rows of the table: one for each kind of bodies.
    pub fn table(&self) -> Vec<Vec<String>> {
        let titles = ["added", "fill s", "ticks", "up MB", "down MB", "join s"];
        let mut table = vec![titles.map(str::to_owned).to_vec()];
        for scene in &self.scenes {
            let mut cells = vec![format!("{} {}", self.bodies, scene.kind)];
            cells.push(number(Some(scene.fill_s)));
            cells.push(scene.ticks.to_string());
            cells.extend([scene.up_mb, scene.down_mb, scene.join_s].map(|it| number(Some(it))));
            table.push(cells);
        }
        table
    }

    /// Rows of the joins, and of the other scene.
    pub fn others(&self) -> Vec<Vec<String>> {
        let row = |what: String, figure: f64| vec![what, number(Some(figure))];
        let [alone, beside] = [self.alone.p99_us, self.beside.p99_us];
        vec![
            vec!["what".to_owned(), "figure".to_owned()],
            row(
                format!("joins of {} bodies in a minute", self.joined_bodies),
                self.joins_per_minute,
            ),
            row(
                "99th percentile of another scene's frame, us".to_owned(),
                alone,
            ),
            row(
                format!(
                    "the same while a scene is filled, {} times, us",
                    self.filled
                ),
                beside,
            ),
            row("ratio".to_owned(), beside / alone),
        ]
    }
}
