//! `rhumb-paper remote`: finds where remote beats integrated.
//!
//! All modes step one scene. For each amount of other work, each mode runs a block of frames by itself, so that its
//! caller does only that work while the server steps. Each block starts with uncounted frames, as many as the deepest
//! pipeline holds: calls that fill a pipeline do not wait.

mod results;

use std::num::NonZeroU32;
use std::path::PathBuf;

use clap::Args;
use rhumb_bench::drive::player::{self, Player, PlayerSetup, PlayerTotals};
use rhumb_bench::drive::{Defects, ServerCpu};
use rhumb_bench::record::Mode;
use rhumb_bench::{machine, output};
use rhumb_client::PipelineDepth;
use rhumb_protocol::Span;
use rhumb_reckoning::Tick;
use rhumb_server::run_on_cores;
use rhumb_sims::{Crowd, Script};
use rhumb_transport::Clock;
use serde::Serialize;

use crate::page::Provenance;
use crate::processor::{CoreAssignment, work};
use crate::settings::{PaperError, tolerance};
use crate::trial::{FRAMES_PER_SECOND, bodies_placed, in_frames};
use results::{Crossing, RemotePoint, crossings};

pub(crate) use results::{RemoteResults, aims_table, crossings_table, points_table};

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
}
