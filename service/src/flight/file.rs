//! The entries of a flight recorder: a bounded ring, and the file made of it.
//!
//! The ring drops its oldest entries and holds whole ones only. Each is its length, two bytes little-endian, and its bytes,
//! an entry of the record of a run.
//!
//! A file is eight bytes that name the format, the length of the head (two bytes, little-endian), the head in postcard
//! form, the entries, and the CRC-32 of everything before it. `rhumb-server flight` prints it.

use std::collections::VecDeque;
use std::error::Error;
use std::io::Write;
use std::path::Path;
use std::{fmt, fs};

use rhumb_protocol::Span;
use rhumb_protocol::packet::Datagram;
use rhumb_protocol::scene::Command;
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_scene::LogEntry;
use serde::{Deserialize, Serialize};

/// Names the format and its version.
const MAGIC: &[u8; 8] = b"RHFLGHT2";
const CRC_BYTES: usize = 4;

/// The head of a file: its scene, cause and moment.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct FlightHead {
    /// The version of the server.
    pub(super) server: String,
    pub(super) scene: String,
    pub(super) cause: FlightCause,
    /// When it was written, seconds since 1970.
    pub(super) written: i64,
    /// Older entries that it no longer had.
    pub(super) dropped: u64,
}

/// Reason why a file cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum UnreadableFlight {
    /// It does not begin as such a file does.
    NotAFlight,
    /// It was cut short or changed.
    Damaged,
}

impl fmt::Display for UnreadableFlight {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotAFlight => "is no file of a flight recorder of this version",
            Self::Damaged => "was cut short or changed",
        })
    }
}

/// The bytes of a file; `None` if the head is too long.
pub(super) fn encode(head: &FlightHead, entries: &[u8]) -> Option<Vec<u8>> {
    let encoded = postcard::to_allocvec(head).ok()?;
    let mut bytes = MAGIC.to_vec();
    bytes.extend(u16::try_from(encoded.len()).ok()?.to_le_bytes());
    bytes.extend(encoded);
    bytes.extend(entries);
    bytes.extend(crc32fast::hash(&bytes).to_le_bytes());
    Some(bytes)
}

/// The head and the entries of a file.
pub(super) fn decode(bytes: &[u8]) -> Result<(FlightHead, &[u8]), UnreadableFlight> {
    let rest = bytes.strip_prefix(MAGIC);
    let rest = rest.ok_or(UnreadableFlight::NotAFlight)?;
    decode_rest(bytes, rest).ok_or(UnreadableFlight::Damaged)
}

fn decode_rest<'a>(bytes: &[u8], rest: &'a [u8]) -> Option<(FlightHead, &'a [u8])> {
    let (rest, crc) = rest.split_at_checked(rest.len().checked_sub(CRC_BYTES)?)?;
    let body = &bytes[..bytes.len() - CRC_BYTES];
    if crc32fast::hash(body).to_le_bytes() != crc {
        return None;
    }
    let (length, rest) = rest.split_at_checked(2)?;
    let length = u16::from_le_bytes(length.try_into().ok()?);
    let (head, entries) = rest.split_at_checked(usize::from(length))?;
    Some((postcard::from_bytes(head).ok()?, entries))
}

/// A fault of a scene. The numbers in files are those of the order; new causes are added at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum FlightCause {
    /// The engine panicked.
    EnginePanicked,
    /// The thread of the scene panicked.
    ThreadPanicked,
    /// The scene did not answer the watchdog and is quarantined.
    Quarantined,
    /// The engine removed a body whose state was not finite.
    NotFinite,
    /// A checksum of a client's copy differs from that of the stream.
    ChecksumMismatch,
    /// The scene did not answer the watchdog, and its process was killed.
    Killed,
    /// The process of the scene ended.
    ProcessEnded,
}

