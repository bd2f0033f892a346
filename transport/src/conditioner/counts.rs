//! Counters of a link.
//!
//! Pieces and bytes as pushed: no headers are added.

use std::ops::AddAssign;

use bytes::Bytes;

/// Counters of one lane of a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounts {
    /// Pushed into the link.
    pub pushed: Tally,
    /// Lost; a lost piece of the control lane is sent again.
    pub lost: Tally,
    /// Lost by a full queue before the rate limit; a lost piece of the control lane is sent again.
    pub overflowed: Tally,
    /// Duplicates that the link made.
    pub duplicated: Tally,
    /// Delivered by the link, duplicates included.
    pub delivered: Tally,
}

/// Count of pieces, and of their bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Pieces.
    pub pieces: u64,
    /// Bytes, as pushed, without headers.
    pub bytes: u64,
}

impl Tally {
    pub(super) fn add(&mut self, bytes: &Bytes) {
        self.pieces += 1;
        self.bytes += bytes.len() as u64;
    }
}

impl AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.pieces += other.pieces;
        self.bytes += other.bytes;
    }
}

impl AddAssign for LinkCounts {
    fn add_assign(&mut self, other: Self) {
        self.pushed += other.pushed;
        self.lost += other.lost;
        self.overflowed += other.overflowed;
        self.duplicated += other.duplicated;
        self.delivered += other.delivered;
    }
}
