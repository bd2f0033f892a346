//! The dead-reckoning models 1 to 9 of DIS, in f64.
//!
//! Pure arithmetic on one state and a time; it does not know how a state was sent. Positions are displacements, because
//! an f64 of the Earth's radius has steps of a nanometre. Spin is about the entity's axes in every model. The models with
//! fixed orientation ignore the spin. In models 8 and 9 the acceleration is the rate of change of the components of the
//! velocity along the entity's axes; it is not the inertial acceleration, which differs by spin × velocity.

use core::f64::consts::{FRAC_PI_2, PI};

use glam::{DQuat, DVec3};

/// A model of dead reckoning, with its number on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Model {
    /// 1: stands still.
    Static = 1,
    /// 2, FPW: constant velocity in the world, fixed orientation.
    FixedVelocityWorld = 2,
    /// 3, RPW: constant velocity in the world, constant spin.
    RotatingVelocityWorld = 3,
    /// 4, RVW: constant acceleration in the world, constant spin.
    RotatingAccelerationWorld = 4,
    /// 5, FVW: constant acceleration in the world, fixed orientation.
    FixedAccelerationWorld = 5,
    /// 6, FPB: constant velocity along the entity's axes, fixed orientation.
    FixedVelocityBody = 6,
    /// 7, RPB: constant velocity along the entity's axes, constant spin: circles and helices.
    RotatingVelocityBody = 7,
    /// 8, RVB: velocity along the entity's axes grows evenly, constant spin.
    RotatingAccelerationBody = 8,
    /// 9, FVB: velocity along the entity's axes grows evenly, fixed orientation.
    FixedAccelerationBody = 9,
}

impl Model {
    /// All models, in order of number.
    pub const ALL: [Self; 9] = [
        Self::Static,
        Self::FixedVelocityWorld,
        Self::RotatingVelocityWorld,
        Self::RotatingAccelerationWorld,
        Self::FixedAccelerationWorld,
        Self::FixedVelocityBody,
        Self::RotatingVelocityBody,
        Self::RotatingAccelerationBody,
        Self::FixedAccelerationBody,
    ];

    /// The model of this number on the wire; `None` for 0 (other) and for numbers that no standard has.
    #[must_use]
    pub fn of(number: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|model| *model as u8 == number)
    }

    /// True if it predicts a turn.
    #[must_use]
    pub const fn turns(self) -> bool {
        matches!(self as u8, 3 | 4 | 7 | 8)
    }

    const fn accelerates(self) -> bool {
        matches!(self as u8, 4 | 5 | 8 | 9)
    }

    /// True if its velocity is along the entity's axes.
    #[must_use]
    pub const fn is_along_body(self) -> bool {
        self as u8 >= 6
    }
}

/// The motion of an entity at the moment of its state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Metres per second: along the axes of the world in models 1 to 5, along the entity's in 6 to 9.
    pub velocity: DVec3,
    /// Metres per second squared, along the axes of the velocity.
    pub acceleration: DVec3,
    /// Unit quaternion, entity → world.
    pub orientation: DQuat,
    /// Radians per second, about the entity's axes.
    pub spin: DVec3,
}

/// The predicted pose of an entity, a time after its state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reckoned {
    /// From the position of the state, metres, in the world.
    pub displacement: DVec3,
    /// Along the axes of the velocity of the state.
    pub velocity: DVec3,
    /// Unit quaternion, entity → world.
    pub orientation: DQuat,
}

