//! For how many ticks a track that begins so will hold.
//!
//! By what the body does next, as far as hindsight knows, and beyond by how it strayed from the law lately. What it does between
//! two ticks that are spoken of nobody sees. Nobody's promise rests on it.

use rhumb_reckoning::{Motion, Predictor, Ticks, VelocityResidual, carried};

use super::shares::Shares;
use super::trial::{Place, Trial};
use super::{Subject, Way, share};

/// What the ticks of a track's whole life add to the expected error of the next, as a share of the tolerance …
const DOUBT_OF_A_LIFE: f64 = 0.1;
/// … and each tick, at least and at most.
const DOUBT: [f64; 2] = [0.001, 0.05];
/// The ticks at which an expected error is looked at.
const LOOKS: [f64; 15] = [
    1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 96.0, 128.0, 192.0,
];

/// What is reckoned before it is put on the grid is off by less than this share of the tolerance.
pub(super) const ROUGHLY: f64 = 0.05;

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

/// How a body is expected to stray on a course: α·h + β·h² after h ticks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prospect {
    /// Of a track that begins without velocities.
    still: Shares,
    square: Shares,
    /// For how many ticks the course may go on at most.
    lasts: f64,
}

impl Trial<'_> {
    pub(super) fn prospect(&self, way: &Way<'_>) -> Prospect {
        let ([linear, linear_square], [angular, angular_square]) =
            (way.stray.linear, way.stray.angular);
        let mut still = Shares::of([linear, angular], self.worth.still);
        if way.predictor != Predictor::Rest {
            // What strays is measured against one that begins at the true ones.
            let twist = way.frame.truth.twist();
            still = still + Shares::of([twist.linear, twist.angular], self.worth.moving);
        }
        Prospect {
            still,
            square: Shares::of([linear_square, angular_square], self.worth.still),
            lasts: way.lasts,
        }
    }

    /// For how many ticks a track holds that begins at a place with these velocities beyond the implied ones.
    pub(super) fn life(
        &self,
        way: &Way<'_>,
        prospect: &Prospect,
        place: &Place,
        velocity: Option<&VelocityResidual>,
    ) -> f64 {
        let known = match self.subject.ahead {
            [] => 0.0,
            _ => match self.known(way, &place.begun(way, velocity, self.grid)) {
                Known::Breaks(ticks) => return ticks,
                Known::Whole(ticks) => ticks,
            },
        };
        let mut rate = prospect.still;
        if way.predictor != Predictor::Rest {
            rate = rate - place.implies;
            if let Some(velocity) = velocity {
                let VelocityResidual {
                    linear, angular, ..
                } = *velocity;
                let doubled = f64::from(1_u32 << (velocity.coarseness & 31));
                rate = rate - Shares::of_steps(linear, angular, self.worth.velocities) * doubled;
            }
        }
        let at = self.beyond(&rate, &prospect.square, &place.off, 1.0);
        f64::max(at.min(prospect.lasts), known) + self.unseen()
    }

    /// How a track suits what hindsight knows.
    fn known(&self, way: &Way<'_>, begun: &Motion) -> Known {
        let (subject, tracks) = (self.subject, self.chooser.tracks);
        let every = tracks.every().get();
        let mut held = 0.0;
        let spoken_of = (1..)
            .zip(subject.ahead)
            .filter(|(ticks, _)| ticks % every == 0);
        for (ticks, then) in spoken_of {
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
                let half = (share - 1.0).min(1.0) * 0.5;
                return Known::Breaks(held + f64::from(every) * (1.0 - half));
            }
            held = f64::from(ticks);
        }
        Known::Whole(held)
    }

    /// The tick at which a body that begins so far off and strays so is expected to be off by so much of its tolerance.
    #[inline]
    fn beyond(&self, rate: &Shares, square: &Shares, off: &Shares, most: f64) -> f64 {
        let (mut at, mut before) = (0.0, self.worth.both(off));
        for look in LOOKS {
            let strayed = *rate * look + *square * (look * look) - *off;
            let share = self.worth.both(&strayed) + self.doubt * look;
            if share > most {
                let part = ((most - before) / (share - before)).clamp(0.0, 1.0);
                return at + part * (look - at);
            }
            (at, before) = (look, share);
        }
        at
    }

    /// For how many ticks a track holds at most, more or less, that begins so far off with these velocities.
    pub(super) fn at_most(
        &self,
        prospect: &Prospect,
        off: &Shares,
        implies: Option<Shares>,
    ) -> f64 {
        let rate = implies.map_or(prospect.still, |implies| prospect.still - implies);
        let at = self.beyond(&rate, &prospect.square, off, 1.0 + ROUGHLY);
        at.min(prospect.lasts) + self.unseen()
    }

    /// How much longer a track stands once it does not hold any more: until the next tick that is spoken of, or a tick. Twice
    /// as much served the ball pit at every sixth tick a hundredth better, and asteroids at every other one worse.
    fn unseen(&self) -> f64 {
        f64::from((self.chooser.tracks.every().get() - 1).max(1))
    }
}
