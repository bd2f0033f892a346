//! `rhumb-bench limit`: how few updates and bits might have done.
//!
//! Had the future been known. For each body of a recording, greedily, the longest segments by any predictor of the closed
//! list, each verified by the normative prediction; then what an ideal coder would have taken for them. It is found, not
//! proved: a better fit may make a segment longer, so that the true least is lower still. On the other side a publisher
//! has more to do: it does not know the future, and says packets, refreshes and exact rests. One cut is of motions as they
//! were fitted, one of such as the protocol can say: the difference is the price of its grid.

mod beside;
mod code;
mod context;
mod fit;
mod path;
mod segments;

use std::collections::BTreeMap;
use std::fmt;
use std::num::NonZeroU32;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use rhumb_reckoning::Tolerance;
use serde::{Deserialize, Serialize};

use crate::output;
use crate::quantile::WithZeros;
use crate::recording::Recording;
use crate::replay::{Failure, RecordingSource, ToleranceOptions, ended};
use crate::summary::{ErrorQuantiles, aligned, number};

pub(crate) use beside::{Promised, set_beside_limits};
use code::Bits;
use context::{Basis, ParentPath, PredictorKind, SegmentContext};
use path::{Path, Paths};
use segments::{Objective, PARENT_RATIO, Segmentation, cut};

/// Which recording, what is promised, and where to write what came of it.
#[derive(Clone, Debug, Args)]
pub struct LimitArguments {
    #[command(flatten)]
    source: RecordingSource,
    #[command(flatten)]
    tolerance_options: ToleranceOptions,
    /// Judge every so many ticks of the recording, as if no others were published.
    #[arg(long, default_value = "1")]
    publish_interval: NonZeroU32,
    /// Folder for limit.json; made if it is not there.
    #[arg(long, default_value = "results/limit")]
    out: PathBuf,
}

/// How few updates and bits were found to do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Limit {
    /// What was recorded.
    pub scene: String,
    /// Bodies that can move.
    pub bodies: u32,
    /// Ticks of the recording.
    pub ticks: u32,
    /// Judged every so many ticks.
    pub publish_interval: u32,
    /// What is promised, metres; of the centre alone where turns have a bound of their own.
    pub tolerance_m: f64,
    /// That bound, radians.
    pub turn_rad: Option<f64>,
    /// Cut into as few segments as were found.
    pub fewest_updates: Cut,
    /// The same with motions that are rounded to the protocol's grid and judged as rounded: what could be said.
    pub fewest_updates_on_grid: Cut,
    /// Cut for few bits, or the same cut if that takes no more.
    pub fewest_bits: Cut,
}

/// The ways of all bodies, cut into segments.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cut {
    /// Segments, the first of each body left out: what has to be said.
    pub updates: u64,
    /// The same for each simulated second.
    pub updates_per_second: f64,
    /// By the predictor that is said.
    pub by_predictor: BTreeMap<String, u64>,
    /// Of an ideal coder, 1,000 bit/s of simulated time.
    pub kbps: f64,
    /// Of it, for each update.
    pub bits_per_update: f64,
    /// What it would take for each part.
    pub parts_kbps: PartRates,
    /// Of bodies that are elsewhere than a frame before, at those frames; never above the tolerance.
    pub surface_error_m: Option<ErrorQuantiles>,
}

/// The parts of a cut, 1,000 bit/s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PartRates {
    /// Which bodies are spoken of.
    pub body_ids: f64,
    /// By which predictor they go on.
    pub predictors: f64,
    /// Positions and turns.
    pub poses: f64,
    /// Velocities.
    pub velocities: f64,
}

/// Computes a limit. Exit code 0 when it was computed and written, 1 otherwise.
pub fn limit(arguments: &LimitArguments) -> ExitCode {
    ended(limit_all(arguments))
}

fn limit_all(arguments: &LimitArguments) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let tolerance = arguments
        .tolerance_options
        .tolerance()
        .map_err(Failure::Terms)?;
    let recording = arguments.source.read()?;
    let limit = Limit::of(&recording, tolerance, arguments.publish_interval);
    output::write_limit(&arguments.out, &limit)?;
    Ok(())
}

