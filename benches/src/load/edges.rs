//! `rhumb-bench load edges`: what members cost a server that has edges.
//!
//! One scene runs by the server's clock. At first it has its owner and one observer; then so many observers come
//! through edges, processes of their own. Most of them only count packets; of each edge some have copies, which are
//! compared with the server's states. The delay that an edge adds is measured in the packets, which are the same bytes
//! at every member: by when the observer of the server had each of them, and by when those of the edges had it. At the
//! end one edge is killed, and another one is frozen for a while.

use std::num::NonZeroU32;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use std::{fs, thread};

use clap::Args;
use rhumb_client::{JoinMode, StreamChoice};
use rhumb_reckoning::{Tick, Tolerance};
use rhumb_sims::NAMES;
use rhumb_transport::DevelopmentPem;
use serde::{Deserialize, Serialize};

use super::member::Crowd;
use super::member::{Contents, Judged, Member, Place, Watch, Watchers};
use super::rig::{ServerArguments, ServerMetrics};

use crate::drive::{BesideListener, ServerProcess, Signal};
use crate::machine::{load_average, worked_us};
use crate::numbers::{markdown, number, of_nanoseconds};
use crate::output::{self, Failure, Provenance, write};

/// Longest wait for members that come back.
const BACK: Duration = Duration::from_secs(30);
/// Time between two looks at them.
const LOOK: Duration = Duration::from_millis(10);

/// Arguments: server, scene, edges, members, durations, output.
#[derive(Clone, Debug, Args)]
pub(super) struct EdgesArguments {
    #[command(flatten)]
    server: ServerArguments,
    /// The scene.
    #[arg(long, default_value = "ball-pit", value_parser = clap::builder::PossibleValuesParser::new(NAMES))]
    scene: String,
    /// Bodies of the scene.
    #[arg(long, default_value = "2000")]
    bodies: u32,
    /// Steps between publications.
    #[arg(long, default_value = "3")]
    publish_interval: NonZeroU32,
    /// Number of edges.
    #[arg(long, default_value = "2", value_parser = clap::value_parser!(u32).range(1..=64))]
    edges: u32,
    /// Members of all edges together.
    #[arg(long, default_value = "200", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    members: u32,
    /// Members of each edge that have a copy, and whose packets are timed.
    #[arg(long, default_value = "3", value_parser = clap::value_parser!(u32).range(1..=100))]
    copies: u32,
    /// Duration of each part, seconds.
    #[arg(long, default_value = "40", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    seconds: u32,
    /// Duration of the comparison with the server's states, seconds.
    #[arg(long, default_value = "10", value_parser = clap::value_parser!(u32).range(1..=1_000))]
    compared: u32,
    /// Seconds after which the bodies are put back where they began.
    #[arg(long, default_value = "20", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    reset: u32,
    /// Seconds for which an edge is frozen at the end.
    #[arg(long, default_value = "2", value_parser = clap::value_parser!(u32).range(1..=9))]
    frozen: u32,
    /// Seed of the scene.
    #[arg(long, default_value = "1")]
    seed: u64,
    /// Folder for edges.json, and for the certificate of the edges; created if missing.
    #[arg(long, default_value = "results/edges")]
    out: PathBuf,
}

/// Content of `edges.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EdgesLoad {
    /// Source of the figures.
    #[serde(flatten)]
    pub provenance: Provenance,
    /// Load average of the machine over a minute: before, and at the end of the part with edges.
    pub machine_load: [Option<f64>; 2],
    /// Bodies of the scene.
    pub bodies: u32,
    /// Number of edges.
    pub edges: u32,
    /// Members of the edges.
    pub members: u32,
    /// Duration of a published tick, milliseconds.
    pub tick_ms: f64,
    /// Processor time of the server, microseconds a published tick: with one observer, and with the edges.
    pub server_us: [Option<f64>; 2],
    /// Processor time of all edges, microseconds for each packet of a member.
    pub edge_us: Option<f64>,
    /// Packets of a member, for each published tick.
    pub packets: f64,
    /// Packets that members of edges received, as a share of those that the observer of the server received.
    pub delivered: f64,
    /// Packets that were timed, at one member each.
    pub timed: u64,
    /// Delay that the edges added, milliseconds: median and 99th percentile; `None` if no packet was timed.
    pub added_ms: Option<[f64; 2]>,
    /// The copies beside the server's states.
    pub judged: Judged,
    /// Members that lost their connection before an edge was killed.
    pub lost: u64,
    /// An edge that was killed and started again at its address.
    pub killed: Fault,
    /// An edge that was frozen, from its end on.
    pub frozen: Fault,
}

