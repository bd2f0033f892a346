//! The bytes of a scene's files: frames of a command log, and snapshots.
//!
//! Their bytes, and what is left of a damaged file. Pure. A frame is a magic number, the length of its payload, a
//! CRC-32 of all that follows it, the bytes of the file that were synchronised before, the scene's tick before its
//! records, and the payload. Invariants: a frame counts as a whole or not at all; reading never panics.
//!
//! Layout: magic number, version of the program and its engine, number of the segment that continues from it, tick,
//! digest, image of the sessions and owners, image of the scene, HMAC-SHA-256 of everything before. The engine trusts
//! its image, so that nothing behind the version is read before the code is verified.

use std::path::PathBuf;

use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::Tick;
use rhumb_scene::{Digest, IMAGE_FORMAT, Ownership, Sessions, decode_u64};
use ring::hmac;

use super::disk::{Damage, DataError, Disk, LogFile, parent};

/// Begins each frame, so that one is found behind damage.
const FRAME_MAGIC: [u8; 4] = *b"RhF1";
/// Bytes of a frame beside its payload.
pub(super) const OVERHEAD: usize = 4 + 4 + 4 + 8 + 8;
/// Bytes of a payload, at most: a batch with the longest commands stays far below.
const PAYLOAD_BYTES_MAX: usize = 1 << 30;

/// One frame, as it lies in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LogFrame<'a> {
    /// Bytes of the file that were synchronised when it was written.
    pub(super) synced: u64,
    /// The scene's tick before its records.
    pub(super) tick: Tick,
    pub(super) payload: &'a [u8],
}

/// The end of a segment, as far as its bytes tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Tail {
    /// The last frame ends with the file.
    Whole,
    /// Bytes follow that are no frame, and nothing shows that they were ever synchronised: the end of a write that a
    /// crash cut off.
    Torn,
    /// Bytes are no frame, though a later frame says that they were synchronised.
    Damaged,
}

/// The frames of a segment.
#[derive(Clone, Debug)]
pub(super) struct LogFrames<'a> {
    pub(super) frames: Vec<LogFrame<'a>>,
    /// Bytes of the frames.
    pub(super) length: usize,
    pub(super) tail: Tail,
}

impl LogFrame<'_> {
    /// Its bytes in a file.
    pub(super) const fn bytes(&self) -> usize {
        OVERHEAD + self.payload.len()
    }

    /// Appends the frame.
    pub(super) fn encode(&self, to: &mut Vec<u8>) {
        to.extend_from_slice(&FRAME_MAGIC);
        to.extend_from_slice(&(self.payload.len() as u32).to_le_bytes());
        let place = to.len();
        to.extend_from_slice(&[0; 4]);
        to.extend_from_slice(&self.synced.to_le_bytes());
        to.extend_from_slice(&self.tick.value().to_le_bytes());
        to.extend_from_slice(self.payload);
        let crc = crc(self.payload.len() as u32, &to[place + 4..]);
        to[place..place + 4].copy_from_slice(&crc.to_le_bytes());
    }
}

impl<'a> LogFrames<'a> {
    /// Reads a segment from its first byte.
    pub(super) fn read(bytes: &'a [u8]) -> Self {
        let mut frames = Vec::new();
        let mut length = 0;
        while let Some((frame, after)) = frame_at(bytes, length) {
            frames.push(frame);
            length = after;
        }
        let tail = if length == bytes.len() {
            Tail::Whole
        } else if was_synced(bytes, length) {
            Tail::Damaged
        } else {
            Tail::Torn
        };
        Self {
            frames,
            length,
            tail,
        }
    }
}

impl LogFrames<'_> {
    /// The ticks of all frames that are whole, also of those behind damage.
    pub(super) fn ticks(bytes: &[u8]) -> Vec<Tick> {
        let (mut ticks, mut from) = (Vec::new(), 0);
        while let Some(found) = find(bytes, from) {
            from = match frame_at(bytes, found) {
                Some((frame, after)) => {
                    ticks.push(frame.tick);
                    after
                }
                None => found + 1,
            };
        }
        ticks
    }
}

/// True if a frame behind a place says that the byte there was synchronised.
fn was_synced(bytes: &[u8], place: usize) -> bool {
    let mut from = place + 1;
    while let Some(found) = find(bytes, from) {
        if let Some((frame, _)) = frame_at(bytes, found)
            && frame.synced > place as u64
        {
            return true;
        }
        from = found + 1;
    }
    false
}

