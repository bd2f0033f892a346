//! `rhumb-paper remote`: finds where remote beats integrated.
//!
//! All modes step one scene. For each amount of other work, each mode runs a block of frames by itself, so that its
//! caller does only that work while the server steps. Each block starts with uncounted frames, as many as the deepest
//! pipeline holds: calls that fill a pipeline do not wait. The results are the points, where their curves cross, and tables.

use std::num::NonZeroU32;
use std::path::PathBuf;

use clap::Args;
use rhumb_bench::drive::player::{self, Player, PlayerSetup, PlayerTotals};
use rhumb_bench::drive::{Defects, ServerCpu};
use rhumb_bench::numbers::number;
use rhumb_bench::record::Mode;
use rhumb_bench::{machine, output};
use rhumb_client::PipelineDepth;
use rhumb_protocol::Span;
use rhumb_reckoning::Tick;
use rhumb_server::run_on_cores;
use rhumb_sims::{Crowd, Script};
use rhumb_transport::Clock;
use serde::{Deserialize, Serialize};

use crate::page::{Provenance, Table};
use crate::processor::{CoreAssignment, work};
use crate::settings::{PaperError, tolerance};
use crate::trial::{FRAMES_PER_SECOND, bodies_placed, in_frames};

/// Arguments of the remote task.
#[derive(Clone, Debug, Args)]
pub(crate) struct RemoteArguments {
    /// Number of bodies. Default: 20000, 50000 and 100000, or 1000 and 2000 with --fast.
    #[arg(long, value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..=100_000))]
    loads: Vec<u32>,
    /// Percentages of bodies in motion; the others sleep.
    #[arg(long, value_delimiter = ',', default_values_t = [100, 5], value_parser = clap::value_parser!(u32).range(0..=100))]
    awake: Vec<u32>,
    /// Work of the caller's thread besides physics in each frame, milliseconds. Default: 0,5,20,50,100.
    #[arg(long, value_delimiter = ',', value_parser = clap::value_parser!(u32).range(0..=10_000))]
    other_work_ms: Vec<u32>,
    /// Pipeline depths: frames by which the caller is ahead of its server.
    #[arg(long, value_delimiter = ',', default_values_t = [0, 1, 2], value_parser = clap::value_parser!(u32).range(0..=16))]
    depths: Vec<u32>,
    /// Counted frames of each point.
    #[arg(long, default_value = "6")]
    frames: NonZeroU32,
    /// Tolerance of a copied body's surface error, metres.
    #[arg(long, default_value_t = 0.05, allow_negative_numbers = true)]
    tolerance: f64,
    /// Seed of the scene.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Use small loads.
    #[arg(long)]
    fast: bool,
    /// Folder for the results; created if missing.
    #[arg(long, default_value = "results/remote")]
    out: PathBuf,
    /// Let the system choose the cores instead of separating servers from their caller.
    #[arg(long)]
    no_pin: bool,
}

/// Frames before the measurement, about a second: balls start to fall, boxes fall asleep.
const WARM_UP_FRAMES: u32 = 12;

/// Runs everything; writes the results after each load.
pub(crate) fn run(arguments: &RemoteArguments) -> Result<(), PaperError> {
    let machine = machine::describe();
    let places = if arguments.no_pin {
        CoreAssignment::default()
    } else {
        CoreAssignment::apart()
    };
    tolerance(arguments.tolerance)?;
    output::make_folder(&arguments.out)?;
    if !places.caller.is_empty() {
        run_on_cores(&places.caller).map_err(PaperError::Cores)?;
    }
    let usual: &[u32] = if arguments.fast {
        &[1_000, 2_000]
    } else {
        &[20_000, 50_000, 100_000]
    };
    let loads = if arguments.loads.is_empty() {
        usual
    } else {
        &arguments.loads
    };
    let mut results = RemoteResults {
        provenance: Provenance::new(machine, &places, arguments.seed, arguments.frames.get()),
        points: Vec::new(),
    };
    let cost: u64 = loads.iter().copied().map(u64::from).sum();
    let shares: u64 = arguments
        .awake
        .iter()
        .map(|share| u64::from(*share) + 1)
        .sum();
    let bar = output::progress_bar(cost * shares, String::new());
    bar.set_style(output::share_style());
    for awake_percent in &arguments.awake {
        for load in loads {
            bar.set_message(format!("{load} bodies, {awake_percent} % in motion"));
            let points = run_load(arguments, &places, *load, *awake_percent)?;
            results.points.extend(points);
            write(arguments, &results)?;
            bar.inc(u64::from(*load) * (u64::from(*awake_percent) + 1));
        }
    }
    bar.finish_and_clear();
    output::print_text(&crossings_table(&results).to_text())?;
    output::print_text(&points_table(&results).to_text())?;
    let out = arguments.out.display();
    Ok(output::print_text(&format!("\nwritten to {out}\n"))?)
}

