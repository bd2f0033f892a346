//! The number of a shape within its scene.

use core::fmt;

use crate::limits::SHAPES_MAX;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Names a shape of one scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ShapeId(pub u32);

impl fmt::Display for ShapeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "shape {}", self.0)
    }
}

impl Wire for ShapeId {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.0));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let number = from.varint_to(u64::from(SHAPES_MAX) - 1)?;
        Ok(Self(number as u32))
    }
}
