//! Files of flight recorders: their bounds, and what is read back or refused.

use std::sync::Arc;

use proptest::prelude::*;
use rhumb_protocol::Peer;
use rhumb_scene::{COMMAND_BYTES_KEPT, ReceivedCommand};

use super::*;
use crate::flight::FlightCause;

fn head(written: i64) -> FlightHead {
    FlightHead {
        server: String::new(),
        scene: "a/b".to_owned(),
        cause: FlightCause::Quarantined,
        written,
        dropped: 0,
    }
}

#[test]
fn the_oldest_files_are_removed_beyond_the_bound() {
    let directory = tempfile::tempdir().unwrap();
    let write = |at| write(directory.path(), 3, &head(at), b"").unwrap();
    let first = write(1);
    let later: Vec<_> = [2, 2, 3].map(write).into();
    assert!(!first.exists());
    assert!(later.iter().all(|path| path.exists()));
    assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 3);
}

#[test]
fn a_directory_that_is_gone_is_an_error() {
    let directory = tempfile::tempdir().unwrap();
    let gone = directory.path().join("gone");
    assert!(write(&gone, 3, &head(1), b"").is_err());
}

#[test]
fn a_file_is_read_back_and_every_cut_or_changed_one_is_refused() {
    let head = FlightHead {
        server: "0.1.0".to_owned(),
        scene: "team/pit".to_owned(),
        cause: FlightCause::Quarantined,
        written: 1_700_000_000,
        dropped: 3,
    };
    let bytes = encode(&head, b"entries").unwrap();
    assert_eq!(decode(&bytes), Ok((head, &b"entries"[..])));
    for end in 0..bytes.len() {
        assert!(decode(&bytes[..end]).is_err(), "cut at {end}");
        let mut changed = bytes.clone();
        changed[end] ^= 1;
        assert!(decode(&changed).is_err(), "changed at {end}");
    }
}

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
