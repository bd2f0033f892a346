//! Arrays of NumPy: one `.npy` file, or the members of an `.npz`.
//!
//! Numbers become 64 bits wide, those of 16 bits too. A claimed size never makes memory grow beyond the bytes that are
//! there. The header is read here: the library that would read it multiplies a claimed shape unchecked, and brings two
//! dozen crates.

use std::collections::BTreeMap;
use std::fmt;
use std::io::Read;

use flate2::bufread::DeflateDecoder;
use rawzip::{CompressionMethod, ZipArchive};

/// First bytes of an array.
pub(super) const MAGIC: &[u8] = b"\x93NUMPY";
/// First bytes of an archive.
pub(super) const ZIP: &[u8] = b"PK\x03\x04";

/// Most bytes of the arrays that are read of an archive, with 64 bits for each number.
const BYTES_MAX: u64 = 2 << 30;

/// The reason why an array is not read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NpyError {
    /// The archive is damaged.
    Archive(String),
    /// The arrays have more bytes than are read.
    TooLarge,
    /// The header is none of NumPy's, or is cut.
    Header {
        /// The array.
        array: String,
        /// The defect.
        defect: &'static str,
    },
    /// Its elements are of another type.
    Type {
        /// The array.
        array: String,
        /// As NumPy writes it.
        descr: String,
    },
    /// It has another number of bytes than its shape needs.
    Length {
        /// The array.
        array: String,
        /// Its shape.
        shape: Vec<u64>,
        /// Bytes that are there.
        bytes: usize,
    },
}

impl fmt::Display for NpyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Archive(cause) => write!(f, "the .npz is damaged: {cause}"),
            Self::TooLarge => write!(
                f,
                "the arrays of the .npz have more than {BYTES_MAX} bytes with 64 bits for each number"
            ),
            Self::Header { array, defect } => write!(f, "array {array}: {defect}"),
            Self::Type { array, descr } => write!(
                f,
                "array {array} has elements of type {descr}; read are f2, f4, f8 (float16, float32, float64) and whole numbers: convert it by astype(\"f8\")"
            ),
            Self::Length {
                array,
                shape,
                bytes,
            } => write!(
                f,
                "array {array} of shape {shape:?} has {bytes} bytes, which are not as many as its shape needs"
            ),
        }
    }
}

impl std::error::Error for NpyError {}

/// An array in the order of C.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Array {
    pub(super) shape: Vec<usize>,
    pub(super) values: Vec<f64>,
    /// True for elements of 32 or 16 bits with a point.
    pub(super) is_single: bool,
}

/// The arrays of an archive.
#[derive(Debug, Default)]
pub(super) struct Archive {
    /// The wanted arrays, by name.
    pub(super) arrays: BTreeMap<String, Array>,
    /// The names of all.
    pub(super) names: Vec<String>,
}

/// Reads the arrays of these names; others are not unpacked.
pub(super) fn read_archive(bytes: &[u8], wanted: &[&str]) -> Result<Archive, NpyError> {
    read_within(bytes, wanted, BYTES_MAX)
}

fn read_within(bytes: &[u8], wanted: &[&str], most: u64) -> Result<Archive, NpyError> {
    let damaged = |cause: &dyn fmt::Display| NpyError::Archive(cause.to_string());
    let archive = ZipArchive::from_slice(bytes).map_err(|cause| damaged(&cause))?;
    let mut entries = archive.entries();
    let mut found = Archive::default();
    let mut left = most;
    while let Some(entry) = entries.next_entry().map_err(|cause| damaged(&cause))? {
        let path = entry.file_path();
        let name = String::from_utf8_lossy(path.as_ref());
        let name = name.trim_end_matches(".npy").to_owned();
        found.names.push(name.clone());
        if !wanted.contains(&name.as_str()) {
            continue;
        }
        let local = archive
            .get_entry(entry.wayfinder())
            .map_err(|cause| damaged(&cause))?;
        let packed = local.data();
        let reader: Box<dyn Read> = match entry.compression_method() {
            CompressionMethod::STORE => Box::new(packed),
            CompressionMethod::DEFLATE => Box::new(DeflateDecoder::new(packed)),
            _ => {
                return Err(damaged(&format!(
                    "{name} is packed neither by deflate nor not at all"
                )));
            }
        };
        let mut member = Vec::new();
        let mut limited = local.verifying_reader(reader).take(left + 1);
        limited
            .read_to_end(&mut member)
            .map_err(|cause| damaged(&format!("{name}: {cause}")))?;
        if member.len() as u64 > left {
            return Err(NpyError::TooLarge);
        }
        let narrow = read_narrow(&name, &member)?;
        // As it is kept, not as it is packed.
        let wide = narrow.wide_bytes();
        left = left.checked_sub(wide).ok_or(NpyError::TooLarge)?;
        found.arrays.insert(name, narrow.widened());
    }
    Ok(found)
}

