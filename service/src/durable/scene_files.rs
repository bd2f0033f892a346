//! The files of one scene: segments of its command log, and snapshots.
//!
//! Segment n is `n.log`, and the state at its beginning `n.snapshot`; segment 0 begins with an empty scene. A segment
//! is never appended to by a later process. Its first frame states where the segment before it ends, so that a torn end
//! of that one differs from damage; for the newest one, the head does.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use rhumb_protocol::scene::{SceneConfig, SceneName};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::Tick;
use rhumb_scene::Batch;
use ring::hmac;

use super::disk::{Damage, DataError, Disk, LogFile, parent, write_whole};
use super::format::{DurableEnd, HeadFile, LogFrame, LogFrames, Snapshot, Tail};

/// The directory of one scene.
#[derive(Clone)]
pub(crate) struct SceneFiles {
    pub(super) disk: Arc<dyn Disk>,
    pub(super) directory: PathBuf,
    pub(super) key: hmac::Key,
    /// With a directory of scenes: true once the files were there. They are not made again, as another server may have taken
    /// them over.
    pub(super) is_there: Option<Arc<AtomicBool>>,
}

/// The first record of a segment.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct LogHeader {
    pub(super) scene: SceneName,
    pub(super) config: SceneConfig,
    /// Number and bytes of the segment before it, unless it continues from its own snapshot alone.
    pub(super) previous: Option<(u32, u64)>,
}

/// A segment that is being written.
pub(super) struct Segment {
    path: PathBuf,
    file: Box<dyn LogFile>,
    pub(super) number: u32,
    /// Bytes written.
    pub(super) length: u64,
    /// Bytes that are durable.
    synced: u64,
    /// The scene's tick before the last frame.
    tick: Tick,
    /// `None` until the first frame is durable.
    head: Option<HeadFile>,
}

/// Ends the name of a directory whose scene was deleted.
pub(super) const DELETED: &str = "deleted";
/// Ends the name of a directory whose scene was repaired.
pub(super) const DAMAGED: &str = "damaged";
/// Ends the name of a directory that is being made.
pub(super) const UNFINISHED: &str = "unfinished";
/// Version of the format of headers and entries, and of what a scene makes of them: a push that was shortened by format 4
/// acts whole.
const FORMAT: u8 = 5;

impl SceneFiles {
    pub(super) fn segment_path(&self, number: u32) -> PathBuf {
        self.directory.join(format!("{number:08}.log"))
    }

    pub(super) fn snapshot_path(&self, number: u32) -> PathBuf {
        self.directory.join(format!("{number:08}.snapshot"))
    }

    pub(super) fn head_path(&self) -> PathBuf {
        self.directory.join("head")
    }

    /// The head; `None` if there is none, because no segment was ever durable or because it is lost.
    pub(super) fn read_head(&self) -> Result<Option<DurableEnd>, DataError> {
        let path = self.head_path();
        let bytes = match self.disk.read(&path) {
            Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            read => read.map_err(DataError::io(&path, "read"))?,
        };
        let head = DurableEnd::decode(&bytes);
        head.map(Some)
            .ok_or_else(|| DataError::damaged(&path, Damage::Head))
    }

    /// Numbers of the segments and of the snapshots, in rising order.
    pub(super) fn numbers(&self) -> Result<(Vec<u32>, Vec<u32>), DataError> {
        let names =
            (self.disk.list(&self.directory)).map_err(DataError::io(&self.directory, "list"))?;
        let with = |suffix: &str| -> Vec<u32> {
            let numbers = names.iter();
            numbers
                .filter_map(|name| name.strip_suffix(suffix)?.parse().ok())
                .collect()
        };
        Ok((with(".log"), with(".snapshot")))
    }

    /// Makes the directory, unless it exists; its name is durable on return.
    pub(super) fn make_directory(&self) -> Result<(), DataError> {
        let is_there = self.is_there.as_deref();
        if is_there.is_some_and(|is_there| is_there.load(Ordering::Relaxed)) {
            return Ok(());
        }
        (self.disk.make_directory(&self.directory))
            .map_err(DataError::io(&self.directory, "make the directory"))?;
        if let Some(is_there) = is_there {
            is_there.store(true, Ordering::Relaxed);
        }
        self.sync_name()
    }

    /// Returns when the name of the directory is durable.
    fn sync_name(&self) -> Result<(), DataError> {
        let above = parent(&self.directory);
        (self.disk.sync_directory(&above)).map_err(DataError::io(&above, "synchronise"))
    }

    /// Begins a segment; it and its name are durable on return. The directory exists if a segment precedes it.
    pub(super) fn begin_segment(
        &self,
        number: u32,
        tick: Tick,
        header: &LogHeader,
    ) -> Result<Segment, DataError> {
        if header.previous.is_none() {
            self.make_directory()?;
        }
        let path = self.segment_path(number);
        let file = (self.disk.create(&path)).map_err(DataError::io(&path, "create"))?;
        let mut segment = Segment {
            path,
            file,
            number,
            length: 0,
            synced: 0,
            tick,
            head: None,
        };
        let mut payload = Writer::new();
        header.encode(&mut payload);
        let records = payload.into_bytes();
        segment.append(&[Batch { tick, records }])?;
        segment.sync()?;
        (self.disk.sync_directory(&self.directory))
            .map_err(DataError::io(&self.directory, "synchronise"))?;
        // After the names: a head never names a segment that a crash may lose.
        let end = segment.durable_end();
        segment.head = Some(HeadFile::begin(&*self.disk, self.head_path(), end)?);
        Ok(segment)
    }

