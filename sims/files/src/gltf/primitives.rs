//! The triangles of meshes, primitive by primitive.
//!
//! Knows no nodes. Invariants: a mesh is read once; the triangles of all of them are counted before they are read, and time
//! and memory are those of the triangles, however many primitives name the same numbers.

use std::collections::BTreeMap;
use std::rc::Rc;

use super::buffers::{Buffers, Indices};
use super::document::{Document, Primitive, title};
use crate::mesh::{self, MESH_TRIANGLES_MAX, TriangleMesh};
use crate::report::Problem;

/// Modes of primitives that are triangles.
const TRIANGLES: u32 = 4;
const STRIP: u32 = 5;
const FAN: u32 = 6;
/// What is counted against the most triangles.
pub(super) const TRIANGLES_OF_ALL: &str = "triangles of all meshes";

/// Meshes in their own axes.
pub(super) struct Primitives<'a> {
    document: &'a Document,
    buffers: Buffers<'a>,
    /// Those that were read, by the number of their mesh.
    known: BTreeMap<usize, Vec<Rc<TriangleMesh>>>,
    /// The number of their triangles.
    read: usize,
}

impl<'a> Primitives<'a> {
    pub(super) const fn new(document: &'a Document, buffers: Buffers<'a>) -> Self {
        let known = BTreeMap::new();
        Self {
            document,
            buffers,
            known,
            read: 0,
        }
    }

    /// The primitives of a mesh that are triangles.
    pub(super) fn of_mesh(
        &mut self,
        number: usize,
        note: &mut dyn FnMut(String, &'static str),
    ) -> Result<Vec<Rc<TriangleMesh>>, Problem> {
        if let Some(known) = self.known.get(&number) {
            return Ok(known.clone());
        }
        let document = self.document;
        let meshes = &document.meshes;
        let Some(mesh) = meshes.get(number) else {
            let count = meshes.len();
            return Err(Problem::Mesh(format!(
                "a node names mesh {number}, and there are {count}"
            )));
        };
        let title = title(number, &mesh.name);
        let mut read = Vec::new();
        for primitive in &mesh.primitives {
            if !primitive.targets.is_empty() {
                let why = "bodies do not bend: the mesh has its first form";
                note("morph targets".to_owned(), why);
            }
            read.extend(self.triangles_of(primitive, &title, note)?.map(Rc::new));
        }
        self.known.insert(number, read.clone());
        Ok(read)
    }

    fn triangles_of(
        &mut self,
        primitive: &Primitive,
        title: &str,
        note: &mut dyn FnMut(String, &'static str),
    ) -> Result<Option<TriangleMesh>, Problem> {
        let mode = primitive.mode.unwrap_or(TRIANGLES);
        if !matches!(mode, TRIANGLES | STRIP | FAN) {
            let why = "points and lines have no surface";
            note(format!("primitive of {title}"), why);
            return Ok(None);
        }
        let has_bytes = |number: usize| {
            let accessor = self.document.accessors.get(number);
            accessor.is_none_or(|accessor| accessor.buffer_view.is_some())
        };
        let Some(position) = primitive
            .attributes
            .position
            .filter(|number| has_bytes(*number))
        else {
            let why = "its positions are missing, or packed by an extension";
            note(format!("primitive of {title}"), why);
            return Ok(None);
        };
        let document = self.document;
        let points = self.buffers.points(document, position)?;
        let indices = primitive.indices;
        let indices = indices.map(|number| self.buffers.indices(document, number));
        let indices = indices.transpose()?;
        let corners = indices.as_ref().map_or(points.count(), Indices::count);
        // Counted before they are read: many primitives may name the same ones.
        self.read += match mode {
            TRIANGLES => corners / 3,
            _ => corners.saturating_sub(2),
        };
        Problem::bound(TRIANGLES_OF_ALL, self.read, MESH_TRIANGLES_MAX)?;
        let indices = match indices {
            Some(indices) => indices.all(),
            None => (0..points.count() as u32).collect(),
        };
        let triangles: Vec<[u32; 3]> = match mode {
            TRIANGLES => indices.as_chunks::<3>().0.to_vec(),
            STRIP => (indices.windows(3).enumerate())
                .map(|(place, three)| match place % 2 {
                    0 => [three[0], three[1], three[2]],
                    _ => [three[1], three[0], three[2]],
                })
                .collect(),
            _ => {
                let pairs = indices.get(1..).unwrap_or_default().windows(2);
                pairs.map(|two| [indices[0], two[0], two[1]]).collect()
            }
        };
        let count = points.count();
        let mesh = match count > 3 * triangles.len() {
            true => TriangleMesh::of_some(&triangles, count, |place| points.get(place)),
            false => mesh::check(TriangleMesh {
                points: points.all(),
                triangles,
            }),
        };
        let mesh = mesh.map_err(|problem| match problem {
            Problem::Mesh(cause) => Problem::Mesh(format!("{title}: {cause}")),
            other => other,
        })?;
        Ok(Some(mesh))
    }
}