/// How the members of an edge came back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Fault {
    /// Members with a copy that came back, of all of this edge.
    pub copies: [usize; 2],
    /// Time until the last of them had all of a tick later than the fault, seconds.
    pub copies_s: Option<f64>,
    /// Other members that lost their connection.
    pub crowd_lost: u64,
    /// Time from the first loss until all of them were members again, seconds.
    pub crowd_s: Option<f64>,
}

/// Runs the measurement.
pub(super) fn run(arguments: &EdgesArguments) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let mut rig = Rig::start(arguments)?;
    let measured = rig.measure();
    let ended = rig.end();
    let measured = measured?;
    ended?;
    let table = [("", measured.table())];
    Ok(write(&arguments.out, "edges.json", &measured, &table)?)
}

/// The server, its scene, its edges, and their members.
struct Rig<'a> {
    arguments: &'a EdgesArguments,
    server: ServerProcess,
    certificate: [String; 2],
    contents: Contents,
    stop: Arc<AtomicBool>,
    owner: Option<Member>,
    watchers: Watchers,
    edges: Vec<ServerProcess>,
    crowds: Vec<Crowd>,
}

/// The cost of a part of the time.
struct Part {
    server_us: Option<f64>,
    edges_us: Option<f64>,
    /// Published ticks.
    ticks: f64,
    /// Packets of the observer of the server.
    direct: u64,
    /// Packets of the crowds.
    followed: u64,
}

fn place(process: &ServerProcess) -> Place {
    Place {
        address: process.address,
        fingerprint: process.fingerprint,
        number: 0,
    }
}

impl<'a> Rig<'a> {
    fn start(arguments: &'a EdgesArguments) -> Result<Self, Failure> {
        let made = DevelopmentPem::new(["localhost"])?;
        let files = ["edge.pem", "edge.key"].map(|name| arguments.out.join(name));
        fs::write(&files[0], made.certificate)?;
        fs::write(&files[1], made.key)?;
        let open = ["--open", "--log", "warn", "--metrics", "127.0.0.1:0"];
        let listener = Some(BesideListener::Metrics);
        let contents = Contents {
            script: arguments.scene.clone(),
            bodies: arguments.bodies,
            seed: arguments.seed,
            reset: Duration::from_secs(u64::from(arguments.reset)),
            publish_interval: arguments.publish_interval,
        };
        Ok(Self {
            arguments,
            server: arguments.server.start(&open, listener)?,
            certificate: files.map(|file| file.display().to_string()),
            watchers: Watchers::new(&contents)?,
            contents,
            stop: Arc::default(),
            owner: None,
            edges: Vec::new(),
            crowds: Vec::new(),
        })
    }

    fn measure(&mut self) -> Result<EdgesLoad, Failure> {
        let arguments = self.arguments;
        let seconds = |seconds: u32| Duration::from_secs(u64::from(seconds));
        let load_before = load_average();
        let at_server = place(&self.server);
        self.owner = Some(Member::own(&at_server, &self.contents, &self.stop)?);
        let direct = at_server.join(JoinMode::Join)?;
        let step_ms = direct.config().integrator.rate.step_ns() as f64 * 1e-6;
        self.watchers.watch(direct, Watch::Server);
        let alone = self.part(seconds(arguments.seconds))?;
        self.enter()?;
        self.watchers.forget_arrivals();
        let with = self.part(seconds(arguments.seconds))?;
        let machine_load = [load_before, load_average()];
        let mut added = self.watchers.added_ns();
        let exact = at_server.join_stream(JoinMode::Join, StreamChoice::Full)?;
        let compared = seconds(arguments.compared);
        let mut judged = self.watchers.judge(exact, Tolerance::NORMAL, compared)?;
        judged.mismatches = self.watchers.mismatches();
        let crowds = self.crowds.iter();
        let lost = self.watchers.interrupted() + crowds.map(Crowd::lost).sum::<u64>();
        let (killed, frozen) = (self.kill()?, self.freeze(seconds(arguments.frozen))?);
        let mut percentile = |percent| Some(of_nanoseconds(&mut added, percent)? as f64 * 1e-6);
        let added_ms = percentile(50).zip(percentile(99));
        let members = f64::from(arguments.members);
        let received = members * with.direct as f64;
        Ok(EdgesLoad {
            provenance: Provenance::here(),
            machine_load,
            bodies: arguments.bodies,
            edges: arguments.edges,
            members: arguments.members,
            tick_ms: f64::from(arguments.publish_interval.get()) * step_ms,
            server_us: [alone.server_us, with.server_us],
            edge_us: with.edges_us.map(|us| us / received),
            packets: with.direct as f64 / with.ticks,
            delivered: with.followed as f64 / (self.followers() * with.direct as f64),
            timed: added.len() as u64,
            added_ms: added_ms.map(|(p50, p99)| [p50, p99]),
            judged,
            lost,
            killed,
            frozen,
        })
    }

