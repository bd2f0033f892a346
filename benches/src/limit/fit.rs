//! The motion that stays nearest to what a body does, by one predictor.
//!
//! Weighted least squares, whose weights grow where the error is greatest, so that the greatest error falls (Lawson,
//! 1961). Simple models of position and turn lead; how good a motion is, the normative prediction tells. The best
//! motion there is may be missed; none is called better than it is.

use glam::{DMat3, DQuat, DVec3};
use rhumb_reckoning::{ConstantAcceleration, Divergence, Motion, Pose, RotationCursor, Twist};

use super::context::{PredictorKind, SegmentContext, SegmentStart};

/// Rounds of weighing.
const ROUNDS: u32 = 10;
/// Beyond so many times the tolerance after the first rounds nothing is to be hoped for.
const HOPELESS: f64 = 4.0;
/// The greatest part of a push is said in so many steps at least.
const ACCELERATION_FINENESS: f64 = 64.0;
/// Unknowns of a turn: where it begins and how fast it is.
const UNKNOWNS: usize = 6;

/// A frame to come near to.
#[derive(Clone, Copy, Debug)]
struct FitTarget {
    frame: usize,
    ticks: usize,
    truth: Pose,
    weight: f64,
    /// Where the fit so far is.
    fitted: Pose,
}

