//! The way in: a file's format by its content.
//!
//! Decides nothing else. An XML file is known by its first element, JSON by its first bracket.

use crate::assemble::{LoadedScene, assemble};
use crate::error::{LoadError, Place, Problem};
use crate::files::{Files, join};
use crate::json;
use crate::mjcf;
use crate::model::LoadOptions;
use crate::report::Report;
use crate::urdf;
use crate::xml::{self, XML_BYTES_MAX};

/// Reads a file as a scene.
///
/// # Errors
///
/// [`LoadError`] names the file, the line and the reason.
pub fn load(
    files: &dyn Files,
    path: &str,
    options: &LoadOptions,
) -> Result<LoadedScene, LoadError> {
    let path = join("", path);
    let bytes = files
        .read(&path, XML_BYTES_MAX)
        .map_err(|error| LoadError {
            place: Place::of(&path),
            problem: Problem::File(error),
        })?;
    load_text(files, &path, &String::from_utf8_lossy(&bytes), options)
}

/// Reads a text as a scene. `path`: where it comes from, for the files that it names.
///
/// # Errors
///
/// [`LoadError`] names the file, the line and the reason.
pub fn load_text(
    files: &dyn Files,
    path: &str,
    text: &str,
    options: &LoadOptions,
) -> Result<LoadedScene, LoadError> {
    if text
        .trim_start_matches('\u{feff}')
        .trim_start()
        .starts_with('{')
    {
        return json::read(path, text, options);
    }
    let root = xml::parse(path, text)?;
    let mut report = Report::default();
    let model = match root.name.as_str() {
        "robot" => urdf::read(&root, files, options, &mut report)?,
        "mujoco" => mjcf::read(root, files, options, &mut report)?,
        other => {
            let what = format!("<{other}>");
            return Err(root.wrong(Problem::UnknownFormat(what)));
        }
    };
    assemble(&model, options, report)
}
