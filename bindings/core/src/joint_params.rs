//! A joint, as plain fields in the coordinates of the application.

use std::f32::consts::PI;

use rhumb_client::BodyId;
use rhumb_client::scene::{
    Joint, JointFrame, JointKind, JointLimits, JointStrength, LockedAxes, Motor, Spring,
};

use crate::error::BindingError;

/// The motions that a joint leaves free: those of [`JointKind`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointFreedom {
    /// Nothing.
    Fixed,
    /// Every turn.
    Spherical,
    /// The turn about x of its frames.
    Revolute,
    /// The displacement along x of its frames.
    Prismatic,
    /// Everything, but the anchors are at most `length` apart.
    Rope,
    /// Everything; a spring pulls the anchors.
    Spring,
    /// Every axis that `locked` does not name.
    Generic,
}

/// A joint. What its freedom does not name is ignored, except limits and motors of axes that it does not leave free.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointParams {
    /// The motions that it leaves free.
    pub freedom: JointFreedom,
    /// The bodies, two different ones.
    pub bodies: [BodyId; 2],
    /// Its frame in each body.
    pub frames: [JointFrame; 2],
    /// Of a generic joint: the axes of its frames without motion.
    pub locked: LockedAxes,
    /// Limits along x, y and z, then about them: units of length, radians.
    pub limits: [Option<JointLimits>; 6],
    /// Motors along x, y and z, then about them.
    pub motors: [Option<Motor>; 6],
    /// Of a rope or a spring: units of length.
    pub length: f32,
    /// Of a spring: N/m.
    pub stiffness: f32,
    /// Of a spring: N·s/m.
    pub damping: f32,
    /// True if the two bodies also collide with each other.
    pub collide: bool,
    /// Load at which it breaks; `None`: it never does.
    pub strength: Option<JointStrength>,
}

impl JointParams {
    /// A joint at the centres of two bodies, without limits and motors, that never breaks.
    #[must_use]
    pub const fn new(freedom: JointFreedom, bodies: [BodyId; 2]) -> Self {
        Self {
            freedom,
            bodies,
            frames: [JointFrame::at(glam::Vec3::ZERO); 2],
            locked: LockedAxes::NONE,
            limits: [None; 6],
            motors: [None; 6],
            length: 1.0,
            stiffness: 0.0,
            damping: 0.0,
            collide: false,
            strength: None,
        }
    }

    /// The joint, still in the coordinates of the application.
    ///
    /// # Errors
    ///
    /// [`BindingError::Value`] for a limit or a motor of an axis that cannot have one.
    pub fn joint(&self) -> Result<Joint, BindingError> {
        let kind = self.kind();
        let mut both = self.limits.iter().zip(kind.limits());
        let wrong = both.position(|(given, taken)| given.is_some() && taken.is_none());
        let of_axis = |argument, axis| {
            let needed = "of axes that the joint leaves free";
            BindingError::value(argument, format_args!("of axis {axis}"), needed)
        };
        if let Some(axis) = wrong {
            return Err(of_axis("limits", axis));
        }
        let mut motors = self.motors.iter().enumerate();
        let locked = kind.locked();
        if let Some((axis, _)) = motors.find(|(axis, of)| of.is_some() && locked.locks(*axis)) {
            return Err(of_axis("motors", axis));
        }
        Ok(Joint {
            kind,
            bodies: self.bodies,
            frames: self.frames,
            collide: self.collide,
            motors: self.motors,
            strength: self.strength,
        })
    }

    fn kind(&self) -> JointKind {
        let [x, _, _, about_x, about_y, about_z] = self.limits;
        match self.freedom {
            JointFreedom::Fixed => JointKind::Fixed,
            JointFreedom::Spherical => {
                let turns = [about_x, about_y, about_z];
                let is_limited = turns.iter().any(Option::is_some);
                let all = JointLimits {
                    least: -PI,
                    most: PI,
                };
                let turns = turns.map(|limits| limits.unwrap_or(all));
                JointKind::Spherical(is_limited.then_some(turns))
            }
            JointFreedom::Revolute => JointKind::Revolute(about_x),
            JointFreedom::Prismatic => JointKind::Prismatic(x),
            JointFreedom::Rope => JointKind::Rope(self.length),
            JointFreedom::Spring => JointKind::Spring(Spring {
                length: self.length,
                stiffness: self.stiffness,
                damping: self.damping,
            }),
            JointFreedom::Generic => JointKind::Generic(self.locked, self.limits),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: JointLimits = JointLimits {
        least: -0.5,
        most: 1.0,
    };

    fn limited(freedom: JointFreedom, axis: usize) -> Result<JointKind, BindingError> {
        let mut params = JointParams::new(freedom, [BodyId::new(0, 0), BodyId::new(1, 0)]);
        params.limits[axis] = Some(LIMITS);
        params.joint().map(|joint| joint.kind)
    }

    #[test]
    fn a_limit_belongs_to_an_axis_that_the_joint_leaves_free() {
        let kind = limited(JointFreedom::Revolute, 3).unwrap();
        assert_eq!(kind, JointKind::Revolute(Some(LIMITS)));
        let kind = limited(JointFreedom::Prismatic, 0).unwrap();
        assert_eq!(kind, JointKind::Prismatic(Some(LIMITS)));
        let kind = limited(JointFreedom::Spherical, 4).unwrap();
        assert_eq!(kind.limits()[4], Some(LIMITS));
        for (freedom, axis) in [
            (JointFreedom::Fixed, 0),
            (JointFreedom::Revolute, 4),
            (JointFreedom::Prismatic, 3),
            (JointFreedom::Spherical, 0),
            (JointFreedom::Rope, 0),
            (JointFreedom::Spring, 5),
        ] {
            let error = limited(freedom, axis).expect_err("no such limit");
            let text = format!("limits is of axis {axis}, and must be");
            assert!(error.to_string().starts_with(&text), "{error}");
        }
    }
}
