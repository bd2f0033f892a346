//! CDR, the encoding of ROS 2's messages.
//!
//! XCDR1 and XCDR2, in either byte order. Bytes behind a message are ignored, as writers pad them. Memory stays within the
//! bytes that are there, whatever a count claims.

use std::fmt;

/// The reason why bytes are not read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CdrError {
    /// The header names an encoding that is not read.
    Encoding {
        /// Its second byte.
        number: u8,
    },
    /// The bytes end within a field.
    Short {
        /// Offset of the field.
        at: usize,
        /// Its bytes.
        needed: usize,
        /// Bytes that are left.
        left: usize,
    },
    /// A text is not UTF-8, or does not end with a zero.
    Text {
        /// Offset of the text.
        at: usize,
    },
    /// A sequence claims more elements than its bytes can hold.
    Count {
        /// Offset of the count.
        at: usize,
        /// The claim.
        count: u32,
        /// Most elements that the bytes hold.
        most: usize,
    },
}

impl fmt::Display for CdrError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Encoding { number } => write!(
                f,
                "encoding {number} of CDR is not read; 0 and 1 (XCDR1) and 6 to 11 (XCDR2) are"
            ),
            Self::Short { at, needed, left } => {
                write!(
                    f,
                    "byte {at}: a field of {needed} bytes, and {left} are left"
                )
            }
            Self::Text { at } => write!(f, "byte {at}: a text that is not UTF-8 or has no end"),
            Self::Count { at, count, most } => write!(
                f,
                "byte {at}: a sequence of {count} elements, and the bytes hold {most} at most"
            ),
        }
    }
}

impl std::error::Error for CdrError {}

/// Reads one field after the other.
pub(super) struct Cdr<'a> {
    /// Behind the header, from which alignment counts.
    bytes: &'a [u8],
    at: usize,
    is_little: bool,
    version: Version,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Version {
    /// Numbers of eight bytes are aligned to eight.
    One,
    /// They are aligned to four, and sequences of structures have their length in front.
    Two,
}

/// Bytes of the header, which names the encoding.
const HEADER_BYTES: usize = 4;

impl<'a> Cdr<'a> {
    pub(super) fn new(message: &'a [u8]) -> Result<Self, CdrError> {
        let left = message.len();
        let short = CdrError::Short {
            at: 0,
            needed: HEADER_BYTES,
            left,
        };
        let ([zero, number, _, _], bytes) = message.split_first_chunk().ok_or(short)?;
        let version = match (zero, number) {
            (0, 0 | 1) => Version::One,
            (0, 6..=11) => Version::Two,
            _ => return Err(CdrError::Encoding { number: *number }),
        };
        Ok(Self {
            bytes,
            at: 0,
            is_little: number & 1 == 1,
            version,
        })
    }

    fn take<const COUNT: usize>(&mut self, align: usize) -> Result<[u8; COUNT], CdrError> {
        let at = self.at.next_multiple_of(align);
        let rest = self.bytes.get(at..).unwrap_or_default();
        let taken = rest.first_chunk().ok_or(CdrError::Short {
            at: at + HEADER_BYTES,
            needed: COUNT,
            left: rest.len(),
        })?;
        self.at = at + COUNT;
        Ok(*taken)
    }

    pub(super) fn u32(&mut self) -> Result<u32, CdrError> {
        let bytes = self.take(4)?;
        Ok(if self.is_little {
            u32::from_le_bytes(bytes)
        } else {
            u32::from_be_bytes(bytes)
        })
    }

    pub(super) fn i32(&mut self) -> Result<i32, CdrError> {
        self.u32().map(u32::cast_signed)
    }

    pub(super) fn f64(&mut self) -> Result<f64, CdrError> {
        let bytes = self.take(match self.version {
            Version::One => 8,
            Version::Two => 4,
        })?;
        Ok(if self.is_little {
            f64::from_le_bytes(bytes)
        } else {
            f64::from_be_bytes(bytes)
        })
    }

    pub(super) fn f64s<const COUNT: usize>(&mut self) -> Result<[f64; COUNT], CdrError> {
        let mut all = [0.0; COUNT];
        for one in &mut all {
            *one = self.f64()?;
        }
        Ok(all)
    }

    /// A text; its length counts the zero at its end. Length 0 or 1 is empty.
    pub(super) fn text(&mut self) -> Result<&'a str, CdrError> {
        let length = self.u32()? as usize;
        let at = self.at + HEADER_BYTES;
        let rest = &self.bytes[self.at..];
        let short = CdrError::Short {
            at,
            needed: length,
            left: rest.len(),
        };
        let text = rest.get(..length).ok_or(short)?;
        self.at += length;
        let Some((end, text)) = text.split_last() else {
            return Ok("");
        };
        let text = std::str::from_utf8(text).ok().filter(|_| *end == 0);
        text.ok_or(CdrError::Text { at })
    }

    /// The count of a sequence of structures, each of this many bytes at least.
    pub(super) fn count(&mut self, least_bytes: usize) -> Result<u32, CdrError> {
        if self.version == Version::Two {
            self.u32()?;
        }
        let at = self.at.next_multiple_of(4) + HEADER_BYTES;
        let count = self.u32()?;
        let most = (self.bytes.len() - self.at) / least_bytes;
        if count as usize > most {
            return Err(CdrError::Count { at, count, most });
        }
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_versions_and_both_orders_are_read_with_their_alignments() {
        let little = b"\x05\0\0\0abcd\0";
        let big = b"\0\0\0\x05abcd\0";
        let forms = [
            (
                [&[0, 1, 0, 0], &little[..], &[0; 7]].concat(),
                1.5_f64.to_le_bytes(),
            ),
            (
                [&[0, 0, 0, 0], &big[..], &[0; 7]].concat(),
                1.5_f64.to_be_bytes(),
            ),
            (
                [&[0, 7, 0, 0], &little[..], &[0; 3]].concat(),
                1.5_f64.to_le_bytes(),
            ),
        ];
        for (head, number) in forms {
            // Padding behind it is ignored.
            let bytes = [&head[..], &number, &[0, 0]].concat();
            let mut cdr = Cdr::new(&bytes).expect("a known encoding");
            assert_eq!(cdr.text(), Ok("abcd"));
            assert_eq!(cdr.f64(), Ok(1.5));
        }
    }

    #[test]
    fn wrong_bytes_are_refused_with_their_place() {
        let error = |bytes: &[u8], read: fn(&mut Cdr<'_>) -> Result<(), CdrError>| {
            let read = Cdr::new(bytes).and_then(|mut cdr| read(&mut cdr));
            read.expect_err("it is wrong").to_string()
        };
        let text = |cdr: &mut Cdr<'_>| cdr.text().map(drop);
        assert!(error(&[0, 3, 0, 0], text).starts_with("encoding 3 of CDR is not read"));
        assert!(error(&[0, 1], text).contains("byte 0: a field of 4 bytes, and 2 are left"));
        let long = [0, 1, 0, 0, 9, 0, 0, 0, b'a', 0];
        assert!(error(&long, text).contains("byte 8: a field of 9 bytes, and 2 are left"));
        let endless = [0, 1, 0, 0, 1, 0, 0, 0, b'a'];
        assert!(error(&endless, text).contains("byte 8: a text"));
        let many = [0, 1, 0, 0, 255, 255, 255, 255, 0];
        let count = |cdr: &mut Cdr<'_>| cdr.count(80).map(drop);
        assert!(error(&many, count).contains("4294967295 elements, and the bytes hold 0"));
    }
}