impl Limit {
    /// Of a recording, under a tolerance that holds at every so many ticks.
    #[must_use]
    pub fn of(recording: &Recording, tolerance: Tolerance, publish_interval: NonZeroU32) -> Self {
        let paths = Paths::new(recording, publish_interval);
        let bar = output::progress_bar(3 * paths.len() as u64, "limit".to_owned());
        let of = |objective| {
            let search = Search::new(recording, tolerance, publish_interval, objective);
            search.cut_all(&paths, &mut || bar.inc(1))
        };
        let (fewest_updates, fewest_bits) = (of(Objective::Updates), of(Objective::Bits));
        let fewest_updates_on_grid = of(Objective::UpdatesOnGrid);
        bar.finish_and_clear();
        let (tolerance_m, turn_rad) = match tolerance {
            Tolerance::Surface(length) => (length.metres().metres(), None),
            Tolerance::Parts { position, turn } => {
                (position.metres().metres(), Some(turn.radians().radians()))
            }
        };
        Self {
            scene: recording.name.clone(),
            bodies: paths.len() as u32,
            ticks: recording.ticks(),
            publish_interval: publish_interval.get(),
            tolerance_m,
            turn_rad,
            fewest_updates_on_grid,
            fewest_bits: if fewest_bits.kbps < fewest_updates.kbps {
                fewest_bits
            } else {
                fewest_updates.clone()
            },
            fewest_updates,
        }
    }

    /// As the text of `limit.json`.
    #[must_use]
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self)
            .expect("numbers, texts and maps keyed by texts are always JSON");
        text.push('\n');
        text
    }
}

impl fmt::Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let cuts = [
            &self.fewest_updates,
            &self.fewest_bits,
            &self.fewest_updates_on_grid,
        ];
        let mut rows = vec![
            ["", "fewest updates", "fewest bits", "updates on grid"]
                .map(str::to_owned)
                .to_vec(),
        ];
        let mut row = |name: &str, of: &dyn Fn(&Cut) -> Option<f64>| {
            let cells = cuts.iter().map(|cut| number(of(cut)));
            rows.push(std::iter::once(name.to_owned()).chain(cells).collect());
        };
        row("updates a second", &|cut| Some(cut.updates_per_second));
        for predictor in PredictorKind::ALL {
            row(&format!("  {}, %", predictor.name()), &|cut| {
                let count = *cut.by_predictor.get(predictor.name())?;
                Some(100.0 * count as f64 / cut.updates.max(1) as f64)
            });
        }
        row("bits an update", &|cut| Some(cut.bits_per_update));
        row("kbit/s", &|cut| Some(cut.kbps));
        row("  which bodies", &|cut| Some(cut.parts_kbps.body_ids));
        row("  which predictors", &|cut| Some(cut.parts_kbps.predictors));
        row("  poses", &|cut| Some(cut.parts_kbps.poses));
        row("  velocities", &|cut| Some(cut.parts_kbps.velocities));
        row("error p50, mm", &|cut| Some(1e3 * cut.surface_error_m?.p50));
        row("error p99, mm", &|cut| Some(1e3 * cut.surface_error_m?.p99));
        row("error max, mm", &|cut| Some(1e3 * cut.surface_error_m?.max));
        f.write_str(&aligned(&rows))
    }
}

/// A body's turn to be cut.
struct SearchOrder {
    body: usize,
    holds: bool,
}

/// Most bodies that others may be held by, as publishers have it.
const PARENTS_MAX: usize = 16;

/// All bodies, the largest first if they are larger than the smallest by enough to hold it.
fn parents_first(paths: &Paths<'_>) -> Vec<SearchOrder> {
    let mut order: Vec<_> = (0..paths.len()).collect();
    order.sort_by(|a, b| paths.radius(*b).total_cmp(&paths.radius(*a)));
    let smallest = order.last().map_or(0.0, |last| paths.radius(*last));
    let holds = |place: usize, body: usize| {
        place < PARENTS_MAX && paths.radius(body) >= smallest * PARENT_RATIO
    };
    order
        .into_iter()
        .enumerate()
        .map(|(place, body)| SearchOrder {
            body,
            holds: holds(place, body),
        })
        .collect()
}