/// Reads an array.
pub(super) fn read(name: &str, bytes: &[u8]) -> Result<Array, NpyError> {
    Ok(read_narrow(name, bytes)?.widened())
}

/// An array as it is in its file.
struct Narrow<'a> {
    shape: Vec<usize>,
    is_fortran: bool,
    element: Element,
    data: &'a [u8],
}

impl Narrow<'_> {
    /// Bytes of its numbers once each has 64 bits.
    const fn wide_bytes(&self) -> u64 {
        (self.data.len() / self.element.bytes) as u64 * 8
    }

    fn widened(self) -> Array {
        let elements = self.data.chunks_exact(self.element.bytes);
        let values: Vec<f64> = elements.map(|one| self.element.value(one)).collect();
        let values = if self.is_fortran {
            transposed(&values, &self.shape)
        } else {
            values
        };
        Array {
            shape: self.shape,
            values,
            is_single: self.element.kind == b'f' && self.element.bytes <= 4,
        }
    }
}

fn read_narrow<'a>(name: &str, bytes: &'a [u8]) -> Result<Narrow<'a>, NpyError> {
    let wrong = |defect| NpyError::Header {
        array: name.to_owned(),
        defect,
    };
    let behind = bytes
        .strip_prefix(MAGIC)
        .ok_or_else(|| wrong("it does not begin as an array"))?;
    let cut = || wrong("it ends within its header");
    let ([major, _], behind) = behind.split_first_chunk().ok_or_else(cut)?;
    let (length, behind) = match major {
        1 => {
            let (length, behind) = behind.split_first_chunk().ok_or_else(cut)?;
            (usize::from(u16::from_le_bytes(*length)), behind)
        }
        _ => {
            let (length, behind) = behind.split_first_chunk().ok_or_else(cut)?;
            (u32::from_le_bytes(*length) as usize, behind)
        }
    };
    let (header, data) = behind.split_at_checked(length).ok_or_else(cut)?;
    let header = std::str::from_utf8(header).map_err(|_| wrong("its header is not UTF-8"))?;
    let value = |key: &str| {
        let (_, behind) = header.split_once(key)?;
        behind.trim_start().strip_prefix(':').map(str::trim_start)
    };
    let shape = value("'shape'")
        .and_then(shape)
        .ok_or_else(|| wrong("its header has no shape"))?;
    let is_fortran = value("'fortran_order'").is_some_and(|value| value.starts_with("True"));
    let descr = value("'descr'").unwrap_or_default();
    let descr = descr
        .strip_prefix('\'')
        .and_then(|descr| descr.split_once('\''));
    let descr = descr.map_or_else(|| "a structure".to_owned(), |(descr, _)| descr.to_owned());
    let Some(element) = Element::of(&descr) else {
        let array = name.to_owned();
        return Err(NpyError::Type { array, descr });
    };
    let mut needed = Some(element.bytes as u64);
    for length in &shape {
        needed = needed.and_then(|needed| needed.checked_mul(*length));
    }
    if needed != Some(data.len() as u64) {
        return Err(NpyError::Length {
            array: name.to_owned(),
            shape,
            bytes: data.len(),
        });
    }
    Ok(Narrow {
        shape: shape.into_iter().map(|length| length as usize).collect(),
        is_fortran,
        element,
        data,
    })
}

