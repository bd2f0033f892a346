//! `rhumb-bench cost`: processor time of a stream, stage by stage.
//!
//! Covers publishing of awake bodies beside the engine's step, a tick in which all bodies sleep, decoding, rendering,
//! and one more member of a stream. All but the members run in the calling thread, one after the other. Times are
//! processor times of that thread, so that other programs hardly change them. Each figure is the median of its
//! repeats, beside its target.

mod members;

use std::hint::black_box;
use std::num::{NonZeroU32, NonZeroUsize};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Args;
use rhumb_reckoning::{Anchor, Grid, Metres, QuantisedState, Tolerance, Track};
use serde::{Deserialize, Serialize};

use crate::processor::time_of;
use crate::setup::decoding::{DecodeLoad, RenderLoad, TICKS, config, impulse_state, track};
use crate::setup::lanes::Lanes;
use crate::setup::publishing::{
    MEASURED, ObservedRun, PublishCost, SCENARIOS, Scenario, SleepLoad, TIERS,
};
use crate::summary::{markdown, number};
use crate::task::{Failure, Provenance, ended, write};
use crate::{output, quantile};

pub use members::Members;

/// Arguments: bodies, members, repeats, output.
#[derive(Clone, Debug, Args)]
pub struct CostArguments {
    /// Bodies that are published, decoded and rendered.
    #[arg(long, default_value = "10000", value_parser = clap::value_parser!(u32).range(100..=50_000))]
    bodies: u32,
    /// Repeats per measurement; the median counts.
    #[arg(long, default_value = "5")]
    repeats: NonZeroU32,
    /// Numbers of members of a stream over loopback, smallest first.
    #[arg(long, value_delimiter = ',', default_value = "1,8,16,32")]
    members: Vec<NonZeroUsize>,
    /// Seconds of measurement for each number of members.
    #[arg(long, default_value = "4")]
    member_seconds: NonZeroU32,
    /// Skip the measurement of members.
    #[arg(long)]
    no_members: bool,
    /// Folder for cost.json; created if missing.
    #[arg(long, default_value = "results/cost")]
    out: PathBuf,
}

/// Content of `cost.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Costs {
    /// Source of the figures.
    #[serde(flatten)]
    pub provenance: Provenance,
    /// Publishing of awake bodies, as one stream and as four.
    pub publishing: Vec<Publishing>,
    /// Publishing of sleeping bodies, by their number.
    pub sleeping: Vec<Sleeping>,
    /// Decoding and rendering.
    pub decoding: Decoding,
    /// Cost of one more member; empty if not measured or if the system does not report thread times.
    pub members: Vec<Members>,
}

/// Runs the measurements. Exit code 0 if everything was measured and written, 1 otherwise.
pub fn cost(arguments: &CostArguments) -> ExitCode {
    ended(cost_all(arguments))
}

fn cost_all(arguments: &CostArguments) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let costs = Costs::measure(arguments)?;
    let tables = [
        (
            "publishing, beside the engine's step",
            costs.publishing_rows(),
        ),
        ("a tick in which all sleep", costs.sleeping_rows()),
        ("decoding and rendering", costs.decoding_rows()),
        (
            "a member's datagram, microseconds of a processor",
            costs.member_rows(),
        ),
    ];
    Ok(write(&arguments.out, "cost.json", &costs, &tables)?)
}

impl Costs {
    fn measure(arguments: &CostArguments) -> Result<Self, String> {
        let (bodies, repeats) = (arguments.bodies, arguments.repeats.get());
        let counts = match arguments.no_members || !members::can_be_measured() {
            true => &[][..],
            false => &arguments.members[..],
        };
        let steps = publishing_steps(repeats) + 2 * counts.len() as u64;
        let bar = output::progress_bar(steps, "cost".to_owned());
        let mut progress = || bar.inc(1);
        let publishing = measure_publishing(bodies, repeats, &mut progress)?;
        let sleepers = [bodies / 100, bodies / 10, bodies];
        let long = Duration::from_secs(u64::from(arguments.member_seconds.get()));
        let costs = Self {
            provenance: Provenance::here(),
            publishing,
            sleeping: sleepers
                .map(|bodies| measure_sleeping(bodies, repeats))
                .to_vec(),
            decoding: measure_decoding(bodies, repeats),
            members: members::members(counts, long, &mut progress)?,
        };
        bar.finish_and_clear();
        Ok(costs)
    }

