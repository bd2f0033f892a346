//! States to which a scene returns: bytes, and copies in memory.
//!
//! Layout: magic number, version, configuration, tick and digest of the image, image, the entries since then, CRC-32 of
//! everything before. An engine has an image only right after a step; what was commanded since is applied again. Invariant:
//! a scene from a checkpoint is at the tick and the digest of the scene that was saved, or there is an error.
//!
//! Holds a copy of the scene as it was after an earlier step, and does again what was done since, without the commands
//! on which the engine fails. A scene that runs the same commands runs to the same bits, so that members notice only
//! what was left out. Reads no clock: the running scene adds the time of steps. Invariants: a restored scene is at the
//! tick of the failed one, and a copy of it has taken the next step.

use std::fmt;

use rhumb_protocol::Span;
use rhumb_protocol::scene::{Command, InvalidSceneName, SceneConfig, SceneName};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::Tick;

use crate::engine::StepThreads;
use crate::permit::Ownership;
use crate::record::{AppliedCommand, Author, LogEntry, decode_u64};
use crate::scene::{Digest, IMAGE_FORMAT, Scene};

const MAGIC: [u8; 8] = *b"RhCheck1";
const CODE_BYTES: usize = 4;
const VERSION_BYTES_MAX: usize = 200;

/// A scene at a moment: bodies, shapes, joints, sleeping islands, contacts and the engine's own memory of them.
///
/// A scene that is made of it, given the same commands before the same ticks, runs to the same bits on every machine. It
/// has the ids of bodies, and neither members nor owners; a hook of the server begins anew.
///
/// The bytes are for programs of the same version. Their checksum finds damage and no malice: the engine trusts its image.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    config: SceneConfig,
    /// Tick and digest of the image.
    at: (Tick, Digest),
    image: Vec<u8>,
    /// Changes since the image.
    since: Vec<LogEntry>,
}

/// Reason why a scene cannot be saved, or not be made of a checkpoint.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CheckpointError {
    /// The text cannot name a scene.
    SceneName {
        /// The text, as the caller wrote it.
        scene: String,
        /// The rule that it breaks.
        cause: InvalidSceneName,
    },
    /// The server has no scene of this name.
    NoSuchScene(SceneName),
    /// The server has a scene of this name.
    SceneExists(SceneName),
    /// The scene stands still, because its engine failed.
    Faulted,
    /// Commands since the last step are not kept: they are too many, or the server's limit of restorations is zero.
    Changed,
    /// The scene's engine has no image.
    NoImage,
    /// The scene is fed: its owner's engine has the state.
    Fed,
    /// The bytes are no checkpoint, or damaged.
    Damaged,
    /// A checkpoint of another version.
    Version {
        /// The version that it is of.
        found: String,
    },
    /// The scene does not run to the tick and the digest that the checkpoint has.
    Differs {
        /// The tick of its image.
        tick: Tick,
    },
    /// The server has no place or no time for the scene, or does not take its configuration.
    NotAdmitted(String),
    /// The scene works on something without end.
    NoAnswer(SceneName),
    /// The server in this process is not of a kind that can be asked, or has ended.
    NoServer,
}

impl fmt::Display for CheckpointError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SceneName { scene, cause } => write!(f, "{scene:?}: {cause}"),
            Self::NoSuchScene(name) => write!(f, "the server has no scene \"{name}\""),
            Self::SceneExists(name) => {
                write!(f, "the server already has a scene \"{name}\": give another name")
            }
            Self::Faulted => f.write_str("the scene stands still, because its engine failed"),
            Self::Changed => f.write_str(
                "the commands since the last step are not kept: save the scene right after a step",
            ),
            Self::NoImage => f.write_str("the engine of the scene cannot be saved"),
            Self::Fed => f.write_str(
                "the engine of the program that feeds the scene has its state: save it there",
            ),
            Self::Damaged => f.write_str("the bytes are no checkpoint, or damaged"),
            Self::Version { found } => write!(
                f,
                "the checkpoint is of \"{found}\", and this program reads those of \"{}\"",
                version()
            ),
            Self::Differs { tick } => write!(
                f,
                "the scene does not run again from tick {tick} as the checkpoint says: it was made on a machine that computes otherwise"
            ),
            Self::NotAdmitted(reason) => write!(f, "the server does not take the scene: {reason}"),
            Self::NoAnswer(name) => write!(f, "the scene \"{name}\" does not answer"),
            Self::NoServer => f.write_str(
                "scenes are saved and restored by a server of this process alone, and it runs no more or is of another kind",
            ),
        }
    }
}

