//! A bounded queue of encoded entries that drops its oldest.
//!
//! Each entry is its length, two bytes little-endian, and its postcard form. Invariant: it holds whole entries only.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

/// Longest encoded entry.
const ENTRY_BYTES_MAX: usize = 1_024;
const LENGTH_BYTES: usize = 2;

/// The newest entries of one scene.
#[derive(Debug)]
pub(super) struct FlightRing {
    bytes: VecDeque<u8>,
    bytes_max: usize,
    /// Entries that were dropped for newer ones, or that were too long.
    dropped: u64,
}

impl FlightRing {
    pub(super) const fn new(bytes_max: usize) -> Self {
        Self {
            bytes: VecDeque::new(),
            bytes_max,
            dropped: 0,
        }
    }

    pub(super) fn push(&mut self, entry: &FlightEntry<'_>) {
        let mut buffer = [0; ENTRY_BYTES_MAX];
        match postcard::to_slice(entry, &mut buffer) {
            Ok(encoded) => self.push_encoded(encoded),
            Err(_) => self.dropped += 1,
        }
    }

    /// Adds entries that another ring gave away; bytes that are none end them.
    pub(super) fn append(&mut self, mut entries: &[u8]) {
        while let Some((encoded, rest)) = split_entry(entries) {
            self.push_encoded(encoded);
            entries = rest;
        }
    }

    /// Gives all entries away.
    pub(super) fn take(&mut self) -> Vec<u8> {
        self.bytes.drain(..).collect()
    }

    fn push_encoded(&mut self, encoded: &[u8]) {
        let length = encoded.len();
        while self.bytes.len() + LENGTH_BYTES + length > self.bytes_max {
            if !self.drop_oldest() {
                self.dropped += 1;
                return;
            }
        }
        self.bytes.extend((length as u16).to_le_bytes());
        self.bytes.extend(encoded);
    }

    /// False if there is none.
    fn drop_oldest(&mut self) -> bool {
        let (Some(low), Some(high)) = (self.bytes.pop_front(), self.bytes.pop_front()) else {
            return false;
        };
        let length = usize::from(u16::from_le_bytes([low, high]));
        self.bytes.drain(..length.min(self.bytes.len()));
        self.dropped += 1;
        true
    }

    /// All entries as bytes, and the number of those that were dropped.
    pub(super) fn copy(&self) -> (Vec<u8>, u64) {
        (self.bytes.iter().copied().collect(), self.dropped)
    }
}

/// The entries in these bytes, in order; `None` stands for one that cannot be read, and ends them.
pub(super) fn entries(mut bytes: &[u8]) -> impl Iterator<Item = Option<FlightEntry<'_>>> {
    std::iter::from_fn(move || {
        if bytes.is_empty() {
            return None;
        }
        let entry = split_entry(bytes).and_then(|(entry, rest)| {
            bytes = rest;
            postcard::from_bytes(entry).ok()
        });
        if entry.is_none() {
            bytes = &[];
        }
        Some(entry)
    })
}

/// The encoded entry at the beginning of some bytes, and the rest.
fn split_entry(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<LENGTH_BYTES>()?;
    let length = usize::from(u16::from_le_bytes(*length));
    (length <= ENTRY_BYTES_MAX).then(|| rest.split_at_checked(length))?
}

/// Bytes that are kept of one command; of longer ones, such as meshes, only the beginning.
pub(super) const COMMAND_BYTES_KEPT: usize = 256;
/// Bytes that are kept of a packet: its head.
pub(super) const HEAD_BYTES_KEPT: usize = 8;

/// One event of a scene. Moments are nanoseconds since the server's start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) enum FlightEntry<'a> {
    /// A client became a member; its name, if it showed a token.
    Joined { peer: u64, client: Option<&'a str> },
    /// A member left, or its connection ended.
    Left { peer: u64 },
    /// A command that is about to be checked and applied, as it is on the wire.
    Command {
        peer: u64,
        number: u64,
        /// The length of the whole command, bytes.
        length: u32,
        bytes: &'a [u8],
    },
    /// The last command was refused.
    Refused { error: &'a str },
    /// A step begins: the last entry of a scene whose step never ends.
    StepBegan { at_ns: u64, tick: u64 },
    /// A step and its publication have ended.
    Stepped {
        tick: u64,
        step_ns: u64,
        publish_ns: u64,
        members: u32,
        bodies: u32,
        awake: u32,
        /// Digest of all observations so far.
        digest: u64,
    },
    /// A packet of the tick, for all members of its stream.
    Packet { length: u32, head: &'a [u8] },
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn the_newest_entries_are_kept_whole_within_the_bound(
            lengths in proptest::collection::vec(0_usize..1_100, 1..200),
            bytes_max in 0_usize..4_096,
        ) {
            let mut ring = FlightRing::new(bytes_max);
            let content = vec![7; 1_100];
            for (number, length) in lengths.iter().enumerate() {
                let (number, bytes) = (number as u64, &content[..*length]);
                ring.push(&FlightEntry::Command { peer: 1, number, length: 0, bytes });
            }
            let (bytes, dropped) = ring.copy();
            prop_assert!(bytes.len() <= bytes_max);
            let kept: Vec<u64> = entries(&bytes)
                .map(|entry| match entry {
                    Some(FlightEntry::Command { number, .. }) => number,
                    other => panic!("{other:?}"),
                })
                .collect();
            prop_assert_eq!(kept.len() as u64 + dropped, lengths.len() as u64);
            prop_assert!(kept.is_sorted());
        }

        #[test]
        fn entries_that_are_given_away_arrive_whole(
            lengths in proptest::collection::vec(0_usize..900, 1..50),
            cut in 0_usize..2_000,
        ) {
            let (mut from, mut to) = (FlightRing::new(1 << 20), FlightRing::new(1 << 20));
            let content = vec![7; 900];
            for (number, length) in lengths.iter().enumerate() {
                let (number, bytes) = (number as u64, &content[..*length]);
                from.push(&FlightEntry::Command { peer: 1, number, length: 0, bytes });
            }
            let before = from.copy();
            let given = from.take();
            prop_assert!(from.copy().0.is_empty());
            to.append(&given);
            prop_assert_eq!(to.copy(), before);
            // Bytes of a broken process are no entries.
            to.append(&given[cut.min(given.len())..]);
        }

        #[test]
        fn arbitrary_bytes_are_read_without_a_panic(bytes: Vec<u8>) {
            prop_assert!(entries(&bytes).count() <= bytes.len());
        }
    }
}