/// A player of one mode during the measurement.
struct Runner {
    depth: Option<u32>,
    player: Box<dyn Player>,
}

fn run_load(
    arguments: &RemoteArguments,
    places: &CoreAssignment,
    load: u32,
    awake_percent: u32,
) -> Result<Vec<RemotePoint>, PaperError> {
    let mut script = Crowd::new(load, awake_percent, arguments.seed);
    let mut commands = Vec::new();
    script.commands(Tick::ZERO, &mut commands);
    let player_setup = PlayerSetup {
        config: in_frames(script.config()),
        bodies: bodies_placed(&commands),
        tolerance: tolerance(arguments.tolerance)?,
        defects: Defects::SOUND,
        cpu: ServerCpu {
            cores: places.servers.clone(),
            threads: None,
        },
        seed: arguments.seed,
    };
    let mode = Mode::Integrated;
    let integrated =
        player::start(mode, &player_setup).ok_or(PaperError::NotPlayable { mode })??;
    let mut runners = vec![Runner {
        depth: None,
        player: integrated,
    }];
    for depth in &arguments.depths {
        runners.push(Runner {
            depth: Some(*depth),
            player: player::remote_player_at(&player_setup, PipelineDepth::new(*depth))?,
        });
    }
    for runner in &mut runners {
        runner.player.prepare(&commands)?;
        for _ in 0..WARM_UP_FRAMES {
            runner.player.frame(&[])?;
        }
    }
    let usual = [0, 5, 20, 50, 100];
    let works = if arguments.other_work_ms.is_empty() {
        &usual[..]
    } else {
        &arguments.other_work_ms
    };
    let deepest = arguments.depths.iter().copied().max().unwrap_or_default();
    let mut points = Vec::new();
    for other_work_ms in works {
        let frames = BlockFrames {
            uncounted: deepest.max(1),
            counted: arguments.frames.get(),
        };
        let mut truth = None;
        for runner in &mut runners {
            let (mut point, totals) = block(runner, *other_work_ms, frames)?;
            let own = (totals.tick, totals.truth);
            point.void = *truth.get_or_insert(own) != own;
            (point.load, point.awake_percent) = (load, awake_percent);
            points.push(point);
        }
    }
    Ok(points)
}

/// Numbers of frames of a block.
#[derive(Clone, Copy, Debug)]
struct BlockFrames {
    /// Frames that fill the pipeline and warm caches after another mode.
    uncounted: u32,
    counted: u32,
}

