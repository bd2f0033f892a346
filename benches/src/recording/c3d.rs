//! Markers of cameras as C3D: positions of points, frame by frame.
//!
//! Makes no poses by time. Positions are in the file's unit and its axes. Numbers of all three processors are read, as 16
//! bits or with a point. A marker whose residual is below zero, or whose position is not finite, is missing in that frame;
//! its coordinates are never used. Analog channels are left out.
//!
//! The header counts frames with 16 bits. A count in TRIAL comes first; where there is none and the header's is at its
//! end, the frames are those that the file holds.

use std::collections::BTreeMap;
use std::fmt;

use glam::DVec3;
use rhumb_protocol::limits::BODIES_MAX;

/// Bytes of a block: the header is one, and parameters and data begin with one.
pub(super) const BLOCK: usize = 512;
/// The second byte of every file.
pub(super) const KEY: u8 = 0x50;
/// The most that 16 bits count.
const COUNT_MAX: u64 = 65_535;
/// The most blocks that come before the frames: more than any file has.
const BLOCKS_MAX: u32 = 1 << 31;

/// The reason why a C3D file is not read.
#[derive(Clone, Debug, PartialEq)]
pub enum C3dError {
    /// The file ends within a part.
    Ends {
        /// The part.
        within: String,
        /// Where the part lies, bytes from the beginning.
        at: usize,
        /// The length of the file.
        length: usize,
    },
    /// The numbers are those of an unknown processor.
    Processor {
        /// Its number.
        number: u8,
    },
    /// The record of a parameter leads to one that does not come behind it.
    Backwards {
        /// Where it lies.
        at: usize,
    },
    /// A parameter that is needed is missing, or is of another kind.
    Parameter {
        /// Its group and name.
        name: &'static str,
        /// The kind of value that is needed.
        needed: &'static str,
    },
    /// A parameter that counts is no whole number, or beyond the most.
    Count {
        /// Its group and name.
        name: &'static str,
        /// The number.
        stated: f64,
        /// The most.
        most: u32,
    },
    /// The file ends before the last frame that it counts.
    Frames {
        /// Whole frames that it holds.
        held: u64,
        /// Frames that it counts.
        stated: u64,
    },
}

impl fmt::Display for C3dError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ends { within, at, length } => write!(
                f,
                "byte {at}: {within} does not end within the {length} bytes of the file: it is cut"
            ),
            Self::Processor { number } => write!(
                f,
                "the file is of processor {number}; 84 (Intel), 85 (DEC) and 86 (MIPS) are read"
            ),
            Self::Backwards { at } => {
                write!(
                    f,
                    "byte {at}: the record of a parameter does not lead on to the next"
                )
            }
            Self::Parameter { name, needed } => write!(f, "parameter {name} has to be {needed}"),
            Self::Count { name, stated, most } => write!(
                f,
                "parameter {name} is {stated:?}, and has to be a whole number from 0 to {most}"
            ),
            Self::Frames { held, stated } => write!(
                f,
                "the file ends after {held} of the {stated} frames that it counts: it is cut"
            ),
        }
    }
}

impl std::error::Error for C3dError {}

/// True for the beginning of such a file: no text begins so.
pub(super) fn is_c3d(bytes: &[u8]) -> bool {
    let is_block =
        |block: u8| block != 0 && !block.is_ascii_graphic() && !block.is_ascii_whitespace();
    matches!(bytes, [block, KEY, ..] if is_block(*block))
}

/// The form of a file's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Processor {
    Intel,
    Dec,
    Mips,
}

impl Processor {
    fn word(self, bytes: [u8; 2]) -> u16 {
        match self {
            Self::Intel | Self::Dec => u16::from_le_bytes(bytes),
            Self::Mips => u16::from_be_bytes(bytes),
        }
    }

    fn number(self, [a, b, c, d]: [u8; 4]) -> f64 {
        match self {
            Self::Intel => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::Mips => f64::from(f32::from_be_bytes([a, b, c, d])),
            // The words are exchanged, and the exponent counts from two higher.
            Self::Dec => f64::from(f32::from_le_bytes([c, d, a, b])) / 4.0,
        }
    }
}

