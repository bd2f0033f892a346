//! Errors of position and turn, as shares of what a tolerance allows.
//!
//! For who chooses alone: the promise is judged by [`Tolerance::share`](rhumb_reckoning::Tolerance::share).

use core::ops::{Add, Mul, Sub};

use glam::DVec3;
use rhumb_reckoning::Grid;
use wide::f64x2;

use super::ToleranceAllowance;

/// By axis; position first, then turn.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shares([f64x2; 3]);

impl Shares {
    /// Of so many metres and radians, of so many m/s and rad/s, or of so many steps of a grid, each units so much.
    #[inline]
    pub(super) fn of([linear, angular]: [DVec3; 2], unit: f64x2) -> Self {
        Self([
            f64x2::new([linear.x, angular.x]) * unit,
            f64x2::new([linear.y, angular.y]) * unit,
            f64x2::new([linear.z, angular.z]) * unit,
        ])
    }

    /// Of whole steps.
    #[inline]
    pub(super) fn of_steps([a, b, c]: [i32; 3], [p, q, r]: [i32; 3], unit: f64x2) -> Self {
        let pair =
            |linear: i32, angular: i32| f64x2::new([f64::from(linear), f64::from(angular)]) * unit;
        Self([pair(a, p), pair(b, q), pair(c, r)])
    }

    /// How long they are, of position and of turn.
    #[inline]
    fn lengths(&self) -> [f64; 2] {
        let [x, y, z] = self.0;
        (x * x + y * y + z * z).sqrt().to_array()
    }
}

impl Add for Shares {
    type Output = Self;

    #[inline]
    fn add(self, other: Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        Self([a + x, b + y, c + z])
    }
}

impl Sub for Shares {
    type Output = Self;

    #[inline]
    fn sub(self, other: Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        Self([a - x, b - y, c - z])
    }
}

impl Mul<f64> for Shares {
    type Output = Self;

    #[inline]
    fn mul(self, factor: f64) -> Self {
        let ([a, b, c], factor) = (self.0, f64x2::splat(factor));
        Self([a * factor, b * factor, c * factor])
    }
}

/// What things are units of a body's tolerance.
#[derive(Clone, Copy, Debug)]
pub(super) struct ShareUnits {
    /// A metre and a radian; the velocities that move a body by these in a tick.
    pub(super) still: f64x2,
    pub(super) moving: f64x2,
    /// A step of position and of turn in a correction; a step of velocities.
    pub(super) steps: f64x2,
    pub(super) velocities: f64x2,
    /// Whether both share one bound.
    shared: bool,
}

impl ShareUnits {
    #[inline]
    pub(super) fn of(allowance: &ToleranceAllowance, grid: &Grid, step_s: f64) -> Self {
        let still = f64x2::new([1.0 / allowance.position, 1.0 / allowance.turn]);
        let moving = still * f64x2::splat(step_s);
        Self {
            still,
            moving,
            steps: still * f64x2::new([grid.position(), grid.turn()]),
            velocities: moving * f64x2::new([grid.linear(), grid.angular()]),
            shared: allowance.shared,
        }
    }

    /// What position and turn take together.
    #[inline]
    pub(super) fn both(&self, shares: &Shares) -> f64 {
        let [position, turn] = shares.lengths();
        if self.shared {
            position + turn
        } else {
            position.max(turn)
        }
    }
}
