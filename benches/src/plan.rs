//! `rhumb-bench plan`: the machines that a service needs, and its first limit.
//!
//! Draws where members are, places scenes on servers and members on edges, and adds up. The costs are arguments: their
//! defaults were measured, and `rhumb-bench load` and `cost` measure those of other scenes. No packet is simulated, and a
//! cost is taken to grow in proportion to what causes it. Invariant: a plan is a function of its arguments.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use rand_pcg::Pcg32;
use rand_pcg::rand_core::Rng;
use serde::{Deserialize, Serialize};

use crate::numbers::{dash, number};
use crate::output::{self, Failure, Provenance, ended, write};

/// Most times the members that are tried for the limit that is reached first.
const GROWTH_MAX: u32 = 1 << 16;
/// Machines that a scene is tried on before a new one is taken, newest first.
const OPEN_MAX: usize = 64;
/// Allowed for the rounding of sums of shares.
const ROUNDING: f64 = 1e-9;

/// Arguments: the service, its costs, its machines, output.
#[derive(Clone, Debug, Args)]
pub struct PlanArguments {
    #[command(flatten)]
    service: ServiceArguments,
    #[command(flatten)]
    costs: Costs,
    #[command(flatten)]
    machine: Machine,
    /// Seed of the members' places.
    #[arg(long, default_value = "1")]
    seed: u64,
    /// Folder for plan.json; created if missing.
    #[arg(long, default_value = "results/plan")]
    out: PathBuf,
}

/// The service: members, scenes, regions.
#[derive(Clone, Debug, Args)]
struct ServiceArguments {
    /// Members of all scenes together.
    #[arg(long, default_value = "100000", value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    members: u32,
    /// Number of scenes.
    #[arg(long, default_value = "10000", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    scenes: u32,
    /// Members of each region in proportion to each other, as 5,3,2.
    #[arg(long, value_delimiter = ',', default_value = "1,1,1", value_parser = at_least_zero)]
    regions: Vec<f64>,
    /// Exponent of Zipf's law for the members of scenes: at 0 all have alike, at 1 the tenth has a tenth of the first.
    #[arg(long, default_value = "0.8", value_parser = at_least_zero)]
    popularity: f64,
    /// Share of a scene's members who are in the scene's own region; the others are anywhere.
    #[arg(long, default_value = "0.7", value_parser = share)]
    at_home: f64,
    /// Share of the members who only observe: an edge serves these without its owner.
    #[arg(long, default_value = "0.9", value_parser = share)]
    observers: f64,
}

/// Costs as measured.
#[derive(Clone, Debug, Args, Serialize, Deserialize)]
struct Costs {
    /// Processor cores of a scene with its engine and one member: `cores` of `rhumb-bench load`, over its scenes.
    #[arg(long, default_value = "0.028", value_parser = at_least_zero)]
    scene_cores: f64,
    /// Memory of a scene, megabytes: `MB` of `rhumb-bench load`, over its scenes.
    #[arg(long, default_value = "6.4", value_parser = at_least_zero)]
    scene_mb: f64,
    /// Memory of one more member of a server or an edge, megabytes.
    #[arg(long, default_value = "0.2", value_parser = at_least_zero)]
    member_mb: f64,
    /// UDP payload to a member, kbit/s: the last line of `rhumb-bench load`.
    #[arg(long, default_value = "15.1", value_parser = at_least_zero)]
    member_kbit: f64,
    /// Datagrams to a member in a second.
    #[arg(long, default_value = "26", value_parser = at_least_zero)]
    datagrams: f64,
    /// Processor time of a datagram to one more member, microseconds: `one more us` of `rhumb-bench cost`.
    #[arg(long, default_value = "18.7", value_parser = at_least_zero)]
    datagram_us: f64,
}

/// A machine with one server or one edge.
#[derive(Clone, Debug, Args, Serialize, Deserialize)]
struct Machine {
    /// Its processor cores. One of them is for all of its sockets.
    #[arg(long, default_value = "16", value_parser = above_zero)]
    cores: f64,
    /// Its network, Gbit/s outwards.
    #[arg(long, default_value = "10", value_parser = above_zero)]
    gbit: f64,
    /// Its memory, gigabytes.
    #[arg(long, default_value = "32", value_parser = above_zero)]
    gb: f64,
    /// Share of cores, network and memory that may be in use.
    #[arg(long, default_value = "0.6", value_parser = share_above_zero)]
    full: f64,
    /// Scenes of one server at most (limit `scenes`).
    #[arg(long, default_value = "256", value_parser = clap::value_parser!(u32).range(1..))]
    server_scenes: u32,
    /// Connections of one server at most: those of members, and of edges for each of their scenes.
    #[arg(long, default_value = "1024", value_parser = clap::value_parser!(u32).range(1..))]
    server_connections: u32,
    /// Members of one edge at most.
    #[arg(long, default_value = "1024", value_parser = clap::value_parser!(u32).range(1..))]
    edge_members: u32,
    /// Streams of one edge at most, over all of its scenes.
    #[arg(long, default_value = "256", value_parser = clap::value_parser!(u32).range(1..))]
    edge_streams: u32,
}

