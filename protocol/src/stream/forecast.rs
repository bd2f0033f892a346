//! How far off a body will be after a correction, where the future is known.
//!
//! Nothing is predicted here: a correction moves what was predicted by so many steps, and by more each tick where it
//! implies velocities, so that one prediction for each tick does for all corrections. That is near enough to choose by,
//! and no promise rests on it: what is chosen is judged by the normative prediction.

use glam::DVec3;
use rhumb_reckoning::{
    Grid, RESIDUAL_LIMIT, Residual, TURN_LIMIT, VELOCITY_EXPONENT_MAX, VelocityResidual,
};

use super::choose::ToleranceAllowance;
use super::observation_history::LOOKAHEAD_MAX;

/// Ticks that are looked at: the one that is spoken of, and what lookahead knows.
pub(super) const SPAN: usize = LOOKAHEAD_MAX.count() as usize + 1;
/// The ticks beyond what is known at which an expected error is looked at.
const LOOKS: [f64; 11] = [1.0, 2.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0];

/// Errors of position (m) and of turn (rad), tick by tick, in the frame of a mode.
pub(super) type Errors = [[DVec3; 2]; SPAN];

/// How far off a body is, and how it strays at last.
#[derive(Clone, Copy, Debug)]
pub(super) struct ForecastErrors {
    pub(super) errors: Errors,
    /// From the last known tick to the next, m and rad.
    pub(super) rate: [DVec3; 2],
}

/// What is known of a body beside a predictor that it may follow.
#[derive(Clone, Copy, Debug)]
pub(super) struct ErrorForecast {
    /// What the predictor makes of the prediction as it is, from the tick that is spoken of on.
    pub(super) off: ForecastErrors,
    /// The last tick that is known.
    pub(super) known: usize,
    /// Whether nothing is to be said of it after that.
    pub(super) ends: bool,
    pub(super) grid: Grid,
    /// Seconds in a tick.
    pub(super) step_s: f64,
    /// For one who moves: the time by which a correction is a velocity, s.
    pub(super) over_s: Option<f64>,
    pub(super) allowance: ToleranceAllowance,
    /// For how many ticks beyond those known it may hold at most.
    pub(super) lasts: f64,
    /// What each tick beyond those known adds to the expected error, as a share of the tolerance.
    pub(super) error_growth: f64,
}

/// For how long a correction holds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lifetime {
    /// Ticks, those expected beyond what is known included; none if it does not hold at all.
    pub(super) ticks: f64,
    /// The first known tick at which it does not hold.
    pub(super) breach: Option<usize>,
}

impl ErrorForecast {
    /// By how much of a correction a body is moved at a tick.
    fn gain(&self, tick: usize) -> f64 {
        self.over_s
            .map_or(1.0, |over| 1.0 + self.seconds(tick) / over)
    }

    fn seconds(&self, tick: usize) -> f64 {
        tick as f64 * self.step_s
    }

    /// What is left to be off by after a correction.
    pub(super) fn after(&self, residual: &Residual) -> ForecastErrors {
        let metres = vector(residual.position, self.grid.position());
        let radians = vector(residual.turn, self.grid.turn());
        let [faster, spun] = residual.velocity.map_or([DVec3::ZERO; 2], |velocity| {
            let doubled = f64::from(1_u32 << velocity.velocity_exponent.min(VELOCITY_EXPONENT_MAX));
            [
                vector(velocity.linear, self.grid.linear() * doubled),
                vector(velocity.angular, self.grid.angular() * doubled),
            ]
        });
        let mut off = self.off;
        for (tick, [position, turn]) in off.errors.iter_mut().enumerate().take(self.known + 1) {
            let (gain, seconds) = (self.gain(tick), self.seconds(tick));
            *position -= metres * gain + faster * seconds;
            *turn -= radians * gain + spun * seconds;
        }
        let implied = self.gain(1) - self.gain(0);
        off.rate[0] -= metres * implied + faster * self.step_s;
        off.rate[1] -= radians * implied + spun * self.step_s;
        off
    }

    fn share(&self, [position, turn]: &[DVec3; 2]) -> f64 {
        self.allowance.share(position.length(), turn.length())
    }

    /// For how long a body with these errors is within tolerance.
    pub(super) fn lifetime(&self, off: &ForecastErrors) -> Lifetime {
        let known = &off.errors[..=self.known];
        let breach = known.iter().position(|error| self.share(error) > 1.0);
        let ticks = match breach {
            Some(breach) => breach as f64,
            None if self.ends => known.len() as f64,
            None => known.len() as f64 + self.beyond(off).min(self.lasts),
        };
        Lifetime { ticks, breach }
    }