/// What the cutting of every body needs.
struct Search<'a> {
    recording: &'a Recording,
    tolerance: Tolerance,
    publish_interval: NonZeroU32,
    objective: Objective,
    /// By the bits of both dampings.
    bases: BTreeMap<[u32; 2], Basis>,
    parents: Vec<ParentPath>,
}

impl<'a> Search<'a> {
    fn new(
        recording: &'a Recording,
        tolerance: Tolerance,
        publish_interval: NonZeroU32,
        objective: Objective,
    ) -> Self {
        Self {
            recording,
            tolerance,
            publish_interval,
            objective,
            bases: BTreeMap::new(),
            parents: Vec::new(),
        }
    }

    /// Cuts every body's way; `done` is called after each.
    fn cut_all(mut self, paths: &Paths<'_>, done: &mut dyn FnMut()) -> Cut {
        let mut found = Found::default();
        // What may hold others is cut first: what it holds is judged by where it is predicted_motion to be.
        for place in parents_first(paths) {
            if let Some(path) = paths.get(place.body) {
                let segmentation = self.cut(&path, found.present.len());
                found.take(&path, &segmentation);
                if place.holds {
                    self.parents.push(ParentPath {
                        radius: path.radius,
                        first: path.first,
                        predicted_in_world: segmentation.predicted_in_world,
                    });
                }
            }
            done();
        }
        found.figures(self.recording, self.publish_interval)
    }

    fn cut(&mut self, path: &Path, body: usize) -> Segmentation {
        let damping = [path.damping.linear, path.damping.angular].map(f32::to_bits);
        let integrator = self.recording.integrator;
        let basis = self
            .bases
            .entry(damping)
            .or_insert_with(|| Basis::new(integrator, path));
        let context = SegmentContext {
            path,
            basis,
            parents: &self.parents,
            tolerance: self.tolerance.scaled(path.tolerance_scale),
            rate: integrator.rate,
            publish_interval: self.publish_interval,
        };
        cut(&context, body, self.objective)
    }
}

/// What was found so far.
#[derive(Debug, Default)]
struct Found {
    updates: Vec<segments::SegmentUpdate>,
    present: Vec<(usize, usize, PredictorKind)>,
    errors: WithZeros,
}

impl Found {
    fn take(&mut self, path: &Path, segmentation: &Segmentation) {
        let predictor = match path.known.predictor {
            rhumb_reckoning::Predictor::Rest => PredictorKind::Rest,
            _ => PredictorKind::Ballistic,
        };
        self.present.push((path.first, path.end(), predictor));
        self.updates.extend(&segmentation.updates);
        self.errors.extend(&segmentation.errors_m, 0);
    }

    fn figures(mut self, recording: &Recording, publish_interval: NonZeroU32) -> Cut {
        self.updates
            .sort_by_key(|update| (update.frame, update.body));
        let frames = recording.ticks() / publish_interval.get() + 1;
        let bits: Bits = code::bits(&self.updates, &self.present, frames as usize);
        let step_s = recording.integrator.rate.step().seconds();
        let simulated_s = (f64::from(recording.ticks()) * step_s).max(step_s);
        let kbps = |bits: f64| bits / 1e3 / simulated_s;
        let updates = self.updates.len() as u64;
        let mut by_predictor: BTreeMap<String, u64> = PredictorKind::ALL
            .map(|predictor| (predictor.name().into(), 0))
            .into();
        for update in &self.updates {
            *by_predictor
                .entry(update.predictors[1].name().into())
                .or_default() += 1;
        }
        Cut {
            updates,
            updates_per_second: updates as f64 / simulated_s,
            by_predictor,
            kbps: kbps(bits.sum()),
            bits_per_update: bits.sum() / updates.max(1) as f64,
            parts_kbps: PartRates {
                body_ids: kbps(bits.body_ids),
                predictors: kbps(bits.predictors),
                poses: kbps(bits.poses),
                velocities: kbps(bits.velocities),
            },
            surface_error_m: ErrorQuantiles::of(&mut self.errors),
        }
    }
}
