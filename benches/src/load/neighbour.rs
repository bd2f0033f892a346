//! `rhumb-bench load neighbour`: a scene's ticks beside abuses of its server.
//!
//! Each abuse has a server of its own, with tokens, a data directory and cells. A member of a scene of 60 ticks a second
//! notes when each tick arrives: alone, then beside the abuse. At the end a client of a third tenant creates a scene.
//! Attacker, server and victim share the machine; the attacker's threads have a lower priority, as if it had its own.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use glam::Vec3;
use rhumb_client::scene::{BodyDesc, SceneConfig, Shape, Sleep, Stepping};
use rhumb_client::{Client, JoinMode, JoinOptions, StreamChoice, TapChannel, Trust};
use rhumb_protocol::packet::{Datagram, PacketKind};
use rhumb_reckoning::Tick;
use serde::{Deserialize, Serialize};

use super::abuses::{ABUSES, Abuse};
use super::attacker::{Attacker, VICTIM};
use super::rig::{
    FrameTimes, LIMIT, ServerArguments, TokenKey, bytes_in, empty_folder, script, take_ids,
};
use crate::drive::ServerProcess;
use crate::machine::{lower_priority, memory_bytes};
use crate::numbers::{dash, markdown, number};
use crate::output::{self, Failure, Provenance, write};

/// Arguments: server, abuses, duration, victim, output.
#[derive(Clone, Debug, Args)]
pub(super) struct NeighbourArguments {
    #[command(flatten)]
    server: ServerArguments,
    /// Only the abuses whose words contain this text.
    #[arg(long, value_name = "TEXT", default_value = "")]
    only: String,
    /// Seconds alone, and as many beside each abuse.
    #[arg(long, default_value = "5", value_parser = clap::value_parser!(u32).range(1..=3_600))]
    seconds: u32,
    /// Balls in the victim's scene.
    #[arg(long, default_value = "150")]
    bodies: u32,
    /// Seed of the victim's scene.
    #[arg(long, default_value = "1")]
    seed: u64,
    /// Folder for neighbour.json; created if missing.
    #[arg(long, default_value = "results/neighbour")]
    out: PathBuf,
}

/// Content of `neighbour.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Neighbour {
    /// Source of the figures.
    #[serde(flatten)]
    pub provenance: Provenance,
    /// Each abuse.
    pub abuses: Vec<AbuseTicks>,
}

/// A scene's ticks alone and beside one abuse, and what the abuse did to the server.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AbuseTicks {
    /// The abuse, in words.
    pub abuse: String,
    /// Number of what was done, or the end of it.
    pub done: Result<u64, String>,
    /// Ticks alone.
    pub alone: TickTimes,
    /// Ticks beside it.
    pub beside: TickTimes,
    /// Time in which another tenant's client then created a scene, milliseconds.
    pub created_ms: Option<f64>,
    /// Greatest memory of the server's processes together, megabytes.
    pub server_mb: f64,
    /// Data directory at the end, megabytes.
    pub data_mb: f64,
    /// Those that lost their connection or were refused, other than the attacker, and why.
    pub lost: Vec<String>,
}

/// Arrivals of a scene's ticks at a member.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TickTimes {
    /// Ticks in a second.
    pub per_second: f64,
    /// Gaps between two ticks.
    pub gaps: FrameTimes,
}

/// Runs the measurement.
pub(super) fn run(arguments: &NeighbourArguments) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let of_these = |abuse: &&Abuse| abuse.words.contains(&arguments.only);
    let abuses: Vec<_> = ABUSES.iter().filter(of_these).collect();
    let bar = output::progress_bar(abuses.len() as u64, "neighbour".to_owned());
    let mut measured = Vec::new();
    for abuse in abuses {
        output::note(&bar, abuse.words);
        measured.push(measure(arguments, abuse)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let measured = Neighbour {
        provenance: Provenance::here(),
        abuses: measured,
    };
    let table = [("", measured.table())];
    Ok(write(&arguments.out, "neighbour.json", &measured, &table)?)
}

/// A server of one abuse, and the key of its tokens.
struct AbusedServer<'a> {
    arguments: &'a NeighbourArguments,
    process: ServerProcess,
    key: TokenKey,
    data: PathBuf,
}