impl std::error::Error for CheckpointError {}

/// The engine's version is that of this program's lock file: another one may run to other bits.
fn version() -> String {
    format!("rhumb {} with {IMAGE_FORMAT}", env!("CARGO_PKG_VERSION"))
}

impl Checkpoint {
    /// The state of a scene. `base`: an earlier one and the changes since, for a scene that was changed after its last step.
    pub(crate) fn of<'a>(
        scene: &Scene,
        base: Option<(&Scene, impl Iterator<Item = &'a LogEntry>)>,
    ) -> Result<Self, CheckpointError> {
        if !scene.is_sound() {
            return Err(CheckpointError::Faulted);
        }
        let (from, frozen, since) = match (scene.freeze(), base) {
            (Some(frozen), _) => (scene, frozen, Vec::new()),
            (None, Some((base, since))) => {
                let frozen = base.freeze().ok_or(CheckpointError::NoImage)?;
                (base, frozen, since.map(unattributed).collect())
            }
            (None, None) => return Err(CheckpointError::Changed),
        };
        Ok(Self {
            config: *from.config(),
            at: (from.tick(), from.digest()),
            image: frozen.encode().ok_or(CheckpointError::NoImage)?,
            since,
        })
    }

    /// The tick of the scene.
    #[must_use]
    pub fn tick(&self) -> Tick {
        let steps = self.steps().count() as u64;
        Tick::new(self.at.0.value() + steps)
    }

    /// The digest of all observations of the scene.
    #[must_use]
    pub fn digest(&self) -> Digest {
        let last = self.steps().last();
        last.map_or(self.at.1, Digest::from_value)
    }

    /// The configuration of the scene.
    #[must_use]
    pub const fn config(&self) -> &SceneConfig {
        &self.config
    }

    /// The digests of the steps since the image.
    fn steps(&self) -> impl Iterator<Item = u64> {
        self.since.iter().filter_map(|entry| match entry {
            LogEntry::Stepped(digest) => Some(*digest),
            _ => None,
        })
    }

    /// A scene that continues from it.
    ///
    /// # Errors
    ///
    /// [`CheckpointError::Damaged`] for an image that its engine does not read, and [`CheckpointError::Differs`].
    pub fn scene(&self, threads: &StepThreads) -> Result<Scene, CheckpointError> {
        let mut scene = self.scene_at_last_step(threads)?;
        self.apply_pending(&mut scene)?;
        Ok(scene)
    }

    /// The scene right after its last step.
    pub(crate) fn scene_at_last_step(
        &self,
        threads: &StepThreads,
    ) -> Result<Scene, CheckpointError> {
        let scene = Scene::from_image(self.config, threads, self.at, &self.image);
        let mut scene = scene.map_err(|_| CheckpointError::Damaged)?;
        self.replay(self.since_split().0, &mut scene)?;
        Ok(scene)
    }

    /// Does again what changed after the last step.
    pub(crate) fn apply_pending(&self, scene: &mut Scene) -> Result<(), CheckpointError> {
        self.replay(self.since_split().1, scene)
    }

    /// The changes up to the last step since the image, and those after it.
    fn since_split(&self) -> (&[LogEntry], &[LogEntry]) {
        let is_step = |entry: &LogEntry| matches!(entry, LogEntry::Stepped(_));
        let last = self.since.iter().rposition(is_step);
        self.since.split_at(last.map_or(0, |place| place + 1))
    }

    fn replay(&self, entries: &[LogEntry], scene: &mut Scene) -> Result<(), CheckpointError> {
        let differs = CheckpointError::Differs { tick: self.at.0 };
        let mut no_owners = Ownership::default();
        for entry in entries {
            if !replay(entry, scene, &mut no_owners) {
                return Err(differs);
            }
            if let LogEntry::Stepped(digest) = entry
                && scene.digest().value() != *digest
            {
                return Err(differs);
            }
        }
        Ok(())
    }

