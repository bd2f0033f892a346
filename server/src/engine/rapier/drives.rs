//! The law of a motor, and the motions that motors of one joint drive.
//!
//! A motor accelerates its own axis and leaves the others to their motors. Where the bodies are not balanced about the
//! axes, a torque about one accelerates all. So motors of several rotations are laid along the axes in which the bodies
//! are balanced, and those of a body that is driven along and about every axis at its centre of mass. With equal
//! stiffness and damping that is the same law; what different ones make is added as a force. The law itself knows
//! numbers only, neither bodies nor joints.

use std::f64::consts::PI;

use glam::{DQuat, DVec3};
use rhumb_protocol::limits::FORCE_MAX;
use rhumb_protocol::scene::Motor;

use super::held_joint::{Ease, HeldJoint, Six};

/// The mean acceleration of a motor in a step, by its law and as the solver takes it: in substeps, each by its end.
pub(super) fn mean_acceleration(
    motor: &Motor,
    lack: f64,
    rate: f64,
    (step, substep): (f64, f64),
) -> f64 {
    let (turned, rate_after) = after_step(motor, lack, rate, (step, substep));
    debug_assert!(turned.is_finite(), "its numbers are");
    (rate_after - rate) / step
}

/// The way and the rate of a motor after a step, by its law.
pub(super) fn after_step(
    motor: &Motor,
    lack: f64,
    rate: f64,
    (step, substep): (f64, f64),
) -> (f64, f64) {
    let (stiffness, damping) = (f64::from(motor.stiffness), f64::from(motor.damping));
    let (mut way, mut now) = (0.0, rate);
    let mut left = step;
    while left > substep * 0.5 {
        let slow = f64::from(motor.velocity) - now;
        let force = stiffness * (lack - way - substep * now) + damping * slow;
        now += substep * force / (1.0 + substep * damping + substep * substep * stiffness);
        way += substep * now;
        left -= substep;
    }
    (way, now)
}

/// Stiffness and damping of a row, N/m and N·s/m or about it, that accelerate by the motor's.
///
/// A substep solves each row twice. With `a` and `b` the two eases of the row and `c` the softness of the motor, a row that
/// takes `x` of the lack for each pass gives the impulse `x · (1 + x · (a − b))`; one substep of the motor's law takes
/// `1 / (b · (1 + c))`.
pub(super) fn gains([a, b]: [f64; 2], motor: &Motor, substep: f64) -> Gains {
    let (mut stiffness, mut damping) = (f64::from(motor.stiffness), f64::from(motor.damping));
    let softness =
        |stiffness: f64, damping: f64| 1.0 / (substep * substep * stiffness + substep * damping);
    let mut c = softness(stiffness, damping);
    let is_sound = c.is_finite() && b > 0.0;
    if !is_sound {
        return Gains::default();
    }
    let wanted = 1.0 / (b * (1.0 + c));
    let lost = a - b;
    let mut is_exact = true;
    let mut x = match lost > a * 1e-6 {
        true => ((1.0 + 4.0 * lost * wanted).sqrt() - 1.0) / (2.0 * lost),
        false => wanted,
    };
    if x > 1.0 / a {
        // The most that the row can do, at the same damping ratio.
        is_exact = false;
        x = 1.0 / a;
        c = a * a / (b * (2.0 * a - b)) - 1.0;
        let c = c.max(f64::EPSILON);
        let ratio = damping / (2.0 * stiffness.sqrt());
        if stiffness > 0.0 {
            let root = ((ratio * ratio + 1.0 / c).sqrt() - ratio) / substep;
            stiffness = root * root;
            damping = 2.0 * ratio * root;
        } else {
            damping = 1.0 / (c * substep);
        }
    }
    let yielding = (1.0 / x - a).max(a * 1e-6);
    let weight = softness(stiffness, damping) / yielding;
    Gains {
        stiffness: stiffness * weight,
        damping: damping * weight,
        share: x * (1.0 + x * lost),
        is_exact,
    }
}

/// The settings of a motor in Rapier.
#[derive(Default)]
pub(super) struct Gains {
    /// N/m or N·m.
    pub(super) stiffness: f64,
    /// N·s/m or N·m·s.
    pub(super) damping: f64,
    /// Impulse of a substep for each unit of velocity that the row lacks.
    pub(super) share: f64,
    /// False if the motor is too strong for the row.
    pub(super) is_exact: bool,
}

