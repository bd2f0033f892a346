//! The decision without lookahead: one correction for each mode.
//!
//! Without known ticks nothing is searched. The modes of one frame share the correction at the published tick and its
//! cost, so that a mode adds its form and its lifetime alone.

use rhumb_reckoning::{Predictor, Residual, VelocityResidual};

use super::candidates::{
    ACCELERATED, ATTACHED, Attached, FALLING, FLOATING, Prediction, REST, WorldModes,
};
use super::cost::{Beside, Cost, NEAREST, Settings, VELOCITY_EXPONENTS};
use super::forecast::{Errors, Expectation, apart};
use super::recent::{Context, FallGrowth, Growth, RecentMotion};

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
pub(super) fn cheapest<T>(
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
        let rounding = if settings.features.sparse {
            SPARSE
        } else {
            NEAREST
        };
        let now = now * units.still;
        let residual = units.residual(&now, rounding);
        Self {
            now,
            residual,
            at_once: units.of_residual(&residual),
            bits: Cost::of_place(&residual),
        }
    }
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
