//! The way in: a file's format by its content, and meshes by their names.
//!
//! Names with `package://` are searched in given folders, then in the folders above the file. A mesh is read once.

use std::collections::BTreeMap;
use std::rc::Rc;

use glam::DVec3;

use crate::assemble::{LoadedScene, assemble};
use crate::error::{LoadError, Place, Problem};
use crate::files::{FileError, Files, folder_of, join};
use crate::json;
use crate::mesh::{self, TriangleMesh};
use crate::mjcf;
use crate::model::LoadOptions;
use crate::report::{Effect, Report};
use crate::urdf;
use crate::xml::{self, Element, XML_BYTES_MAX};

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

/// Folders above a file that are searched for packages.
const FOLDERS_ABOVE: usize = 12;

/// Mesh files of one scene.
pub(crate) struct Meshes<'a> {
    files: &'a dyn Files,
    packages: &'a [String],
    read: BTreeMap<String, Rc<TriangleMesh>>,
}

impl<'a> Meshes<'a> {
    pub(crate) const fn new(files: &'a dyn Files, packages: &'a [String]) -> Self {
        let read = BTreeMap::new();
        Self {
            files,
            packages,
            read,
        }
    }

    /// The mesh that an element names; `None` with a note for one that no file or no reader is there for.
    pub(crate) fn get(
        &mut self,
        element: &Element,
        name: &str,
        scale: DVec3,
        subject: &str,
        report: &mut Report,
    ) -> Result<Option<Rc<TriangleMesh>>, LoadError> {
        let places = self.places(element, name);
        self.first(element, (name, places), scale, subject, report)
    }

    /// The mesh at a path.
    pub(crate) fn get_at(
        &mut self,
        element: &Element,
        path: &str,
        scale: DVec3,
        subject: &str,
        report: &mut Report,
    ) -> Result<Option<Rc<TriangleMesh>>, LoadError> {
        self.first(
            element,
            (path, vec![path.to_owned()]),
            scale,
            subject,
            report,
        )
    }

    /// The mesh at the first of these places that has one.
    fn first(
        &mut self,
        element: &Element,
        (name, places): (&str, Vec<String>),
        scale: DVec3,
        subject: &str,
        report: &mut Report,
    ) -> Result<Option<Rc<TriangleMesh>>, LoadError> {
        let key = format!("{name} {scale}");
        if let Some(mesh) = self.read.get(&key) {
            return Ok(Some(mesh.clone()));
        }
        if !mesh::is_read(name) {
            let why = "meshes are read from STL and OBJ files";
            report.add(
                &element.place(),
                subject.to_owned(),
                name.to_owned(),
                Effect::Left,
                why,
            );
            return Ok(None);
        }
        for path in places {
            let read = match mesh::read(self.files, &path) {
                Err(Problem::File(FileError::NotFound)) => continue,
                read => read,
            };
            let read = read.map_err(|problem| LoadError {
                place: Place::of(&path),
                problem,
            })?;
            let mesh = Rc::new(read.scaled(scale));
            self.read.insert(key, mesh.clone());
            return Ok(Some(mesh));
        }
        let why = "there is no such file; folders of packages can be given";
        report.add(
            &element.place(),
            subject.to_owned(),
            name.to_owned(),
            Effect::Left,
            why,
        );
        Ok(None)
    }

    /// Where a file of this name may be, the likeliest first.
    fn places(&self, element: &Element, name: &str) -> Vec<String> {
        let file = element.place().file;
        let folder = folder_of(&file);
        if let Some(path) = name.strip_prefix("file://") {
            return vec![join(folder, path)];
        }
        let package = ["package://", "model://", "$(find "];
        let Some(rest) = package.iter().find_map(|begin| name.strip_prefix(begin)) else {
            return vec![join(folder, name)];
        };
        let rest = rest.replacen(')', "", 1);
        let inner = rest.split_once('/').map_or("", |(_, inner)| inner);
        let mut above = folder.to_owned();
        let mut roots = self.packages.to_vec();
        for _ in 0..FOLDERS_ABOVE {
            roots.push(above.clone());
            let next = join(&above, "..");
            if next == above {
                break;
            }
            above = next;
        }
        let both = |root: &String| [join(root, &rest), join(root, inner)];
        roots.iter().flat_map(both).collect()
    }
}
