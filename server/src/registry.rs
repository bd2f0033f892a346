//! Present and former shapes, bodies and joints of a scene.
//!
//! No engine here. Checks the rules of names and numbers; a refused change changes nothing. Invariants: each body's
//! shape exists, each joint's bodies live; the generations of an index only grow.

mod image;

use std::collections::BTreeMap;

use rhumb_protocol::limits::{
    BODIES_MAX, DAMPINGS_MAX, INDICES_MAX, JOINTS_MAX, SHAPE_BYTES_PER_SCENE_MAX, SHAPES_MAX,
};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, CommandError, IdRange, Joint, JointId, Joints, Shape, ShapeId,
};
use rhumb_reckoning::{BodyId, Damping};

/// The shapes, bodies and joints of one scene.
#[derive(Clone, Debug, Default)]
pub(crate) struct Registry {
    shapes: BTreeMap<ShapeId, ShapeEntry>,
    shape_bytes: usize,
    /// By index; `None` for an index that was never used.
    bodies: Vec<Option<BodyEntry>>,
    count: usize,
    joints: Joints,
    /// All damping values that bodies ever had: both ends of a stream keep a table for each.
    dampings: Vec<Damping>,
}

#[derive(Clone, Debug)]
struct ShapeEntry {
    shape: Shape,
    /// Number of bodies with this shape.
    users: usize,
}

/// The last body of an index.
#[derive(Clone, Copy, Debug)]
struct BodyEntry {
    desc: BodyDesc,
    lives: bool,
}

impl Registry {
    pub(crate) fn add_shape(&mut self, id: ShapeId, shape: Shape) -> Result<(), CommandError> {
        if id.0 >= SHAPES_MAX {
            return Err(CommandError::UnknownShape(id));
        }
        if self.shapes.contains_key(&id) {
            return Err(CommandError::ShapeIdTaken(id));
        }
        let bytes = self.shape_bytes + shape.bytes();
        if bytes > SHAPE_BYTES_PER_SCENE_MAX {
            return Err(CommandError::TooManyShapeBytes);
        }
        self.shape_bytes = bytes;
        self.shapes.insert(id, ShapeEntry { shape, users: 0 });
        Ok(())
    }

    pub(crate) fn remove_shape(&mut self, id: ShapeId) -> Result<(), CommandError> {
        let known = self.shapes.get(&id);
        if known.ok_or(CommandError::UnknownShape(id))?.users > 0 {
            return Err(CommandError::ShapeInUse(id));
        }
        if let Some(known) = self.shapes.remove(&id) {
            self.shape_bytes -= known.shape.bytes();
        }
        Ok(())
    }

    /// Adds a body. `damping`: its own or the scene's.
    pub(crate) fn add_body(
        &mut self,
        desc: BodyDesc,
        damping: Damping,
    ) -> Result<(), CommandError> {
        let id = desc.id;
        if id.index() >= INDICES_MAX {
            return Err(CommandError::NotGranted(id));
        }
        let last = self.bodies.get(id.index() as usize).copied().flatten();
        if last.is_some_and(|last| last.lives || last.desc.id.generation() >= id.generation()) {
            return Err(CommandError::BodyIdTaken(id));
        }
        if self.count >= BODIES_MAX as usize {
            return Err(CommandError::TooManyBodies);
        }
        // As in predictors: a body that no engine moves has no damping, whatever its description says.
        let damping = match desc.kind {
            BodyKind::Dynamic => damping,
            BodyKind::Static | BodyKind::Kinematic => Damping::default(),
        };
        let new_damping = !self.dampings.contains(&damping);
        if new_damping && self.dampings.len() >= DAMPINGS_MAX {
            return Err(CommandError::TooManyDampings);
        }
        let known = self.shapes.get_mut(&desc.shape);
        let known = known.ok_or(CommandError::UnknownShape(desc.shape))?;
        if desc.kind == BodyKind::Dynamic && !known.shape.is_solid() {
            return Err(CommandError::NoInside(desc.shape));
        }
        known.users += 1;
        if new_damping {
            self.dampings.push(damping);
        }
        let index = id.index() as usize;
        if index >= self.bodies.len() {
            self.bodies.resize(index + 1, None);
        }
        self.bodies[index] = Some(BodyEntry { desc, lives: true });
        self.count += 1;
        Ok(())
    }

    /// Removes a body, and returns the joints that go with it.
    pub(crate) fn remove_body(&mut self, id: BodyId) -> Result<Vec<JointId>, CommandError> {
        let shape = self.body(id).ok_or(CommandError::UnknownBody(id))?.shape;
        if let Some(Some(known)) = self.bodies.get_mut(id.index() as usize) {
            known.lives = false;
        }
        if let Some(known) = self.shapes.get_mut(&shape) {
            known.users -= 1;
        }
        self.count -= 1;
        Ok(self.joints.remove_body(id))
    }

    pub(crate) fn add_joint(&mut self, id: JointId, joint: Joint) -> Result<(), CommandError> {
        if id.0 >= JOINTS_MAX {
            return Err(CommandError::UnknownJoint(id));
        }
        let [first, second] = joint.bodies;
        for body in joint.bodies {
            self.body(body).ok_or(CommandError::UnknownBody(body))?;
        }
        if first == second {
            return Err(CommandError::JoinedToItself(first));
        }
        if !self.joints.insert(id, joint) {
            return Err(CommandError::JointIdTaken(id));
        }
        Ok(())
    }

    pub(crate) fn remove_joint(&mut self, id: JointId) -> Result<(), CommandError> {
        let joint = self.joints.remove(id);
        joint.map(drop).ok_or(CommandError::UnknownJoint(id))
    }

    pub(crate) const fn joints(&self) -> &Joints {
        &self.joints
    }

    pub(crate) fn body(&self, id: BodyId) -> Option<&BodyDesc> {
        let known = self.bodies.get(id.index() as usize)?.as_ref()?;
        (known.lives && known.desc.id == id).then_some(&known.desc)
    }

    /// In the order of ids.
    pub(crate) fn bodies(&self) -> impl Iterator<Item = &BodyDesc> {
        let known = self.bodies.iter().flatten();
        known.filter(|known| known.lives).map(|known| &known.desc)
    }

    /// Number of indices up to the last that was ever used.
    pub(crate) const fn indices(&self) -> u32 {
        self.bodies.len() as u32
    }

    pub(crate) const fn body_count(&self) -> usize {
        self.count
    }

    pub(crate) fn shape(&self, id: ShapeId) -> Option<&Shape> {
        self.shapes.get(&id).map(|known| &known.shape)
    }

    /// In the order of ids.
    pub(crate) fn shapes(&self) -> impl Iterator<Item = (ShapeId, &Shape)> {
        self.shapes.iter().map(|(id, known)| (*id, &known.shape))
    }

    /// The least generation that no body of the range has had; `None` while a body lives in the range or one of its
    /// indices is used up.
    pub(crate) fn vacancy(&self, range: &IdRange) -> Option<u16> {
        let from = (range.first() as usize).min(self.bodies.len());
        let to = (from + range.count() as usize).min(self.bodies.len());
        let mut generation = 0;
        for known in self.bodies[from..to].iter().flatten() {
            if known.lives {
                return None;
            }
            generation = generation.max(known.desc.id.generation().checked_add(1)?);
        }
        Some(generation)
    }
}
