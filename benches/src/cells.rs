//! `rhumb-bench cells`: members that take a scene by cells.
//!
//! Bodies walk on a square of 10 by 10 cells and turn at random. Everything runs in this process, in virtual time, over links
//! without loss; bytes are those of datagrams and control stream, without the headers of QUIC. Server time is that from the
//! end of a step to the end of its publication, on the clock of the host: it has all streams, and the copies of packets for
//! members, and no sealing.
//!
//! Of the member that crosses all cells it is checked at each tick that its cells show each of their bodies once, by the
//! positions that the server has. Where a border is near, a body may be in either cell, but is in one.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant as HostInstant;

use bytes::Bytes;
use clap::Args;
use glam::Vec3;
use rhumb_netsim::{Direction, Lane, LinkConfig, SimNetwork};
use rhumb_protocol::limits::CELLS_PER_MEMBER_MAX;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{
    BodyDesc, Cell, CellGrid, Command, SceneConfig, SceneName, Shape, ShapeId, Stepping,
};
use rhumb_protocol::session::{ClientSession, Event, Misuse};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{BodyId, Metres, Tolerance};
use rhumb_scene::{
    Limits, ObserveScenes, ProvidedScene, ProvidedScenes, Scene, SceneObserver, SceneRouter,
    SceneScript, SceneSettings, TickMetrics,
};
use serde::{Deserialize, Serialize};

use crate::numbers::number;
use crate::output::{self, Failure, Provenance, ended, write};

/// Cells along each side.
const SIDE: u32 = 10;
/// Metres along a cell.
const EDGE: f32 = 50.0;
/// Metres a second.
const SPEED: f32 = 1.5;
/// A body turns once in so many ticks, on average.
const TURNS: usize = 60;
const TICKS_PER_SECOND: u64 = 60;
/// Seconds before the measurement: snapshots are over.
const SETTLING: u64 = 2;
/// Ticks within which an answer of the server has come: a server that snapshots keep busy answers late.
const ANSWERED: u64 = 600;
/// Metres a second of a member that crosses all cells.
const CROSSING_SPEED: f32 = 100.0;
/// Members that take empty cells: together as many as a scene has.
const EMPTY_MEMBERS: usize = 16;
/// Ticks after which it takes the cells around it anew.
const TAKES_EACH: u64 = 6;
const NAME: &str = "walkers";

type Network = SimNetwork<SceneRouter, ClientSession>;

/// Arguments: bodies, seconds, output.
#[derive(Clone, Debug, Args)]
pub struct CellArguments {
    /// Bodies on the 100 cells.
    #[arg(long, default_value = "50000", value_parser = clap::value_parser!(u32).range(100..=100_000))]
    bodies: u32,
    /// Seconds of the scene that are measured, for each kind of member.
    #[arg(long, default_value = "5", value_parser = clap::value_parser!(u64).range(1..=600))]
    seconds: u64,
    /// Only the member that crosses all cells.
    #[arg(long)]
    crossing: bool,
    /// Seed of the walks.
    #[arg(long, default_value = "1")]
    seed: u64,
    /// Folder for cells.json; created if missing.
    #[arg(long, default_value = "results/cells")]
    out: PathBuf,
}

/// Content of `cells.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CellFigures {
    /// Source of the figures.
    #[serde(flatten)]
    pub provenance: Provenance,
    /// A row for each kind of member.
    pub rows: Vec<CellRow>,
}

/// The figures of members of one kind.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CellRow {
    /// Their choice of cells.
    pub what: String,
    /// Their number.
    pub members: usize,
    /// Bodies that one of them shows.
    pub bodies: usize,
    /// Datagrams of one of them, bytes a second.
    pub datagram_bytes: f64,
    /// Control stream of one of them, bytes a second.
    pub control_bytes: f64,
    /// Server time of a tick without the step, milliseconds.
    pub publish_ms: f64,
    /// Faults of all ticks; `None` where they are not looked for.
    pub shown: Option<ShownBodies>,
}

/// Bodies that the cells of a member show, once a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ShownBodies {
    /// Ticks at which they were looked for.
    pub ticks: u64,
    /// Bodies that have to be shown.
    pub expected: u64,
    /// Those that are not.
    pub missing: u64,
    /// Bodies that are shown twice.
    pub double: u64,
    /// Bodies that are elsewhere.
    pub stray: u64,
}