/// The next magic number from a place on.
fn find(bytes: &[u8], from: usize) -> Option<usize> {
    let rest = bytes.get(from..)?;
    let found = rest
        .windows(FRAME_MAGIC.len())
        .position(|four| four == FRAME_MAGIC);
    found.map(|place| from + place)
}

/// The frame at a place, and the place behind it.
fn frame_at(bytes: &[u8], place: usize) -> Option<(LogFrame<'_>, usize)> {
    let rest = bytes.get(place..)?;
    let (magic, rest) = rest.split_first_chunk::<4>()?;
    let (length, rest) = rest.split_first_chunk::<4>()?;
    let (expected, rest) = rest.split_first_chunk::<4>()?;
    let length = u32::from_le_bytes(*length);
    if *magic != FRAME_MAGIC || length as usize > PAYLOAD_BYTES_MAX {
        return None;
    }
    let covered = rest.get(..16 + length as usize)?;
    if crc(length, covered) != u32::from_le_bytes(*expected) {
        return None;
    }
    let (synced, covered) = covered.split_first_chunk::<8>()?;
    let (tick, payload) = covered.split_first_chunk::<8>()?;
    let frame = LogFrame {
        synced: u64::from_le_bytes(*synced),
        tick: Tick::new(u64::from_le_bytes(*tick)),
        payload,
    };
    Some((frame, place + OVERHEAD + payload.len()))
}

fn crc(length: u32, covered: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&length.to_le_bytes());
    hasher.update(covered);
    hasher.finalize()
}

/// Begins each place.
const HEAD_MAGIC: [u8; 4] = *b"RhH1";
/// Bytes of a place: magic number, CRC-32 of the rest, segment, length, tick.
const PLACE_BYTES: usize = 4 + 4 + 4 + 8 + 8;

/// The durable end of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct DurableEnd {
    /// Number of the newest segment.
    pub(super) segment: u32,
    /// Its durable bytes.
    pub(super) length: u64,
    /// The scene's tick before its last durable frame.
    pub(super) tick: Tick,
}

/// The file of a head that is being written.
pub(super) struct HeadFile {
    path: PathBuf,
    file: Box<dyn LogFile>,
    /// The place to write next.
    place: u64,
}

impl DurableEnd {
    fn encode(self) -> Vec<u8> {
        let mut covered = Vec::with_capacity(PLACE_BYTES);
        covered.extend_from_slice(&self.segment.to_le_bytes());
        covered.extend_from_slice(&self.length.to_le_bytes());
        covered.extend_from_slice(&self.tick.value().to_le_bytes());
        let mut bytes = HEAD_MAGIC.to_vec();
        bytes.extend_from_slice(&crc32fast::hash(&covered).to_le_bytes());
        bytes.extend_from_slice(&covered);
        bytes
    }

    /// The newer of the two places; `None` if neither is whole.
    pub(super) fn decode(bytes: &[u8]) -> Option<Self> {
        bytes.chunks(PLACE_BYTES).filter_map(Self::of_place).max()
    }

    fn of_place(bytes: &[u8]) -> Option<Self> {
        let (magic, rest) = bytes.split_first_chunk::<4>()?;
        let (expected, covered) = rest.split_first_chunk::<4>()?;
        if *magic != HEAD_MAGIC || crc32fast::hash(covered) != u32::from_le_bytes(*expected) {
            return None;
        }
        let (segment, rest) = covered.split_first_chunk::<4>()?;
        let (length, rest) = rest.split_first_chunk::<8>()?;
        let tick = rest.first_chunk::<8>()?;
        Some(Self {
            segment: u32::from_le_bytes(*segment),
            length: u64::from_le_bytes(*length),
            tick: Tick::new(u64::from_le_bytes(*tick)),
        })
    }
}

impl HeadFile {
    /// Replaces the head; it is durable on return, and so are the names of the directory.
    pub(super) fn begin(
        disk: &dyn Disk,
        path: PathBuf,
        head: DurableEnd,
    ) -> Result<Self, DataError> {
        let failed = |doing| DataError::io(&path, doing);
        let temporary = path.with_extension("tmp");
        match disk.remove(&temporary) {
            Err(cause) if cause.kind() != std::io::ErrorKind::NotFound => {
                return Err(failed("replace")(cause));
            }
            _ => {}
        }
        let mut file = disk.create(&temporary).map_err(failed("create"))?;
        let bytes = head.encode().repeat(2);
        file.append(&bytes).map_err(failed("write"))?;
        file.sync().map_err(failed("synchronise"))?;
        (disk.rename(&temporary, &path)).map_err(failed("rename"))?;
        (disk.sync_directory(&parent(&path))).map_err(failed("synchronise"))?;
        let place = 0;
        Ok(Self { path, file, place })
    }

