//! The arithmetic that every platform and language must repeat to the bit.
//!
//! IEEE-754 binary64 add, subtract, multiply, divide and square root, each rounded on its own, in the order written
//! (RECKONING 1). No fused operation, no library sine. Nothing here checks its input: callers hold checked motions.

use glam::{DQuat, DVec3};
use wide::f64x2;

/// Correctly rounded square root.
pub(crate) fn sqrt(x: f64) -> f64 {
    // WebAssembly has an instruction; libm computes by whole numbers there.
    if cfg!(target_feature = "simd128") {
        f64x2::splat(x).sqrt().to_array()[0]
    } else {
        libm::sqrt(x)
    }
}

/// The greatest whole number not above `x`; infinities and NaN stay. The sign of zero is not preserved.
#[inline]
fn floor(x: f64) -> f64 {
    let has_fraction = x.abs() < WHOLE;
    if !has_fraction {
        return x;
    }
    let cut = x as i64 as f64;
    if cut > x { cut - 1.0 } else { cut }
}

/// The greatest whole number not above `x`, within ±2³¹; NaN gives zero.
#[inline]
pub(crate) fn floor_to_i32(x: f64) -> i32 {
    // The cast saturates, and what is cut off is a fraction only.
    let cut = x as i32;
    cut.saturating_sub(i32::from(f64::from(cut) > x))
}

/// From this value (2⁵²) on every double is whole.
const WHOLE: f64 = 4_503_599_627_370_496.0;

/// `(x·x + y·y) + z·z`.
fn dot3(a: DVec3, b: DVec3) -> f64 {
    a.x * b.x + a.y * b.y + a.z * b.z
}

/// Euclidean length, by [`dot3`] and one square root.
pub(crate) fn length3(a: DVec3) -> f64 {
    sqrt(dot3(a, a))
}

/// Cross product: `y·z − z·y` and so on.
pub(crate) fn cross3(a: DVec3, b: DVec3) -> DVec3 {
    DVec3::new(
        a.y * b.z - a.z * b.y,
        a.z * b.x - a.x * b.z,
        a.x * b.y - a.y * b.x,
    )
}

/// Each component times one factor.
pub(crate) fn scale3(a: DVec3, k: f64) -> DVec3 {
    DVec3::new(a.x * k, a.y * k, a.z * k)
}

/// Component by component.
pub(crate) fn add3(a: DVec3, b: DVec3) -> DVec3 {
    DVec3::new(a.x + b.x, a.y + b.y, a.z + b.z)
}

/// `sqrt(((x·x + y·y) + z·z) + w·w)`.
pub(crate) fn length4(q: DQuat) -> f64 {
    sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w)
}

/// Each component divided by [`length4`].
pub(crate) fn normalised(q: DQuat) -> DQuat {
    let n = length4(q);
    DQuat::from_xyzw(q.x / n, q.y / n, q.z / n, q.w / n)
}

/// Hamilton product `a b`: first the turn `b`, then the turn `a` (RECKONING 1.3 gives the order of the sums).
pub(crate) fn product(a: DQuat, b: DQuat) -> DQuat {
    DQuat::from_xyzw(
        a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
        a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
        a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
        a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
    )
}

/// A vector turned by a unit quaternion (RECKONING 1.3).
pub(crate) fn turned(q: DQuat, v: DVec3) -> DVec3 {
    let r = DVec3::new(q.x, q.y, q.z);
    let t = scale3(cross3(r, v), 2.0);
    add3(add3(v, scale3(t, q.w)), cross3(r, t))
}

/// The reverse turn of a unit quaternion.
pub(crate) fn conjugate(q: DQuat) -> DQuat {
    DQuat::from_xyzw(-q.x, -q.y, -q.z, q.w)
}

/// Two over pi, to the nearest double.
pub(crate) const TWO_OVER_PI: f64 = f64::from_bits(0x3FE4_5F30_6DC9_C883);
/// The first 33 bits of pi/2, so that a multiple of up to 20 bits is exact.
pub(crate) const HALF_PI_HIGH: f64 = f64::from_bits(0x3FF9_21FB_5440_0000);
/// Pi/2 less [`HALF_PI_HIGH`], to the nearest double.
pub(crate) const HALF_PI_LOW: f64 = f64::from_bits(0x3DD0_B461_1A62_6331);

/// Taylor coefficients of sine, x³ to x¹³. The first term left out is below 2.1e-14 at pi/4.
pub(crate) const SINE: [f64; 6] = [
    -1.0 / 6.0,
    1.0 / 120.0,
    -1.0 / 5_040.0,
    1.0 / 362_880.0,
    -1.0 / 39_916_800.0,
    1.0 / 6_227_020_800.0,
];
/// Taylor coefficients of cosine, x² to x¹⁴. The first term left out is below 1.1e-15 at pi/4.
pub(crate) const COSINE: [f64; 7] = [
    -1.0 / 2.0,
    1.0 / 24.0,
    -1.0 / 720.0,
    1.0 / 40_320.0,
    -1.0 / 3_628_800.0,
    1.0 / 479_001_600.0,
    -1.0 / 87_178_291_200.0,
];

