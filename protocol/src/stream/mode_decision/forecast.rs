//! Prediction errors of a body, their forecast, and the lifetime that follows.
//!
//! No body is predicted here. A correction reduces the error by a constant and, if it implies velocities, by a
//! constant per tick. So one forecast serves all corrections of one mode. These approximate errors only rank
//! corrections; [`Tolerance::share`] decides whether the tolerance holds. Errors of position and of turn lie in the
//! two lanes of one vector, so that one instruction computes both.

use core::ops::{Add, Mul, Sub};

use glam::{DQuat, DVec3};
use rhumb_reckoning::{
    BodyState, Grid, Metres, Pose, RESIDUAL_LIMIT, Residual, TURN_LIMIT, Tolerance, Twist,
    VELOCITY_EXPONENT_MAX, VelocityResidual,
};
use wide::f64x2;

use crate::stream::observation_history::LOOKAHEAD_MAX;

/// Ticks of a forecast: the published tick and those of the lookahead.
pub(super) const SPAN: usize = LOOKAHEAD_MAX.count() as usize + 1;
/// Ticks beyond the known ones at which the expected error is evaluated.
const SAMPLED_TICKS: [f64; 15] = [
    1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 96.0, 128.0, 192.0,
];

/// Reduction of the error by a correction: at once, and additionally per tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct Effect {
    pub(super) at_once: Errors,
    pub(super) each_tick: Errors,
}

/// Errors at the published tick and at the known ticks after it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Known {
    errors: [Errors; SPAN],
    count: usize,
}

impl Known {
    pub(super) const fn new(now: Errors) -> Self {
        let mut errors = [Errors::ZERO; SPAN];
        errors[0] = now;
        Self { errors, count: 1 }
    }

    pub(super) fn push(&mut self, next: Errors) {
        self.errors[self.count] = next;
        self.count += 1;
    }

    pub(super) fn errors(&self) -> &[Errors] {
        &self.errors[..self.count]
    }
}

/// Effect of a constant acceleration on the known errors: its unit reduction, and the factor at each tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct Acceleration<'a> {
    pub(super) each: Errors,
    pub(super) falls: &'a [f64],
}

/// Error of the uncorrected prediction of one mode, by tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct ErrorForecast<'a> {
    /// Errors at the published tick and at the known ticks after it.
    pub(super) known: &'a [Errors],
    pub(super) acceleration: Option<Acceleration<'a>>,
    /// Expected growth beyond the known ticks, per tick.
    pub(super) slope: Errors,
    /// Expected growth beyond the known ticks, per tick squared.
    pub(super) curve: Errors,
    /// True if the body leaves the stream after the last known tick.
    pub(super) ends: bool,
    /// Greatest expected duration of the mode, in ticks.
    pub(super) lasts: f64,
}

/// Parameters of the lifetime estimates of one body.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expectation {
    pub(super) units: Units,
    /// Growth of the expected error per tick, as a share of the tolerance.
    pub(super) growth: f64,
    /// Publish interval, in ticks.
    pub(super) interval: usize,
}

impl Expectation {
    /// Ticks for which an error that begins and grows like this is expected to stay within the tolerance; `None` if it
    /// begins beyond.
    #[inline]
    pub(super) fn ticks_within(&self, begin: Errors, slope: Errors, curve: &Errors) -> Option<f64> {
        let Self { units, growth, .. } = self;
        // The square of the error is a polynomial of the time in ticks.
        let squares = [
            begin.dot(&begin),
            begin.dot(&slope) * 2.0,
            slope.dot(&slope) + begin.dot(curve) * 2.0,
            slope.dot(curve) * 2.0,
            curve.dot(curve),
        ];
        let (mut at, mut before) = (0.0, units.share_of_squares(squares[0]));
        let holds = before <= 1.0;
        if !holds {
            return None;
        }
        for ticks in SAMPLED_TICKS {
            let [zeroth, first, second, third, fourth] = squares;
            let square =
                (((fourth * ticks + third) * ticks + second) * ticks + first) * ticks + zeroth;
            let share = units.share_of_squares(square) + growth * ticks;
            if share > 1.0 {
                let part = ((1.0 - before) / (share - before)).clamp(0.0, 1.0);
                return Some(at + part * (ticks - at));
            }
            (at, before) = (ticks, share);
        }
        Some(at)
    }

