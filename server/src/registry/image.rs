//! The image of a registry in a snapshot.

use rhumb_protocol::scene::Joint;
use rhumb_protocol::scene::{BodyDesc, JointId, Shape, ShapeId};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::Damping;

use super::locomotions::Locomotions;
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
            entry.damping.encode(to);
        }
        to.varint(self.joints.iter().count() as u64);
        for (id, joint) in self.joints.iter() {
            id.encode(to);
            joint.encode(to);
        }
        self.locomotions.encode(to);
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
            let entry = BodyEntry {
                lives,
                desc: BodyDesc::decode(from)?,
                damping: Damping::decode(from)?,
            };
            registry.restore_body(entry)?;
        }
        for _ in 0..from.varint()? {
            let id = JointId::decode(from)?;
            let before = registry.joints.insert(id, Joint::decode(from)?);
            if before.is_some() {
                return Err(Malformed::NotCanonical);
            }
        }
        registry.locomotions = Locomotions::decode(from)?;
        Ok(registry)
    }
}

impl Registry {
    fn restore_body(&mut self, entry: BodyEntry) -> Result<(), Malformed> {
        if entry.lives {
            if !self.shapes.contains_key(&entry.desc.shape) {
                return Err(Malformed::OutOfRange);
            }
            self.count += 1;
            self.count_properties(&entry);
        }
        let index = entry.desc.id.index() as usize;
        if index >= self.bodies.len() {
            self.bodies.resize(index + 1, None);
        }
        self.bodies[index] = Some(entry);
        Ok(())
    }
}