fn at_least_zero(text: &str) -> Result<f64, String> {
    within(text, "a number of at least 0", |value| value >= 0.0)
}

fn above_zero(text: &str) -> Result<f64, String> {
    within(text, "a number above 0", |value| value > 0.0)
}

fn share(text: &str) -> Result<f64, String> {
    within(text, "a share from 0 to 1", |value| {
        (0.0..=1.0).contains(&value)
    })
}

fn share_above_zero(text: &str) -> Result<f64, String> {
    within(text, "a share above 0, up to 1", |value| {
        value > 0.0 && value <= 1.0
    })
}

fn within(text: &str, what: &str, is_right: fn(f64) -> bool) -> Result<f64, String> {
    let value = text
        .parse()
        .ok()
        .filter(|value: &f64| value.is_finite() && is_right(*value));
    value.ok_or_else(|| format!("it has to be {what}"))
}

/// Computes a plan. Exit code 0 if it was written, 1 otherwise.
pub fn plan(arguments: &PlanArguments) -> ExitCode {
    ended(run(arguments))
}

fn run(arguments: &PlanArguments) -> Result<(), Failure> {
    let service = &arguments.service;
    if service.regions.iter().sum::<f64>() <= 0.0 {
        return Err("--regions: no region has members; give at least one a share above 0".into());
    }
    let shares = Shares::of(&arguments.costs, &arguments.machine);
    if shares.observers_in(Use::default()) < 1.0 {
        return Err("a machine serves no member: give it more --cores, --gbit, --gb, --full or --edge-members".into());
    }
    output::make_folder(&arguments.out)?;
    let plan = Plan::of(arguments, &shares);
    let tables = [
        ("what it takes", plan.rows()),
        ("the limit that is reached first", plan.limits()),
    ];
    Ok(write(&arguments.out, "plan.json", &plan, &tables)?)
}

/// Content of `plan.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Source of the figures.
    #[serde(flatten)]
    pub provenance: Provenance,
    /// Members of the scene that has most.
    pub largest_scene: u32,
    /// All members at the servers.
    pub direct: Fleet,
    /// Observers at edges of their region.
    pub edges: Fleet,
}

/// The machines of one way to serve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fleet {
    /// Machines with scenes.
    pub servers: Machines,
    /// Machines with members alone.
    pub edges: Machines,
    /// Datagrams to members, edges included, in a second.
    pub datagrams_s: f64,
    /// To members and edges, Gbit/s with the headers of IPv4 and UDP.
    pub gbit_s: f64,
    /// Of this, between regions, Gbit/s.
    pub between_gbit_s: f64,
    /// Scenes that no server holds.
    pub too_large: u32,
    /// The times as many members with which a scene first fits no server, and the limit that it meets. `None`: above
    /// 65,536 times.
    pub breaks: Option<Break>,
}

/// Machines of one kind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Machines {
    /// Their number.
    pub number: usize,
    /// Processor cores that they use together.
    pub cores: f64,
    /// The limit to which most of them are nearest.
    pub nearest: Option<String>,
}

/// The first limit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Break {
    /// Times the members.
    pub times: u32,
    /// Members of the largest scene then.
    pub members: u64,
    /// The limit.
    pub limit: String,
}

/// Use of a machine, as shares of what may be used of each thing that it has.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Use([f64; 6]);

/// The things that a machine has.
const THINGS: [&str; 6] = [
    "processor cores",
    "the thread of the sockets",
    "network",
    "memory",
    "places",
    "connections",
];

impl Use {
    fn plus(self, other: Self) -> Self {
        Self(std::array::from_fn(|thing| self.0[thing] + other.0[thing]))
    }

    fn times(self, factor: f64) -> Self {
        Self(self.0.map(|share| share * factor))
    }

