//! Poses of bodies by time become frames of a constant rate.
//!
//! Rotations are checked and continue their sign. A gap of up to three frames is filled, a longer one takes the body away
//! until its next pose. A body with one pose alone is static.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DQuat, DVec3, Vec3};
use rhumb_protocol::limits::BODIES_MAX;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Shape, ShapeId};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, BodyState, Damping, Inertia, Integrator, Rate, Tick};

use super::error::{Place, RecordingError, RowDefect};
use super::options::{MissingPoses, ReadOptions, rate_of_step};
use super::recorded::{self, FRAMES_MAX, Recording, Velocities, activity_from_records, set_digest};
use super::stays::{FILLED_MAX, FramedPose, Path, Removal, Removals, Stay, stays};
use crate::record::{Placed, Truth};

/// Largest distance of a time from its frame, as a share of a step.
const JITTER_MAX: f64 = 0.25;
/// Rounding of times that are exact otherwise, nanoseconds.
const TIMES_ROUNDED_NS: f64 = 10.0;
/// Distance of a quaternion's length from one that counts as rounded.
const LENGTH_SLACK: f64 = 1e-3;
/// Most poses that are made for each that is recorded, in a recording whose made poses are more than the most frames.
const MADE_MAX: u64 = 16;
/// Most frames that a sentence names.
const FRAMES_NAMED: usize = 5;
/// Distance from zero, metres, beyond which single precision knows no centimetres.
const POSITION_MAX_M: f64 = 1e6;

/// Recorded poses.
#[derive(Clone, Debug, Default)]
pub(super) struct TimedPoses {
    pub(super) bodies: Vec<RecordedBody>,
    pub(super) poses: Vec<TimedPose>,
    pub(super) removals: Vec<Removal>,
    /// True if a body stays until it is removed, whatever its poses.
    pub(super) persist: bool,
    /// Sentences on what the file has and the recording has not.
    pub(super) left_out: Vec<String>,
    /// The frames that poses are said to be of.
    frames: BTreeSet<String>,
    /// The velocities that the file has in part only, so that they are not used.
    pub(super) part_of_velocities: Option<String>,
    numbers: BTreeMap<String, usize>,
}

/// A body of a file.
#[derive(Clone, Debug)]
pub(super) struct RecordedBody {
    pub(super) name: String,
    /// The frame of its poses, if that may be one of the bodies.
    pub(super) parent: Option<String>,
    /// Its shape, if the file has one.
    pub(super) shape: Option<Shape>,
    /// Its moments of inertia, if the file has them.
    pub(super) inertia: Option<Inertia>,
    /// The number of those that are removed together, if it is one of them.
    pub(super) group: Option<usize>,
}

/// A file has more bodies than a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TooManyBodies;

impl TooManyBodies {
    pub(super) const fn at(self, place: Place) -> RecordingError {
        RecordingError::TooManyBodies { place }
    }
}

impl From<TooManyBodies> for RecordingError {
    fn from(TooManyBodies: TooManyBodies) -> Self {
        Self::Bodies {
            bodies: u64::from(BODIES_MAX) + 1,
        }
    }
}

/// A pose of a body at a moment.
#[derive(Clone, Debug)]
pub(super) struct TimedPose {
    /// Nanoseconds, from any origin.
    pub(super) at_ns: i64,
    /// The number of its body.
    pub(super) body: usize,
    /// Metres.
    pub(super) position: DVec3,
    /// As recorded, x, y, z, w.
    pub(super) rotation: DQuat,
    /// Linear and angular velocity, world axes, if recorded.
    pub(super) velocity: Option<[DVec3; 2]>,
    pub(super) place: Place,
}

impl TimedPose {
    /// True if it says the same of the body.
    fn is_as(&self, other: &Self) -> bool {
        let said = |pose: &Self| (pose.position, pose.rotation, pose.velocity);
        said(self) == said(other)
    }

    /// The error that another pose of the body is of the same time.
    fn contradicts(&self, bodies: &[RecordedBody], other: &Place) -> RecordingError {
        RecordingError::Row {
            place: self.place.clone(),
            defect: RowDefect::Contradiction {
                body: bodies[self.body].name.clone(),
                other: Box::new(other.clone()),
            },
        }
    }
}

/// Poses by body and frame.
struct Framed {
    paths: Vec<Path>,
    /// The last frame.
    last: u64,
    removals: Removals,
}

