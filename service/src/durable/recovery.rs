//! A scene from its files: the newest good snapshot, and the log after it.
//!
//! The log may be one that another server still writes: its scene is followed, to take its place soon. A followed scene is
//! served only once its log is read to the durable end.
//!
//! Every step of the replay is compared with the digest of the recorded one. Invariants: either the scene is a state
//! that the recorded run went through, with nothing lost that was synchronised, or there is an error; damaged files
//! never panic.

use std::path::{Path, PathBuf};

use rhumb_protocol::scene::{CommandError, SceneConfig, SceneName};
use rhumb_reckoning::Tick;
use rhumb_scene::engine::StepThreads;
use rhumb_scene::{LogEntry, Ownership, Scene, Sessions};

use super::disk::{Damage, DataError};
use super::format::{DurableEnd, LogFrame, LogFrames, OVERHEAD, Snapshot, Tail};
use super::scene_files::{LogHeader, SceneFiles};
use super::writer::Origin;

/// A scene as its files have it.
pub(crate) struct Restored {
    pub(crate) name: SceneName,
    pub(crate) scene: Scene,
    pub(crate) sessions: Sessions,
    pub(crate) ownership: Ownership,
    /// Number of the next segment.
    pub(super) next_segment: u32,
    /// Number and bytes of the last segment.
    pub(super) last: (u32, u64),
    /// Entries of sessions that are to be noted: they follow the end of the log.
    pub(crate) unnoted: Vec<LogEntry>,
    pub(crate) report: Report,
}

/// The state at which a replay begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ReplayStart {
    /// At the newest good snapshot.
    Newest,
    /// At the oldest state that the files have.
    Oldest,
}

/// Findings of the recovery of a scene.
#[derive(Clone, Debug, Default)]
pub(crate) struct Report {
    /// The tick of the snapshot; zero without one.
    pub(crate) from: Tick,
    /// Steps that were replayed.
    pub(crate) steps: u64,
    /// Commands that were replayed.
    pub(crate) commands: u64,
    /// The end of a segment that a crash cut off, and its bytes. It was never acknowledged as durable.
    pub(crate) torn: Option<(PathBuf, usize)>,
    /// Snapshots that could not be used.
    pub(crate) refused: Vec<String>,
}

impl Restored {
    /// The place at which its log continues.
    pub(crate) fn origin(&self) -> Origin {
        Origin {
            name: self.name.clone(),
            config: *self.scene.config(),
            tick: self.scene.tick(),
            segment: self.next_segment,
            previous: Some(self.last),
        }
    }

    /// Does everything in more frames of its log.
    pub(super) fn replay(
        self,
        path: &Path,
        frames: &[LogFrame<'_>],
        beat: &mut dyn FnMut(),
    ) -> Result<Self, DataError> {
        let mut report = self.report;
        let mut run = Run {
            scene: self.scene,
            sessions: self.sessions,
            ownership: self.ownership,
        };
        replay(path, frames, &mut run, &mut report, beat)?;
        Ok(Self {
            scene: run.scene,
            sessions: run.sessions,
            ownership: run.ownership,
            report,
            ..self
        })
    }
}

/// A segment that belongs to the run.
struct ChainLink {
    number: u32,
    header: LogHeader,
    bytes: Vec<u8>,
    /// Bytes that count.
    length: usize,
    torn: usize,
}

impl SceneFiles {
    /// The scene, or `None` if its creation was never durable. `beat` is called before each step.
    pub(crate) fn restore(
        &self,
        workers: &StepThreads,
        (start, tail): (ReplayStart, LogTail),
        beat: &mut dyn FnMut(),
    ) -> Result<Option<Restored>, DataError> {
        let (segments, snapshots) = self.numbers()?;
        let Some(head) = self.head_of(&segments)? else {
            return Ok(None);
        };
        let Some(mut chain) = self.chain(&segments, head)? else {
            return Ok(None);
        };
        let unnoted = match tail {
            LogTail::Kept => Vec::new(),
            LogTail::LeftOut => self.leave_out_tail(&mut chain)?,
        };
        let mut report = Report::default();
        let snapshot = self.first_snapshot(&chain, &snapshots, start, &mut report)?;
        let first = snapshot.as_ref().map_or(0, |snapshot| snapshot.segment);
        let last = &chain[chain.len() - 1];
        let (config, name) = (last.header.config, last.header.scene.clone());
        if last.torn > 0 {
            report.torn = Some((self.segment_path(last.number), last.torn));
        }
        let end = (last.number, last.length as u64);
        let newest = segments.iter().max().copied().unwrap_or(0);
        let mut run = self.begin(config, workers, snapshot)?;
        report.from = run.scene.tick();
        for link in chain.iter().filter(|link| link.number >= first) {
            let frames = LogFrames::read(&link.bytes[..link.length]);
            let path = self.segment_path(link.number);
            // The first one is the header.
            let frames = frames.frames.get(1..).unwrap_or_default();
            replay(&path, frames, &mut run, &mut report, beat)?;
        }
        Ok(Some(Restored {
            name,
            scene: run.scene,
            sessions: run.sessions,
            ownership: run.ownership,
            next_segment: newest + 1,
            last: end,
            unnoted,
            report,
        }))
    }