/// Runs the measurement. Exit code 0 if everything was measured and written, 1 otherwise.
pub fn cells(arguments: &CellArguments) -> ExitCode {
    ended(measure_all(arguments))
}

/// The choice of a member.
#[derive(Clone, Copy)]
enum Taken {
    Nothing,
    Whole,
    /// Bands around the middle of the square.
    Bands(&'static [(f64, f64)]),
    /// As many cells as it may, all beyond the square: no other member takes them.
    Empty,
}

/// Nine cells within 1 cm: those around the middle of a cell.
const NINE: Taken = Taken::Bands(&[(36.0, 0.01)]);
/// Nine cells within 1 cm, and all others within two more cells at 20 cm.
const NEAR_AND_FAR: Taken = Taken::Bands(&[(36.0, 0.01), (110.0, 0.2)]);

fn measure_all(arguments: &CellArguments) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let kinds = [
        ("none", Taken::Nothing, 1),
        ("the whole scene", Taken::Whole, 1),
        ("nine cells", NINE, 1),
        ("nine cells", NINE, 64),
        ("near and far", NEAR_AND_FAR, 1),
        ("256 empty cells each", Taken::Empty, EMPTY_MEMBERS),
    ];
    let kinds: &[_] = if arguments.crossing { &[] } else { &kinds[..] };
    let bar = output::progress_bar(kinds.len() as u64 + 1, "cells".to_owned());
    let mut rows = Vec::new();
    for &(what, taken, members) in kinds {
        let row = measure(arguments, (what, taken), members)?;
        output::note(&bar, &row.line().join("  "));
        rows.push(row);
        bar.inc(1);
    }
    for row in measure_crossing(arguments)? {
        output::note(&bar, &row.line().join("  "));
        rows.push(row);
    }
    bar.finish_and_clear();
    let figures = CellFigures {
        provenance: Provenance::here(),
        rows,
    };
    let tables = [("members by cells", figures.table())];
    Ok(write(&arguments.out, "cells.json", &figures, &tables)?)
}

impl CellFigures {
    fn table(&self) -> Vec<Vec<String>> {
        let titles = [
            "takes",
            "members",
            "bodies",
            "datagrams, kB/s",
            "control, kB/s",
            "publish, ms",
            "missing, double, stray",
        ];
        let mut rows = vec![titles.map(str::to_owned).to_vec()];
        rows.extend(self.rows.iter().map(CellRow::line));
        rows
    }
}

impl CellRow {
    fn line(&self) -> Vec<String> {
        vec![
            self.what.clone(),
            self.members.to_string(),
            self.bodies.to_string(),
            number(Some(self.datagram_bytes / 1e3)),
            number(Some(self.control_bytes / 1e3)),
            number(Some(self.publish_ms)),
            self.shown.map_or_else(|| number(None), ShownBodies::text),
        ]
    }
}

impl ShownBodies {
    fn text(self) -> String {
        let Self {
            ticks,
            expected,
            missing,
            double,
            stray,
        } = self;
        format!("{missing}, {double}, {stray} of {expected} at {ticks} ticks")
    }

    /// Looks at what a member shows now.
    fn look(&mut self, session: &ClientSession, grid: &CellGrid, positions: &[Vec3]) {
        let mut shown = BTreeMap::new();
        for (_, copy) in session.cells() {
            for id in copy.bodies().filter_map(|body| copy.id_in_scene(body.id)) {
                *shown.entry(id.index()).or_insert(0_u32) += 1;
            }
        }
        let cells: BTreeSet<Cell> = session.cells().map(|(cell, _)| cell).collect();
        let margin = EDGE / 16.0;
        let around = [-margin, margin].map(|x| [-margin, margin].map(|z| Vec3::new(x, 0.0, z)));
        self.ticks += 1;
        self.double += shown.values().filter(|count| **count > 1).count() as u64;
        for (index, at) in (0..).zip(positions) {
            let around = around.as_flattened().iter();
            let inside = around.filter(|offset| cells.contains(&grid.cell_of(*at + **offset)));
            let (inside, is_shown) = (inside.count(), shown.contains_key(&index));
            self.expected += u64::from(inside == 4);
            self.missing += u64::from(inside == 4 && !is_shown);
            self.stray += u64::from(inside == 0 && is_shown);
        }
    }
}

