//! Builder of a body: its description, shape, pose and velocity.
//!
//! Sends nothing. A client assigns the ids of body and shape when it adds the body.

use glam::{Quat, Vec3};
use rhumb_reckoning::{BodyId, BodyState, Damping, ToleranceScale};

use super::body::{BodyDesc, BodyKind, CollisionGroups, LockedAxes, Mass};
use super::checks::Invalid;
use super::command::Command;
use super::shape::{Shape, ShapeId};
use super::{Material, Sleep};

/// A body to add: the content of [`BodyDesc`], its shape, its pose and its velocity.
///
/// Lengths in metres, world frame. A new one is at rest at the origin, unturned, with the scene's material and
/// damping.
#[derive(Clone, Debug, PartialEq)]
pub struct BodyBuilder {
    /// The description; its ids are placeholders until the body is added.
    desc: BodyDesc,
    shape: Shape,
    position: Vec3,
    rotation: Quat,
    linear: Vec3,
    angular: Vec3,
}

impl BodyDesc {
    /// A body that the engine moves.
    #[must_use]
    pub const fn dynamic(shape: Shape) -> BodyBuilder {
        BodyBuilder::new(BodyKind::Dynamic, shape)
    }

    /// A body that nothing moves, such as a floor.
    #[must_use]
    pub const fn fixed(shape: Shape) -> BodyBuilder {
        BodyBuilder::new(BodyKind::Fixed, shape)
    }

    /// A body that its client moves, by commands or by authority. It pushes others and is not pushed.
    #[must_use]
    pub const fn kinematic(shape: Shape) -> BodyBuilder {
        BodyBuilder::new(BodyKind::Kinematic, shape)
    }
}

impl BodyBuilder {
    const fn new(kind: BodyKind, shape: Shape) -> Self {
        Self::of(BodyDesc::plain(BodyId::new(0, 0), kind, ShapeId(0)), shape)
    }

    /// A body of this description, whose ids mean nothing, at rest at the origin.
    #[must_use]
    pub const fn of(desc: BodyDesc, shape: Shape) -> Self {
        Self {
            desc,
            shape,
            position: Vec3::ZERO,
            rotation: Quat::IDENTITY,
            linear: Vec3::ZERO,
            angular: Vec3::ZERO,
        }
    }

    /// Sets the start of its centre of mass, metres.
    #[must_use]
    pub const fn at(mut self, x: f32, y: f32, z: f32) -> Self {
        self.position = Vec3::new(x, y, z);
        self
    }

    /// Sets the start of its centre of mass, metres.
    #[must_use]
    pub fn position(mut self, position: impl Into<Vec3>) -> Self {
        self.position = position.into();
        self
    }

    /// Sets its rotation at the start, body → world.
    #[must_use]
    pub fn rotation(mut self, rotation: impl Into<Quat>) -> Self {
        self.rotation = rotation.into();
        self
    }

    /// Sets the velocity of its centre of mass at the start, m/s.
    #[must_use]
    pub fn linear_velocity(mut self, linear: impl Into<Vec3>) -> Self {
        self.linear = linear.into();
        self
    }

    /// Sets its spin at the start, rad/s about world axes.
    #[must_use]
    pub fn angular_velocity(mut self, angular: impl Into<Vec3>) -> Self {
        self.angular = angular.into();
        self
    }

    /// The body with its shape moved so that the centre of mass is the shape's own, and the centre: where it was, in
    /// the axes of the body. The body lies where it would with the shape as it was given, and its pose is that of the
    /// centre.
    ///
    /// Does nothing to a shape whose centre is its origin: see [`Shape::centred`].
    #[must_use]
    pub fn centred(mut self) -> (Self, Vec3) {
        let (shape, centre) = self.shape.centred();
        // A rotation that is not finite is refused under its own name.
        if self.rotation.is_finite() {
            self.position += self.rotation * centre;
        }
        self.shape = shape;
        (self, centre)
    }

    /// The centre of mass of its shape, metres in the axes of the body, where the engine would turn the body about
    /// another point: its origin. `None` for a body that is not dynamic or has moments of inertia of its own.
    #[must_use]
    pub fn off_centre(&self) -> Option<Vec3> {
        let has_moments = self.desc.mass.is_some_and(|mass| mass.moments.is_some());
        let is_concerned = self.desc.kind == BodyKind::Dynamic && !has_moments;
        is_concerned.then(|| self.shape.centre()).flatten()
    }

    /// True if [`Self::off_centre`] is the same for another body.
    #[must_use]
    pub fn is_turned_like(&self, other: &Self) -> bool {
        self.desc.kind == other.desc.kind
            && self.desc.mass == other.desc.mass
            && self.shape == other.shape
    }

    /// Sets its own material in place of the scene's.
    #[must_use]
    pub const fn material(mut self, material: Material) -> Self {
        self.desc.material = Some(material);
        self
    }

    /// Sets its own damping in place of the scene's.
    #[must_use]
    pub const fn damping(mut self, damping: Damping) -> Self {
        self.desc.damping = Some(damping);
        self
    }

    /// Sets its factor on the scene's gravity.
    #[must_use]
    pub const fn gravity_scale(mut self, factor: f32) -> Self {
        self.desc.gravity_scale = factor;
        self
    }

