//! A checkpoint: a whole scene as bytes, from which others continue.
//!
//! Layout: magic number, version, configuration, tick and digest of the image, image, the entries since then, CRC-32 of
//! everything before. An engine has an image only right after a step; what was commanded since is applied again. Invariant:
//! a scene from a checkpoint is at the tick and the digest of the scene that was saved, or there is an error.

use std::fmt;

use rhumb_protocol::scene::{InvalidSceneName, SceneConfig, SceneName};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::Tick;

use crate::digest::Digest;
use crate::engine::StepThreads;
use crate::permit::Ownership;
use crate::record::{AppliedCommand, LogEntry, decode_u64};
use crate::rollback::replay;
use crate::scene::{IMAGE_FORMAT, Scene};

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
        let mut scene = self.base(threads)?;
        self.continue_from(&mut scene)?;
        Ok(scene)
    }

    /// The scene of the image, without what changed since.
    pub(crate) fn base(&self, threads: &StepThreads) -> Result<Scene, CheckpointError> {
        let scene = Scene::from_image(self.config, threads, self.at, &self.image);
        scene.map_err(|_| CheckpointError::Damaged)
    }

    /// Does again what changed since the image.
    pub(crate) fn continue_from(&self, scene: &mut Scene) -> Result<(), CheckpointError> {
        let differs = CheckpointError::Differs { tick: self.at.0 };
        let mut no_owners = Ownership::default();
        for entry in &self.since {
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