/// A parameter: its kind, as its record says it, the lengths of its dimensions, and its bytes.
struct Parameter<'a> {
    kind: i8,
    lengths: Vec<usize>,
    data: &'a [u8],
}

/// A file: the numbers of its header, and its parameters.
pub(super) struct File<'a> {
    bytes: &'a [u8],
    processor: Processor,
    /// By group and name, in capital letters.
    parameters: BTreeMap<(String, String), Parameter<'a>>,
}

impl<'a> File<'a> {
    pub(super) fn read(bytes: &'a [u8]) -> Result<Self, C3dError> {
        let mut file = Self {
            bytes,
            processor: Processor::Intel,
            parameters: BTreeMap::new(),
        };
        file.part(0, BLOCK, "the header")?;
        let begin = BLOCK * (usize::from(bytes[0]).saturating_sub(1));
        let front = file.part(begin, 4, "the beginning of the parameters")?;
        file.processor = match front[3] {
            84 => Processor::Intel,
            85 => Processor::Dec,
            86 => Processor::Mips,
            number => return Err(C3dError::Processor { number }),
        };
        file.read_parameters(begin + 4)?;
        Ok(file)
    }

    /// Some bytes; an error names the part that they are.
    fn part(&self, at: usize, length: usize, within: &str) -> Result<&'a [u8], C3dError> {
        let part = at
            .checked_add(length)
            .and_then(|end| self.bytes.get(at..end));
        part.ok_or_else(|| C3dError::Ends {
            within: within.to_owned(),
            at,
            length: self.bytes.len(),
        })
    }

    fn word(&self, bytes: &[u8]) -> u16 {
        self.processor.word([bytes[0], bytes[1]])
    }

    /// A word of the header, counted from one.
    fn header(&self, word: usize) -> u16 {
        self.word(&self.bytes[2 * (word - 1)..])
    }

    fn read_parameters(&mut self, mut at: usize) -> Result<(), C3dError> {
        let mut groups: BTreeMap<i8, String> = BTreeMap::new();
        let mut found: Vec<(i8, String, Parameter<'a>)> = Vec::new();
        loop {
            let record = "the record of a parameter";
            let front = self.part(at, 2, record)?;
            let (length, group) = (front[0].cast_signed(), front[1].cast_signed());
            if length == 0 {
                break;
            }
            // A length below zero is that of a locked one.
            let length = usize::from(length.unsigned_abs());
            let name = String::from_utf8_lossy(self.part(at + 2, length, record)?);
            let name = name.trim().to_ascii_uppercase();
            let pointer = at + 2 + length;
            let next = usize::from(self.word(self.part(pointer, 2, record)?));
            if group < 0 {
                groups.insert(group.saturating_neg(), name);
            } else {
                let parameter = self.parameter(pointer + 2, &name)?;
                found.push((group, name, parameter));
            }
            match next {
                0 => break,
                1 => return Err(C3dError::Backwards { at }),
                _ => at = pointer + next,
            }
        }
        for (group, name, parameter) in found {
            if let Some(group) = groups.get(&group) {
                self.parameters.insert((group.clone(), name), parameter);
            }
        }
        Ok(())
    }

    /// The kind, lengths and bytes of a parameter.
    fn parameter(&self, at: usize, name: &str) -> Result<Parameter<'a>, C3dError> {
        let within = format!("parameter {name}");
        let front = self.part(at, 2, &within)?;
        let (kind, dimensions) = (front[0].cast_signed(), usize::from(front[1]));
        let lengths = self.part(at + 2, dimensions, &within)?;
        let lengths: Vec<usize> = lengths.iter().map(|length| usize::from(*length)).collect();
        let count = lengths
            .iter()
            .fold(1_usize, |all, one| all.saturating_mul(*one));
        let bytes = count.saturating_mul(usize::from(kind.unsigned_abs()));
        let data = self.part(at + 2 + dimensions, bytes, &within)?;
        Ok(Parameter {
            kind,
            lengths,
            data,
        })
    }

    fn get(&self, group: &str, name: &str) -> Option<&Parameter<'a>> {
        self.parameters.get(&(group.to_owned(), name.to_owned()))
    }

    /// The numbers of a parameter. Those of 16 bits count from zero.
    fn numbers(&self, group: &str, name: &str) -> Option<Vec<f64>> {
        let parameter = self.get(group, name)?;
        let data = parameter.data;
        match parameter.kind {
            1 => Some(data.iter().map(|byte| f64::from(*byte)).collect()),
            2 => Some(
                data.as_chunks::<2>()
                    .0
                    .iter()
                    .map(|two| self.processor.word(*two).into())
                    .collect(),
            ),
            4 => Some(
                data.as_chunks::<4>()
                    .0
                    .iter()
                    .map(|four| self.processor.number(*four))
                    .collect(),
            ),
            _ => None,
        }
    }

    fn number(&self, group: &str, name: &str) -> Option<f64> {
        self.numbers(group, name)?.first().copied()
    }

    /// Texts of a parameter, without the blanks that fill them.
    fn texts(&self, group: &str, name: &str) -> Vec<String> {
        let Some(parameter) = self
            .get(group, name)
            .filter(|parameter| parameter.kind == -1)
        else {
            return Vec::new();
        };
        let length = parameter
            .lengths
            .first()
            .copied()
            .unwrap_or(parameter.data.len());
        let texts = parameter.data.chunks(length.max(1));
        let text = |bytes: &[u8]| {
            String::from_utf8_lossy(bytes)
                .trim_matches(['\0', ' '])
                .to_owned()
        };
        texts.map(text).collect()
    }

    pub(super) fn text(&self, group: &str, name: &str) -> Option<String> {
        self.texts(group, name).into_iter().next()
    }

    /// The count of 32 bits in TRIAL, by its two halves.
    fn field(&self, name: &str) -> Option<u64> {
        let words = self.get("TRIAL", name).filter(|words| words.kind == 2)?;
        match words.data {
            [a, b, c, d] => {
                let [low, high] = [[*a, *b], [*c, *d]].map(|half| self.processor.word(half));
                Some(u64::from(low) + 65_536 * u64::from(high))
            }
            _ => None,
        }
    }
}

