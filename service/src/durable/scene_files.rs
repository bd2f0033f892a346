//! The files of a scene: its directory's name, its log's segments, snapshots.
//!
//! Segment n is `n.log`, and the state at its beginning `n.snapshot`; segment 0 begins with an empty scene. A segment
//! is never appended to by a later process. Its first frame states where the segment before it ends, so that a torn end
//! of that one differs from damage; for the newest one, the head does.

use std::collections::BTreeMap;
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

/// The number in the name of a scene's directory: the greatest one has the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Generation(pub(crate) u64);

/// Ends the name of a directory whose scene was deleted.
pub(super) const DELETED: &str = "deleted";
/// Ends the name of a directory whose scene was repaired.
pub(super) const DAMAGED: &str = "damaged";
/// Ends the name of a directory that is being made.
pub(super) const UNFINISHED: &str = "unfinished";

/// The name of the directory of a scene, with the number of its creation.
pub(super) fn directory_name(scene: &SceneName, number: u64) -> String {
    format!("{}.{number}", escape(scene))
}

/// A scene's name in that of a directory. Some file systems do not tell capitals from small letters, and a dot separates.
fn escape(scene: &SceneName) -> String {
    let mut escaped = String::new();
    for byte in scene.as_str().bytes() {
        match byte {
            b'a'..=b'z' | b'0'..=b'9' | b'-' | b'_' => escaped.push(char::from(byte)),
            _ => escaped.push_str(&format!("%{byte:02x}")),
        }
    }
    escaped
}

/// The scene of a directory.
pub(super) fn scene_of(directory: &str) -> Option<SceneName> {
    Some(parse_directory(directory)?.0)
}

/// The scene of a directory, and the number of its creation.
pub(super) fn parse_directory(directory: &str) -> Option<(SceneName, u64)> {
    let (escaped, number) = directory.rsplit_once('.')?;
    let mut parts = escaped.split('%');
    let mut name = parts.next()?.to_owned();
    for part in parts {
        let (code, rest) = part.split_at_checked(2)?;
        name.push(char::from(u8::from_str_radix(code, 16).ok()?));
        name.push_str(rest);
    }
    Some((name.parse().ok()?, number.parse().ok()?))
}

/// The same of a directory that is being deleted.
pub(super) fn parse_deleted_directory(directory: &str) -> Option<(SceneName, u64)> {
    parse_directory_apart(directory, DELETED)
}

/// The same of a directory of this ending, which is no scene.
fn parse_directory_apart(directory: &str, ending: &str) -> Option<(SceneName, u64)> {
    parse_directory(directory.strip_suffix(ending)?.strip_suffix('.')?)
}

/// The newest directory of each scene.
pub(super) fn newest_directories(names: &[String]) -> BTreeMap<SceneName, (u64, &String)> {
    let mut newest: BTreeMap<SceneName, (u64, &String)> = BTreeMap::new();
    for name in names {
        if let Some((scene, number)) = parse_directory(name) {
            let entry = newest.entry(scene).or_insert((number, name));
            *entry = (*entry).max((number, name));
        }
    }
    newest
}

/// The other ones: a crash kept a repair from putting them aside.
pub(super) fn older_directories(names: &[String]) -> Vec<&String> {
    let newest = newest_directories(names);
    let older = names.iter().filter(|name| {
        let scene = scene_of(name);
        let newest = scene.and_then(|scene| newest.get(&scene));
        newest.is_some_and(|(_, newest)| newest != name)
    });
    older.collect()
}

/// A number above those of all creations. Directories count that are no scene any more, or not yet: their names are taken.
pub(super) fn next_number(names: &[String]) -> u64 {
    let numbers = names.iter().filter_map(|name| parse_any_directory(name));
    let newest = numbers.map(|(_, number)| number).max();
    newest.map_or(0, |newest| newest + 1)
}

/// The scene and number of a directory, which may be no scene any more, or not yet.
fn parse_any_directory(name: &str) -> Option<(SceneName, u64)> {
    let apart = [DELETED, DAMAGED, UNFINISHED].into_iter();
    let mut apart = apart.filter_map(|ending| parse_directory_apart(name, ending));
    parse_directory(name).or_else(|| apart.next())
}

/// A directory with the number of its name.
pub(super) struct Numbered<'a> {
    pub(super) number: u64,
    pub(super) name: &'a str,
    /// False if it is no scene any more, or not yet.
    pub(super) is_scene: bool,
}

/// The directories of each scene.
pub(super) fn directories_by_scene(names: &[String]) -> BTreeMap<SceneName, Vec<Numbered<'_>>> {
    let mut by_scene: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for name in names {
        if let Some((scene, number)) = parse_any_directory(name) {
            by_scene.entry(scene).or_default().push(Numbered {
                number,
                name,
                is_scene: parse_directory(name).is_some(),
            });
        }
    }
    by_scene
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_s_name_round_trips_through_its_directory() {
        for name in ["pit", "Pit", "a/b", "x.0", "_-.A/z"] {
            let scene: SceneName = name.parse().unwrap();
            let directory = directory_name(&scene, 12);
            assert!(!directory.contains('/'));
            assert_eq!(
                parse_directory(&directory),
                Some((scene, 12)),
                "{directory}"
            );
        }
        assert_eq!(parse_directory("pit"), None);
        assert_eq!(parse_directory("pit.1.deleted"), None);
    }

    #[test]
    fn a_directory_that_is_no_scene_any_more_keeps_its_number() {
        for ending in ["", ".deleted", ".damaged", ".unfinished"] {
            let names = ["pit.2".to_owned(), format!("pit.7{ending}")];
            assert_eq!(next_number(&names), 8, "{ending}");
        }
        assert_eq!(next_number(&["pit.7.other".to_owned()]), 0);
    }
}
