//! Finding and repairing a track that two ends do not agree on.
//!
//! That never happens but by a fault of an implementation or of memory; a copy that has one is made right without a new
//! snapshot. Sums are compared only where both ends stand at the same packet and the same notice (PROTOCOL 6.12).

use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::BodyId;

use super::publisher::Publisher;
use super::tracks::Tracks;
use crate::limits::{DIGEST_RANGES_MAX, INDICES_MAX};
use crate::packet::{Digest, Doubt, Low16, Ranges, RepairRecord, RepairWriter, TrackSaying};

/// What a publisher answers to a doubt.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reassurance {
    /// The sums over parts of the range.
    Sums(Bytes),
    /// The track of the one body that was doubted, which there may be none of.
    Amendment(Option<BodyId>, Vec<Bytes>),
}

impl Publisher {
    /// The sum over all tracks, by which two ends can be compared.
    #[must_use]
    pub fn agreement(&self) -> u64 {
        self.table().agreement().value()
    }

    /// The datagram that says the sum over all tracks. `notices`: how many the scene has given.
    #[must_use]
    pub fn digest(&self, notices: u64) -> Bytes {
        let sums = alloc::vec![self.agreement()];
        self.sums(Ranges::ALL, sums, notices)
    }

    /// Answers a member whose sum over a range is another.
    #[must_use]
    pub fn reassure(&self, doubt: Doubt, notices: u64) -> Reassurance {
        let range = doubt.range;
        if range.stride > 1 {
            let parts = range.cut();
            let end = range.first as usize + range.stride as usize;
            let sums = sums(self.table(), parts, end);
            return Reassurance::Sums(self.sums(parts, sums, notices));
        }
        let index = range.first;
        let mut writer = RepairWriter::default();
        let slot = self.table().slot(index);
        if let Some(slot) = slot {
            let age = self.tick().since(slot.origin()).unwrap_or_default();
            let whole = TrackSaying::of(&slot.track());
            writer.push(&RepairRecord {
                index,
                seat: None,
                age,
                whole,
            });
        }
        // It makes good a packet that was not sent yet: so it is told from repairs.
        let datagrams = writer.finish(
            self.stream(),
            self.next_number(),
            self.tick().value(),
            notices,
        );
        let datagrams = datagrams.into_iter().map(Bytes::from).collect();
        Reassurance::Amendment(slot.map(|slot| slot.id(index)), datagrams)
    }

    fn sums(&self, ranges: Ranges, sums: Vec<u64>, notices: u64) -> Bytes {
        let digest = Digest {
            next: Low16::of(self.next_number()),
            tick: Low16::of(self.tick().value()),
            notices: Low16::of(notices),
            ranges,
            sums,
        };
        Bytes::from(digest.encode(self.stream()))
    }
}

/// The sums over ranges of indices below `end`.
fn sums(tracks: &Tracks, ranges: Ranges, end: usize) -> Vec<u64> {
    let stride = ranges.stride as usize;
    let places = (ranges.first as usize..end).step_by(stride);
    let sum = |first: usize| {
        tracks
            .agreement_of(first..(first + stride).min(end))
            .value()
    };
    places.take(DIGEST_RANGES_MAX).map(sum).collect()
}

/// What a subscriber does not agree on.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Doubts {
    range: Option<Ranges>,
}

impl Doubts {
    /// What to ask for.
    pub(super) fn doubt(self) -> Option<Doubt> {
        self.range.map(|range| Doubt { range })
    }

    /// The body that is doubted, if it is known to be one.
    pub(super) fn index(self) -> Option<u32> {
        let range = self.range.filter(|range| range.stride == 1)?;
        Some(range.first)
    }

    /// It was made right.
    pub(super) fn end(&mut self) {
        self.range = None;
    }

    /// Compares sums that were said of the tracks as they stand here; `true` if they are other sums.
    ///
    /// A sum over all tracks does not begin the search again while it goes on.
    pub(super) fn compare(&mut self, tracks: &Tracks, said: &Digest) -> bool {
        let stride = said.ranges.stride as usize;
        let range = |place: usize| {
            let first = said.ranges.first as usize + place * stride;
            first..first + stride
        };
        let differs = |(place, sum): &(usize, &u64)| {
            let own = if said.ranges == Ranges::ALL {
                tracks.agreement()
            } else {
                tracks.agreement_of(range(*place))
            };
            own.value() != **sum
        };
        // A range behind all indices has no bodies, and no doubt can name it.
        let may_be = |(place, _): &(usize, &u64)| range(*place).start < INDICES_MAX as usize;
        let mut sums = said.sums.iter().enumerate().take_while(may_be);
        let found = sums.find(differs);
        let searching = said.ranges == Ranges::ALL && self.range.is_some();
        if found.is_some() && searching {
            return true;
        }
        self.range = found.map(|(place, _)| Ranges {
            first: range(place).start as u32,
            stride: said.ranges.stride,
        });
        found.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec;
    use core::num::NonZeroU32;
    use glam::Vec3;
    use rhumb_reckoning::{Integrator, Rate, Tolerance};

    #[test]
    fn no_range_behind_all_indices_is_doubted() {
        let integrator = Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::MIN,
        };
        let tracks = Tracks::new(Tolerance::NORMAL, integrator, NonZeroU32::MIN, Vec3::ZERO);
        let digest = |sums| Digest {
            next: Low16(0),
            tick: Low16(0),
            notices: Low16(0),
            ranges: Ranges {
                first: 1,
                stride: INDICES_MAX - 1,
            },
            sums,
        };
        let mut doubts = Doubts::default();
        assert!(!doubts.compare(&tracks, &digest(vec![0, 1])));
        assert_eq!(doubts.doubt(), None);
        assert!(doubts.compare(&tracks, &digest(vec![1, 1])));
        assert_eq!(doubts.doubt().map(|doubt| doubt.range.first), Some(1));
    }
}
