//! The paths of bodies, how long predictors hold, and motions next to them.
//!
//! A frame is a published tick: every tick, or every n-th. A path starts at the body's placement and ends at its
//! removal or the end of the recording. Every check compares the normative prediction with the recording.
//!
//! Iteratively reweighted least squares: weights grow where the error is largest, so the largest error falls (Lawson,
//! 1961). Simple models of position and rotation guide the fit; the normative prediction measures its quality. The
//! best motion may be missed, but no fit is rated better than it is.

use std::collections::BTreeMap;
use std::num::NonZeroU32;

use glam::{DMat3, DQuat, DVec3};
use rhumb_protocol::scene::BodyKind;
use rhumb_reckoning::{
    BodyId, BodyState, Conditions, ConstantAcceleration, Damping, Divergence, Inertia, Integrator,
    Metres, Motion, Pose, Predictor, Rate, RotationCursor, StepCoefficientTable, TRACK_AGE_MAX,
    Tick, Ticks, Tolerance, ToleranceScale, Track, Twist, attached_motion, relative_to,
};

use crate::record::Placed;
use crate::recording::{Recording, first_track};

/// Path of one body.
#[derive(Clone, Debug)]
pub(super) struct Path {
    pub(super) radius: Metres,
    pub(super) tolerance_scale: ToleranceScale,
    pub(super) damping: Damping,
    /// Gravity acting on it, m/s².
    pub(super) gravity: DVec3,
    /// Its inertia, if it rotates freely.
    pub(super) inertia: Option<Inertia>,
    /// The track that both ends know before the first update.
    pub(super) known: Track,
    /// Its first frame.
    pub(super) first: usize,
    /// Motion at its first frame and each one after.
    pub(super) motions: Vec<Motion>,
    /// True at each frame whose pose equals that of the frame before.
    pub(super) same: Vec<bool>,
}

impl Path {
    /// End of its frames.
    pub(super) const fn end(&self) -> usize {
        self.first + self.motions.len()
    }

    pub(super) fn at(&self, frame: usize) -> &Motion {
        &self.motions[frame - self.first]
    }

    pub(super) fn is_same(&self, frame: usize) -> bool {
        self.same[frame - self.first]
    }
}

/// The paths of a recording, built one at a time to bound memory.
#[derive(Debug)]
pub(super) struct Paths<'a> {
    recording: &'a Recording,
    publish_interval: NonZeroU32,
    /// The last tick of each placed body that goes.
    ends: Vec<Option<Tick>>,
    rows: BTreeMap<BodyId, Vec<(u64, BodyState)>>,
    /// Non-static bodies, in order of placing, with their numbers among all.
    placed: Vec<(usize, &'a Placed)>,
}

impl<'a> Paths<'a> {
    pub(super) fn new(recording: &'a Recording, publish_interval: NonZeroU32) -> Self {
        let truth = &recording.truth;
        let mut rows: BTreeMap<BodyId, Vec<_>> = BTreeMap::new();
        for (row, tick) in truth.ticks.iter().zip(1..) {
            for observation in row {
                let of_body = rows.entry(observation.id).or_default();
                of_body.push((tick, observation.motion));
            }
        }
        let can_move = |(_, placed): &(usize, &Placed)| placed.desc.kind != BodyKind::Fixed;
        Self {
            recording,
            publish_interval,
            ends: truth.ends(),
            rows,
            placed: truth.placed.iter().enumerate().filter(can_move).collect(),
        }
    }

    /// Number of non-static bodies.
    pub(super) const fn len(&self) -> usize {
        self.placed.len()
    }

    /// Bounding radius of a body, metres.
    pub(super) fn radius(&self, place: usize) -> f64 {
        let (_, placed) = self.placed[place];
        placed.shape.bounding_radius().metres()
    }

    /// Path of a body; `None` if it is present at no frame.
    pub(super) fn get(&self, place: usize) -> Option<Path> {
        let (number, placed) = self.placed[place];
        let last = u64::from(self.recording.ticks());
        let end = self.ends[number].map_or(last, Tick::value);
        let observed = self
            .rows
            .get(&placed.desc.id)
            .map_or(&[][..], Vec::as_slice);
        // Another body of this id may have been there before.
        let begin = observed.partition_point(|(tick, _)| *tick <= placed.tick.value());
        let observed = &observed[begin..];
        let path = path(self.recording, placed, observed, end, self.publish_interval);
        (!path.motions.is_empty()).then_some(path)
    }
}