/// The numbers of `(3, 4)`.
fn shape(text: &str) -> Option<Vec<u64>> {
    let (inside, _) = text.strip_prefix('(')?.split_once(')')?;
    let parts = inside
        .split(',')
        .map(str::trim)
        .filter(|part| !part.is_empty());
    parts
        .map(|part| part.trim_end_matches('L').parse().ok())
        .collect()
}

/// The type of an element.
#[derive(Clone, Copy)]
struct Element {
    kind: u8,
    bytes: usize,
    is_big: bool,
}

impl Element {
    fn of(descr: &str) -> Option<Self> {
        let (order, kind, size) = match descr.as_bytes() {
            [order @ (b'<' | b'>' | b'|' | b'='), kind, size] => (*order, *kind, *size),
            _ => return None,
        };
        let bytes = match (kind, size) {
            (b'f', b'2') => 2,
            (b'f', b'4') => 4,
            (b'f', b'8') => 8,
            (b'i' | b'u', b'1' | b'2' | b'4' | b'8') => usize::from(size - b'0'),
            _ => return None,
        };
        Some(Self {
            kind,
            bytes,
            is_big: order == b'>',
        })
    }

    fn value(self, bytes: &[u8]) -> f64 {
        let mut wide = [0; 8];
        wide[..bytes.len()].copy_from_slice(bytes);
        if self.is_big {
            wide[..bytes.len()].reverse();
        }
        let whole = u64::from_le_bytes(wide);
        // Moves the sign of a narrow number to the top and back.
        let spare = 64 - 8 * bytes.len() as u32;
        match (self.kind, bytes.len()) {
            (b'f', 2) => half(whole as u16),
            (b'f', 4) => f64::from(f32::from_bits(whole as u32)),
            (b'f', _) => f64::from_bits(whole),
            (b'u', _) => whole as f64,
            _ => ((whole << spare).cast_signed() >> spare) as f64,
        }
    }
}

/// The value of a number of 16 bits with a point. Source: IEEE 754-2019, binary16.
fn half(bits: u16) -> f64 {
    let fraction = f64::from(bits & 0x3ff) / 1_024.0;
    let size = match (bits >> 10) & 0x1f {
        0 => fraction * 2_f64.powi(-14),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        exponent => (1.0 + fraction) * 2_f64.powi(i32::from(exponent) - 15),
    };
    if bits >> 15 == 1 { -size } else { size }
}