    /// Advances the head; it is durable on return.
    pub(super) fn write(&mut self, head: DurableEnd) -> Result<(), DataError> {
        let at = self.place * PLACE_BYTES as u64;
        (self.file.write_at(at, &head.encode())).map_err(DataError::io(&self.path, "write"))?;
        (self.file.sync()).map_err(DataError::io(&self.path, "synchronise"))?;
        self.place = 1 - self.place;
        Ok(())
    }
}

const SNAPSHOT_MAGIC: [u8; 8] = *b"RhSnap1\0";
const CODE_BYTES: usize = 32;
const VERSION_BYTES_MAX: usize = 200;

/// The state of a scene at the beginning of a segment.
#[derive(Clone, Debug)]
pub(super) struct Snapshot {
    /// Number of the segment.
    pub(super) segment: u32,
    pub(super) tick: Tick,
    pub(super) digest: Digest,
    pub(super) sessions: Sessions,
    pub(super) ownership: Ownership,
    /// The image of the scene.
    pub(super) scene: Vec<u8>,
}

impl Snapshot {
    pub(super) fn encode(&self, key: &hmac::Key) -> Vec<u8> {
        let mut to = Writer::new();
        to.raw(&SNAPSHOT_MAGIC);
        to.sized(version().as_bytes());
        to.varint(u64::from(self.segment));
        to.varint(self.tick.value());
        to.raw(&self.digest.value().to_le_bytes());
        let mut members = Writer::new();
        self.sessions.encode(&mut members);
        self.ownership.encode(&mut members);
        to.sized(&members.into_bytes());
        to.raw(&self.scene);
        let mut bytes = to.into_bytes();
        let code = hmac::sign(key, &bytes);
        bytes.extend_from_slice(code.as_ref());
        bytes
    }

    pub(super) fn decode(bytes: &[u8], key: &hmac::Key) -> Result<Self, Damage> {
        let split = bytes.len().checked_sub(CODE_BYTES);
        let (signed, code) = bytes.split_at(split.ok_or(Damage::NotAuthentic)?);
        hmac::verify(key, signed, code).map_err(|_| Damage::NotAuthentic)?;
        let mut from = Reader::new(signed);
        let version = read_version(&mut from).map_err(|_| Damage::NotAuthentic)?;
        if version != self::version() {
            return Err(Damage::Version { found: version });
        }
        Self::read(&mut from).map_err(|_| Damage::NotAuthentic)
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let segment = from.varint32()?;
        let tick = Tick::new(from.varint()?);
        let digest = Digest::from_value(decode_u64(from)?);
        let mut inner = Reader::new(from.sized(from.rest().len())?);
        let sessions = Sessions::decode(&mut inner)?;
        let ownership = Ownership::decode(&mut inner)?;
        inner.finish()?;
        Ok(Self {
            segment,
            tick,
            digest,
            sessions,
            ownership,
            scene: from.rest().to_vec(),
        })
    }
}

/// The engine's version is that of this program's lock file: another one may run to other bits.
fn version() -> String {
    let program = env!("CARGO_PKG_VERSION");
    format!("rhumb-server {program} with {IMAGE_FORMAT}")
}

