//! `rhumb-bench dev limit`: fewest updates and bits if the future is known.
//!
//! For each body of a recording the search greedily takes the longest segments by any standard predictor, each
//! verified by the normative prediction. An ideal coder then prices them. The result is an upper bound of the true
//! minimum: better fits may make segments longer. A real publisher has more to do: it does not know the future, and it
//! sends packets, refreshes and exact rest poses. One cut uses motions as fitted, another those that the protocol can
//! express; the difference is the cost of its grid. Other tasks add the limit to their runs.
//!
//! The ideal coder is adaptive and writes no packet. Each choice costs the logarithm of its frequency among earlier choices
//! (Krichevsky and Trofimov, 1981), so the cost of learning is included. Contexts are simple: predictors, axes, and time
//! since a body's last update.

mod context;
mod segments;

use std::collections::BTreeMap;
use std::fmt;
use std::num::NonZeroU32;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use rhumb_reckoning::Tolerance;
use serde::{Deserialize, Serialize};

use crate::numbers::{WithZeros, aligned, number, pretty_json};
use crate::output::{self, Failure, ended};
use crate::record::{LimitRates, Run};
use crate::recording::{Recording, RecordingSource, ToleranceOptions};
use crate::summary::ErrorQuantiles;
use context::{Basis, ParentPath, Path, Paths, PredictorKind, SegmentContext};
use segments::{Objective, PARENT_RATIO, SegmentUpdate, Segmentation, cut};

/// Arguments: recording, tolerance, output.
#[derive(Clone, Debug, Args)]
pub struct LimitArguments {
    #[command(flatten)]
    source: RecordingSource,
    #[command(flatten)]
    tolerance_options: ToleranceOptions,
    /// Check the tolerance at every n-th tick of the recording, as if no other ticks were published.
    #[arg(long, default_value = "1")]
    publish_interval: NonZeroU32,
    /// Folder for limit.json; created if missing.
    #[arg(long, default_value = "results/limit")]
    out: PathBuf,
}

/// Fewest updates and bits found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Limit {
    /// Name of the recorded scene.
    pub scene: String,
    /// Number of non-static bodies.
    pub bodies: u32,
    /// Ticks of the recording.
    pub ticks: u32,
    /// Ticks between checks of the tolerance.
    pub publish_interval: u32,
    /// Tolerance, metres; of the position alone if rotations have a bound of their own.
    pub tolerance_m: f64,
    /// Bound of rotations, radians.
    pub turn_rad: Option<f64>,
    /// Cut with the fewest segments.
    pub fewest_updates: Cut,
    /// The same with motions rounded to the protocol's grid and verified as rounded.
    pub fewest_updates_on_grid: Cut,
    /// Cut with few bits, or the cut with the fewest segments if it takes at most as many bits.
    pub fewest_bits: Cut,
}

/// The paths of all bodies, cut into segments.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cut {
    /// Segments without the first of each body: the updates to send.
    pub updates: u64,
    /// Updates per simulated second.
    pub updates_per_second: f64,
    /// Updates by predictor.
    pub by_predictor: BTreeMap<String, u64>,
    /// Rate of an ideal coder, 1,000 bit/s of simulated time.
    pub kbps: f64,
    /// Bits of the ideal coder per update.
    pub bits_per_update: f64,
    /// Rate of each part.
    pub parts_kbps: PartRates,
    /// Surface errors of bodies that moved since the previous frame; never above the tolerance.
    pub surface_error_m: Option<ErrorQuantiles>,
}

/// Rates of the parts of a cut, 1,000 bit/s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PartRates {
    /// Ids of the updated bodies.
    pub body_ids: f64,
    /// Choice of predictors.
    pub predictors: f64,
    /// Positions and rotations.
    pub poses: f64,
    /// Velocities.
    pub velocities: f64,
}

/// Computes a limit. Exit code 0 if it was computed and written, 1 otherwise.
pub fn limit(arguments: &LimitArguments) -> ExitCode {
    ended(limit_all(arguments))
}

fn limit_all(arguments: &LimitArguments) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let tolerance = arguments.tolerance_options.tolerance()?;
    let recording = arguments.source.read()?;
    let limit = Limit::of(&recording, tolerance, arguments.publish_interval);
    output::write_file(
        &arguments.out.join("limit.json"),
        limit.to_json().as_bytes(),
    )?;
    output::print_text(&limit.to_string())?;
    output::print_text(&format!("\nwritten to {}\n", arguments.out.display()))?;
    Ok(())
}

impl Limit {
    /// Computes the limit of a recording under a tolerance that holds at every `publish_interval`-th tick.
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

