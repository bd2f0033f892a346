//! The bound that each language states is about the pose that it shows.
//!
//! A program in each language makes random calls, and writes what its view shows with the bound. A hook of the server
//! keeps the truth of every tick. No shown point may be farther from its true place than the bound.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::process::Command;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use glam::{DQuat, DVec3};
use rhumb_protocol::scene::CellGrid;
use rhumb_reckoning::{BodyId, Metres, Pose};
use rhumb_scene::{Hook, Hooks, Scene};
use rhumb_server::{Access, Identity, RunError, Server, ServerStatistics, Stop};
use rhumb_transport::Fingerprint;
use tempfile::TempDir;

use super::c::{Compiled, Linked};
use super::csharp::Assembly;
use super::python::Package;
use super::{has, has_all, root, run_well};

/// Calls of each run.
const CALLS: u64 = 400;
/// Seeds of each language and stepping; `SEEDS=n` tries more.
const SEEDS: u64 = 2;
/// Metres along the edge of a cell: the floor is larger than half of it, and no other body is.
const CELL_EDGE: f64 = 4.0;
/// Metres that rounding to single precision may cost.
const ROUNDING: f64 = 1e-4;

/// How a program takes its scene.
#[derive(Clone, Copy)]
struct Run {
    stepping: &'static str,
    /// `whole` or `cells`.
    extent: &'static str,
}

/// Every stepping with every extent.
const RUNS: [Run; 4] = [
    Run {
        stepping: "lockstep",
        extent: "whole",
    },
    Run {
        stepping: "free running",
        extent: "whole",
    },
    Run {
        stepping: "lockstep",
        extent: "cells",
    },
    Run {
        stepping: "free running",
        extent: "cells",
    },
];

/// The pose of every body, and the radius about it that its shape reaches, by tick.
type TrueTicks = BTreeMap<u64, BTreeMap<BodyId, (Pose, f64)>>;

/// The same by scene.
type Truth = Arc<Mutex<BTreeMap<String, TrueTicks>>>;

/// A server on a thread of this process, and the truth of its scenes.
struct TruthfulServer {
    address: SocketAddr,
    fingerprint: Fingerprint,
    truth: Truth,
    /// Its Unix socket, for Node, which has no QUIC.
    folder: TempDir,
    stop: Stop,
    thread: Option<JoinHandle<Result<ServerStatistics, RunError>>>,
}

impl TruthfulServer {
    fn start() -> Self {
        let truth = Truth::default();
        let loopback = SocketAddr::from(([127, 0, 0, 1], 0));
        let server = Server::bind(loopback, &Identity::Development, Access::OpenOnLoopback);
        let mut server = server.expect("a free port");
        let of_hooks = Arc::clone(&truth);
        server.scenes.hooks = Some(Hooks::new(move |name, _| {
            let (truth, name) = (Arc::clone(&of_hooks), name.to_string());
            Some(Hook::new(move |scene, _| keep(&truth, &name, scene)))
        }));
        let folder = TempDir::new().expect("a folder for the socket");
        server.scenes.cells = CellGrid::columns(Metres::new(CELL_EDGE));
        server
            .listen_at(&folder.path().join("rhumb.sock"))
            .expect("a new socket");
        let (address, fingerprint) = (server.address(), server.fingerprint());
        let stop = Stop::new();
        let thread = thread::spawn({
            let stop = stop.clone();
            move || server.run(&stop)
        });
        Self {
            address,
            fingerprint,
            truth,
            folder,
            stop,
            thread: Some(thread),
        }
    }

    /// Arguments of a program.
    fn arguments(&self, scene: &str, seed: u64, run: Run) -> [String; 7] {
        [
            self.address.to_string(),
            self.fingerprint.to_string(),
            scene.to_owned(),
            seed.to_string(),
            CALLS.to_string(),
            run.stepping.to_owned(),
            run.extent.to_owned(),
        ]
    }
}

impl Drop for TruthfulServer {
    fn drop(&mut self) {
        self.stop.stop();
        if let Some(thread) = self.thread.take() {
            // A failure of the server has failed the programs already.
            let _ended = thread.join();
        }
    }
}

/// Keeps the truth of the last step.
fn keep(truth: &Truth, name: &str, scene: &Scene) {
    let mut observations = Vec::new();
    scene.observe_all(&mut observations);
    let poses = observations.iter().map(|observation| {
        let position = DVec3::from_array(observation.motion.position().map(f64::from));
        let rotation = DQuat::from_array(observation.motion.rotation().map(f64::from));
        let desc = scene.body(observation.id).expect("an observed body");
        let shape = scene.shape(desc.shape).expect("a body has a shape");
        let radius = shape.bounding_radius().metres();
        (observation.id, (Pose { position, rotation }, radius))
    });
    let mut truth = truth.lock().unwrap_or_else(PoisonError::into_inner);
    let ticks = truth.entry(name.to_owned()).or_default();
    ticks.insert(scene.tick().value(), poses.collect());
}

/// The contents of a line.
struct ShownLine {
    tick: u64,
    fraction: f64,
    body: BodyId,
    pose: Pose,
    bound: f64,
}

impl ShownLine {
    fn parse(line: &str) -> Self {
        let words: Vec<_> = line.split(' ').collect();
        let number = |place: usize| words[place].parse::<f64>().expect("a number");
        let word = words[2].parse().expect("a body");
        Self {
            tick: words[0].parse().expect("a tick"),
            fraction: number(1),
            body: rhumb_bindings::parse_packed_id(word).expect("a body"),
            pose: Pose {
                position: DVec3::new(number(3), number(4), number(5)),
                rotation: DQuat::from_xyzw(number(6), number(7), number(8), number(9)),
            },
            bound: number(10),
        }
    }