/// Measures consecutive frames of one mode.
fn block(
    runner: &mut Runner,
    other_work_ms: u32,
    frames: BlockFrames,
) -> Result<(RemotePoint, PlayerTotals), PaperError> {
    let clock = Clock::start();
    let other_work = Span::from_millis(u64::from(other_work_ms));
    let mut before = runner.player.totals()?;
    for _ in 0..frames.uncounted {
        runner.player.frame(&[])?;
        work(&clock, other_work);
    }
    // Polling the totals of a pipelined server would wait for it and drain the pipeline.
    let ahead = runner.depth.is_some_and(|depth| depth > 0);
    let stepped = if ahead {
        frames.uncounted + frames.counted
    } else {
        before = runner.player.totals()?;
        frames.counted
    };
    let (mut frame_ns, mut lasted_s) = (0, 0.0);
    let (mut call_ns, mut work_ns) = (0, Some(0));
    for _ in 0..frames.counted {
        let begun = clock.now();
        let frame_cost = runner.player.frame(&[])?;
        work(&clock, other_work);
        let frame = clock.now().since(begun).as_nanos();
        frame_ns += frame;
        lasted_s += (frame as f64 / 1e9).max(1.0 / FRAMES_PER_SECOND);
        call_ns += frame_cost.wall_ns;
        work_ns = work_ns.zip(frame_cost.work_ns).map(|(sum, own)| sum + own);
    }
    let after = runner.player.totals()?;
    let count = f64::from(frames.counted);
    let each = |nanoseconds: u64| nanoseconds as f64 / 1e6 / count;
    let stage =
        |of: fn(&PlayerTotals) -> u64| (of(&after) - of(&before)) as f64 / 1e6 / f64::from(stepped);
    let point = RemotePoint {
        load: 0,
        awake_percent: 0,
        awake: after.awake,
        other_work_ms,
        depth: runner.depth,
        frame_ms: each(frame_ns),
        call_ms: each(call_ns),
        work_ms: work_ns.map(each),
        step_ms: stage(|totals| totals.stages.step_ns),
        observe_ms: stage(|totals| totals.stages.observe_ns),
        publish_ms: stage(|totals| totals.stages.publish_ns),
        sim_fps: count / lasted_s,
        uncapped_fps: count / (frame_ns.max(1) as f64 / 1e9),
        void: false,
    };
    Ok((point, after))
}

/// Results and what is computed from them.
#[derive(Serialize)]
struct Written<'a> {
    #[serde(flatten)]
    results: &'a RemoteResults,
    crossings: Vec<Crossing>,
}

fn write(arguments: &RemoteArguments, results: &RemoteResults) -> Result<(), PaperError> {
    let out = &arguments.out;
    let written = Written {
        results,
        crossings: crossings(&results.points),
    };
    output::write_json(&out.join("remote.json"), &written)?;
    let tables = [
        aims_table(results),
        crossings_table(results),
        points_table(results),
    ];
    let provenance = &results.provenance;
    provenance.write(out, "remote", "Where remote wins", &tables)
}

/// Results: `remote.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct RemoteResults {
    /// Circumstances of the measurement.
    #[serde(flatten)]
    pub(crate) provenance: Provenance,
    /// Points, load by load.
    pub(crate) points: Vec<RemotePoint>,
}

/// One mode with a load and an amount of other work. Times are milliseconds per frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct RemotePoint {
    /// Number of bodies.
    pub(crate) load: u32,
    /// Percentage of bodies set in motion.
    pub(crate) awake_percent: u32,
    /// Bodies awake at the end, according to the engine.
    pub(crate) awake: u32,
    /// Requested other work.
    pub(crate) other_work_ms: u32,
    /// Pipeline depth; `None` for the integrated engine.
    pub(crate) depth: Option<u32>,
    /// Frame time, other work included.
    pub(crate) frame_ms: f64,
    /// Time of the physics call in it.
    pub(crate) call_ms: f64,
    /// Processor time of the caller's thread in that call.
    pub(crate) work_ms: Option<f64>,
    /// Time of the engine's steps.
    pub(crate) step_ms: f64,
    /// Time of observing.
    pub(crate) observe_ms: f64,
    /// Time of selecting, encoding and queueing.
    pub(crate) publish_ms: f64,
    /// Frames per second, at most 11.33.
    pub(crate) sim_fps: f64,
    /// The same without that limit.
    pub(crate) uncapped_fps: f64,
    /// True if its engine diverged from the integrated one.
    pub(crate) void: bool,
}

impl RemotePoint {
    /// Server time besides stepping, as a share of the stepping time.
    pub(super) fn beside(&self) -> f64 {
        (self.observe_ms + self.publish_ms) / self.step_ms
    }

