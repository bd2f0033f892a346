//! Errors of reading a recording.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use rhumb_protocol::limits::BODIES_MAX;
use rhumb_protocol::scene::Invalid;
use rhumb_reckoning::{InvalidInertia, Tick};
use rhumb_trace::ContentsError;

use super::bvh::BvhError;
use super::c3d::C3dError;
use super::npy::NpyError;

/// The forms that are read, as an error states them.
const FORMS: &str = "read are MCAP files (traces, recordings of a server, foxglove.FrameTransforms, FrameTransform, \
                     PoseInFrame, PosesInFrame or SceneUpdate in protobuf, and tf2_msgs/msg/TFMessage, \
                     geometry_msgs/msg/PoseStamped or nav_msgs/msg/Odometry in cdr), CSV files of time, body, x, y, z, qx, qy, \
                     qz, qw, NumPy arrays in .npz or .npy, BVH, C3D, and .rhtrace files, packed by zstd or not";

/// The error of a recording that was not read.
#[derive(Debug)]
pub enum RecordingError {
    /// The file cannot be read.
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        cause: io::Error,
    },
    /// The file is no valid recording.
    File {
        /// Path of the file.
        path: PathBuf,
        /// The defect.
        cause: Box<Self>,
    },
    /// The file is of another form.
    UnknownForm,
    /// Decompression failed.
    Unpack(io::Error),
    /// The magic number of an `.rhtrace` is missing.
    NotARecording,
    /// The data end too early.
    Short {
        /// The part in which they end.
        within: String,
    },
    /// Data follow the last frame.
    Long {
        /// Bytes behind it.
        bytes: usize,
    },
    /// The frame count exceeds the limit.
    Frames {
        /// Frame count stated by the file, as far as 32 bits hold it.
        frames: u32,
    },
    /// The step that the file states is none of a rate from 1 to 1000 Hz.
    Step {
        /// The step, seconds.
        step_s: f64,
    },
    /// The time between frames is the step of no rate from 1 to 1000 Hz, and the caller may state one.
    Interval {
        /// The time, seconds.
        step_s: f64,
    },
    /// More poses would be made of those of the file than it may take.
    Poses {
        /// Poses that would be made.
        made: u64,
        /// Most that are.
        most: u64,
    },
    /// The times of poses keep no constant rate.
    NoRate {
        /// Step that fits them best, seconds.
        step_s: f64,
        /// The pose that is furthest off, as a share of a step.
        share: f64,
        /// Its place in the file.
        place: Place,
    },
    /// A number is not finite or otherwise invalid.
    Number {
        /// Tick of the record.
        tick: Tick,
        /// Index of the body.
        index: u32,
    },
    /// Extents out of bounds, or inconsistent with the stated radius.
    Extents {
        /// Index of the body.
        index: u32,
    },
    /// A record whose flags stand for nothing, or say that a body goes unchanged which is not there or stays.
    Flags {
        /// Tick of the record.
        tick: Tick,
        /// Index of the body.
        index: u32,
        /// Its flags.
        flags: u8,
    },
    /// A record of an unknown body, or one out of order.
    Record {
        /// Tick of the record.
        tick: Tick,
        /// Index of the body.
        index: u32,
    },
    /// A body moves that was not placed.
    NotPlaced {
        /// Tick of its record.
        tick: Tick,
        /// Index of the body.
        index: u32,
    },
    /// The states of one tick occur twice.
    TickTwice {
        /// The tick.
        tick: Tick,
        /// The scene or load.
        load: String,
    },
    /// A row or a pose has a defect.
    Row {
        /// Its place in the file.
        place: Place,
        /// The defect.
        defect: RowDefect,
    },
    /// The first line names no columns, and is no row.
    Header {
        /// The line.
        line: u32,
        /// Columns that are missing.
        missing: Vec<&'static str>,
    },
    /// The MCAP file cannot be read.
    Contents(ContentsError),
    /// A message is not what its topic holds.
    Message {
        /// The topic.
        topic: String,
        /// Log time, nanoseconds.
        log_ns: u64,
        /// The defect.
        cause: prost::DecodeError,
    },
    /// A message of ROS 2 is not what its topic holds.
    Cdr {
        /// The message.
        place: Place,
        /// The defect.
        cause: CdrError,
    },
    /// The file has more bodies than a scene.
    TooManyBodies {
        /// The place of the first one too many.
        place: Place,
    },
    /// A body comes more often than its id can say.
    Stays {
        /// Its name, or its index.
        body: String,
    },
    /// The file claims more bodies than a scene has.
    Bodies {
        /// The claim.
        bodies: u64,
    },
    /// A BVH file has a defect.
    Bvh(BvhError),
    /// A C3D file has a defect.
    C3d(C3dError),
    /// The unit of positions is unknown.
    Unit {
        /// The unit that the file states; empty for none.
        stated: String,
    },
    /// An array of NumPy is not read.
    Npy(NpyError),
    /// An array has another shape or type than needed.
    Array {
        /// Its name.
        array: String,
        /// The values that are allowed.
        needed: &'static str,
    },
    /// An array has another shape than the recording's bodies and frames need.
    ArrayShape {
        /// Its name.
        array: String,
        /// Its shape.
        shape: Vec<usize>,
        /// The shape that is needed.
        needed: Vec<usize>,
        /// The meaning of that shape.
        of: &'static str,
    },
    /// A number of an array is out of its range.
    ArrayNumber {
        /// The array.
        array: String,
        /// The number.
        number: f64,
        /// The numbers that are allowed: whole ones, say.
        kind: &'static str,
        /// Least of them.
        least: f64,
        /// Greatest of them.
        most: f64,
    },
    /// The numbers of an array are those of no solid.
    ArrayBody {
        /// The array.
        array: String,
        /// The body, counted from zero.
        body: usize,
        /// The defect.
        cause: BodyDefect,
    },
    /// An array does not fit another.
    OtherShape {
        /// Its name.
        array: String,
        /// The other's.
        beside: String,
    },
    /// Arrays are missing.
    Arrays {
        /// The arrays that are there.
        found: Vec<String>,
    },
    /// Nothing says in which order the numbers of quaternions are.
    QuaternionOrder {
        /// Their array.
        array: String,
    },
    /// The MCAP file has no bodies that are read.
    NoPoses {
        /// Encoding and schema of each of its topics.
        found: Vec<String>,
    },
    /// The file does not have the requested load.
    UnknownLoad {
        /// The requested load.
        name: String,
        /// The loads that it has.
        loads: Vec<String>,
    },
    /// A transform's frame hangs on itself.
    Cycle {
        /// The frame.
        frame: String,
    },
    /// The recording holds no motion.
    NoTruth,
    /// The scene is unknown, so its gravity is unknown too.
    UnknownScene {
        /// Name of the scene.
        name: String,
    },
    /// The scene's config is out of bounds.
    Terms(Invalid),
}

