//! `rhumb-bench load frames`: a simulator's frame by where its physics is.
//!
//! Every place steps the same script. At each tick each place has its frame in turn, so that a change of the machine's
//! speed meets all of them. A frame sends the commands, steps the scene, and reads every pose.

use std::hint::black_box;
use std::path::PathBuf;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use clap::Args;
use rhumb_client::{
    Client, JoinMode, JoinOptions, LocalServer, PipelineDepth, ServerConnection, StreamChoice,
    Tolerance, Trust,
};
use rhumb_protocol::scene::Command;
use rhumb_protocol::stream::Observation;
use rhumb_reckoning::Tick;
use rhumb_scene::Scene;
use rhumb_server::{Access, Identity, RunError, Server, Stop};
use rhumb_sims::NAMES;
use serde::{Deserialize, Serialize};

use super::rig::{script, take_ids};
use crate::numbers::{self, number};
use crate::output::{self, Failure, Provenance, write};

/// Arguments: scene, bodies, ticks, output.
#[derive(Clone, Debug, Args)]
pub(super) struct FramesArguments {
    /// The scene.
    #[arg(long, default_value = "ball-pit", value_parser = clap::builder::PossibleValuesParser::new(NAMES))]
    scene: String,
    /// Numbers of bodies.
    #[arg(long, value_delimiter = ',', default_value = "10,100,500,1000,2000")]
    bodies: Vec<u32>,
    /// Ticks of each scene.
    #[arg(long, default_value = "300", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    ticks: u32,
    /// Seed of the scene.
    #[arg(long, default_value = "1")]
    seed: u64,
    /// Folder for frames.json; created if missing.
    #[arg(long, default_value = "results/frames")]
    out: PathBuf,
}

/// Content of `frames.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frames {
    /// Source of the figures.
    #[serde(flatten)]
    pub provenance: Provenance,
    /// Each number of bodies, in the order of the command line.
    pub scenes: Vec<SceneFrames>,
}

/// The frames of one number of bodies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneFrames {
    /// Bodies of the script.
    pub bodies: u32,
    /// Median frame of the engine in the caller's thread, microseconds.
    pub integrated_us: f64,
    /// All other places.
    pub places: Vec<PlaceFrames>,
}

/// The frames of one place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlaceFrames {
    /// Name of the place.
    pub place: String,
    /// Median frame, microseconds.
    pub frame_us: f64,
    /// Median of what a frame takes longer than the engine's at the same tick, microseconds.
    pub longer_us: f64,
    /// Median of a frame over the engine's at the same tick.
    pub of_integrated: f64,
    /// True if the scene ended in the state of the engine's, to the bit.
    pub same_truth: bool,
}

/// Runs the measurements.
pub(super) fn run(arguments: &FramesArguments) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let steps = arguments.bodies.len() as u64 * u64::from(arguments.ticks);
    let bar = output::progress_bar(steps, "frames".to_owned());
    let mut scenes = Vec::new();
    for bodies in &arguments.bodies {
        scenes.push(measure(arguments, *bodies, &mut || bar.inc(1))?);
    }
    bar.finish_and_clear();
    let frames = Frames {
        provenance: Provenance::here(),
        scenes,
    };
    let table = [("", frames.rows())];
    Ok(write(&arguments.out, "frames.json", &frames, &table)?)
}

/// A client of a scene somewhere, and its frames.
struct Remote {
    place: &'static str,
    client: Client,
    depth: PipelineDepth,
    took: Vec<Duration>,
}

/// A server of this process with sockets, stopped when it is dropped.
struct SocketServer {
    address: String,
    fingerprint: Trust,
    unix: String,
    stop: Stop,
    thread: Option<JoinHandle<Result<(), RunError>>>,
}

/// Measures one number of bodies.
fn measure(
    arguments: &FramesArguments,
    bodies: u32,
    progress: &mut dyn FnMut(),
) -> Result<SceneFrames, Failure> {
    let mut script = script(&arguments.scene, bodies, arguments.seed)?;
    let config = script.config();
    let mut scene = Scene::new(config)?;
    let sockets = SocketServer::start()?;
    let unix = Client::connect(&sockets.unix, sockets.fingerprint.clone())?;
    let quic = Client::connect(&sockets.address, sockets.fingerprint.clone())?;
    let (here, beside) = (LocalServer::new(), LocalServer::spawn()?);
    let exact = JoinOptions {
        mode: JoinMode::Create(config),
        stream: StreamChoice::Full,
        ..JoinOptions::default()
    };
    let within = JoinOptions {
        stream: StreamChoice::Within(Tolerance::NORMAL),
        ..exact
    };
    let mut places = [
        Remote::join("in process, exact", here.connect(), exact)?,
        Remote::join("in process", here.connect(), within)?,
        Remote::join("own thread", beside.connect(), within)?,
        Remote::join("unix socket", unix, within)?,
        Remote::join("loopback quic", quic, within)?,
        Remote {
            depth: PipelineDepth::PIPELINED,
            ..Remote::join("pipelined", beside.connect(), within)?
        },
    ];
    let mut integrated = Vec::new();
    let mut observations = Vec::new();
    for tick in 0..u64::from(arguments.ticks) {
        let mut commands = Vec::new();
        script.commands(Tick::new(tick), &mut commands);
        integrated.push(frame(&mut scene, &commands, &mut observations)?);
        for remote in &mut places {
            remote.frame(&commands, tick == 0)?;
        }
        progress();
    }
    let truth = scene.digest().value();
    let places = places.map(|remote| remote.end(&integrated, truth));
    Ok(SceneFrames {
        bodies,
        integrated_us: median_us(integrated.iter().copied()),
        places: places.into_iter().collect::<Result<_, _>>()?,
    })
}

