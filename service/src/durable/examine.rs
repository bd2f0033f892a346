//! Verification and replay of a data directory that no server uses.

use std::error::Error;
use std::io::Write;
use std::path::Path;

use rhumb_protocol::scene::SceneName;
use rhumb_scene::engine::StepThreads;

use super::data_dir::DataDir;
use super::recovery::{LogTail, ReplayStart, Restored};
use super::scene_files::SceneFiles;

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
            Ok(Some(restored)) => report(&restored, out)?,
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
        Some(restored) => report(&restored, out),
        None => Err(format!("the creation of {scene} was never durable").into()),
    }
}

fn restore(files: &SceneFiles, start: ReplayStart) -> Result<Option<Restored>, Box<dyn Error>> {
    Ok(files.restore(&StepThreads::default(), (start, LogTail::Kept), &mut || {})?)
}

/// One line on a restored scene, and one for each thing that was passed over.
fn report(restored: &Restored, out: &mut dyn Write) -> Result<(), Box<dyn Error>> {
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