/// A driven motion of the second body against the first.
#[derive(Clone, Copy, Debug)]
pub(super) struct DrivenMotion {
    /// Unit push at the anchor.
    pub(super) unit: Six,
    pub(super) is_turn: bool,
    /// True if it is laid along another axis than the motor's own.
    pub(super) is_laid: bool,
    /// A point that a turn leaves where it is.
    pub(super) centre: DVec3,
    /// The settings along or about this motion.
    pub(super) motor: Motor,
    /// Metres or radians.
    pub(super) lack: f64,
    /// m/s or rad/s.
    pub(super) rate: f64,
    /// Acceleration beside that of the law.
    pub(super) more: f64,
    /// Limits from where it is now, metres or radians.
    pub(super) limits: Option<[f64; 2]>,
}

impl DrivenMotion {
    fn of(held: &HeldJoint, axis: usize, motor: Motor) -> Self {
        let limits = held.limits[axis];
        Self {
            unit: held.axis(axis),
            is_turn: axis >= 3,
            is_laid: false,
            centre: held.anchor,
            motor,
            lack: held.lack(axis, &motor),
            rate: held.rates[axis],
            more: 0.0,
            limits: limits.map(|limits| limits.map(|limit| limit - held.place[axis])),
        }
    }

    /// Unit vector along or about which it moves.
    pub(super) fn direction(&self) -> DVec3 {
        match self.is_turn {
            true => self.unit.angular,
            false => self.unit.linear,
        }
    }

    /// Aims no farther than this past its limits in a step.
    fn bound(&mut self, past: f64, (step, substep): (f64, f64)) {
        let Some([least, most]) = self.limits else {
            return;
        };
        let (way, _) = after_step(&self.motor, self.lack, self.rate, (step, substep));
        let rest = way.max(least - past).min(most + past);
        if rest == way {
            return;
        }
        // The velocity that makes its way in the step end there.
        let one = Motor {
            velocity: 0.0,
            ..self.motor
        };
        if self.motor.stiffness > 0.0 {
            let (each, _) = after_step(&one, 1.0, 0.0, (step, substep));
            self.lack += (rest - way) / each.max(f64::MIN_POSITIVE);
        } else {
            let one = Motor {
                velocity: 1.0,
                ..self.motor
            };
            let (each, _) = after_step(&one, 0.0, 0.0, (step, substep));
            self.motor.velocity += ((rest - way) / each.max(f64::MIN_POSITIVE)) as f32;
        }
    }
}

/// A smaller share of a motor in a drive counts for none.
const SHARE_MIN: f64 = 0.01;

/// Distance past its limit at which a motor along its own axis aims in a step, metres or radians, so that it carries a
/// load there.
const PAST: f64 = 0.02;

/// The drives of a joint's motors, one for each.
pub(super) fn drives(
    held: &HeldJoint,
    motors: &[(usize, Motor)],
    substep: f64,
) -> Vec<DrivenMotion> {
    let drives = motors
        .iter()
        .map(|(axis, motor)| DrivenMotion::of(held, *axis, *motor));
    let mut drives: Vec<_> = drives.collect();
    let drives_it =
        |motor: &Motor| motor.force > 0.0 && (motor.stiffness > 0.0 || motor.damping > 0.0);
    let turns: Vec<_> = (0..drives.len())
        .filter(|place| drives[*place].is_turn && drives_it(&drives[*place].motor))
        .collect();
    let times = (held.step, substep);
    if turns.len() < 2 {
        drives.iter_mut().for_each(|drive| drive.bound(PAST, times));
        return drives;
    }
    if turns.len() == 3 {
        aim_turns(held, &mut drives, motors);
    }
    let is_whole = drives.len() == 6 && drives.iter().all(|drive| drives_it(&drive.motor));
    for drive in &mut drives {
        drive.is_laid = drive.is_turn || is_whole;
        drive.bound(if drive.is_laid { 0.0 } else { PAST }, times);
        drive.limits = drive.limits.filter(|_| !drive.is_laid);
    }
    let sides = held.held.unwrap_or(held.pair);
    if is_whole {
        centre(&mut drives, &sides, times);
    }
    let own: Vec<_> = turns.iter().map(|place| drives[*place]).collect();
    let balanced = balanced(held, &sides, &own);
    let laid = laid_along(&own, &balanced, times);
    for (place, drive) in turns.into_iter().zip(laid) {
        drives[place] = drive;
    }
    drives
}