impl TimedPoses {
    /// The number of a body of this name, which is added if it is new.
    pub(super) fn body(
        &mut self,
        name: &str,
        parent: Option<&str>,
    ) -> Result<usize, TooManyBodies> {
        if let Some(number) = self.numbers.get(name) {
            return Ok(*number);
        }
        let number = self.new_body(name, parent)?;
        self.numbers.insert(name.to_owned(), number);
        Ok(number)
    }

    /// The number of a new body, which its name alone does not find again.
    pub(super) fn new_body(
        &mut self,
        name: &str,
        parent: Option<&str>,
    ) -> Result<usize, TooManyBodies> {
        let number = self.bodies.len();
        if number >= BODIES_MAX as usize {
            return Err(TooManyBodies);
        }
        self.bodies.push(RecordedBody {
            name: name.to_owned(),
            parent: parent.map(str::to_owned),
            shape: None,
            inertia: None,
            group: None,
        });
        Ok(number)
    }

    /// Takes the name of the frame of a pose.
    pub(super) fn of_frame(&mut self, frame: &str) {
        if !self.frames.contains(frame) {
            self.frames.insert(frame.to_owned());
        }
    }

    /// A sentence if poses are of several frames that no transform connects.
    fn frames_note(&self) -> Option<String> {
        let parents = self.bodies.iter().filter_map(|body| body.parent.as_deref());
        let roots = parents.filter(|parent| !self.numbers.contains_key(*parent));
        let frames: BTreeSet<&str> = roots
            .chain(self.frames.iter().map(String::as_str))
            .collect();
        let named: Vec<&str> = frames
            .into_iter()
            .filter(|frame| !frame.is_empty())
            .collect();
        (named.len() > 1).then(|| {
            let more = match named.len().saturating_sub(FRAMES_NAMED) {
                0 => String::new(),
                more => format!(" and {more} more"),
            };
            let named = named[..named.len().min(FRAMES_NAMED)].join(", ");
            format!("poses are of the frames {named}{more}, and are taken as of one")
        })
    }

    /// The number of a body of this name, if it is known.
    pub(super) fn known(&self, name: &str) -> Option<usize> {
        self.numbers.get(name).copied()
    }

    /// The recording of these poses.
    pub(super) fn recording(
        mut self,
        name: &str,
        options: &ReadOptions,
    ) -> Result<Recording, RecordingError> {
        self.check()?;
        let w_first_note = self.w_first_note();
        let rate = match (options.resample, options.rate) {
            (Some(rate), _) => {
                self.resample(rate)?;
                rate
            }
            (None, Some(rate)) => rate,
            (None, None) => self.find_rate()?,
        };
        let framed = self.frame(rate)?;
        let has_velocities = self.poses.iter().all(|pose| pose.velocity.is_some());
        let paths = self.in_world(framed.paths)?;
        let truth = self.truth(paths, (framed.last, &framed.removals), options)?;
        let mut recording = Recording {
            name: name.to_owned(),
            played: None,
            truth,
            integrator: Integrator {
                rate,
                substeps: std::num::NonZeroU32::MIN,
            },
            gravity: options.gravity.unwrap_or(Vec3::ZERO),
            damping: Damping::default(),
            inertias: BTreeMap::new(),
            velocities: Velocities::Recorded,
            notes: self.notes(rate, options, has_velocities),
        };
        recording.notes.extend(w_first_note);
        activity_from_records(&mut recording.truth);
        if !has_velocities {
            recorded::derive(&mut recording)?;
        }
        set_digest(&mut recording.truth);
        Ok(recording)
    }

    /// Every number is finite, every rotation one.
    fn check(&mut self) -> Result<(), RecordingError> {
        for pose in &mut self.poses {
            let defect = |defect| RecordingError::Row {
                place: pose.place.clone(),
                defect,
            };
            let is_far = pose.position.abs().max_element() > POSITION_MAX_M;
            if !pose.position.is_finite() || is_far {
                return Err(defect(RowDefect::OutOfRange {
                    of: "position",
                    most: Some("1e6 m from zero"),
                }));
            }
            let length = pose.rotation.length();
            if !length.is_finite() {
                return Err(defect(RowDefect::OutOfRange {
                    of: "rotation",
                    most: None,
                }));
            }
            if (length - 1.0).abs() > LENGTH_SLACK {
                return Err(defect(RowDefect::Rotation { length }));
            }
            let velocities = pose.velocity.iter().flatten();
            if !velocities.clone().all(|velocity| velocity.is_finite()) {
                return Err(defect(RowDefect::OutOfRange {
                    of: "velocity",
                    most: None,
                }));
            }
            pose.rotation = pose.rotation.normalize();
        }
        Ok(())
    }