    /// Ticks of a lifetime before the stream is published again.
    pub(super) fn unobserved(&self) -> f64 {
        self.interval.saturating_sub(2) as f64
    }
}

/// Estimated lifetime of a correction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lifetime {
    /// Duration in ticks; zero if the correction does not hold at all.
    pub(super) ticks: f64,
    /// The first known tick at which the correction does not hold.
    pub(super) breach: Option<usize>,
}

impl ErrorForecast<'_> {
    /// The last known tick.
    pub(super) const fn last(&self) -> usize {
        self.known.len() - 1
    }

    /// The error at a known tick without a correction.
    #[inline]
    fn error(&self, tick: usize) -> Errors {
        let error = self.known[tick];
        match &self.acceleration {
            Some(by) if tick > 0 => error - by.each * by.falls[tick],
            _ => error,
        }
    }

    #[inline]
    fn left(&self, tick: usize, by: &Effect) -> Errors {
        self.error(tick) - by.at_once - by.each_tick * (tick as f64)
    }

    /// The lifetime of the prediction after a correction.
    pub(super) fn lifetime(&self, by: &Effect, expectation: &Expectation) -> Lifetime {
        let last = self.last();
        let mut tick = 0;
        while last > 0 && tick <= last {
            let holds = expectation.units.share(&self.left(tick, by)) <= 1.0;
            if !holds {
                return Lifetime {
                    ticks: tick as f64,
                    breach: Some(tick),
                };
            }
            tick += expectation.interval;
        }
        let known = last as f64 + 1.0;
        let ticks = if self.ends {
            known
        } else {
            let Some(beyond) = self.beyond(by, expectation) else {
                return Lifetime {
                    ticks: last as f64,
                    breach: Some(last),
                };
            };
            known + beyond.min(self.lasts) + expectation.unobserved()
        };
        Lifetime {
            ticks,
            breach: None,
        }
    }

    /// Ticks for which the correction holds beyond the known ones; `None` if it does not hold at the last known tick.
    fn beyond(&self, by: &Effect, expectation: &Expectation) -> Option<f64> {
        let begin = self.left(self.last(), by);
        expectation.ticks_within(begin, self.slope - by.each_tick, &self.curve)
    }

    /// The known errors from a later tick on, after a correction.
    pub(super) fn known_after(&self, tick: usize, by: &Effect) -> Known {
        let mut known = Known::new(self.left(tick, by));
        for later in tick + 1..=self.last() {
            known.push(self.left(later, by));
        }
        known
    }

    /// The best reduction at once, by least squares over the ticks up to `last`. Each tick adds the share `rate` of it.
    pub(super) fn nearest(&self, last: usize, rate: f64) -> Errors {
        if last == 0 {
            return self.error(0);
        }
        let (mut sum, mut weight) = (Errors::ZERO, 0.0);
        for tick in 0..=last {
            let gain = 1.0 + rate * tick as f64;
            sum = sum + self.error(tick) * gain;
            weight += gain * gain;
        }
        sum * (1.0 / weight)
    }

    /// The slope of the line from `begin` that fits the ticks up to `last` best.
    pub(super) fn slope_from(&self, last: usize, begin: &Errors) -> Errors {
        let (mut times, mut squares) = (0.0, 0.0);
        let mut moment = Errors::ZERO;
        for tick in 0..=last {
            let (errors, tick) = (self.error(tick), tick as f64);
            (times, squares) = (times + tick, squares + tick * tick);
            moment = moment + errors * tick;
        }
        (moment - *begin * times) * (1.0 / squares)
    }

    /// The straight line that fits the ticks up to `last` best: its start, and its slope per tick.
    pub(super) fn line(&self, last: usize) -> [Errors; 2] {
        let (mut times, mut squares) = (0.0, 0.0);
        let (mut sum, mut moment) = (Errors::ZERO, Errors::ZERO);
        for tick in 0..=last {
            let (errors, tick) = (self.error(tick), tick as f64);
            (times, squares) = (times + tick, squares + tick * tick);
            sum = sum + errors;
            moment = moment + errors * tick;
        }
        let determinant = (last + 1) as f64 * squares - times * times;
        let begin = (sum * squares - moment * times) * (1.0 / determinant);
        let slope = (moment - begin * times) * (1.0 / squares);
        [begin, slope]
    }
}

