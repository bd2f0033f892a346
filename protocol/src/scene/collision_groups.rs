//! Groups that decide which bodies touch each other.

use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Two bodies touch each other if each is a member of a group that the other one touches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CollisionGroups {
    /// One bit for each group of the body.
    pub members: u32,
    /// One bit for each group that the body touches.
    pub touches: u32,
}

impl CollisionGroups {
    /// A member of every group that touches every group.
    pub const ALL: Self = Self {
        members: u32::MAX,
        touches: u32::MAX,
    };
}

impl Wire for CollisionGroups {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.members));
        to.varint(u64::from(self.touches));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(Self {
            members: from.varint32()?,
            touches: from.varint32()?,
        })
    }
}