    /// A sentence if the rotations look like those of a file that has w first: its bodies begin unturned, which is half a
    /// turn about x when it is read as x.
    fn w_first_note(&self) -> Option<String> {
        let mut first: BTreeMap<usize, &TimedPose> = BTreeMap::new();
        for pose in &self.poses {
            let known = first.entry(pose.body).or_insert(pose);
            if pose.at_ns < known.at_ns {
                *known = pose;
            }
        }
        let is_half_turn = |pose: &&TimedPose| pose.rotation.x.abs() > 0.99;
        let looks_so = !first.is_empty() && first.values().all(is_half_turn);
        looks_so.then(|| {
            "every body begins half a turn about x: if the file has w first, name its columns qw, qx, qy, qz"
                .to_owned()
        })
    }

    /// Most poses that are made of the recorded ones.
    fn made_max(&self) -> u64 {
        (self.poses.len() as u64 * MADE_MAX).max(FRAMES_MAX.into())
    }

    /// Puts poses at the frames of a rate in place of the recorded ones: on lines and shortest arcs between neighbours. A
    /// body's gaps beyond three of its own periods stay gaps; a pose between two gaps goes to the nearest frame.
    fn resample(&mut self, rate: Rate) -> Result<(), RecordingError> {
        let Some(begun_ns) = self.poses.iter().map(|pose| pose.at_ns).min() else {
            return Ok(());
        };
        let most = self.made_max();
        let frames = Frames {
            begun_ns,
            step_ns: rate.step().seconds() * 1e9,
        };
        let mut by_body: BTreeMap<usize, Vec<TimedPose>> = BTreeMap::new();
        for pose in self.poses.drain(..) {
            by_body.entry(pose.body).or_default().push(pose);
        }
        let mut runs = Vec::new();
        let mut contradictions = Contradictions::default();
        for mut of_body in by_body.into_values() {
            of_body.sort_by_key(|pose| pose.at_ns);
            of_body.dedup_by(|again, pose| {
                let is_again = again.at_ns == pose.at_ns;
                if is_again && !again.is_as(pose) {
                    contradictions.add(again, pose);
                }
                is_again
            });
            runs.extend(frames.runs(of_body));
        }
        self.left_out.extend(contradictions.note());
        let made = runs.iter().map(|run| frames.count(run));
        let made = made.fold(0, u64::saturating_add);
        if made > most {
            return Err(RecordingError::Poses { made, most });
        }
        for run in runs {
            frames.fill(&run, &mut self.poses);
        }
        Ok(())
    }

    /// The simplest constant rate that the times keep.
    fn find_rate(&self) -> Result<Rate, RecordingError> {
        let mut times: BTreeMap<usize, Vec<i64>> = BTreeMap::new();
        for pose in &self.poses {
            times.entry(pose.body).or_default().push(pose.at_ns);
        }
        let mut gaps = Vec::new();
        for of_body in times.values_mut() {
            of_body.sort_unstable();
            of_body.dedup();
            gaps.extend(of_body.windows(2).map(|pair| pair[1].abs_diff(pair[0])));
        }
        gaps.sort_unstable();
        let median_ns = *gaps.get(gaps.len() / 2).ok_or(RecordingError::NoTruth)? as f64;
        // The longest row of times tells the step best.
        let longest = times.values().max_by_key(|times| times.len());
        let longest = longest.map_or(&[][..], Vec::as_slice);
        let since = |at: &i64| at.abs_diff(longest[0]) as f64;
        let (mut before_ns, mut frame) = (0.0, 0.0);
        let mut frames = Vec::new();
        for at_ns in longest.iter().map(since) {
            frame += ((at_ns - before_ns) / median_ns).round();
            before_ns = at_ns;
            frames.push((frame, at_ns));
        }
        let step_ns = if frame > 0.0 {
            before_ns / frame
        } else {
            median_ns
        };
        // A simple rate may be off by as much as the times are from those of the step.
        let off_ns = frames
            .iter()
            .map(|(frame, at_ns)| (at_ns - frame * step_ns).abs());
        let off_ns = off_ns.fold(0.0, f64::max);
        let share = (2.0 * off_ns + TIMES_ROUNDED_NS) / before_ns.max(median_ns);
        let share = share.clamp(1e-9, 1e-2);
        let step_s = step_ns / 1e9;
        rate_of_step(step_s, share).ok_or(RecordingError::Interval { step_s })
    }

