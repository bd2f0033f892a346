//! Whether something pushes a body steadily, and with how much.
//!
//! An engine's velocities are exact, so that two ticks tell an acceleration: it counts as steady where the tick before, or
//! with hindsight the next one, has the same. How long it will last nobody knows.

use glam::DVec3;
use rhumb_reckoning::{Motion, Push};

use super::{Chooser, Subject};

/// Pushes that are tried: the one that the track has, and the one that was seen, finely and coarsely.
pub(super) const PUSHES: usize = 3;
/// How much one tick's acceleration may differ from that of its neighbour, and must differ from gravity, as a share of it.
const UNSTEADY: f64 = 0.1;
/// A push is worth saying where it moves a body by the tolerance in fewer ticks than the first, and in more than the
/// second.
const WORTH: [f64; 2] = [32.0, 1.0];
/// Steps are so fine that the greatest part of a push takes at least so many of them.
const FINENESS: [f64; PUSHES - 1] = [16.0, 64.0];

impl Chooser<'_> {
    /// Pushes by which a body may go on; what its track has first.
    pub(super) fn pushes(&self, subject: &Subject<'_>) -> [Option<Push>; PUSHES] {
        let mut pushes = [None; PUSHES];
        let spins = self.features.tumbling || !subject.slot.tumbles();
        if !self.features.pushed || !spins {
            return pushes;
        }
        pushes[0] = subject.track.predictor.push();
        let Some(seen) = self.push(subject) else {
            return pushes;
        };
        for (push, fineness) in pushes[1..].iter_mut().zip(FINENESS) {
            *push = Push::nearest(seen, fineness);
        }
        pushes
    }

    /// The acceleration of a body that is pushed steadily, and enough to be spoken of: m/s².
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
        // What gravity does another law knows.
        let falls = near(self.tracks.gravity(subject.slot, subject.tick));
        (near(neighbour) && !falls && strength > least && strength < most).then_some(push)
    }
}