    /// Frame time of the paired integrated engine if its steps took as long as this one's, milliseconds.
    pub(super) fn frame_of(&self, integrated: &Self) -> f64 {
        let beside_steps = integrated.frame_ms - integrated.step_ms;
        self.step_ms + beside_steps
    }
}

/// The range in which a depth beats the integrated engine in frames per second.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Crossing {
    /// Pipeline depth.
    pub(crate) depth: u32,
    /// Percentage of bodies set in motion.
    pub(crate) awake_percent: u32,
    /// Fixed load, if the search runs over other work.
    pub(crate) load: Option<u32>,
    /// Fixed other work, if the search runs over loads.
    pub(crate) other_work_ms: Option<u32>,
    /// Crossings with frames of at least 1/11.33 s.
    pub(crate) capped: Vec<Crossover>,
    /// Crossings with frames as fast as possible.
    pub(crate) uncapped: Vec<Crossover>,
    /// The same, if the engine's steps took as long in the caller's thread as at the server.
    pub(crate) engines_alike: Vec<Crossover>,
}

/// All crossovers: over other work at each load, and over loads at each amount of other work.
pub(super) fn crossings(points: &[RemotePoint]) -> Vec<Crossing> {
    let sound: Vec<&RemotePoint> = points.iter().filter(|point| !point.void).collect();
    let mut depths: Vec<u32> = sound.iter().filter_map(|point| point.depth).collect();
    let mut shares: Vec<u32> = sound.iter().map(|point| point.awake_percent).collect();
    let mut loads: Vec<u32> = sound.iter().map(|point| point.load).collect();
    let mut works: Vec<u32> = sound.iter().map(|point| point.other_work_ms).collect();
    for values in [&mut depths, &mut shares, &mut loads, &mut works] {
        values.sort_unstable();
        values.dedup();
    }
    let mut found = Vec::new();
    for awake_percent in shares {
        for depth in &depths {
            let along = |load: Option<u32>, other_work_ms: Option<u32>| {
                let there = |point: &&&RemotePoint| {
                    point.awake_percent == awake_percent
                        && load.is_none_or(|load| point.load == load)
                        && other_work_ms.is_none_or(|work| point.other_work_ms == work)
                };
                let sorted = |of: fn(&RemotePoint, &RemotePoint) -> (f64, f64)| {
                    let all: Vec<&RemotePoint> = sound.iter().filter(there).copied().collect();
                    crossovers(&pairs(&all, *depth, load.is_some(), of))
                };
                Crossing {
                    depth: *depth,
                    awake_percent,
                    load,
                    other_work_ms,
                    capped: sorted(|own, other| (own.sim_fps, other.sim_fps)),
                    uncapped: sorted(|own, other| (own.uncapped_fps, other.uncapped_fps)),
                    engines_alike: sorted(|own, other| {
                        (1e3 / other.frame_of(own), other.uncapped_fps)
                    }),
                }
            };
            found.extend(loads.iter().map(|load| along(Some(*load), None)));
            found.extend(works.iter().map(|work| along(None, Some(*work))));
        }
    }
    found
}

/// The pairs of the integrated engine and a depth, by other work or by load.
fn pairs(
    points: &[&RemotePoint],
    depth: u32,
    by_work: bool,
    of: fn(&RemotePoint, &RemotePoint) -> (f64, f64),
) -> Vec<Pair> {
    let place = |point: &RemotePoint| {
        if by_work {
            point.other_work_ms
        } else {
            point.load
        }
    };
    let mut pairs: Vec<Pair> = points
        .iter()
        .filter(|point| point.depth == Some(depth))
        .filter_map(|other| {
            let all = points.iter().copied();
            let (own, beats) = of(integrated(all, other)?, other);
            Some(Pair {
                at: f64::from(place(other)),
                own,
                other: beats,
            })
        })
        .collect();
    pairs.sort_by(|one, other| one.at.total_cmp(&other.at));
    pairs
}

