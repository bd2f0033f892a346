//! Solids that were made beside the steps of a scene.

use rhumb_protocol::scene::{Shape, ShapeId};

use super::Scene;
use crate::engine::{BakedShape, Baker, UnusableShape};

impl Scene {
    /// The function that makes the solid of a shape under a free id; `None` if the id is taken, and for an engine that
    /// makes solids only by itself.
    pub(crate) fn baker_for(&self, id: ShapeId) -> Option<Baker> {
        self.engine.baker().filter(|_| self.shape(id).is_none())
    }

    /// Keeps a solid for the next command that adds its shape.
    pub(crate) fn put_baked(
        &mut self,
        id: ShapeId,
        shape: &Shape,
        baked: Result<BakedShape, UnusableShape>,
    ) {
        self.baked.put(id, shape.clone(), baked);
    }
}
