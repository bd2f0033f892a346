//! Scenes that survive the process.
//!
//! A data directory holds a command log and snapshots of each. One that no server uses can be verified and replayed.

mod data_dir;
mod disk;
mod format;
mod recovery;
mod repair;
mod scene_files;
mod writer;

use std::collections::BTreeMap;
use std::error::Error;
use std::io::{BufRead, Write};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use rhumb_protocol::scene::{SceneConfig, SceneName};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::Tick;
use rhumb_scene::engine::StepThreads;
use rhumb_scene::{CommandLog, Limits, RestoredScene, SceneStore};

use self::data_dir::Room;
use self::recovery::{ReplayStart, Restored};
use self::scene_files::SceneFiles;
use self::writer::{Origin, SceneLog};

pub(crate) use self::recovery::LogTail;
pub use data_dir::DataDir;
pub use disk::{Damage, DataError};
pub(crate) use scene_files::Generation;
pub(crate) use writer::Wake;

/// A scene of another server, as far as its log was read.
pub(crate) struct Followed {
    scene: Box<Restored>,
    /// Time that this has taken, which is that of a restoration.
    took: Span,
}

/// The data directory, and the scenes in it that cannot be served.
pub(crate) struct StoredScenes {
    data: DataDir,
    room: Room,
    workers: StepThreads,
    wake: Wake,
    /// Of the files that a directory of scenes has given this server; no others are opened to be written.
    generation: OnceLock<Generation>,
    /// Without files if the directory could not be read.
    damaged: Mutex<BTreeMap<SceneName, Option<SceneFiles>>>,
}

impl StoredScenes {
    /// `workers`: threads that step a scene. `wake` is called when a log has more that is durable.
    pub(crate) fn new(
        (data, limits): (DataDir, &Limits),
        workers: StepThreads,
        wake: Wake,
    ) -> Self {
        let damaged = Mutex::default();
        Self {
            room: Room::new(data.scenes_on_disk(), limits),
            data,
            workers,
            wake,
            generation: OnceLock::new(),
            damaged,
        }
    }

    /// Restores and creates from now on in the directory of this number alone.
    pub(crate) fn take(&self, generation: Generation) {
        // A worker has one claim.
        self.generation.get_or_init(|| generation);
    }

    /// Reads a scene of another server as its files are now, and changes none. `None`: not yet, and it begins anew.
    pub(crate) fn follow(
        &self,
        name: &SceneName,
        followed: Option<Followed>,
        clock: &dyn Fn() -> Instant,
        beat: &mut dyn FnMut(),
    ) -> Option<Followed> {
        let begun = clock();
        let before = (followed.as_ref()).map_or(Span::ZERO, |followed| followed.took);
        let follow = |files: &SceneFiles, beat: &mut dyn FnMut()| match followed {
            None => files.begin_to_follow(&self.workers, beat),
            Some(followed) => files.catch_up(*followed.scene, beat).map(Some),
        };
        let files = self.newest_files(name);
        match files.and_then(|files| files.map_or(Ok(None), |files| follow(&files, beat))) {
            Ok(followed) => followed.map(|scene| Followed {
                scene: Box::new(scene),
                took: after(before, clock().since(begun)),
            }),
            Err(error) => {
                // Its owner may have removed the segment meanwhile.
                tracing::info!(scene = %name, %error, "a scene that is to come is read anew");
                None
            }
        }
    }

    /// A followed scene with the rest of its log; `None` if the files have to be read from their newest snapshot.
    fn finish(
        &self,
        name: &SceneName,
        files: &SceneFiles,
        (followed, beat): (Followed, &mut dyn FnMut()),
    ) -> Option<Restored> {
        let followed = files.catch_up(*followed.scene, beat);
        let at_end = followed.and_then(|scene| Ok((files.is_at_end(&scene)?, scene)));
        match at_end {
            Ok((true, scene)) => Some(scene),
            Ok((false, _)) => {
                tracing::info!(scene = %name, "a followed scene lacks the end of its log, and is restored");
                None
            }
            Err(error) => {
                tracing::info!(scene = %name, %error, "a followed scene is not used, and restored");
                None
            }
        }
    }

