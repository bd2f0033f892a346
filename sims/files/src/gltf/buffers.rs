//! The bytes of a glTF file: container, buffers, accessors, triangles.
//!
//! Invariants: what an accessor claims is compared with the bytes of its view before memory is taken for it. All buffers
//! together have bounded bytes, whatever their number: a file beside is read once, and the binary chunk is not copied.
//!
//! Knows no nodes. Invariants: a mesh is read once; the triangles of all of them are counted before they are read, and time
//! and memory are those of the triangles, however many primitives name the same numbers.

use std::collections::BTreeMap;
use std::ops::Deref;
use std::rc::Rc;

use glam::DVec3;

use super::document::{Accessor, Buffer, Document, Primitive, title};
use crate::files::{FileError, Files, folder_of, join};
use crate::mesh::{self, MESH_BYTES_MAX, MESH_TRIANGLES_MAX, TriangleMesh};
use crate::report::Problem;

/// The first bytes of a binary file.
pub(crate) const MAGIC: &[u8] = b"glTF";
/// Kinds of its chunks.
const JSON: u32 = 0x4e4f_534a;
const BINARY: u32 = 0x004e_4942;
/// Component types of accessors.
const SIGNED_BYTE: u32 = 5_120;
const BYTE: u32 = 5_121;
const SIGNED_SHORT: u32 = 5_122;
const SHORT: u32 = 5_123;
const INT: u32 = 5_125;
const FLOAT: u32 = 5_126;

fn wrong(cause: String) -> Problem {
    Problem::Mesh(cause)
}

/// The text of a binary file, and its bytes.
pub(super) fn container(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), Problem> {
    let word = |at: usize| {
        let four = bytes.get(at..at + 4)?;
        Some(u32::from_le_bytes([four[0], four[1], four[2], four[3]]))
    };
    let (version, length) = (word(4).unwrap_or(0), word(8).unwrap_or(0));
    if version != 2 {
        return Err(wrong(format!(
            "it is of version {version} of GLB, and 2 is read"
        )));
    }
    if length as usize > bytes.len() {
        let held = bytes.len();
        return Err(wrong(format!(
            "it says {length} bytes and holds {held}: it is cut"
        )));
    }
    let (mut text, mut binary) = (None, None);
    let mut at = 12;
    while let Some((length, kind)) = word(at).zip(word(at + 4)) {
        let chunk = bytes
            .get(at + 8..)
            .and_then(|rest| rest.get(..length as usize));
        let chunk = chunk.ok_or_else(|| wrong(format!("the chunk at byte {at} is cut")))?;
        match kind {
            JSON if text.is_none() => text = Some(chunk),
            BINARY if binary.is_none() => binary = Some(chunk),
            _ => {}
        }
        at += 8 + (length as usize).next_multiple_of(4);
    }
    let text = text.ok_or_else(|| wrong("it has no JSON chunk".to_owned()))?;
    Ok((text, binary))
}

/// The bytes of a buffer.
enum Bytes<'a> {
    /// The binary chunk of the file.
    Chunk(&'a [u8]),
    /// The bytes of a file beside, which several buffers may name, or of base64.
    Read(Rc<Vec<u8>>),
}

impl Deref for Bytes<'_> {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Self::Chunk(bytes) => bytes,
            Self::Read(bytes) => bytes,
        }
    }
}

/// The source of buffers while they are read.
struct Sources<'a> {
    path: &'a str,
    files: &'a dyn Files,
    /// Files beside, by their paths.
    known: BTreeMap<String, Rc<Vec<u8>>>,
    /// The most bytes of all buffers, and those that are left.
    most: usize,
    left: usize,
}

impl Sources<'_> {
    fn read(&mut self, number: usize, uri: &str) -> Result<Rc<Vec<u8>>, Problem> {
        let most = self.most;
        let full = || {
            wrong(format!(
                "buffer {number}: all buffers together have more than {most} bytes, and no more are read: make several files"
            ))
        };
        if let Some(data) = uri.strip_prefix("data:") {
            let bytes = inline(data);
            let bytes =
                bytes.ok_or_else(|| wrong(format!("buffer {number}: its data are no base64")))?;
            self.left = self.left.checked_sub(bytes.len()).ok_or_else(full)?;
            return Ok(Rc::new(bytes));
        }
        let path = join(folder_of(self.path), &unescaped(uri));
        if let Some(known) = self.known.get(&path) {
            return Ok(known.clone());
        }
        let bytes = self
            .files
            .read(&path, self.left)
            .map_err(|error| match error {
                FileError::TooLarge { .. } => full(),
                error => wrong(format!("buffer {number}, {path}: {error}")),
            })?;
        self.left -= bytes.len();
        let bytes = Rc::new(bytes);
        self.known.insert(path, bytes.clone());
        Ok(bytes)
    }
}

