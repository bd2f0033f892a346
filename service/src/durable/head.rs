//! The head of a scene's log: a file that says how far the log is durable.
//!
//! A log that is cut between two frames looks whole; its head says what is missing. Two places are written in turn, so
//! that a torn write leaves the one before. Invariant: the head never says more than the log has, because it is written
//! after the log is synchronised, and commands are acknowledged after the head is.

use std::path::PathBuf;

use rhumb_reckoning::Tick;

use super::disk::{Disk, LogFile, parent};
use super::error::DataError;

/// Begins each place.
const MAGIC: [u8; 4] = *b"RhH1";
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
        let mut bytes = MAGIC.to_vec();
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
        if *magic != MAGIC || crc32fast::hash(covered) != u32::from_le_bytes(*expected) {
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

#[cfg(test)]
mod tests {
    use super::*;

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
}