/// The integrated point with the same load and other work.
pub(super) fn integrated<'a>(
    mut points: impl Iterator<Item = &'a RemotePoint>,
    beside: &RemotePoint,
) -> Option<&'a RemotePoint> {
    points.find(|point| {
        point.depth.is_none()
            && point.awake_percent == beside.awake_percent
            && point.load == beside.load
            && point.other_work_ms == beside.other_work_ms
    })
}

/// Two values at one abscissa.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pair {
    /// Abscissa: other work in milliseconds, or bodies.
    at: f64,
    /// Value of the baseline.
    own: f64,
    /// Value of the challenger, which beats the baseline by being greater.
    other: f64,
}

/// An interval in which the challenger beats the baseline.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Crossover {
    /// Start, interpolated between the last pair before and the first pair that beats.
    pub(super) from: f64,
    /// True if the first pair already beats; the true start may then lie earlier.
    pub(super) from_the_first: bool,
    /// End, if it lies within the measured range.
    pub(super) to: Option<f64>,
}

/// The intervals in which the challenger beats the baseline; pairs in ascending order. Ties do not beat.
fn crossovers(pairs: &[Pair]) -> Vec<Crossover> {
    let beats = |pair: &Pair| pair.other > pair.own;
    let between = |one: &Pair, two: &Pair| {
        let (before, after) = (one.other - one.own, two.other - two.own);
        one.at + (two.at - one.at) * before / (before - after)
    };
    let (mut found, mut before): (Vec<Crossover>, Option<&Pair>) = (Vec::new(), None);
    for pair in pairs {
        match before.filter(|before| beats(before) != beats(pair)) {
            Some(before) if beats(pair) => found.push(Crossover {
                from: between(before, pair),
                from_the_first: false,
                to: None,
            }),
            Some(before) => {
                if let Some(open) = found.last_mut() {
                    open.to = Some(between(before, pair));
                }
            }
            None if before.is_none() && beats(pair) => found.push(Crossover {
                from: pair.at,
                from_the_first: true,
                to: None,
            }),
            None => {}
        }
        before = Some(pair);
    }
    found
}

/// The crossovers, a row each.
pub(crate) fn crossings_table(results: &RemoteResults) -> Table {
    let mut table = Table::new(
        "Where remote beats integrated",
        [
            "depth",
            "in motion, %",
            "searched over",
            "in SimFPS",
            "uncapped",
            "uncapped, equal engines",
        ],
    );
    for found in crossings(&results.points) {
        let over = match (found.load, found.other_work_ms) {
            (Some(load), _) => format!("other work, at {load} bodies"),
            (_, Some(work)) => format!("bodies, at {work} ms of other work"),
            _ => String::new(),
        };
        let unit = if found.load.is_some() { "ms" } else { "bodies" };
        let cell = |stretches: &[Crossover]| {
            let stretches = stretches.iter().map(|stretch| stretch_text(*stretch, unit));
            let stretches: Vec<_> = stretches.collect();
            match &stretches[..] {
                [] => "nowhere".to_owned(),
                some => some.join("; "),
            }
        };
        table.rows.push(vec![
            found.depth.to_string(),
            found.awake_percent.to_string(),
            over,
            cell(&found.capped),
            cell(&found.uncapped),
            cell(&found.engines_alike),
        ]);
    }
    table.note = "Interpolated linearly between measured points; without an end, the interval is open. From the \
                  first: already at the smallest measured value, and perhaps below. Where both reach 11.33 frames \
                  per second neither beats the other. Nowhere: not within the measured range. Equal engines: \
                  compared with an integrated engine whose steps take as long as at the server, so noise of one \
                  engine decides nothing."
        .to_owned();
    table
}

/// An interval in which remote beats integrated, as text.
fn stretch_text(stretch: Crossover, unit: &str) -> String {
    let from = number(Some(stretch.from));
    let from = match stretch.from_the_first {
        true => format!("from the first, {from}"),
        false => format!("from {from}"),
    };
    match stretch.to {
        None => format!("{from} {unit}"),
        Some(to) => format!("{from} to {} {unit}", number(Some(to))),
    }
}