/// The bytes of each buffer; `None` for one that has none, as those have that an extension fills.
pub(super) struct Buffers<'a>(Vec<Option<Bytes<'a>>>);

impl<'a> Buffers<'a> {
    pub(super) fn read(
        document: &Document,
        path: &str,
        files: &dyn Files,
        binary: Option<&'a [u8]>,
    ) -> Result<Self, Problem> {
        let (known, most, left) = (BTreeMap::new(), MESH_BYTES_MAX, MESH_BYTES_MAX);
        let mut sources = Sources {
            path,
            files,
            known,
            most,
            left,
        };
        Self::of(&document.buffers, binary, &mut sources)
    }

    fn of(
        stated: &[Buffer],
        binary: Option<&'a [u8]>,
        sources: &mut Sources<'_>,
    ) -> Result<Self, Problem> {
        let mut buffers = Vec::new();
        for (number, buffer) in stated.iter().enumerate() {
            let bytes = match buffer.uri.as_deref() {
                Some(uri) => Some(Bytes::Read(sources.read(number, uri)?)),
                None => binary.filter(|_| number == 0).map(Bytes::Chunk),
            };
            let held = bytes.as_ref().map(|bytes| bytes.len());
            if let Some(held) = held.filter(|held| *held < buffer.byte_length) {
                let said = buffer.byte_length;
                return Err(wrong(format!(
                    "buffer {number} says {said} bytes and holds {held}: it is cut"
                )));
            }
            buffers.push(bytes);
        }
        Ok(Self(buffers))
    }

    /// The elements of an accessor, of so many bytes each.
    fn elements(
        &self,
        document: &Document,
        number: usize,
        accessor: &Accessor,
        size: usize,
    ) -> Result<Elements<'_>, Problem> {
        let wrong = |cause: &str| wrong(format!("accessor {number} {cause}"));
        let view = accessor.buffer_view.ok_or_else(|| wrong("has no bytes"))?;
        let view = document.buffer_views.get(view);
        let view = view.ok_or_else(|| wrong("names a view beyond the last"))?;
        let buffer = self.0.get(view.buffer);
        let buffer = buffer.ok_or_else(|| wrong("names a buffer beyond the last"))?;
        let buffer = buffer.as_ref().ok_or_else(|| {
            let buffer = view.buffer;
            wrong(&format!(
                "is in buffer {buffer}, which has no uri; without one buffer 0 of a .glb has bytes, and no other"
            ))
        })?;
        let bytes = buffer.get(view.byte_offset..);
        let bytes = bytes.and_then(|bytes| bytes.get(..view.byte_length));
        let bytes = bytes.ok_or_else(|| wrong("has a view beyond its buffer"))?;
        let stride = view.byte_stride.unwrap_or(size);
        if stride < size {
            return Err(wrong("has a stride below the size of its elements"));
        }
        let bytes = bytes.get(accessor.byte_offset..).unwrap_or_default();
        let (count, last) = (accessor.count, accessor.count.saturating_sub(1));
        let needed = last.saturating_mul(stride).saturating_add(size);
        if count > 0 && needed > bytes.len() {
            return Err(wrong("claims more elements than its view holds"));
        }
        Ok(Elements {
            bytes,
            stride,
            size,
            count,
        })
    }

    /// Points of an accessor.
    pub(super) fn points(&self, document: &Document, number: usize) -> Result<Points<'_>, Problem> {
        let accessor = accessor(document, number)?;
        if accessor.component_type != FLOAT || accessor.kind != "VEC3" {
            let (kind, component) = (&accessor.kind, accessor.component_type);
            return Err(wrong(format!(
                "accessor {number} is {kind} of component type {component}, and positions are VEC3 of {FLOAT}"
            )));
        }
        Ok(Points(self.elements(document, number, accessor, 12)?))
    }

    /// Indices of an accessor.
    pub(super) fn indices(
        &self,
        document: &Document,
        number: usize,
    ) -> Result<Indices<'_>, Problem> {
        let accessor = accessor(document, number)?;
        let size = match accessor.component_type {
            BYTE => 1,
            SHORT => 2,
            INT => 4,
            other => {
                return Err(wrong(format!(
                    "accessor {number} has components of type {other}, and indices are of {BYTE}, {SHORT} or {INT}"
                )));
            }
        };
        Ok(Indices(self.elements(document, number, accessor, size)?))
    }
}