/// Predicts a motion `seconds` after its state, which may be negative.
///
/// Exact for every spin, zero included: below half a radian of turn the integrals are series. Not finite exactly when
/// its input, or the result, is beyond f64.
#[must_use]
pub fn reckon(model: Model, motion: &Motion, seconds: f64) -> Reckoned {
    let t = seconds;
    let spin = if model.turns() {
        motion.spin
    } else {
        DVec3::ZERO
    };
    let acceleration = if model.accelerates() {
        motion.acceleration
    } else {
        DVec3::ZERO
    };
    let displacement = if model == Model::Static {
        DVec3::ZERO
    } else if model.is_along_body() {
        let integrals = Integrals::of(spin, t);
        let along = integrals.first(motion.velocity) + integrals.second(acceleration);
        motion.orientation * along
    } else {
        motion.velocity * t + acceleration * (0.5 * t * t)
    };
    Reckoned {
        displacement,
        velocity: motion.velocity + acceleration * t,
        orientation: motion.orientation * turn(spin, t),
    }
}

/// The rotation of a constant spin about axes that turn with it.
fn turn(spin: DVec3, t: f64) -> DQuat {
    let rate = spin.length();
    let half = 0.5 * rate * t;
    let scale = if rate == 0.0 {
        0.5 * t
    } else {
        half.sin() / rate
    };
    let axis = spin * scale;
    DQuat::from_xyzw(axis.x, axis.y, axis.z, half.cos())
}

/// The integrals over time of the rotation of a spin, and of that times the time.
struct Integrals {
    spin: DVec3,
    t: f64,
    /// Coefficients of a vector, its cross product and its projection, for the first integral and the second.
    first: [f64; 3],
    second: [f64; 3],
}

impl Integrals {
    fn of(spin: DVec3, t: f64) -> Self {
        let b = spin.length() * t;
        let (first, second) = if b.abs() < SERIES_BELOW {
            series(b * b)
        } else {
            closed(b)
        };
        Self {
            spin,
            t,
            first,
            second,
        }
    }

    fn first(&self, v: DVec3) -> DVec3 {
        self.combine(v, self.first) * self.t
    }

    fn second(&self, v: DVec3) -> DVec3 {
        self.combine(v, self.second) * (self.t * self.t)
    }

    fn combine(&self, v: DVec3, [same, cross, along]: [f64; 3]) -> DVec3 {
        let turn = self.spin * self.t;
        v * same + turn.cross(v) * cross + turn * (turn.dot(v) * along)
    }
}

/// Turn below which the closed forms lose digits, radians. Eight terms leave 4e-17 there.
const SERIES_BELOW: f64 = 0.5;
const TERMS: u32 = 9;

/// The coefficients for a turn whose square is `x`.
fn series(x: f64) -> ([f64; 3], [f64; 3]) {
    let (mut first, mut second) = ([0.0; 3], [0.0; 3]);
    // (−x)^k / (2k)!
    let mut term = 1.0;
    for k in 0..TERMS {
        let n = f64::from(2 * k);
        first[0] += term / (n + 1.0);
        first[1] += term / ((n + 1.0) * (n + 2.0));
        first[2] += term / ((n + 1.0) * (n + 2.0) * (n + 3.0));
        second[0] += term / (n + 2.0);
        second[1] += term / ((n + 1.0) * (n + 3.0));
        second[2] += term / ((n + 1.0) * (n + 2.0) * (n + 4.0));
        term *= -x / ((n + 1.0) * (n + 2.0));
    }
    (first, second)
}

/// The coefficients for a turn of `b` radians.
fn closed(b: f64) -> ([f64; 3], [f64; 3]) {
    let (sin, cos) = b.sin_cos();
    let square = b * b;
    let first = [sin / b, (1.0 - cos) / square, (b - sin) / (square * b)];
    let second = [
        (cos + b * sin - 1.0) / square,
        (sin - b * cos) / (square * b),
        (0.5 * square - cos - b * sin + 1.0) / (square * square),
    ];
    (first, second)
}

/// Orientation as DIS has it: about z, then the new y, then the new x; radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Euler {
    /// About z.
    pub psi: f64,
    /// About the new y.
    pub theta: f64,
    /// About the newest x.
    pub phi: f64,
}