    /// Sets the power of two on its streams' tolerance.
    #[must_use]
    pub const fn tolerance_scale(mut self, tolerance_scale: ToleranceScale) -> Self {
        self.desc.tolerance_scale = tolerance_scale;
        self
    }

    /// Keeps the axis of its spin even if its moments of inertia differ.
    #[must_use]
    pub const fn without_gyroscopic_forces(mut self) -> Self {
        self.desc.gyroscopic = false;
        self
    }

    /// Prevents rotation by the engine; only commands turn it.
    #[must_use]
    pub const fn with_locked_rotation(self) -> Self {
        self.locked_axes(LockedAxes::ROTATIONS)
    }

    /// Sets the world axes along or about which the engine does not move it.
    #[must_use]
    pub const fn locked_axes(mut self, locked: LockedAxes) -> Self {
        self.desc.locked = locked;
        self
    }

    /// Sets its mass, kg; its moments of inertia are in proportion.
    #[must_use]
    pub const fn mass(mut self, mass: f32) -> Self {
        let moments = None;
        self.desc.mass = Some(Mass { mass, moments });
        self
    }

    /// Sets its mass, with its moments of inertia if they are not those of its shape.
    #[must_use]
    pub const fn mass_of(mut self, mass: Mass) -> Self {
        self.desc.mass = Some(mass);
        self
    }

    /// Sets the groups that decide which bodies it touches.
    #[must_use]
    pub const fn collision_groups(mut self, groups: CollisionGroups) -> Self {
        self.desc.groups = groups;
        self
    }

    /// Sets its dominance over bodies that it touches.
    #[must_use]
    pub const fn dominance(mut self, dominance: i8) -> Self {
        self.desc.dominance = dominance;
        self
    }

    /// Lets bodies pass through it.
    #[must_use]
    pub const fn as_sensor(mut self) -> Self {
        self.desc.sensor = true;
        self
    }

    /// Sweeps it against moving bodies, so that it does not pass through them between two steps.
    #[must_use]
    pub const fn swept(mut self) -> Self {
        self.desc.swept = true;
        self
    }

    /// Sets its own conditions of sleep in place of the scene's.
    #[must_use]
    pub const fn sleep(mut self, sleep: Sleep) -> Self {
        self.desc.sleep = Some(sleep);
        self
    }

    /// Its shape.
    #[must_use]
    pub const fn shape(&self) -> &Shape {
        &self.shape
    }

    /// Its kind.
    #[must_use]
    pub const fn kind(&self) -> BodyKind {
        self.desc.kind
    }

    /// Its description, for these ids of body and shape.
    #[must_use]
    pub const fn desc(&self, id: BodyId, shape: ShapeId) -> BodyDesc {
        BodyDesc {
            id,
            shape,
            ..self.desc
        }
    }

    /// Checks every number: of the shape, of the description, and of the start.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first that is wrong.
    pub fn check(&self) -> Result<(), Invalid> {
        self.shape.check()?;
        self.desc.check()?;
        Command::check_pose(self.position, self.rotation)?;
        Command::check_velocity(self.linear, self.angular)
    }

    /// Its pose and velocity at the start.
    ///
    /// # Errors
    ///
    /// [`Invalid`] for a number that is not finite, or a rotation that is not of unit length.
    pub fn state(&self) -> Result<BodyState, Invalid> {
        let state = BodyState::new(
            self.position.to_array(),
            self.rotation.to_array(),
            self.linear.to_array(),
            self.angular.to_array(),
        );
        state.map_err(Invalid::from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Quantity;

    #[test]
    fn a_built_body_has_the_values_of_its_builder() {
        let body = BodyDesc::dynamic(Shape::ball(0.5))
            .at(1.0, 2.0, 3.0)
            .linear_velocity([0.0, 0.0, 4.0])
            .gravity_scale(0.0)
            .with_locked_rotation();
        let id = BodyId::new(7, 1);
        let expected = BodyDesc {
            gravity_scale: 0.0,
            locked: LockedAxes::ROTATIONS,
            ..BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(3))
        };
        assert_eq!(body.desc(id, ShapeId(3)), expected);
        let state = body.state().unwrap();
        assert_eq!(state.position(), [1.0, 2.0, 3.0]);
        assert_eq!(state.parts()[7..], [0.0, 0.0, 4.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn an_invalid_number_is_named_in_the_error() {
        let ball = |radius| BodyDesc::fixed(Shape::ball(radius));
        assert_eq!(ball(0.5).check(), Ok(()));
        for (body, invalid) in [
            (
                ball(0.5).at(0.0, f32::NAN, 0.0),
                Invalid::not_finite(Quantity::Position),
            ),
            (
                ball(0.5).at(1e9, 0.0, 0.0),
                Invalid::out_of_range(Quantity::Position),
            ),
            (ball(-1.0), Invalid::out_of_range(Quantity::Extent)),
            (
                ball(0.5).gravity_scale(f32::NAN),
                Invalid::not_finite(Quantity::GravityScale),
            ),
        ] {
            assert_eq!(body.check(), Err(invalid));
        }
    }
}
