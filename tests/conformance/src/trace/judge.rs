//! Compares the copies in a trace with its truth.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DQuat, DVec3};

use super::grid::{Body, GridReader, Pose, beside};
use super::messages::{Breach, Poses, States, TickStats};
use super::run_metadata::RunMetadata;
use crate::outcome::{CaseResult, Stop};

/// Numeric error of the comparison, in metres: copies hold f32, and rotations are normalised twice. At 128 m both
/// amount to 16 µm.
const EXACT_M: f64 = 2e-5;
/// The same for each metre of a body's radius: half a step of the grid in each part of two rotations.
const EXACT_M_PER_RADIUS: f64 = 4e-6;
/// The number of static bodies in the trace format.
const STATIC: i32 = 1;
/// Ticks of sleep after which the rest pose must have arrived.
const SLEPT_TICKS: u64 = 60;

/// A body of the scene.
#[derive(Clone, Debug)]
struct Placed {
    kind: i32,
    radius_m: f64,
    /// Factor from the tolerance of the run to that of the body.
    scale: f64,
    began: Pose,
}

/// The engine's bodies at a tick.
#[derive(Debug, Default)]
pub(super) struct TracedTruth {
    poses: BTreeMap<Body, Pose>,
    grid: GridReader,
    placed: BTreeMap<Body, Placed>,
    /// The tick at which each sleeping body fell asleep.
    asleep: BTreeMap<Body, u64>,
    coming: Vec<Body>,
    leaving: Vec<Body>,
    tick: u64,
}

impl TracedTruth {
    /// Advances to a tick. Placements and removals after a tick take effect at the next; those before the first take
    /// effect immediately.
    pub(super) fn step(&mut self, states: &States) {
        self.settle();
        self.tick = states.tick;
        let (columns, steps) = (states.columns(), states.steps());
        for (place, body) in bodies(&states.index, &states.generation).enumerate() {
            let pose = self.grid.pose(body, &columns, &steps, place);
            self.poses.extend(pose.map(|pose| (body, pose)));
            if states.awake.get(place) == Some(&true) {
                self.asleep.remove(&body);
            } else {
                self.asleep.entry(body).or_insert(states.tick);
            }
        }
        self.leaving
            .extend(bodies(&states.removed_index, &states.removed_generation));
        for placed in &states.placed {
            let body = (placed.index, placed.generation);
            let mut began = [0.0; 7];
            for (part, number) in began.iter_mut().zip(&placed.motion) {
                *part = *number;
            }
            let (kind, radius_m) = (placed.kind, placed.bounding_radius_m);
            let scale = 2.0_f64.powi(placed.tolerance_scale);
            self.placed.insert(
                body,
                Placed {
                    kind,
                    radius_m,
                    scale,
                    began,
                },
            );
            self.coming.push(body);
        }
        if states.tick == 0 {
            self.settle();
        }
    }

    fn settle(&mut self) {
        for body in std::mem::take(&mut self.coming) {
            self.poses
                .extend(self.placed.get(&body).map(|placed| (body, placed.began)));
        }
        for body in std::mem::take(&mut self.leaving) {
            self.poses.remove(&body);
            self.asleep.remove(&body);
        }
    }
}

/// One client's copy, frame by frame.
#[derive(Debug)]
pub(super) struct TracedCopy {
    scene: String,
    mode: String,
    link: String,
    tolerance_m: Option<f64>,
    has_budget: bool,
    mismatches: u64,
    frames: BTreeMap<u32, (u64, u64)>,
    poses_by_frame: BTreeMap<u32, Poses>,
    breaches: BTreeMap<(u64, Body), i32>,
    copy: BTreeMap<Body, Option<Pose>>,
    grid: GridReader,
    next: u32,
    judged: u64,
    untold: Vec<(u64, Body, f64)>,
    unexplained: BTreeSet<(u64, Body)>,
    /// Bodies that slept long but were displayed elsewhere at the last compared frame, with the error in metres.
    off_asleep: Vec<(Body, f64)>,
}

