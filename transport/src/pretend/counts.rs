//! What a link did, counted.
//!
//! Pieces and bytes as they were pushed: no headers are added.

use bytes::Bytes;

/// What happened on one lane of a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounts {
    /// Pushed in.
    pub pushed: Tally,
    /// Lost on the way; on the control lane, each time sent again.
    pub lost: Tally,
    /// Lost because the queue before the rate limit was full; on the control lane, sent again.
    pub overflowed: Tally,
    /// Copies made.
    pub duplicated: Tally,
    /// Popped out, copies included.
    pub delivered: Tally,
}

/// How many pieces, and their bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Pieces.
    pub pieces: u64,
    /// Bytes, as pushed: no headers.
    pub bytes: u64,
}

impl Tally {
    pub(super) fn add(&mut self, bytes: &Bytes) {
        self.pieces += 1;
        self.bytes += bytes.len() as u64;
    }
}
