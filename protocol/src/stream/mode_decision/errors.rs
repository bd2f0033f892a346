//! Prediction errors of position and turn, as shares of a body's tolerance.
//!
//! These approximate errors only rank corrections; [`Tolerance::share`] decides whether the tolerance holds. Errors of
//! position and of turn lie in the two lanes of one vector, so that one instruction computes both.

use core::ops::{Add, Mul, Sub};

use glam::{DQuat, DVec3};
use rhumb_reckoning::{
    BodyState, Grid, Metres, Pose, RESIDUAL_LIMIT, Residual, TURN_LIMIT, Tolerance, Twist,
    VELOCITY_EXPONENT_MAX, VelocityResidual,
};
use wide::f64x2;

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
    pub(super) fn share_of_squares(&self, squares: f64x2) -> f64 {
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
    use super::*;
    use proptest::prelude::*;

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