    /// How many ticks more it may hold, if it goes on prediction_error as it did at last.
    fn beyond(&self, off: &ForecastErrors) -> f64 {
        let last = off.errors[self.known];
        let (mut at, mut share) = (0.0, self.share(&last));
        for look in LOOKS {
            let error = [0, 1].map(|i| last[i] + off.rate[i] * look);
            let then = self.share(&error) + self.error_growth * look;
            if then > 1.0 {
                return at + (1.0 - share) / (then - share) * (look - at);
            }
            (at, share) = (look, then);
        }
        at
    }

    /// What is known from a later tick on, if the body is off so; `age_s`: of its track by then, s.
    pub(super) fn from(&self, tick: usize, off: &ForecastErrors, age_s: f64) -> Self {
        let mut off = *off;
        off.errors.copy_within(tick..=self.known, 0);
        Self {
            off,
            known: self.known - tick,
            over_s: self.over_s.map(|_| age_s),
            ..*self
        }
    }

    /// The correction that comes nearest to the ticks up to one, without velocities.
    pub(super) fn nearest(&self, last: usize) -> Residual {
        let (mut sums, mut weight) = ([DVec3::ZERO; 2], 0.0);
        for (tick, errors) in self.off.errors.iter().enumerate().take(last + 1) {
            let gain = self.gain(tick);
            sums = [0, 1].map(|i| sums[i] + errors[i] * gain);
            weight += gain * gain;
        }
        self.rounded(sums.map(|sum| sum / weight))
    }

    /// The pose that a straight line through the ticks up to one begins at, and velocities beyond those that are implied,
    /// m/s and rad/s: those that then bring the body nearest to those ticks, and those of the line, which serve for longer.
    pub(super) fn line(&self, last: usize) -> (Residual, [[DVec3; 2]; 2]) {
        let known = || self.off.errors.iter().enumerate().take(last + 1);
        let (mut times, mut squares) = (0.0, 0.0);
        let (mut sums, mut moments) = ([DVec3::ZERO; 2], [DVec3::ZERO; 2]);
        for (tick, errors) in known() {
            let seconds = self.seconds(tick);
            (times, squares) = (times + seconds, squares + seconds * seconds);
            sums = [0, 1].map(|i| sums[i] + errors[i]);
            moments = [0, 1].map(|i| moments[i] + errors[i] * seconds);
        }
        let determinant = (last + 1) as f64 * squares - times * times;
        let begins = [0, 1].map(|i| (sums[i] * squares - moments[i] * times) / determinant);
        let residual = self.rounded(begins);
        let said = [
            vector(residual.position, self.grid.position()),
            vector(residual.turn, self.grid.turn()),
        ];
        let rate = self.over_s.map_or(0.0, |over| 1.0 / over);
        let nearest = [0, 1].map(|i| (moments[i] - said[i] * times) / squares - said[i] * rate);
        let along = [0, 1].map(|i| (moments[i] - begins[i] * times) / squares - said[i] * rate);
        (residual, [nearest, along])
    }

    /// Velocities in steps of this velocity_exponent.
    pub(super) fn velocity(&self, faster: [DVec3; 2], velocity_exponent: u32) -> VelocityResidual {
        let doubled = f64::from(1_u32 << velocity_exponent);
        let steps = |velocity: DVec3, step: f64| whole(velocity / (step * doubled), i32::MAX);
        VelocityResidual {
            velocity_exponent,
            linear: steps(faster[0], self.grid.linear()),
            angular: steps(faster[1], self.grid.angular()),
        }
    }

    /// Keyframe steps; the nearest within what an update may hold.
    fn rounded(&self, [position, turn]: [DVec3; 2]) -> Residual {
        Residual {
            position: whole(position / self.grid.position(), RESIDUAL_LIMIT),
            turn: whole(turn / self.grid.turn(), TURN_LIMIT),
            velocity: None,
        }
    }
}

fn vector(steps: [i32; 3], step: f64) -> DVec3 {
    DVec3::from_array(steps.map(f64::from)) * step
}