/// The elements of an accessor, where they are in the file: none is read before it is asked for.
struct Elements<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
    count: usize,
}

impl Elements<'_> {
    fn get(&self, place: usize) -> &[u8] {
        &self.bytes[place * self.stride..][..self.size]
    }
}

/// Points in a file.
pub(super) struct Points<'a>(Elements<'a>);

impl Points<'_> {
    pub(super) const fn count(&self) -> usize {
        self.0.count
    }

    /// One of them, which has to be below their count.
    pub(super) fn get(&self, place: usize) -> DVec3 {
        let of = self.0.get(place);
        let number =
            |four: &[u8]| f64::from(f32::from_le_bytes([four[0], four[1], four[2], four[3]]));
        DVec3::new(number(of), number(&of[4..]), number(&of[8..]))
    }

    pub(super) fn all(&self) -> Vec<DVec3> {
        (0..self.count()).map(|place| self.get(place)).collect()
    }
}

/// Indices in a file.
pub(super) struct Indices<'a>(Elements<'a>);

impl Indices<'_> {
    pub(super) const fn count(&self) -> usize {
        self.0.count
    }

    pub(super) fn all(&self) -> Vec<u32> {
        let index = |bytes: &[u8]| {
            let bytes = bytes.iter().rev();
            bytes.fold(0, |sum, byte| sum << 8 | u32::from(*byte))
        };
        (0..self.count())
            .map(|place| index(self.0.get(place)))
            .collect()
    }
}

fn accessor(document: &Document, number: usize) -> Result<&Accessor, Problem> {
    let accessor = document.accessors.get(number);
    let accessor = accessor.ok_or_else(|| {
        let count = document.accessors.len();
        wrong(format!("it names accessor {number}, and has {count}"))
    })?;
    match accessor.sparse {
        Some(_) => Err(wrong(format!(
            "accessor {number} is sparse, which is not read"
        ))),
        None => Ok(accessor),
    }
}

/// The bytes of a `data:` address behind its first word, if they are base64.
fn inline(data: &str) -> Option<Vec<u8>> {
    let (kind, text) = data.split_once(',')?;
    kind.ends_with(";base64").then_some(())?;
    let text = text.trim_end_matches('=').as_bytes();
    let mut bytes = Vec::with_capacity(text.len() * 3 / 4);
    let (mut held, mut bits) = (0_u32, 0);
    for letter in text {
        let value = match letter {
            b'A'..=b'Z' => letter - b'A',
            b'a'..=b'z' => letter - b'a' + 26,
            b'0'..=b'9' => letter - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            _ => return None,
        };
        held = held << 6 | u32::from(value);
        bits += 6;
        if bits >= 8 {
            bits -= 8;
            bytes.push((held >> bits) as u8);
        }
    }
    Some(bytes)
}