/// Aims motors of all three turns along the shortest turn to their target. Their angles, one by one, wind about it.
fn aim_turns(held: &HeldJoint, drives: &mut [DrivenMotion], motors: &[(usize, Motor)]) {
    let mut target = DVec3::ZERO;
    for (drive, (axis, motor)) in drives.iter().zip(motors).filter(|(drive, _)| drive.is_turn) {
        if motor.stiffness <= 0.0 || drive.lack.abs() > PI {
            return;
        }
        target[*axis - 3] = libm::sin(0.5 * (held.place[*axis] + drive.lack));
    }
    let rest = 1.0 - target.length_squared();
    if rest < 0.0 {
        return;
    }
    let left = DQuat::from_xyzw(target.x, target.y, target.z, rest.sqrt()) * held.turn.inverse();
    let left = if left.w < 0.0 { -left } else { left };
    let sine = left.xyz().length();
    if sine > 0.0 {
        let turn = left.xyz() * (2.0 * libm::atan2(sine, left.w) / sine);
        for (drive, (axis, _)) in drives
            .iter_mut()
            .zip(motors)
            .filter(|(drive, _)| drive.is_turn)
        {
            drive.lack = turn[*axis - 3];
        }
    }
}

/// Mean acceleration of a drive in a step.
fn mean(drive: &DrivenMotion, times: (f64, f64)) -> f64 {
    mean_acceleration(&drive.motor, drive.lack, drive.rate, times)
}

/// Lays motors of all six axes through the centre of mass.
fn centre(drives: &mut [DrivenMotion], sides: &[Ease; 2], times: (f64, f64)) {
    let weights =
        sides.map(|side| side.angular.x_axis.x + side.angular.y_axis.y + side.angular.z_axis.z);
    let [first, second] = weights;
    let middle = (sides[0].centre * first + sides[1].centre * second) / (first + second);
    if !middle.is_finite() {
        return;
    }
    let sum = |value: fn(&DrivenMotion) -> f64, drives: &[DrivenMotion]| -> DVec3 {
        let turns = drives.iter().filter(|drive| drive.is_turn);
        turns.map(|drive| drive.direction() * value(drive)).sum()
    };
    let lack = sum(|drive| drive.lack, drives);
    let rate = sum(|drive| drive.rate, drives);
    let speed = sum(|drive| f64::from(drive.motor.velocity), drives);
    let turns = drives.iter().filter(|drive| drive.is_turn);
    let turned: DVec3 = turns
        .map(|drive| drive.direction() * mean(drive, times))
        .sum();
    for drive in drives {
        let arm = middle - drive.centre;
        drive.centre = middle;
        if drive.is_turn {
            continue;
        }
        let direction = drive.direction();
        let wanted = mean(drive, times) + turned.cross(arm).dot(direction);
        drive.unit.angular = arm.cross(direction);
        drive.lack += lack.cross(arm).dot(direction);
        drive.rate += rate.cross(arm).dot(direction);
        drive.motor.velocity += speed.cross(arm).dot(direction) as f32;
        drive.more = wanted - mean(drive, times);
    }
}

/// Axes of turns that do not move each other, as shares of those of the drives; each with how easily it turns.
fn balanced(held: &HeldJoint, sides: &[Ease; 2], drives: &[DrivenMotion]) -> Vec<(Vec<f64>, f64)> {
    let count = drives.len();
    let mut ease = [[0.0; 3]; 3];
    for (column, drive) in drives.iter().enumerate() {
        let (_, answer) = held.freed(sides, drive.unit);
        for (row, other) in drives.iter().enumerate() {
            ease[row][column] = answer.dot(other.unit);
        }
    }
    let (eigen, shares) = eigen(ease, count);
    let axes = (0..count).map(|axis| {
        let shares = (0..count).map(|of| shares[of][axis]).collect();
        (shares, eigen[axis])
    });
    axes.collect()
}

/// Eigenvalues and eigenvectors, in columns, of a symmetric matrix of two or three rows: Jacobi's method.
fn eigen(mut matrix: [[f64; 3]; 3], count: usize) -> ([f64; 3], [[f64; 3]; 3]) {
    const SWEEPS: usize = 12;
    let mut vectors = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for _ in 0..SWEEPS {
        for p in 0..count {
            for q in p + 1..count {
                let off = (matrix[p][q] + matrix[q][p]) * 0.5;
                let size = matrix[p][p] * matrix[q][q];
                // The rest of a rounding does not turn axes that are equal.
                if off * off <= size * 1e-6 {
                    continue;
                }
                let ratio = (matrix[q][q] - matrix[p][p]) / (2.0 * off);
                let tangent = ratio.signum() / (ratio.abs() + (ratio * ratio + 1.0).sqrt());
                let cosine = 1.0 / (tangent * tangent + 1.0).sqrt();
                let sine = tangent * cosine;
                for row in &mut matrix {
                    (row[p], row[q]) = (
                        cosine * row[p] - sine * row[q],
                        sine * row[p] + cosine * row[q],
                    );
                }
                let (upper, lower) = matrix.split_at_mut(q);
                for (one, other) in upper[p].iter_mut().zip(&mut lower[0]) {
                    (*one, *other) = (cosine * *one - sine * *other, sine * *one + cosine * *other);
                }
                for row in &mut vectors {
                    (row[p], row[q]) = (
                        cosine * row[p] - sine * row[q],
                        sine * row[p] + cosine * row[q],
                    );
                }
            }
        }
    }
    ([matrix[0][0], matrix[1][1], matrix[2][2]], vectors)
}