    /// Restores a scene from its files, if it has any, or from what was followed of them. `beat` is called before each step.
    pub(crate) fn restore(
        &self,
        name: &SceneName,
        (tail, followed): (LogTail, Option<Followed>),
        clock: &dyn Fn() -> Instant,
        beat: &mut dyn FnMut(),
    ) -> Option<RestoredScene> {
        let files = match self.files(name) {
            Ok(files) => files?,
            Err(error) => {
                // It may be there: a new scene of this name would take its place.
                tracing::error!(scene = %name, %error, "the scene cannot be looked for and is not served");
                self.lock().insert(name.clone(), None);
                return None;
            }
        };
        let begun = clock();
        let before = (followed.as_ref()).map_or(Span::ZERO, |followed| followed.took);
        let finished =
            followed.and_then(|followed| self.finish(name, &files, (followed, &mut *beat)));
        let restored = match finished {
            Some(finished) => Ok(Some(finished)),
            None => files.restore(&self.workers, (ReplayStart::Newest, tail), beat),
        };
        match restored {
            Ok(Some(restored)) => {
                let took = clock().since(begun);
                report(&restored, took.as_nanos() / 1_000_000);
                let took = after(before, took);
                let log = self.start(files, restored.origin());
                Some(RestoredScene {
                    scene: restored.scene,
                    sessions: restored.sessions,
                    ownership: restored.ownership,
                    unnoted: restored.unnoted,
                    log,
                    took,
                })
            }
            Ok(None) => {
                if let Err(error) = files.delete() {
                    tracing::warn!(scene = %name, %error, "the rest of a scene stays");
                }
                None
            }
            Err(error) => {
                tracing::error!(scene = %name, %error, "the scene cannot be restored and is not served");
                self.lock().insert(name.clone(), Some(files));
                None
            }
        }
    }

    /// The files that a scene has here; `None` if it has none.
    fn files(&self, name: &SceneName) -> Result<Option<SceneFiles>, DataError> {
        match self.generation.get() {
            Some(generation) => self.data.files_of(name, *generation),
            None => self.newest_files(name),
        }
    }

    fn newest_files(&self, name: &SceneName) -> Result<Option<SceneFiles>, DataError> {
        let mut scenes = self.data.scenes()?.into_iter();
        Ok(scenes.find_map(|(scene, files)| (scene == *name).then_some(files)))
    }