/// The place of the markers in a file.
pub(super) struct Markers {
    pub(super) count: usize,
    pub(super) frames: u64,
    /// The first frame.
    begin: usize,
    /// Bytes of a frame, with its analog values.
    stride: usize,
    /// `None`: numbers with a point.
    scale: Option<f64>,
    /// The first and last frame of the header, if the frames are those that the file holds.
    miscounted: Option<(u64, u64)>,
}

/// A number that counts, before anything is multiplied by it.
fn whole(name: &'static str, stated: f64, most: u32) -> Result<usize, C3dError> {
    // NaN is none.
    let is_count = (0.0..=f64::from(most)).contains(&stated) && stated.fract() == 0.0;
    let wrong = C3dError::Count { name, stated, most };
    is_count.then_some(stated as usize).ok_or(wrong)
}

impl Markers {
    pub(super) fn find(file: &File<'_>) -> Result<Self, C3dError> {
        let header = |word| f64::from(file.header(word));
        let of = |name, word| file.number("POINT", name).unwrap_or_else(|| header(word));
        let count = whole("POINT:USED", of("USED", 2), BODIES_MAX)?;
        let stated = file.number("POINT", "SCALE");
        let scale = stated.unwrap_or_else(|| {
            file.processor
                .number([12, 13, 14, 15].map(|at| file.bytes[at]))
        });
        if !scale.is_finite() || scale == 0.0 {
            let (name, needed) = ("POINT:SCALE", "a number other than zero");
            return Err(C3dError::Parameter { name, needed });
        }
        let scale = (scale > 0.0).then_some(scale);
        let width = if scale.is_some() { 2 } else { 4 };
        let block = match whole("POINT:DATA_START", of("DATA_START", 9), BLOCKS_MAX)? {
            0 => usize::from(file.header(9)),
            block => block,
        };
        let begin = BLOCK.saturating_mul(block.saturating_sub(1));
        let stride = (width * (4 * count + usize::from(file.header(3)))).max(1);
        let mut markers = Self {
            count,
            frames: 0,
            begin,
            stride,
            scale,
            miscounted: None,
        };
        markers.count_frames(file)?;
        Ok(markers)
    }

