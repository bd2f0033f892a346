//! Body indices that one member may give out.

use rhumb_reckoning::BodyId;

use crate::limits::BODIES_MAX;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// A run of body indices that a server granted to one member.
///
/// The member names the bodies it adds, so that it can command them without waiting for an answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IdRange {
    first: u32,
    count: u32,
}

impl IdRange {
    /// None at all.
    pub const EMPTY: Self = Self { first: 0, count: 0 };

    /// `count` indices from `first` on, or `None` beyond the limit of bodies.
    #[must_use]
    pub fn new(first: u32, count: u32) -> Option<Self> {
        let end = first.checked_add(count)?;
        (end <= BODIES_MAX).then_some(Self { first, count })
    }

    /// Whether a body's index is one of these.
    #[must_use]
    pub fn contains(&self, id: BodyId) -> bool {
        id.index() >= self.first && id.index() - self.first < self.count
    }

    /// The `place`-th of these, as the first body to use its index.
    #[must_use]
    pub fn id(&self, place: u32) -> Option<BodyId> {
        (place < self.count).then(|| BodyId::new(self.first + place, 0))
    }

    /// The first index.
    #[must_use]
    pub const fn first(&self) -> u32 {
        self.first
    }

    /// How many there are.
    #[must_use]
    pub const fn count(&self) -> u32 {
        self.count
    }
}

impl Wire for IdRange {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.first));
        to.varint(u64::from(self.count));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Self::new(from.varint32()?, from.varint32()?).ok_or(Malformed::OutOfRange)
    }
}

impl Wire for BodyId {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.index()));
        to.varint(u64::from(self.generation()));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let index = from.varint_to(u64::from(BODIES_MAX) - 1)?;
        let generation = from.varint_to(u64::from(u16::MAX))?;
        Ok(Self::new(index as u32, generation as u16))
    }
}
