//! Body indices that a server grants to a member.

use rhumb_reckoning::BodyId;

use crate::limits::INDICES_MAX;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// A range of body indices granted to one member.
///
/// The member assigns the ids of its bodies, so that it can command them without waiting for an answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IdRange {
    first: u32,
    count: u32,
    generation: u16,
}

impl IdRange {
    /// A range without indices.
    pub const EMPTY: Self = Self {
        first: 0,
        count: 0,
        generation: 0,
    };

    /// `count` indices from `first` on, none of which had a body of this generation or a later one.
    ///
    /// `None` beyond the limit of indices.
    #[must_use]
    pub fn new(first: u32, count: u32, generation: u16) -> Option<Self> {
        let end = first.checked_add(count)?;
        (end <= INDICES_MAX).then_some(Self {
            first,
            count,
            generation,
        })
    }

    /// True if a body's index is in the range.
    #[must_use]
    pub fn contains(&self, id: BodyId) -> bool {
        id.index() >= self.first && id.index() - self.first < self.count
    }

    /// The first id of the `place`-th of these indices.
    #[must_use]
    pub fn id(&self, place: u32) -> Option<BodyId> {
        (place < self.count).then(|| BodyId::new(self.first + place, self.generation))
    }

    /// The first index.
    #[must_use]
    pub const fn first(&self) -> u32 {
        self.first
    }

    /// The number of indices.
    #[must_use]
    pub const fn count(&self) -> u32 {
        self.count
    }

    /// The least generation of the ids.
    #[must_use]
    pub const fn generation(&self) -> u16 {
        self.generation
    }
}

impl Wire for IdRange {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.first));
        to.varint(u64::from(self.count));
        to.varint(u64::from(self.generation));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let (first, count) = (from.varint32()?, from.varint32()?);
        let generation = from.varint_to(u64::from(u16::MAX))? as u16;
        Self::new(first, count, generation).ok_or(Malformed::OutOfRange)
    }
}

impl Wire for BodyId {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.index()));
        to.varint(u64::from(self.generation()));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let index = from.varint_to(u64::from(INDICES_MAX) - 1)?;
        let generation = from.varint_to(u64::from(u16::MAX))?;
        Ok(Self::new(index as u32, generation as u16))
    }
}
