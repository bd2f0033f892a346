//! Whether a steady acceleration acts on a body.
//!
//! An engine's velocities are exact, so that two ticks tell an acceleration. It counts as steady where the tick before, or
//! with lookahead the next one, has the same.

use glam::DVec3;
use rhumb_reckoning::{ConstantAcceleration, Motion};

use super::subject::{Context, Subject};

/// Accelerations that are tried: the track's own, and the seen one, finely and coarsely.
pub(super) const ACCELERATIONS: usize = 3;
/// How much one tick's acceleration may differ from its neighbour's, and must differ from gravity, as a share of it.
const UNSTEADY: f64 = 0.1;
/// An acceleration is worth its bits where it moves a body by the tolerance in fewer ticks than the first, and in more than the
/// second.
const WORTH: [f64; 2] = [32.0, 1.0];
/// Steps are so fine that the greatest part of an acceleration takes at least so many of them.
const FINENESS: [f64; ACCELERATIONS - 1] = [16.0, 64.0];

/// Accelerations by which a body may go on; its track's own first.
pub(super) fn accelerations(
    context: &Context<'_>,
    subject: &Subject<'_>,
    reach: f64,
) -> [Option<ConstantAcceleration>; ACCELERATIONS] {
    let mut all = [None; ACCELERATIONS];
    let spins = context.features.torque_free || !subject.slot.is_torque_free();
    if !context.features.accelerated || !spins {
        return all;
    }
    all[0] = subject.track.predictor.acceleration();
    let Some(seen) = acceleration(context, subject, reach) else {
        return all;
    };
    for (acceleration, fineness) in all[1..].iter_mut().zip(FINENESS) {
        *acceleration = ConstantAcceleration::nearest(seen, fineness);
    }
    all
}

/// A steady acceleration that is worth its bits, m/s². `reach`: how far off a body's position may be, metres.
fn acceleration(context: &Context<'_>, subject: &Subject<'_>, reach: f64) -> Option<DVec3> {
    let between = |before: &Motion, after: &Motion| {
        let (before, after) = (before.twist().linear, after.twist().linear);
        context.tracks.acceleration(subject.slot, before, after)
    };
    let now = &subject.truth;
    let [(before, after), (other, next)] = match (subject.ahead, &subject.last) {
        ([next, last, ..], _) => [(now, next), (next, last)],
        (_, [Some(one), Some(two)]) => [(one, now), (two, one)],
        _ => return None,
    };
    let acceleration = between(before, after);
    let strength = acceleration.length_squared();
    let step = context.tracks.integrator().rate.step().seconds();
    let bound = |ticks: f64| {
        let strength = reach * 2.0 / (ticks * step * ticks * step);
        strength * strength
    };
    if strength <= bound(WORTH[0]) || strength >= bound(WORTH[1]) {
        return None;
    }
    let near = |other: DVec3| acceleration.distance_squared(other) < UNSTEADY * UNSTEADY * strength;
    // Another predictor knows of gravity.
    let falls = near(context.tracks.gravity(subject.slot, subject.tick));
    (!falls && near(between(other, next))).then_some(acceleration)
}
