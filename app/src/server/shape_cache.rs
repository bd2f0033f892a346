//! Shapes of an APP client's bodies in its scene, each stored once.
//!
//! The published plug-in defines a shape for every object; a scene allows a few thousand, and sends each to every
//! member.

use std::collections::BTreeMap;

use rhumb_protocol::limits::SHAPES_MAX;
use rhumb_protocol::scene::{Command, CommandError, Shape, ShapeId};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Writer;

use super::host::AppScene;

/// Shapes in the scene, by their bytes.
#[derive(Debug, Default)]
pub(super) struct ShapeCache {
    known: BTreeMap<Vec<u8>, ShapeId>,
    /// Number of bodies with each shape, and its bytes.
    users: BTreeMap<ShapeId, (usize, Vec<u8>)>,
    /// The last assigned number.
    last: u32,
}

impl ShapeCache {
    /// The scene's id of a shape, for one more body.
    pub(super) fn take(
        &mut self,
        shape: &Shape,
        scene: &mut dyn AppScene,
    ) -> Result<ShapeId, CommandError> {
        let mut writer = Writer::new();
        shape.encode(&mut writer);
        let bytes = writer.into_bytes();
        if let Some(id) = self.known.get(&bytes) {
            if let Some((users, _)) = self.users.get_mut(id) {
                *users += 1;
            }
            return Ok(*id);
        }
        if self.users.len() >= SHAPES_MAX as usize {
            return Err(CommandError::UnknownShape(ShapeId(SHAPES_MAX)));
        }
        let id = self.free(scene);
        let shape = shape.clone();
        scene.command(&Command::AddShape { id, shape })?;
        self.last = id.0;
        self.known.insert(bytes.clone(), id);
        self.users.insert(id, (1, bytes));
        Ok(id)
    }

    /// Releases a shape for one body.
    pub(super) fn give_back(&mut self, id: ShapeId, scene: &mut dyn AppScene) {
        let Some((users, bytes)) = self.users.get_mut(&id) else {
            return;
        };
        *users -= 1;
        if *users > 0 {
            return;
        }
        self.known.remove(bytes);
        self.users.remove(&id);
        if let Err(error) = scene.command(&Command::RemoveShape { id }) {
            // Another member's body has this shape.
            tracing::debug!(%error, "a shape stays in its scene");
        }
    }

    /// A number without a shape in the scene: members may have taken any. Beyond the limit if all are taken.
    fn free(&self, scene: &dyn AppScene) -> ShapeId {
        let from = (self.last + 1) % SHAPES_MAX;
        let numbers = (from..SHAPES_MAX).chain(0..from).map(ShapeId);
        let free = |id: &ShapeId| scene.shape(*id).is_none();
        numbers
            .into_iter()
            .find(free)
            .unwrap_or(ShapeId(SHAPES_MAX))
    }
}