    fn count_frames(&mut self, file: &File<'_>) -> Result<(), C3dError> {
        let begun = file.field("ACTUAL_START_FIELD");
        let in_trial = begun.zip(file.field("ACTUAL_END_FIELD"));
        let in_header = (u64::from(file.header(4)), u64::from(file.header(5)));
        let (first, last) = in_trial.unwrap_or(in_header);
        let stated = (last + 1).saturating_sub(first);
        let held = file.bytes.len().saturating_sub(self.begin) / self.stride;
        // The header's count is at its end, or went round.
        let is_full = in_trial.is_none() && (last >= COUNT_MAX || last < first);
        if is_full && held as u64 > stated {
            self.miscounted = Some((first, last));
            self.frames = (held - self.filling(file, held)) as u64;
            return Ok(());
        }
        if stated > held as u64 {
            let held = held as u64;
            return Err(C3dError::Frames { held, stated });
        }
        self.frames = stated;
        Ok(())
    }

    /// Frames of zeros at the end, which fill the last block.
    fn filling(&self, file: &File<'_>, held: usize) -> usize {
        let is_empty = |frame: &usize| {
            let at = self.begin + frame * self.stride;
            file.bytes[at..at + self.stride]
                .iter()
                .all(|byte| *byte == 0)
        };
        let most = BLOCK / self.stride;
        (0..held).rev().take(most).take_while(is_empty).count()
    }

    /// Frames in a second.
    pub(super) fn hertz(&self, file: &File<'_>) -> Result<f64, C3dError> {
        let in_header = file
            .processor
            .number([20, 21, 22, 23].map(|at| file.bytes[at]));
        let hertz = file.number("POINT", "RATE").unwrap_or(in_header);
        // NaN is none.
        let is_rate = hertz > 0.0;
        is_rate.then_some(hertz).ok_or(C3dError::Parameter {
            name: "POINT:RATE",
            needed: "a number of hertz above zero (--rate)",
        })
    }

    /// Position of a marker in a frame, in the file's unit; `None` where it is missing.
    pub(super) fn position(&self, file: &File<'_>, frame: usize, marker: usize) -> Option<DVec3> {
        let width = if self.scale.is_some() { 2 } else { 4 };
        let at = self.begin + frame * self.stride + 4 * width * marker;
        let bytes = &file.bytes[at..at + 4 * width];
        let [x, y, z, residual] = [0, 1, 2, 3].map(|place| match self.scale {
            Some(_) => f64::from(file.word(&bytes[2 * place..]).cast_signed()),
            None => {
                let four = &bytes[4 * place..];
                file.processor.number([four[0], four[1], four[2], four[3]])
            }
        });
        let position = DVec3::new(x, y, z) * self.scale.unwrap_or(1.0);
        // A residual that is not a number is none below zero.
        let is_missing = residual < 0.0 || !position.is_finite();
        (!is_missing).then_some(position)
    }

    /// The names of all markers, each once.
    pub(super) fn labels(&self, file: &File<'_>) -> Vec<String> {
        let further = (2..).map(|number| format!("LABELS{number}"));
        let mut stated = file.texts("POINT", "LABELS");
        for name in further {
            let more = file.texts("POINT", &name);
            if more.is_empty() {
                break;
            }
            stated.extend(more);
        }
        let mut known = std::collections::BTreeSet::new();
        let label = |marker: usize| {
            let label = stated.get(marker).filter(|label| !label.is_empty());
            let plain = format!("marker {marker}");
            let label = label.cloned().unwrap_or_else(|| plain.clone());
            match known.insert(label.clone()) {
                true => label,
                false => format!("{label} ({plain})"),
            }
        };
        (0..self.count).map(label).collect()
    }

    /// Sentences on what the file has and the recording has not.
    pub(super) fn notes(&self, file: &File<'_>) -> Vec<String> {
        let mut notes = vec!["markers have positions alone: no body turns".to_owned()];
        let frames = self.frames;
        notes.extend(self.miscounted.map(|(first, last)| match last >= COUNT_MAX {
            true => {
                format!("the header cannot count beyond {COUNT_MAX}; the file holds {frames} frames")
            }
            false => format!(
                "the header has the frames from {first} to {last}, which are none; the file holds {frames} frames"
            ),
        }));
        if file.header(3) > 0 {
            notes.push(format!(
                "{} analog values of each frame are left out",
                file.header(3)
            ));
        }
        notes
    }
}
