//! The shapes that a client's bodies have in its scene, each kept once.
//!
//! The published plug-in tells a shape for every object; scenes hold few thousand, and say each to every member.

use std::collections::BTreeMap;

use rhumb_protocol::limits::SHAPES_MAX;
use rhumb_protocol::scene::{Command, CommandError, Shape, ShapeId};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Writer;

use super::lead::Lead;

/// Shapes in the scene, by their bytes.
#[derive(Debug, Default)]
pub(super) struct ShapeCache {
    known: BTreeMap<Vec<u8>, ShapeId>,
    /// How many bodies have each, and its bytes.
    users: BTreeMap<ShapeId, (usize, Vec<u8>)>,
    /// The number that was given out last.
    last: u32,
}

impl ShapeCache {
    /// The scene's name of a shape, which one more body has from now on.
    pub(super) fn take(
        &mut self,
        shape: &Shape,
        lead: &mut Lead<'_>,
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
        let id = self.free(lead);
        let shape = shape.clone();
        lead.command(&Command::AddShape { id, shape })?;
        self.last = id.0;
        self.known.insert(bytes.clone(), id);
        self.users.insert(id, (1, bytes));
        Ok(id)
    }

    /// A body less has it.
    pub(super) fn give_back(&mut self, id: ShapeId, lead: &mut Lead<'_>) {
        let Some((users, bytes)) = self.users.get_mut(&id) else {
            return;
        };
        *users -= 1;
        if *users > 0 {
            return;
        }
        self.known.remove(bytes);
        self.users.remove(&id);
        if let Err(error) = lead.command(&Command::RemoveShape { id }) {
            // A member gave a body of its own this shape.
            tracing::debug!(%error, "a shape stays in its scene");
        }
    }

    /// A number that the scene has no shape of: members may have taken any. Beyond the limit if all are taken.
    fn free(&self, lead: &Lead<'_>) -> ShapeId {
        let from = (self.last + 1) % SHAPES_MAX;
        let numbers = (from..SHAPES_MAX).chain(0..from).map(ShapeId);
        let free = |id: &ShapeId| lead.scene().shape(*id).is_none();
        numbers
            .into_iter()
            .find(free)
            .unwrap_or(ShapeId(SHAPES_MAX))
    }
}
