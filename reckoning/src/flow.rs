//! Free motion of a body over n ticks of an integrator: seven coefficients.
//!
//! The engine integrates semi-implicitly in substeps, damps once a tick, and turns by a normalised linear step. Any
//! other predictor would deviate from it (RECKONING 2). The coefficients depend on the scene and on a body's damping,
//! not on its motion: one row serves every body. Horizons are bounded by [`TRACK_AGE_MAX`].

use alloc::vec::Vec;
use core::num::NonZeroU32;

use crate::units::{Rate, Ticks};

/// Greatest age of a track: a moving body gets an update before, so that tables and ages stay small.
pub const TRACK_AGE_MAX: Ticks = Ticks::new(1_023);

/// The integration of a free body in a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Integrator {
    /// Ticks per second.
    pub rate: Rate,
    /// Velocity and position steps in one tick.
    pub substeps: NonZeroU32,
}

/// Damping of a body's free motion: velocity is divided by `1 + dt·damping` once a tick. Per second, ≥ 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Damping {
    /// Of the linear velocity, 1/s.
    pub linear: f32,
    /// Of the angular velocity, 1/s.
    pub angular: f32,
}

/// Coefficients after n ticks, from v₀, g and |ω₀| (RECKONING 2.3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StepCoefficients {
    /// v = `velocity`·v₀ + `fall_velocity`·g.
    pub(crate) velocity: f64,
    /// p = p₀ + `reach`·v₀ + `fall`·g, seconds.
    pub(crate) reach: f64,
    /// Seconds.
    pub(crate) fall_velocity: f64,
    /// Seconds squared.
    pub(crate) fall: f64,
    /// ω = `spin`·ω₀.
    pub(crate) spin: f64,
    /// Sums over the ticks of the spin coefficient to the first, third and fifth power.
    pub(crate) turns: [f64; 3],
}

impl StepCoefficients {
    const START: Self = Self {
        velocity: 1.0,
        reach: 0.0,
        fall_velocity: 0.0,
        fall: 0.0,
        spin: 1.0,
        turns: [0.0; 3],
    };

    /// One tick later.
    fn stepped(&self, config: &StepConstants) -> Self {
        let spin2 = self.spin * self.spin;
        let spin3 = spin2 * self.spin;
        let spin5 = spin3 * spin2;
        Self {
            velocity: self.velocity * config.linear_keep,
            reach: self.reach + config.dt * self.velocity,
            fall_velocity: (self.fall_velocity + config.dt) * config.linear_keep,
            fall: (self.fall + config.dt * self.fall_velocity) + config.fall_in_tick,
            spin: self.spin * config.angular_keep,
            turns: [
                self.turns[0] + self.spin,
                self.turns[1] + spin3,
                self.turns[2] + spin5,
            ],
        }
    }

    /// Half the angle turned so far by a body whose initial spin is `speed` rad/s (RECKONING 2.4).
    ///
    /// Each substep turns by twice the arctangent of `u`; its series is cut after the fifth power.
    pub(crate) fn half_angle(&self, speed: f64, config: &StepConstants) -> f64 {
        let u = speed * config.half_substep;
        let u2 = u * u;
        let series = self.turns[0] - u2 * (self.turns[1] / 3.0 - u2 * (self.turns[2] / 5.0));
        (config.substeps * u) * series
    }
}

/// Constants that all rows of one table share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StepConstants {
    pub(crate) dt: f64,
    pub(crate) substeps: f64,
    pub(crate) substep_count: u32,
    pub(crate) half_substep: f64,
    linear_keep: f64,
    pub(crate) angular_keep: f64,
    fall_in_tick: f64,
}

/// Rows from tick zero to the last one computed, for one integrator and one damping.
#[derive(Clone, Debug)]
pub struct StepCoefficientTable {
    config: StepConstants,
    rows: Vec<StepCoefficients>,
}

impl StepCoefficientTable {
    /// A table for bodies of this damping; [`Self::extend_to`] computes its rows.
    #[must_use]
    pub fn new(integrator: Integrator, damping: Damping) -> Self {
        let dt = integrator.rate.step().seconds();
        let substeps = f64::from(integrator.substeps.get());
        let config = StepConstants {
            dt,
            substeps,
            substep_count: integrator.substeps.get(),
            half_substep: (dt / substeps) * 0.5,
            linear_keep: 1.0 / (1.0 + dt * f64::from(damping.linear)),
            angular_keep: 1.0 / (1.0 + dt * f64::from(damping.angular)),
            fall_in_tick: (dt * dt) * ((substeps + 1.0) / (2.0 * substeps)),
        };
        Self {
            config,
            rows: alloc::vec![StepCoefficients::START],
        }
    }

