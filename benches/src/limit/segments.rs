//! One body's way, cut into as few segments as are found.
//!
//! Greedy: from where the last segment breaks the promise, the one that keeps it longest. For one family of fits no
//! other cut of the way has fewer segments, since what holds over a stretch holds over each part of it. A cut for few
//! bits takes the segment that costs least for the time that it holds, which is no more than a good guess.

use rhumb_reckoning::{
    ConstantAcceleration, Grid, Motion, Predictor, QuantisedState, Residual, RotationCursor,
    attached_motion, relative_to,
};

use super::context::{PredictorKind, SegmentContext, SegmentStart};
use super::fit::fit;
use super::path::Path;

/// Frames by which a push is found at first.
const ACCELERATION_FRAMES: usize = 4;
/// A body is held within this many radii of its parent_candidate, and the parent_candidate is larger by the factor below, as publishers
/// have it.
const PARENT_REACH: f64 = 3.0;
/// Velocities are said in steps of half the tolerance a second, where no finer ones are sought.
const COARSENESS: u32 = 3;
/// See above.
pub(super) const PARENT_RATIO: f64 = 1.2;

/// What has to be said at the beginning of a segment.
#[derive(Clone, Copy, Debug)]
pub(super) struct SegmentUpdate {
    pub(super) frame: usize,
    /// Place of the body.
    pub(super) body: usize,
    /// The predictor until now, and from now on.
    pub(super) predictors: [PredictorKind; 2],
    /// Whether the body is held by another than before.
    pub(super) changes_parent: bool,
    /// What pushes it, if that is another push than before.
    pub(super) push: Option<ConstantAcceleration>,
    /// Position and turn in grid steps, and velocities where those implied would not hold as long.
    pub(super) residual: Residual,
}

/// A body's whole way.
#[derive(Clone, Debug, Default)]
pub(super) struct Segmentation {
    pub(super) updates: Vec<SegmentUpdate>,
    /// Surface errors at frames at which the body is elsewhere than a frame before, metres.
    pub(super) errors_m: Vec<f32>,
    /// Where it is predicted_motion to be, frame by frame.
    pub(super) predicted_in_world: Vec<Motion>,
}

/// What a cut is to have little of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Objective {
    /// Segments.
    Updates,
    /// Bits for the time that a segment holds, as far as they can be guessed.
    Bits,
    /// Segments whose motions are such as the protocol can say: rounded to its grid, and judged as rounded.
    UpdatesOnGrid,
}

/// A payload, until when it holds, and what has to be said for it.
#[derive(Clone, Copy, Debug)]
struct SegmentCandidate {
    segment: SegmentStart,
    until: usize,
    update: SegmentUpdate,
}

/// Cuts a body's way into segments.
pub(super) fn cut(context: &SegmentContext<'_>, body: usize, objective: Objective) -> Segmentation {
    let path = context.path;
    let grid = Grid::new(context.tolerance, path.radius);
    let mut segmentation = Segmentation::default();
    let mut segment = known(path, &grid);
    let mut frame = context.holds_until(&segment);
    note(context, &segment, frame, &mut segmentation);
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
        note(context, &segment, frame, &mut segmentation);
    }
    segmentation
}

/// Less is better.
fn price(candidate: &SegmentCandidate, objective: Objective) -> f64 {
    let frames = (candidate.until - candidate.segment.frame) as f64;
    match objective {
        Objective::Updates | Objective::UpdatesOnGrid => 1.0 / frames,
        Objective::Bits => guess(&candidate.update) / frames,
    }
}

/// What an update may take: enough to choose by; what it takes is reckoned when all are known.
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
    let push = update.push.map_or(0.0, |push| {
        three(&push.steps().map(i32::from)) + number(&i32::from(push.exponent()))
    });
    BODY_ID_BITS + three(&residual.position) + three(&residual.turn) + velocity + push
}

/// Which body, and which predictor.
const BODY_ID_BITS: f64 = 6.0;

/// What both ends know before anything is said.
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
        push: None,
    }
}

/// Writes down where a segment has the body, and how far off that is.
fn note(
    context: &SegmentContext<'_>,
    segment: &SegmentStart,
    until: usize,
    segmentation: &mut Segmentation,
) {
    let (mut there, mut apart) = (RotationCursor::default(), RotationCursor::default());
    for frame in segment.frame..until {
        if let Some(predicted_in_world) = context.predicted_in_world(segment, frame, &mut there) {
            segmentation.predicted_in_world.push(predicted_in_world);
        }
        if !context.path.is_same(frame)
            && let Some(off) = context.apart(segment, frame, &mut apart)
        {
            let error = off.surface_error(context.path.radius);
            segmentation.errors_m.push(error.metres() as f32);
        }
    }
}

/// What is said of a fitted motion, and until when that holds.
type Quantise<'r> = &'r dyn Fn(SegmentStart) -> (SegmentStart, usize);

/// The motion that the protocol says where it wants to say a fitted one, with the velocities that hold longer: those
/// that the correction implies, or those that are nearest to the fitted ones.
fn on_grid(
    context: &SegmentContext<'_>,
    grid: &Grid,
    last: &SegmentStart,
    fitted: &SegmentStart,
) -> (SegmentStart, usize) {
    let (residual, implied) = implied(context, grid, last, fitted);
    let mut all = vec![implied];
    if fitted.predictor.moves() {
        // The finest steps that can be said, and those that most words have: what is nearer does not always hold longer.
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
    let held = all.into_iter().map(|quantised| {
        let motion = quantised.motion(grid);
        let segment = SegmentStart { motion, ..*fitted };
        (segment, context.holds_until(&segment))
    });
    held.max_by_key(|(_, until)| *until)
        .unwrap_or((*fitted, fitted.frame))
}

/// The correction of a pose, rounded, and the motion that it leads to by itself.
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

/// The motion that a correction leads to.
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

/// By each predictor the payload that holds longest from a frame on, and until when.
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

/// By one predictor.
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
        push: None,
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
    // Ever longer until none is found, then between what was found and what was not.
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

/// The nearest body that may hold this one.
fn nearest_parent(context: &SegmentContext<'_>, frame: usize) -> Option<usize> {
    let path = context.path;
    let here = path.at(frame).pose().position;
    let far = |place: usize| {
        let parent = &context.parents[place];
        let radius = parent.radius.metres();
        let far = parent.at(frame)?.pose().position.distance(here);
        let holds = radius >= path.radius.metres() * PARENT_RATIO && far <= radius * PARENT_REACH;
        holds.then_some((far, place))
    };
    (0..context.parents.len())
        .filter_map(far)
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, place)| place)
}

/// The ways to say what was found: as it is, and with the velocities that the correction itself implies.
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
            push: next.push.filter(|push| last.push != Some(*push)),
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

/// What was predicted of the frame at which the next payload begins, as that payload's parent_candidate sees it.
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