impl TracedCopy {
    /// A run from its metadata.
    ///
    /// # Errors
    ///
    /// The number in the metadata that is missing or malformed.
    pub(super) fn of(config: &RunMetadata) -> Result<Self, String> {
        let sent = |name: &str| config.get(name).cloned().unwrap_or_default();
        let mismatches = config.get("mismatches").map(String::as_str);
        let tolerance_m = config.get("tolerance_m").map(|text| {
            let number = text.parse();
            number.map_err(|_| format!("tolerance_m is not a number: {text:?}"))
        });
        Ok(Self {
            scene: sent("scene"),
            mode: sent("mode"),
            link: sent("link"),
            tolerance_m: tolerance_m.transpose()?,
            has_budget: config.contains_key("budget_bytes_per_second"),
            mismatches: (mismatches.and_then(|text| text.parse().ok()))
                .ok_or_else(|| format!("mismatches is not a count: {mismatches:?}"))?,
            frames: BTreeMap::new(),
            poses_by_frame: BTreeMap::new(),
            breaches: BTreeMap::new(),
            copy: BTreeMap::new(),
            grid: GridReader::default(),
            next: 0,
            judged: 0,
            untold: Vec::new(),
            unexplained: BTreeSet::new(),
            off_asleep: Vec::new(),
        })
    }

    pub(super) fn name(&self) -> String {
        let link = if self.link.is_empty() {
            "no link"
        } else {
            &self.link
        };
        format!(
            "{} by {}, over {link}, keeps the accuracy promise",
            self.scene, self.mode
        )
    }

    pub(super) fn add_frame(&mut self, frame: &TickStats) {
        self.frames
            .insert(frame.frame, (frame.tick, frame.body_ticks));
    }

    pub(super) fn add_poses(&mut self, poses: Poses) {
        self.poses_by_frame.insert(poses.frame, poses);
    }

    pub(super) fn add_breach(&mut self, breach: &Breach) {
        let body = (breach.index, breach.generation);
        self.breaches.insert((breach.tick, body), breach.cause);
    }

    /// Applies all frames of this tick, and compares each with the truth.
    pub(super) fn follow(&mut self, truth: &TracedTruth, tick: u64) {
        while let Some(&(at, body_ticks)) = self.frames.get(&self.next)
            && at <= tick
        {
            if let Some(poses) = self.poses_by_frame.remove(&self.next) {
                self.show(&poses, truth);
            }
            self.next += 1;
            if body_ticks > 0 {
                self.compare(truth, at);
            }
        }
    }

    fn show(&mut self, poses: &Poses, truth: &TracedTruth) {
        for body in bodies(&poses.gone_index, &poses.gone_generation) {
            self.copy.insert(body, None);
        }
        let (columns, steps) = (poses.columns(), poses.steps());
        for (place, body) in bodies(&poses.index, &poses.generation).enumerate() {
            let pose = if poses.from_truth {
                let real = truth.poses.get(&body);
                real.and_then(|real| beside(real, &steps, place))
            } else {
                self.grid.pose(body, &columns, &steps, place)
            };
            self.copy.insert(body, pose);
        }
    }