    /// Its bytes, for a file.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut to = Writer::new();
        to.raw(&MAGIC);
        to.sized(version().as_bytes());
        self.config.encode(&mut to);
        to.varint(self.at.0.value());
        to.raw(&self.at.1.value().to_le_bytes());
        to.sized(&self.image);
        for entry in &self.since {
            entry.encode(&mut to);
        }
        let mut bytes = to.into_bytes();
        let code = crc32fast::hash(&bytes);
        bytes.extend_from_slice(&code.to_le_bytes());
        bytes
    }

    /// A checkpoint from its bytes.
    ///
    /// # Errors
    ///
    /// [`CheckpointError::Damaged`] and [`CheckpointError::Version`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CheckpointError> {
        let damaged = |_: Malformed| CheckpointError::Damaged;
        let (checked, code) = bytes
            .split_last_chunk::<CODE_BYTES>()
            .ok_or(CheckpointError::Damaged)?;
        if crc32fast::hash(checked) != u32::from_le_bytes(*code) {
            return Err(CheckpointError::Damaged);
        }
        let mut from = Reader::new(checked);
        let found = read_version(&mut from).map_err(damaged)?;
        if found != version() {
            return Err(CheckpointError::Version { found });
        }
        Self::read(&mut from).map_err(damaged)
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let config = SceneConfig::decode(from)?;
        let tick = Tick::new(from.varint()?);
        let digest = Digest::from_value(decode_u64(from)?);
        let image = from.sized(from.rest().len())?.to_vec();
        let since = LogEntry::decode_all(from.rest())?;
        if !since.iter().all(LogEntry::is_change) {
            return Err(Malformed::UnknownCode);
        }
        Ok(Self {
            config,
            at: (tick, digest),
            image,
            since,
        })
    }
}

impl Scene {
    /// The state of the scene, right after a step. A scene of a server may be saved at any time.
    ///
    /// # Errors
    ///
    /// [`CheckpointError::Changed`] if a step was not the last change, [`CheckpointError::Faulted`], and
    /// [`CheckpointError::NoImage`].
    pub fn save(&self) -> Result<Checkpoint, CheckpointError> {
        Checkpoint::of(self, None::<(&Self, core::slice::Iter<'_, LogEntry>)>)
    }
}

/// The entry without the client and the member whose command it was.
fn unattributed(entry: &LogEntry) -> LogEntry {
    match entry {
        LogEntry::Applied(applied) => LogEntry::Applied(Box::new(AppliedCommand {
            command: applied.command.clone(),
            client: None,
            author: None,
        })),
        other => other.clone(),
    }
}

fn read_version(from: &mut Reader<'_>) -> Result<String, Malformed> {
    if from.raw(MAGIC.len())? != MAGIC {
        return Err(Malformed::UnknownCode);
    }
    let text = from.sized(VERSION_BYTES_MAX)?;
    String::from_utf8(text.to_vec()).map_err(|_| Malformed::Text)
}

/// The way back of one scene.
#[derive(Default)]
pub(crate) struct Rollback {
    base: Option<Base>,
    /// Time of the steps since then: a replay takes about as long.
    stepped: Span,
}

/// A scene right after a step, with its owners.
struct Base {
    scene: Scene,
    ownership: Ownership,
}

/// A scene that continues, and what it lacks.
pub(crate) struct Restoration {
    pub(crate) scene: Scene,
    pub(crate) ownership: Ownership,
    /// The authors of the commands that were left out, in the order of the commands.
    pub(crate) left_out: Vec<Option<Author>>,
    /// True if a command was left out that acted in an earlier step: every body may be elsewhere.
    pub(crate) differs: bool,
}

/// The call in which an engine failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FailedIn {
    /// In a command, which the record lacks.
    Command,
    /// In a step.
    Step,
    /// Before a step, or a part of one, which would meet a crowd: single commands are not sought, as each attempt would step
    /// nearly as many.
    Crowd,
}

/// Time of steps after which a copy is due, as long as the scene is small. A copy takes some 0.1 % of it with 1,000
/// bodies, and 4 % with 10,000.
const COPY_AFTER: Span = Span::from_millis(500);
/// The same for a large scene: together with a search, less than the 3 s that a restoration may take.
const COPY_AFTER_MAX: Span = Span::from_millis(1_000);
/// Bodies from which on a scene is large.
const LARGE: usize = 20_000;
/// Bytes of entries after which a copy of a small scene is due.
const ENTRY_BYTES: usize = 1 << 20;
/// The same for each body of a larger one, which takes about a kilobyte and is copied in some four microseconds: a scene
/// that is filled doubles from one copy to the next, so that all of them take as long as two of the full scene.
const ENTRY_BYTES_PER_BODY: usize = 160;
/// The same for any scene: half of what its record keeps.
const ENTRY_BYTES_MAX: usize = 8 << 20;
/// Commands of one tick that are left out by themselves, before all of them are.
const CULPRITS_MAX: usize = 3;
/// Attempts with ever more commands left out, before all since the copy are.
const ATTEMPTS_MAX: usize = 4;

impl Rollback {
    /// Adds the time of a step.
    pub(crate) fn note_step(&mut self, took: Span) {
        self.stepped = Span::from_nanos(self.stepped.as_nanos() + took.as_nanos());
    }

