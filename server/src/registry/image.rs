//! The image of a registry in a snapshot.

use rhumb_protocol::scene::{BodyDesc, JointId, Shape, ShapeId};
use rhumb_protocol::scene::Joint;
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::Damping;

use super::{BodyEntry, Registry, ShapeEntry};

impl Wire for Registry {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.shapes.len() as u64);
        for (id, entry) in &self.shapes {
            id.encode(to);
            entry.shape.encode(to);
        }
        to.varint(self.bodies.iter().flatten().count() as u64);
        for entry in self.bodies.iter().flatten() {
            to.u8(u8::from(entry.lives));
            entry.desc.encode(to);
        }
        to.varint(self.joints.iter().count() as u64);
        for (id, joint) in self.joints.iter() {
            id.encode(to);
            joint.encode(to);
        }
        to.varint(self.dampings.len() as u64);
        for damping in &self.dampings {
            damping.encode(to);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let mut registry = Self::default();
        for _ in 0..from.varint()? {
            let id = ShapeId::decode(from)?;
            let shape = Shape::decode(from)?;
            registry.shape_bytes += shape.bytes();
            registry.shapes.insert(id, ShapeEntry { shape, users: 0 });
        }
        for _ in 0..from.varint()? {
            let lives = from.u8()? != 0;
            let desc = BodyDesc::decode(from)?;
            registry.restore_body(BodyEntry { desc, lives })?;
        }
        for _ in 0..from.varint()? {
            let id = JointId::decode(from)?;
            if !registry.joints.insert(id, Joint::decode(from)?) {
                return Err(Malformed::NotCanonical);
            }
        }
        for _ in 0..from.varint()? {
            registry.dampings.push(Damping::decode(from)?);
        }
        Ok(registry)
    }
}

impl Registry {
    fn restore_body(&mut self, entry: BodyEntry) -> Result<(), Malformed> {
        if entry.lives {
            self.count += 1;
            let shape = self.shapes.get_mut(&entry.desc.shape);
            shape.ok_or(Malformed::OutOfRange)?.users += 1;
        }
        let index = entry.desc.id.index() as usize;
        if index >= self.bodies.len() {
            self.bodies.resize(index + 1, None);
        }
        self.bodies[index] = Some(entry);
        Ok(())
    }
}
