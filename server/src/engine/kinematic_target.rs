//! Target of a kinematic body for the next step.
//!
//! No engine here. Poses are kept in f64, so that a velocity kept for hours ends at the right place. A turn is the
//! normalised linear substep of free bodies (RECKONING 2.4), so that predictors of free spin predict it.

use glam::{DQuat, DVec3};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::{Integrator, Pose, Twist};

/// Commanded motion of one kinematic body.
#[derive(Clone, Copy, Debug)]
pub(super) struct KinematicTarget {
    /// Present pose.
    pose: Pose,
    /// Velocities that it keeps.
    twist: Twist,
    /// Pose of the next step.
    target: Option<Pose>,
    /// Velocities of the last step, unless it went to a target.
    kept: Option<Twist>,
}

impl KinematicTarget {
    /// A body that stands still.
    pub(super) const fn at(pose: Pose) -> Self {
        Self {
            pose,
            twist: Twist::ZERO,
            target: None,
            kept: None,
        }
    }

    /// Sets the pose of the next step; the body stands still there.
    pub(super) const fn go_to(&mut self, pose: Pose) {
        self.target = Some(pose);
        self.twist = Twist::ZERO;
    }

    /// Keeps velocities from the next step on, or from the target on if one is set.
    pub(super) const fn keep(&mut self, twist: Twist) {
        self.twist = twist;
    }

    /// Present pose.
    #[cfg(feature = "box3d")]
    pub(super) const fn pose(&self) -> Pose {
        self.pose
    }

    /// True if it moves in the next step.
    pub(super) fn is_moving(&self) -> bool {
        self.target.is_some() || self.twist != Twist::ZERO
    }

    /// Its velocities in the last step, unless that went to a target: then the engine has them.
    pub(super) const fn kept(&self) -> Option<Twist> {
        self.kept
    }

    /// The velocities that it keeps, unless its next step goes to a target.
    pub(super) const fn keeps(&self) -> Option<Twist> {
        match self.target {
            Some(_) => None,
            None => Some(self.twist),
        }
    }

    /// The rotation at the end of a step at the velocities that it keeps.
    pub(super) fn turned(&self, integrator: Integrator) -> DQuat {
        carried(self.pose, self.twist, integrator).rotation
    }

    /// Ends a step at another pose than its velocities lead to; the engine has its velocities of that step.
    pub(super) const fn arrive(&mut self, pose: Pose) {
        (self.pose, self.kept) = (pose, None);
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

impl Wire for KinematicTarget {
    fn encode(&self, to: &mut Writer) {
        encode_pose(self.pose, to);
        encode_twist(self.twist, to);
        to.u8(u8::from(self.target.is_some()) | u8::from(self.kept.is_some()) << 1);
        if let Some(target) = self.target {
            encode_pose(target, to);
        }
        if let Some(kept) = self.kept {
            encode_twist(kept, to);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let (pose, twist) = (decode_pose(from)?, decode_twist(from)?);
        let present = from.u8()?;
        let mut target = None;
        if present & 1 != 0 {
            target = Some(decode_pose(from)?);
        }
        let mut kept = None;
        if present & 2 != 0 {
            kept = Some(decode_twist(from)?);
        }
        Ok(Self {
            pose,
            twist,
            target,
            kept,
        })
    }
}

fn encode_f64s(values: &[f64], to: &mut Writer) {
    for value in values {
        to.raw(&value.to_le_bytes());
    }
}

fn decode_f64s<const N: usize>(from: &mut Reader<'_>) -> Result<[f64; N], Malformed> {
    let mut values = [0.0; N];
    for value in &mut values {
        let bytes = from.raw(8)?.try_into().map_err(|_| Malformed::Truncated)?;
        *value = f64::from_le_bytes(bytes);
    }
    Ok(values)
}

fn encode_pose(pose: Pose, to: &mut Writer) {
    encode_f64s(&pose.position.to_array(), to);
    encode_f64s(&pose.rotation.to_array(), to);
}

fn decode_pose(from: &mut Reader<'_>) -> Result<Pose, Malformed> {
    Ok(Pose {
        position: DVec3::from_array(decode_f64s(from)?),
        rotation: DQuat::from_array(decode_f64s(from)?),
    })
}

fn encode_twist(twist: Twist, to: &mut Writer) {
    encode_f64s(&twist.linear.to_array(), to);
    encode_f64s(&twist.angular.to_array(), to);
}

fn decode_twist(from: &mut Reader<'_>) -> Result<Twist, Malformed> {
    Ok(Twist {
        linear: DVec3::from_array(decode_f64s(from)?),
        angular: DVec3::from_array(decode_f64s(from)?),
    })
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
    fn sixty_steps_move_a_body_by_one_second_of_its_velocity() {
        let mut kinematic_target = KinematicTarget::at(Pose::IDENTITY);
        kinematic_target.keep(Twist {
            linear: DVec3::new(3.0, 0.0, 0.0),
            angular: DVec3::new(0.0, 1.0, 0.0),
        });
        let mut pose = Pose::IDENTITY;
        for _ in 0..60 {
            pose = kinematic_target.advance(INTEGRATOR);
        }
        assert!((pose.position - DVec3::new(3.0, 0.0, 0.0)).length() < 1e-12);
        let turned = 2.0 * pose.rotation.y.atan2(pose.rotation.w);
        assert!((turned - 1.0).abs() < 1e-5, "{turned}");
    }

    #[test]
    fn a_pose_replaces_earlier_velocities_and_precedes_later_ones() {
        let target = Pose {
            position: DVec3::new(0.0, 5.0, 0.0),
            ..Pose::IDENTITY
        };
        let twist = Twist {
            linear: DVec3::X,
            ..Twist::ZERO
        };
        let mut kinematic_target = KinematicTarget::at(Pose::IDENTITY);
        kinematic_target.keep(twist);
        kinematic_target.go_to(target);
        assert_eq!(kinematic_target.advance(INTEGRATOR), target);
        assert_eq!(kinematic_target.kept(), None);
        assert!(!kinematic_target.is_moving());
        kinematic_target.go_to(target);
        kinematic_target.keep(twist);
        kinematic_target.advance(INTEGRATOR);
        assert!(kinematic_target.advance(INTEGRATOR).position.x > 0.0);
        assert_eq!(kinematic_target.kept(), Some(twist));
    }
}