    /// Processor times and packets of a part of the time.
    fn part(&self, duration: Duration) -> Result<Part, Failure> {
        let metrics = self.server.beside;
        let metrics = metrics.ok_or("the server names no metrics address")?;
        let worked = || -> Option<u64> {
            let each = self.edges.iter().map(|edge| worked_us(edge.id()));
            each.sum()
        };
        let followed = || self.crowds.iter().map(Crowd::packets).sum::<u64>();
        let read = || ServerMetrics::read(metrics, self.server.id());
        let (before, edges_before) = (read()?, worked());
        let (direct_before, followed_before) = (self.watchers.packets(), followed());
        thread::sleep(duration);
        let (direct, followed) = (self.watchers.packets(), followed());
        let (after, edges_after) = (read()?, worked());
        let interval = f64::from(self.arguments.publish_interval.get());
        let ticks = (after.newest_tick() - before.newest_tick()) / interval;
        let since = |after: Option<u64>, before: Option<u64>| {
            let (after, before) = after.zip(before)?;
            Some(after.saturating_sub(before) as f64)
        };
        Ok(Part {
            server_us: since(after.worked_us, before.worked_us).map(|us| us / ticks),
            edges_us: since(edges_after, edges_before),
            ticks,
            direct: direct - direct_before,
            followed: followed - followed_before,
        })
    }

    fn newest_tick(&self) -> Result<Tick, Failure> {
        let metrics = self.server.beside;
        let metrics = metrics.ok_or("the server names no metrics address")?;
        let metrics = ServerMetrics::read(metrics, self.server.id())?;
        Ok(Tick::new(metrics.newest_tick() as u64))
    }

    fn start_edge(&self, listen: &str) -> Result<ServerProcess, Failure> {
        let (owner, print) = (&self.server.address, &self.server.fingerprint);
        let [cert, key] = &self.certificate;
        let mut program = self.arguments.server.program()?;
        program.args(["edge", "--owner", &owner.to_string()]);
        program.args(["--fingerprint", &print.to_string()]);
        program.args(["--cert", cert, "--key", key, "--listen", listen]);
        program.args(["--observers", "--log", "error"]);
        Ok(ServerProcess::run(&mut program, None)?)
    }

    /// Starts the edges; all members come.
    fn enter(&mut self) -> Result<(), Failure> {
        let EdgesArguments {
            edges,
            members,
            copies,
            ..
        } = *self.arguments;
        let bar = output::progress_bar(u64::from(members), "members".to_owned());
        for number in 0..edges {
            self.edges.push(self.start_edge("127.0.0.1:0")?);
            let place = place(&self.edges[number as usize]);
            let of_edge = members / edges + u32::from(number < members % edges);
            let copies = copies.min(of_edge);
            for _ in 0..copies {
                let client = place.join(JoinMode::Join)?;
                self.watchers.watch(client, Watch::Edge(number as usize));
                bar.inc(1);
            }
            let crowd = Crowd::enter(&place, of_edge - copies, &|| bar.inc(1))?;
            self.crowds.push(crowd);
        }
        bar.finish_and_clear();
        Ok(())
    }

    /// Members without a copy.
    fn followers(&self) -> f64 {
        let EdgesArguments {
            edges,
            members,
            copies,
            ..
        } = *self.arguments;
        f64::from(members) - f64::from(edges * copies.min(members / edges))
    }

    /// Kills the first edge, and starts it again.
    fn kill(&mut self) -> Result<Fault, Failure> {
        let tick = self.newest_tick()?;
        let lost_before = self.crowds[0].lost();
        self.edges[0].send(Signal::Kill)?;
        self.watchers.begin_fault(0, tick);
        let address = self.edges[0].address.to_string();
        self.edges[0] = self.start_edge(&address)?;
        Ok(self.await_members(0, lost_before))
    }

    /// Freezes the last edge for a while.
    fn freeze(&mut self, duration: Duration) -> Result<Fault, Failure> {
        let edge = self.edges.len() - 1;
        let lost_before = self.crowds[edge].lost();
        self.edges[edge].send(Signal::Stop)?;
        thread::sleep(duration);
        let tick = self.newest_tick()?;
        self.edges[edge].send(Signal::Continue)?;
        self.watchers.begin_fault(edge, tick);
        Ok(self.await_members(edge, lost_before))
    }