fn measure(arguments: &NeighbourArguments, abuse: &Abuse) -> Result<AbuseTicks, Failure> {
    let mut server = AbusedServer::start(arguments)?;
    let attacker = server.attacker()?;
    let others = server.token(("other", "owner"), OTHERS)?;
    let mut victim = Victim::join(&server)?;
    let time = Duration::from_secs(arguments.seconds.into());
    victim.follow(SETTLED)?;
    let alone = victim.follow(time)?;
    let mut lost = Vec::new();
    let (done, beside, created_ms, server_bytes) = thread::scope(|scope| {
        let abusing = scope.spawn(|| {
            lower_priority();
            (abuse.play)(&attacker)
        });
        let watching = scope.spawn(|| greatest_memory(server.process.id(), &attacker.is_stopped));
        let beside = victim.follow_if_served(time, &mut lost);
        let created_ms = server.create_another(&others, &mut lost);
        attacker.is_stopped.store(true, Ordering::Relaxed);
        let done = abusing.join();
        let done = done.unwrap_or_else(|_| Err("the thread of the abuse panicked".into()));
        let bytes = watching.join().map_err(|_| "the watching thread panicked");
        Ok::<_, Failure>((done, beside, created_ms, bytes?))
    })?;
    if server.process.has_ended() {
        lost.push("the server".to_owned());
    }
    Ok(AbuseTicks {
        abuse: abuse.words.to_owned(),
        done: done.map_err(|end| end.to_string()),
        alone,
        beside,
        created_ms,
        server_mb: server_bytes as f64 * 1e-6,
        data_mb: bytes_in(&server.data)? as f64 * 1e-6,
        lost,
    })
}

/// The scene that another tenant's client creates at the end.
const OTHERS: &str = "other/scene";
/// Time for the victim's balls to lie in their pit.
const SETTLED: Duration = Duration::from_millis(1_500);
/// Time between two looks at the server's memory.
const LOOK: Duration = Duration::from_millis(50);

/// The greatest memory of a process and its children until something is over.
fn greatest_memory(process: u32, is_over: &AtomicBool) -> u64 {
    let mut most = 0;
    while !is_over.load(Ordering::Relaxed) {
        most = most.max(memory_bytes(process).unwrap_or(0));
        thread::sleep(LOOK);
    }
    most
}

impl<'a> AbusedServer<'a> {
    fn start(arguments: &'a NeighbourArguments) -> Result<Self, Failure> {
        let folder = arguments.out.join("server");
        empty_folder(&folder)?;
        let key = TokenKey::make(&arguments.server, &folder)?;
        let (public, data) = (key.public(), folder.join("data"));
        let [key_file, data_folder] = [&public, &data].map(|path| path.display().to_string());
        let flags = ["--token-key", &key_file, "--data", &data_folder];
        let more = ["--cells", "10", "--log", "error"];
        Ok(Self {
            arguments,
            process: arguments.server.start(&[flags, more].concat(), None)?,
            key,
            data,
        })
    }

    fn token(&self, who: (&str, &str), scenes: &str) -> Result<String, Failure> {
        self.key.token(&self.arguments.server, who, scenes)
    }

    fn attacker(&self) -> Result<Attacker, Failure> {
        Ok(Attacker {
            address: self.process.address,
            fingerprint: self.process.fingerprint,
            own: self.token(("attacker", "owner"), "attacker/*")?,
            of_victim: self.token(("attacker", "controller"), VICTIM)?,
            is_stopped: AtomicBool::new(false),
        })
    }

    /// A client with a token, which creates a scene.
    fn create(
        &self,
        (token, scene): (&str, &str),
        config: SceneConfig,
        stream: StreamChoice,
    ) -> Result<Client, Failure> {
        let options = JoinOptions {
            mode: JoinMode::Create(config),
            stream,
            resume_within: Some(Duration::ZERO),
            ..JoinOptions::default()
        };
        let trust = Trust::Fingerprint(self.process.fingerprint);
        let connection = Client::connect(&self.process.address.to_string(), trust)?;
        Ok((connection.timeout(LIMIT).token(token)).join_with(scene, options)?)
    }

    /// The time in which a new client creates a scene.
    fn create_another(&self, token: &str, lost: &mut Vec<String>) -> Option<f64> {
        let begun = Instant::now();
        let stream = JoinOptions::default().stream;
        match self.create((token, OTHERS), SceneConfig::default(), stream) {
            Ok(_) => Some(begun.elapsed().as_secs_f64() * 1e3),
            Err(cause) => {
                lost.push(format!("another tenant: {cause}"));
                None
            }
        }
    }
}