    fn start(&self, files: SceneFiles, origin: Origin) -> Option<Box<dyn CommandLog>> {
        let scene = origin.name.clone();
        match SceneLog::start((files, self.room.clone()), origin, Wake::clone(&self.wake)) {
            Ok(log) => Some(Box::new(log)),
            Err(cause) => {
                tracing::error!(%scene, %cause, "no thread for a command log; nothing is durable");
                None
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<SceneName, Option<SceneFiles>>> {
        // An entry is added or removed in one piece.
        self.damaged.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl SceneStore for StoredScenes {
    fn create(&self, scene: &SceneName, config: &SceneConfig) -> Option<Box<dyn CommandLog>> {
        let origin = Origin {
            name: scene.clone(),
            config: *config,
            tick: Tick::ZERO,
            segment: 0,
            previous: None,
        };
        let files = match self.generation.get() {
            None => self.data.create(scene),
            Some(generation) => match self.data.files_of(scene, *generation) {
                Ok(None) => self.data.files_to_make(scene, *generation),
                Ok(Some(files)) => {
                    let path = files.directory.display();
                    tracing::error!(%scene, %path, "the files of a deleted scene are still there; nothing is durable");
                    return None;
                }
                Err(error) => {
                    tracing::error!(%scene, %error, "a scene's files cannot be made; nothing is durable");
                    return None;
                }
            },
        };
        self.start(files, origin)
    }

    fn is_damaged(&self, scene: &SceneName) -> bool {
        self.lock().contains_key(scene)
    }

    fn delete_damaged(&self, scene: &SceneName) -> bool {
        let mut damaged = self.lock();
        let deleted = match damaged.get(scene) {
            None => return false,
            Some(Some(files)) => files.delete(),
            Some(None) => {
                (self.files(scene)).and_then(|files| files.map_or(Ok(()), |files| files.delete()))
            }
        };
        if let Err(error) = deleted {
            tracing::error!(%scene, %error, "a damaged scene stays");
            return false;
        }
        damaged.remove(scene);
        true
    }

    fn damaged(&self) -> usize {
        self.lock().len()
    }
}

/// Two spans one after the other.
const fn after(before: Span, span: Span) -> Span {
    Span::from_nanos(before.as_nanos() + span.as_nanos())
}

/// Logs what a restoration found. `ms`: the time that it took.
fn report(restored: &Restored, ms: u64) {
    let (scene, found) = (&restored.scene, &restored.report);
    for refused in &found.refused {
        tracing::warn!(scene = %restored.name, "a snapshot is not used: {refused}");
    }
    if let Some((path, bytes)) = &found.torn {
        let path = path.display();
        tracing::warn!(%path, bytes, "the end of the log was cut off before it was durable");
    }
    tracing::info!(
        scene = %restored.name,
        tick = scene.tick().value(),
        digest = %scene.digest(),
        snapshot = found.from.value(),
        steps = found.steps,
        ms,
        "scene restored"
    );
}

/// Verifies every scene, one line each.
///
/// # Errors
///
/// The first error of a scene that cannot be restored; the others are verified all the same.
pub(crate) fn check(directory: &Path, out: &mut dyn Write) -> Result<(), Box<dyn Error>> {
    let data = DataDir::open_to_read(directory)?;
    let mut failed: Option<Box<dyn Error>> = None;
    for (name, files) in data.scenes()? {
        match restore(&files, ReplayStart::Newest) {
            Ok(Some(restored)) => write_report(&restored, out)?,
            Ok(None) => writeln!(out, "{name}: its creation was never durable")?,
            Err(error) => {
                writeln!(out, "{name}: {error}")?;
                failed.get_or_insert(error);
            }
        }
    }
    failed.map_or(Ok(()), Err)
}

/// Runs the log of a scene again from its oldest state, and compares every step with the recorded one.
///
/// # Errors
///
/// The first damage or difference.
pub(crate) fn replay(
    directory: &Path,
    scene: &SceneName,
    out: &mut dyn Write,
) -> Result<(), Box<dyn Error>> {
    let data = DataDir::open_to_read(directory)?;
    let found = data.scenes()?.into_iter().find(|(name, _)| name == scene);
    let (_, files) = found.ok_or_else(|| format!("no scene {scene} in the directory"))?;
    match restore(&files, ReplayStart::Oldest)? {
        Some(restored) => write_report(&restored, out),
        None => Err(format!("the creation of {scene} was never durable").into()),
    }
}

/// Cuts the damaged scenes of a directory back to their last good ticks, or one of them. The loss is stated first, and
/// asked for unless `is_agreed`. The directory of each stays beside it.
///
/// # Errors
///
/// The first scene that cannot be repaired, or was not agreed to; the others are repaired all the same.
pub(crate) fn repair(
    (directory, only): (&Path, Option<&SceneName>),
    is_agreed: bool,
    (answers, out): (&mut dyn BufRead, &mut dyn Write),
) -> Result<(), Box<dyn Error>> {
    let data = DataDir::open_to_read(directory)?;
    let mut scenes = data.scenes()?;
    if let Some(only) = only {
        scenes.retain(|(name, _)| name == only);
        if scenes.is_empty() {
            return Err(format!("no scene {only} in {}", directory.display()).into());
        }
    }
    let mut failed: Option<Box<dyn Error>> = None;
    for (name, files) in scenes {
        let repaired = repair_scene(&data, (&name, &files), is_agreed, (answers, out));
        if let Err(error) = repaired {
            writeln!(out, "{name}: {error}")?;
            failed.get_or_insert(error);
        }
    }
    failed.map_or(Ok(()), Err)
}

fn repair_scene(
    data: &DataDir,
    (name, files): (&SceneName, &SceneFiles),
    is_agreed: bool,
    (answers, out): (&mut dyn BufRead, &mut dyn Write),
) -> Result<(), Box<dyn Error>> {
    let Err(damage) = restore(files, ReplayStart::Newest) else {
        writeln!(out, "{name}: nothing to repair")?;
        return Ok(());
    };
    let Some(cut) = files.find_cut(name)? else {
        return Err(format!("no good state is left, and nothing was changed; {damage}").into());
    };
    writeln!(
        out,
        "{name}: {damage}\n{name}: the last good tick is {}, with {} bodies and digest {}; lost are {} bytes of its log, to \
         tick {} at least",
        cut.tick.value(),
        cut.bodies,
        cut.digest,
        cut.bytes,
        cut.newest.value(),
    )?;
    if !is_agreed {
        write!(
            out,
            "{name}: cut it back to tick {}? [y/N] ",
            cut.tick.value()
        )?;
        out.flush()?;
        let mut answer = String::new();
        answers.read_line(&mut answer)?;
        if !["y", "yes"].contains(&answer.trim()) {
            return Err("nothing was changed; --yes agrees beforehand".into());
        }
    }
    let to = data.replace(name)?;
    let old = files.cut_back(name, &cut, &to)?;
    match restore(&to, ReplayStart::Newest)? {
        Some(restored) if restored.scene.digest() == cut.digest => {
            write_report(&restored, out)?;
            writeln!(out, "{name}: its files before are in {}", old.display())?;
            Ok(())
        }
        _ => Err("the scene that was made is another one: report this".into()),
    }
}

fn restore(files: &SceneFiles, start: ReplayStart) -> Result<Option<Restored>, Box<dyn Error>> {
    Ok(files.restore(&StepThreads::default(), (start, LogTail::Kept), &mut || {})?)
}

/// One line on a restored scene, and one for each thing that was passed over.
fn write_report(restored: &Restored, out: &mut dyn Write) -> Result<(), Box<dyn Error>> {
    let (scene, found) = (&restored.scene, &restored.report);
    writeln!(
        out,
        "{}: tick {} digest {} bodies {} from tick {} by {} commands and {} steps",
        restored.name,
        scene.tick().value(),
        scene.digest(),
        scene.body_count(),
        found.from.value(),
        found.commands,
        found.steps,
    )?;
    for refused in &found.refused {
        writeln!(out, "{}: passed over {refused}", restored.name)?;
    }
    if let Some((path, bytes)) = &found.torn {
        let path = path.display();
        writeln!(
            out,
            "{}: {path} ends with {bytes} bytes that were never durable",
            restored.name
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod store_tests {
    use std::fs;
    use std::sync::Arc;

    use super::*;

    #[test]
    fn a_scene_that_cannot_be_looked_for_is_not_taken_for_a_new_one() {
        let directory = tempfile::tempdir().unwrap();
        let data = DataDir::open(directory.path()).unwrap();
        let stored = StoredScenes::new(
            (data, &Limits::default()),
            StepThreads::default(),
            Arc::new(|| {}),
        );
        let (scenes, name) = (directory.path().join("scenes"), "pit".parse().unwrap());
        fs::remove_dir(&scenes).unwrap();
        fs::write(&scenes, "no directory").unwrap();
        let clock = || Instant::ZERO;
        let restored = stored.restore(&name, (LogTail::Kept, None), &clock, &mut || {});
        assert!(restored.is_none() && stored.is_damaged(&name));
        assert!(
            !stored.delete_damaged(&name),
            "it is not known what to delete"
        );
        fs::remove_file(&scenes).unwrap();
        fs::create_dir(&scenes).unwrap();
        assert!(stored.delete_damaged(&name) && !stored.is_damaged(&name));
        // One that is looked for and not found is new.
        assert!(
            stored
                .restore(&name, (LogTail::Kept, None), &clock, &mut || {})
                .is_none()
        );
        assert!(!stored.is_damaged(&name));
    }
}

#[cfg(test)]
mod tests;
