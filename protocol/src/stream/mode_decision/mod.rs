//! The mode decision: which update corrects a track best, for how long and for how many bits.
//!
//! Only the publisher decides, so that nothing here is normative: any decision keeps the promise, a good one keeps it with fewer
//! bytes. Three stages:
//!
//! 1. *Candidates*: the prediction modes that apply (rest, uniform, falling, attached, accelerated), each with its error forecast: how far
//!    off the uncorrected prediction will be, from what lookahead knows or from how the body diverged lately.
//! 2. *Cost*: bits of a correction over the ticks that it is expected to hold.
//! 3. *Refinement*: the residual of least cost. What is chosen is then put on the grid and checked as a subscriber computes it.

mod acceleration;
mod candidates;
mod cost;
mod errors;
mod forecast;
mod refinement;

use rhumb_reckoning::{
    Anchor, Divergence, Metres, Motion, Pose, Predictor, Seconds, TRACK_AGE_MAX, Tick, Ticks,
    Tolerance, Track,
};

use super::features::Features;
use super::tracks::{Slot, Tracks};
use crate::packet::{Age, UpdatePayload};
use candidates::{Candidate, Candidates};
use errors::Units;
use forecast::{Expectation, SPAN};
use refinement::{Choice, Refinement, Settings};

/// What is known of a body that needs an update.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Subject<'a> {
    pub(crate) index: u32,
    pub(crate) slot: &'a Slot,
    /// The track that no longer holds.
    pub(crate) track: &'a Track,
    /// The published tick.
    pub(crate) tick: Tick,
    /// The body's motion then, and the predicted one.
    pub(crate) truth: Motion,
    pub(crate) predicted_motion: Motion,
    /// Its motion one and two ticks before.
    pub(crate) last: [Option<Motion>; 2],
    /// Its motion one and two strides before.
    pub(crate) past: [Option<Motion>; 2],
    /// Ticks between two observations before the published tick.
    pub(crate) stride: Ticks,
    /// Its motions in the next ticks, as far as lookahead knows.
    pub(crate) ahead: &'a [Motion],
    /// Whether it is known that nothing is seen of it after that.
    pub(crate) ends: bool,
    /// The body that it may be attached to.
    pub(crate) parent: Option<Parent<'a>>,
}

/// A body that another may be attached to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Parent<'a> {
    pub(crate) index: u32,
    pub(crate) slot: &'a Slot,
    /// Its motion at the published tick.
    pub(crate) truth: Motion,
    /// Its motion one and two strides of the child before.
    pub(crate) past: [Option<Motion>; 2],
    /// Its motions in the next ticks.
    pub(crate) ahead: &'a [Motion],
}

/// What the ticks of a track's whole life add to the expected error of the next, as a share of the tolerance …
const ERROR_GROWTH_PER_LIFETIME: f64 = 0.1;
/// … and each tick, at least and at most.
const DOUBT: [f64; 2] = [0.001, 0.05];

/// A body whose track held for so many ticks flies: lookahead ends before it strays, and its last ticks tell more.
const FLIGHT: Ticks = Ticks::new(12);

/// Decides for one publisher.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ModeDecision<'a> {
    pub(crate) tracks: &'a Tracks,
    pub(crate) features: Features,
    /// Factor on the tolerances by which lifetimes are estimated: more than one where a budget does not suffice, less for
    /// bodies that others are attached to.
    pub(crate) slack: f64,
}