fn measure(
    arguments: &CellArguments,
    (what, taken): (&str, Taken),
    members: usize,
) -> Result<CellRow, Failure> {
    let (mut network, grid, publish) = walking(arguments)?;
    let mut clients = Vec::new();
    for _ in 0..members {
        clients.push(enter(&mut network, taken)?);
    }
    if let Taken::Bands(bands) = taken {
        let middle = middle_of(SIDE / 2, SIDE / 2);
        for client in &clients {
            take(&mut network, *client, (&grid, middle), bands)?;
        }
    }
    if let Taken::Empty = taken {
        let choice = choice(0.01)?;
        for (member, client) in (1..).zip(&clients) {
            let beyond = |along| Cell([along, 0, -member]);
            let cells = (0..CELLS_PER_MEMBER_MAX as i32).map(|along| (beyond(along), choice));
            let cells = cells.collect();
            once_allowed(&mut network, *client, |client| client.take_cells(&cells))?;
        }
    }
    run(&mut network, SETTLING * TICKS_PER_SECOND);
    publish.restart();
    let first = *clients.first().ok_or("no member")?;
    let before = received(&network, first);
    run(&mut network, arguments.seconds * TICKS_PER_SECOND);
    let members = match taken {
        Taken::Nothing => 0,
        Taken::Whole | Taken::Bands(_) | Taken::Empty => members,
    };
    let seconds = arguments.seconds as f64;
    let row = row_of(&network, first, (before, seconds), &publish);
    Ok(CellRow {
        what: what.to_owned(),
        members,
        ..row
    })
}

/// A member crosses all cells on end, row after row, and takes the nine around it; beside it is one of the whole scene.
fn measure_crossing(arguments: &CellArguments) -> Result<[CellRow; 2], Failure> {
    let (mut network, grid, publish) = walking(arguments)?;
    let whole = enter(&mut network, Taken::Whole)?;
    let crossing = enter(&mut network, NINE)?;
    let Taken::Bands(bands) = NINE else {
        return Err("no bands".into());
    };
    take(&mut network, crossing, (&grid, middle_of(0, 0)), bands)?;
    run(&mut network, SETTLING * TICKS_PER_SECOND);
    publish.restart();
    let before = [whole, crossing].map(|client| received(&network, client));
    let cells = (SIDE * SIDE) as usize;
    // Each second row is crossed the other way.
    let place = |step: usize| {
        let (row, along) = (step as u32 / SIDE, step as u32 % SIDE);
        let along = if row % 2 == 0 {
            along
        } else {
            SIDE - 1 - along
        };
        middle_of(along, row)
    };
    let length = (cells - 1) as f32 * EDGE;
    let step = CROSSING_SPEED * TAKES_EACH as f32 / TICKS_PER_SECOND as f32;
    let mut gone = 0.0;
    let mut seconds = 0.0;
    let mut shown = ShownBodies::default();
    while gone < length {
        gone = (gone + step).min(length);
        let from = ((gone / EDGE) as usize).min(cells - 2);
        let at = place(from).lerp(place(from + 1), gone / EDGE - from as f32);
        take(&mut network, crossing, (&grid, at), bands)?;
        for _ in 0..TAKES_EACH {
            run(&mut network, 1);
            shown.look(network.client(crossing), &grid, &publish.positions());
        }
        seconds += TAKES_EACH as f64 / TICKS_PER_SECOND as f64;
    }
    let row = |client, before, what: &str| CellRow {
        what: what.to_owned(),
        ..row_of(&network, client, (before, seconds), &publish)
    };
    let crossed = row(crossing, before[1], "nine cells, crossing");
    Ok([
        CellRow {
            shown: Some(shown),
            ..crossed
        },
        row(whole, before[0], "the whole scene beside it"),
    ])
}