/// A relative address as a path: `%20` is a blank.
fn unescaped(uri: &str) -> String {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let [first, after @ ..] = rest {
        let two = after.get(..2).filter(|_| *first == b'%');
        let two = two.and_then(|two| std::str::from_utf8(two).ok());
        let byte = two.and_then(|two| u8::from_str_radix(two, 16).ok());
        bytes.push(byte.unwrap_or(*first));
        rest = if byte.is_some() { &after[2..] } else { after };
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Modes of primitives that are triangles.
const TRIANGLES: u32 = 4;
const STRIP: u32 = 5;
const FAN: u32 = 6;
/// The triangles that count against the most.
pub(super) const TRIANGLES_OF_ALL: &str = "triangles of all meshes";

/// Meshes in their own axes.
pub(super) struct Primitives<'a> {
    document: &'a Document,
    buffers: Buffers<'a>,
    /// Triangles that were read, by the number of their mesh.
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

    /// Why a primitive is not read that the format allows; `None` for one that is.
    fn unread(&self, primitive: &Primitive) -> Option<&'static str> {
        if !matches!(primitive.mode.unwrap_or(TRIANGLES), TRIANGLES | STRIP | FAN) {
            return Some("points and lines have no surface");
        }
        let accessors = &self.document.accessors;
        let Some(position) = primitive.attributes.position else {
            return Some("its positions are missing, or packed by an extension");
        };
        let points = accessors.get(position)?;
        let indices = primitive.indices.and_then(|number| accessors.get(number));
        if points.sparse.is_some() || indices.is_some_and(|indices| indices.sparse.is_some()) {
            return Some("sparse accessors are not read");
        }
        if points.buffer_view.is_none() {
            return Some("its positions are missing, or packed by an extension");
        }
        let is_whole = matches!(
            points.component_type,
            SIGNED_BYTE | BYTE | SIGNED_SHORT | SHORT
        );
        let is_whole = is_whole && points.kind == "VEC3";
        is_whole.then_some("positions of whole numbers (KHR_mesh_quantization) are not read")
    }

    fn triangles_of(
        &mut self,
        primitive: &Primitive,
        title: &str,
        note: &mut dyn FnMut(String, &'static str),
    ) -> Result<Option<TriangleMesh>, Problem> {
        let mode = primitive.mode.unwrap_or(TRIANGLES);
        let why = self.unread(primitive);
        let position = primitive.attributes.position;
        let Some(position) = position.filter(|_| why.is_none()) else {
            why.into_iter()
                .for_each(|why| note(format!("primitive of {title}"), why));
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

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;
    use crate::files::MemoryFiles;

    /// Files of six zeros each, and the paths that were asked for.
    #[derive(Default)]
    struct Counted(RefCell<Vec<String>>);

    impl Files for Counted {
        fn read(&self, path: &str, most: usize) -> Result<Vec<u8>, FileError> {
            self.0.borrow_mut().push(path.to_owned());
            match most {
                0..6 => Err(FileError::TooLarge { most }),
                _ => Ok(vec![0; 6]),
            }
        }
    }

    fn read<'a>(
        files: &dyn Files,
        uris: &[Option<&str>],
        binary: Option<&'a [u8]>,
        most: usize,
    ) -> Result<Buffers<'a>, Problem> {
        let buffer = |uri: &Option<&str>| Buffer {
            uri: uri.map(str::to_owned),
            byte_length: 0,
        };
        let stated: Vec<Buffer> = uris.iter().map(buffer).collect();
        let mut sources = Sources {
            path: "models/a.gltf",
            files,
            known: BTreeMap::new(),
            most,
            left: most,
        };
        Buffers::of(&stated, binary, &mut sources)
    }

    #[test]
    fn a_file_is_read_once_for_all_buffers_that_name_it() {
        let files = Counted::default();
        let uris = [
            Some("a.bin"),
            Some("b.bin"),
            Some("./a.bin"),
            Some("%61.bin"),
        ];
        let buffers = read(&files, &uris, None, 12).expect("twelve bytes");
        assert_eq!(*files.0.borrow(), ["models/a.bin", "models/b.bin"]);
        let places = buffers.0.iter().flatten().map(|bytes| bytes.as_ptr());
        let places: Vec<_> = places.collect();
        assert_eq!((places[0], places.len()), (places[2], 4));
        assert_eq!((places[0], places[0] == places[1]), (places[3], false));
    }

    #[test]
    fn the_bytes_of_all_buffers_are_bounded_together() {
        let files = Counted::default();
        let six = "data:;base64,AAAAAAAA";
        for uris in [["a", "b"], ["a", six], [six, "a"], [six, six]] {
            let uris = uris.map(Some);
            let refused = read(&files, &uris, None, 11).err().expect("twelve bytes");
            let said = refused.to_string();
            let words = "buffer 1: all buffers together have more than 11 bytes";
            assert!(said.contains(words), "{said}");
            assert!(read(&files, &uris, None, 12).is_ok());
        }
    }

    #[test]
    fn only_the_first_buffer_has_the_binary_chunk_and_none_a_copy() {
        let chunk = [1, 2, 3];
        let none = MemoryFiles::default();
        let buffers = read(&none, &[None; 1_000], Some(&chunk), 0).expect("no bytes of its own");
        let first = buffers.0[0].as_ref().expect("the chunk");
        assert!(std::ptr::eq(&**first, &chunk[..]));
        assert!(buffers.0[1..].iter().all(Option::is_none));
    }

    #[test]
    fn inline_bytes_and_escaped_names_are_read() {
        let read = |text: &str| inline(&format!("application/octet-stream;base64,{text}"));
        assert_eq!(read("AAECAwT/").as_deref(), Some(&[0, 1, 2, 3, 4, 255][..]));
        assert_eq!(read("AQ==").as_deref(), Some(&[1][..]));
        assert_eq!(read("AQI").as_deref(), Some(&[1, 2][..]));
        assert_eq!((read("A?"), inline("text/plain,abc")), (None, None));
        assert_eq!(unescaped("a%20b%C3%A9%zz%"), "a bé%zz%");
    }
}
