//! Cuts a body's path into as few segments as possible.
//!
//! Greedy: where the last segment leaves the tolerance, the segment that holds longest follows. For one family of fits
//! no other cut has fewer segments, because a fit that holds over a span holds over each part of it. The cut for few
//! bits takes the segment with the lowest cost per time, which is only a heuristic.

use rhumb_reckoning::{
    ConstantAcceleration, Grid, Motion, Predictor, QuantisedState, Residual, RotationCursor,
    attached_motion, relative_to,
};

use super::context::{Path, PredictorKind, SegmentContext, SegmentStart, fit};

/// Shortest segment, in frames, from which an acceleration is fitted.
const ACCELERATION_FRAMES: usize = 4;
/// A parent lies within this many of its radii and is larger by [`PARENT_RATIO`], the same as in the publisher.
const PARENT_REACH: f64 = 3.0;
/// Velocity exponent of the default step: half the tolerance per second.
const COARSENESS: u32 = 3;
/// Smallest ratio of a parent's radius to its child's.
pub(super) const PARENT_RATIO: f64 = 1.2;

/// Content of the update that starts a segment.
#[derive(Clone, Copy, Debug)]
pub(super) struct SegmentUpdate {
    pub(super) frame: usize,
    /// Index of the body.
    pub(super) body: usize,
    /// Predictor before and after the update.
    pub(super) predictors: [PredictorKind; 2],
    /// True if the parent changes.
    pub(super) changes_parent: bool,
    /// Acceleration, if it changes.
    pub(super) constant_acceleration: Option<ConstantAcceleration>,
    /// Position and rotation in grid steps; velocities unless the implied ones hold as long.
    pub(super) residual: Residual,
}

/// The segments of a body's whole path.
#[derive(Clone, Debug, Default)]
pub(super) struct Segmentation {
    pub(super) updates: Vec<SegmentUpdate>,
    /// Surface errors at frames in which the body moved since the previous frame, metres.
    pub(super) errors_m: Vec<f32>,
    /// Predicted motion, frame by frame.
    pub(super) predicted_in_world: Vec<Motion>,
}

/// Quantity that a cut minimises.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Objective {
    /// Number of segments.
    Updates,
    /// Estimated bits per time that a segment holds.
    Bits,
    /// Number of segments, with motions rounded to the protocol's grid and verified as rounded.
    UpdatesOnGrid,
}

/// A segment start, its end, and its update.
#[derive(Clone, Copy, Debug)]
struct SegmentCandidate {
    segment: SegmentStart,
    until: usize,
    update: SegmentUpdate,
}

/// Cuts a body's path into segments.
pub(super) fn cut(context: &SegmentContext<'_>, body: usize, objective: Objective) -> Segmentation {
    let path = context.path;
    let grid = Grid::new(context.tolerance, path.radius);
    let mut segmentation = Segmentation::default();
    let mut segment = known(path, &grid);
    let mut frame = context.holds_until(&segment);
    record(context, &segment, frame, &mut segmentation);
    while frame < path.end() {
        let mut best: Option<SegmentCandidate> = None;
        let quantise = |fitted: SegmentStart| match objective {
            Objective::UpdatesOnGrid => on_grid(context, &grid, &segment, &fitted),
            Objective::Updates | Objective::Bits => (fitted, context.holds_until(&fitted)),
        };
        for found in longest(context, frame, &quantise) {
            for candidate in candidates(context, &grid, (segment, found), body, objective) {
                if best.is_none_or(|best| price(&candidate, objective) < price(&best, objective)) {
                    best = Some(candidate);
                }
            }
        }
        let Some(next) = best else {
            break;
        };
        segmentation.updates.push(next.update);
        (segment, frame) = (next.segment, next.until);
        record(context, &segment, frame, &mut segmentation);
    }
    segmentation
}

/// Price of a candidate; lower is better.
fn price(candidate: &SegmentCandidate, objective: Objective) -> f64 {
    let frames = (candidate.until - candidate.segment.frame) as f64;
    match objective {
        Objective::Updates | Objective::UpdatesOnGrid => 1.0 / frames,
        Objective::Bits => guess(&candidate.update) / frames,
    }
}

/// Estimated bits of an update, good enough for comparing candidates.
fn guess(update: &SegmentUpdate) -> f64 {
    let residual = &update.residual;
    let number = |value: &i32| match value.unsigned_abs() {
        0 => 0.7,
        size => 2.5 + 2.0 * f64::from(size).log2(),
    };
    let three = |values: &[i32; 3]| values.iter().map(number).sum::<f64>();
    let velocity = residual
        .velocity
        .map_or(0.0, |by| three(&by.linear) + three(&by.angular));
    let constant_acceleration = update
        .constant_acceleration
        .map_or(0.0, |constant_acceleration| {
            three(&constant_acceleration.steps().map(i32::from))
                + number(&i32::from(constant_acceleration.exponent()))
        });
    BODY_ID_BITS
        + three(&residual.position)
        + three(&residual.turn)
        + velocity
        + constant_acceleration
}