/// The place of a row or message in its file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// The file as a whole.
    Whole,
    /// A line, counted from one.
    Line(u32),
    /// A body in a frame of an array, both counted from zero.
    Element {
        /// The array.
        array: String,
        /// The frame.
        frame: u64,
        /// The body.
        body: u64,
    },
    /// A record of an `.rhtrace`.
    Record {
        /// Its frame.
        frame: u64,
        /// Its body.
        body: u64,
    },
    /// A message.
    Message {
        /// Its topic.
        topic: String,
        /// Its log time, nanoseconds.
        log_ns: u64,
    },
}

/// The reason why no solid has these numbers.
#[derive(Clone, Debug, PartialEq)]
pub enum BodyDefect {
    /// The extents are those of no shape.
    Extents(Box<Invalid>),
    /// The moments of inertia are out of range.
    Moments {
        /// The moments.
        moments: [f32; 3],
        /// The rule.
        cause: InvalidInertia,
    },
    /// A moment of inertia exceeds the sum of the other two.
    Sums {
        /// The moments.
        moments: [f32; 3],
    },
}

/// An error of a row or a pose.
#[derive(Clone, Debug, PartialEq)]
pub enum RowDefect {
    /// It has another number of fields than the header.
    Fields {
        /// Its number of fields.
        found: usize,
        /// The header's.
        expected: usize,
    },
    /// A field is no number.
    NotANumber {
        /// The name of the column.
        column: &'static str,
        /// Its text.
        text: String,
    },
    /// A number is not finite, or too large.
    OutOfRange {
        /// The quantity that it belongs to.
        of: &'static str,
        /// Most that it may be, if it is not single precision that limits it.
        most: Option<&'static str>,
    },
    /// A quaternion is not of length one.
    Rotation {
        /// Its length.
        length: f64,
    },
    /// The body has another pose at the same time.
    Contradiction {
        /// The body.
        body: String,
        /// The other place.
        other: Box<Place>,
    },
    /// The body has a pose of this frame already.
    Twice {
        /// The body.
        body: String,
        /// The other place.
        other: Box<Place>,
    },
    /// A transform names another parent than before.
    Parent {
        /// The frame.
        frame: String,
    },
}