/// A frame of a simulator with the engine in its own thread.
fn frame(
    scene: &mut Scene,
    commands: &[Command],
    observations: &mut Vec<Observation>,
) -> Result<Duration, Failure> {
    let begun = Instant::now();
    for command in commands {
        scene.apply(command)?;
    }
    scene.step()?;
    observations.clear();
    scene.observe(observations);
    for observation in &*observations {
        black_box((observation.motion.position(), observation.motion.rotation()));
    }
    Ok(begun.elapsed())
}

impl Remote {
    fn join(
        place: &'static str,
        connection: ServerConnection,
        options: JoinOptions,
    ) -> Result<Self, Failure> {
        let letters = place.chars().filter(char::is_ascii_alphabetic);
        let scene: String = letters.collect();
        Ok(Self {
            place,
            client: connection.join_with(&scene, options)?,
            depth: PipelineDepth::LOCKSTEP,
            took: Vec::new(),
        })
    }

    /// Times a frame. A step that still runs beside the caller ends outside that time.
    fn frame(&mut self, commands: &[Command], is_first: bool) -> Result<(), Failure> {
        if is_first {
            take_ids(&mut self.client, commands)?;
        }
        let begun = Instant::now();
        for command in commands {
            self.client.command(command.clone())?;
        }
        self.client.advance(self.depth)?;
        let view = self.client.view();
        black_box((view.positions(), view.rotations()));
        self.took.push(begun.elapsed());
        self.client.wait(PipelineDepth::LOCKSTEP)?;
        Ok(())
    }

    fn end(mut self, integrated: &[Duration], truth: u64) -> Result<PlaceFrames, Failure> {
        let same_truth = self.client.inspect()?.truth == truth;
        self.client.delete()?;
        let pairs = self.took.iter().zip(integrated);
        let seconds = pairs.map(|(frame, engine)| (frame.as_secs_f64(), engine.as_secs_f64()));
        let seconds: Vec<_> = seconds.collect();
        let longer = seconds.iter().map(|(frame, engine)| 1e6 * (frame - engine));
        let shares = seconds.iter().map(|(frame, engine)| frame / engine);
        Ok(PlaceFrames {
            place: self.place.to_owned(),
            frame_us: median_us(self.took.iter().copied()),
            longer_us: median(longer.collect()),
            of_integrated: median(shares.collect()),
            same_truth,
        })
    }
}

fn median_us(frames: impl Iterator<Item = Duration>) -> f64 {
    median(frames.map(|frame| 1e6 * frame.as_secs_f64()).collect())
}

fn median(mut values: Vec<f64>) -> f64 {
    let place = numbers::rank(50, values.len());
    place.map_or(0.0, |place| {
        *values.select_nth_unstable_by(place, f64::total_cmp).1
    })
}

impl SocketServer {
    fn start() -> Result<Self, Failure> {
        let listen = "127.0.0.1:0".parse()?;
        let mut server = Server::bind(listen, &Identity::Development, Access::OpenOnLoopback)?;
        let path = std::env::temp_dir().join(format!("rhumb-frames-{}", std::process::id()));
        server.listen_at(&path)?;
        let (address, fingerprint) = (server.address().to_string(), server.fingerprint());
        let stop = Stop::new();
        let stopped = stop.clone();
        let thread = thread::spawn(move || server.run(&stopped).map(drop));
        Ok(Self {
            address,
            fingerprint: Trust::Fingerprint(fingerprint),
            unix: format!("unix:{}", path.display()),
            stop,
            thread: Some(thread),
        })
    }
}

impl Drop for SocketServer {
    fn drop(&mut self) {
        self.stop.stop();
        // A server that failed has ended its clients, which say so.
        drop(self.thread.take().map(JoinHandle::join));
    }
}

impl Frames {
    /// Rows of the table: one for each number of bodies and place.
    pub fn rows(&self) -> Vec<Vec<String>> {
        let titles = [
            "bodies",
            "place",
            "frame us",
            "longer us",
            "of integrated",
            "same truth",
        ];
        let mut rows = vec![titles.map(str::to_owned).to_vec()];
        for scene in &self.scenes {
            rows.push(vec![
                scene.bodies.to_string(),
                "integrated".to_owned(),
                number(Some(scene.integrated_us)),
                "-".to_owned(),
                "1".to_owned(),
                "-".to_owned(),
            ]);
            for place in &scene.places {
                rows.push(vec![
                    scene.bodies.to_string(),
                    place.place.clone(),
                    number(Some(place.frame_us)),
                    number(Some(place.longer_us)),
                    number(Some(place.of_integrated)),
                    if place.same_truth { "yes" } else { "NO" }.to_owned(),
                ]);
            }
        }
        rows
    }
}
