//! The bytes of a glTF file: container, buffers, numbers of accessors.
//!
//! Invariant: what an accessor claims is compared with the bytes of its view before memory is taken for it.

use glam::DVec3;

use super::document::{Accessor, Document};
use crate::files::{Files, folder_of, join};
use crate::mesh::MESH_BYTES_MAX;
use crate::report::Problem;

/// The first bytes of a binary file.
pub(crate) const MAGIC: &[u8] = b"glTF";
/// Kinds of its chunks.
const JSON: u32 = 0x4e4f_534a;
const BINARY: u32 = 0x004e_4942;
/// Component types of accessors.
const BYTE: u32 = 5_121;
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

/// The bytes of each buffer.
pub(super) struct Buffers(Vec<Vec<u8>>);

impl Buffers {
    pub(super) fn read(
        document: &Document,
        path: &str,
        files: &dyn Files,
        binary: Option<&[u8]>,
    ) -> Result<Self, Problem> {
        let mut buffers = Vec::new();
        for (number, buffer) in document.buffers.iter().enumerate() {
            let bytes = match buffer.uri.as_deref() {
                None => binary.unwrap_or_default().to_vec(),
                Some(uri) => match uri.strip_prefix("data:") {
                    Some(data) => inline(data)
                        .ok_or_else(|| wrong(format!("buffer {number}: its data are no base64")))?,
                    None => {
                        let path = join(folder_of(path), &unescaped(uri));
                        let read = files.read(&path, MESH_BYTES_MAX);
                        read.map_err(|error| wrong(format!("buffer {number}, {path}: {error}")))?
                    }
                },
            };
            if bytes.len() < buffer.byte_length {
                let (said, held) = (buffer.byte_length, bytes.len());
                return Err(wrong(format!(
                    "buffer {number} says {said} bytes and holds {held}: it is cut"
                )));
            }
            buffers.push(bytes);
        }
        Ok(Self(buffers))
    }

    /// The elements of an accessor, of so many bytes each.
    fn elements<'a>(
        &'a self,
        document: &Document,
        number: usize,
        accessor: &Accessor,
        size: usize,
    ) -> Result<impl Iterator<Item = &'a [u8]>, Problem> {
        let wrong = |cause: &str| wrong(format!("accessor {number} {cause}"));
        let view = accessor.buffer_view.ok_or_else(|| wrong("has no bytes"))?;
        let view = document.buffer_views.get(view);
        let view = view.ok_or_else(|| wrong("names a view beyond the last"))?;
        let buffer = self.0.get(view.buffer);
        let buffer = buffer.ok_or_else(|| wrong("names a buffer beyond the last"))?;
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
        Ok((0..count).map(move |place| &bytes[place * stride..][..size]))
    }

    /// Points of an accessor.
    pub(super) fn points(&self, document: &Document, number: usize) -> Result<Vec<DVec3>, Problem> {
        let accessor = accessor(document, number)?;
        if accessor.component_type != FLOAT || accessor.kind != "VEC3" {
            return Err(wrong(format!(
                "accessor {number} has to be of three numbers with a point for each position"
            )));
        }
        let elements = self.elements(document, number, accessor, 12)?;
        let number =
            |four: &[u8]| f64::from(f32::from_le_bytes([four[0], four[1], four[2], four[3]]));
        let point = |of: &[u8]| DVec3::new(number(of), number(&of[4..]), number(&of[8..]));
        Ok(elements.map(point).collect())
    }

    /// Indices of an accessor.
    pub(super) fn indices(&self, document: &Document, number: usize) -> Result<Vec<u32>, Problem> {
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
        let elements = self.elements(document, number, accessor, size)?;
        let index = |bytes: &[u8]| {
            let (low, high) = bytes.split_at(bytes.len().min(1));
            let low = u32::from(low.first().copied().unwrap_or_default());
            let high = high
                .iter()
                .rev()
                .fold(0, |sum, byte| sum << 8 | u32::from(*byte));
            low | high << 8
        };
        Ok(elements.map(index).collect())
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

#[cfg(test)]
mod tests {
    use super::*;

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
