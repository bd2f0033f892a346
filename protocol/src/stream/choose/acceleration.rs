//! Whether something accelerations a body steadily, and with how much.
//!
//! An engine's velocities are exact, so that two ticks tell an acceleration: it counts as steady where the tick before, or
//! with lookahead the next one, has the same. How long it will last nobody knows.

use glam::DVec3;
use rhumb_reckoning::{ConstantAcceleration, Motion};

use super::{Chooser, Subject};

/// Pushes that are tried: the one that the track has, and the one that was seen, finely and coarsely.
pub(super) const ACCELERATIONS: usize = 3;
/// How much one tick's acceleration may differ from that of its neighbour, and must differ from gravity, as a share of it.
const UNSTEADY: f64 = 0.1;
/// A push is units payload where it moves a body by the tolerance in fewer ticks than the first, and in more than the
/// second.
const WORTH: [f64; 2] = [32.0, 1.0];
/// Steps are so fine that the greatest part of a push takes at least so many of them.
const FINENESS: [f64; ACCELERATIONS - 1] = [16.0, 64.0];

impl Chooser<'_> {
    /// Pushes by which a body may go on; what its track has first.
    pub(super) fn accelerations(
        &self,
        subject: &Subject<'_>,
    ) -> [Option<ConstantAcceleration>; ACCELERATIONS] {
        let mut accelerations = [None; ACCELERATIONS];
        let spins = self.features.torque_free || !subject.slot.is_torque_free();
        if !self.features.accelerated || !spins {
            return accelerations;
        }
        accelerations[0] = subject.track.predictor.acceleration();
        let Some(seen) = self.push(subject) else {
            return accelerations;
        };
        for (push, fineness) in accelerations[1..].iter_mut().zip(FINENESS) {
            *push = ConstantAcceleration::nearest(seen, fineness);
        }
        accelerations
    }

    /// The acceleration of a body that is accelerated steadily, and enough to be spoken of: m/s².
    fn push(&self, subject: &Subject<'_>) -> Option<DVec3> {
        let between = |before: &Motion, after: &Motion| {
            let (before, after) = (before.twist().linear, after.twist().linear);
            self.tracks.acceleration(subject.slot, before, after)
        };
        let now = &subject.truth;
        let (push, neighbour) = match (subject.ahead, subject.last) {
            ([next, last, ..], _) => (between(now, next), between(next, last)),
            (_, [Some(one), Some(two)]) => (between(&one, now), between(&two, &one)),
            _ => return None,
        };
        let step = self.tracks.integrator().rate.step().seconds();
        let tolerance = self.allowance(subject).position;
        let [least, most] = WORTH.map(|ticks| tolerance * 2.0 / (ticks * step * ticks * step));
        let strength = push.length();
        let near = |other: DVec3| push.distance(other) < UNSTEADY * strength;
        // What gravity does another predictor knows.
        let falls = near(self.tracks.gravity(subject.slot, subject.tick));
        (near(neighbour) && !falls && strength > least && strength < most).then_some(push)
    }
}