/// The figures of one member since it had received so many bytes.
fn row_of(
    network: &Network,
    client: usize,
    (before, seconds): ((u64, u64), f64),
    publish: &PublishTimes,
) -> CellRow {
    let after = received(network, client);
    let session = network.client(client);
    let of_scene = session.replica().map_or(0, |copy| copy.bodies().count());
    let of_cells: usize = session.cells().map(|(_, copy)| copy.bodies().count()).sum();
    CellRow {
        what: String::new(),
        members: 1,
        bodies: of_scene + of_cells,
        datagram_bytes: (after.0 - before.0) as f64 / seconds,
        control_bytes: (after.1 - before.1) as f64 / seconds,
        publish_ms: publish.mean_ms(),
        shown: None,
    }
}

/// The scene, its grid, and its times.
fn walking(arguments: &CellArguments) -> Result<(Network, CellGrid, Arc<PublishTimes>), Failure> {
    let publish = Arc::new(PublishTimes::default());
    let grid = CellGrid::columns(Metres::new(f64::from(EDGE))).ok_or("no such grid")?;
    let router = SceneRouter::new(settings(arguments, grid, &publish));
    let network = Network::new(router, LinkConfig::PERFECT, arguments.seed);
    Ok((network, grid, publish))
}

/// The middle of a cell.
fn middle_of(x: u32, z: u32) -> Vec3 {
    let middle = |place: u32| (place as f32 + 0.5) * EDGE;
    Vec3::new(middle(x), 0.0, middle(z))
}

/// A member takes the cells around a point.
fn take(
    network: &mut Network,
    client: usize,
    (grid, at): (&CellGrid, Vec3),
    bands: &[(f64, f64)],
) -> Result<(), Failure> {
    let within = |(radius, metres): &(f64, f64)| Ok((Metres::new(*radius), choice(*metres)?));
    let bands: Result<Vec<_>, Failure> = bands.iter().map(within).collect();
    let cells = grid.within(at, &bands?)?.ok_or("too many cells")?;
    once_allowed(network, client, |client| client.take_cells(&cells))
}

/// A client joins. One that takes nothing takes cells, and asks for none.
fn enter(network: &mut Network, taken: Taken) -> Result<usize, Failure> {
    let index = network.connect(ClientSession::new(NAME.parse()?));
    if !matches!(taken, Taken::Whole) {
        once_allowed(network, index, ClientSession::join_cells)?;
    }
    let choice = choice(0.01)?;
    once_allowed(network, index, |client| client.join(choice))?;
    Ok(index)
}

/// Acts as soon as the answers before have come.
fn once_allowed(
    network: &mut Network,
    index: usize,
    mut act: impl FnMut(&mut ClientSession) -> Result<(), Misuse>,
) -> Result<(), Failure> {
    for _ in 0..ANSWERED {
        while let Some(event) = network.client_mut(index).poll_event() {
            if let Event::Denied(denial) = event {
                return Err(denial.to_string().into());
            }
        }
        match act(network.client_mut(index)) {
            Err(Misuse::NotNow) => run(network, 1),
            acted => return Ok(acted?),
        }
    }
    Err("the server gave no answer".into())
}

fn choice(metres: f64) -> Result<StreamChoice, Failure> {
    let tolerance = Tolerance::from_metres(Metres::new(metres))?;
    Ok(StreamChoice::Within(tolerance))
}

fn run(network: &mut Network, ticks: u64) {
    let span = Span::from_nanos(ticks * 1_000_000_000 / TICKS_PER_SECOND);
    network.run_until(network.now() + span);
}

/// Bytes of datagrams and of the control stream.
fn received(network: &Network, client: usize) -> (u64, u64) {
    let bytes = |lane| network.counts(client, Direction::Down, lane).pushed.bytes;
    (bytes(Lane::State), bytes(Lane::Control))
}

fn settings(
    arguments: &CellArguments,
    grid: CellGrid,
    publish: &Arc<PublishTimes>,
) -> SceneSettings {
    let began = HostInstant::now();
    let clock = move || Instant::from_nanos(began.elapsed().as_nanos() as u64);
    let (bodies, seed) = (arguments.bodies, arguments.seed);
    let provided = ProvidedScenes::new(move |_| {
        Some(ProvidedScene {
            config: SceneConfig {
                stepping: Stepping::FreeRunning,
                ..SceneConfig::default()
            },
            script: walkers(bodies, seed),
        })
    });
    SceneSettings {
        limits: Limits {
            scene_load: u64::MAX,
            server_load: u64::MAX,
            tenant_load: u64::MAX,
            ..Limits::default()
        },
        cells: Some(grid),
        provided: Some(provided),
        observers: Arc::new(Observers(Arc::clone(publish))),
        ..SceneSettings::new(clock)
    }
}