/// Path of one body from its placement to `end`.
fn path(
    recording: &Recording,
    placed: &Placed,
    observed: &[(u64, BodyState)],
    end: u64,
    publish_interval: NonZeroU32,
) -> Path {
    let parameters = recording.parameters(placed);
    let publish_interval = u64::from(publish_interval.get());
    let first = placed.tick.value().div_ceil(publish_interval);
    let mut motion = placed.observation.motion.motion();
    let (mut motions, mut same) = (Vec::new(), Vec::new());
    let mut observed = observed.iter().peekable();
    for frame in first..=end / publish_interval {
        let before = motion;
        while let Some((tick, newer)) = observed.peek()
            && *tick <= frame * publish_interval
        {
            motion = newer.motion();
            observed.next();
        }
        same.push(frame > first && before.pose() == motion.pose());
        motions.push(motion);
    }
    Path {
        radius: parameters.radius,
        tolerance_scale: parameters.tolerance_scale,
        damping: parameters.damping,
        gravity: recording.gravity.as_dvec3() * f64::from(parameters.gravity_scale),
        known: first_track(placed, &parameters),
        inertia: parameters.inertia,
        first: first as usize,
        motions,
        same,
    }
}

/// A predictor, in the world frame or in the frame of a parent. Bodies with inertia rotate freely under either of the
/// moving ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum PredictorKind {
    Rest,
    Attached,
    Uniform,
    Ballistic,
    ConstantAcceleration,
}

impl PredictorKind {
    /// Cheapest first: where two hold equally long, the first is chosen.
    pub(super) const ALL: [Self; 5] = [
        Self::Rest,
        Self::Attached,
        Self::Uniform,
        Self::Ballistic,
        Self::ConstantAcceleration,
    ];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Rest => "rest",
            Self::Attached => "attached",
            Self::Uniform => "uniform",
            Self::Ballistic => "ballistic",
            Self::ConstantAcceleration => "constant-acceleration",
        }
    }

    /// The protocol's predictor for a body with or without free rotation and with or without constant acceleration.
    const fn predictor(
        self,
        rotates_freely: bool,
        constant_acceleration: Option<ConstantAcceleration>,
    ) -> Predictor {
        if let Some(constant_acceleration) = constant_acceleration {
            return Predictor::Accelerated(constant_acceleration);
        }
        match self {
            Self::Rest | Self::Attached => Predictor::Rest,
            Self::Uniform | Self::ConstantAcceleration if rotates_freely => Predictor::TorqueFree,
            Self::Uniform | Self::ConstantAcceleration => Predictor::Uniform,
            Self::Ballistic if rotates_freely => Predictor::BallisticTorqueFree,
            Self::Ballistic => Predictor::Ballistic,
        }
    }

    pub(super) const fn moves(self) -> bool {
        matches!(
            self,
            Self::Uniform | Self::Ballistic | Self::ConstantAcceleration
        )
    }
}

/// Path of a possible parent, and its predicted motion at each of its frames.
#[derive(Clone, Debug)]
pub(super) struct ParentPath {
    pub(super) radius: Metres,
    pub(super) first: usize,
    pub(super) predicted_in_world: Vec<Motion>,
}

impl ParentPath {
    pub(super) fn at(&self, frame: usize) -> Option<&Motion> {
        self.predicted_in_world.get(frame.checked_sub(self.first)?)
    }
}

/// A motion from which a body continues by a predictor.
#[derive(Clone, Copy, Debug)]
pub(super) struct SegmentStart {
    pub(super) predictor: PredictorKind,
    /// The frame at which the motion holds.
    pub(super) frame: usize,
    /// The motion in the world frame, or in the parent's frame.
    pub(super) motion: Motion,
    /// Index of the parent.
    pub(super) parent: Option<usize>,
    /// Acceleration, for that predictor only.
    pub(super) constant_acceleration: Option<ConstantAcceleration>,
}

/// Coefficients of motion after a number of ticks, for one damping: `p = p₀ + reach·v₀ + fall·g`, or `p₀ + reach·v₀ +
/// acceleration_gain·a` under a constant acceleration a; and the angle per rad/s.
#[derive(Clone, Debug)]
pub(super) struct Basis {
    pub(super) flow: StepCoefficientTable,
    pub(super) reach: Vec<f64>,
    pub(super) fall: Vec<f64>,
    pub(super) acceleration_gain: Vec<f64>,
    pub(super) turn: Vec<f64>,
}

