//! A scene that follows the log of another server, to take its place soon.
//!
//! Reads what the other one has written since, while it writes, and changes no file. Invariants: a followed scene is a state
//! that the recorded run went through; before it is served, its log is read to the durable end, or it is not used.

use rhumb_scene::engine::StepThreads;

use super::disk::{Damage, DataError};
use super::format::LogFrames;
use super::recovery::{LogTail, ReplayStart, Restored};
use super::scene_files::SceneFiles;

impl SceneFiles {
    /// A scene as its files have it now, to be followed; `None` if its creation is not durable.
    pub(super) fn begin_to_follow(
        &self,
        workers: &StepThreads,
        beat: &mut dyn FnMut(),
    ) -> Result<Option<Restored>, DataError> {
        self.restore(workers, (ReplayStart::Newest, LogTail::Kept), beat)
    }

    /// Does what the log has since; the scene is of no more use after an error.
    pub(super) fn catch_up(
        &self,
        mut followed: Restored,
        beat: &mut dyn FnMut(),
    ) -> Result<Restored, DataError> {
        loop {
            let (number, length) = followed.last;
            let bytes = self.read_segment(number)?;
            let path = self.segment_path(number);
            let cut = Damage::Bytes {
                at: bytes.len() as u64,
                after: followed.scene.tick(),
            };
            let rest = bytes.get(length as usize..);
            let frames = LogFrames::read(rest.ok_or_else(|| DataError::damaged(&path, cut))?);
            followed = followed.replay(&path, &frames.frames, beat)?;
            followed.last.1 += frames.length as u64;
            if !self.goes_on(&mut followed)? {
                return Ok(followed);
            }
        }
    }

    /// Goes to the next segment, if all before it is done; false if it is not there yet.
    fn goes_on(&self, followed: &mut Restored) -> Result<bool, DataError> {
        let next = followed.last.0 + 1;
        let (segments, _) = self.numbers()?;
        if !segments.contains(&next) {
            return Ok(false);
        }
        let bytes = self.read_segment(next)?;
        let frames = LogFrames::read(&bytes);
        let header = self.header_of(next, &frames)?;
        let (Some(header), Some(first)) = (header, frames.frames.first()) else {
            return Ok(false);
        };
        if header.previous != Some(followed.last) {
            return Ok(false);
        }
        followed.last = (next, first.bytes() as u64);
        followed.next_segment = next + 1;
        Ok(true)
    }

    /// True if a followed scene has everything that its files have: nothing is written any more.
    pub(super) fn is_at_end(&self, followed: &Restored) -> Result<bool, DataError> {
        let (segments, _) = self.numbers()?;
        let is_newest = segments.iter().max() == Some(&followed.last.0);
        let head = self.read_head()?;
        let has_head = head.is_some_and(|head| (head.segment, head.length) <= followed.last);
        Ok(is_newest && has_head)
    }
}