impl Euler {
    /// The same rotation as a unit quaternion, entity → world.
    #[must_use]
    pub fn to_quaternion(self) -> DQuat {
        let [(sa, ca), (sb, cb), (sc, cc)] =
            [self.psi, self.theta, self.phi].map(|angle| (0.5 * angle).sin_cos());
        DQuat::from_xyzw(
            ca * cb * sc - sa * sb * cc,
            ca * sb * cc + sa * cb * sc,
            sa * cb * cc - ca * sb * sc,
            ca * cb * cc + sa * sb * sc,
        )
    }

    /// The angles of a unit quaternion, entity → world: psi and phi in (−π, π], theta in [−π/2, π/2].
    ///
    /// Half of psi + phi and half of psi − phi are found apart. So the rotation is exact near theta = ±π/2 as well, where
    /// only one of the two is defined.
    #[must_use]
    pub fn from_quaternion(q: DQuat) -> Self {
        let plus = (q.x + q.z).atan2(q.w - q.y);
        let minus = (q.z - q.x).atan2(q.w + q.y);
        let rise = (q.w + q.y).hypot(q.z - q.x);
        let fall = (q.w - q.y).hypot(q.x + q.z);
        Self {
            psi: wrapped(plus + minus),
            theta: 2.0 * rise.atan2(fall) - FRAC_PI_2,
            phi: wrapped(plus - minus),
        }
    }
}

/// An angle in [−2π, 2π], in (−π, π].
fn wrapped(angle: f64) -> f64 {
    if angle > PI {
        angle - 2.0 * PI
    } else if angle <= -PI {
        angle + 2.0 * PI
    } else {
        angle
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn series_and_closed_forms_meet() {
        let (a, b) = (series(0.25), closed(0.5));
        for (x, y) in a.0.iter().chain(&a.1).zip(b.0.iter().chain(&b.1)) {
            assert!((x - y).abs() < 4e-15, "{x} and {y}");
        }
    }

    #[test]
    fn every_model_has_its_number() {
        for number in 0..=255 {
            let model = Model::of(number);
            assert_eq!(
                model.map(|model| model as u8),
                (1..=9).contains(&number).then_some(number)
            );
        }
    }

    proptest! {
        #[test]
        fn euler_angles_keep_the_rotation_everywhere(
            psi in -4.0..4.0, phi in -4.0..4.0, theta in -1.6..1.6, tiny in -1e-9..1e-9, pole in 0..3,
        ) {
            let theta: f64 = match pole { 0 => theta, 1 => FRAC_PI_2 + tiny, _ => tiny - FRAC_PI_2 };
            let q = Euler { psi, theta, phi }.to_quaternion();
            let back = Euler::from_quaternion(q);
            prop_assert!(back.psi.abs() <= PI && back.phi.abs() <= PI && back.theta.abs() <= FRAC_PI_2 + 1e-15);
            let off = 1.0 - back.to_quaternion().dot(q).abs();
            prop_assert!(off < 1e-15, "{q} is read as {back:?}");
        }

        #[test]
        fn two_short_predictions_are_one_long(
            w in prop::array::uniform3(-3.0..3.0), v in prop::array::uniform3(-50.0..50.0), t in -2.0..2.0,
        ) {
            let start = Motion {
                velocity: DVec3::from(v), acceleration: DVec3::ZERO,
                orientation: Euler { psi: 0.3, theta: -0.4, phi: 1.0 }.to_quaternion(), spin: DVec3::from(w),
            };
            let model = Model::RotatingVelocityBody;
            let (half, whole) = (reckon(model, &start, 0.5 * t), reckon(model, &start, t));
            let then = Motion { orientation: half.orientation, ..start };
            let rest = reckon(model, &then, 0.5 * t);
            prop_assert!((half.displacement + rest.displacement - whole.displacement).length() < 1e-12);
            prop_assert!(1.0 - rest.orientation.dot(whole.orientation).abs() < 1e-14);
        }
    }
}