/// Bodies that walk straight on, and turn at random and at the border.
fn walkers(bodies: u32, seed: u64) -> SceneScript {
    let mut state = seed;
    let mut is_there = false;
    SceneScript::new(move |scene: &Scene, commands: &mut Vec<Command>| {
        let width = EDGE * SIDE as f32;
        let mut part = || random_part(&mut state);
        if !is_there {
            is_there = true;
            let shape = Shape::capsule(0.6, 0.3);
            let walker = BodyDesc::kinematic(shape.clone());
            commands.push(Command::AddShape {
                id: ShapeId(0),
                shape,
            });
            for index in (0..bodies).rev() {
                let walker = walker.clone().at(part() * width, 0.9, part() * width);
                if let Ok(motion) = walker.state() {
                    let desc = walker.desc(BodyId::new(index, 0), ShapeId(0));
                    commands.push(Command::AddBody { desc, motion });
                }
            }
        }
        for _ in 0..bodies as usize / TURNS {
            let id = BodyId::new((part() * (bodies - 1) as f32) as u32, 0);
            let Some(there) = scene.observation(id) else {
                continue;
            };
            let turn = part() * core::f32::consts::TAU;
            let [x, _, z] = there.motion.position();
            let towards = |at: f32, way: f32| {
                if (0.0..width).contains(&at) {
                    way
                } else {
                    (width / 2.0 - at).signum()
                }
            };
            let linear = Vec3::new(towards(x, turn.cos()), 0.0, towards(z, turn.sin())) * SPEED;
            let angular = Vec3::ZERO;
            commands.push(Command::SetVelocity {
                id,
                linear,
                angular,
            });
        }
    })
}

/// A number from 0 to below 1. Source: Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014, figure 17.
fn random_part(state: &mut u64) -> f32 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mixed = (*state ^ (*state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((mixed ^ (mixed >> 31)) >> 40) as f32 / (1 << 24) as f32
}

/// Times of publication.
#[derive(Debug, Default)]
struct PublishTimes {
    nanoseconds: AtomicU64,
    ticks: AtomicU64,
    /// Of the bodies at the newest tick, by index.
    positions: Mutex<Vec<Vec3>>,
}

impl PublishTimes {
    fn restart(&self) {
        self.nanoseconds.store(0, Ordering::Relaxed);
        self.ticks.store(0, Ordering::Relaxed);
    }

    fn positions(&self) -> MutexGuard<'_, Vec<Vec3>> {
        (self.positions.lock()).unwrap_or_else(PoisonError::into_inner)
    }

    fn mean_ms(&self) -> f64 {
        let ticks = self.ticks.load(Ordering::Relaxed).max(1);
        self.nanoseconds.load(Ordering::Relaxed) as f64 / ticks as f64 / 1e6
    }
}

struct Observers(Arc<PublishTimes>);

impl ObserveScenes for Observers {
    fn begin(&self, _: &SceneName, _: Span) -> Box<dyn SceneObserver> {
        Box::new(Observer(Arc::clone(&self.0)))
    }
}

struct Observer(Arc<PublishTimes>);

impl SceneObserver for Observer {
    fn stepped(
        &mut self,
        metrics: &TickMetrics,
        scene: &Scene,
        _: &mut dyn Iterator<Item = &Bytes>,
    ) {
        let times = &self.0;
        let mut positions = times.positions();
        for observation in scene.observations() {
            let index = observation.id.index() as usize;
            if index >= positions.len() {
                positions.resize(index + 1, Vec3::ZERO);
            }
            positions[index] = Vec3::from_array(observation.motion.position());
        }
        times
            .nanoseconds
            .fetch_add(metrics.publish.as_nanos(), Ordering::Relaxed);
        times.ticks.fetch_add(1, Ordering::Relaxed);
    }
}