impl FlightCause {
    /// The word for the cause in the name of a file.
    pub(super) const fn word(self) -> &'static str {
        match self {
            Self::EnginePanicked => "engine-panicked",
            Self::ThreadPanicked => "thread-panicked",
            Self::Quarantined => "quarantined",
            Self::NotFinite => "not-finite",
            Self::ChecksumMismatch => "checksum-mismatch",
            Self::Killed => "killed",
            Self::ProcessEnded => "process-ended",
        }
    }
}

impl fmt::Display for FlightCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::EnginePanicked => "the physics engine panicked",
            Self::ThreadPanicked => "the thread of the scene panicked",
            Self::Quarantined => "the scene did not answer and is quarantined",
            Self::NotFinite => "a body's state was not finite",
            Self::ChecksumMismatch => "a client's copy has another checksum than its stream",
            Self::Killed => "the scene did not answer and its process was killed",
            Self::ProcessEnded => "the process of the scene ended",
        })
    }
}

/// Longest text of a printed command.
const COMMAND_TEXT_MAX: usize = 240;

/// Prints a file, oldest event first.
///
/// # Errors
///
/// For a file that cannot be read, with its path and the cause.
pub(crate) fn run(path: &Path, out: &mut dyn Write) -> Result<(), Box<dyn Error>> {
    let shown = path.display();
    let bytes = fs::read(path).map_err(|cause| format!("cannot read {shown}: {cause}"))?;
    let (head, rest) = decode(&bytes).map_err(|cause| format!("{shown} {cause}"))?;
    writeln!(out, "scene {}", head.scene)?;
    writeln!(out, "cause {}", head.cause)?;
    writeln!(
        out,
        "written {} seconds after 1970 by rhumb-server {}",
        head.written, head.server
    )?;
    writeln!(out, "{} older entries are not kept", head.dropped)?;
    for entry in entries(rest) {
        let entry = entry.ok_or_else(|| format!("{shown} has an entry of another version"))?;
        writeln!(out, "{}", text(&entry))?;
    }
    Ok(())
}

fn text(entry: &LogEntry) -> String {
    let ms = |span: Span| span.as_nanos() as f64 / 1e6;
    match entry {
        LogEntry::Joined(peer, client) => {
            let client = client.as_deref().unwrap_or("without a token");
            format!("client {} joins: {client}", peer.0)
        }
        LogEntry::Left(peer) => format!("client {} leaves", peer.0),
        LogEntry::Received(received) => {
            let shown = command(&received.bytes, received.length as usize);
            format!(
                "client {} command {}: {shown}",
                received.member.0, received.number
            )
        }
        LogEntry::Refused(error) => format!("  refused: {error}"),
        LogEntry::StepBegan(at, tick) => {
            let seconds = at.as_nanos() as f64 / 1e9;
            format!("{seconds:.6} s: step from tick {}", tick.value())
        }
        LogEntry::Stepped(digest) => format!("  digest {digest:016x}"),
        LogEntry::Measured(metrics) => format!(
            "  tick {}: step {:.3} ms, publish {:.3} ms, {} members, {} bodies, {} awake",
            metrics.tick.value(),
            ms(metrics.step),
            ms(metrics.publish),
            metrics.members,
            metrics.bodies,
            metrics.awake,
        ),
        LogEntry::Packet(head) => format!("  {}, {} bytes", packet(head.bytes()), head.length),
        changes => format!("  {changes:?}"),
    }
}

/// A command as far as it was kept.
fn command(bytes: &[u8], length: usize) -> String {
    if bytes.len() < length {
        return format!(
            "{length} bytes, of which {} were kept: {bytes:02x?}",
            bytes.len()
        );
    }
    let mut from = Reader::new(bytes);
    match Command::decode(&mut from) {
        Ok(command) => {
            let text = format!("{command:?}");
            text.chars().take(COMMAND_TEXT_MAX).collect()
        }
        Err(error) => format!("{error:?}: {bytes:02x?}"),
    }
}

fn packet(head: &[u8]) -> String {
    match Datagram::open(head) {
        Ok(datagram) => {
            let head = datagram.head();
            format!("{}: {:?}", head.stream, head.kind)
        }
        Err(error) => format!("packet {head:02x?}: {error:?}"),
    }
}

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
}
