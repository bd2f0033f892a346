//! A body to add, as plain fields in the coordinates of the application.

use glam::{Quat, Vec3};
use rhumb_client::Damping;
use rhumb_client::ToleranceScale;
use rhumb_client::scene::{
    BodyBuilder, BodyDesc, BodyKind, CollisionGroups, LockedAxes, Mass, Material, Shape, Sleep,
};

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