    /// Copies the scene if that is due and the scene can be copied now: right after a step. To be called before a
    /// scene is changed.
    pub(crate) fn copy_if_due(&mut self, scene: &mut Scene, ownership: &Ownership) {
        let after = if scene.body_count() < LARGE {
            COPY_AFTER
        } else {
            COPY_AFTER_MAX
        };
        let most = scene.body_count() * ENTRY_BYTES_PER_BODY;
        let most = most.clamp(ENTRY_BYTES, ENTRY_BYTES_MAX);
        let bytes = scene.record().bytes_since_base();
        let is_due = bytes.is_none_or(|bytes| bytes >= most);
        if !is_due && self.stepped < after {
            return;
        }
        self.begin_at(scene, ownership);
    }

    /// Begins with a scene that has not changed since its last step.
    pub(crate) fn begin_at(&mut self, scene: &mut Scene, ownership: &Ownership) {
        if let Some(copy) = scene.copy() {
            let ownership = ownership.clone();
            self.begin(Base {
                scene: copy,
                ownership,
            });
            scene.record_mut().begin_base();
        }
    }

    /// An earlier state of the scene, and what it has changed since.
    pub(crate) fn way_to<'a>(
        &'a self,
        scene: &'a Scene,
    ) -> Option<(&'a Scene, impl Iterator<Item = &'a LogEntry>)> {
        let base = self.base.as_ref()?;
        Some((&base.scene, scene.record().since_base()?))
    }

    fn begin(&mut self, base: Base) {
        self.base = Some(base);
        self.stepped = Span::ZERO;
    }

    /// Restores a failed scene; `None` if it fails again without any command since the copy. `beat` is called before
    /// each step.
    pub(crate) fn restore(
        &mut self,
        failed: &Scene,
        failed_in: FailedIn,
        beat: &mut dyn FnMut(),
    ) -> Option<Restoration> {
        let done: Vec<LogEntry> = failed.record().since_base()?.cloned().collect();
        let is_step = |change: &LogEntry| matches!(change, LogEntry::Stepped(_));
        let newest = done.iter().rposition(is_step);
        let (earlier, pending) = done.split_at(newest.map_or(0, |place| place + 1));
        let attempt = self.leave_out_of_pending(earlier, pending, failed_in, beat);
        let attempt = attempt.or_else(|| self.leave_out_of_all(earlier, pending, beat))?;
        self.adopt(attempt)
    }

    /// Leaves out what fails of the commands since the newest step: single ones if that suffices, otherwise all.
    fn leave_out_of_pending(
        &self,
        earlier: &[LogEntry],
        pending: &[LogEntry],
        failed_in: FailedIn,
        beat: &mut dyn FnMut(),
    ) -> Option<Continuation> {
        let base = self.base.as_ref()?.replay(earlier, beat)?;
        let mut attempt = Continuation {
            base,
            kept: pending.to_vec(),
            left_out: Vec::new(),
            differs: false,
        };
        if failed_in == FailedIn::Command {
            return Some(attempt);
        }
        let culprits = match failed_in {
            FailedIn::Crowd => 0,
            FailedIn::Command | FailedIn::Step => CULPRITS_MAX,
        };
        for _ in 0..culprits {
            beat();
            if attempt.steps(attempt.kept.len()) {
                return Some(attempt);
            }
            let Some(culprit) = attempt.culprit(beat) else {
                break;
            };
            attempt.leave_out(culprit);
        }
        while !attempt.kept.is_empty() {
            attempt.leave_out(0);
        }
        attempt.steps(0).then_some(attempt)
    }

