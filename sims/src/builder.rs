//! Builder of a script's shapes and bodies; assigns ids in order.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, Shape, ShapeId};
use rhumb_reckoning::{BodyId, BodyState};

use crate::defaults::still;

/// The next free ids.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SceneBuilder {
    bodies: u32,
    shapes: u32,
}

impl SceneBuilder {
    pub(crate) fn shape(&mut self, shape: Shape, out: &mut Vec<Command>) -> ShapeId {
        let id = ShapeId(self.shapes);
        self.shapes += 1;
        out.push(Command::AddShape { id, shape });
        id
    }

    /// Adds a body with the scene's default material and damping.
    pub(crate) fn body(
        &mut self,
        kind: BodyKind,
        shape: ShapeId,
        motion: BodyState,
        out: &mut Vec<Command>,
    ) -> BodyId {
        self.with(|id| BodyDesc::plain(id, kind, shape), motion, out)
    }

    /// Adds a body with any descriptor.
    pub(crate) fn with(
        &mut self,
        desc: impl FnOnce(BodyId) -> BodyDesc,
        motion: BodyState,
        out: &mut Vec<Command>,
    ) -> BodyId {
        let id = BodyId::new(self.bodies, 0);
        self.bodies += 1;
        let desc = desc(id);
        out.push(Command::AddBody { desc, motion });
        id
    }

    /// Adds a slab with its top at y = 0 that reaches `half` metres each way, thick enough to prevent tunnelling.
    pub(crate) fn floor(&mut self, half: f32, out: &mut Vec<Command>) -> BodyId {
        let half_extents = Vec3::new(half, 5.0, half);
        let slab = self.shape(Shape::Cuboid { half_extents }, out);
        let place = still(Vec3::new(0.0, -5.0, 0.0));
        self.body(BodyKind::Fixed, slab, place, out)
    }
}

/// Rotation about y by an angle, radians.
pub(crate) fn about_y(angle: f64) -> Quat {
    let (sin, cos) = (libm::sin(angle * 0.5), libm::cos(angle * 0.5));
    Quat::from_xyzw(0.0, sin as f32, 0.0, cos as f32)
}

/// Rotation about z by an angle, radians.
pub(crate) fn about_z(angle: f64) -> Quat {
    let (sin, cos) = (libm::sin(angle * 0.5), libm::cos(angle * 0.5));
    Quat::from_xyzw(0.0, 0.0, sin as f32, cos as f32)
}