/// Difference of two poses: metres, and a rotation vector in radians.
#[inline]
pub(super) fn apart(to: &Pose, from: &Pose) -> Errors {
    let turn = to.rotation * from.rotation.conjugate();
    let sign = if turn.w < 0.0 { -2.0 } else { 2.0 };
    let chord = DVec3::new(turn.x, turn.y, turn.z) * sign;
    // The angle is twice the arcsine of half the chord: the first two terms of its series.
    let turn = chord * (1.0 + chord.length_squared() * (1.0 / 24.0));
    Errors::of([to.position - from.position, turn])
}

/// The pose of an observed state. Its rotation is of unit length up to f32 rounding, which suffices to compare.
pub(super) fn observed_pose(state: &BodyState) -> Pose {
    let [x, y, z, a, b, c, d, ..] = state.parts().map(f64::from);
    Pose {
        position: DVec3::new(x, y, z),
        rotation: DQuat::from_xyzw(a, b, c, d),
    }
}

/// The velocities of an observed state.
pub(super) fn observed_twist(state: &BodyState) -> Twist {
    let [.., u, v, w, p, q, r] = state.parts().map(f64::from);
    Twist {
        linear: DVec3::new(u, v, w),
        angular: DVec3::new(p, q, r),
    }
}

/// An error of position and turn by axis, or its change per tick. In metres and radians, or as shares of a tolerance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Errors([f64x2; 3]);

impl Errors {
    pub(super) const ZERO: Self = Self([f64x2::ZERO; 3]);

    /// Errors of position and of turn, or their changes.
    #[inline]
    pub(super) fn of([position, turn]: [DVec3; 2]) -> Self {
        Self([
            f64x2::new([position.x, turn.x]),
            f64x2::new([position.y, turn.y]),
            f64x2::new([position.z, turn.z]),
        ])
    }

    /// Errors from whole steps.
    #[inline]
    fn of_steps([a, b, c]: [i32; 3], [p, q, r]: [i32; 3], unit: f64x2) -> Self {
        let pair = |one: i32, other: i32| f64x2::new([f64::from(one), f64::from(other)]) * unit;
        Self([pair(a, p), pair(b, q), pair(c, r)])
    }

    /// Errors of position alone, with `unit` as the value of one metre.
    #[inline]
    pub(super) fn of_position(metres: DVec3, unit: f64x2) -> Self {
        Self::of([metres, DVec3::ZERO]) * unit
    }

    /// Dot products of the position errors and of the turn errors.
    #[inline]
    pub(super) fn dot(&self, other: &Self) -> f64x2 {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        a * x + b * y + c * z
    }
}

impl Add for Errors {
    type Output = Self;

    #[inline]
    fn add(self, other: Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        Self([a + x, b + y, c + z])
    }
}

impl Sub for Errors {
    type Output = Self;

    #[inline]
    fn sub(self, other: Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        Self([a - x, b - y, c - z])
    }
}

impl Mul<f64> for Errors {
    type Output = Self;

    #[inline]
    fn mul(self, factor: f64) -> Self {
        let ([a, b, c], factor) = (self.0, f64x2::splat(factor));
        Self([a * factor, b * factor, c * factor])
    }
}

impl Mul<f64x2> for Errors {
    type Output = Self;

    /// The same errors in other units: one factor for positions, and one for turns.
    #[inline]
    fn mul(self, unit: f64x2) -> Self {
        let [a, b, c] = self.0;
        Self([a * unit, b * unit, c * unit])
    }
}

/// Lengths, angles and steps as shares of one body's tolerance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Units {
    /// One metre, and one radian.
    pub(super) still: f64x2,
    /// One m/s and one rad/s over a tick.
    pub(super) moving: f64x2,
    /// One step of a residual's position, and one of its turn.
    steps: f64x2,
    /// One step of a residual's linear and angular velocity, over a tick.
    velocities: f64x2,
    /// True if position and turn share one bound.
    shared: bool,
}

impl Units {
    /// `slack`: factor on the tolerance.
    pub(super) fn new(
        tolerance: Tolerance,
        radius: Metres,
        slack: f64,
        grid: &Grid,
        step_s: f64,
    ) -> Self {
        let (position, turn, shared) = match tolerance {
            Tolerance::Surface(length) => {
                let length = length.metres().metres();
                (length, length / radius.metres(), true)
            }
            Tolerance::Parts { position, turn } => {
                (position.metres().metres(), turn.radians().radians(), false)
            }
        };
        let still = f64x2::new([1.0 / (position * slack), 1.0 / (turn * slack)]);
        let moving = still * f64x2::splat(step_s);
        Self {
            still,
            moving,
            steps: still * f64x2::new([grid.position(), grid.turn()]),
            velocities: moving * f64x2::new([grid.linear(), grid.angular()]),
            shared,
        }
    }