/// Targets and results.
pub(crate) fn aims_table(results: &RemoteResults) -> Table {
    /// Largest allowed share of the engine's step where most bodies sleep.
    const MOST: f64 = 0.05;
    const LOAD: u32 = 50_000;
    const AWAKE_PERCENT: u32 = 5;
    let mut table = Table::new("Targets", ["target", "found", "where", "met"]);
    let there = results.points.iter().filter(|point| {
        !point.void
            && point.depth.is_some()
            && point.load == LOAD
            && point.awake_percent == AWAKE_PERCENT
    });
    let there: Vec<_> = there.collect();
    let worst = there
        .iter()
        .max_by(|one, other| one.beside().total_cmp(&other.beside()));
    let Some(worst) = worst else {
        return table;
    };
    let mean = there.iter().map(|point| point.beside()).sum::<f64>() / there.len() as f64;
    let (work, depth) = (worst.other_work_ms, worst.depth.unwrap_or_default());
    let aim = format!(
        "{LOAD} bodies, {AWAKE_PERCENT} % in motion: observe and publish at most {MOST} of the engine's step"
    );
    for (found, place) in [
        (mean, format!("on average of {} points", there.len())),
        (
            worst.beside(),
            format!("worst, at {work} ms of other work, depth {depth}"),
        ),
    ] {
        table.rows.push(vec![
            aim.clone(),
            number(Some(found)),
            place,
            if found <= MOST { "yes" } else { "no" }.to_owned(),
        ]);
    }
    table
}