impl RecordingError {
    pub(super) fn read(path: &Path, cause: io::Error) -> Self {
        Self::Read {
            path: path.to_owned(),
            cause,
        }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Whole => f.write_str("the file"),
            Self::Line(line) => write!(f, "line {line}"),
            Self::Element { array, frame, body } => {
                write!(f, "body {body} of frame {frame} in {array}")
            }
            Self::Record { frame, body } => write!(f, "body {body} of frame {frame}"),
            Self::Message { topic, log_ns } => {
                write!(f, "the message of {topic} at {} s", *log_ns as f64 / 1e9)
            }
        }
    }
}

/// A number that a file states, in few letters, however large or small it is.
struct Short(f64);

impl fmt::Display for Short {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let number = self.0;
        let is_plain = number == 0.0 || (1e-9..1e15).contains(&number.abs());
        match is_plain || !number.is_finite() {
            true => write!(f, "{number}"),
            false => write!(f, "{number:e}"),
        }
    }
}

/// A shape as NumPy writes it.
struct Tuple<'a>(&'a [usize]);

impl fmt::Display for Tuple<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            [length] => write!(f, "({length},)"),
            lengths => {
                let lengths: Vec<String> = lengths.iter().map(usize::to_string).collect();
                write!(f, "({})", lengths.join(", "))
            }
        }
    }
}

impl fmt::Display for BodyDefect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Extents(cause) => write!(f, "{cause}"),
            Self::Moments { moments, cause } => write!(
                f,
                "the moments of inertia are {moments:?}: {cause}; leave inertia out to have those of the shape"
            ),
            Self::Sums { moments } => write!(
                f,
                "the moments of inertia are {moments:?}, and no moment of a solid exceeds the sum of the other two; leave inertia out to have those of the shape"
            ),
        }
    }
}

impl fmt::Display for RowDefect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fields { found, expected } => {
                write!(f, "has {found} fields, and there are {expected} columns")
            }
            Self::NotANumber { column, text } => {
                write!(f, "column {column}: {text:?} is no number")
            }
            Self::OutOfRange { of, most } => {
                let most = most.map_or_else(String::new, |most| format!(": {most} at most"));
                write!(f, "the {of} is not finite or too large{most}")
            }
            Self::Rotation { length } => write!(
                f,
                "the quaternion has length {}, not 1: are its columns those of x, y, z, w?",
                Short(*length)
            ),
            Self::Contradiction { body, other } => {
                write!(
                    f,
                    "body {body} has another pose at the same time, by {other}"
                )
            }
            Self::Twice { body, other } => {
                write!(
                    f,
                    "body {body} has a pose of this frame already, by {other}; --resample HZ interpolates poses without one rate"
                )
            }
            Self::Parent { frame } => {
                write!(
                    f,
                    "frame {frame} has another parent than in its first transform"
                )
            }
        }
    }
}

impl fmt::Display for RecordingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Read { path, cause } => write!(f, "cannot read {}: {cause}", path.display()),
            Self::File { path, cause } => write!(f, "{}: {cause}", path.display()),
            Self::UnknownForm => write!(f, "this is no recording; {FORMS}"),
            Self::Unpack(cause) => write!(f, "the recording cannot be unpacked: {cause}"),
            Self::NotARecording => {
                write!(
                    f,
                    "this is no .rhtrace, which begins with RHTRACE1; {FORMS}"
                )
            }
            other => other.fmt_contents(f),
        }
    }
}

