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
//!
//! Without lookahead there is one correction for each mode, and nothing is searched. The modes of one frame share the
//! correction at the published tick and its cost, so that a mode adds its form and its lifetime alone.

mod candidates;
mod forecast;
mod recent;

use rhumb_reckoning::{
    Anchor, Predictor, Residual, Seconds, TRACK_AGE_MAX, Ticks, Track, VelocityResidual,
};

use self::candidates::{
    ACCELERATED, ATTACHED, Attached, Candidates, FALLING, FLOATING, Prediction, REST, WorldModes,
};
use self::candidates::{Beside, CorrectionRanker, Cost, NEAREST, Settings, VELOCITY_EXPONENTS};
use self::forecast::{Errors, Expectation, Units, apart};
use self::recent::{FallGrowth, Growth, RecentMotion};
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

/// Rounding of a correction without velocities: a smaller fraction of a step is dropped, because the tolerance hardly
/// needs it.
const SPARSE: [f64; 2] = [0.6; 2];
/// Ticks after which the expected errors of the modes are compared.
const COMPARED_TICKS: f64 = 3.0;
/// Hardly any velocities cost less than this, in 1/256 bits.
const VELOCITY_BITS: u32 = 8 * 256;
/// Share of the tolerance that rounded velocities may add to a component of the error within a lifetime.
const ROUNDING: f64 = 0.5;
/// The moving modes in the world.
const MOVING: [usize; 4] = [FLOATING, FALLING, ACCELERATED, ACCELERATED + 1];

/// Expected growth of an error in one mode, as shares of the tolerance.
#[derive(Clone, Copy, Debug)]
struct Course {
    slope: Errors,
    curve: Errors,
    /// Greatest expected duration of the mode, in ticks.
    lasts: f64,
}

/// A correction at the published tick; all modes of one frame share it.
#[derive(Clone, Copy, Debug)]
struct Start {
    /// The error before it.
    now: Errors,
    residual: Residual,
    at_once: Errors,
    /// Its cost without the form.
    bits: u32,
}

/// A correction of one mode.
#[derive(Clone, Copy, Debug)]
struct Priced<'p> {
    price: f64,
    mode: usize,
    residual: &'p Residual,
}

/// One body without known ticks.
struct SinglePass<'s> {
    settings: &'s Settings,
    modes: WorldModes<'s>,
    /// True if the body leaves the stream after this tick.
    ends: bool,
    /// Growth of the error without an acceleration, but for the error of the velocities, and what an acceleration of
    /// 1 m/s² takes off.
    free: Course,
    falls: FallGrowth,
    /// Difference of the true and the predicted velocities, per tick.
    velocity: Errors,
}