/// The payload of a predictor at `from` that comes nearest to the frames from there to `to`, `to` left out; none if its parent_candidate
/// is gone by then or nothing is to be hoped for.
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
        let push = match predictor {
            PredictorKind::ConstantAcceleration => Some(push(context, &targets)?),
            _ => None,
        };
        (pose.position, twist.linear) = place(context, predictor, push, &targets);
        let steps = if round == 0 { 2 } else { 1 };
        for _ in 0..steps {
            propagate(
                context,
                (predictor, push),
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
            (predictor, push),
            from,
            (pose, twist),
            &mut targets,
        )?;
        let worst = weigh(context, &mut targets);
        let segment = SegmentStart {
            predictor,
            frame: from,
            motion,
            parent,
            push,
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
    let aim = |frame: usize| {
        let truth = context.target(frame, parent)?.pose();
        Some(FitTarget {
            frame,
            ticks: context.ticks(from, frame).count() as usize,
            truth,
            weight: 1.0,
            fitted: truth,
        })
    };
    (from..to).filter(|frame| !still(frame)).map(aim).collect()
}

/// The mean spin over all frames, rad/s, world axes.
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

/// The steady push that explains best what the body does, rounded as it is said; none if nothing tells of one, or it is beyond
/// what can be said.
fn push(context: &SegmentContext<'_>, targets: &[FitTarget]) -> Option<ConstantAcceleration> {
    let mut matrix = [[0.0; 4]; 3];
    let mut sums = [DVec3::ZERO; 3];
    for aim in targets {
        let (reach, pushed) = (
            context.basis.reach[aim.ticks],
            context.basis.pushed[aim.ticks],
        );
        let columns = [1.0, reach, pushed];
        for (row, (sum, left)) in matrix.iter_mut().zip(sums.iter_mut().zip(columns)) {
            for (cell, right) in row.iter_mut().zip(columns) {
                *cell += aim.weight * left * right;
            }
            *sum += aim.truth.position * (aim.weight * left);
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
        .filter(|push| push.steps() != [0; 3])
}

/// The best position and velocity under the weights.
fn place(
    context: &SegmentContext<'_>,
    predictor: PredictorKind,
    push: Option<ConstantAcceleration>,
    targets: &[FitTarget],
) -> (DVec3, DVec3) {
    let acceleration = push.map_or(DVec3::ZERO, |push| push.acceleration());
    let pull = |aim: &FitTarget| match predictor {
        PredictorKind::Ballistic => context.path.gravity * context.basis.fall[aim.ticks],
        PredictorKind::ConstantAcceleration => acceleration * context.basis.pushed[aim.ticks],
        _ => DVec3::ZERO,
    };
    let (mut one, mut reach, mut reach2) = (0.0, 0.0, 0.0);
    let (mut sum, mut moment) = (DVec3::ZERO, DVec3::ZERO);
    for aim in targets {
        let (weight, by) = (aim.weight, context.basis.reach[aim.ticks]);
        let position = aim.truth.position - pull(aim);
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

/// What is to be added to the turn at the beginning (rad) and to the spin (rad/s) to come nearer: one step of Gauss and
/// Newton.
fn turn(
    context: &SegmentContext<'_>,
    predictor: PredictorKind,
    targets: &[FitTarget],
    spin: DVec3,
) -> [DVec3; 2] {
    if !predictor.moves() {
        let weights: f64 = targets.iter().map(|aim| aim.weight).sum();
        let errors = targets
            .iter()
            .map(|aim| rotation_vector(aim.truth.rotation, aim.fitted.rotation) * aim.weight);
        return [errors.sum::<DVec3>() / weights, DVec3::ZERO];
    }
    let mut matrix = [[0.0; UNKNOWNS + 1]; UNKNOWNS];
    for aim in targets {
        let error = rotation_vector(aim.truth.rotation, aim.fitted.rotation);
        let by = context.basis.turn[aim.ticks];
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
                *cell += aim.weight * left.dot(*right);
            }
            row[UNKNOWNS] += aim.weight * left.dot(error);
        }
    }
    let [a, b, c, d, e, f] = solved(matrix);
    [DVec3::new(a, b, c), DVec3::new(d, e, f)]
}

/// How a turn changes with its rotation vector. Source: Solà, Deray and Atchuthan (2018), equation 145.
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

/// Gauss' elimination, of `N` unknowns with what they amount to behind them; unknowns that nothing tells of stay zero.
fn solved<const N: usize, const WIDTH: usize>(mut rows: [[f64; WIDTH]; N]) -> [f64; N] {
    const { assert!(WIDTH == N + 1) };
    let scale = (0..N).map(|i| rows[i][i]).fold(0.0, f64::max);
    let mut told = [false; N];
    for pivot in 0..N {
        let least = 1e-12 * scale;
        if rows[pivot][pivot] <= least {
            continue;
        }
        told[pivot] = true;
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
        if told[i] {
            rows[i][N] / rows[i][i]
        } else {
            0.0
        }
    })
}

/// Puts the fitted poses where the normative prediction has them; returns the motion itself, none if it is none.
fn propagate(
    context: &SegmentContext<'_>,
    (predictor, push): (PredictorKind, Option<ConstantAcceleration>),
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
        push,
    };
    let mut cursor = RotationCursor::default();
    for aim in targets {
        aim.fitted = context.predicted(&segment, aim.frame, &mut cursor).pose();
    }
    Some(motion)
}

/// Gives each frame weight by how far off it is; returns the greatest share of the tolerance.
fn weigh(context: &SegmentContext<'_>, targets: &mut [FitTarget]) -> f64 {
    let share = |aim: &FitTarget| {
        let apart = Divergence::between(&aim.truth, &aim.fitted);
        context.tolerance.share(&apart, context.path.radius)
    };
    let worst = targets.iter().map(share).fold(0.0, f64::max);
    let mut total = 0.0;
    for aim in targets.iter_mut() {
        aim.weight *= share(aim).max(1e-3 * worst).max(f64::MIN_POSITIVE);
        total += aim.weight;
    }
    let scale = targets.len() as f64 / total;
    for aim in targets {
        aim.weight *= scale;
    }
    worst
}

/// The shortest turn from one rotation to another, axis times angle, rad.
fn rotation_vector(to: DQuat, from: DQuat) -> DVec3 {
    let turn = to * from.conjugate();
    let turn = if turn.w < 0.0 { -turn } else { turn };
    turn.to_scaled_axis()
}