/// The same motion by drives along other axes.
fn laid_along(
    own: &[DrivenMotion],
    axes: &[(Vec<f64>, f64)],
    times: (f64, f64),
) -> Vec<DrivenMotion> {
    let means: Vec<_> = own.iter().map(|drive| mean(drive, times)).collect();
    let laid = axes.iter().map(|(shares, _)| {
        let sum = |value: fn(&DrivenMotion) -> f64| -> f64 {
            own.iter()
                .zip(shares)
                .map(|(drive, share)| value(drive) * share)
                .sum()
        };
        let weighed = |value: fn(&DrivenMotion) -> f32| -> f32 {
            let parts = own.iter().zip(shares);
            parts
                .map(|(drive, share)| f64::from(value(drive)) * share * share)
                .sum::<f64>() as f32
        };
        let direction: DVec3 = own
            .iter()
            .zip(shares)
            .map(|(drive, share)| drive.direction() * *share)
            .sum();
        let mut drive = DrivenMotion {
            unit: Six {
                linear: DVec3::ZERO,
                angular: direction.normalize(),
            },
            motor: Motor {
                position: 0.0,
                velocity: sum(|drive| f64::from(drive.motor.velocity)) as f32,
                stiffness: weighed(|drive| drive.motor.stiffness),
                damping: weighed(|drive| drive.motor.damping),
                force: FORCE_MAX,
            },
            lack: sum(|drive| drive.lack),
            rate: sum(|drive| drive.rate),
            ..own[0]
        };
        let wanted: f64 = means
            .iter()
            .zip(shares)
            .map(|(mean, share)| mean * share)
            .sum();
        drive.more = wanted - mean(&drive, times);
        drive
    });
    let mut laid: Vec<_> = laid.collect();
    bound_torques(own, axes, &mut laid, times);
    laid
}

/// Bounds the torques of drives by those of the motors that they stand for.
fn bound_torques(
    own: &[DrivenMotion],
    axes: &[(Vec<f64>, f64)],
    laid: &mut [DrivenMotion],
    times: (f64, f64),
) {
    if own.iter().all(|drive| drive.motor.force >= FORCE_MAX) {
        return;
    }
    // The torque that the law asks for, about the axes of the motors.
    let asked = laid
        .iter()
        .zip(axes)
        .map(|(drive, (_, ease))| (mean(drive, times) + drive.more) / ease.max(f64::MIN_POSITIVE));
    let asked: Vec<_> = asked.collect();
    let given = own.iter().enumerate().map(|(place, drive)| {
        let torque: f64 = axes
            .iter()
            .zip(&asked)
            .map(|((shares, _), asked)| shares[place] * asked)
            .sum();
        let most = f64::from(drive.motor.force);
        torque.clamp(-most, most)
    });
    let given: Vec<_> = given.collect();
    for ((drive, (shares, ease)), asked) in laid.iter_mut().zip(axes).zip(&asked) {
        let torque: f64 = shares
            .iter()
            .zip(&given)
            .map(|(share, given)| share * given)
            .sum();
        // The rest of the motors that it is part of, each for all drives that it is part of.
        let spare = own
            .iter()
            .zip(&given)
            .enumerate()
            .filter(|(place, _)| shares[*place].abs() > SHARE_MIN);
        let spare = spare.map(|(place, (own, given))| {
            let reach: f64 = axes.iter().map(|(shares, _)| shares[place].abs()).sum();
            (f64::from(own.motor.force) - given.abs()) / reach
        });
        let spare = spare.fold(f64::from(FORCE_MAX), f64::min);
        drive.motor.force = (torque.abs() + spare) as f32;
        if torque * asked < 0.0 {
            // The other way round than its law: as a force alone.
            drive.more += (torque - asked) * ease;
        }
    }
}