    /// The greatest share, and its thing.
    fn most(self) -> (f64, &'static str) {
        let shares = self.0.into_iter().zip(THINGS);
        shares.fold(
            (0.0, THINGS[0]),
            |most, of| if of.0 > most.0 { of } else { most },
        )
    }

    fn fits(self) -> bool {
        self.most().0 <= 1.0 + ROUNDING
    }
}

/// Costs as shares of a machine.
struct Shares {
    /// A scene without members.
    scene: Use,
    /// A member of a server, or an edge of which it is the owner.
    member: Use,
    /// A member of an edge.
    observer: Use,
    /// A scene at an edge.
    mirror: Use,
    /// Processor cores of a full machine.
    cores: f64,
}

impl Shares {
    fn of(costs: &Costs, machine: &Machine) -> Self {
        let full = machine.full;
        let share = |used: f64, has: f64| used / (has * full);
        let datagram_cores = costs.datagrams * costs.datagram_us * 1e-6;
        let memory = |mb: f64| share(mb, machine.gb * 1e3);
        let stream = Use([
            share(datagram_cores, machine.cores),
            share(datagram_cores, 1.0),
            share(with_headers(costs) * 1e-6, machine.gbit),
            memory(costs.member_mb),
            0.0,
            0.0,
        ]);
        let place = |most: u32| Use([0.0, 0.0, 0.0, 0.0, 1.0 / f64::from(most), 0.0]);
        let connection = |most: u32| Use([0.0, 0.0, 0.0, 0.0, 0.0, 1.0 / f64::from(most)]);
        let engine = Use([
            share((costs.scene_cores - datagram_cores).max(0.0), machine.cores),
            0.0,
            0.0,
            memory(costs.scene_mb),
            0.0,
            0.0,
        ]);
        Self {
            scene: engine.plus(place(machine.server_scenes)),
            member: stream.plus(connection(machine.server_connections)),
            observer: stream.plus(place(machine.edge_members)),
            // It receives what a member receives, and keeps no engine.
            mirror: stream.plus(connection(machine.edge_streams)),
            cores: machine.cores * full,
        }
    }

    /// Observers of one scene that an edge takes beside what it has.
    fn observers_in(&self, used: Use) -> f64 {
        let used = used.plus(self.mirror);
        if !used.fits() {
            return 0.0;
        }
        let all = used.0.into_iter().zip(self.observer.0);
        let rooms = all.map(|(used, one)| {
            if one > 0.0 {
                (1.0 - used) / one
            } else {
                f64::INFINITY
            }
        });
        let room = rooms.fold(f64::INFINITY, f64::min);
        (room * (1.0 + ROUNDING)).floor().max(0.0)
    }
}

/// Kbit/s to a member with the headers of IPv4 and UDP.
fn with_headers(costs: &Costs) -> f64 {
    let headers = crate::summary::DATAGRAM_HEADER_BYTES as f64 * 8.0 / 1e3;
    costs.member_kbit + costs.datagrams * headers
}

/// A scene and its members.
#[derive(Clone, Debug, PartialEq)]
struct Scene {
    /// The region of its server.
    home: usize,
    /// Members who act, by region.
    acting: Vec<u32>,
    /// Members who only observe, by region.
    observing: Vec<u32>,
}

impl Scene {
    fn members(&self) -> u32 {
        self.acting.iter().chain(&self.observing).sum()
    }

    fn abroad(&self, members: &[u32]) -> u32 {
        members.iter().sum::<u32>() - members[self.home]
    }
}

/// Numbers of members of scenes by Zipf's law, greatest first; their sum is exact.
fn sizes(members: u32, scenes: u32, popularity: f64) -> Vec<u32> {
    let weights: Vec<f64> = (1..=scenes)
        .map(|rank| f64::from(rank).powf(-popularity))
        .collect();
    let all: f64 = weights.iter().sum();
    let (mut given, mut due) = (0_u32, 0.0);
    let mut take = |weight: &f64| {
        due += weight / all * f64::from(members);
        let size = (due.round() as u32).min(members) - given;
        given += size;
        size
    };
    let mut sizes: Vec<u32> = weights.iter().map(&mut take).collect();
    sizes[0] += members - sizes.iter().sum::<u32>();
    sizes
}

