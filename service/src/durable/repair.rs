//! A damaged scene cut back to its last good tick.
//!
//! The longest run that the files still tell is sought: from the empty scene, or from any good snapshot, frame by frame, each
//! step compared with the recorded one. It gets a new directory, which one rename makes the scene's own; the old directory
//! stays beside it as it was, under another name. Invariants: nothing is removed; a scene that is repaired is restored by the
//! ordinary way, to the tick and the digest that were found; files of another version are not touched.

use std::path::{Path, PathBuf};

use rhumb_protocol::scene::{SceneConfig, SceneName};
use rhumb_reckoning::Tick;
use rhumb_scene::engine::StepThreads;
use rhumb_scene::{Digest, LogEntry};

use super::disk::{DataError, parent};
use super::format::{DurableEnd, HeadFile, LogFrames, OVERHEAD};
use super::recovery::{Report, Run};
use super::scene_files::{DAMAGED, LogHeader, SceneFiles, UNFINISHED};

/// The part of a damaged scene that is left, and the part that is lost.
#[derive(Debug)]
pub(crate) struct Cut {
    /// The state at which the run begins: a snapshot of this segment, or the empty scene.
    snapshot: Option<u32>,
    /// The segments of the run, and the bytes of each that stay.
    segments: Vec<(u32, u64)>,
    /// The tick before the records of the last frame that stays.
    frame_tick: Tick,
    config: SceneConfig,
    /// The tick to which the scene comes back.
    pub(crate) tick: Tick,
    pub(crate) digest: Digest,
    pub(crate) bodies: usize,
    /// The newest tick of which the files tell.
    pub(crate) newest: Tick,
    /// Bytes of the logs that are cut off.
    pub(crate) bytes: u64,
}

impl SceneFiles {
    /// The longest run that the files tell; `None` if they tell of no state at all.
    pub(crate) fn find_cut(&self, name: &SceneName) -> Result<Option<Cut>, DataError> {
        let (segments, snapshots) = self.numbers()?;
        let config = self.config_of(name, &segments)?;
        let Some(config) = config else {
            return Ok(None);
        };
        let mut best: Option<Cut> = None;
        let empty = segments.contains(&0).then_some(None);
        for start in empty.into_iter().chain(snapshots.into_iter().map(Some)) {
            let Some(cut) = self.run_from(start, name, config)? else {
                continue;
            };
            let rank = |cut: &Cut| (cut.tick, cut.segments.last().copied());
            if best.as_ref().is_none_or(|best| rank(&cut) > rank(best)) {
                best = Some(cut);
            }
        }
        let Some(mut cut) = best else {
            return Ok(None);
        };
        cut.newest = cut.tick.max(self.newest_tick(&segments)?);
        // Segments older than the snapshot are not needed; those before the last one are kept.
        let (last, kept) = (cut.segments.last().copied()).unwrap_or((cut.snapshot.unwrap_or(0), 0));
        for number in segments.into_iter().filter(|number| *number >= last) {
            let length = self.read_segment(number)?.len() as u64;
            cut.bytes += length - if number == last { kept } else { 0 };
        }
        Ok(Some(cut))
    }

    /// The configuration of the scene, from any segment whose beginning is whole.
    fn config_of(
        &self,
        name: &SceneName,
        segments: &[u32],
    ) -> Result<Option<SceneConfig>, DataError> {
        for number in segments {
            match self.whole_header(*number)? {
                Some(header) if header.scene == *name => return Ok(Some(header.config)),
                _ => {}
            }
        }
        Ok(None)
    }

    /// The header of a segment; `None` if it is damaged. That of another version is an error.
    fn whole_header(&self, number: u32) -> Result<Option<LogHeader>, DataError> {
        let bytes = self.read_segment(number)?;
        match self.header_of(number, &LogFrames::read(&bytes)) {
            Err(error) if error.is_damage() => Ok(None),
            header => header,
        }
    }

    /// The run from a state; `None` if the state cannot be used.
    fn run_from(
        &self,
        snapshot: Option<u32>,
        name: &SceneName,
        config: SceneConfig,
    ) -> Result<Option<Cut>, DataError> {
        let start = match snapshot
            .map(|number| self.read_snapshot(number))
            .transpose()
        {
            Err(error) if error.is_damage() => return Ok(None),
            start => start?,
        };
        let Ok(mut run) = self.begin(config, &StepThreads::default(), start) else {
            return Ok(None);
        };
        let mut cut = Cut {
            snapshot,
            segments: Vec::new(),
            frame_tick: run.scene.tick(),
            config,
            tick: run.scene.tick(),
            digest: run.scene.digest(),
            bodies: run.scene.body_count(),
            newest: run.scene.tick(),
            bytes: 0,
        };
        let first = snapshot.unwrap_or(0);
        let (segments, _) = self.numbers()?;
        let mut headers = Vec::new();
        for number in segments.into_iter().filter(|number| *number >= first) {
            let header = self.whole_header(number)?;
            let header = header.filter(|header| header.scene == *name);
            headers.extend(header.map(|header| (number, header.previous)));
        }
        let mut next = (headers.first().map(|(number, _)| *number)).filter(|next| *next == first);
        while let Some(number) = next {
            // Of several segments that continue one, a restoration follows the newest. It states how much of the one
            // before it counts: a tail on which a step hung does not.
            let states = |(next, previous): &(u32, Option<(u32, u64)>)| {
                let (before, length) = (*previous)?;
                (before == number && *next > before).then_some((*next, length))
            };
            let after = headers.iter().rev().find_map(states);
            let length = after.map(|(_, length)| length);
            let is_whole = self.follow((number, length), &mut run, &mut cut)?;
            next = after.map(|(after, _)| after).filter(|_| is_whole);
        }
        // An empty scene of which no log tells is no state of it.
        let has_state = snapshot.is_some() || !cut.segments.is_empty();
        Ok(has_state.then_some(cut))
    }

