//! A bounded queue of encoded entries that drops its oldest.
//!
//! Each entry of the record of a run is its length, two bytes little-endian, and its bytes. Invariant: it holds whole
//! entries only.

use std::collections::VecDeque;

use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_scene::LogEntry;

/// Longest encoded entry.
const ENTRY_BYTES_MAX: usize = 1_024;
const LENGTH_BYTES: usize = 2;

/// The newest entries of one scene.
#[derive(Debug)]
pub(super) struct FlightRing {
    bytes: VecDeque<u8>,
    bytes_max: usize,
    /// The bytes of one entry, while it is encoded.
    encoded: Writer,
    /// Entries that were dropped for newer ones, or that were too long.
    dropped: u64,
}

impl FlightRing {
    pub(super) fn new(bytes_max: usize) -> Self {
        Self {
            bytes: VecDeque::new(),
            bytes_max,
            encoded: Writer::new(),
            dropped: 0,
        }
    }

    pub(super) fn push(&mut self, entry: &LogEntry) {
        let mut encoded = std::mem::take(&mut self.encoded);
        encoded.clear();
        entry.encode(&mut encoded);
        if encoded.len() <= ENTRY_BYTES_MAX {
            self.push_encoded(encoded.as_bytes());
        } else {
            self.dropped += 1;
        }
        self.encoded = encoded;
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
pub(super) fn entries(mut bytes: &[u8]) -> impl Iterator<Item = Option<LogEntry>> {
    std::iter::from_fn(move || {
        if bytes.is_empty() {
            return None;
        }
        let entry = split_entry(bytes).and_then(|(entry, rest)| {
            bytes = rest;
            let mut from = Reader::new(entry);
            let entry = LogEntry::decode(&mut from).ok()?;
            from.finish().ok().map(|()| entry)
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

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use proptest::prelude::*;
    use rhumb_protocol::Peer;
    use rhumb_scene::{COMMAND_BYTES_KEPT, ReceivedCommand};

    use super::*;

    fn received(number: u64, bytes: &[u8]) -> LogEntry {
        let received = ReceivedCommand {
            member: Peer(1),
            number,
            length: 0,
            bytes: bytes.to_vec(),
        };
        LogEntry::Received(received.into())
    }

    #[test]
    fn an_entry_that_is_too_long_is_dropped_alone() {
        let mut ring = FlightRing::new(1 << 16);
        let name = "a".repeat(ENTRY_BYTES_MAX);
        let long = LogEntry::Joined(Peer(1), Some(Arc::from(name)));
        for entry in [received(1, &[]), long, received(2, &[])] {
            ring.push(&entry);
        }
        let (bytes, dropped) = ring.copy();
        let kept = [received(1, &[]), received(2, &[])].map(Some);
        assert_eq!(entries(&bytes).collect::<Vec<_>>(), kept);
        assert_eq!(dropped, 1);
    }

    proptest! {
        #[test]
        fn the_newest_entries_are_kept_whole_within_the_bound(
            lengths in proptest::collection::vec(0_usize..=COMMAND_BYTES_KEPT, 1..200),
            bytes_max in 0_usize..4_096,
        ) {
            let mut ring = FlightRing::new(bytes_max);
            let content = [7; COMMAND_BYTES_KEPT];
            for (number, length) in lengths.iter().enumerate() {
                ring.push(&received(number as u64, &content[..*length]));
            }
            let (bytes, dropped) = ring.copy();
            prop_assert!(bytes.len() <= bytes_max);
            let kept: Vec<u64> = entries(&bytes)
                .map(|entry| match entry {
                    Some(LogEntry::Received(received)) => received.number,
                    other => panic!("{other:?}"),
                })
                .collect();
            prop_assert_eq!(kept.len() as u64 + dropped, lengths.len() as u64);
            prop_assert!(kept.is_sorted());
        }

        #[test]
        fn entries_that_are_given_away_arrive_whole(
            lengths in proptest::collection::vec(0_usize..=COMMAND_BYTES_KEPT, 1..50),
            cut in 0_usize..2_000,
        ) {
            let (mut from, mut to) = (FlightRing::new(1 << 20), FlightRing::new(1 << 20));
            let content = [7; COMMAND_BYTES_KEPT];
            for (number, length) in lengths.iter().enumerate() {
                from.push(&received(number as u64, &content[..*length]));
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