    /// The share of the tolerance that an error takes.
    #[inline]
    pub(super) fn share(&self, errors: &Errors) -> f64 {
        self.share_of_squares(errors.dot(errors))
    }

    /// The share of the tolerance for the squares of the errors of position and of turn.
    #[inline]
    fn share_of_squares(&self, squares: f64x2) -> f64 {
        let [position, turn] = squares.fast_max(f64x2::ZERO).sqrt().to_array();
        if self.shared {
            position + turn
        } else {
            position.max(turn)
        }
    }

    /// Reduction of the error by a residual without its velocities.
    #[inline]
    pub(super) fn of_residual(&self, residual: &Residual) -> Errors {
        Errors::of_steps(residual.position, residual.turn, self.steps)
    }

    /// Reduction of the error per tick by velocities.
    #[inline]
    pub(super) fn of_velocity(&self, velocity: &VelocityResidual) -> Errors {
        let doubled = f64::from(1_u32 << velocity.velocity_exponent.min(VELOCITY_EXPONENT_MAX));
        let unit = self.velocities * f64x2::splat(doubled);
        Errors::of_steps(velocity.linear, velocity.angular, unit)
    }

    /// Greatest rounding error of a velocity component per tick, in steps doubled `velocity_exponent` times.
    pub(super) fn rounding(&self, velocity_exponent: u32) -> f64 {
        let [linear, angular] = self.velocities.to_array();
        0.5 * linear.max(angular) * f64::from(1_u32 << velocity_exponent)
    }

    /// The residual without velocities that reduces an error most. A fraction of a step of at least `rounding` rounds
    /// up.
    pub(super) fn residual(&self, errors: &Errors, rounding: [f64; 2]) -> Residual {
        let [position, turn] = steps(errors, self.steps, f64x2::new(rounding), f64x2::new(LIMITS));
        Residual {
            position,
            turn,
            velocity: None,
        }
    }

    /// The velocities that reduce the growth of an error per tick most, in steps doubled `velocity_exponent` times.
    pub(super) fn velocity(&self, errors: &Errors, velocity_exponent: u32) -> VelocityResidual {
        let doubled = f64::from(1_u32 << velocity_exponent.min(VELOCITY_EXPONENT_MAX));
        let unit = self.velocities * f64x2::splat(doubled);
        let [linear, angular] = steps(errors, unit, f64x2::splat(0.5), f64x2::splat(1e9));
        VelocityResidual {
            velocity_exponent,
            linear,
            angular,
        }
    }
}

/// Limits of the steps of position and of turn.
const LIMITS: [f64; 2] = [RESIDUAL_LIMIT as f64, TURN_LIMIT as f64];