/// Finds the cheapest correction that `accept` turns into a result. It gets a mode and a residual, the cheapest first.
fn cheapest<T>(
    context: &Context<'_>,
    recent: &RecentMotion<'_>,
    settings: &Settings,
    accept: impl Fn(&Prediction<'_>, &Residual) -> Option<T>,
) -> Option<T> {
    let (subject, units) = (recent.subject, &settings.expectation.units);
    let modes = WorldModes::new(context, subject, units);
    if modes.orphaned {
        return None;
    }
    let (growth, falls) = recent.of_unaccelerated(modes.floating);
    let pass = SinglePass {
        settings,
        modes,
        ends: subject.ends && subject.ahead.is_empty(),
        free: Course::new(settings, &growth),
        falls,
        velocity: subject.velocity_error() * units.moving,
    };
    let now = apart(&subject.truth.pose(), &subject.predicted_motion.pose());
    let world = Start::new(settings, now);
    let attached = Attached::new(context, subject).filter(|it| it.moves_along(units));
    let of_parent = attached.as_ref().map(|it| Start::new(settings, it.now));
    let mut choices = [Priced {
        price: f64::INFINITY,
        mode: REST,
        residual: &world.residual,
    }; 4];
    choices[0].price = pass.rest(recent, &world).unwrap_or(f64::INFINITY);
    let steadiest = pass.steadiest();
    // The track's own moving mode is worth keeping; only a track without one changes to the steadiest.
    let moving = pass.modes.own_moving().or(steadiest);
    if let Some(mode) = moving.filter(|_| settings.features.derived)
        && let Some((prediction, course)) = pass.moving(mode)
    {
        (choices[1].price, choices[1].mode) = (pass.price(&world, &prediction, &course), mode);
    }
    if let (Some(attached), Some(start)) = (&attached, &of_parent) {
        let course = Course::new(settings, &attached.growth);
        choices[2] = Priced {
            price: pass.price(start, &attached.prediction(), &course),
            mode: ATTACHED,
            residual: &start.residual,
        };
    }
    let limit = choices
        .iter()
        .fold(f64::INFINITY, |least, choice| least.min(choice.price));
    let hastened = steadiest.and_then(|mode| {
        let (residual, price) = pass.with_velocities(&world, mode, limit)?;
        Some((mode, residual, price))
    });
    if let Some((mode, residual, price)) = &hastened {
        choices[3] = Priced {
            price: *price,
            mode: *mode,
            residual,
        };
    }
    first_accepted(&mut choices, |mode, residual| {
        let prediction = match (mode, &attached) {
            (ATTACHED, Some(attached)) => attached.prediction(),
            _ => pass.modes.prediction(mode)?,
        };
        accept(&prediction, residual)
    })
}

/// Tries the corrections in order of their prices, until one is accepted.
fn first_accepted<T>(
    choices: &mut [Priced<'_>],
    accept: impl Fn(usize, &Residual) -> Option<T>,
) -> Option<T> {
    loop {
        let by_price = |a: &&mut Priced<'_>, b: &&mut Priced<'_>| a.price.total_cmp(&b.price);
        let best = choices.iter_mut().min_by(by_price)?;
        if best.price == f64::INFINITY {
            return None;
        }
        let accepted = accept(best.mode, best.residual);
        if accepted.is_some() {
            return accepted;
        }
        best.price = f64::INFINITY;
    }
}

impl Course {
    fn new(settings: &Settings, growth: &Growth) -> Self {
        let still = settings.expectation.units.still;
        Self {
            slope: growth.slope * still,
            curve: growth.curve * still,
            lasts: f64::INFINITY,
        }
    }
}

impl Start {
    /// `now`: the error of the uncorrected prediction, metres and radians.
    fn new(settings: &Settings, now: Errors) -> Self {
        let units = &settings.expectation.units;
        let now = now * units.still;
        let residual = rounded(settings, &now);
        Self {
            now,
            residual,
            at_once: units.of_residual(&residual),
            bits: Cost::of_place(&residual),
        }
    }
}

/// The correction of an error at once, in few steps.
fn rounded(settings: &Settings, now: &Errors) -> Residual {
    let rounding = if settings.features.sparse {
        SPARSE
    } else {
        NEAREST
    };
    settings.expectation.units.residual(now, rounding)
}

impl SinglePass<'_> {
    /// The price of the shared correction of a body that rests from now on. `None` for a body that cannot.
    fn rest(&self, recent: &RecentMotion<'_>, world: &Start) -> Option<f64> {
        let (subject, units) = (recent.subject, &self.expectation().units);
        let rests = subject.track.parent.is_none() && subject.track.predictor == Predictor::Rest;
        // A body that moves by the tolerance or more in each tick does not rest.
        let stride = f64::from(subject.stride.count());
        let is_slow = || units.share(&(recent.moved[0] * units.still)) <= stride;
        if !self.settings.features.resting || !rests && !is_slow() {
            return None;
        }
        let course = Course::new(self.settings, &recent.of_rest());
        Some(self.price(world, &self.modes.prediction(REST)?, &course))
    }

    /// The expected growth of the error in a moving mode, but for the error of the velocities. `None` if the mode does
    /// not apply.
    fn course(&self, mode: usize) -> Option<Course> {
        let (acceleration, lasts) = self.modes.acceleration(mode)?;
        let each = Errors::of_position(acceleration, self.expectation().units.still);
        Some(Course {
            slope: self.free.slope - each * self.falls.slope,
            curve: self.free.curve - each * self.falls.curve,
            lasts,
        })
    }

    /// A moving mode and its expected growth of the error.
    fn moving(&self, mode: usize) -> Option<(Prediction<'_>, Course)> {
        let course = self.course(mode)?;
        let slope = course.slope + self.velocity;
        Some((self.modes.prediction(mode)?, Course { slope, ..course }))
    }

    /// The moving mode with the least recent prediction error.
    fn steadiest(&self) -> Option<usize> {
        let mut least = (None, f64::INFINITY);
        for mode in MOVING {
            let Some(Course { slope, curve, .. }) = self.course(mode) else {
                continue;
            };
            let errors = slope * COMPARED_TICKS + curve * (COMPARED_TICKS * COMPARED_TICKS);
            let share = self.expectation().units.share(&errors);
            if share < least.1 {
                least = (Some(mode), share);
            }
        }
        least.0
    }

    fn expectation(&self) -> &Expectation {
        &self.settings.expectation
    }

    fn cost(&self, prediction: &Prediction<'_>) -> Cost {
        Cost::new(prediction.mode, self.settings.age, Beside::default())
    }

    /// The price of the shared correction in a mode.
    fn price(&self, start: &Start, prediction: &Prediction<'_>, course: &Course) -> f64 {
        let each_tick = if prediction.moves() {
            start.at_once * self.settings.rate
        } else {
            Errors::ZERO
        };
        let lifetime = self.lifetime(start.now - start.at_once, course, each_tick);
        let cost = self.cost(prediction);
        cost.price(cost.of_form(false) + start.bits, lifetime)
    }

    /// The price of a moving mode's correction with velocities, and that correction. `None` if the price surely exceeds
    /// the limit.
    fn with_velocities(&self, world: &Start, mode: usize, limit: f64) -> Option<(Residual, f64)> {
        let (prediction, course) = self.moving(mode)?;
        let (units, cost) = (&self.expectation().units, self.cost(&prediction));
        let residual = units.residual(&world.now, NEAREST);
        let at_once = units.of_residual(&residual);
        let left = world.now - at_once;
        // No correction with velocities outlives one with the true velocities.
        let longest = self.lifetime(left, &course, self.velocity);
        let form = cost.of_form(true);
        if cost.price(form + world.bits + VELOCITY_BITS, longest) >= limit {
            return None;
        }
        let implied = at_once * self.settings.rate;
        let too_coarse = |exponent: &u32| units.rounding(*exponent) * longest > ROUNDING;
        let mut exponents = self.settings.features.steps(VELOCITY_EXPONENTS);
        let exponent = exponents.find(|exponent| *exponent == 0 || !too_coarse(exponent))?;
        let velocity: VelocityResidual = units.velocity(&(self.velocity - implied), exponent);
        if !velocity.is_within_limits() {
            return None;
        }
        let bits = form + Cost::of_place(&residual) + cost.of_velocity(&velocity);
        let each_tick = implied + units.of_velocity(&velocity);
        let price = cost.price(bits, self.lifetime(left, &course, each_tick));
        let velocity = Some(velocity);
        Some((
            Residual {
                velocity,
                ..residual
            },
            price,
        ))
    }

    /// The expected lifetime in ticks of a correction that leaves an error, and takes some off in each tick; zero if it
    /// does not hold.
    fn lifetime(&self, left: Errors, course: &Course, each_tick: Errors) -> f64 {
        if self.ends {
            return 1.0;
        }
        let expectation = self.expectation();
        let beyond = expectation.ticks_within(left, course.slope - each_tick, &course.curve);
        beyond.map_or(0.0, |beyond| {
            1.0 + beyond.min(course.lasts) + expectation.unobserved()
        })
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
