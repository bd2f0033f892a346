//! For how many ticks a track that begins so will hold.
//!
//! By what the body does next, as far as lookahead knows, and beyond by how it diverged from the predictor lately. What it does between
//! two ticks that are spoken of nobody sees. Nobody's promise rests on it.

use rhumb_reckoning::{Motion, Predictor, Ticks, VelocityResidual, attached_motion};

use super::shares::Shares;
use super::trial::{CorrectedPose, Trial};
use super::{ModeCandidate, Subject, share};

/// What the ticks of a track's whole lifetime add to the expected error of the next, as a share of the tolerance …
const ERROR_GROWTH_PER_LIFETIME: f64 = 0.1;
/// … and each tick, at least and at most.
const ERROR_GROWTH: [f64; 2] = [0.001, 0.05];
/// The ticks at which an expected error is looked at.
const LOOKS: [f64; 15] = [
    1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 96.0, 128.0, 192.0,
];

/// What is reckoned before it is put on the grid is off by less than this share of the tolerance.
pub(super) const ROUGHLY: f64 = 0.05;

/// What each tick adds to the expected error of a body, as a share of the tolerance: less of one whose last track attached for
/// long, as of what flies freely.
pub(crate) fn error_growth(subject: &Subject<'_>) -> f64 {
    let age = subject.tick.since(subject.track.origin);
    let [least, most] = ERROR_GROWTH;
    (ERROR_GROWTH_PER_LIFETIME / f64::from(age.unwrap_or_default().count())).clamp(least, most)
}

/// For how long what is known of a body to come suits a track.
enum KnownLifetime {
    /// To the end of what is known: so many ticks.
    Keyframe(f64),
    /// It breaks before.
    Breaks(f64),
}

/// How a body is expected to prediction_error on a mode: α·h + β·h² after h ticks.
#[derive(Clone, Copy, Debug)]
pub(super) struct LifetimeEstimate {
    /// Of a track that begins without velocities.
    still: Shares,
    square: Shares,
    /// For how many ticks the mode may go on at most.
    lasts: f64,
}

impl Trial<'_> {
    pub(super) fn lifetime_estimate(&self, mode_candidate: &ModeCandidate<'_>) -> LifetimeEstimate {
        let ([linear, linear_square], [angular, angular_square]) = (
            mode_candidate.prediction_error.linear,
            mode_candidate.prediction_error.angular,
        );
        let mut still = Shares::of([linear, angular], self.units.still);
        if mode_candidate.predictor != Predictor::Rest {
            // What strays is measured against one that begins at the true ones.
            let twist = mode_candidate.frame.truth.twist();
            still = still + Shares::of([twist.linear, twist.angular], self.units.moving);
        }
        LifetimeEstimate {
            still,
            square: Shares::of([linear_square, angular_square], self.units.still),
            lasts: mode_candidate.lasts,
        }
    }

    /// For how many ticks a track holds that begins at a place with these velocities beyond the implied ones.
    pub(super) fn lifetime(
        &self,
        mode_candidate: &ModeCandidate<'_>,
        lifetime_estimate: &LifetimeEstimate,
        place: &CorrectedPose,
        velocity: Option<&VelocityResidual>,
    ) -> f64 {
        let known = match self.subject.ahead {
            [] => 0.0,
            _ => match self.known(
                mode_candidate,
                &place.begun(mode_candidate, velocity, self.grid),
            ) {
                KnownLifetime::Breaks(ticks) => return ticks,
                KnownLifetime::Keyframe(ticks) => ticks,
            },
        };
        let mut rate = lifetime_estimate.still;
        if mode_candidate.predictor != Predictor::Rest {
            rate = rate - place.implies;
            if let Some(velocity) = velocity {
                let VelocityResidual {
                    linear, angular, ..
                } = *velocity;
                let doubled = f64::from(1_u32 << (velocity.velocity_exponent & 31));
                rate = rate - Shares::of_steps(linear, angular, self.units.velocities) * doubled;
            }
        }
        let at = self.beyond(&rate, &lifetime_estimate.square, &place.off, 1.0);
        f64::max(at.min(lifetime_estimate.lasts), known) + self.unseen()
    }

    /// How a track suits what lookahead knows.
    fn known(&self, mode_candidate: &ModeCandidate<'_>, begun: &Motion) -> KnownLifetime {
        let (subject, tracks) = (self.subject, self.chooser.tracks);
        let publish_interval = tracks.publish_interval().get();
        let mut attached = 0.0;
        let spoken_of = (1..)
            .zip(subject.ahead)
            .filter(|(ticks, _)| ticks % publish_interval == 0);
        for (ticks, then) in spoken_of {
            let (slot, ticks_on) = (subject.slot, Ticks::new(ticks));
            let mut motion = tracks.predicted_after(
                slot,
                mode_candidate.predictor,
                begun,
                subject.tick,
                ticks_on,
            );
            if let Some(parent_candidate) = mode_candidate.frame.parent_candidate
                && let Some(by) = parent_candidate.ahead.get(ticks as usize - 1)
            {
                motion = attached_motion(by, &motion.pose());
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
                return KnownLifetime::Breaks(
                    attached + f64::from(publish_interval) * (1.0 - half),
                );
            }
            attached = f64::from(ticks);
        }
        KnownLifetime::Keyframe(attached)
    }

    /// The tick at which a body that begins so far off and strays so is expected to be off by so much of its tolerance.
    #[inline]
    fn beyond(&self, rate: &Shares, square: &Shares, off: &Shares, most: f64) -> f64 {
        let (mut at, mut before) = (0.0, self.units.both(off));
        for look in LOOKS {
            let diverged = *rate * look + *square * (look * look) - *off;
            let share = self.units.both(&diverged) + self.error_growth * look;
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
        lifetime_estimate: &LifetimeEstimate,
        off: &Shares,
        implies: Option<Shares>,
    ) -> f64 {
        let rate = implies.map_or(lifetime_estimate.still, |implies| {
            lifetime_estimate.still - implies
        });
        let at = self.beyond(&rate, &lifetime_estimate.square, off, 1.0 + ROUGHLY);
        at.min(lifetime_estimate.lasts) + self.unseen()
    }

    /// How much longer a track stands once it does not hold any more: until the next tick that is spoken of, or a tick. Twice
    /// as much served the ball pit at every sixth tick a hundredth better, and asteroids at every other one worse.
    fn unseen(&self) -> f64 {
        f64::from((self.chooser.tracks.publish_interval().get() - 1).max(1))
    }
}
