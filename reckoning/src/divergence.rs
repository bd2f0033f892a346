//! Distance between a predicted and a true pose.
//!
//! Arithmetic on two poses of one body at one tick. Whether the distance matters is not decided here: see `tolerance`.

use crate::exact::{conjugate, length3, product, sqrt};
use crate::motion::Pose;
use crate::units::{Metres, Radians};

/// Distance between two poses of one body at one tick.
///
/// `position`: between centres of mass, world frame, ≥ 0. `half_chord`: sine of half the shortest turn, in [0, 1]; zero
/// exactly when the rotations agree up to the sign of the quaternion. Source: RECKONING 5.1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Divergence {
    /// Between centres of mass.
    pub position: Metres,
    /// Sine of half the shortest turn.
    pub half_chord: f64,
}

impl Divergence {
    /// Distance between a true and a predicted pose.
    #[must_use]
    pub fn between(truth: &Pose, prediction: &Pose) -> Self {
        let apart = length3(truth.position - prediction.position);
        // q and -q are one rotation, and the vector part of their quotient has one length.
        let turn = product(truth.rotation, conjugate(prediction.rotation));
        let half_chord = sqrt(turn.x * turn.x + turn.y * turn.y + turn.z * turn.z).min(1.0);
        Self {
            position: Metres::new(apart),
            half_chord,
        }
    }

    /// Bound on the distance between any point of the body and its prediction: |Δp| + 2 r sin(Δθ/2).
    #[must_use]
    pub fn surface_error(&self, radius: Metres) -> Metres {
        Metres::new(self.position.metres() + 2.0 * radius.metres() * self.half_chord)
    }

    /// The shortest turn, in [0, π].
    #[must_use]
    pub fn turn(&self) -> Radians {
        Radians::new(2.0 * libm::asin(self.half_chord))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};

    #[test]
    fn opposite_quaternions_are_one_rotation() {
        let rotation = DQuat::from_rotation_y(0.7);
        let here = Pose {
            position: DVec3::ZERO,
            rotation,
        };
        let same = Pose {
            position: DVec3::ZERO,
            rotation: -rotation,
        };
        assert!(Divergence::between(&here, &same).half_chord < 1e-15);
    }

    #[test]
    fn surface_error_adds_the_chord_at_the_bounding_radius() {
        let truth = Pose {
            position: DVec3::X * 3.0,
            rotation: DQuat::from_rotation_z(0.2),
        };
        let far = Divergence::between(&truth, &Pose::IDENTITY);
        let expected = 3.0 + 2.0 * 0.5 * libm::sin(0.1);
        assert!((far.surface_error(Metres::new(0.5)).metres() - expected).abs() < 1e-12);
        assert!((far.turn().radians() - 0.2).abs() < 1e-12);
    }
}