/// A spin slow enough for the angle to be proportional to it, rad/s.
const SLOW: f64 = 1e-3;

impl Basis {
    /// Sampled from the normative prediction.
    pub(super) fn new(integrator: Integrator, path: &Path) -> Self {
        let mut flow = StepCoefficientTable::new(integrator, path.damping);
        flow.extend_to(TRACK_AGE_MAX);
        let start = Motion::new(
            Pose::IDENTITY,
            Twist {
                linear: DVec3::X,
                angular: DVec3::Z * SLOW,
            },
        )
        .expect("these numbers are finite");
        let conditions = Conditions {
            gravity: DVec3::Y,
            flow: &flow,
            inertia: None,
        };
        let after = |predictor: Predictor| {
            let ticks = 0..=TRACK_AGE_MAX.count();
            let ends = ticks.map(|ticks| predictor.predict(&start, Ticks::new(ticks), &conditions));
            ends.collect::<Vec<_>>()
        };
        let ends = after(Predictor::Ballistic);
        let position = |end: &Motion| end.pose().position;
        let by = ConstantAcceleration::SAMPLE.acceleration().y;
        let acceleration_gain = after(Predictor::Accelerated(ConstantAcceleration::SAMPLE));
        Self {
            reach: ends.iter().map(|end| position(end).x).collect(),
            fall: ends.iter().map(|end| position(end).y).collect(),
            acceleration_gain: acceleration_gain
                .iter()
                .map(|end| position(end).y / by)
                .collect(),
            turn: ends
                .iter()
                .map(|end| 2.0 * end.pose().rotation.z.asin() / SLOW)
                .collect(),
            flow,
        }
    }
}

/// One body's path, and the parameters of its search.
#[derive(Clone, Copy, Debug)]
pub(super) struct SegmentContext<'a> {
    pub(super) path: &'a Path,
    pub(super) basis: &'a Basis,
    pub(super) parents: &'a [ParentPath],
    pub(super) tolerance: Tolerance,
    pub(super) rate: Rate,
    pub(super) publish_interval: NonZeroU32,
}

impl SegmentContext<'_> {
    /// Ticks from one frame to a later one, up to the longest track age.
    pub(super) fn ticks(&self, from: usize, to: usize) -> Ticks {
        let ticks = (to - from) as u64 * u64::from(self.publish_interval.get());
        Ticks::new(ticks.min(u64::from(TRACK_AGE_MAX.count())) as u32)
    }

    /// End of the frames for which a predictor started at `from` may hold.
    pub(super) fn horizon(&self, predictor: PredictorKind, from: usize) -> usize {
        if predictor.moves() {
            let frames = TRACK_AGE_MAX.count() / self.publish_interval.get();
            self.path.end().min(from + frames as usize + 1)
        } else {
            self.path.end()
        }
    }

    /// Motion of the body, in the parent's frame if given; `None` once the parent is removed.
    pub(super) fn target(&self, frame: usize, parent: Option<usize>) -> Option<Motion> {
        let truth = self.path.at(frame);
        let Some(parent) = parent else {
            return Some(*truth);
        };
        let by = self.parents[parent].at(frame)?;
        Some(relative_to(&by.pose(), &truth.pose()))
    }

    /// The predictor of a segment of this body.
    pub(super) const fn predictor(&self, segment: &SegmentStart) -> Predictor {
        segment
            .predictor
            .predictor(self.path.inertia.is_some(), segment.constant_acceleration)
    }

    /// Predicted motion of a segment at a frame, in the segment's frame of reference.
    pub(super) fn predicted(
        &self,
        segment: &SegmentStart,
        frame: usize,
        cursor: &mut RotationCursor,
    ) -> Motion {
        let conditions = Conditions {
            gravity: self.path.gravity,
            flow: &self.basis.flow,
            inertia: self.path.inertia.as_ref(),
        };
        let ticks = self.ticks(segment.frame, frame);
        let predictor = self.predictor(segment);
        predictor.predict_with(&segment.motion, ticks, &conditions, cursor)
    }

    /// The same in the world frame; `None` once the parent is removed.
    pub(super) fn predicted_in_world(
        &self,
        segment: &SegmentStart,
        frame: usize,
        cursor: &mut RotationCursor,
    ) -> Option<Motion> {
        let predicted = self.predicted(segment, frame, cursor);
        match segment.parent {
            None => Some(predicted),
            Some(parent) => {
                let by = self.parents[parent].at(frame)?;
                Some(attached_motion(by, &predicted.pose()))
            }
        }
    }

    /// Distance between the prediction of a segment and the truth at a frame.
    pub(super) fn divergence(
        &self,
        segment: &SegmentStart,
        frame: usize,
        cursor: &mut RotationCursor,
    ) -> Option<Divergence> {
        let predicted_in_world = self.predicted_in_world(segment, frame, cursor)?;
        Some(Divergence::between(
            &self.path.at(frame).pose(),
            &predicted_in_world.pose(),
        ))
    }

    /// End of the contiguous frames in which a segment stays within tolerance.
    pub(super) fn holds_until(&self, segment: &SegmentStart) -> usize {
        let end = self.horizon(segment.predictor, segment.frame);
        let mut cursor = RotationCursor::default();
        for frame in segment.frame..end {
            // If neither the body nor the prediction moves, the error does not change.
            let still = segment.predictor == PredictorKind::Rest
                && frame > segment.frame
                && self.path.is_same(frame);
            if still {
                continue;
            }
            let within = self
                .divergence(segment, frame, &mut cursor)
                .is_some_and(|divergence| {
                    self.tolerance.share(&divergence, self.path.radius) <= 1.0
                });
            if !within {
                return frame;
            }
        }
        end
    }
}