    /// Text of a block of the documents; `None` if the block does not exist.
    pub fn block(&self, what: &str) -> Option<String> {
        let rows = match what {
            "command" => {
                return Some(self.provenance.paragraph());
            }
            "publishing" => self.publishing_rows(),
            "sleeping" => self.sleeping_rows(),
            "decoding" => self.decoding_rows(),
            "members" => self.member_rows(),
            _ => return None,
        };
        Some(markdown(&rows))
    }

    fn publishing_rows(&self) -> Vec<Vec<String>> {
        let mut rows = vec![titles([
            "scene",
            "awake",
            "streams",
            "step ms",
            "observe ms",
            "publish ms",
            "% of step",
            "aimed at",
            "upd/tick",
            "ns/upd",
        ])];
        for of in &self.publishing {
            let each_ns = of.publish_ms * 1e6 / of.updates_per_tick;
            rows.push(vec![
                of.scene.clone(),
                of.awake.to_string(),
                of.streams.to_string(),
                number(Some(of.step_ms)),
                number(Some(of.observe_ms)),
                number(Some(of.publish_ms)),
                number(Some(100.0 * of.of_step)),
                if of.streams == 1 { "3" } else { "8" }.to_owned(),
                number(Some(of.updates_per_tick)),
                // With few updates, scanning for them takes the time, so a cost per update would mislead.
                number(
                    (of.updates_per_tick >= of.awake as f64 / 100.0 && of.updates_per_tick > 0.0)
                        .then_some(each_ns),
                ),
            ]);
        }
        rows
    }

    fn sleeping_rows(&self) -> Vec<Vec<String>> {
        let mut rows = vec![titles(["sleepers", "publish us"])];
        let row = |of: &Sleeping| vec![of.bodies.to_string(), number(Some(of.publish_us))];
        rows.extend(self.sleeping.iter().map(row));
        rows
    }

    fn decoding_rows(&self) -> Vec<Vec<String>> {
        let of = &self.decoding;
        let row = |what: String, found: f64, aim: &str, floor: f64| {
            let [found, floor] = [found, floor].map(|figure| number(Some(figure)));
            vec![what, found, aim.to_owned(), floor]
        };
        let first = "a body's first update, ns".to_owned();
        let view = format!("a view of {} moving bodies, ms", of.bodies);
        vec![
            titles(["what", "found", "aimed at", "least"]),
            row(
                "an update, ns".to_owned(),
                of.update_ns,
                "200",
                of.correcting_ns,
            ),
            row(first, of.first_ns, "200", of.correcting_ns),
            row(view, of.view_ms, "0.3", of.predicting_ms),
        ]
    }

    fn member_rows(&self) -> Vec<Vec<String>> {
        let mut rows = vec![titles([
            "members",
            "rtt ms",
            "host us",
            "sockets us",
            "one more us",
            "aimed at",
            "its least us",
            "least of all us",
        ])];
        for (place, of) in self.members.iter().enumerate() {
            let before = place.checked_sub(1).map(|before| &self.members[before]);
            rows.push(vec![
                of.members.to_string(),
                of.round_trip_ms.to_string(),
                number(Some(of.server_loop_us)),
                number(Some(of.sockets_us)),
                number(of.one_more_us),
                "3".to_owned(),
                number(before.and_then(|before| of.floor_of_one_more_us(before))),
                number(Some(of.floor_us)),
            ]);
        }
        rows
    }
}

fn titles<const N: usize>(titles: [&str; N]) -> Vec<String> {
    titles.map(str::to_owned).to_vec()
}

/// Cost of decoding and rendering.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Decoding {
    /// Bodies of the stream.
    pub bodies: u32,
    /// First update of a body, nanoseconds.
    pub first_ns: f64,
    /// Update in mid-run, nanoseconds.
    pub update_ns: f64,
    /// View of all bodies, milliseconds.
    pub view_ms: f64,
    /// Lower bound: prediction and correction of one body alone, nanoseconds.
    pub correcting_ns: f64,
    /// Lower bound: prediction of all bodies alone, milliseconds.
    pub predicting_ms: f64,
}

/// Measures decoding; each figure is the median of `repeats`.
fn measure_decoding(bodies: u32, repeats: u32) -> Decoding {
    let grid = Grid::new(Tolerance::NORMAL, Metres::new(0.5));
    let often = repeats * TICKS as u32;
    let lanes =
        |track: &dyn Fn(u32) -> Track| Lanes::of((0..bodies).map(track), config().integrator, grid);
    // Anchors in mid-run lie on the grid; anchors of a snapshot do not.
    let quantised_track = |index| Track {
        anchor: Anchor::Quantised(QuantisedState::of(&impulse_state(index, 0).motion(), &grid)),
        ..track(index)
    };
    let (moving, quantised) = (lanes(&track), lanes(&quantised_track));
    let correcting = median_of(often, || quantised.correct());
    let mut render = RenderLoad::new(bodies);
    Decoding {
        bodies,
        first_ns: update_ns(&DecodeLoad::new(bodies), repeats),
        update_ns: update_ns(&DecodeLoad::in_mid_run(bodies), repeats),
        view_ms: ms(median_of(often, || render.refresh())),
        correcting_ns: correcting.as_nanos() as f64 / f64::from(bodies),
        predicting_ms: ms(median_of(often, || moving.predict())),
    }
}