fn read_version(from: &mut Reader<'_>) -> Result<String, Malformed> {
    if from.raw(SNAPSHOT_MAGIC.len())? != SNAPSHOT_MAGIC {
        return Err(Malformed::UnknownCode);
    }
    let text = from.sized(VERSION_BYTES_MAX)?;
    String::from_utf8(text.to_vec()).map_err(|_| Malformed::Text)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A file of these payloads, each synchronised before the next one; and the place behind each frame.
    fn file(payloads: &[Vec<u8>]) -> (Vec<u8>, Vec<usize>) {
        let (mut bytes, mut ends) = (Vec::new(), Vec::new());
        for (place, payload) in payloads.iter().enumerate() {
            let synced = bytes.len() as u64;
            let tick = Tick::new(place as u64);
            LogFrame {
                synced,
                tick,
                payload,
            }
            .encode(&mut bytes);
            ends.push(bytes.len());
        }
        (bytes, ends)
    }

    fn payloads() -> impl Strategy<Value = Vec<Vec<u8>>> {
        proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..40), 1..8)
    }

    proptest! {
        #[test]
        fn a_file_cut_anywhere_keeps_its_whole_frames(payloads in payloads(), cut in any::<prop::sample::Index>()) {
            let (bytes, ends) = file(&payloads);
            let cut = cut.index(bytes.len() + 1);
            let read = LogFrames::read(&bytes[..cut]);
            let whole = ends.iter().filter(|end| **end <= cut).count();
            prop_assert_eq!(read.frames.len(), whole);
            for (frame, payload) in read.frames.iter().zip(&payloads) {
                prop_assert_eq!(frame.payload, &payload[..]);
            }
            let expected = if read.length == cut { Tail::Whole } else { Tail::Torn };
            prop_assert_eq!(read.tail, expected);
        }

        #[test]
        fn a_flipped_bit_is_never_read_and_is_damage_if_the_bytes_were_synchronised(
            payloads in payloads(),
            flip in any::<prop::sample::Index>(),
            bit in 0..8_u8,
        ) {
            let (mut bytes, ends) = file(&payloads);
            let place = flip.index(bytes.len());
            bytes[place] ^= 1 << bit;
            let read = LogFrames::read(&bytes);
            let whole = ends.iter().filter(|end| **end <= place).count();
            prop_assert_eq!(read.frames.len(), whole);
            let is_last = whole + 1 == payloads.len();
            prop_assert_eq!(read.tail, if is_last { Tail::Torn } else { Tail::Damaged });
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let read = LogFrames::read(&bytes);
            prop_assert!(read.length <= bytes.len());
        }

        #[test]
        fn a_hole_before_a_frame_that_was_not_synchronised_is_torn(payloads in payloads()) {
            // Two frames of one write: the disk kept the second and lost the first.
            let (before, _) = file(&payloads);
            let synced = before.len() as u64;
            let mut bytes = before.clone();
            let frame = |payload| LogFrame { synced, tick: Tick::new(9), payload };
            frame(&[1, 2, 3]).encode(&mut bytes);
            let hole = before.len()..bytes.len();
            bytes[hole].fill(0);
            frame(&[4]).encode(&mut bytes);
            let read = LogFrames::read(&bytes);
            prop_assert_eq!((read.length, read.tail), (before.len(), Tail::Torn));
        }
    }

    fn head(length: u64) -> DurableEnd {
        DurableEnd {
            segment: 3,
            length,
            tick: Tick::new(length / 2),
        }
    }

    #[test]
    fn the_newer_place_counts_and_a_torn_one_leaves_the_other() {
        let (old, new) = (head(70).encode(), head(300).encode());
        for (first, second) in [(&old, &new), (&new, &old)] {
            let both = [first.clone(), second.clone()].concat();
            assert_eq!(DurableEnd::decode(&both), Some(head(300)));
        }
        for torn in 0..PLACE_BYTES {
            let mut both = [old.clone(), new.clone()].concat();
            both[PLACE_BYTES + torn] ^= 1;
            assert_eq!(DurableEnd::decode(&both), Some(head(70)), "byte {torn}");
            let cut = &[old.clone(), new[..torn].to_vec()].concat();
            assert_eq!(DurableEnd::decode(cut), Some(head(70)), "cut to {torn}");
            assert_eq!(DurableEnd::decode(&old[..torn]), None);
        }
    }

    #[test]
    fn a_damaged_snapshot_is_never_read() {
        let key = hmac::Key::new(hmac::HMAC_SHA256, &[7; 32]);
        let snapshot = Snapshot {
            segment: 3,
            tick: Tick::new(600),
            digest: Digest::START,
            sessions: Sessions::default(),
            ownership: Ownership::default(),
            scene: vec![1, 2, 3],
        };
        let bytes = snapshot.encode(&key);
        let read = Snapshot::decode(&bytes, &key).unwrap();
        assert_eq!(
            (read.segment, read.tick, read.scene),
            (3, Tick::new(600), vec![1, 2, 3])
        );
        for place in 0..bytes.len() {
            let mut flipped = bytes.clone();
            flipped[place] ^= 0x10;
            let refused = Snapshot::decode(&flipped, &key).err();
            assert_eq!(refused, Some(Damage::NotAuthentic), "byte {place}");
            let cut = Snapshot::decode(&bytes[..place], &key).err();
            assert_eq!(cut, Some(Damage::NotAuthentic), "cut to {place}");
        }
        let other = hmac::Key::new(hmac::HMAC_SHA256, &[8; 32]);
        assert!(Snapshot::decode(&bytes, &other).is_err());
    }
}
