//! `rhumb-bench load edges`: what members cost a server that has edges.
//!
//! One scene runs by the server's clock. At first it has its owner and one observer; then so many observers come
//! through edges, processes of their own. Most of them only count packets; of each edge some have copies, which are
//! compared with the server's states. The delay that an edge adds is measured in the packets, which are the same bytes
//! at every member: by when the observer of the server had each of them, and by when those of the edges had it. At the
//! end one edge is killed, and another one is frozen for a while; a member of an edge of its own commands meanwhile, and that
//! edge is killed too. The edges may stand behind routers of zenoh, of which one is killed then, and the other one frozen.

use std::num::NonZeroU32;
use std::ops::Range;
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

use super::member::{Commanded, Commander, Contents, Crowd, Member, Place};
use super::rig::{Routers, ServerArguments, ServerMetrics};
use super::watchers::{Judge, Judged, Watch, Watchers};
use crate::drive::{BesideListener, ServerProcess, Signal};
use crate::machine::{load_average, worked_us};
use crate::numbers::{markdown, number, of_nanoseconds};
use crate::output::{self, Failure, Provenance, write};

/// Longest wait for members that come back.
const BACK: Duration = Duration::from_secs(30);
/// Time between two looks at them.
const LOOK: Duration = Duration::from_millis(10);
/// Time after the members have come, and between two faults.
const BETWEEN: Duration = Duration::from_secs(2);

/// Arguments: server, scene, edges, members, durations, output.
#[derive(Clone, Debug, Args)]
pub(super) struct EdgesArguments {
    #[command(flatten)]
    server: ServerArguments,
    /// The program of edge/zenoh: the edges are then behind two of its routers.
    #[arg(long, value_name = "FILE")]
    zenoh: Option<PathBuf>,
    /// The scene.
    #[arg(long, default_value = "ball-pit", value_parser = clap::builder::PossibleValuesParser::new(NAMES))]
    scene: String,
    /// Bodies of the scene.
    #[arg(long, default_value = "2000")]
    bodies: u32,
    /// Steps between publications.
    #[arg(long, default_value = "3")]
    publish_interval: NonZeroU32,
    /// Number of edges, without that of the member that commands.
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
    /// Seconds for which an edge, and a router, is frozen at the end.
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
    /// Number of routers.
    pub routers: Option<u32>,
    /// Members of the edges.
    pub members: u32,
    /// Duration of a published tick, milliseconds.
    pub tick_ms: f64,
    /// Processor time of the server, microseconds a published tick: with one observer, and with the edges.
    pub server_us: [Option<f64>; 2],
    /// Processor time of all edges, microseconds for each packet of a member.
    pub edge_us: Option<f64>,
    /// Processor time of the routers and the hub, microseconds a published tick.
    pub routers_us: Option<f64>,
    /// Bytes that the server sent, for each published tick: with one observer, and with the edges.
    pub sent_bytes: [f64; 2],
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
    /// The faults of edges and routers, and the recovery from each.
    pub faults: Faults,
}

/// Edges and routers that failed, one after the other.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Faults {
    /// An edge that was killed and started again at its address, and with it that of the commander.
    pub killed: Fault,
    /// An edge that was frozen, from its end on.
    pub frozen: Fault,
    /// The router of the edges that was killed.
    pub router_killed: Option<Fault>,
    /// The router that was frozen, to which edges and hub had gone, from its beginning on.
    pub router_frozen: Option<Fault>,
    /// The copies beside the server's states from the first fault to the last.
    pub judged: Judged,
    /// The commands that a member gave meanwhile.
    pub commanded: Option<Commanded>,
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
    /// Time until all of them were members again, seconds.
    pub crowd_s: Option<f64>,
    /// The longest time from a command to its answer meanwhile, seconds.
    pub command_s: Option<f64>,
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
    routers: Option<Routers>,
    edges: Vec<ServerProcess>,
    crowds: Vec<Crowd>,
    /// The member that commands, and its edge.
    commander: Option<(Commander, ServerProcess)>,
}

/// A fault that has begun.
struct Begun {
    since: Instant,
    /// The edges whose members notice it.
    edges: Range<usize>,
    /// Members without a copy that lose their connection for sure.
    expected: u64,
}