    /// Waits until the members of an edge are back.
    fn await_members(&self, edge: usize, lost_before: u64) -> Fault {
        let (begun, copies) = (Instant::now(), self.arguments.copies as usize);
        let crowd = &self.crowds[edge];
        let lost = || crowd.lost() - lost_before;
        let is_back = || self.watchers.back().len() >= copies;
        let is_crowd_back = || lost() == 0 || crowd.absence().is_some();
        while begun.elapsed() < BACK && !(is_back() && is_crowd_back()) {
            thread::sleep(LOOK);
        }
        let back = self.watchers.back();
        let last = back.iter().max().map(Duration::as_secs_f64);
        let absence = crowd.absence().filter(|_| lost() > 0);
        Fault {
            copies: [back.len(), copies],
            copies_s: last.filter(|_| back.len() >= copies),
            crowd_lost: lost(),
            crowd_s: absence.map(|absence| absence.as_secs_f64()),
        }
    }

    /// Ends members, edges and server.
    fn end(self) -> Result<(), Failure> {
        self.watchers.end()?;
        for crowd in self.crowds {
            crowd.end()?;
        }
        self.stop.store(true, Ordering::Relaxed);
        let end = self.owner.map(Member::end);
        match end.and_then(|end| end.error) {
            Some(error) => Err(format!("the client that owns the scene was lost: {error}").into()),
            None => Ok(()),
        }
    }
}

impl EdgesLoad {
    /// Text of a block of the documents; `None` if the block does not exist.
    #[must_use]
    pub fn block(&self, what: &str) -> Option<String> {
        let [before, with] = self.machine_load.map(number);
        match what {
            "command" => Some(format!(
                "{}\n\nThe machine's load was {before} before, and {with} with the edges.",
                self.provenance.paragraph()
            )),
            "table" => Some(markdown(&self.table())),
            _ => None,
        }
    }

    /// Rows of the table.
    pub fn table(&self) -> Vec<Vec<String>> {
        let [alone, with] = self.server_us;
        let [p50, p99] = self.added_ms.map_or([None; 2], |delay| delay.map(Some));
        let ticks = |ms: Option<f64>| number(ms.map(|ms| ms / self.tick_ms));
        let judged = self.judged;
        let mut rows = vec![
            ("bodies", self.bodies.to_string()),
            ("published tick, ms", number(Some(self.tick_ms))),
            ("edges", self.edges.to_string()),
            ("members of the edges", self.members.to_string()),
            ("packets a tick", number(Some(self.packets))),
            ("server with one observer, us a tick", number(alone)),
            ("server with the edges, us a tick", number(with)),
            ("edges, us a packet and member", number(self.edge_us)),
            ("packets delivered, %", number(Some(self.delivered * 100.0))),
            ("packets timed", self.timed.to_string()),
            ("delay added, p50, ms", number(p50)),
            ("delay added, p50, ticks", ticks(p50)),
            ("delay added, p99, ms", number(p99)),
            ("delay added, p99, ticks", ticks(p99)),
            ("members lost", self.lost.to_string()),
            ("bodies of copies compared", judged.compared.to_string()),
            ("beyond the tolerance", judged.breaches.to_string()),
            ("greatest error, tolerances", number(Some(judged.worst))),
            ("checksums that differed", judged.mismatches.to_string()),
        ];
        rows.extend(self.killed.rows([
            "edge killed: copies back",
            "edge killed: the last after, s",
            "edge killed: other members lost",
            "edge killed: all of them back after, s",
        ]));
        rows.extend(self.frozen.rows([
            "edge frozen: copies back",
            "edge frozen: the last after it went on, s",
            "edge frozen: other members lost",
            "edge frozen: all of them back after, s",
        ]));
        let titles = vec!["what".to_owned(), "figure".to_owned()];
        let rows = rows.into_iter();
        let rows = rows.map(|(what, figure)| vec![what.to_owned(), figure]);
        std::iter::once(titles).chain(rows).collect()
    }
}

impl Fault {
    fn rows(&self, names: [&'static str; 4]) -> Vec<(&'static str, String)> {
        let [back, all] = self.copies;
        let figures = [
            format!("{back} of {all}"),
            number(self.copies_s),
            self.crowd_lost.to_string(),
            number(self.crowd_s),
        ];
        names.into_iter().zip(figures).collect()
    }
}
