//! The mode decision: which update corrects a track best.
//!
//! Only the publisher decides, so that nothing here is normative. Every decision keeps the tolerance, and a good one
//! needs fewer bytes. Three stages:
//!
//! 1. *Candidates*: the prediction modes that apply (rest, uniform, falling, attached, accelerated), each with its
//!    error forecast. The forecast of the uncorrected prediction comes from the lookahead or from recent prediction
//!    errors.
//! 2. *Cost*: bits of a correction per tick of its expected lifetime.
//! 3. *Refinement*: the residual of least cost. With lookahead, the search starts at the residuals that fit the known
//!    ticks best, and removes steps while that lowers the price; the best ones of each candidate are priced together
//!    with their next correction. The result is then quantised and checked as a subscriber computes it.

mod candidates;
mod cost;
mod forecast;
mod recent;
mod single_pass;

use candidates::{Candidates, Prediction};
use cost::{CorrectionRanker, NEAREST, Settings};
use forecast::{Expectation, Units};
use recent::RecentMotion;
use rhumb_reckoning::{Anchor, Predictor, Residual, Seconds, TRACK_AGE_MAX, Ticks, Track};
use single_pass::cheapest;

use super::Features;
use crate::packet::{Age, UpdatePayload};

pub(crate) use recent::{Context, Parent, Subject, share};

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
        let settings = self.settings(subject, ticks, age, over);
        let units = &settings.expectation.units;
        let recent = RecentMotion::new(&self.context, subject, units);
        let update = UpdateConditions {
            context: &self.context,
            subject,
            age,
            over,
            units,
            recent: &recent,
        };
        let is_long_lived = ticks >= LONG_LIVED && track.predictor != Predictor::Rest;
        if subject.ahead.is_empty() || is_long_lived || !self.context.features.mode_decision {
            let update_of =
                |prediction: &Prediction<'_>, residual: &Residual| update.of(prediction, residual);
            return cheapest(&self.context, &recent, &settings, update_of);
        }
        let candidates = Candidates::new(&self.context, &recent, &settings.expectation.units);
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
    fn settings(&self, subject: &Subject<'_>, ticks: Ticks, age: Age, over: Seconds) -> Settings {
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
            age,
            rate: step / over.seconds(),
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
    units: &'u Units,
    recent: &'u RecentMotion<'u>,
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
        if prediction.moves() && !self.recent.may_have(&begun.twist(), self.units) {
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

/// Numbers of known ticks that residuals without velocities are fitted to.
const FITS: [usize; 5] = [0, 1, 2, 4, 6];
/// Numbers of known ticks that residuals with velocities are fitted to, by a straight line.
const LINES: [usize; 3] = [2, 4, 6];

/// The best corrections of a body, the cheapest first.
fn refined(settings: &Settings, candidates: &Candidates<'_>) -> BestCorrections {
    let mut all = BestCorrections::default();
    for mode in candidates.modes() {
        let Some(ranker) = CorrectionRanker::new(settings, candidates, mode) else {
            continue;
        };
        for choice in best_of(settings, mode, &ranker).iter() {
            let price = ranker.price_with_next(&choice.residual);
            all.note(Choice { price, ..*choice });
        }
    }
    all
}

/// The best corrections of one candidate, without their next corrections.
fn best_of(settings: &Settings, mode: usize, ranker: &CorrectionRanker<'_>) -> BestCorrections {
    let (forecast, units) = (&ranker.forecast, &ranker.expectation.units);
    let moves = ranker.rate > 0.0;
    let mut best = BestCorrections::default();
    let mut note = |residual, price| {
        best.note(Choice {
            mode,
            residual,
            price,
        });
    };
    if !moves || settings.features.derived {
        for fit in FITS.into_iter().take_while(|fit| *fit <= forecast.last()) {
            let residual = units.residual(&forecast.nearest(fit, ranker.rate), NEAREST);
            let price = ranker.price(&residual);
            note(residual, price);
            if settings.features.sparse {
                ranker.leave_out_steps((residual, price), &mut note);
            }
        }
    }
    let lines = if moves { &LINES[..] } else { &[] };
    for line in lines
        .iter()
        .copied()
        .take_while(|line| *line < forecast.last())
    {
        let [begin, slope] = forecast.line(line);
        let residual = units.residual(&begin, NEAREST);
        let at_once = units.of_residual(&residual);
        let nearest = forecast.slope_from(line, &at_once);
        for slope in [slope, nearest] {
            ranker.with_velocities(settings, &residual, &slope, &mut note);
        }
    }
    best
}

/// Number of corrections that are kept: with lookahead they are priced with their next correction.
const SHORTLIST: usize = 3;

/// A correction, and its price in 1/256 bits per tick.
#[derive(Clone, Copy, Debug)]
struct Choice {
    /// Number of the prediction mode.
    mode: usize,
    residual: Residual,
    price: f64,
}

/// The best corrections so far, the cheapest first, without duplicates.
#[derive(Clone, Copy, Debug, Default)]
struct BestCorrections {
    choices: [Option<Choice>; SHORTLIST],
}

impl BestCorrections {
    fn iter(&self) -> impl Iterator<Item = &Choice> {
        self.choices.iter().flatten()
    }

    /// Inserts a correction if it is among the best.
    fn note(&mut self, choice: Choice) {
        let mut at = 0;
        for other in self.choices.iter().flatten() {
            if other.price > choice.price {
                break;
            }
            let same = other.price == choice.price && other.mode == choice.mode;
            if same && other.residual == choice.residual {
                return;
            }
            at += 1;
        }
        if at < SHORTLIST && choice.price.is_finite() {
            self.choices.copy_within(at..SHORTLIST - 1, at + 1);
            self.choices[at] = Some(choice);
        }
    }
}

#[cfg(test)]
mod tests {
    use alloc::vec::Vec;

    use glam::{DVec3, Vec3};
    use proptest::array::uniform3;
    use proptest::prelude::*;
    use rhumb_reckoning::{BodyId, BodyState, Grid, Metres, Tick, Tolerance, Twist};

    use super::*;
    use crate::packet::StreamId;
    use crate::scene::PublishSchedule;
    use crate::stream::StreamConfig;
    use crate::stream::observation_history::{Activity, Observation, ObservationHistory};
    use crate::stream::publisher::Publisher;
    use crate::stream::tracks::PredictionParameters;

    const BODY: BodyId = BodyId::new(4, 0);
    const RADIUS: Metres = Metres::new(0.5);
    const STEP_S: f32 = 1.0 / 60.0;

    /// One body whose observations are published at each tick.
    struct Stage {
        publisher: Publisher,
        history: ObservationHistory,
        tick: Tick,
        position: Vec3,
        /// The velocity by which it moves, m/s.
        velocity: Vec3,
        /// The velocity that the engine reports of it, m/s.
        reported: Vec3,
    }

    impl Stage {
        /// The body begins with this predictor.
        fn new(predictor: Predictor, velocity: Vec3) -> Self {
            let mut publisher = Publisher::new(StreamId(0), &StreamConfig::PLAIN, Tick::ZERO);
            let track = Track {
                origin: Tick::ZERO,
                predictor,
                anchor: Anchor::Exact(state(Vec3::ZERO, velocity)),
                parent: None,
            };
            assert!(publisher.place(BODY, &PredictionParameters::plain(RADIUS), track));
            Self {
                publisher,
                history: ObservationHistory::new(PublishSchedule::EACH_TICK),
                tick: Tick::ZERO,
                position: Vec3::ZERO,
                velocity,
                reported: velocity,
            }
        }

        /// Publishes the next tick, in which the body moves and then jumps; returns the velocities of its track.
        fn step(&mut self, jump: Vec3) -> Twist {
            self.tick = self.tick.next();
            self.position += self.velocity * STEP_S + jump;
            let observation = Observation {
                id: BODY,
                motion: state(self.position, self.reported),
                activity: Activity::Awake,
            };
            self.history.observe(self.tick, &[observation]);
            self.publisher.publish(&self.history, 0, &mut Vec::new());
            let (_, track) = self.publisher.tracks().next().expect("a body");
            let grid = Grid::new(Tolerance::NORMAL, RADIUS);
            match (track.predictor, track.anchor) {
                (Predictor::Rest, _) => Twist::default(),
                (_, Anchor::Quantised(quantised)) => quantised.twist(&grid),
                (_, Anchor::Exact(exact)) => exact.motion().twist(),
            }
        }

        fn steps(&mut self, ticks: u32) {
            for _ in 0..ticks {
                self.step(Vec3::ZERO);
            }
        }
    }

    fn state(position: Vec3, velocity: Vec3) -> BodyState {
        let upright = [0.0, 0.0, 0.0, 1.0];
        let state = BodyState::new(position.into(), upright, velocity.into(), [0.0; 3]);
        state.expect("it is finite")
    }

    #[test]
    fn a_resting_body_that_jumps_rests_at_its_new_place() {
        for predictor in [Predictor::Rest, Predictor::Uniform] {
            let mut stage = Stage::new(predictor, Vec3::ZERO);
            for (ticks, jump) in [(30, 50.0), (30, 1.0), (1, -0.4), (30, -7.0), (1, 900.0)] {
                stage.steps(ticks);
                for moved in [jump, 0.0, 0.0, 0.0] {
                    let twist = stage.step(Vec3::new(moved, 0.0, moved));
                    assert_eq!(twist, Twist::default(), "{predictor:?}, {jump} m");
                }
            }
        }
    }

    proptest! {
        #[test]
        fn a_moving_body_that_jumps_keeps_its_velocity(
            velocity in uniform3(-20.0_f32..20.0), jump in uniform3(-90.0_f32..90.0), ticks in 2_u32..40,
        ) {
            let (velocity, jump) = (Vec3::from(velocity), Vec3::from(jump));
            let mut stage = Stage::new(Predictor::Uniform, velocity);
            for _ in 0..2 {
                stage.steps(ticks);
                for jump in [jump, Vec3::ZERO, Vec3::ZERO] {
                    let twist = stage.step(jump);
                    // Within a tick it is the tolerance off at most.
                    let off = twist.linear.distance(velocity.as_dvec3()) / 60.0;
                    prop_assert!(off <= 0.05, "{:?} instead of {velocity}", twist.linear);
                    prop_assert!(twist.angular == DVec3::ZERO);
                }
            }
        }
    }

    #[test]
    fn a_body_that_moves_without_velocities_is_predicted_by_its_displacements() {
        let velocity = Vec3::new(30.0, 0.0, 0.0);
        let mut stage = Stage::new(Predictor::Uniform, velocity);
        stage.reported = Vec3::ZERO;
        stage.steps(10);
        let twist = stage.step(Vec3::ZERO);
        assert!(
            twist.linear.distance(velocity.as_dvec3()) < 1.0,
            "{twist:?}"
        );
    }

    fn choice(steps: i32, price: f64) -> Choice {
        let residual = Residual {
            position: [steps, 0, 0],
            ..Residual::default()
        };
        Choice {
            mode: 0,
            residual,
            price,
        }
    }

    proptest! {
        #[test]
        fn the_best_are_kept_in_order_without_duplicates(
            prices in proptest::collection::vec(0_u32..50, 0..40), again in 0_usize..40,
        ) {
            let choices: Vec<_> = (0..)
                .zip(&prices)
                .map(|(steps, price)| choice(steps, f64::from(*price)))
                .collect();
            let mut list = BestCorrections::default();
            for choice in choices.iter().chain(choices.get(again)) {
                list.note(*choice);
            }
            list.note(choice(-1, f64::INFINITY));
            let mut best = prices.clone();
            best.sort_unstable();
            best.truncate(SHORTLIST);
            let kept: Vec<_> = list.iter().collect();
            let kept_prices: Vec<_> = kept.iter().map(|choice| choice.price as u32).collect();
            prop_assert_eq!(kept_prices, best);
            for (place, choice) in kept.iter().enumerate() {
                prop_assert!(kept[..place].iter().all(|other| other.residual != choice.residual));
            }
        }
    }
}