/// Errors in whole steps of `unit`, within limits.
#[inline]
fn steps(Errors(errors): &Errors, unit: f64x2, rounding: f64x2, limit: f64x2) -> [[i32; 3]; 2] {
    let (inverse, up) = (f64x2::ONE / unit, f64x2::ONE - rounding);
    let of = |errors: f64x2| {
        let steps = errors * inverse;
        // The cast turns NaN into zero.
        let size = (steps.abs() + up).fast_min(limit);
        let ([x, y], [p, q]) = (steps.to_array(), size.to_array());
        let signed = |of: f64, size: f64| {
            let size = size as i32;
            if of < 0.0 { -size } else { size }
        };
        [signed(x, p), signed(y, q)]
    };
    // Written out, because `map` of an array is not inlined here.
    let [x, y, z] = *errors;
    let ([a, p], [b, q], [c, r]) = (of(x), of(y), of(z));
    [[a, b, c], [p, q, r]]
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use proptest::prelude::*;
    use rhumb_reckoning::{Grid, Metres, Residual, Tolerance};

    use super::*;

    const STEP_S: f64 = 1.0 / 60.0;

    fn expectation() -> Expectation {
        let radius = Metres::new(0.5);
        let tolerance = Tolerance::from_metres(Metres::new(0.05)).unwrap();
        let grid = Grid::new(tolerance, radius);
        Expectation {
            units: Units::new(tolerance, radius, 1.0, &grid, STEP_S),
            growth: 0.01,
            interval: 1,
        }
    }

    /// The known errors of a body with these uncorrected errors along x, in metres.
    fn known(errors: &[f64]) -> Known {
        let of = |x: &f64| Errors::of_position(DVec3::X * *x, expectation().units.still);
        let mut known = Known::new(of(&errors[0]));
        errors[1..].iter().for_each(|x| known.push(of(x)));
        known
    }

    fn forecast(known: &Known) -> ErrorForecast<'_> {
        let slope = match known.errors() {
            [.., before, last] => *last - *before,
            _ => Errors::ZERO,
        };
        ErrorForecast {
            known: known.errors(),
            acceleration: None,
            slope,
            curve: Errors::ZERO,
            ends: false,
            lasts: f64::INFINITY,
        }
    }

    fn moved(steps: i32) -> Effect {
        let residual = Residual {
            position: [steps, 0, 0],
            ..Residual::default()
        };
        Effect {
            at_once: expectation().units.of_residual(&residual),
            each_tick: Errors::ZERO,
        }
    }

    #[test]
    fn a_lifetime_ends_where_the_tolerance_breaks() {
        let known = known(&[0.01, 0.03, 0.049, 0.051, 0.0]);
        let forecast = forecast(&known);
        let life = forecast.lifetime(&moved(0), &expectation());
        assert_eq!((life.ticks, life.breach), (3.0, Some(3)));
        let beyond = forecast.lifetime(&moved(1), &expectation());
        assert!(beyond.breach.is_none() && beyond.ticks > 5.0);
        let ends = ErrorForecast {
            ends: true,
            ..forecast
        };
        assert_eq!(ends.lifetime(&moved(1), &expectation()).ticks, 5.0);
    }

    #[test]
    fn the_known_errors_after_a_breach_include_the_correction() {
        let known = known(&[0.0, 0.02, 0.04, 0.06]);
        let forecast = forecast(&known);
        let remaining = forecast.known_after(3, &moved(0));
        let later = ErrorForecast {
            known: remaining.errors(),
            ..forecast
        };
        assert_eq!(later.last(), 0);
        let life = |steps| later.lifetime(&moved(steps), &expectation());
        assert_eq!((life(0).ticks, life(0).breach), (0.0, Some(0)));
        assert!(life(2).ticks > 3.0);
    }

    #[test]
    fn a_straight_line_is_found() {
        let errors: [f64; SPAN] = core::array::from_fn(|tick| 0.028 + 0.03 * tick as f64);
        let known = known(&errors);
        let [begin, slope] = forecast(&known).line(SPAN - 1);
        let units = expectation().units;
        let share = |errors: Errors| units.share(&errors) * 0.05;
        assert!((share(begin) - 0.028).abs() < 1e-9 && (share(slope) - 0.03).abs() < 1e-9);
        let again = forecast(&known).slope_from(SPAN - 1, &begin);
        assert!(share(again - slope) < 1e-9);
    }

    fn units() -> Units {
        let (tolerance, radius) = (Tolerance::NORMAL, Metres::new(0.5));
        Units::new(
            tolerance,
            radius,
            1.0,
            &Grid::new(tolerance, radius),
            1.0 / 60.0,
        )
    }

    fn vector() -> impl Strategy<Value = DVec3> {
        proptest::array::uniform3(-3.0..3.0_f64).prop_map(DVec3::from_array)
    }

    proptest! {
        #[test]
        fn the_nearest_residual_leaves_at_most_half_a_step_per_axis(position in vector(), turn in vector()) {
            let units = units();
            let errors = Errors::of([position, turn]) * units.still;
            let left = errors - units.of_residual(&units.residual(&errors, [0.5; 2]));
            for (lanes, steps) in left.0.iter().zip([units.steps; 3]) {
                let ([x, p], [a, b]) = (lanes.to_array(), steps.to_array());
                prop_assert!(x.abs() <= 0.5001 * a && p.abs() <= 0.5001 * b);
            }
        }

        #[test]
        fn a_residual_is_within_limits_for_every_error(
            error in prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(1e300), -1e9..1e9],
        ) {
            let units = units();
            let errors = Errors::of([DVec3::splat(error); 2]) * units.still;
            prop_assert!(units.residual(&errors, [0.5; 2]).is_within_limits());
        }
    }
}