/// Draws regions and roles of all members.
fn draw(service: &ServiceArguments, seed: u64) -> Vec<Scene> {
    let mut draws = Pcg32::new(seed, 1);
    let mut uniform = || f64::from(draws.next_u32()) / (f64::from(u32::MAX) + 1.0);
    let all: f64 = service.regions.iter().sum();
    let region_at = |drawn: f64| {
        let mut left = drawn * all;
        let place = service.regions.iter().position(|share| {
            left -= share;
            left < 0.0
        });
        place.unwrap_or(service.regions.len() - 1)
    };
    let scene = |size: u32| {
        let home = region_at(uniform());
        let (mut acting, mut observing) = (
            vec![0; service.regions.len()],
            vec![0; service.regions.len()],
        );
        for _ in 0..size {
            let region = if uniform() < service.at_home {
                home
            } else {
                region_at(uniform())
            };
            let kind = if uniform() < service.observers {
                &mut observing
            } else {
                &mut acting
            };
            kind[region] += 1;
        }
        Scene {
            home,
            acting,
            observing,
        }
    };
    sizes(service.members, service.scenes, service.popularity)
        .into_iter()
        .map(scene)
        .collect()
}

/// Machines of one region, as they fill.
#[derive(Default)]
struct Filling {
    machines: Vec<Use>,
}

impl Filling {
    /// Puts it on the newest machine that has room, or on a new one; `false` if it fits none.
    fn put(&mut self, needs: Use) -> bool {
        let room = |of: &&mut Use| of.plus(needs).fits();
        match self.machines.iter_mut().rev().take(OPEN_MAX).find(room) {
            Some(machine) => *machine = machine.plus(needs),
            None if needs.fits() => self.machines.push(needs),
            None => return false,
        }
        true
    }

    /// Puts observers of one scene on the newest machine and on as many new ones as they need. Returns how many machines
    /// have some: each is a member of the scene's server.
    fn observe(&mut self, observers: u32, shares: &Shares) -> u32 {
        let (mut left, mut links) = (f64::from(observers), 0);
        while left > 0.0 {
            let room = self
                .machines
                .last()
                .map_or(0.0, |newest| shares.observers_in(*newest));
            if room < 1.0 {
                self.machines.push(Use::default());
                continue;
            }
            let taken = left.min(room);
            if let Some(newest) = self.machines.last_mut() {
                *newest = newest
                    .plus(shares.mirror)
                    .plus(shares.observer.times(taken));
            }
            left -= taken;
            links += 1;
        }
        links
    }
}

/// Machines of all regions together.
fn sum(filled: &[Filling], shares: &Shares) -> Machines {
    let all: Vec<&Use> = filled.iter().flat_map(|of| &of.machines).collect();
    let nearest = THINGS
        .into_iter()
        .max_by_key(|thing| all.iter().filter(|of| of.most().1 == *thing).count());
    Machines {
        number: all.len(),
        cores: all.iter().map(|of| of.0[0]).sum::<f64>() * shares.cores,
        nearest: nearest.filter(|_| !all.is_empty()).map(str::to_owned),
    }
}

impl Plan {
    fn of(arguments: &PlanArguments, shares: &Shares) -> Self {
        let scenes = draw(&arguments.service, arguments.seed);
        Self {
            provenance: Provenance::here(),
            largest_scene: scenes.iter().map(Scene::members).max().unwrap_or(0),
            direct: direct(&scenes, arguments, shares),
            edges: through_edges(&scenes, arguments, shares),
        }
    }
}

/// All members at the servers of their scenes.
fn direct(scenes: &[Scene], arguments: &PlanArguments, shares: &Shares) -> Fleet {
    let mut servers: Vec<_> = arguments
        .service
        .regions
        .iter()
        .map(|_| Filling::default())
        .collect();
    let mut too_large = 0;
    let (mut members, mut between) = (0_u64, 0_u64);
    let needs = |scene: &Scene, times: u32| {
        shares.scene.plus(
            shares
                .member
                .times(f64::from(scene.members()) * f64::from(times)),
        )
    };
    for scene in scenes {
        too_large += u32::from(!servers[scene.home].put(needs(scene, 1)));
        members += u64::from(scene.members());
        between += u64::from(scene.abroad(&scene.acting) + scene.abroad(&scene.observing));
    }
    let kbit = with_headers(&arguments.costs);
    Fleet {
        servers: sum(&servers, shares),
        edges: Machines::default(),
        datagrams_s: members as f64 * arguments.costs.datagrams,
        gbit_s: members as f64 * kbit * 1e-6,
        between_gbit_s: between as f64 * kbit * 1e-6,
        too_large,
        breaks: first_break(scenes, needs),
    }
}