impl RecordingError {
    /// Writes errors about the contents of a file.
    fn fmt_contents(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Short { within } => write!(f, "the recording ends within {within}"),
            Self::Long { bytes } => write!(f, "{bytes} bytes follow the last frame"),
            Self::Frames { frames } => write!(
                f,
                "the recording claims {frames} frames, more than are read"
            ),
            Self::Step { step_s } => {
                let step = Short(*step_s);
                write!(f, "{step} s is the step of no rate from 1 to 1000 Hz")
            }
            Self::Interval { step_s } => write!(
                f,
                "{} s is the step of no rate from 1 to 1000 Hz: --rate HZ states the rate of the frames",
                Short(*step_s)
            ),
            Self::Poses { made, most } => write!(
                f,
                "the file would become {made} poses, and at most {most} are made of it: a lower --resample makes fewer"
            ),
            Self::NoRate {
                step_s,
                share,
                place,
            } => write!(
                f,
                "the times keep no constant rate: {place} lies {:.0} % of a step beside the frames of {} s; \
                 --rate HZ states another rate, --resample HZ interpolates them",
                share * 100.0,
                Short(*step_s)
            ),
            Self::Number { tick, index } => {
                write!(f, "body {index} has an invalid number at {tick}")
            }
            Self::Extents { index } => write!(
                f,
                "body {index} has half extents out of range, or another bounding radius than theirs"
            ),
            Self::Flags { tick, index, flags } => write!(
                f,
                "the record of body {index} at {tick} has the flags {flags}: bits 0 to 2 are known, and bit 2 stands beside bit 1 for a body that is there"
            ),
            Self::Record { tick, index } => write!(
                f,
                "a record at {tick} is of body {index}, which is out of order or beyond the number of bodies"
            ),
            Self::NotPlaced { tick, index } => write!(
                f,
                "body {index} moves at {tick} and was not placed: the beginning of the recording is missing"
            ),
            Self::TickTwice { tick, load } => write!(
                f,
                "{tick} of {load} occurs twice: recordings of two runs were merged"
            ),
            Self::Stays { body } => write!(
                f,
                "body {body} comes more than {} times, as often as an id can say; of poses, --missing hold keeps it there",
                u32::from(u16::MAX) + 1
            ),
            other => other.fmt_arrays(f),
        }
    }

    /// Writes errors about arrays and numbers of bodies.
    fn fmt_arrays(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cdr { place, cause } => write!(f, "{place}: {cause}"),
            Self::TooManyBodies { place } => write!(
                f,
                "{place}: this is body {}, and a scene has {BODIES_MAX} at most",
                u64::from(BODIES_MAX) + 1
            ),
            Self::Bodies { bodies } => {
                write!(
                    f,
                    "the file claims {bodies} bodies, and a scene has {BODIES_MAX} at most"
                )
            }
            Self::Npy(cause) => write!(f, "{cause}"),
            Self::Bvh(cause) => write!(f, "{cause}"),
            Self::C3d(cause) => write!(f, "{cause}"),
            Self::Unit { stated } if stated.is_empty() => f.write_str(
                "the file does not say the unit of its positions: --unit cm (as most skeletons have it), mm, m, in, ft, or a number of metres",
            ),
            Self::Unit { stated } => write!(
                f,
                "the unit {stated:?} is unknown: --unit mm, cm, m, in, ft, or a number of metres"
            ),
            Self::Array { array, needed } => write!(f, "array {array} has to be {needed}"),
            Self::ArrayShape {
                array,
                shape,
                needed,
                of,
            } => write!(
                f,
                "array {array} has shape {}, and needs shape {}: {of}",
                Tuple(shape),
                Tuple(needed)
            ),
            Self::ArrayNumber {
                array,
                number,
                kind,
                least,
                most,
            } => write!(
                f,
                "array {array} has {}, and needs {kind} from {least} to {most}",
                Short(*number)
            ),
            Self::ArrayBody { array, body, cause } => {
                write!(f, "array {array}, body {body}: {cause}")
            }
            Self::OtherShape { array, beside } => {
                write!(
                    f,
                    "array {array} has not as many frames and bodies as {beside}"
                )
            }
            Self::Arrays { found } => write!(
                f,
                "of the arrays {} none are poses: time (or timestep) and qpos, or time, position (or xpos) and quat_xyzw, quat_wxyz or xquat",
                found.join(", ")
            ),
            Self::QuaternionOrder { array } => write!(
                f,
                "array {array} does not say whether w is first or last: --quaternion wxyz or xyzw, or name it quat_wxyz or quat_xyzw"
            ),
            other => other.fmt_messages(f),
        }
    }

    /// Writes errors about rows, messages and names.
    fn fmt_messages(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Row { place, defect } => write!(f, "{place}: {defect}"),
            Self::Header { line, missing } => write!(
                f,
                "line {line} is neither a row of numbers nor a header: it does not name {}",
                missing.join(", ")
            ),
            Self::Contents(cause) => write!(f, "{cause}"),
            Self::Message {
                topic,
                log_ns,
                cause,
            } => write!(
                f,
                "the message of {topic} at {} s: {cause}",
                *log_ns as f64 / 1e9
            ),
            Self::NoPoses { found } if found.is_empty() => {
                write!(f, "the MCAP file has no topics; {FORMS}")
            }
            Self::NoPoses { found } => {
                write!(f, "the MCAP file has {}; {FORMS}", found.join(", "))
            }
            Self::UnknownLoad { name, loads } => {
                let loads = loads.join(", ");
                write!(f, "there is no load {name:?}; there are {loads}")
            }
            Self::Cycle { frame } => write!(f, "frame {frame} is its own parent"),
            Self::NoTruth => f.write_str("the recording holds no motion: it needs two frames"),
            Self::UnknownScene { name } => write!(
                f,
                "the trace is of the unknown scene {name:?}, so its gravity is unknown"
            ),
            Self::Terms(invalid) => write!(f, "{invalid}"),
            Self::Read { .. }
            | Self::File { .. }
            | Self::UnknownForm
            | Self::Unpack(_)
            | Self::Cdr { .. }
            | Self::TooManyBodies { .. }
            | Self::Stays { .. }
            | Self::Bodies { .. }
            | Self::Npy(_)
            | Self::Bvh(_)
            | Self::C3d(_)
            | Self::Unit { .. }
            | Self::Array { .. }
            | Self::ArrayShape { .. }
            | Self::ArrayNumber { .. }
            | Self::ArrayBody { .. }
            | Self::OtherShape { .. }
            | Self::Arrays { .. }
            | Self::QuaternionOrder { .. }
            | Self::NotARecording
            | Self::Short { .. }
            | Self::Long { .. }
            | Self::Frames { .. }
            | Self::Step { .. }
            | Self::Interval { .. }
            | Self::Poses { .. }
            | Self::NoRate { .. }
            | Self::Number { .. }
            | Self::Extents { .. }
            | Self::Record { .. }
            | Self::Flags { .. }
            | Self::NotPlaced { .. }
            | Self::TickTwice { .. } => fmt::Display::fmt(self, f),
        }
    }
}

impl std::error::Error for RecordingError {}

impl From<NpyError> for RecordingError {
    fn from(cause: NpyError) -> Self {
        Self::Npy(cause)
    }
}

impl From<BvhError> for RecordingError {
    fn from(cause: BvhError) -> Self {
        Self::Bvh(cause)
    }
}

impl From<C3dError> for RecordingError {
    fn from(cause: C3dError) -> Self {
        Self::C3d(cause)
    }
}

impl From<ContentsError> for RecordingError {
    fn from(cause: ContentsError) -> Self {
        Self::Contents(cause)
    }
}

/// The reason why bytes are not read as CDR, the encoding of ROS 2's messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CdrError {
    /// The header names an encoding that is not read.
    Encoding {
        /// Its first two bytes, the first one high.
        number: u16,
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