/// The points, a row each.
pub(crate) fn points_table(results: &RemoteResults) -> Table {
    let columns = [
        "bodies",
        "in motion, %",
        "awake",
        "other work, ms",
        "depth",
        "SimFPS",
        "uncapped",
        "frame, ms",
        "call, ms",
        "caller's work, ms",
        "caller waits, ms",
        "engine, ms",
        "observe, ms",
        "publish, ms",
        "rest of server, of engine",
        "frame, equal engines",
    ];
    let mut table = Table::new("Frames, and where their time goes", columns);
    for point in &results.points {
        let depth = point
            .depth
            .map_or_else(|| "integrated".to_owned(), |depth| depth.to_string());
        let mut row = vec![
            point.load.to_string(),
            point.awake_percent.to_string(),
            point.awake.to_string(),
            point.other_work_ms.to_string(),
            if point.void {
                format!("{depth}, void")
            } else {
                depth
            },
        ];
        let waits = point.work_ms.map(|work| (point.call_ms - work).max(0.0));
        let values = [
            Some(point.sim_fps),
            Some(point.uncapped_fps),
            Some(point.frame_ms),
            Some(point.call_ms),
            point.work_ms,
            waits,
            Some(point.step_ms),
            Some(point.observe_ms),
            Some(point.publish_ms),
            Some(point.beside()),
            integrated(results.points.iter(), point)
                .filter(|own| !own.void && !point.void)
                .map(|own| point.frame_ms / point.frame_of(own)),
        ];
        row.extend(values.map(number));
        table.rows.push(row);
    }
    table.note = "For pipelined callers, engine, observe and publish are averages that include the uncounted frames. \
                  Frame, equal engines: relative to an integrated engine with the same steps. Void: the engine \
                  diverged from the integrated one; excluded from the crossovers."
        .to_owned();
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(load: u32, other_work_ms: u32, depth: Option<u32>, fps: f64) -> RemotePoint {
        RemotePoint {
            load,
            awake_percent: 100,
            awake: load,
            other_work_ms,
            depth,
            frame_ms: 1e3 / fps,
            call_ms: 1.0,
            work_ms: Some(1.0),
            step_ms: 1.0,
            observe_ms: 0.0,
            publish_ms: 0.05,
            sim_fps: fps.min(FRAMES_PER_SECOND),
            uncapped_fps: fps,
            void: false,
        }
    }

    #[test]
    fn crossovers_are_searched_over_other_work_and_over_loads() {
        let points = [
            point(1_000, 0, None, 20.0),
            point(1_000, 0, Some(1), 18.0),
            point(1_000, 100, None, 8.0),
            point(1_000, 100, Some(1), 10.0),
            point(3_000, 0, None, 6.0),
            point(3_000, 0, Some(1), 5.0),
            point(3_000, 100, None, 4.0),
            point(3_000, 100, Some(1), 6.0),
        ];
        let found = crossings(&points);
        assert_eq!(found.len(), 4);
        let of = |load: Option<u32>, work: Option<u32>| {
            let found = found
                .iter()
                .find(|one| one.load == load && one.other_work_ms == work);
            found.cloned().unwrap()
        };
        let at_thousand = of(Some(1_000), None);
        // Uncapped −2 at 0 and +2 at 100. Capped, the first is a tie, from which on remote wins.
        assert_eq!(at_thousand.uncapped[0].from, 50.0);
        assert_eq!(at_thousand.capped[0].from, 0.0);
        assert_eq!(of(None, Some(0)).capped, []);
        let busy = of(None, Some(100)).capped[0];
        assert!(busy.from_the_first && busy.from == 1_000.0 && busy.to.is_none());
        let mut void = points;
        void[3].void = true;
        assert_eq!(crossings(&void)[0].uncapped, []);
    }

    #[test]
    fn with_equal_engines_a_slower_integrated_engine_decides_nothing() {
        let own = RemotePoint {
            step_ms: 49.0,
            ..point(1_000, 0, None, 20.0)
        };
        let other = RemotePoint {
            step_ms: 39.0,
            ..point(1_000, 0, Some(0), 24.0)
        };
        assert_eq!(other.frame_of(&own), 40.0);
        let found = crossings(&[own, other]);
        assert!(
            found[0].uncapped[0].from_the_first,
            "it has the higher frame rate"
        );
        assert_eq!(found[0].engines_alike, [], "41.7 ms for 40");
    }

    fn pairs(values: &[(f64, f64, f64)]) -> Vec<Pair> {
        let pair = |(at, own, other): &(f64, f64, f64)| Pair {
            at: *at,
            own: *own,
            other: *other,
        };
        values.iter().map(pair).collect()
    }

    #[test]
    fn a_crossover_lies_where_straight_lines_cross() {
        // Differences −2 at 10 and +6 at 50: zero at a quarter of the distance.
        let found = crossovers(&pairs(&[
            (10.0, 5.0, 3.0),
            (50.0, 4.0, 10.0),
            (100.0, 1.0, 9.0),
        ]));
        let expected = Crossover {
            from: 20.0,
            from_the_first: false,
            to: None,
        };
        assert_eq!(found, [expected]);
    }

    #[test]
    fn a_challenger_that_never_beats_has_no_crossover() {
        assert_eq!(crossovers(&pairs(&[(0.0, 5.0, 3.0), (50.0, 4.0, 4.0)])), []);
        assert_eq!(crossovers(&[]), []);
        // After a tie, the interval starts at the tie.
        let found = crossovers(&pairs(&[(0.0, 4.0, 4.0), (50.0, 4.0, 5.0)]));
        assert_eq!((found[0].from, found[0].from_the_first), (0.0, false));
    }

    #[test]
    fn intervals_may_start_at_the_first_pair_end_and_start_again() {
        let found = crossovers(&pairs(&[
            (5.0, 1.0, 2.0),
            (10.0, 2.0, 3.0),
            (20.0, 3.0, 2.0),
            (30.0, 3.0, 2.0),
            (40.0, 3.0, 6.0),
        ]));
        let first = Crossover {
            from: 5.0,
            from_the_first: true,
            to: Some(15.0),
        };
        let again = Crossover {
            from: 32.5,
            from_the_first: false,
            to: None,
        };
        assert_eq!(found, [first, again]);
    }
}