/// Observers at edges of their region; those who act are members of the server.
fn through_edges(scenes: &[Scene], arguments: &PlanArguments, shares: &Shares) -> Fleet {
    let regions = arguments.service.regions.len();
    let (mut servers, mut edges): (Vec<_>, Vec<_>) = (0..regions)
        .map(|_| (Filling::default(), Filling::default()))
        .unzip();
    let mut too_large = 0;
    let (mut receivers, mut between) = (0_u64, 0_u64);
    for scene in scenes {
        let mut links = scene.acting.clone();
        for (region, edges) in edges.iter_mut().enumerate() {
            links[region] += edges.observe(scene.observing[region], shares);
        }
        let served: u32 = links.iter().sum();
        let needs = shares.scene.plus(shares.member.times(f64::from(served)));
        too_large += u32::from(!servers[scene.home].put(needs));
        receivers += u64::from(served) + u64::from(scene.observing.iter().sum::<u32>());
        between += u64::from(scene.abroad(&links));
    }
    let kbit = with_headers(&arguments.costs);
    let full_edge = shares.observers_in(Use::default());
    Fleet {
        servers: sum(&servers, shares),
        edges: sum(&edges, shares),
        datagrams_s: receivers as f64 * arguments.costs.datagrams,
        gbit_s: receivers as f64 * kbit * 1e-6,
        between_gbit_s: between as f64 * kbit * 1e-6,
        too_large,
        breaks: first_break(scenes, |scene, times| {
            let edges =
                |observers: &u32| (f64::from(*observers) * f64::from(times) / full_edge).ceil();
            let acting = f64::from(scene.acting.iter().sum::<u32>()) * f64::from(times);
            let links = acting + scene.observing.iter().map(edges).sum::<f64>();
            shares.scene.plus(shares.member.times(links))
        }),
    }
}

/// The least growth of all scenes with which one of them fits no server.
fn first_break(scenes: &[Scene], needs: impl Fn(&Scene, u32) -> Use) -> Option<Break> {
    let worst = |times: u32| {
        let all = scenes
            .iter()
            .map(|scene| (scene, needs(scene, times).most()));
        all.max_by(|a, b| a.1.0.total_cmp(&b.1.0))
            .filter(|(_, most)| most.0 > 1.0 + ROUNDING)
    };
    worst(GROWTH_MAX)?;
    let (mut holds, mut breaks) = (0, GROWTH_MAX);
    while breaks - holds > 1 {
        let times = holds.midpoint(breaks);
        if worst(times).is_some() {
            breaks = times;
        } else {
            holds = times;
        }
    }
    worst(breaks).map(|(scene, (_, limit))| Break {
        times: breaks,
        members: u64::from(scene.members()) * u64::from(breaks),
        limit: limit.to_owned(),
    })
}

impl Plan {
    fn rows(&self) -> Vec<Vec<String>> {
        let row = |name: &str, of: &Fleet| {
            vec![
                name.to_owned(),
                of.servers.number.to_string(),
                number(Some(of.servers.cores)),
                of.servers.nearest.clone().unwrap_or_else(dash),
                of.edges.number.to_string(),
                number(Some(of.edges.cores)),
                of.edges.nearest.clone().unwrap_or_else(dash),
                number(Some(of.datagrams_s * 1e-6)),
                number(Some(of.gbit_s)),
                number(Some(of.between_gbit_s)),
            ]
        };
        let titles = [
            "members at",
            "servers",
            "cores",
            "nearest limit",
            "edges",
            "cores",
            "nearest limit",
            "10^6 datagrams/s",
            "Gbit/s",
            "between regions",
        ];
        vec![
            titles.map(str::to_owned).to_vec(),
            row("servers", &self.direct),
            row("servers and edges", &self.edges),
        ]
    }

    fn limits(&self) -> Vec<Vec<String>> {
        let row = |name: &str, of: &Fleet| {
            let first = of.breaks.as_ref();
            vec![
                name.to_owned(),
                self.largest_scene.to_string(),
                of.too_large.to_string(),
                first.map_or_else(|| format!("> {GROWTH_MAX}"), |of| of.times.to_string()),
                first.map_or_else(dash, |of| of.members.to_string()),
                first.map_or_else(dash, |of| of.limit.clone()),
            ]
        };
        let titles = [
            "members at",
            "largest scene",
            "too large",
            "times the members",
            "then in one scene",
            "limit",
        ];
        vec![
            titles.map(str::to_owned).to_vec(),
            row("servers", &self.direct),
            row("servers and edges", &self.edges),
        ]
    }
}

#[cfg(test)]
mod tests;
