//! Mesh files of one scene, by the names that its file gives them.
//!
//! Names with `package://` are searched in given folders, then in the folders above the file. A mesh is read once.

use std::collections::BTreeMap;
use std::rc::Rc;

use glam::DVec3;

use crate::error::{LoadError, Place, Problem};
use crate::files::{FileError, Files, folder_of, join};
use crate::mesh::{self, TriangleMesh};
use crate::report::{Effect, Report};
use crate::xml::Element;

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
            let why = "meshes are read from STL, OBJ and MSH files";
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
                Err(Problem::File(FileError::NotFound | FileError::IsFolder)) => continue,
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

    /// The paths that a file of this name may have, the likeliest first.
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