    fn compare(&mut self, truth: &TracedTruth, tick: u64) {
        self.off_asleep.clear();
        for (body, real) in &truth.poses {
            let Some(placed) = truth
                .placed
                .get(body)
                .filter(|placed| placed.kind != STATIC)
            else {
                continue;
            };
            // A body without a frame is displayed where it was placed.
            let shown = self.copy.get(body).copied().unwrap_or(Some(placed.began));
            let Some(shown) = shown else {
                continue;
            };
            self.judged += 1;
            let error_m = surface_error_m(real, &shown, placed.radius_m);
            let exact_m = EXACT_M + EXACT_M_PER_RADIUS * placed.radius_m;
            let allowed_m = self.tolerance_m.map(|tolerance| tolerance * placed.scale);
            if allowed_m.is_some_and(|allowed| error_m > allowed + exact_m) {
                match self.breaches.get(&(tick, *body)) {
                    None => self.untold.push((tick, *body, error_m)),
                    Some(cause) if !EXPLAINED.contains(cause) => {
                        self.unexplained.insert((tick, *body));
                    }
                    Some(_) => {}
                }
            }
            let slept = truth
                .asleep
                .get(body)
                .map(|since| tick.saturating_sub(*since));
            if slept >= Some(SLEPT_TICKS) && error_m > exact_m {
                self.off_asleep.push((*body, error_m));
            }
        }
    }

    /// The accuracy promise was kept.
    pub(super) fn judge(&self, truth: &TracedTruth) -> CaseResult {
        if self.judged == 0 {
            return Err(Stop::Inconclusive("no frame shows a body".into()));
        }
        if self.mismatches > 0 {
            return Stop::fail(format!("{} checksums differ", self.mismatches));
        }
        if let Some((tick, body, error_m)) = self.untold.first() {
            let count = self.untold.len();
            return Stop::fail(format!(
                "{count} breaches are not recorded; the first is {body:?}, {error_m} m off at {tick}"
            ));
        }
        if let Some((tick, body)) = self.unexplained.first() {
            let count = self.unexplained.len();
            return Stop::fail(format!(
                "{count} breaches are caused by a fault; the first is {body:?} at {tick}"
            ));
        }
        let lossless = self.link.is_empty() && !self.has_budget;
        match self.off_asleep.first().filter(|_| lossless) {
            Some((body, error_m)) => Stop::fail(format!(
                "{} sleeping bodies are displayed elsewhere at {}; the first is {body:?}, {error_m} m off",
                self.off_asleep.len(),
                truth.tick
            )),
            None => Ok(()),
        }
    }
}

/// Causes that excuse a breach: loss, delay, exhausted budget.
const EXPLAINED: [i32; 3] = [1, 2, 4];

fn bodies(index: &[u32], generation: &[u32]) -> impl Iterator<Item = Body> {
    index.iter().copied().zip(generation.iter().copied())
}

/// Greatest distance between equal points of a body's surface in two poses, in metres: |Δp| + 2 r sin(turn / 2).
fn surface_error_m(real: &Pose, shown: &Pose, radius_m: f64) -> f64 {
    if real == shown {
        return 0.0;
    }
    let parts = |pose: &Pose| {
        let [px, py, pz, qx, qy, qz, qw] = pose.map(f64::from);
        let rotation = DQuat::from_xyzw(qx, qy, qz, qw).normalize();
        (DVec3::new(px, py, pz), rotation)
    };
    let ((one, turned), (other, also)) = (parts(real), parts(shown));
    let between = turned.conjugate() * also;
    let half_sine = DVec3::new(between.x, between.y, between.z).length();
    one.distance(other) + 2.0 * radius_m * half_sine.min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(pairs: &[(&str, &str)]) -> Result<TracedCopy, String> {
        let pairs = pairs.iter();
        let config = pairs.map(|(name, text)| ((*name).to_owned(), (*text).to_owned()));
        TracedCopy::of(&config.collect())
    }

    #[test]
    fn metadata_without_its_numbers_is_refused() {
        let run = read(&[("mismatches", "3"), ("tolerance_m", "0.05")]).expect("valid metadata");
        assert_eq!((run.mismatches, run.tolerance_m), (3, Some(0.05)));
        assert!(
            read(&[("mismatches", "0")]).is_ok(),
            "a missing tolerance must be refused"
        );
        for wrong in [
            &[][..],
            &[("mismatches", "some")],
            &[("mismatches", "0"), ("tolerance_m", "wide")],
        ] {
            assert!(read(wrong).is_err(), "{wrong:?}");
        }
    }
}