/// Rounds of reweighting.
const ROUNDS: u32 = 10;
/// Error after the first rounds, in tolerances, above which the fit is abandoned.
const HOPELESS: f64 = 4.0;
/// Smallest number of steps in which the largest component of an acceleration is quantised.
const ACCELERATION_FINENESS: f64 = 64.0;
/// Unknowns of a rotation: initial angle and spin.
const UNKNOWNS: usize = 6;

/// A frame that the fit approximates.
#[derive(Clone, Copy, Debug)]
struct FitTarget {
    frame: usize,
    ticks: usize,
    truth: Pose,
    weight: f64,
    /// Pose of the fit so far.
    fitted: Pose,
}

/// The segment start at `from` that best approximates the frames from `from` to `to`, `to` excluded. `None` if the
/// parent is removed before `to`, or the error stays far above the tolerance.
pub(super) fn fit(
    context: &SegmentContext<'_>,
    predictor: PredictorKind,
    parent: Option<usize>,
    from: usize,
    to: usize,
) -> Option<SegmentStart> {
    let mut targets = targets(context, predictor, parent, from, to)?;
    let mut pose = targets.first()?.truth;
    let mut twist = Twist {
        linear: DVec3::ZERO,
        angular: if predictor.moves() {
            mean_spin(context, &targets)
        } else {
            DVec3::ZERO
        },
    };
    let mut best: Option<(f64, SegmentStart)> = None;
    for round in 0..ROUNDS {
        let constant_acceleration = match predictor {
            PredictorKind::ConstantAcceleration => Some(constant_acceleration(context, &targets)?),
            _ => None,
        };
        (pose.position, twist.linear) = place(context, predictor, constant_acceleration, &targets);
        let steps = if round == 0 { 2 } else { 1 };
        for _ in 0..steps {
            propagate(
                context,
                (predictor, constant_acceleration),
                from,
                (pose, twist),
                &mut targets,
            )?;
            let [by, faster] = turn(context, predictor, &targets, twist.angular);
            pose.rotation = (DQuat::from_scaled_axis(by) * pose.rotation).normalize();
            twist.angular += faster;
        }
        let motion = propagate(
            context,
            (predictor, constant_acceleration),
            from,
            (pose, twist),
            &mut targets,
        )?;
        let worst = reweight(context, &mut targets);
        let segment = SegmentStart {
            predictor,
            frame: from,
            motion,
            parent,
            constant_acceleration,
        };
        if best.is_none_or(|(least, _)| worst < least) {
            best = Some((worst, segment));
        }
        if worst <= 1.0 || round >= 2 && worst > HOPELESS {
            break;
        }
    }
    best.map(|(_, segment)| segment)
}