    /// Leaves out ever more of the last commands, at last all since the copy: some act on the engine late.
    fn leave_out_of_all(
        &self,
        earlier: &[LogEntry],
        pending: &[LogEntry],
        beat: &mut dyn FnMut(),
    ) -> Option<Continuation> {
        let is_command = |change: &&LogEntry| matches!(change, LogEntry::Applied(_));
        let commands = earlier.iter().filter(is_command).count();
        let mut count = 1;
        for attempts in 1.. {
            if commands == 0 {
                return None;
            }
            if count >= commands || attempts > ATTEMPTS_MAX {
                count = commands;
            }
            let mut left = commands - count;
            let (mut kept, mut left_out) = (Vec::new(), Vec::new());
            for change in earlier {
                match change {
                    LogEntry::Applied(applied) if left == 0 => left_out.push(applied.author),
                    LogEntry::Applied(_) => {
                        left -= 1;
                        kept.push(change.clone());
                    }
                    _ => kept.push(change.clone()),
                }
            }
            left_out.extend(pending.iter().filter_map(author_of));
            if let Some(base) = self.base.as_ref()?.replay(&kept, beat) {
                let attempt = Continuation {
                    base,
                    kept: Vec::new(),
                    left_out,
                    differs: true,
                };
                if attempt.steps(0) {
                    return Some(attempt);
                }
            }
            if count == commands {
                return None;
            }
            count *= 8;
        }
        None
    }

    /// Continues from an attempt that stepped.
    fn adopt(&mut self, attempt: Continuation) -> Option<Restoration> {
        let Continuation {
            base,
            kept,
            mut left_out,
            differs,
        } = attempt;
        let mut scene = base.scene.copy()?;
        let mut ownership = base.ownership.clone();
        scene.record_mut().begin_base();
        for change in kept {
            if !replay(&change, &mut scene, &mut ownership) {
                left_out.extend(author_of(&change));
            } else if let LogEntry::Applied(applied) = change
                && let Some(author) = applied.author
            {
                scene.record_mut().attribute(author, applied.client);
            }
        }
        self.begin(base);
        Some(Restoration {
            scene,
            ownership,
            left_out,
            differs,
        })
    }
}

/// A state at the newest tick, and the commands since then that are kept.
struct Continuation {
    base: Base,
    kept: Vec<LogEntry>,
    left_out: Vec<Option<Author>>,
    differs: bool,
}

impl Continuation {
    /// True if the scene takes a step after so many of the commands.
    fn steps(&self, count: usize) -> bool {
        let Some(mut scene) = self.base.scene.copy() else {
            return false;
        };
        for change in &self.kept[..count] {
            // A command that depends on one that was left out is refused, and left out too.
            if let LogEntry::Applied(applied) = change {
                let _ = scene.apply(&applied.command);
            }
        }
        scene.step().is_ok()
    }

    /// The command after which the scene does not step any more; `None` if it does not step without any.
    fn culprit(&self, beat: &mut dyn FnMut()) -> Option<usize> {
        if !self.steps(0) {
            return None;
        }
        let (mut good, mut bad) = (0, self.kept.len());
        while bad - good > 1 {
            beat();
            let middle = usize::midpoint(good, bad);
            if self.steps(middle) {
                good = middle;
            } else {
                bad = middle;
            }
        }
        (bad > 0).then_some(good)
    }

    fn leave_out(&mut self, place: usize) {
        let change = self.kept.remove(place);
        self.left_out.extend(author_of(&change));
    }
}

impl Base {
    /// The state after these changes; `None` if it fails on the way.
    fn replay(&self, done: &[LogEntry], beat: &mut dyn FnMut()) -> Option<Self> {
        let mut scene = self.scene.copy()?;
        let mut ownership = self.ownership.clone();
        for change in done {
            if matches!(change, LogEntry::Stepped(_)) {
                beat();
            }
            if !replay(change, &mut scene, &mut ownership) {
                return None;
            }
        }
        Some(Self { scene, ownership })
    }
}

/// Does an entry again; `false` if the scene refuses or fails.
pub fn replay(entry: &LogEntry, scene: &mut Scene, ownership: &mut Ownership) -> bool {
    match entry {
        LogEntry::Applied(applied) => {
            if scene.apply(&applied.command).is_err() {
                return false;
            }
            if let Command::RemoveBody { id } = applied.command {
                ownership.remove_body(id);
            }
            ownership.note(applied.client.as_ref(), &applied.command);
        }
        LogEntry::Stepped(_) => {
            let Ok(stepped) = scene.step() else {
                return false;
            };
            (stepped.removed.iter()).for_each(|(id, _)| ownership.remove_body(*id));
            (stepped.broken.iter()).for_each(|id| ownership.remove_joint(*id));
        }
        _ => {}
    }
    true
}

fn author_of(change: &LogEntry) -> Option<Option<Author>> {
    match change {
        LogEntry::Applied(applied) => Some(applied.author),
        _ => None,
    }
}