/// Estimated bits of body id and predictor.
const BODY_ID_BITS: f64 = 6.0;

/// The motion that both ends know before the first update.
fn known(path: &Path, grid: &Grid) -> SegmentStart {
    let predictor = match path.known.predictor {
        Predictor::Rest => PredictorKind::Rest,
        Predictor::Uniform | Predictor::TorqueFree => PredictorKind::Uniform,
        _ => PredictorKind::Ballistic,
    };
    SegmentStart {
        predictor,
        frame: path.first,
        motion: path.known.start(grid),
        parent: None,
        constant_acceleration: None,
    }
}

/// Records the predicted motions and the errors of a segment.
fn record(
    context: &SegmentContext<'_>,
    segment: &SegmentStart,
    until: usize,
    segmentation: &mut Segmentation,
) {
    let (mut predicted, mut divergence) = (RotationCursor::default(), RotationCursor::default());
    for frame in segment.frame..until {
        if let Some(predicted_in_world) = context.predicted_in_world(segment, frame, &mut predicted)
        {
            segmentation.predicted_in_world.push(predicted_in_world);
        }
        if !context.path.is_same(frame)
            && let Some(off) = context.divergence(segment, frame, &mut divergence)
        {
            let error = off.surface_error(context.path.radius);
            segmentation.errors_m.push(error.metres() as f32);
        }
    }
}

/// Quantises a fitted motion; returns the result and the end of its validity.
type Quantise<'r> = &'r dyn Fn(SegmentStart) -> (SegmentStart, usize);

/// The motion that the protocol expresses for a fitted one. Of two velocities the one that holds longer is used: that
/// implied by the correction, or that nearest to the fit.
fn on_grid(
    context: &SegmentContext<'_>,
    grid: &Grid,
    last: &SegmentStart,
    fitted: &SegmentStart,
) -> (SegmentStart, usize) {
    let (residual, implied) = implied(context, grid, last, fitted);
    let mut all = vec![implied];
    if fitted.predictor.moves() {
        // The finest steps and the common ones: the nearer velocity does not always hold longer.
        for velocity_exponent in [0, COARSENESS] {
            let twist = fitted.motion.twist();
            let velocity = Residual::of_velocity(&twist, &implied, grid, velocity_exponent);
            let residual = Residual {
                velocity: Some(velocity),
                ..residual
            };
            all.push(quantised(context, grid, last, fitted, &residual));
        }
    }
    let results = all.into_iter().map(|quantised| {
        let motion = quantised.motion(grid);
        let segment = SegmentStart { motion, ..*fitted };
        (segment, context.holds_until(&segment))
    });
    results
        .max_by_key(|(_, until)| *until)
        .unwrap_or((*fitted, fitted.frame))
}

/// The rounded pose correction and the motion it implies.
fn implied(
    context: &SegmentContext<'_>,
    grid: &Grid,
    last: &SegmentStart,
    next: &SegmentStart,
) -> (Residual, QuantisedState) {
    let predicted = in_frame_of(context, last, next);
    let [position, turn] = Residual::wanted(&next.motion.pose(), &predicted.pose(), grid);
    let rounded = |steps: glam::DVec3| steps.to_array().map(|step| step.round() as i32);
    let residual = Residual {
        position: rounded(position),
        turn: rounded(turn),
        velocity: None,
    };
    (residual, quantised(context, grid, last, next, &residual))
}

/// The motion that results from a correction.
fn quantised(
    context: &SegmentContext<'_>,
    grid: &Grid,
    last: &SegmentStart,
    next: &SegmentStart,
    residual: &Residual,
) -> QuantisedState {
    let predicted = in_frame_of(context, last, next);
    let age = context.ticks(last.frame, next.frame);
    let over = context.predictor(last).divergence_time(age, context.rate);
    let quantised = residual.onto(&predicted, over, grid);
    if next.predictor.moves() {
        quantised
    } else {
        quantised.stilled()
    }
}

/// For each predictor, the segment that holds longest from a frame, and its end.
fn longest(
    context: &SegmentContext<'_>,
    frame: usize,
    quantise: Quantise<'_>,
) -> Vec<(SegmentStart, usize)> {
    let by = |predictor: PredictorKind| {
        let parent = match predictor {
            PredictorKind::Attached => Some(nearest_parent(context, frame)?),
            _ => None,
        };
        let pulled = context.path.gravity != glam::DVec3::ZERO;
        let found = (predictor != PredictorKind::Ballistic || pulled)
            .then(|| longest_by(context, predictor, parent, frame, quantise))
            .flatten();
        found.filter(|(_, until)| *until > frame)
    };
    PredictorKind::ALL.into_iter().filter_map(by).collect()
}