fn targets(
    context: &SegmentContext<'_>,
    predictor: PredictorKind,
    parent: Option<usize>,
    from: usize,
    to: usize,
) -> Option<Vec<FitTarget>> {
    let still = |frame: &usize| {
        predictor == PredictorKind::Rest && *frame > from && context.path.is_same(*frame)
    };
    let target = |frame: usize| {
        let truth = context.target(frame, parent)?.pose();
        Some(FitTarget {
            frame,
            ticks: context.ticks(from, frame).count() as usize,
            truth,
            weight: 1.0,
            fitted: truth,
        })
    };
    (from..to)
        .filter(|frame| !still(frame))
        .map(target)
        .collect()
}

/// Mean spin over all frames, rad/s, world axes.
fn mean_spin(context: &SegmentContext<'_>, targets: &[FitTarget]) -> DVec3 {
    let turned = targets
        .windows(2)
        .map(|pair| rotation_vector(pair[1].truth.rotation, pair[0].truth.rotation));
    let angle = targets
        .last()
        .map_or(0.0, |last| context.basis.turn[last.ticks]);
    if angle > 0.0 {
        turned.sum::<DVec3>() / angle
    } else {
        DVec3::ZERO
    }
}

/// The constant acceleration that best explains the path, quantised. `None` if the path determines none, or if it
/// exceeds the protocol's range.
fn constant_acceleration(
    context: &SegmentContext<'_>,
    targets: &[FitTarget],
) -> Option<ConstantAcceleration> {
    let mut matrix = [[0.0; 4]; 3];
    let mut sums = [DVec3::ZERO; 3];
    for target in targets {
        let (reach, acceleration_gain) = (
            context.basis.reach[target.ticks],
            context.basis.acceleration_gain[target.ticks],
        );
        let columns = [1.0, reach, acceleration_gain];
        for (row, (sum, left)) in matrix.iter_mut().zip(sums.iter_mut().zip(columns)) {
            for (cell, right) in row.iter_mut().zip(columns) {
                *cell += target.weight * left * right;
            }
            *sum += target.truth.position * (target.weight * left);
        }
    }
    let along = |part: fn(&DVec3) -> f64| {
        let mut rows = matrix;
        for (row, sum) in rows.iter_mut().zip(&sums) {
            row[3] = part(sum);
        }
        solved(rows)[2]
    };
    let acceleration = DVec3::new(along(|sum| sum.x), along(|sum| sum.y), along(|sum| sum.z));
    ConstantAcceleration::nearest(acceleration, ACCELERATION_FINENESS)
        .filter(|constant_acceleration| constant_acceleration.steps() != [0; 3])
}

/// Best position and velocity under the weights.
fn place(
    context: &SegmentContext<'_>,
    predictor: PredictorKind,
    constant_acceleration: Option<ConstantAcceleration>,
    targets: &[FitTarget],
) -> (DVec3, DVec3) {
    let acceleration = constant_acceleration.map_or(DVec3::ZERO, |constant_acceleration| {
        constant_acceleration.acceleration()
    });
    let pull = |target: &FitTarget| match predictor {
        PredictorKind::Ballistic => context.path.gravity * context.basis.fall[target.ticks],
        PredictorKind::ConstantAcceleration => {
            acceleration * context.basis.acceleration_gain[target.ticks]
        }
        _ => DVec3::ZERO,
    };
    let (mut one, mut reach, mut reach2) = (0.0, 0.0, 0.0);
    let (mut sum, mut moment) = (DVec3::ZERO, DVec3::ZERO);
    for target in targets {
        let (weight, by) = (target.weight, context.basis.reach[target.ticks]);
        let position = target.truth.position - pull(target);
        one += weight;
        reach += weight * by;
        reach2 += weight * by * by;
        sum += position * weight;
        moment += position * (weight * by);
    }
    let determinant = one * reach2 - reach * reach;
    if !predictor.moves() || determinant <= 1e-12 * one * reach2 {
        return (sum / one, DVec3::ZERO);
    }
    let velocity = (moment * one - sum * reach) / determinant;
    ((sum - velocity * reach) / one, velocity)
}

