//! Fits the motion that stays nearest to a body's path, by one predictor.
//!
//! Iteratively reweighted least squares: weights grow where the error is largest, so the largest error falls (Lawson,
//! 1961). Simple models of position and rotation guide the fit; the normative prediction measures its quality. The
//! best motion may be missed, but no fit is rated better than it is.

use glam::{DMat3, DQuat, DVec3};
use rhumb_reckoning::{ConstantAcceleration, Divergence, Motion, Pose, RotationCursor, Twist};

use super::context::{PredictorKind, SegmentContext, SegmentStart};

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
