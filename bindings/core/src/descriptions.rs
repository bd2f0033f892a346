//! Bodies and joints to add, and states of bodies, as plain fields.
//!
//! All are in the coordinates of the application.

use std::f32::consts::PI;

use glam::{Quat, Vec3};
use rhumb_client::scene::{
    BodyBuilder, BodyDesc, BodyKind, CollisionGroups, Command, Joint, JointFrame, JointKind,
    JointLimits, JointStrength, LockedAxes, Mass, Material, Motor, Shape, Sleep, Spring,
};
use rhumb_client::{BodyId, ClientError, Damping, Misuse, ToleranceScale};

use crate::coordinates::Coordinates;
use crate::error::BindingError;

/// A body to add. A new one is at rest at the origin, unturned, with the scene's material and damping.
#[derive(Clone, Debug, PartialEq)]
pub struct BodyParams {
    /// Kind of its motion.
    pub kind: BodyKind,
    /// Its shape, in units of length of the application.
    pub shape: Shape,
    /// Origin of its shape, which is its centre of mass but for hulls and compounds.
    pub position: Vec3,
    /// Body → world.
    pub rotation: Quat,
    /// Units of length per second.
    pub linear_velocity: Vec3,
    /// rad/s about world axes.
    pub angular_velocity: Vec3,
    /// `None`: the scene's. Its density is in kg/m³.
    pub material: Option<Material>,
    /// `None`: the scene's; 1/s.
    pub damping: Option<Damping>,
    /// Kilograms; `None`: volume times density.
    pub mass: Option<f32>,
    /// Moments of inertia about its own axes, kg·m² in any coordinates; `None`: those of its shape. Needs a mass.
    pub moments: Option<Vec3>,
    /// Factor on the scene's gravity.
    pub gravity_scale: f32,
    /// World axes along or about which the engine does not move it, in the application's order.
    pub locked_axes: LockedAxes,
    /// Groups that decide which bodies it touches.
    pub groups: CollisionGroups,
    /// Power of two on its streams' tolerance.
    pub tolerance_scale: ToleranceScale,
    /// True if bodies pass through it.
    pub sensor: bool,
    /// True if it is swept against moving bodies.
    pub swept: bool,
    /// True if its axis of spin wanders when its moments of inertia differ, as in physics.
    pub gyroscopic: bool,
    /// Conditions under which it falls asleep, speeds in units of length per second; `None`: the scene's.
    pub sleep: Option<Sleep>,
}

impl BodyParams {
    /// A body of this kind and shape at the origin.
    #[must_use]
    pub const fn new(kind: BodyKind, shape: Shape) -> Self {
        Self {
            kind,
            shape,
            position: Vec3::ZERO,
            rotation: Quat::IDENTITY,
            linear_velocity: Vec3::ZERO,
            angular_velocity: Vec3::ZERO,
            material: None,
            damping: None,
            mass: None,
            moments: None,
            gravity_scale: 1.0,
            locked_axes: LockedAxes::NONE,
            groups: CollisionGroups::ALL,
            tolerance_scale: ToleranceScale::USUAL,
            sensor: false,
            swept: false,
            gyroscopic: true,
            sleep: None,
        }
    }

    /// The body in Rhumb's coordinates.
    ///
    /// # Errors
    ///
    /// [`BindingError::Invalid`] for a shape with a number that is not finite or outside the limits.
    pub fn builder(&self, coordinates: Coordinates) -> Result<BodyBuilder, BindingError> {
        let shape = coordinates.shape_in(self.shape.clone())?;
        let plain = match self.kind {
            BodyKind::Fixed => BodyDesc::fixed(shape),
            BodyKind::Dynamic => BodyDesc::dynamic(shape),
            BodyKind::Kinematic => BodyDesc::kinematic(shape),
        };
        let mut builder = plain
            .position(coordinates.vector_in(self.position))
            .rotation(coordinates.rotation_in(self.rotation))
            .linear_velocity(coordinates.vector_in(self.linear_velocity))
            .angular_velocity(coordinates.angular_in(self.angular_velocity))
            .gravity_scale(self.gravity_scale)
            .locked_axes(coordinates.locked_axes_in(self.locked_axes))
            .collision_groups(self.groups)
            .tolerance_scale(self.tolerance_scale);
        if let Some(material) = self.material {
            builder = builder.material(material);
        }
        if let Some(damping) = self.damping {
            builder = builder.damping(damping);
        }
        match (self.mass, self.moments) {
            (None, None) => {}
            (None, Some(_)) => {
                return Err(BindingError::Argument {
                    argument: "moments",
                    needed: "beside a mass",
                });
            }
            (Some(mass), moments) => {
                let moments = moments.map(|moments| coordinates.moments_in(moments));
                builder = builder.mass_of(Mass { mass, moments });
            }
        }
        if self.sensor {
            builder = builder.as_sensor();
        }
        if self.swept {
            builder = builder.swept();
        }
        if !self.gyroscopic {
            builder = builder.without_gyroscopic_forces();
        }
        if let Some(sleep) = self.sleep {
            builder = builder.sleep(coordinates.sleep_in(sleep));
        }
        Ok(builder)
    }
}

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

/// A joint. Fields that its freedom does not name are ignored, except limits and motors of axes that it does not leave free.
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
            frames: [JointFrame::at(Vec3::ZERO); 2],
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

/// State of a body: one that the application moves, or one of the copy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StateRecord {
    /// The body.
    pub body: BodyId,
    /// Centre of mass, or the origin of a hull or compound that this client added.
    pub position: Vec3,
    /// Body → world.
    pub rotation: Quat,
    /// Units of length per second.
    pub linear_velocity: Vec3,
    /// rad/s about world axes.
    pub angular_velocity: Vec3,
}

impl StateRecord {
    /// Checks each number as a command that sets it does. Metres.
    pub(crate) fn check(&self) -> Result<(), BindingError> {
        let pose = Command::SetPose {
            id: self.body,
            position: self.position,
            rotation: self.rotation,
        };
        let velocity = Command::SetVelocity {
            id: self.body,
            linear: self.linear_velocity,
            angular: self.angular_velocity,
        };
        let named = |cause| ClientError::Misuse(Misuse::State(self.body, cause)).into();
        let checked = pose.check().and_then(|()| velocity.check());
        checked.map_err(named)
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