/// The same for one predictor.
fn longest_by(
    context: &SegmentContext<'_>,
    predictor: PredictorKind,
    parent: Option<usize>,
    frame: usize,
    quantise: Quantise<'_>,
) -> Option<(SegmentStart, usize)> {
    let end = context.horizon(predictor, frame);
    let motion = context.target(frame, parent)?;
    let start = SegmentStart {
        predictor,
        frame,
        motion: if predictor.moves() {
            motion
        } else {
            motion.stilled()
        },
        parent,
        constant_acceleration: None,
    };
    let begun = match predictor {
        PredictorKind::ConstantAcceleration => fit(
            context,
            predictor,
            parent,
            frame,
            (frame + ACCELERATION_FRAMES).min(end),
        )?,
        _ => start,
    };
    let mut best = quantise(begun);
    let attempt = |to: usize, best: &mut (SegmentStart, usize)| {
        let fitted = fit(context, predictor, parent, frame, to);
        let until = fitted.map(quantise);
        *best = until.filter(|(_, until)| *until > best.1).unwrap_or(*best);
        best.1 >= to
    };
    // Lengthen until a fit fails, then bisect between the longest success and the shortest failure.
    let mut beyond = end + 1;
    while best.1 < end {
        let length = best.1 - frame;
        let to = (best.1 + (length / 2).max(1)).min(end);
        if !attempt(to, &mut best) {
            beyond = to;
            break;
        }
    }
    while best.1 + 1 < beyond.min(end + 1) {
        let to = best.1 + (beyond - best.1) / 2;
        if !attempt(to, &mut best) {
            beyond = to;
        }
    }
    Some(best)
}

/// The nearest body that may be a parent.
fn nearest_parent(context: &SegmentContext<'_>, frame: usize) -> Option<usize> {
    let path = context.path;
    let here = path.at(frame).pose().position;
    let far = |place: usize| {
        let parent = &context.parents[place];
        let radius = parent.radius.metres();
        let far = parent.at(frame)?.pose().position.distance(here);
        let eligible =
            radius >= path.radius.metres() * PARENT_RATIO && far <= radius * PARENT_REACH;
        eligible.then_some((far, place))
    };
    (0..context.parents.len())
        .filter_map(far)
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, place)| place)
}

/// Ways to encode a segment: with its own velocities, or with those that the correction implies.
fn candidates(
    context: &SegmentContext<'_>,
    grid: &Grid,
    (last, (next, until)): (SegmentStart, (SegmentStart, usize)),
    body: usize,
    objective: Objective,
) -> Vec<SegmentCandidate> {
    let frame = next.frame;
    let (residual, implied) = implied(context, grid, &last, &next);
    let candidate = |segment, until, residual| SegmentCandidate {
        segment,
        until,
        update: SegmentUpdate {
            frame,
            body,
            predictors: [last.predictor, next.predictor],
            changes_parent: next.parent.is_some() && last.parent != next.parent,
            constant_acceleration: next.constant_acceleration.filter(|constant_acceleration| {
                last.constant_acceleration != Some(*constant_acceleration)
            }),
            residual,
        },
    };
    if !next.predictor.moves() {
        return vec![candidate(next, until, residual)];
    }
    let velocity = Some(Residual::of_velocity(
        &next.motion.twist(),
        &implied,
        grid,
        COARSENESS,
    ));
    let mut all = vec![candidate(
        next,
        until,
        Residual {
            velocity,
            ..residual
        },
    )];
    if let Ok(motion) = Motion::new(next.motion.pose(), implied.motion(grid).twist()) {
        let segment = SegmentStart { motion, ..next };
        let holds = context.holds_until(&segment);
        if holds >= until || objective == Objective::Bits && holds > frame {
            all.insert(0, candidate(segment, holds, residual));
        }
    }
    all
}

/// Predicted motion at the frame where the next segment starts, in the next segment's parent frame.
fn in_frame_of(context: &SegmentContext<'_>, last: &SegmentStart, next: &SegmentStart) -> Motion {
    let frame = next.frame;
    let predicted = context.predicted(last, frame, &mut RotationCursor::default());
    if last.parent == next.parent {
        return predicted;
    }
    let by = |parent: usize| context.parents[parent].at(frame);
    let world = match last.parent.and_then(by) {
        Some(by) => attached_motion(by, &predicted.pose()),
        None => predicted,
    };
    match next.parent.and_then(by) {
        Some(by) => relative_to(&by.pose(), &world.pose()),
        None => world,
    }
}