fn whole(steps: DVec3, limit: i32) -> [i32; 3] {
    // What is no number becomes zero.
    let whole = |x: f64| (libm::floor(x + 0.5) as i32).clamp(-limit, limit);
    steps.to_array().map(whole)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rhumb_reckoning::{Metres, Tolerance};

    const STEP_S: f64 = 1.0 / 60.0;

    /// Of a body whose errors without a correction are these along x.
    fn forecast(errors: &[f64], over_s: Option<f64>) -> ErrorForecast {
        let radius = Metres::new(0.5);
        let tolerance = Tolerance::from_metres(Metres::new(0.05)).unwrap();
        let known = errors.len() - 1;
        let mut off = [[DVec3::ZERO; 2]; SPAN];
        for (place, error) in off.iter_mut().zip(errors) {
            place[0] = DVec3::X * *error;
        }
        let rate = off[known][0] - off[known.saturating_sub(1)][0];
        ErrorForecast {
            off: ForecastErrors {
                errors: off,
                rate: [rate, DVec3::ZERO],
            },
            known,
            ends: false,
            grid: Grid::new(tolerance, radius),
            step_s: STEP_S,
            over_s,
            allowance: ToleranceAllowance::of(tolerance, radius),
            lasts: f64::INFINITY,
            error_growth: 0.01,
        }
    }

    fn moved(steps: i32) -> Residual {
        Residual {
            position: [steps, 0, 0],
            ..Residual::default()
        }
    }

    #[test]
    fn a_life_ends_where_the_tolerance_breaks() {
        let forecast = forecast(&[0.01, 0.03, 0.049, 0.051, 0.0], None);
        let lifetime = forecast.lifetime(&forecast.off);
        assert_eq!((lifetime.ticks, lifetime.breach), (3.0, Some(3)));
        let beyond = forecast.after(&moved(1));
        let lifetime = forecast.lifetime(&beyond);
        assert_eq!(lifetime.breach, None);
        assert!(lifetime.ticks > 5.0);
        let ends = ErrorForecast {
            ends: true,
            ..forecast
        };
        assert_eq!(ends.lifetime(&beyond).ticks, 5.0);
    }

    #[test]
    fn forecast_after_a_breach_keeps_the_error_rate() {
        // At the last known tick nothing but the rate tells that it moves on.
        let forecast = forecast(&[0.0, 0.02, 0.04, 0.06], Some(3.0 * STEP_S));
        let off = forecast.after(&moved(0));
        let next = forecast.from(3, &off, 3.0 * STEP_S);
        assert_eq!(next.known, 0);
        assert!((next.off.rate[0].x - 0.02).abs() < 1e-12);
        let (still, corrected) = (next.after(&moved(0)), next.after(&moved(2)));
        assert_eq!(next.lifetime(&still).ticks, 0.0);
        assert!(next.lifetime(&corrected).ticks > 3.0);
    }

    #[test]
    fn a_line_is_found_with_its_velocities() {
        let slope = 2.0;
        let errors: [f64; 7] = core::array::from_fn(|tick| 0.028 + slope * tick as f64 * STEP_S);
        let forecast = forecast(&errors, Some(0.1));
        let (residual, faster) = forecast.line(6);
        let steps = (0.028 / forecast.grid.position() + 0.5).floor() as i32;
        assert_eq!(residual.position, [steps, 0, 0]);
        let [nearest, along] = faster.map(|faster| {
            let velocity = Some(forecast.velocity(faster, 0));
            let off = forecast.after(&Residual {
                velocity,
                ..residual
            });
            let worst = off.errors.iter().map(|[error, _]| error.length());
            (worst.fold(0.0, f64::max), off.rate[0].length())
        });
        assert!(nearest.0 < 0.02 && along.0 < 0.02, "{nearest:?} {along:?}");
        // Who goes along the line is as far off as at first.
        assert!(
            along.1 < 1e-4 && along.1 < nearest.1,
            "{nearest:?} {along:?}"
        );
    }

    proptest! {
        #[test]
        fn a_correction_of_a_still_body_is_as_much_at_every_tick(
            errors in proptest::collection::vec(-0.1..0.1_f64, 1..=SPAN), steps in -9..9,
        ) {
            let forecast = forecast(&errors, None);
            let off = forecast.after(&moved(steps));
            for (error, [left, _]) in errors.iter().zip(&off.errors) {
                let expected = error - f64::from(steps) * forecast.grid.position();
                prop_assert!((left.x - expected).abs() < 1e-12);
            }
        }

        #[test]
        fn invalid_numbers_are_clamped(
            error in prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(1e300), -1e9..1e9],
        ) {
            let forecast = forecast(&[error, error, error], Some(0.1));
            prop_assert!(forecast.nearest(2).is_within_limits());
            let lifetime = forecast.lifetime(&forecast.off);
            prop_assert!(!lifetime.ticks.is_nan());
            let (residual, faster) = forecast.line(2);
            prop_assert!(residual.is_within_limits());
            prop_assert_eq!(forecast.velocity(faster[0], 9).velocity_exponent, 9);
        }
    }
}