    /// Leaves out what follows the last step; returns the entries of sessions in it.
    fn leave_out_tail(&self, chain: &mut [ChainLink]) -> Result<Vec<LogEntry>, DataError> {
        let Some(link) = chain.last_mut() else {
            return Ok(Vec::new());
        };
        let frames = LogFrames::read(&link.bytes[..link.length]);
        let after = frames.frames.last().map_or(Tick::ZERO, |frame| frame.tick);
        let path = self.segment_path(link.number);
        let cut =
            cut(&frames).ok_or_else(|| DataError::damaged(&path, Damage::Unreadable { after }))?;
        link.length = cut.length;
        Ok(cut.sessions)
    }

    /// The durable end of the log; `None` if the scene's creation was never durable.
    fn head_of(&self, segments: &[u32]) -> Result<Option<DurableEnd>, DataError> {
        let Some(head) = self.read_head()? else {
            // A first segment precedes its head, and has nothing but its beginning then.
            return match segments {
                [] => Ok(None),
                [0] if LogFrames::read(&self.read_segment(0)?).frames.len() <= 1 => Ok(None),
                _ => Err(DataError::damaged(&self.head_path(), Damage::Missing)),
            };
        };
        if segments.contains(&head.segment) {
            return Ok(Some(head));
        }
        let path = self.segment_path(head.segment);
        Err(DataError::damaged(&path, Damage::Missing))
    }

    /// The segments from the oldest that is needed to the newest one, each checked up to where the next one begins.
    fn chain(
        &self,
        segments: &[u32],
        head: DurableEnd,
    ) -> Result<Option<Vec<ChainLink>>, DataError> {
        let mut chain: Vec<ChainLink> = Vec::new();
        let mut required: Option<(u32, u64)> = None;
        for number in segments.iter().rev() {
            let awaited = match required {
                // Only the newest segments may lack a beginning: they had no time to become durable.
                None if !chain.is_empty() => break,
                None => *number,
                Some((awaited, _)) => awaited,
            };
            if *number > awaited {
                continue;
            }
            if *number < awaited {
                // The rest is older than the oldest that is left; a snapshot may stand in for it.
                break;
            }
            let length = required.map(|(_, length)| length);
            let Some(link) = self.link(*number, length, head)? else {
                continue;
            };
            required = link.header.previous;
            chain.push(link);
        }
        chain.reverse();
        Ok((!chain.is_empty()).then_some(chain))
    }

    /// A segment; `None` if its beginning was never durable. `required`: the bytes that the next segment says it has.
    fn link(
        &self,
        number: u32,
        required: Option<u64>,
        head: DurableEnd,
    ) -> Result<Option<ChainLink>, DataError> {
        let path = self.segment_path(number);
        let bytes = self.read_segment(number)?;
        let frames = LogFrames::read(&bytes);
        let after = frames.frames.last().map_or(Tick::ZERO, |frame| frame.tick);
        let damage = Damage::Bytes {
            at: frames.length as u64,
            after,
        };
        if number == head.segment && (frames.length as u64) < head.length {
            let lost = Damage::End {
                at: frames.length as u64,
                of: head.length,
                after,
                through: head.tick,
            };
            return Err(DataError::damaged(&path, lost));
        }
        let header = self.header_of(number, &frames)?;
        let Some(header) = header else {
            return match required {
                None => Ok(None),
                Some(_) => Err(DataError::damaged(&path, Damage::Beginning)),
            };
        };
        let length = required.map_or(frames.length, |required| required as usize);
        let is_short = frames.length < length;
        if is_short || (required.is_none() && frames.tail == Tail::Damaged) {
            return Err(DataError::damaged(&path, damage));
        }
        let torn = match required {
            None => bytes.len() - frames.length,
            Some(_) => 0,
        };
        Ok(Some(ChainLink {
            number,
            header,
            length,
            torn,
            bytes,
        }))
    }

    /// The first good snapshot whose segment is in the chain; `None` to begin with an empty scene.
    fn first_snapshot(
        &self,
        chain: &[ChainLink],
        snapshots: &[u32],
        start: ReplayStart,
        report: &mut Report,
    ) -> Result<Option<Snapshot>, DataError> {
        let oldest = chain.first().map_or(0, |link| link.number);
        let mut usable: Vec<u32> = (snapshots.iter().copied())
            .filter(|number| chain.iter().any(|link| link.number == *number))
            .collect();
        match start {
            ReplayStart::Newest => usable.reverse(),
            ReplayStart::Oldest if oldest == 0 => usable.clear(),
            ReplayStart::Oldest => {}
        }
        let mut first_error = None;
        for number in &usable {
            match self.read_snapshot(*number) {
                Ok(snapshot) => return Ok(Some(snapshot)),
                Err(error) => {
                    report.refused.push(error.to_string());
                    first_error.get_or_insert(error);
                }
            }
        }
        if oldest == 0 {
            return Ok(None);
        }
        let missing = || DataError::damaged(&self.snapshot_path(oldest), Damage::Missing);
        Err(first_error.unwrap_or_else(missing))
    }