    /// Follows a segment as far as it is whole, and to this length at most; `false` if it is not whole to there.
    fn follow(
        &self,
        (number, most): (u32, Option<u64>),
        run: &mut Run,
        cut: &mut Cut,
    ) -> Result<bool, DataError> {
        let mut bytes = self.read_segment(number)?;
        if let Some(most) = most {
            bytes.truncate(usize::try_from(most).unwrap_or(usize::MAX));
        }
        let frames = LogFrames::read(&bytes);
        let mut length = 0;
        for (place, frame) in frames.frames.iter().enumerate() {
            // The first frame holds the header.
            if place > 0 && (frame.tick != run.scene.tick() || !run.take(frame.payload)) {
                return Ok(false);
            }
            length += (OVERHEAD + frame.payload.len()) as u64;
            cut.segments.retain(|(kept, _)| *kept != number);
            cut.segments.push((number, length));
            cut.frame_tick = frame.tick;
            cut.tick = run.scene.tick();
            cut.digest = run.scene.digest();
            cut.bodies = run.scene.body_count();
        }
        Ok(most.is_none_or(|most| length == most))
    }

    /// The newest tick of which the head or a frame tells.
    fn newest_tick(&self, segments: &[u32]) -> Result<Tick, DataError> {
        let head = match self.read_head() {
            Err(error) if error.is_damage() => None,
            head => head?,
        };
        let mut newest = head.map_or(Tick::ZERO, |head| head.tick);
        for number in segments {
            let bytes = self.read_segment(*number)?;
            for tick in LogFrames::ticks(&bytes) {
                newest = newest.max(tick);
            }
        }
        Ok(newest)
    }

    /// Makes the run the scene: in the directory of `to`, which is there as a whole or not at all. Returns the directory in
    /// which everything stays as it was.
    pub(crate) fn cut_back(
        &self,
        name: &SceneName,
        cut: &Cut,
        to: &Self,
    ) -> Result<PathBuf, DataError> {
        let with = |files: &Self, ending: &str| {
            let mut path = files.directory.clone().into_os_string();
            path.push(".");
            path.push(ending);
            Self {
                directory: path.into(),
                ..files.clone()
            }
        };
        let made = with(to, UNFINISHED);
        if !(self.disk.list(&made.directory))
            .map_err(DataError::io(&made.directory, "list"))?
            .is_empty()
        {
            (self.disk.remove_directory(&made.directory))
                .map_err(DataError::io(&made.directory, "remove"))?;
        }
        made.make_directory()?;
        self.write_cut(name, cut, &made)?;
        let above = parent(&self.directory);
        let rename = |from: &Self, to: &Self| {
            (self.disk.rename(&from.directory, &to.directory))
                .map_err(DataError::io(&from.directory, "rename"))?;
            // Before the next one: of two names that are not durable, a crash may lose either.
            (self.disk.sync_directory(&above)).map_err(DataError::io(&above, "synchronise"))
        };
        // From here on the new directory is the newest of the scene, and counts.
        rename(&made, to)?;
        let old = with(self, DAMAGED);
        rename(self, &old)?;
        Ok(old.directory)
    }

    fn write_cut(&self, name: &SceneName, cut: &Cut, made: &Self) -> Result<(), DataError> {
        let copy = |from: &Path, to: &Path, most: Option<u64>| {
            let mut bytes = (self.disk.read(from)).map_err(DataError::io(from, "read"))?;
            if let Some(most) = most {
                bytes.truncate(usize::try_from(most).unwrap_or(usize::MAX));
            }
            let mut file = (self.disk.create(to)).map_err(DataError::io(to, "create"))?;
            (file.append(&bytes)).map_err(DataError::io(to, "append to"))?;
            file.sync().map_err(DataError::io(to, "synchronise"))
        };
        if let Some(number) = cut.snapshot {
            let (from, to) = (self.snapshot_path(number), made.snapshot_path(number));
            copy(&from, &to, None)?;
        }
        let Some(last) = cut.segments.last() else {
            // Of the segment behind the snapshot nothing is left: it begins anew.
            let header = LogHeader {
                scene: name.clone(),
                config: cut.config,
                previous: None,
            };
            let number = cut.snapshot.unwrap_or(0);
            return made.begin_segment(number, cut.tick, &header).map(drop);
        };
        for (number, length) in &cut.segments {
            let (from, to) = (self.segment_path(*number), made.segment_path(*number));
            copy(&from, &to, Some(*length))?;
        }
        (self.disk.sync_directory(&made.directory))
            .map_err(DataError::io(&made.directory, "synchronise"))?;
        let end = DurableEnd {
            segment: last.0,
            length: last.1,
            tick: cut.frame_tick,
        };
        HeadFile::begin(&*self.disk, made.head_path(), end).map(drop)
    }
}

impl Run {
    /// Does the entries of a frame; `false` if they are not of this version, or lead elsewhere.
    fn take(&mut self, payload: &[u8]) -> bool {
        let Ok(entries) = LogEntry::decode_all(payload) else {
            return false;
        };
        let mut report = Report::default();
        entries.iter().all(|entry| self.replay(entry, &mut report))
    }
}