/// Correction of the initial rotation (rad) and of the spin (rad/s): one Gauss-Newton step.
fn turn(
    context: &SegmentContext<'_>,
    predictor: PredictorKind,
    targets: &[FitTarget],
    spin: DVec3,
) -> [DVec3; 2] {
    if !predictor.moves() {
        let weights: f64 = targets.iter().map(|target| target.weight).sum();
        let errors = targets.iter().map(|target| {
            rotation_vector(target.truth.rotation, target.fitted.rotation) * target.weight
        });
        return [errors.sum::<DVec3>() / weights, DVec3::ZERO];
    }
    let mut matrix = [[0.0; UNKNOWNS + 1]; UNKNOWNS];
    for target in targets {
        let error = rotation_vector(target.truth.rotation, target.fitted.rotation);
        let by = context.basis.turn[target.ticks];
        let turned = DMat3::from_quat(DQuat::from_scaled_axis(spin * by));
        let faster = left_jacobian(spin * by) * by;
        let columns = [
            turned.x_axis,
            turned.y_axis,
            turned.z_axis,
            faster.x_axis,
            faster.y_axis,
            faster.z_axis,
        ];
        for (row, left) in matrix.iter_mut().zip(&columns) {
            for (cell, right) in row.iter_mut().zip(&columns) {
                *cell += target.weight * left.dot(*right);
            }
            row[UNKNOWNS] += target.weight * left.dot(error);
        }
    }
    let [a, b, c, d, e, f] = solved(matrix);
    [DVec3::new(a, b, c), DVec3::new(d, e, f)]
}

/// Left Jacobian of a rotation vector. Source: Solà, Deray and Atchuthan (2018), equation 145.
fn left_jacobian(turn: DVec3) -> DMat3 {
    let angle = turn.length();
    if angle < 1e-6 {
        return DMat3::IDENTITY;
    }
    let axis = turn / angle;
    let cross = DMat3::from_cols(
        axis.cross(DVec3::X),
        axis.cross(DVec3::Y),
        axis.cross(DVec3::Z),
    );
    let along = DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
    let sine = angle.sin() / angle;
    DMat3::IDENTITY * sine + along * (1.0 - sine) + cross * ((1.0 - angle.cos()) / angle)
}

/// Gaussian elimination of `N` unknowns, right-hand side in the last column; undetermined unknowns stay zero.
fn solved<const N: usize, const WIDTH: usize>(mut rows: [[f64; WIDTH]; N]) -> [f64; N] {
    const { assert!(WIDTH == N + 1) };
    let scale = (0..N).map(|i| rows[i][i]).fold(0.0, f64::max);
    let mut determined = [false; N];
    for pivot in 0..N {
        let least = 1e-12 * scale;
        if rows[pivot][pivot] <= least {
            continue;
        }
        determined[pivot] = true;
        let by = rows[pivot];
        for (other, row) in rows.iter_mut().enumerate() {
            if other != pivot {
                let share = row[pivot] / by[pivot];
                for (cell, own) in row.iter_mut().zip(by) {
                    *cell -= share * own;
                }
            }
        }
    }
    std::array::from_fn(|i| {
        if determined[i] {
            rows[i][N] / rows[i][i]
        } else {
            0.0
        }
    })
}

/// Updates the fitted poses from the normative prediction; returns the motion, or `None` if it is invalid.
fn propagate(
    context: &SegmentContext<'_>,
    (predictor, constant_acceleration): (PredictorKind, Option<ConstantAcceleration>),
    from: usize,
    (pose, twist): (Pose, Twist),
    targets: &mut [FitTarget],
) -> Option<Motion> {
    let motion = Motion::new(pose, twist).ok()?;
    let segment = SegmentStart {
        predictor,
        frame: from,
        motion,
        parent: None,
        constant_acceleration,
    };
    let mut cursor = RotationCursor::default();
    for target in targets {
        target.fitted = context
            .predicted(&segment, target.frame, &mut cursor)
            .pose();
    }
    Some(motion)
}

/// Sets each frame's weight from its error; returns the largest error as a share of the tolerance.
fn reweight(context: &SegmentContext<'_>, targets: &mut [FitTarget]) -> f64 {
    let share = |target: &FitTarget| {
        let divergence = Divergence::between(&target.truth, &target.fitted);
        context.tolerance.share(&divergence, context.path.radius)
    };
    let worst = targets.iter().map(share).fold(0.0, f64::max);
    let mut total = 0.0;
    for target in targets.iter_mut() {
        target.weight *= share(target).max(1e-3 * worst).max(f64::MIN_POSITIVE);
        total += target.weight;
    }
    let scale = targets.len() as f64 / total;
    for target in targets {
        target.weight *= scale;
    }
    worst
}

/// Shortest rotation between two orientations, axis times angle, rad.
fn rotation_vector(to: DQuat, from: DQuat) -> DVec3 {
    let turn = to * from.conjugate();
    let turn = if turn.w < 0.0 { -turn } else { turn };
    turn.to_scaled_axis()
}
