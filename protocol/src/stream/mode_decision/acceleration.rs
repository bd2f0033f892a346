//! Detection of a steady acceleration of a body.
//!
//! An engine's velocities are exact, so that the difference of two ticks gives the acceleration. An acceleration is
//! steady if the tick before, or with lookahead the next tick, has the same one.

use glam::DVec3;
use rhumb_reckoning::{ConstantAcceleration, Motion};

use super::subject::{Context, Subject};

/// Number of candidate accelerations: the track's own, and the observed one.
pub(super) const ACCELERATIONS: usize = 2;
/// Relative difference of two accelerations below which they count as equal: of two ticks, or of a tick and gravity.
const EQUAL_WITHIN: f64 = 0.1;
/// Ticks in which a worthwhile acceleration moves a body by the tolerance: fewer than the first, more than the second.
///
/// A weaker one does not pay for its bits. A stronger one does not hold.
const WORTHWHILE_TICKS: [f64; 2] = [32.0, 1.0];
/// Least number of steps of the greatest component of the observed acceleration.
const STEPS_MIN: f64 = 32.0;

/// Candidate accelerations of a body's next track; the present track's own is the first.
pub(super) fn accelerations(
    context: &Context<'_>,
    subject: &Subject<'_>,
    reach: f64,
    gravity: DVec3,
) -> [Option<ConstantAcceleration>; ACCELERATIONS] {
    let mut all = [None; ACCELERATIONS];
    let spins = context.features.torque_free || !subject.slot.is_torque_free();
    if !context.features.accelerated || !spins {
        return all;
    }
    all[0] = subject.track.predictor.acceleration();
    all[1] = acceleration(context, subject, reach, gravity)
        .and_then(|observed| ConstantAcceleration::nearest(observed, STEPS_MIN));
    all
}

/// A steady, worthwhile acceleration, m/s². `reach`: the greatest allowed error of position, metres.
fn acceleration(
    context: &Context<'_>,
    subject: &Subject<'_>,
    reach: f64,
    gravity: DVec3,
) -> Option<DVec3> {
    let between = |before, after| context.tracks.acceleration(subject.slot, before, after);
    let velocity = |motion: &Motion| motion.twist().linear;
    let now = velocity(subject.truth);
    let [(before, after), (other, next)] = match (subject.ahead, subject.velocities) {
        ([next, last, ..], _) => {
            let next = velocity(next);
            [(now, next), (next, velocity(last))]
        }
        (_, Some([one, two])) => [(one, now), (two, one)],
        _ => return None,
    };
    let acceleration = between(before, after);
    let strength = acceleration.length_squared();
    let step = context.tracks.integrator().rate.step().seconds();
    // Squares are compared: a root less.
    let once = reach * 2.0 / (step * step);
    let bound = |ticks: f64| (once / (ticks * ticks)) * (once / (ticks * ticks));
    if strength <= bound(WORTHWHILE_TICKS[0]) || strength >= bound(WORTHWHILE_TICKS[1]) {
        return None;
    }
    let near = |other: DVec3| {
        acceleration.distance_squared(other) < EQUAL_WITHIN * EQUAL_WITHIN * strength
    };
    // The ballistic predictor covers gravity.
    let falls = near(gravity);
    (!falls && near(between(other, next))).then_some(acceleration)
}
