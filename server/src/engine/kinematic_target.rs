//! Where a kinematic body goes next.
//!
//! Knows no engine. Poses are kept in f64, so that a velocity kept for hours ends where it should; a turn is the
//! normalised linear substep of free bodies (RECKONING 2.4), so that those who predict a free spin predict this one.

use glam::{DQuat, DVec3};
use rhumb_reckoning::{Integrator, Pose, Twist};

/// The wishes for one kinematic body that moves.
#[derive(Clone, Copy, Debug)]
pub(super) struct KinematicTarget {
    /// Where it is.
    pose: Pose,
    /// What it keeps.
    twist: Twist,
    /// Where it goes first.
    target: Option<Pose>,
    /// The velocities by which the last step went, if not to a target.
    kept: Option<Twist>,
}

impl KinematicTarget {
    /// Standing still.
    pub(super) const fn at(pose: Pose) -> Self {
        Self {
            pose,
            twist: Twist::ZERO,
            target: None,
            kept: None,
        }
    }

    /// Goes to a pose in the next step, and stands there.
    pub(super) const fn go_to(&mut self, pose: Pose) {
        self.target = Some(pose);
        self.twist = Twist::ZERO;
    }

    /// Keeps velocities from the next step on, or from the pose on that it was told to go to first.
    pub(super) const fn keep(&mut self, twist: Twist) {
        self.twist = twist;
    }

    /// Whether it would move in the next step.
    pub(super) fn moves(&self) -> bool {
        self.target.is_some() || self.twist != Twist::ZERO
    }

    /// Its velocities in the last step, unless that went to a target: then the engine knows them.
    pub(super) const fn kept(&self) -> Option<Twist> {
        self.kept
    }

    /// The pose at the end of the next step.
    pub(super) fn advance(&mut self, integrator: Integrator) -> Pose {
        (self.pose, self.kept) = match self.target.take() {
            Some(target) => (target, None),
            None => (carried(self.pose, self.twist, integrator), Some(self.twist)),
        };
        self.pose
    }
}

/// A pose after one tick at constant velocities.
fn carried(pose: Pose, twist: Twist, integrator: Integrator) -> Pose {
    let dt = integrator.rate.step().seconds();
    let substeps = integrator.substeps.get();
    let half = dt / f64::from(substeps) * 0.5;
    let spin = twist.angular * half;
    let mut rotation = pose.rotation;
    if spin != DVec3::ZERO {
        for _ in 0..substeps {
            let turn = DQuat::from_xyzw(spin.x, spin.y, spin.z, 0.0) * rotation;
            rotation = (rotation + turn).normalize();
        }
    }
    Pose {
        position: pose.position + twist.linear * dt,
        rotation,
    }
}

#[cfg(test)]
mod tests {
    use core::num::NonZeroU32;

    use rhumb_reckoning::Rate;

    use super::*;

    const INTEGRATOR: Integrator = Integrator {
        rate: Rate::HZ_60,
        substeps: NonZeroU32::new(4).unwrap(),
    };

    #[test]
    fn kept_velocities_carry_a_body_a_second_far_in_sixty_steps() {
        let mut drive = KinematicTarget::at(Pose::IDENTITY);
        drive.keep(Twist {
            linear: DVec3::new(3.0, 0.0, 0.0),
            angular: DVec3::new(0.0, 1.0, 0.0),
        });
        let mut pose = Pose::IDENTITY;
        for _ in 0..60 {
            pose = drive.advance(INTEGRATOR);
        }
        assert!((pose.position - DVec3::new(3.0, 0.0, 0.0)).length() < 1e-12);
        let turned = 2.0 * pose.rotation.y.atan2(pose.rotation.w);
        assert!((turned - 1.0).abs() < 1e-5, "{turned}");
    }

    #[test]
    fn a_pose_ends_the_velocities_before_it_and_begins_those_after_it() {
        let target = Pose {
            position: DVec3::new(0.0, 5.0, 0.0),
            ..Pose::IDENTITY
        };
        let twist = Twist {
            linear: DVec3::X,
            ..Twist::ZERO
        };
        let mut drive = KinematicTarget::at(Pose::IDENTITY);
        drive.keep(twist);
        drive.go_to(target);
        assert_eq!(drive.advance(INTEGRATOR), target);
        assert_eq!(drive.kept(), None);
        assert!(!drive.moves());
        drive.go_to(target);
        drive.keep(twist);
        drive.advance(INTEGRATOR);
        assert!(drive.advance(INTEGRATOR).position.x > 0.0);
        assert_eq!(drive.kept(), Some(twist));
    }
}