/// Sine and cosine of an angle in radians (RECKONING 1.4).
///
/// Range: |x| ≤ [`ANGLE_LIMIT`]. Error: below 3e-14 there. A larger angle counts as zero: the result is finite and
/// equal on every platform. No stream within the protocol's limits comes near it.
pub(crate) fn sin_cos(x: f64) -> (f64, f64) {
    // Written so that NaN fails too.
    let in_range = x.abs() <= ANGLE_LIMIT;
    if !in_range {
        return (0.0, 1.0);
    }
    let quarters = floor(x * TWO_OVER_PI + 0.5);
    let r = (x - quarters * HALF_PI_HIGH) - quarters * HALF_PI_LOW;
    let r2 = r * r;
    let sine = r + r * (r2 * polynomial(&SINE, r2));
    let cosine = 1.0 + r2 * polynomial(&COSINE, r2);
    // In range the quotient is below 2^20, so the cast is exact; two's complement keeps the low bits of a negative.
    match (quarters as i64) & 3 {
        0 => (sine, cosine),
        1 => (cosine, -sine),
        2 => (-sine, -cosine),
        _ => (-cosine, sine),
    }
}

/// The largest angle whose reduction by [`HALF_PI_HIGH`] is exact, rounded down: 2²⁰ quarter turns is 1.6 million.
pub(crate) const ANGLE_LIMIT: f64 = 1.0e6;

/// Horner's rule from the highest coefficient down.
fn polynomial(coefficients: &[f64], x: f64) -> f64 {
    let mut sum = 0.0;
    for c in coefficients.iter().rev() {
        sum = sum * x + c;
    }
    sum
}

/// The quaternion of a turn by twice `half_angle` about `axis`, which has length `length` > 0.
pub(crate) fn turn_about(axis: DVec3, length: f64, half_angle: f64) -> DQuat {
    let (sine, cosine) = sin_cos(half_angle);
    let k = sine / length;
    DQuat::from_xyzw(axis.x * k, axis.y * k, axis.z * k, cosine)
}

/// The quaternion of a rotation vector (axis times angle, radians); zero gives the identity.
pub(crate) fn turn_by(vector: DVec3) -> DQuat {
    let angle = length3(vector);
    if angle == 0.0 {
        return DQuat::IDENTITY;
    }
    turn_about(vector, angle, 0.5 * angle)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn sine_and_cosine_agree_with_the_library(x in -2_000.0_f64..2_000.0) {
            let (s, c) = sin_cos(x);
            prop_assert!((s - libm::sin(x)).abs() < 3e-14);
            prop_assert!((c - libm::cos(x)).abs() < 3e-14);
        }

        #[test]
        fn a_floor_agrees_with_the_library(x in prop_oneof![-3.0_f64..3.0, -1e17_f64..1e17, any::<f64>()]) {
            prop_assert!(floor(x) == libm::floor(x) || x.is_nan() && floor(x).is_nan());
        }

        #[test]
        fn a_turn_is_of_unit_length(x in -10.0_f64..10.0, y in -10.0_f64..10.0, z in -10.0_f64..10.0) {
            let q = turn_by(DVec3::new(x, y, z));
            prop_assert!((length4(q) - 1.0).abs() < 1e-13);
        }
    }

    proptest! {
        #[test]
        fn a_whole_number_is_the_floor_within_its_range(x in prop_oneof![-3.0_f64..3.0, -3e9_f64..3e9, any::<f64>()]) {
            let floor = libm::floor(x).clamp(-2_147_483_648.0, 2_147_483_647.0);
            prop_assert_eq!(floor_to_i32(x), floor as i32);
        }
    }

    #[test]
    fn an_angle_beyond_the_limit_counts_as_zero() {
        for x in [f64::INFINITY, f64::NAN, -1e300] {
            assert_eq!(sin_cos(x), (0.0, 1.0));
        }
    }

    #[test]
    fn the_product_turns_first_by_the_right_factor() {
        let quarter = core::f64::consts::FRAC_PI_2;
        let about_x = turn_by(DVec3::X * quarter);
        let about_y = turn_by(DVec3::Y * quarter);
        let turned = product(about_y, about_x) * DVec3::Z;
        // Z goes to -Y about x, and -Y stays about y.
        assert!((turned - DVec3::NEG_Y).length() < 1e-12);
    }
}