/// The members that an edge serves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Serves {
    Observers,
    All,
}

/// The cost of a part of the time.
struct Part {
    server_us: Option<f64>,
    edges_us: Option<f64>,
    routers_us: Option<f64>,
    /// Bytes that the server sent.
    sent_bytes: f64,
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
            routers: None,
            edges: Vec::new(),
            crowds: Vec::new(),
            commander: None,
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
        // The last snapshots are still under way.
        thread::sleep(BETWEEN);
        self.watchers.forget_arrivals();
        let with = self.part(seconds(arguments.seconds))?;
        let machine_load = [load_before, load_average()];
        let mut added = self.watchers.added_ns();
        let judge = self.judge(&at_server)?;
        thread::sleep(seconds(arguments.compared));
        let mut judged = judge.end()?;
        judged.mismatches = self.watchers.mismatches();
        let lost = self.watchers.interrupted() + self.lost();
        let faults = self.fail(&at_server)?;
        let mut percentile = |percent| Some(of_nanoseconds(&mut added, percent)? as f64 * 1e-6);
        let added_ms = percentile(50).zip(percentile(99));
        let members = f64::from(arguments.members);
        let received = members * with.direct as f64;
        Ok(EdgesLoad {
            provenance: Provenance::here(),
            machine_load,
            bodies: arguments.bodies,
            edges: arguments.edges,
            routers: self.routers.as_ref().map(|_| 2),
            members: arguments.members,
            tick_ms: f64::from(arguments.publish_interval.get()) * step_ms,
            server_us: [alone.server_us, with.server_us],
            edge_us: with.edges_us.map(|us| us / received),
            routers_us: with.routers_us.map(|us| us / with.ticks),
            sent_bytes: [&alone, &with].map(|part| part.sent_bytes / part.ticks),
            packets: with.direct as f64 / with.ticks,
            delivered: with.followed as f64 / (self.followers() * with.direct as f64),
            timed: added.len() as u64,
            added_ms: added_ms.map(|(p50, p99)| [p50, p99]),
            judged,
            lost,
            faults,
        })
    }

    /// Begins to compare the copies.
    fn judge(&self, at_server: &Place) -> Result<Judge, Failure> {
        let exact = at_server.join_stream(JoinMode::Join, StreamChoice::Full)?;
        Ok(self.watchers.judge(exact, Tolerance::NORMAL))
    }

    /// Lets edges and routers fail, one after the other, under a member that commands.
    fn fail(&mut self, at_server: &Place) -> Result<Faults, Failure> {
        let frozen_for = Duration::from_secs(u64::from(self.arguments.frozen));
        self.begin_commands()?;
        let mismatches = self.watchers.mismatches();
        let judge = self.judge(at_server)?;
        let killed = self.kill()?;
        let frozen = self.freeze(frozen_for)?;
        let router_killed = self.kill_router()?;
        let router_frozen = self.freeze_router(frozen_for)?;
        thread::sleep(BETWEEN);
        let judged = Judged {
            mismatches: self.watchers.mismatches() - mismatches,
            ..judge.end()?
        };
        let commander = self.commander.take();
        let commanded = commander.map(|(commander, _edge)| commander.end(at_server));
        Ok(Faults {
            killed,
            frozen,
            router_killed,
            router_frozen,
            judged,
            commanded: commanded.transpose()?,
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
        let routers_worked =
            || -> Option<u64> { self.routers.as_ref()?.ids().map(worked_us).sum() };
        let followed = || self.crowds.iter().map(Crowd::packets).sum::<u64>();
        let read = || ServerMetrics::read(metrics, self.server.id());
        let (before, edges_before, routers_before) = (read()?, worked(), routers_worked());
        let (direct_before, followed_before) = (self.watchers.packets(), followed());
        thread::sleep(duration);
        let (direct, followed) = (self.watchers.packets(), followed());
        let (after, edges_after, routers_after) = (read()?, worked(), routers_worked());
        let interval = f64::from(self.arguments.publish_interval.get());
        let ticks = (after.newest_tick() - before.newest_tick()) / interval;
        let since = |after: Option<u64>, before: Option<u64>| {
            let (after, before) = after.zip(before)?;
            Some(after.saturating_sub(before) as f64)
        };
        Ok(Part {
            server_us: since(after.worked_us, before.worked_us).map(|us| us / ticks),
            edges_us: since(edges_after, edges_before),
            routers_us: since(routers_after, routers_before),
            sent_bytes: after.sent_bytes() - before.sent_bytes(),
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

    fn start_edge(&self, listen: &str, serves: Serves) -> Result<ServerProcess, Failure> {
        let mut program = match &self.routers {
            Some(routers) => routers.edge(),
            None => {
                let (owner, print) = (&self.server.address, &self.server.fingerprint);
                let mut program = self.arguments.server.program()?;
                program.args(["edge", "--owner", &owner.to_string()]);
                program.args(["--fingerprint", &print.to_string()]);
                program
            }
        };
        let [cert, key] = &self.certificate;
        program.args(["--cert", cert, "--key", key, "--listen", listen]);
        program.args(["--log", "error"]);
        if serves == Serves::Observers {
            program.arg("--observers");
        }
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
        if let Some(program) = &self.arguments.zenoh {
            self.routers = Some(Routers::start(program, &self.server)?);
        }
        let bar = output::progress_bar(u64::from(members), "members".to_owned());
        for number in 0..edges {
            self.edges
                .push(self.start_edge("127.0.0.1:0", Serves::Observers)?);
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

    /// A member comes to an edge of its own, and commands from now on.
    fn begin_commands(&mut self) -> Result<(), Failure> {
        let edge = self.start_edge("127.0.0.1:0", Serves::All)?;
        let commander = Commander::enter(&place(&edge))?;
        self.commander = Some((commander, edge));
        Ok(())
    }

    /// Kills the first edge and that of the commander, and starts them again.
    fn kill(&mut self) -> Result<Fault, Failure> {
        thread::sleep(BETWEEN);
        let lost_before = self.lost();
        let killed = self.crowds[0].followers();
        let mut fault = self.begin_fault(0..1, |rig| {
            let of_commander = rig.commander.iter_mut().map(|(_, edge)| edge);
            for edge in rig.edges.iter_mut().take(1).chain(of_commander) {
                edge.kill()?;
            }
            Ok(())
        })?;
        fault.expected = killed;
        let listen = self.edges[0].address.to_string();
        self.edges[0] = self.start_edge(&listen, Serves::Observers)?;
        if let Some((commander, edge)) = self.commander.take() {
            let edge = self.start_edge(&edge.address.to_string(), Serves::All)?;
            self.commander = Some((commander, edge));
        }
        Ok(self.await_members(&fault, lost_before))
    }

    /// Freezes the last edge for a while.
    fn freeze(&mut self, duration: Duration) -> Result<Fault, Failure> {
        thread::sleep(BETWEEN);
        let edge = self.edges.len() - 1;
        let lost_before = self.lost();
        self.edges[edge].send(Signal::Stop)?;
        thread::sleep(duration);
        let continues = |rig: &mut Self| Ok(rig.edges[edge].send(Signal::Continue)?);
        let fault = self.begin_fault(edge..edge + 1, continues)?;
        Ok(self.await_members(&fault, lost_before))
    }

    /// Kills the router of the edges, and starts it again once the edges are served by the other one.
    fn kill_router(&mut self) -> Result<Option<Fault>, Failure> {
        let fault = self.begin_router_fault(1, Signal::Kill)?;
        if let Some(routers) = &mut self.routers {
            routers.start_again(1)?;
        }
        Ok(fault.map(|(_, back)| back))
    }

    /// Freezes the router to which all have gone for a while.
    fn freeze_router(&mut self, duration: Duration) -> Result<Option<Fault>, Failure> {
        let Some((since, back)) = self.begin_router_fault(0, Signal::Stop)? else {
            return Ok(None);
        };
        thread::sleep(duration.saturating_sub(since.elapsed()));
        self.signal_router(0, Signal::Continue)?;
        Ok(Some(back))
    }

    /// Sends a router a signal, and waits until the members are back; also returns the moment of the signal.
    fn begin_router_fault(
        &mut self,
        router: usize,
        signal: Signal,
    ) -> Result<Option<(Instant, Fault)>, Failure> {
        if self.routers.is_none() {
            return Ok(None);
        }
        thread::sleep(BETWEEN);
        let lost_before = self.lost();
        let fault =
            self.begin_fault(0..self.edges.len(), |rig| rig.signal_router(router, signal))?;
        Ok(Some((fault.since, self.await_members(&fault, lost_before))))
    }

    fn signal_router(&self, router: usize, signal: Signal) -> Result<(), Failure> {
        let mut routers = self.routers.iter();
        routers.try_for_each(|routers| routers.send(router, signal))
    }

    /// Other members of all edges that have lost their connection so far.
    fn lost(&self) -> u64 {
        self.crowds.iter().map(Crowd::lost).sum()
    }

    /// From now on members of these edges note when they are back. What they have then was published after the fault.
    fn begin_fault(
        &mut self,
        edges: Range<usize>,
        fault: impl FnOnce(&mut Self) -> Result<(), Failure>,
    ) -> Result<Begun, Failure> {
        if let Some((commander, _)) = &self.commander {
            commander.take_slowest();
        }
        let since = Instant::now();
        fault(self)?;
        let tick = self.newest_tick()?;
        self.watchers.begin_fault(&edges, since, tick);
        Ok(Begun {
            since,
            edges,
            expected: 0,
        })
    }

    /// Waits until the members of edges are back, and commands are answered.
    fn await_members(&self, fault: &Begun, lost_before: u64) -> Fault {
        let copies = self.arguments.copies as usize * fault.edges.len();
        let crowds = &self.crowds[fault.edges.clone()];
        let lost = || self.lost() - lost_before;
        let is_whole = || crowds.iter().all(|crowd| crowd.absent() == 0);
        let is_crowd_back = || lost() >= fault.expected && is_whole();
        let is_back = || self.watchers.back().len() >= copies && is_crowd_back();
        let commander = self.commander.as_ref().map(|(commander, _)| commander);
        let is_answered =
            || commander.is_none_or(|commander| commander.is_answered_since(fault.since));
        while fault.since.elapsed() < BACK && !(is_back() && is_answered()) {
            thread::sleep(LOOK);
        }
        let back = self.watchers.back();
        let last = back.iter().max().map(Duration::as_secs_f64);
        let crowd_back = crowds.iter().filter_map(Crowd::back_at).max();
        let crowd_back = crowd_back.filter(|_| lost() > 0 && is_crowd_back());
        Fault {
            copies: [back.len(), copies],
            copies_s: last.filter(|_| back.len() >= copies),
            crowd_lost: lost(),
            crowd_s: crowd_back.map(|at| at.saturating_duration_since(fault.since).as_secs_f64()),
            command_s: commander.map(|commander| commander.take_slowest().as_secs_f64()),
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
        let [p50, p99] = self.added_ms.map_or([None; 2], |delay| delay.map(Some));
        let ticks = |ms: Option<f64>| number(ms.map(|ms| ms / self.tick_ms));
        let routers = self.routers.unwrap_or_default();
        let mut rows = vec![
            ("bodies", self.bodies.to_string()),
            ("published tick, ms", number(Some(self.tick_ms))),
            ("routers", routers.to_string()),
            ("edges", self.edges.to_string()),
            ("members of the edges", self.members.to_string()),
            ("packets a tick", number(Some(self.packets))),
        ];
        rows.extend(self.server_rows());
        rows.extend([
            ("edges, us a packet and member", number(self.edge_us)),
            ("routers and hub, us a tick", number(self.routers_us)),
            ("packets delivered, %", number(Some(self.delivered * 100.0))),
            ("packets timed", self.timed.to_string()),
            ("delay added, p50, ms", number(p50)),
            ("delay added, p50, ticks", ticks(p50)),
            ("delay added, p99, ms", number(p99)),
            ("delay added, p99, ticks", ticks(p99)),
            ("members lost", self.lost.to_string()),
        ]);
        rows.retain(|(what, _)| routers > 0 || !what.starts_with("routers"));
        let plain = rows.into_iter();
        let rows = plain.map(|(what, figure)| (what.to_owned(), figure));
        let rows = rows.chain(self.judged.rows("")).chain(self.faults.rows());
        let titles = vec!["what".to_owned(), "figure".to_owned()];
        let rows = rows.map(|(what, figure)| vec![what, figure]);
        std::iter::once(titles).chain(rows).collect()
    }

    fn server_rows(&self) -> [(&'static str, String); 5] {
        let [alone, with] = self.server_us;
        let ratio = alone.zip(with).map(|(alone, with)| with / alone);
        let [sent_alone, sent_with] = self.sent_bytes;
        [
            ("server with one observer, us a tick", number(alone)),
            ("server with the edges, us a tick", number(with)),
            ("ratio", number(ratio)),
            (
                "server with one observer, bytes a tick",
                number(Some(sent_alone)),
            ),
            (
                "server with the edges, bytes a tick",
                number(Some(sent_with)),
            ),
        ]
    }
}

impl Faults {
    fn rows(&self) -> Vec<(String, String)> {
        let faults = [
            ("edge killed", Some(self.killed)),
            ("edge frozen, from its end on", Some(self.frozen)),
            ("router killed", self.router_killed),
            ("router frozen", self.router_frozen),
        ];
        let happened = faults
            .into_iter()
            .filter_map(|(what, fault)| Some((what, fault?)));
        let faults = happened.flat_map(|(what, fault)| fault.rows(what));
        let mut rows: Vec<_> = faults.chain(self.judged.rows("meanwhile: ")).collect();
        if let Some(commanded) = self.commanded {
            let applied = commanded.applied.map(|applied| applied as f64);
            rows.extend([
                ("commands given".to_owned(), commanded.given.to_string()),
                ("commands applied".to_owned(), number(applied)),
                ("commands refused".to_owned(), commanded.refused.to_string()),
            ]);
        }
        rows
    }
}

impl Judged {
    fn rows(&self, when: &str) -> [(String, String); 4] {
        [
            ("bodies of copies compared", self.compared.to_string()),
            ("beyond the tolerance", self.breaches.to_string()),
            ("greatest error, tolerances", number(Some(self.worst))),
            ("checksums that differed", self.mismatches.to_string()),
        ]
        .map(|(what, figure)| (format!("{when}{what}"), figure))
    }
}

impl Fault {
    fn rows(&self, what: &str) -> Vec<(String, String)> {
        let [back, all] = self.copies;
        let mut rows = vec![
            ("copies back", format!("{back} of {all}")),
            ("the last after, s", number(self.copies_s)),
            ("other members lost", self.crowd_lost.to_string()),
            ("longest wait of a command, s", number(self.command_s)),
        ];
        if self.crowd_lost > 0 {
            rows.insert(3, ("all of them back after, s", number(self.crowd_s)));
        }
        let rows = rows.into_iter();
        rows.map(|(row, figure)| (format!("{what}: {row}"), figure))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_there_for_each_fault_that_happened() {
        let fault = Fault {
            copies: [3, 3],
            copies_s: Some(0.5),
            crowd_lost: 7,
            crowd_s: Some(0.25),
            command_s: None,
        };
        let faults = Faults {
            killed: fault,
            frozen: Fault {
                crowd_lost: 0,
                ..fault
            },
            router_killed: None,
            router_frozen: None,
            judged: Judged::default(),
            commanded: None,
        };
        let rows = faults.rows();
        let has = |row: &str, figure: &str| rows.contains(&(row.to_owned(), figure.to_owned()));
        assert!(has("edge killed: copies back", "3 of 3"));
        assert!(has("edge killed: all of them back after, s", "0.250"));
        assert!(!rows.iter().any(|(row, _)| row.starts_with("router")));
        let back = |(row, _): &&(String, String)| row.contains("all of them back");
        assert_eq!(rows.iter().filter(back).count(), 1);
        let behind_routers = Faults {
            router_killed: Some(fault),
            ..faults
        };
        assert_eq!(behind_routers.rows().len(), rows.len() + 5);
    }
}