    /// Puts each pose into its frame.
    fn frame(&self, rate: Rate) -> Result<Framed, RecordingError> {
        let begun_ns = self.poses.iter().map(|pose| pose.at_ns).min();
        let begun_ns = begun_ns.ok_or(RecordingError::NoTruth)?;
        let step_ns = rate.step().seconds() * 1e9;
        let steps = |at_ns: i64| at_ns.abs_diff(begun_ns) as f64 / step_ns;
        let mut paths: Vec<Path> = vec![Path::new(); self.bodies.len()];
        let mut known: BTreeMap<(usize, u64), &TimedPose> = BTreeMap::new();
        let (mut last, mut worst) = (0, None);
        for pose in &self.poses {
            let exact = steps(pose.at_ns);
            let share = (exact - exact.round()).abs();
            if worst.is_none_or(|(most, _)| share > most) {
                worst = Some((share, &pose.place));
            }
            let frame = exact.round() as u64;
            last = last.max(frame);
            let framed = FramedPose {
                position: pose.position,
                rotation: pose.rotation,
                velocity: pose.velocity,
            };
            // Some writers repeat a pose.
            if paths[pose.body].get(&frame) == Some(&framed) {
                continue;
            }
            if let Some(other) = known.insert((pose.body, frame), pose) {
                if other.at_ns == pose.at_ns {
                    return Err(pose.contradicts(&self.bodies, &other.place));
                }
                return Err(RecordingError::Row {
                    place: pose.place.clone(),
                    defect: RowDefect::Twice {
                        body: self.bodies[pose.body].name.clone(),
                        other: Box::new(other.place.clone()),
                    },
                });
            }
            paths[pose.body].insert(frame, framed);
        }
        if let Some((share, place)) = worst.filter(|(share, _)| *share > JITTER_MAX) {
            return Err(RecordingError::NoRate {
                step_s: step_ns / 1e9,
                share,
                place: place.clone(),
            });
        }
        if last == 0 {
            return Err(RecordingError::NoTruth);
        }
        if last > u64::from(FRAMES_MAX) {
            let frames = u32::try_from(last).unwrap_or(u32::MAX);
            return Err(RecordingError::Frames { frames });
        }
        // Before the first pose nothing is removed.
        let removals = self
            .removals
            .iter()
            .filter(|removal| removal.at_ns >= begun_ns);
        let removals = removals.map(|removal| (removal, steps(removal.at_ns).round() as u64));
        Ok(Framed {
            paths,
            last,
            removals: Removals::new(removals),
        })
    }

    /// Paths in the world: those of transforms hang on their parents.
    fn in_world(&self, paths: Vec<Path>) -> Result<Vec<Path>, RecordingError> {
        let parent = |body: usize| {
            let parent = self.bodies[body].parent.as_deref()?;
            self.numbers.get(parent).copied()
        };
        let mut done: Vec<Option<Path>> = vec![None; paths.len()];
        let (mut made, most) = (0, self.made_max());
        for body in 0..paths.len() {
            // From the body up to the first frame that is known, then down again.
            let mut chain = vec![body];
            while let Some(above) = parent(chain[chain.len() - 1])
                && done[above].is_none()
            {
                if chain.contains(&above) {
                    let frame = self.bodies[above].name.clone();
                    return Err(RecordingError::Cycle { frame });
                }
                chain.push(above);
            }
            for link in chain.into_iter().rev() {
                if done[link].is_none() {
                    let above = parent(link).and_then(|above| done[above].as_ref());
                    done[link] = Some(match above {
                        Some(above) => {
                            made += (paths[link].len() + above.len()) as u64;
                            if made > most {
                                return Err(RecordingError::Poses { made, most });
                            }
                            composed(&paths[link], above)
                        }
                        None => paths[link].clone(),
                    });
                }
            }
        }
        Ok(done.into_iter().flatten().collect())
    }

