//! For how many ticks a track that begins so will hold.
//!
//! By what the body does next, as far as hindsight knows, and beyond by how it strayed from the law in its last ticks,
//! looked at four moments at a time. Nobody's promise rests on it.

use glam::DVec3;
use rhumb_reckoning::{Motion, Predictor, Ticks, VelocityResidual, carried};
use wide::f64x4;

use super::straying::Stray;
use super::trial::{Place, Trial};
use super::{Subject, Way, share};

/// What the ticks of a track's whole life add to the expected error of the next, as a share of the tolerance …
const DOUBT_OF_A_LIFE: f64 = 0.1;
/// … and each tick, at least and at most.
const DOUBT: [f64; 2] = [0.001, 0.05];
/// The ticks at which an expected error is looked at; the last one twice, to fill its four.
const LOOKS: [[f64; 4]; 4] = [
    [1.0, 2.0, 3.0, 4.0],
    [6.0, 8.0, 12.0, 16.0],
    [24.0, 32.0, 48.0, 64.0],
    [96.0, 128.0, 192.0, 192.0],
];

/// What each tick adds to the expected error of a body, as a share of the tolerance: less of one whose last track held for
/// long, as of what flies freely.
pub(crate) fn doubt(subject: &Subject<'_>) -> f64 {
    let age = subject.tick.since(subject.track.origin);
    let [least, most] = DOUBT;
    (DOUBT_OF_A_LIFE / f64::from(age.unwrap_or_default().count())).clamp(least, most)
}

/// For how long what is known of a body to come suits a track.
enum Known {
    /// To the end of what is known: so many ticks.
    Whole(f64),
    /// It breaks before.
    Breaks(f64),
}

impl Trial<'_> {
    /// For how many ticks a track holds that begins at a place with these velocities beyond the implied ones.
    pub(super) fn life(
        &self,
        way: &Way<'_>,
        place: &Place,
        velocity: Option<&VelocityResidual>,
    ) -> f64 {
        let begun = place.begun(way, velocity, self.grid);
        let known = match self.known(way, &begun) {
            Known::Breaks(ticks) => return ticks,
            Known::Whole(ticks) => ticks,
        };
        let mut stray = way.stray;
        if way.predictor != Predictor::Rest {
            let (truth, said) = (way.frame.truth.twist(), begun.twist());
            stray.linear[0] += (truth.linear - said.linear) * self.step_s;
            stray.angular[0] += (truth.angular - said.angular) * self.step_s;
        }
        let at = self.beyond(&stray, place.off);
        f64::max(at.min(way.lasts), known) + 1.0
    }

    /// How a track suits what hindsight knows.
    fn known(&self, way: &Way<'_>, begun: &Motion) -> Known {
        let (subject, tracks) = (self.subject, self.chooser.tracks);
        let mut held = 0.0;
        for (then, ticks) in subject.ahead.iter().zip(1..) {
            let (slot, ticks_on) = (subject.slot, Ticks::new(ticks));
            let mut motion = tracks.foreseen(slot, way.predictor, begun, subject.tick, ticks_on);
            if let Some(holder) = way.frame.holder
                && let Some(by) = holder.ahead.get(ticks as usize - 1)
            {
                motion = carried(by, &motion.pose());
            }
            let share = share(
                &then.pose(),
                &motion.pose(),
                tracks.tolerance_of(slot),
                tracks.radius(slot),
            );
            let share = share / self.chooser.slack;
            if share > 1.0 {
                return Known::Breaks(held + 1.0 - (share - 1.0).min(1.0) * 0.5);
            }
            held += 1.0;
        }
        Known::Whole(held)
    }

    /// The tick at which a body that begins so far off and strays so is expected to be off by its tolerance.
    fn beyond(&self, stray: &Stray, off: [DVec3; 2]) -> f64 {
        let (mut at, mut before) = (0.0, self.allowance.share(off[0].length(), off[1].length()));
        for looks in LOOKS {
            let shares = self.shares(stray, off, looks);
            let over = shares.simd_gt(f64x4::ONE).to_bitmask();
            let shares = shares.to_array();
            if over == 0 {
                (at, before) = (looks[3], shares[3]);
                continue;
            }
            let lane = over.trailing_zeros() as usize & 3;
            if lane > 0 {
                (at, before) = (looks[lane - 1], shares[lane - 1]);
            }
            let part = ((1.0 - before) / (shares[lane] - before)).clamp(0.0, 1.0);
            return at + part * (looks[lane] - at);
        }
        at
    }

    /// The shares of the tolerance that are expected to be used at four ticks.
    fn shares(&self, stray: &Stray, off: [DVec3; 2], looks: [f64; 4]) -> f64x4 {
        let ticks = f64x4::from(looks);
        let squares = ticks * ticks;
        let far = |[rate, square]: [DVec3; 2], off: DVec3| {
            let part = |rate: f64, square: f64, off: f64| ticks * rate + squares * square - off;
            let x = part(rate.x, square.x, off.x);
            let y = part(rate.y, square.y, off.y);
            let z = part(rate.z, square.z, off.z);
            (x * x + y * y + z * z).sqrt()
        };
        let position = far(stray.linear, off[0]) / self.allowance.position;
        let turn = far(stray.angular, off[1]) / self.allowance.turn;
        let share = if self.allowance.shared {
            position + turn
        } else {
            position.max(turn)
        };
        share + ticks * self.doubt
    }
}