    /// How far a point of the body is from its true place; infinite where the truth has no such body, and `None` where the
    /// truth of the moment is not kept.
    fn error(&self, ticks: &TrueTicks) -> Option<f64> {
        let Some((first, radius)) = ticks.get(&self.tick)?.get(&self.body) else {
            // The hook runs after the commands between two ticks: one of them may have removed the body, or added it and
            // removed it again. One that was removed earlier must not be there.
            let (before, last) = (
                self.tick.checked_sub(1)?,
                |(_, bodies): (_, &BTreeMap<_, _>)| bodies.contains_key(&self.body),
            );
            let is_late = !ticks.get(&before)?.contains_key(&self.body);
            return (is_late && ticks.range(..before).any(last)).then_some(f64::INFINITY);
        };
        let truth = match self.fraction {
            0.0 => *first,
            fraction => {
                // The truth of a body that is gone at the next tick ends with this one.
                let (second, _) = ticks.get(&(self.tick + 1))?.get(&self.body)?;
                Pose {
                    position: first.position.lerp(second.position, fraction),
                    rotation: first.rotation.slerp(second.rotation, fraction),
                }
            }
        };
        let points = (0..8).map(|bits: u8| {
            let side = |bit: u8| if bits & bit == 0 { -1.0 } else { 1.0 };
            DVec3::new(side(1), side(2), side(4)).normalize() * *radius
        });
        let place = |pose: &Pose, point| pose.position + pose.rotation * point;
        let errors = points.map(|point| place(&truth, point).distance(place(&self.pose, point)));
        errors.reduce(f64::max)
    }
}

/// Judges what programs of a language write; `run` gives it for arguments.
fn judge(language: &str, run: impl Fn(&[String; 7]) -> String) {
    judge_on(&TruthfulServer::start(), language, run);
}

fn judge_on(server: &TruthfulServer, language: &str, run: impl Fn(&[String; 7]) -> String) {
    let seeds = std::env::var("SEEDS").map_or(SEEDS, |seeds| seeds.parse().expect("a number"));
    let (mut lines, mut finite, mut misses) = (0_u64, 0_u64, Vec::new());
    for (seed, each) in (1..=seeds).flat_map(|seed| RUNS.map(|run| (seed, run))) {
        let stepping = each.stepping.replace(' ', "-");
        let scene = format!("{language}/{stepping}/{}/{seed}", each.extent);
        let written = run(&server.arguments(&scene, seed, each));
        let truth = server.truth.lock().unwrap_or_else(PoisonError::into_inner);
        let ticks = &truth[&scene];
        for line in written.lines() {
            let shown = ShownLine::parse(line);
            let Some(error) = shown.error(ticks) else {
                continue;
            };
            lines += 1;
            finite += u64::from(shown.bound.is_finite());
            if error > shown.bound + ROUNDING {
                misses.push(format!("{scene}: {error} m off: {line}"));
            }
        }
    }
    eprintln!(
        "{language}: {seeds} seeds of {CALLS} calls in each way, {lines} poses, {finite} finite bounds, {} misses",
        misses.len()
    );
    assert!(
        misses.is_empty(),
        "{language}: {} misses, the first: {}",
        misses.len(),
        misses[0]
    );
    assert!(
        finite > lines / 4 && finite > 100,
        "{finite} finite bounds of {lines}"
    );
}

#[test]
fn a_stated_bound_holds_for_the_shown_pose_in_c() {
    if let Some(program) = Compiled::new("tests/shown.c", Linked::Shared) {
        judge("c", |arguments| program.run_on(arguments));
    }
}

#[test]
fn a_stated_bound_holds_for_the_shown_pose_in_python() {
    if let Some(package) = Package::new() {
        judge("python", |arguments| {
            package.run_on("tests/shown.py", arguments)
        });
    }
}

#[test]
fn a_stated_bound_holds_for_the_shown_pose_in_csharp() {
    if let Some(program) = Assembly::new("tests/Shown.cs") {
        judge("csharp", |arguments| program.run_on(arguments));
    }
}

/// Node with a program of `bindings/web/test`, the client of browsers and a server's socket; `None`, with a line that says so,
/// without one of them.
fn in_node(program: &str, server: &TruthfulServer) -> Option<Command> {
    // The client of browsers is built with the page, where the system has its target.
    let module = rhumb_viewer::asset("/client/rhumb.wasm");
    let module = module.filter(|_| has("node"));
    if !has_all("Node and the client of browsers", module.is_some()) {
        return None;
    }
    let wasm = server.folder.path().join("rhumb.wasm");
    std::fs::write(&wasm, module?.bytes).expect("a file of its own");
    let mut node = Command::new("node");
    node.arg(root().join("bindings/web/test").join(program));
    node.args([wasm, server.folder.path().join("rhumb.sock")]);
    Some(node)
}

#[test]
fn a_stated_bound_holds_for_the_shown_pose_in_javascript() {
    let server = TruthfulServer::start();
    if in_node("shown.mjs", &server).is_some() {
        judge_on(&server, "javascript", |[_, _, of_run @ ..]| {
            let node = in_node("shown.mjs", &server);
            run_well(node.expect("it is there").args(of_run))
        });
    }
}

#[test]
fn a_member_by_cells_shows_what_it_takes_in_javascript() {
    let server = TruthfulServer::start();
    if let Some(mut node) = in_node("cells.mjs", &server) {
        assert_eq!(run_well(&mut node), "the cells around were shown\n");
    }
}
