//! The mode decision: which update corrects a track best.
//!
//! Only the publisher decides, so that nothing here is normative. Every decision keeps the tolerance, and a good one
//! needs fewer bytes. Three stages:
//!
//! 1. *Candidates*: the prediction modes that apply (rest, uniform, falling, attached, accelerated), each with its
//!    error forecast. The forecast of the uncorrected prediction comes from the lookahead or from recent prediction errors.
//! 2. *Cost*: bits of a correction per tick of its expected lifetime.
//! 3. *Refinement*: the residual of least cost. The result is then quantised and checked as a subscriber computes it.

mod acceleration;
mod attached;
mod candidates;
mod cost;
mod errors;
mod forecast;
mod modes;
mod ranking;
mod recent;
mod refinement;
mod shortlist;
mod single_pass;
mod subject;

use rhumb_reckoning::{Anchor, Predictor, Residual, Seconds, TRACK_AGE_MAX, Ticks, Track};

use super::features::Features;
use crate::packet::{Age, UpdatePayload};
use candidates::Candidates;
use errors::Units;
use forecast::Expectation;
use modes::Prediction;
use ranking::Settings;
use refinement::refined;
use single_pass::cheapest;
pub(crate) use subject::{Context, Parent, Subject, share};

/// Expected error growth over a lifetime as long as that of the present track, as a share of the tolerance.
const ERROR_GROWTH_PER_LIFETIME: f64 = 0.1;
/// Least and greatest error growth per tick, as a share of the tolerance.
const ERROR_GROWTH: [f64; 2] = [0.001, 0.05];

/// Age of a moving track from which the lookahead is ignored: its errors grow beyond the lookahead, and past ticks tell
/// more.
const LONG_LIVED: Ticks = Ticks::new(12);

/// The mode decision of one publisher.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ModeDecision<'a> {
    context: Context<'a>,
}

impl<'a> ModeDecision<'a> {
    pub(crate) const fn new(context: Context<'a>) -> Self {
        Self { context }
    }

    /// The cheapest correction that keeps the tolerance, with its track; `None` if the body needs a keyframe.
    pub(crate) fn decide(&self, subject: &Subject<'_>) -> Option<(UpdatePayload, Track)> {
        let track = subject.track;
        let ticks = subject.tick.since(track.origin)?;
        let aged = ticks > TRACK_AGE_MAX && track.predictor != Predictor::Rest;
        let age = self.context.tracks.age(track, subject.tick)?;
        if age == Age::new(0) || aged || !self.context.features.residuals {
            return None;
        }
        let over = track
            .predictor
            .divergence_time(ticks, self.context.tracks.integrator().rate);
        let update = UpdateConditions {
            context: &self.context,
            subject,
            age,
            over,
        };
        let settings = self.settings(subject, ticks, &update);
        let is_long_lived = ticks >= LONG_LIVED && track.predictor != Predictor::Rest;
        if subject.ahead.is_empty() || is_long_lived || !self.context.features.mode_decision {
            let update_of =
                |prediction: &Prediction<'_>, residual: &Residual| update.of(prediction, residual);
            return cheapest(&self.context, subject, &settings, update_of);
        }
        let candidates = Candidates::new(&self.context, subject, &settings.expectation.units);
        let best = refined(&settings, &candidates);
        best.iter()
            .find_map(|choice| update.of(&candidates.prediction(choice.mode)?, &choice.residual))
    }

    /// The decision without lookahead, and with the full tolerance where that is tightened.
    pub(crate) fn widened(&self) -> Self {
        Self::new(Context {
            features: Features {
                mode_decision: false,
                ..self.context.features
            },
            slack: self.context.slack.max(1.0),
            ..self.context
        })
    }

    /// The parameters of the search for a body whose track has this age.
    fn settings(
        &self,
        subject: &Subject<'_>,
        ticks: Ticks,
        update: &UpdateConditions<'_>,
    ) -> Settings {
        let tracks = self.context.tracks;
        let step = tracks.integrator().rate.step().seconds();
        let [least, most] = ERROR_GROWTH;
        Settings {
            expectation: Expectation {
                units: Units::new(
                    tracks.tolerance_of(subject.slot),
                    tracks.radius(subject.slot),
                    self.context.slack,
                    tracks.grid(subject.slot),
                    step,
                ),
                // The error of a body with a long-lived track, such as a flying body, is expected to grow slowly.
                growth: (ERROR_GROWTH_PER_LIFETIME / f64::from(ticks.count())).clamp(least, most),
                interval: tracks.publish_interval().get() as usize,
            },
            features: self.context.features,
            age: update.age,
            rate: step / update.over.seconds(),
        }
    }
}

/// The inputs for turning a choice into an update.
#[derive(Clone, Copy, Debug)]
struct UpdateConditions<'u> {
    context: &'u Context<'u>,
    subject: &'u Subject<'u>,
    age: Age,
    /// Time over which the prediction diverged.
    over: Seconds,
}

impl UpdateConditions<'_> {
    /// The update and the track of a choice, as a subscriber computes them; `None` if they break the tolerance or a
    /// limit.
    fn of(
        &self,
        prediction: &Prediction<'_>,
        residual: &Residual,
    ) -> Option<(UpdatePayload, Track)> {
        let (subject, tracks) = (self.subject, self.context.tracks);
        let grid = tracks.grid(subject.slot);
        let quantised = residual.onto(prediction.motion, self.over, grid);
        let begun = quantised.motion(grid);
        let pose = prediction.in_world(&begun.pose());
        let (tolerance, radius) = (
            tracks.tolerance_of(subject.slot),
            tracks.radius(subject.slot),
        );
        let used = share(&subject.truth.pose(), &pose, tolerance, radius);
        let keeps = used <= self.context.slack.max(1.0);
        if !keeps || !residual.is_within_limits() {
            return None;
        }
        Some((
            UpdatePayload::Residual {
                mode: prediction.mode,
                age: self.age,
                residual: *residual,
            },
            Track {
                origin: subject.tick,
                predictor: prediction.predictor,
                anchor: Anchor::Quantised(if prediction.moves() {
                    quantised
                } else {
                    quantised.stilled()
                }),
                parent: prediction.parent.map(|parent| parent.slot.id(parent.index)),
            },
        ))
    }
}