    /// Writes a snapshot as a whole. The directory exists.
    pub(super) fn write_snapshot(&self, snapshot: &Snapshot) -> Result<(), DataError> {
        let path = self.snapshot_path(snapshot.segment);
        let bytes = snapshot.encode(&self.key);
        write_whole(&*self.disk, &path, &bytes).map_err(DataError::io(&path, "write"))
    }

    pub(super) fn read_snapshot(&self, number: u32) -> Result<Snapshot, DataError> {
        let path = self.snapshot_path(number);
        let bytes = (self.disk.read(&path)).map_err(DataError::io(&path, "read"))?;
        let read = Snapshot::decode(&bytes, &self.key);
        let snapshot = read.map_err(|damage| DataError::damaged(&path, damage))?;
        if snapshot.segment != number {
            return Err(DataError::damaged(&path, Damage::NotAuthentic));
        }
        Ok(snapshot)
    }

    /// Removes segments and snapshots before a number.
    pub(super) fn remove_before(&self, number: u32) -> Result<(), DataError> {
        let (segments, snapshots) = self.numbers()?;
        let segments = segments
            .into_iter()
            .map(|old| (old, self.segment_path(old)));
        let snapshots = snapshots
            .into_iter()
            .map(|old| (old, self.snapshot_path(old)));
        // Snapshots go last: a segment without one before it is of no use, a snapshot alone does no harm.
        for (old, path) in segments.chain(snapshots) {
            if old < number {
                (self.disk.remove(&path)).map_err(DataError::io(&path, "remove"))?;
            }
        }
        Ok(())
    }

    /// Removes everything. The directory has another name first, so that a crash does not leave half a scene.
    pub(crate) fn delete(&self) -> Result<(), DataError> {
        let mut deleted = self.directory.clone().into_os_string();
        deleted.push(".");
        deleted.push(DELETED);
        let deleted = PathBuf::from(deleted);
        (self.disk.rename(&self.directory, &deleted))
            .map_err(DataError::io(&self.directory, "rename"))?;
        self.sync_name()?;
        (self.disk.remove_directory(&deleted)).map_err(DataError::io(&deleted, "remove"))
    }

    /// The bytes of a segment.
    pub(super) fn read_segment(&self, number: u32) -> Result<Vec<u8>, DataError> {
        let path = self.segment_path(number);
        match self.disk.read(&path) {
            Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => {
                Err(DataError::damaged(&path, Damage::Missing))
            }
            read => read.map_err(DataError::io(&path, "read")),
        }
    }

    /// The header of a segment; `None` if its beginning was never durable.
    pub(super) fn header_of(
        &self,
        number: u32,
        frames: &LogFrames<'_>,
    ) -> Result<Option<LogHeader>, DataError> {
        let path = self.segment_path(number);
        let Some(first) = frames.frames.first() else {
            return match frames.tail {
                Tail::Damaged => Err(DataError::damaged(&path, Damage::Beginning)),
                Tail::Whole | Tail::Torn => Ok(None),
            };
        };
        let mut from = Reader::new(first.payload);
        let header = LogHeader::decode(&mut from).and_then(|header| {
            from.finish()?;
            Ok(header)
        });
        let header = header.map_err(|_| {
            let damage = match first.payload.first() {
                Some(format) if *format != FORMAT => Damage::Version {
                    found: format!("with logs of format {format}"),
                },
                _ => Damage::Unreadable { after: first.tick },
            };
            DataError::damaged(&path, damage)
        })?;
        Ok(Some(header))
    }
}

impl Segment {
    /// Appends batches, each in a frame.
    pub(super) fn append(&mut self, batches: &[Batch]) -> Result<(), DataError> {
        let mut bytes = Vec::new();
        for batch in batches {
            let frame = LogFrame {
                synced: self.synced,
                tick: batch.tick,
                payload: &batch.records,
            };
            frame.encode(&mut bytes);
            self.tick = batch.tick;
        }
        (self.file.append(&bytes)).map_err(DataError::io(&self.path, "append to"))?;
        self.length += bytes.len() as u64;
        Ok(())
    }

    /// Returns when everything appended is durable.
    pub(super) fn sync(&mut self) -> Result<(), DataError> {
        (self.file.sync()).map_err(DataError::io(&self.path, "synchronise"))?;
        self.synced = self.length;
        let end = self.durable_end();
        self.head.as_mut().map_or(Ok(()), |head| head.write(end))
    }

    const fn durable_end(&self) -> DurableEnd {
        DurableEnd {
            segment: self.number,
            length: self.synced,
            tick: self.tick,
        }
    }
}

impl Wire for LogHeader {
    fn encode(&self, to: &mut Writer) {
        to.u8(FORMAT);
        self.scene.encode(to);
        self.config.encode(to);
        to.u8(u8::from(self.previous.is_some()));
        if let Some((number, length)) = self.previous {
            to.varint(u64::from(number));
            to.varint(length);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        if from.u8()? != FORMAT {
            return Err(Malformed::UnknownCode);
        }
        let scene = SceneName::decode(from)?;
        let config = SceneConfig::decode(from)?;
        let previous = match from.u8()? {
            0 => None,
            1 => Some((from.varint32()?, from.varint()?)),
            _ => return Err(Malformed::UnknownCode),
        };
        Ok(Self {
            scene,
            config,
            previous,
        })
    }
}