    /// The text of `limit.json`.
    #[must_use]
    pub fn to_json(&self) -> String {
        pretty_json(self).expect("numbers, texts and maps keyed by texts are always JSON")
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

/// Position of a body in the search order.
struct SearchOrder {
    body: usize,
    may_be_parent: bool,
}

/// Largest number of parents, the same as the publisher's.
const PARENTS_MAX: usize = 16;

/// All bodies, largest first; a body may be a parent if it is sufficiently larger than the smallest.
fn parents_first(paths: &Paths<'_>) -> Vec<SearchOrder> {
    let mut order: Vec<_> = (0..paths.len()).collect();
    order.sort_by(|a, b| paths.radius(*b).total_cmp(&paths.radius(*a)));
    let smallest = order.last().map_or(0.0, |last| paths.radius(*last));
    let may_be_parent = |place: usize, body: usize| {
        place < PARENTS_MAX && paths.radius(body) >= smallest * PARENT_RATIO
    };
    order
        .into_iter()
        .enumerate()
        .map(|(place, body)| SearchOrder {
            body,
            may_be_parent: may_be_parent(place, body),
        })
        .collect()
}

/// State of the search over all bodies.
struct Search<'a> {
    recording: &'a Recording,
    tolerance: Tolerance,
    publish_interval: NonZeroU32,
    objective: Objective,
    /// Keyed by the bits of both dampings.
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

    /// Cuts every body's path; calls `done` after each.
    fn cut_all(mut self, paths: &Paths<'_>, done: &mut dyn FnMut()) -> Cut {
        let mut found = Found::default();
        // Parents are cut first: children are predicted relative to their parent's predicted pose.
        for place in parents_first(paths) {
            if let Some(path) = paths.get(place.body) {
                let segmentation = self.cut(&path, found.present.len());
                found.add(&path, &segmentation);
                if place.may_be_parent {
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

/// Updates and errors found so far.
#[derive(Debug, Default)]
struct Found {
    updates: Vec<SegmentUpdate>,
    present: Vec<(usize, usize, PredictorKind)>,
    errors: WithZeros,
}

impl Found {
    fn add(&mut self, path: &Path, segmentation: &Segmentation) {
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
        let bits: Bits = bits(&self.updates, &self.present, frames as usize);
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

/// A tolerance and the publish interval at which it holds.
pub(crate) type Promised = (Tolerance, NonZeroU32);

/// Adds the limit to each run that states a tolerance; equal tolerances are computed once.
pub(crate) fn set_beside_limits<'a>(
    recording: &Recording,
    runs: impl Iterator<Item = (&'a mut Run, Option<Promised>)>,
) {
    let mut known = BTreeMap::new();
    for (run, promised) in runs {
        run.config.limit = promised.map(|(tolerance, publish_interval)| {
            let least = known.entry((tolerance, publish_interval));
            *least.or_insert_with(|| Limit::of(recording, tolerance, publish_interval).rates())
        });
    }
}

impl Limit {
    /// The figures to which runs are compared.
    #[must_use]
    pub fn rates(&self) -> LimitRates {
        LimitRates {
            updates_per_second: self.fewest_updates.updates_per_second,
            updates_on_grid_per_second: self.fewest_updates_on_grid.updates_per_second,
            kbps: self.fewest_bits.kbps,
        }
    }
}

/// Bits of the parts of the updates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Bits {
    /// Ids of the bodies updated in each frame.
    body_ids: f64,
    /// Choice of predictors.
    predictors: f64,
    /// Positions and rotations.
    poses: f64,
    /// Velocities.
    velocities: f64,
}

impl Bits {
    fn sum(&self) -> f64 {
        self.body_ids + self.predictors + self.poses + self.velocities
    }
}

/// Context of a choice; choices in one context share statistics.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Decision {
    Named { silent: u32, still: bool },
    PredictorKind { last: PredictorKind },
    OtherParent,
    OtherAcceleration { last: PredictorKind },
    Implied { predictors: [PredictorKind; 2] },
    Zero(Number),
    Sign(Number),
    Longer(Number, u32),
    Second(Number),
}

/// Context of a number in an update: predictors, quantity and axis.
type Number = ([PredictorKind; 2], CodedQuantity, u8);

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum CodedQuantity {
    Position,
    Turn,
    Linear,
    Angular,
    ConstantAcceleration,
}

/// Counts of each alternative per context.
#[derive(Debug, Default)]
struct AdaptiveModel {
    counts: BTreeMap<Decision, [f64; PredictorKind::ALL.len()]>,
}

impl AdaptiveModel {
    /// Bits of one of `of` alternatives.
    fn choose(&mut self, place: Decision, chosen: usize, of: usize) -> f64 {
        let counts = self
            .counts
            .entry(place)
            .or_insert([0.5; PredictorKind::ALL.len()]);
        let all: f64 = counts[..of].iter().sum();
        let bits = -(counts[chosen] / all).log2();
        counts[chosen] += 1.0;
        bits
    }

    fn decide(&mut self, place: Decision, yes: bool) -> f64 {
        self.choose(place, usize::from(yes), 2)
    }

    /// Zero flag, sign, binary length and second digit; lower digits count as random.
    fn number(&mut self, number: Number, value: i32) -> f64 {
        let mut bits = self.decide(Decision::Zero(number), value == 0);
        if value == 0 {
            return bits;
        }
        bits += self.decide(Decision::Sign(number), value < 0);
        let size = value.unsigned_abs();
        let length = size.ilog2();
        for digit in 0..=length {
            bits += self.decide(Decision::Longer(number, digit), digit < length);
        }
        if length > 0 {
            let second = size >> (length - 1) & 1 == 1;
            bits += self.decide(Decision::Second(number), second) + f64::from(length - 1);
        }
        bits
    }

    fn numbers(
        &mut self,
        predictors: [PredictorKind; 2],
        kind: CodedQuantity,
        values: [i32; 3],
    ) -> f64 {
        let axes = values.into_iter().zip(0..);
        axes.map(|(value, axis)| self.number((predictors, kind, axis), value))
            .sum()
    }

    fn update(&mut self, update: &SegmentUpdate, bits: &mut Bits) {
        let predictors = update.predictors;
        let [last, next] = predictors;
        bits.predictors += self.choose(
            Decision::PredictorKind { last },
            next as usize,
            PredictorKind::ALL.len(),
        );
        if next == PredictorKind::Attached {
            bits.predictors += self.decide(Decision::OtherParent, update.changes_parent);
        }
        if next == PredictorKind::ConstantAcceleration {
            bits.predictors += self.decide(
                Decision::OtherAcceleration { last },
                update.constant_acceleration.is_some(),
            );
        }
        if let Some(constant_acceleration) = update.constant_acceleration {
            bits.predictors += self.numbers(
                predictors,
                CodedQuantity::ConstantAcceleration,
                constant_acceleration.steps().map(i32::from),
            );
            bits.predictors += self.number(
                (predictors, CodedQuantity::ConstantAcceleration, 3),
                i32::from(constant_acceleration.exponent()),
            );
        }
        let residual = &update.residual;
        bits.poses += self.numbers(predictors, CodedQuantity::Position, residual.position);
        bits.poses += self.numbers(predictors, CodedQuantity::Turn, residual.turn);
        if next.moves() {
            let implied = residual.velocity.is_none();
            bits.velocities += self.decide(Decision::Implied { predictors }, implied);
        }
        if let Some(velocity) = residual.velocity {
            bits.velocities += self.numbers(predictors, CodedQuantity::Linear, velocity.linear);
            bits.velocities += self.numbers(predictors, CodedQuantity::Angular, velocity.angular);
        }
    }
}

/// Frames since a body's last update, by powers of two; not counted while the body is absent.
#[derive(Clone, Copy, Debug)]
struct SilentSpan {
    since: usize,
    until: usize,
    predictor: PredictorKind,
}

/// Bits of all updates, sorted by frame and body. `present` gives each body's first frame, end frame and first
/// predictor.
fn bits(
    updates: &[SegmentUpdate],
    present: &[(usize, usize, PredictorKind)],
    frames: usize,
) -> Bits {
    let mut silences: Vec<_> = present
        .iter()
        .map(|&(since, until, predictor)| SilentSpan {
            since,
            until,
            predictor,
        })
        .collect();
    let mut model = AdaptiveModel::default();
    let mut bits = Bits::default();
    let mut updates = updates.iter().peekable();
    for frame in 0..frames {
        for (body, silence) in silences.iter_mut().enumerate() {
            if frame <= silence.since || frame >= silence.until {
                continue;
            }
            let updated = updates.next_if(|update| update.frame == frame && update.body == body);
            let place = Decision::Named {
                silent: (frame - silence.since).ilog2(),
                still: silence.predictor == PredictorKind::Rest,
            };
            bits.body_ids += model.decide(place, updated.is_some());
            if let Some(update) = updated {
                model.update(update, &mut bits);
                (silence.since, silence.predictor) = (frame, update.predictors[1]);
            }
        }
    }
    bits
}

#[cfg(test)]
mod tests {
    use rhumb_reckoning::Residual;

    use super::*;

    fn update(frame: usize, body: usize, x: i32) -> SegmentUpdate {
        SegmentUpdate {
            frame,
            body,
            predictors: [PredictorKind::Rest; 2],
            changes_parent: false,
            constant_acceleration: None,
            residual: Residual {
                position: [x, 0, 0],
                ..Residual::default()
            },
        }
    }

    #[test]
    fn a_constant_value_costs_almost_nothing() {
        let present = vec![(0, 1_001, PredictorKind::Rest); 1];
        let updates: Vec<_> = (1..=1_000).map(|frame| update(frame, 0, 0)).collect();
        let bits = bits(&updates, &present, 1_001);
        assert!(bits.sum() < 100.0, "{bits:?}");
    }

    #[test]
    fn a_random_value_costs_its_entropy() {
        // Two-digit positions, all equally likely.
        let present = vec![(0, 4_001, PredictorKind::Rest); 1];
        let value = |frame: usize| [-3, -2, 2, 3][((frame * 2_654_435_761) >> 7) & 3];
        let updates: Vec<_> = (1..=4_000).map(|f| update(f, 0, value(f))).collect();
        let bits = bits(&updates, &present, 4_001);
        let each = bits.poses / 4_000.0;
        assert!((each - 2.0).abs() < 0.05, "{each}");
    }
}