    pub(super) fn begin(
        &self,
        config: SceneConfig,
        workers: &StepThreads,
        snapshot: Option<Snapshot>,
    ) -> Result<Run, DataError> {
        let Some(snapshot) = snapshot else {
            let scene = Scene::on(config, workers)
                .map_err(|_| DataError::damaged(&self.segment_path(0), Damage::Beginning))?;
            return Ok(Run {
                scene,
                sessions: Sessions::default(),
                ownership: Ownership::default(),
            });
        };
        let path = self.snapshot_path(snapshot.segment);
        let at = (snapshot.tick, snapshot.digest);
        let scene = Scene::from_image(config, workers, at, &snapshot.scene)
            .map_err(|_| DataError::damaged(&path, Damage::NotAuthentic))?;
        Ok(Run {
            scene,
            sessions: snapshot.sessions,
            ownership: snapshot.ownership,
        })
    }
}

/// Does everything in the frames of a segment again.
fn replay(
    path: &Path,
    frames: &[LogFrame<'_>],
    run: &mut Run,
    report: &mut Report,
    beat: &mut dyn FnMut(),
) -> Result<(), DataError> {
    for frame in frames {
        let diverged = |at| DataError::damaged(path, Damage::Diverged { at });
        if frame.tick != run.scene.tick() {
            return Err(diverged(frame.tick));
        }
        let unreadable = Damage::Unreadable { after: frame.tick };
        let entries = LogEntry::decode_all(frame.payload)
            .map_err(|_| DataError::damaged(path, unreadable))?;
        for entry in entries {
            let next = run.scene.tick().next();
            beat();
            if !run.replay(&entry, report) {
                return Err(diverged(next));
            }
        }
    }
    Ok(())
}

/// A scene during a replay, with its sessions and owners.
pub(super) struct Run {
    pub(super) scene: Scene,
    sessions: Sessions,
    ownership: Ownership,
}

impl Run {
    /// Does what an entry says; `false` if the outcome is another one.
    pub(super) fn replay(&mut self, entry: &LogEntry, report: &mut Report) -> bool {
        self.sessions.replay(entry);
        if !rhumb_scene::replay(entry, &mut self.scene, &mut self.ownership) {
            return false;
        }
        match entry {
            LogEntry::Applied(_) => report.commands += 1,
            LogEntry::Stepped(digest) => {
                report.steps += 1;
                return self.scene.digest().value() == *digest;
            }
            _ => {}
        }
        true
    }
}

/// The use of the commands behind the last step of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum LogTail {
    /// They are done again.
    Kept,
    /// They are left out: the step after them did not end. Their sessions get them refused.
    LeftOut,
}

/// The part of a segment that stays, and the entries of sessions behind it.
pub(super) struct CutTail {
    /// Bytes of the segment up to the end of its last step, or else of its header.
    pub(super) length: usize,
    /// Entries of sessions behind that, in which no command was applied.
    pub(super) sessions: Vec<LogEntry>,
}

/// Cuts a segment behind its last step.
pub(super) fn cut(frames: &LogFrames<'_>) -> Option<CutTail> {
    let entries = |payload| LogEntry::decode_all(payload).ok();
    let (mut length, mut kept) = (0, (0, 0));
    for (place, frame) in frames.frames.iter().enumerate() {
        length += OVERHEAD + frame.payload.len();
        let is_step = |entry: &LogEntry| matches!(entry, LogEntry::Stepped(_));
        // The first frame holds the header.
        if place == 0 || entries(frame.payload)?.iter().any(is_step) {
            kept = (place + 1, length);
        }
    }
    let (count, length) = kept;
    let mut sessions = Vec::new();
    for frame in &frames.frames[count..] {
        for entry in entries(frame.payload)? {
            match entry {
                LogEntry::Counted(number, refused) => {
                    let error = refused.unwrap_or(CommandError::EngineFailed);
                    sessions.push(LogEntry::Counted(number, Some(error)));
                }
                LogEntry::Opened(_) | LogEntry::Granted(..) | LogEntry::Closed(_) => {
                    sessions.push(entry);
                }
                _ => {}
            }
        }
    }
    Some(CutTail { length, sessions })
}

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
            if !self.enter_next_segment(&mut followed)? {
                return Ok(followed);
            }
        }
    }

    /// Enters the next segment, if all before it is done; false if it is not there yet.
    fn enter_next_segment(&self, followed: &mut Restored) -> Result<bool, DataError> {
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