/// Time to decode an update, nanoseconds.
fn update_ns(load: &DecodeLoad, repeats: u32) -> f64 {
    let once = || {
        let mut subscriber = load.subscriber.clone();
        let (took, ()) = time_of(|| load.decode(&mut subscriber));
        black_box(subscriber);
        took
    };
    let took = median((0..repeats).map(|_| once()));
    took.as_nanos() as f64 / load.updates.max(1) as f64
}

fn median_of(repeats: u32, mut work: impl FnMut()) -> Duration {
    median((0..repeats).map(|_| time_of(&mut work).0))
}

fn ms(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

/// Ticks with all bodies asleep, measured as one block.
const SILENT: u32 = 1_000;

/// Cost of publishing a scene, per tick.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Publishing {
    /// Scene and stage.
    pub scene: String,
    /// Number of streams, one tier each.
    pub streams: usize,
    /// Bodies awake in the last tick.
    pub awake: usize,
    /// Mean step of the engine, milliseconds.
    pub step_ms: f64,
    /// Mean time to read every body, milliseconds.
    pub observe_ms: f64,
    /// Mean time of selection and encoding for all streams, milliseconds.
    pub publish_ms: f64,
    /// Observing and publishing as a share of the step.
    pub of_step: f64,
    /// Updates per tick over all streams.
    pub updates_per_tick: f64,
}

/// Cost of publishing where nothing moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sleeping {
    /// Bodies of the stream, all asleep.
    pub bodies: u32,
    /// One tick of one stream, microseconds.
    pub publish_us: f64,
}

/// Number of progress calls for `repeats`.
fn publishing_steps(repeats: u32) -> u64 {
    let ticks = SCENARIOS.iter().map(Scenario::steps);
    ticks.sum::<u64>() + SCENARIOS.len() as u64 * TIERS.len() as u64 * u64::from(repeats)
}

/// Measures each scene, as one stream and as four.
///
/// # Errors
///
/// The refusal of the engine or its scene, as text.
fn measure_publishing(
    bodies: u32,
    repeats: u32,
    progress: &mut dyn FnMut(),
) -> Result<Vec<Publishing>, String> {
    let mut all = Vec::new();
    for scenario in &SCENARIOS {
        let run = ObservedRun::record(scenario, bodies, progress)?;
        for tiers in TIERS {
            let measured = (0..repeats).map(|_| {
                let cost = run.publish(tiers);
                progress();
                cost
            });
            let costs: Vec<PublishCost> = measured.collect();
            let ms = |time: Duration| time.as_secs_f64() * 1e3;
            let publish_ms = ms(median(costs.iter().map(|cost| cost.tick)));
            let observe_ms = ms(run.observe);
            let step_ms = ms(run.step);
            // All repeats encode the same updates.
            let updates = costs.first().map_or(0, |cost| cost.updates);
            all.push(Publishing {
                scene: scenario.name.to_owned(),
                streams: tiers.len(),
                awake: run.awake(),
                step_ms,
                publish_ms,
                observe_ms,
                of_step: (observe_ms + publish_ms) / step_ms,
                updates_per_tick: updates as f64 / MEASURED as f64,
            });
        }
    }
    Ok(all)
}

/// Measures a stream of `bodies` sleeping bodies.
fn measure_sleeping(bodies: u32, repeats: u32) -> Sleeping {
    let mut load = SleepLoad::new(bodies);
    let mut silence = || {
        let publish = || {
            for _ in 0..SILENT {
                load.publish();
            }
        };
        time_of(publish).0
    };
    silence();
    let took = median((0..repeats).map(|_| silence()));
    Sleeping {
        bodies,
        publish_us: took.as_secs_f64() * 1e6 / f64::from(SILENT),
    }
}

/// Median of several durations; zero if there are none.
fn median(values: impl Iterator<Item = Duration>) -> Duration {
    let mut all: Vec<u64> = values.map(|value| value.as_nanos() as u64).collect();
    Duration::from_nanos(quantile::of_nanoseconds(&mut all, 50).unwrap_or(0))
}