/// The member whose ticks are measured.
struct Victim {
    client: Client,
    /// When each tick arrived.
    arrivals: Arc<Mutex<Vec<Instant>>>,
}

impl Victim {
    /// Makes the scene, whose bodies move at every tick.
    fn join(server: &AbusedServer<'_>) -> Result<Self, Failure> {
        let arguments = server.arguments;
        let mut script = script("ball-pit", arguments.bodies, arguments.seed)?;
        let config = SceneConfig {
            stepping: Stepping::FreeRunning,
            sleep: Sleep::Never,
            ..script.config()
        };
        let token = server.token(("victim", "owner"), VICTIM)?;
        let mut client = server.create((&token, VICTIM), config, StreamChoice::Full)?;
        let mut commands = Vec::new();
        script.commands(Tick::ZERO, &mut commands);
        take_ids(&mut client, &commands)?;
        for command in commands {
            client.command(command)?;
        }
        let turning = BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 1_000.0, 0.0);
        client.add_body(turning.gravity_scale(0.0).angular_velocity(Vec3::Y))?;
        client.flush();
        let arrivals = Arc::new(Mutex::new(Vec::new()));
        let noted = Arc::clone(&arrivals);
        client.record(move |channel, bytes| {
            let ends_tick = |bytes| {
                let datagram = Datagram::open(bytes).ok()?;
                (datagram.head().kind == PacketKind::FullEnd).then_some(())
            };
            if channel == TapChannel::StateDown && ends_tick(bytes).is_some() {
                let mut arrivals = noted.lock().unwrap_or_else(PoisonError::into_inner);
                arrivals.push(Instant::now());
            }
        });
        Ok(Self { client, arrivals })
    }

    /// Follows the scene for this time.
    fn follow(&mut self, time: Duration) -> Result<TickTimes, Failure> {
        let mut lost = Vec::new();
        let times = self.follow_if_served(time, &mut lost);
        match lost.pop() {
            Some(cause) => Err(cause.into()),
            None => Ok(times),
        }
    }

    /// The same; notes the end of its connection, after which no tick arrives.
    fn follow_if_served(&mut self, time: Duration, lost: &mut Vec<String>) -> TickTimes {
        let begun = Instant::now();
        while begun.elapsed() < time {
            if let Err(cause) = self.client.idle(LOOK) {
                lost.push(format!("the victim: {cause}"));
                thread::sleep(time.saturating_sub(begun.elapsed()));
            }
            while self.client.poll_event().is_some() {}
        }
        let mut arrivals = self.arrivals.lock().unwrap_or_else(PoisonError::into_inner);
        let mut moments = vec![begun];
        moments.append(&mut arrivals);
        let ticks = moments.len() - 1;
        moments.push(Instant::now());
        let gaps = (moments.windows(2)).map(|two| two[1].saturating_duration_since(two[0]));
        TickTimes {
            per_second: ticks as f64 / begun.elapsed().as_secs_f64(),
            gaps: FrameTimes::of(&gaps.collect::<Vec<_>>()),
        }
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
            "abuse",
            "done",
            "ticks/s",
            "beside",
            "p99 ms",
            "beside",
            "ratio",
            "max ms",
            "beside",
            "created ms",
            "MB",
            "data MB",
            "lost",
        ];
        let mut table = vec![titles.map(str::to_owned).to_vec()];
        for row in &self.abuses {
            let (alone, beside) = (row.alone, row.beside);
            let done = row.done.as_ref().map(u64::to_string);
            let mut cells = vec![row.abuse.clone(), done.unwrap_or_else(String::clone)];
            let figures = [
                Some(alone.per_second),
                Some(beside.per_second),
                Some(alone.gaps.p99_us * 1e-3),
                Some(beside.gaps.p99_us * 1e-3),
                Some(beside.gaps.p99_us / alone.gaps.p99_us),
                Some(alone.gaps.max_us * 1e-3),
                Some(beside.gaps.max_us * 1e-3),
                row.created_ms,
                Some(row.server_mb),
                Some(row.data_mb),
            ];
            cells.extend(figures.map(number));
            cells.push(match row.lost.is_empty() {
                true => dash(),
                false => row.lost.join("; "),
            });
            table.push(cells);
        }
        table
    }
}