/// Values in the order of C, of those in the order of Fortran.
fn transposed(values: &[f64], shape: &[usize]) -> Vec<f64> {
    let mut place = vec![0; shape.len()];
    let mut to = Vec::with_capacity(values.len());
    for _ in 0..values.len() {
        let mut stride = 1;
        let mut at = 0;
        for (length, index) in shape.iter().zip(&place) {
            at += index * stride;
            stride *= length;
        }
        to.push(values[at]);
        for (length, index) in shape.iter().zip(&mut place).rev() {
            *index += 1;
            if *index < *length {
                break;
            }
            *index = 0;
        }
    }
    to
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// An array of 64-bit numbers, as NumPy writes it.
    pub(in crate::recording) fn written(shape: &str, values: &[f64]) -> Vec<u8> {
        let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n");
        let mut bytes = [MAGIC, &[1, 0], &(header.len() as u16).to_le_bytes()].concat();
        bytes.extend(header.as_bytes());
        bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        bytes
    }

    #[test]
    fn numbers_of_both_orders_are_read() {
        let array = read("a", &written("(2, 3)", &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])).expect("sound");
        assert_eq!((array.shape, array.values[5]), (vec![2, 3], 6.0));
        let bytes = written("(2, 3)", &[1.0, 4.0, 2.0, 5.0, 3.0, 6.0]);
        let text = String::from_utf8_lossy(&bytes).replace("False", "True ");
        assert!(text.contains("True "));
        let mut fortran = bytes.clone();
        let at = bytes
            .windows(5)
            .position(|window| window == b"False")
            .expect("it is there");
        fortran[at..at + 5].copy_from_slice(b"True ");
        let array = read("a", &fortran).expect("sound");
        assert_eq!(array.values, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        assert_eq!(
            Element::of(">i2").expect("known").value(&[0xff, 0xfe]),
            -2.0
        );
    }

    #[test]
    fn numbers_of_16_bits_are_read_and_other_types_of_a_known_array_are_named() {
        let of_type = |descr: &str, data: &[u8]| {
            let header =
                format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (1,), }}\n");
            let length = (header.len() as u16).to_le_bytes();
            [MAGIC, &[1, 0], &length, header.as_bytes(), data].concat()
        };
        for (bits, value) in [
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x7bff, 65_504.0),
            (0x0001, 2_f64.powi(-24)),
            (0x3555, 0.333_251_953_125),
            (0x7c00, f64::INFINITY),
        ] {
            let bytes = u16::to_le_bytes(bits);
            let array = read("a", &of_type("<f2", &bytes)).expect("it is known");
            assert_eq!(
                (array.values.as_slice(), array.is_single),
                (&[value][..], true)
            );
        }
        let nan = read("a", &of_type(">f2", &[0x7e, 0x00])).expect("it is known");
        assert!(nan.values[0].is_nan());
        let members = [("time", of_type("<c8", &[0; 8]))];
        let packed = crate::recording::arrays::tests::archive(&members);
        let error = read_archive(&packed, &["time"])
            .expect_err("complex")
            .to_string();
        assert!(
            error.contains("array time") && error.contains("<c8"),
            "{error}"
        );
        assert!(error.contains("float16"), "{error}");
        assert!(read_archive(&packed, &["t"]).is_ok());
    }

    #[test]
    fn what_is_not_wanted_stays_packed_and_the_limit_counts_numbers_as_they_are_kept() {
        // One body's picture, of bytes, beside its times.
        let bytes = |shape: &str, data: &[u8]| {
            let header =
                format!("{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}, }}\n");
            let length = (header.len() as u16).to_le_bytes();
            [MAGIC, &[1, 0], &length, header.as_bytes(), data].concat()
        };
        let members = [
            ("picture", bytes("(400,)", &[7; 400])),
            ("time", bytes("(100,)", &[3; 100])),
        ];
        let packed = crate::recording::arrays::tests::archive(&members);
        let read = |wanted: &[&str], most| read_within(&packed, wanted, most);
        let found = read(&["time"], 800).expect("a hundred numbers of eight bytes");
        assert_eq!(found.names, ["picture", "time"]);
        assert_eq!(found.arrays["time"].values, [3.0; 100]);
        assert!(!found.arrays.contains_key("picture"));
        assert_eq!(read(&["time"], 799).err(), Some(NpyError::TooLarge));
        assert_eq!(read(&["picture"], 1_000).err(), Some(NpyError::TooLarge));
    }

    #[test]
    fn wrong_headers_and_lengths_are_named() {
        let whole = written("(2,)", &[1.0, 2.0]);
        for cut in 0..whole.len() {
            assert!(read("a", &whole[..cut]).is_err(), "{cut}");
        }
        let huge = written("(99999999999, 99999999999)", &[1.0]);
        let error = read("a", &huge)
            .expect_err("it claims too much")
            .to_string();
        assert!(
            error.contains("[99999999999, 99999999999] has 8 bytes"),
            "{error}"
        );
        let mut text = whole;
        let at = text
            .windows(3)
            .position(|window| window == b"<f8")
            .expect("it is there");
        text[at..at + 3].copy_from_slice(b"<U8");
        let error = read("names", &text).expect_err("no numbers").to_string();
        assert!(
            error.starts_with("array names has elements of type <U8"),
            "{error}"
        );
        assert!(matches!(
            read_archive(b"PK\x03\x04rubbish", &[]),
            Err(NpyError::Archive(_))
        ));
    }
}
