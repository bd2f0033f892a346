//! Contacts at the edges between the triangles of a mesh or of heights.

use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// How bodies touch the edges that two triangles of a sheet share.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Edges {
    /// Each triangle is touched as if it were alone: a body that slides or rolls over flat ground may catch on an edge.
    Plain,
    /// A contact pushes by the triangles on both sides of the edge: a body slides and rolls over flat ground as over one
    /// face. Heights are then touched from above only; a mesh from both sides.
    Smooth,
}

impl Edges {
    /// Those of a new mesh or field.
    pub const DEFAULT: Self = Self::Smooth;
}

impl Default for Edges {
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl Wire for Edges {
    fn encode(&self, to: &mut Writer) {
        to.u8(match self {
            Self::Plain => 0,
            Self::Smooth => 1,
        });
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        match from.u8()? {
            0 => Ok(Self::Plain),
            1 => Ok(Self::Smooth),
            _ => Err(Malformed::UnknownCode),
        }
    }
}