impl ModeDecision<'_> {
    /// The best correction among those that keep the promise, with the track that it leads to; `None` where a keyframe is needed.
    pub(crate) fn decide(&self, subject: &Subject<'_>) -> Option<(UpdatePayload, Track)> {
        let track = subject.track;
        let ticks = subject.tick.since(track.origin)?;
        let aged = ticks > TRACK_AGE_MAX && track.predictor != Predictor::Rest;
        let age = self.tracks.age(track, subject.tick)?;
        if age == Age::new(0) || aged || !self.features.residuals {
            return None;
        }
        let over = track
            .predictor
            .divergence_time(ticks, self.tracks.integrator().rate);
        let update = Update {
            decision: self,
            subject,
            age,
            over,
        };
        let flies = ticks >= FLIGHT && track.predictor != Predictor::Rest;
        if subject.ahead.is_empty() || flies || !self.features.mode_decision {
            self.decide_within::<1>(&update, ticks)
        } else {
            self.decide_within::<SPAN>(&update, ticks)
        }
    }

    /// The same without lookahead, and by the promised tolerance where that is tightened.
    pub(crate) fn widened(&self) -> Self {
        Self {
            features: Features {
                mode_decision: false,
                ..self.features
            },
            slack: self.slack.max(1.0),
            ..*self
        }
    }

    /// The same where at most so many ticks are known, the published one included.
    fn decide_within<const N: usize>(
        &self,
        update: &Update<'_>,
        ticks: Ticks,
    ) -> Option<(UpdatePayload, Track)> {
        let (subject, age) = (update.subject, update.age);
        let rate = self.tracks.integrator().rate;
        let (tolerance, radius) = (
            self.tracks.tolerance_of(subject.slot),
            self.tracks.radius(subject.slot),
        );
        let step = rate.step().seconds();
        let units = Units::new(
            tolerance,
            radius,
            self.slack,
            self.tracks.grid(subject.slot),
            step,
        );
        let candidates = Candidates::<N>::new(self, subject, &units);
        let interval = self.tracks.publish_interval().get();
        let [least, most] = DOUBT;
        let settings = Settings {
            expectation: Expectation {
                units,
                // A track that held for long, as of a flying body, is expected to stray less.
                growth: (ERROR_GROWTH_PER_LIFETIME / f64::from(ticks.count())).clamp(least, most),
                interval: interval as usize,
            },
            features: self.features,
            age,
            rate: step / update.over.seconds(),
            looks_ahead: N > 1,
        };
        let mut refinement = Refinement::new(&settings);
        let modes = candidates.modes();
        for (number, mode) in modes.iter().enumerate() {
            if let Some(mode) = mode {
                refinement.consider(number, mode, &candidates.velocity);
            }
        }
        let choices = refinement.finish(&modes, &candidates.velocity);
        choices
            .iter()
            .find_map(|choice| update.of(modes[choice.mode].as_ref()?, choice))
    }
}

/// Makes an update of a choice.
#[derive(Clone, Copy, Debug)]
struct Update<'u> {
    decision: &'u ModeDecision<'u>,
    subject: &'u Subject<'u>,
    age: Age,
    /// In what time the prediction diverged.
    over: Seconds,
}

impl Update<'_> {
    /// What a choice leads to, as a subscriber computes it, if that keeps the promise.
    fn of(&self, candidate: &Candidate<'_>, choice: &Choice) -> Option<(UpdatePayload, Track)> {
        let (subject, tracks) = (self.subject, self.decision.tracks);
        let grid = tracks.grid(subject.slot);
        let residual = choice.residual;
        let quantised = residual.onto(&candidate.base.predicted, self.over, grid);
        let begun = quantised.motion(grid);
        let pose = candidate
            .base
            .in_world(self.decision, subject, &begun.pose());
        let (tolerance, radius) = (
            tracks.tolerance_of(subject.slot),
            tracks.radius(subject.slot),
        );
        let used = share(&subject.truth.pose(), &pose, tolerance, radius);
        let keeps = used <= self.decision.slack.max(1.0);
        if !keeps || !residual.is_within_limits() {
            return None;
        }
        let rests = candidate.predictor == Predictor::Rest;
        let parent = candidate.base.parent;
        Some((
            UpdatePayload::Residual {
                mode: candidate.mode,
                age: self.age,
                residual,
            },
            Track {
                origin: subject.tick,
                predictor: candidate.predictor,
                anchor: Anchor::Quantised(if rests {
                    quantised.stilled()
                } else {
                    quantised
                }),
                parent: parent.map(|parent| parent.slot.id(parent.index)),
            },
        ))
    }
}

/// How much of the tolerance lies between two poses of a body.
pub(crate) fn share(
    truth: &Pose,
    predicted_motion: &Pose,
    tolerance: Tolerance,
    radius: Metres,
) -> f64 {
    tolerance.share(&Divergence::between(truth, predicted_motion), radius)
}
