//! Moments of inertia of a body and their principal axes.
//!
//! Sent once, with the body's description, in the engine's own precision. `torque_free_rotation` computes the rotation
//! that follows from them. Invariant: moments are normal f32 above zero with bounded ratios, and the frame is of unit
//! length: no rotation leads to an infinity (RECKONING 2.6).

use core::fmt;

use glam::{DQuat, DVec3};

use crate::exact;
use crate::motion::UNIT_LENGTH_SLACK;

/// Principal moments of inertia (kg·m²; only their ratios matter) and the rotation principal axes → body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertia {
    moments: [f32; 3],
    frame: [f32; 4],
}

impl Inertia {
    /// A moment may exceed another by this factor at most: 2²⁴, a needle four thousand times as long as wide.
    pub const RATIO_MAX: f64 = 16_777_216.0;
    /// Principal axes that coincide with the body's own.
    pub const OWN_AXES: [f32; 4] = [0.0, 0.0, 0.0, 1.0];
    /// Moments that differ by no more than this share of the greatest are equal: 2⁻²⁰, eight times what f32 rounds off.
    pub const EQUAL: f64 = 1.0 / 1_048_576.0;

    /// Takes moments about three axes, and the quaternion (x, y, z, w) that turns those axes into the body's frame.
    ///
    /// # Errors
    ///
    /// [`InvalidInertia`] names the part that is out of range.
    pub fn new(moments: [f32; 3], frame: [f32; 4]) -> Result<Self, InvalidInertia> {
        if !moments.iter().all(|m| m.is_normal() && *m > 0.0) {
            return Err(InvalidInertia::Moment);
        }
        let inertia = Self { moments, frame };
        let (least, greatest) = inertia.extremes();
        if greatest > least * Self::RATIO_MAX {
            return Err(InvalidInertia::Ratio);
        }
        let length = exact::length4(inertia.raw_frame());
        // Written so that NaN fails too.
        let near_unit = (length - 1.0).abs() <= UNIT_LENGTH_SLACK;
        if !near_unit {
            return Err(InvalidInertia::Frame);
        }
        Ok(inertia)
    }

    /// Moments about the principal axes, kg·m².
    #[must_use]
    pub const fn moments(&self) -> [f32; 3] {
        self.moments
    }

    /// Quaternion x, y, z, w, principal axes → body.
    #[must_use]
    pub const fn frame(&self) -> [f32; 4] {
        self.frame
    }

    /// True if all moments are equal up to rounding: such a body keeps its spin, and its inertia is not sent.
    #[must_use]
    pub fn is_isotropic(&self) -> bool {
        let (least, greatest) = self.extremes();
        greatest - least <= greatest * Self::EQUAL
    }

    fn extremes(&self) -> (f64, f64) {
        let [a, b, c] = self.moments.map(f64::from);
        (a.min(b).min(c), a.max(b).max(c))
    }

    fn raw_frame(&self) -> DQuat {
        DQuat::from_array(self.frame.map(f64::from))
    }

    /// The moments, widened.
    pub(crate) fn wide_moments(&self) -> DVec3 {
        DVec3::from_array(self.moments.map(f64::from))
    }

    /// The frame, widened and normalised.
    pub(crate) fn unit_frame(&self) -> DQuat {
        exact::normalised(self.raw_frame())
    }
}

/// Reason why numbers are not an inertia.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum InvalidInertia {
    /// A moment is not a normal number above zero.
    Moment,
    /// A moment exceeds another by more than [`Inertia::RATIO_MAX`].
    Ratio,
    /// The frame is not a finite quaternion of unit length.
    Frame,
}

impl fmt::Display for InvalidInertia {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Moment => "a moment of inertia is not a normal number above zero",
            Self::Ratio => "moments of inertia are too far apart",
            Self::Frame => "the principal frame is not a finite quaternion of unit length",
        })
    }
}

impl core::error::Error for InvalidInertia {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_inertia_is_refused() {
        let own = Inertia::OWN_AXES;
        for wrong in [0.0, -1.0, f32::NAN, f32::INFINITY, f32::MIN_POSITIVE / 2.0] {
            let refused = Inertia::new([1.0, wrong, 1.0], own);
            assert_eq!(refused, Err(InvalidInertia::Moment));
        }
        let needle = Inertia::new([1.0, 1e-8, 1.0], own);
        assert_eq!(needle, Err(InvalidInertia::Ratio));
        for frame in [[0.0; 4], [0.0, 0.0, 0.0, 1.01], [f32::NAN, 0.0, 0.0, 1.0]] {
            assert_eq!(Inertia::new([1.0; 3], frame), Err(InvalidInertia::Frame));
        }
    }

    #[test]
    fn moments_that_differ_by_rounding_only_are_equal() {
        let of = |moments| Inertia::new(moments, Inertia::OWN_AXES).unwrap();
        assert!(of([2.0; 3]).is_isotropic());
        assert!(of([3.0, 3.000_000_5, 3.0]).is_isotropic());
        assert!(!of([3.0, 3.00001, 3.0]).is_isotropic());
        assert!(!of([1.0, 2.0, 2.0]).is_isotropic());
    }
}