    /// Computes the rows up to `ticks`, or up to [`TRACK_AGE_MAX`] if that is less.
    pub fn extend_to(&mut self, ticks: Ticks) {
        let wanted = ticks.min(TRACK_AGE_MAX).count() as usize;
        while self.rows.len() <= wanted {
            let last = self.rows[self.rows.len() - 1];
            self.rows.push(last.stepped(&self.config));
        }
    }

    /// `ticks`, or the last computed row when that is less.
    #[inline]
    pub(crate) fn within(&self, ticks: Ticks) -> Ticks {
        ticks.min(Ticks::new(self.rows.len() as u32 - 1))
    }

    /// Effect in `elapsed` ticks of an acceleration that ends at `ends`: factor on the way, s², and on the velocity,
    /// s.
    #[inline]
    pub(crate) fn ended(&self, elapsed: Ticks, ends: Ticks) -> (f64, f64) {
        let pulled = self.within(elapsed).min(ends);
        let (last, _) = self.row(pulled);
        let coasted = Ticks::new(self.within(elapsed).count() - pulled.count());
        let (coast, _) = self.row(coasted);
        (
            last.fall + last.fall_velocity * coast.reach,
            last.fall_velocity * coast.velocity,
        )
    }

    /// The row for `ticks`; the last one computed when `ticks` lies beyond it.
    #[inline]
    pub(crate) fn row(&self, ticks: Ticks) -> (&StepCoefficients, &StepConstants) {
        (
            &self.rows[self.within(ticks).count() as usize],
            &self.config,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(linear: f32, angular: f32) -> StepCoefficientTable {
        let integrator = Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::new(4).unwrap(),
        };
        let mut table = StepCoefficientTable::new(integrator, Damping { linear, angular });
        table.extend_to(TRACK_AGE_MAX);
        table
    }

    #[test]
    fn the_coefficients_equal_stepping_by_hand() {
        let table = table(0.3, 0.1);
        let (dt, h, keep) = (1.0 / 60.0, 1.0 / 240.0, 1.0 / (1.0 + 0.3_f32 as f64 / 60.0));
        let (mut p, mut v, g) = (0.0, 5.0, -9.8);
        for _ in 0..120 {
            for _ in 0..4 {
                v += g * h;
                p += v * h;
            }
            v *= keep;
        }
        let (flow, _) = table.row(Ticks::new(120));
        assert!((flow.reach * 5.0 + flow.fall * g - p).abs() < 1e-9);
        assert!((flow.velocity * 5.0 + flow.fall_velocity * g - v).abs() < 1e-9);
        assert!((dt - 4.0 * h).abs() < 1e-15);
    }

    #[test]
    fn the_angle_equals_stepping_by_hand() {
        let table = table(0.0, 0.05);
        let (h, keep) = (1.0 / 240.0, 1.0 / (1.0 + 0.05_f32 as f64 / 60.0));
        let (mut spin, mut half) = (40.0, 0.0);
        for _ in 0..300 {
            for _ in 0..4 {
                half += libm::atan(spin * h * 0.5);
            }
            spin *= keep;
        }
        let (flow, config) = table.row(Ticks::new(300));
        // 40 rad/s for five seconds; the cut series is worth less than a thousandth of a radian.
        assert!((flow.half_angle(40.0, config) - half).abs() < 1e-3);
    }

    #[test]
    fn acceleration_ends_after_its_ticks() {
        let table = table(0.3, 0.0);
        let (h, keep, g) = (1.0 / 240.0, 1.0 / (1.0 + 0.3_f32 as f64 / 60.0), -9.8);
        let (mut p, mut v) = (0.0, 0.0);
        for tick in 1..=200 {
            for _ in 0..4 {
                v += if tick <= 64 { g * h } else { 0.0 };
                p += v * h;
            }
            v *= keep;
            let (fall, fall_velocity) = table.ended(Ticks::new(tick), Ticks::new(64));
            assert!((fall * g - p).abs() < 1e-9, "{tick}");
            assert!((fall_velocity * g - v).abs() < 1e-9, "{tick}");
        }
    }

    #[test]
    fn beyond_the_horizon_the_last_row_stands() {
        let table = table(0.0, 0.0);
        assert_eq!(
            table.row(TRACK_AGE_MAX).0,
            table.row(Ticks::new(1_000_000)).0
        );
    }
}