    fn truth(
        &self,
        paths: Vec<Path>,
        (frames, removals): (u64, &Removals),
        options: &ReadOptions,
    ) -> Result<Truth, RecordingError> {
        let mut truth = Truth {
            ticks: vec![Vec::new(); frames as usize],
            ..Truth::default()
        };
        for (number, path) in paths.into_iter().enumerate() {
            let body = &self.bodies[number];
            let shape = body
                .shape
                .clone()
                .unwrap_or_else(|| options.shape(&body.name));
            let persists = options.missing == MissingPoses::Hold || self.persist;
            let stays = stays(path, frames, persists, removals.of(number, body.group));
            if stays.len() > usize::from(u16::MAX) + 1 {
                let body = body.name.clone();
                return Err(RecordingError::Stays { body });
            }
            for (generation, stay) in (0..=u16::MAX).zip(stays) {
                let id = BodyId::new(number as u32, generation);
                add(&mut truth, id, (&shape, body.inertia), stay)?;
            }
        }
        truth
            .placed
            .sort_by_key(|placed| (placed.tick, placed.desc.id));
        truth.removed.sort_unstable();
        Ok(truth)
    }

    fn notes(&self, rate: Rate, options: &ReadOptions, has_velocities: bool) -> Vec<String> {
        let hertz = f64::from(rate.ticks()) / f64::from(rate.seconds());
        let mut notes = vec![format!(
            "{} bodies at {} Hz",
            self.bodies.len(),
            (hertz * 1e6).round() / 1e6
        )];
        let mut taken = Vec::new();
        if options.resample.is_some() {
            taken.push("poses between those of the file");
        }
        let has_shape =
            |body: &RecordedBody| body.shape.is_some() || options.chosen(&body.name).is_some();
        if !self.bodies.iter().all(has_shape) {
            taken.push("a ball of 0.1 m for each body (--shape)");
        }
        if options.gravity.is_none() {
            taken.push("no gravity (--gravity)");
        }
        match &self.part_of_velocities {
            Some(part) => notes.push(format!(
                "the file has {part}, so all velocities are fitted to the poses"
            )),
            None if !has_velocities => taken.push("velocities fitted to the poses"),
            None => {}
        }
        notes.extend(self.left_out.iter().cloned());
        notes.extend(self.frames_note());
        let names: Vec<&str> = self.bodies.iter().map(|body| body.name.as_str()).collect();
        notes.extend(options.note_of_shapes(&names));
        if !taken.is_empty() {
            notes.push(format!(
                "the file does not say it, so this is taken: {}",
                taken.join(", ")
            ));
        }
        notes
    }
}

/// Poses of a time that has another one already.
#[derive(Default)]
struct Contradictions {
    count: usize,
    /// The greatest distance, metres, with its place.
    worst: Option<(f64, Place)>,
}

impl Contradictions {
    fn add(&mut self, pose: &TimedPose, first: &TimedPose) {
        self.count += 1;
        let apart = (pose.position - first.position).length();
        if self.worst.as_ref().is_none_or(|(most, _)| apart > *most) {
            self.worst = Some((apart, pose.place.clone()));
        }
    }

    fn note(self) -> Option<String> {
        let (apart, place) = self.worst?;
        Some(format!(
            "{} poses are of a time that has another one of the body, up to {apart:.4} m apart, as that of {place}: the first counts",
            self.count
        ))
    }
}

/// The frames of a rate, from the first pose.
struct Frames {
    begun_ns: i64,
    step_ns: f64,
}

/// Distance of a moment from a frame, in frames, that is rounding.
const ON_FRAME: f64 = 1e-6;

impl Frames {
    /// The moment of a pose, in frames.
    fn of(&self, pose: &TimedPose) -> f64 {
        pose.at_ns.abs_diff(self.begun_ns) as f64 / self.step_ns
    }

    /// The poses of a body between its gaps.
    fn runs(&self, of_body: Vec<TimedPose>) -> Vec<Vec<TimedPose>> {
        let pairs = of_body.windows(2);
        let mut gaps: Vec<u64> = pairs
            .map(|pair| pair[1].at_ns.abs_diff(pair[0].at_ns))
            .collect();
        gaps.sort_unstable();
        let period = gaps.get(gaps.len() / 2).copied().unwrap_or_default();
        let longest = period.saturating_mul(FILLED_MAX + 1);
        let longest = longest.max(self.step_ns as u64);
        let mut runs: Vec<Vec<TimedPose>> = Vec::new();
        for pose in of_body {
            let goes_on = |run: &&mut Vec<TimedPose>| {
                let last = run.last().map(|last| last.at_ns);
                last.is_some_and(|last| pose.at_ns.abs_diff(last) <= longest)
            };
            match runs.last_mut().filter(goes_on) {
                Some(run) => run.push(pose),
                None => runs.push(vec![pose]),
            }
        }
        runs
    }

    /// First and last frame within a run; one frame for a run between two.
    fn ends(&self, run: &[TimedPose]) -> Option<[f64; 2]> {
        let (first, last) = (self.of(run.first()?), self.of(run.last()?));
        let ends = [(first - ON_FRAME).ceil(), (last + ON_FRAME).floor()];
        Some(match ends[0] <= ends[1] {
            true => ends,
            false => [first.round(); 2],
        })
    }

    fn count(&self, run: &[TimedPose]) -> u64 {
        self.ends(run)
            .map_or(0, |[first, last]| (last - first) as u64 + 1)
    }

    /// Adds the poses of a run at its frames.
    fn fill(&self, run: &[TimedPose], to: &mut Vec<TimedPose>) {
        let Some([mut frame, last]) = self.ends(run) else {
            return;
        };
        let mut place = 0;
        while frame <= last {
            while place + 2 < run.len() && self.of(&run[place + 1]) <= frame {
                place += 1;
            }
            let a = &run[place];
            let b = run.get(place + 1).unwrap_or(a);
            let (from, until) = (self.of(a), self.of(b));
            let share = (frame - from) / (until - from).max(f64::MIN_POSITIVE);
            to.push(TimedPose {
                at_ns: self.begun_ns + (frame * self.step_ns).round() as i64,
                ..between(a, b, share.clamp(0.0, 1.0))
            });
            frame += 1.0;
        }
    }
}

/// A pose on the way from one to another.
fn between(a: &TimedPose, b: &TimedPose, share: f64) -> TimedPose {
    let velocity = a
        .velocity
        .zip(b.velocity)
        .map(|([v, w], [x, y])| [v.lerp(x, share), w.lerp(y, share)]);
    TimedPose {
        position: a.position.lerp(b.position, share),
        rotation: a.rotation.slerp(b.rotation, share),
        velocity,
        ..a.clone()
    }
}

/// A path below another, in the world, at the frames of both.
fn composed(path: &Path, above: &Path) -> Path {
    let Some(first) = path.keys().next() else {
        return Path::new();
    };
    let frames = path
        .keys()
        .chain(above.range(first..).map(|(frame, _)| frame));
    let frames: BTreeSet<u64> = frames.copied().collect();
    let at = |path: &Path, frame: u64| {
        let before = path.range(..=frame).next_back();
        before.or_else(|| path.iter().next()).map(|(_, pose)| *pose)
    };
    let pose = |frame: u64| {
        let (own, above) = (at(path, frame)?, at(above, frame)?);
        Some((
            frame,
            FramedPose {
                position: above.position + above.rotation * own.position,
                rotation: (above.rotation * own.rotation).normalize(),
                velocity: None,
            },
        ))
    };
    frames.into_iter().filter_map(pose).collect()
}

/// Adds one stay of a body.
fn add(
    truth: &mut Truth,
    id: BodyId,
    (shape, inertia): (&Shape, Option<Inertia>),
    stay: Stay,
) -> Result<(), RecordingError> {
    let mut last = None;
    for (frame, pose) in stay.path {
        let tick = Tick::new(frame);
        let [linear, angular] = pose.velocity.unwrap_or_default();
        let motion = BodyState::new(
            pose.position.as_vec3().to_array(),
            pose.rotation.as_quat().to_array(),
            linear.as_vec3().to_array(),
            angular.as_vec3().to_array(),
        );
        let index = id.index();
        let observation = Observation {
            id,
            motion: motion.map_err(|_| RecordingError::Number { tick, index })?,
            activity: Activity::Awake,
        };
        match last.replace(observation.motion) {
            None => {
                let kind = if stay.is_static {
                    BodyKind::Fixed
                } else {
                    BodyKind::Dynamic
                };
                truth.placed.push(Placed {
                    tick,
                    desc: BodyDesc::plain(id, kind, ShapeId(index)),
                    shape: shape.clone(),
                    observation,
                    inertia: inertia.filter(|inertia| !inertia.is_isotropic()),
                });
            }
            // A body that has not changed has no record.
            Some(before) if before == observation.motion => {}
            Some(_) => truth.ticks[frame as usize - 1].push(observation),
        }
    }
    truth
        .removed
        .extend(stay.gone.map(|frame| (Tick::new(frame), id)));
    Ok(())
}

#[cfg(test)]
mod tests;
