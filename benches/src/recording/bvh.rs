//! Skeletons as BVH text: joints by offsets and angles, frame by frame.
//!
//! Makes no poses by time. Places are in the file's unit and its world axes. Rotations are multiplied in the order of their
//! channels. Positions replace a joint's offset in some programs, are added to it in others, and are not read by a third
//! kind: unless the caller states it, that of the first two is taken which puts the joint nearer to its offset in the first
//! frame, and a sentence says so.
//!
//! A joint without channels moves with the one above it, and is folded into its children's offsets.

use std::fmt;
use std::str::{Lines, SplitWhitespace};

use glam::{DQuat, DVec3};

/// The first word of a file.
pub(super) const FIRST: &str = "HIERARCHY";
/// Names of channels, with their axes.
const CHANNELS: [(&str, Channel); 6] = [
    ("Xposition", Channel::Position(0)),
    ("Yposition", Channel::Position(1)),
    ("Zposition", Channel::Position(2)),
    ("Xrotation", Channel::Rotation(0)),
    ("Yrotation", Channel::Rotation(1)),
    ("Zrotation", Channel::Rotation(2)),
];

/// A BVH file that is not read.
#[derive(Clone, Debug, PartialEq)]
pub struct BvhError {
    /// Counted from one.
    pub line: u32,
    /// The defect there.
    pub defect: BvhDefect,
}

/// The meaning of the position channels of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum PositionChannels {
    /// They are in the place of its offset.
    Replace,
    /// They are added to its offset.
    Add,
    /// Channels below the root are not read.
    Ignore,
}

/// The reason why a BVH file is not read.
#[derive(Clone, Debug, PartialEq)]
pub enum BvhDefect {
    /// The file ends before this.
    Ends {
        /// The missing part.
        before: String,
    },
    /// A word stands where another has to.
    Word {
        /// The word.
        found: String,
        /// The words that may stand there.
        expected: &'static str,
    },
    /// A number is none, or not finite.
    Number {
        /// The quantity that it states.
        of: String,
        /// Its text.
        text: String,
    },
    /// A count is none.
    Count {
        /// The counted thing.
        of: &'static str,
        /// Its text.
        text: String,
    },
    /// A joint has two position channels along one axis.
    ChannelTwice {
        /// The joint.
        joint: String,
        /// The channel.
        channel: &'static str,
    },
    /// A joint has no offset.
    NoOffset {
        /// The joint.
        joint: String,
    },
    /// A row has more or fewer numbers than there are channels.
    Numbers {
        /// Its numbers.
        found: usize,
        /// The channels.
        expected: usize,
    },
    /// There are more or fewer rows than the file says.
    Frames {
        /// The rows, as far as they were counted.
        found: usize,
        /// The number in the file's header.
        stated: usize,
    },
    /// No joint has a channel.
    NoChannels,
}

impl fmt::Display for BvhDefect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ends { before } => write!(f, "the file ends before {before}: it is cut"),
            Self::Word { found, expected } => {
                write!(f, "{found:?} stands in the place of {expected}")
            }
            Self::Number { of, text } => write!(f, "{of}: {text:?} is no finite number"),
            Self::Count { of, text } => write!(
                f,
                "{of}: {text:?} is no count, which is a whole number from 0 to {}",
                u32::MAX
            ),
            Self::ChannelTwice { joint, channel } => write!(
                f,
                "joint {joint:?} has the channel {channel} twice: one of them belongs to another axis"
            ),
            Self::NoOffset { joint } => write!(f, "joint {joint:?} has no OFFSET"),
            Self::Numbers { found, expected } => {
                write!(
                    f,
                    "the row has {found} numbers, and there are {expected} channels"
                )
            }
            Self::Frames { found, stated } if found > stated => {
                write!(f, "this is row {found}, and Frames says {stated}")
            }
            Self::Frames { found, stated } => write!(
                f,
                "the file ends after {found} rows, and Frames says {stated}: it is cut"
            ),
            Self::NoChannels => f.write_str("no joint has a channel: nothing moves"),
        }
    }
}

impl fmt::Display for BvhError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: {}", self.line, self.defect)
    }
}

impl std::error::Error for BvhError {}

/// True for the beginning of such a file.
pub(super) fn is_bvh(text: &str) -> bool {
    let text = text.trim_start_matches('\u{feff}').trim_start();
    let first = text.split_whitespace().next();
    first.is_some_and(|word| word.eq_ignore_ascii_case(FIRST))
}

/// Reads a file.
pub(super) fn read(text: &str) -> Result<(Skeleton, Motion), BvhError> {
    let mut text = Text::of(text);
    let skeleton = Skeleton::read(&mut text)?;
    let motion = Motion::read(&mut text, &skeleton)?;
    Ok((skeleton, motion))
}

/// The words and lines of a file.
struct Text<'a> {
    lines: Lines<'a>,
    words: SplitWhitespace<'a>,
    line: u32,
}

impl<'a> Text<'a> {
    fn of(text: &'a str) -> Self {
        Self {
            lines: text.trim_start_matches('\u{feff}').lines(),
            words: "".split_whitespace(),
            line: 0,
        }
    }

    const fn wrong(&self, defect: BvhDefect) -> BvhError {
        BvhError {
            line: self.line,
            defect,
        }
    }

    /// The next word, of this line or a later one.
    fn word(&mut self, expected: &str) -> Result<&'a str, BvhError> {
        loop {
            if let Some(word) = self.words.next() {
                return Ok(word);
            }
            let Some(line) = self.lines.next() else {
                let before = expected.to_owned();
                return Err(self.wrong(BvhDefect::Ends { before }));
            };
            self.words = line.split_whitespace();
            self.line += 1;
        }
    }

    /// The next word, which has to be this one.
    fn is(&mut self, expected: &'static str) -> Result<(), BvhError> {
        let found = self.word(expected)?;
        if found.eq_ignore_ascii_case(expected) {
            return Ok(());
        }
        let found = found.to_owned();
        Err(self.wrong(BvhDefect::Word { found, expected }))
    }

    fn number(&mut self, of: &str) -> Result<f64, BvhError> {
        let text = self.word(of)?;
        self.finite(of, text)
    }

    fn finite(&self, of: &str, text: &str) -> Result<f64, BvhError> {
        let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
        number.ok_or_else(|| {
            let (of, text) = (of.to_owned(), text.to_owned());
            self.wrong(BvhDefect::Number { of, text })
        })
    }

    fn count(&self, of: &'static str, stated: &str) -> Result<usize, BvhError> {
        let count = stated.parse::<u32>().map(|count| count as usize);
        count.map_err(|_| {
            let text = stated.to_owned();
            self.wrong(BvhDefect::Count { of, text })
        })
    }

    /// A name up to a bracket or the end of the line, and true for a bracket: names of some programs have spaces.
    fn name(&mut self) -> (String, bool) {
        let mut words = Vec::new();
        for word in self.words.by_ref() {
            if let Some(front) = word.strip_suffix('{') {
                words.extend(Some(front).filter(|front| !front.is_empty()));
                return (words.join(" "), true);
            }
            words.push(word);
        }
        (words.join(" "), false)
    }

    /// The next line that is not empty; false at the end.
    fn next_line(&mut self) -> bool {
        for line in self.lines.by_ref() {
            self.line += 1;
            self.words = line.split_whitespace();
            if self.words.clone().next().is_some() {
                return true;
            }
        }
        false
    }
}

/// A channel of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Channel {
    /// Along an axis.
    Position(usize),
    /// About an axis, degrees.
    Rotation(usize),
}

/// A joint with channels.
#[derive(Clone, Debug)]
struct Joint {
    name: String,
    /// The nearest joint above that has channels.
    parent: Option<usize>,
    /// From there, in the file's unit.
    offset: DVec3,
    channels: Vec<Channel>,
    /// The column of its first channel.
    first: usize,
}

/// A joint or an end that is not closed yet.
struct Open {
    name: String,
    /// The nearest joint with channels at it or above.
    joint: Option<usize>,
    /// From there.
    offset: DVec3,
    has_offset: bool,
}

/// The joints with channels; those above come first.
#[derive(Clone, Debug, Default)]
pub(super) struct Skeleton {
    joints: Vec<Joint>,
    columns: usize,
}

impl Skeleton {
    fn read(text: &mut Text<'_>) -> Result<Self, BvhError> {
        const EXPECTED: &str = "ROOT, JOINT, End Site, OFFSET, CHANNELS, a bracket or MOTION";
        let mut skeleton = Self::default();
        let mut open: Vec<Open> = Vec::new();
        text.is(FIRST)?;
        loop {
            let word = text.word("MOTION")?;
            let upper = word.to_ascii_uppercase();
            match (upper.as_str(), open.last_mut()) {
                ("ROOT", None) | ("JOINT", Some(_)) | ("END", Some(_)) => {
                    open.push(Self::opened(text, open.last())?);
                }
                ("OFFSET", Some(last)) => {
                    let [x, y, z] =
                        ["x of OFFSET", "y of OFFSET", "z of OFFSET"].map(|of| text.number(of));
                    last.offset += DVec3::new(x?, y?, z?);
                    last.has_offset = true;
                }
                ("CHANNELS", Some(last)) => skeleton.add(text, last)?,
                ("}", Some(_)) => {
                    let closed = open.pop();
                    if let Some(closed) = closed.filter(|closed| !closed.has_offset) {
                        let joint = closed.name;
                        return Err(text.wrong(BvhDefect::NoOffset { joint }));
                    }
                }
                ("MOTION", None) if skeleton.columns > 0 => return Ok(skeleton),
                ("MOTION", None) => return Err(text.wrong(BvhDefect::NoChannels)),
                _ => {
                    let (found, expected) = (word.to_owned(), EXPECTED);
                    return Err(text.wrong(BvhDefect::Word { found, expected }));
                }
            }
        }
    }

    /// A joint or an end below another.
    fn opened(text: &mut Text<'_>, above: Option<&Open>) -> Result<Open, BvhError> {
        let (name, is_open) = text.name();
        if !is_open {
            text.is("{")?;
        }
        Ok(Open {
            name,
            joint: above.and_then(|above| above.joint),
            offset: above.map_or(DVec3::ZERO, |above| above.offset),
            has_offset: false,
        })
    }

    /// Reads the channels of a joint.
    fn add(&mut self, text: &mut Text<'_>, open: &mut Open) -> Result<(), BvhError> {
        let stated = text.word("the number of CHANNELS")?;
        let count = text.count("the number of CHANNELS", stated)?;
        let mut channels = Vec::new();
        for _ in 0..count {
            let word = text.word("a channel")?;
            let known = CHANNELS
                .iter()
                .find(|(name, _)| name.eq_ignore_ascii_case(word));
            let Some((name, channel)) = known else {
                let (found, expected) = (word.to_owned(), "a channel such as Xrotation");
                return Err(text.wrong(BvhDefect::Word { found, expected }));
            };
            // A turn about an axis may come twice, as in zxz; of two positions one would be lost.
            let is_position = matches!(channel, Channel::Position(_));
            if is_position && channels.contains(channel) {
                let (joint, channel) = (open.name.clone(), *name);
                return Err(text.wrong(BvhDefect::ChannelTwice { joint, channel }));
            }
            channels.push(*channel);
        }
        if count == 0 {
            return Ok(());
        }
        if !open.has_offset {
            let joint = open.name.clone();
            return Err(text.wrong(BvhDefect::NoOffset { joint }));
        }
        self.joints.push(Joint {
            name: open.name.clone(),
            parent: open.joint,
            offset: std::mem::take(&mut open.offset),
            first: self.columns,
            channels,
        });
        self.columns += count;
        open.joint = Some(self.joints.len() - 1);
        Ok(())
    }

    /// The names of the joints.
    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.joints.iter().map(|joint| joint.name.as_str())
    }

    /// How the positions of each joint are read, and a sentence where programs differ.
    pub(super) fn readings(
        &self,
        stated: Option<PositionChannels>,
        first: Option<&Row>,
    ) -> (Vec<PositionChannels>, Vec<String>) {
        let mut named: Vec<(PositionChannels, Vec<&str>)> = Vec::new();
        let mut readings = Vec::with_capacity(self.joints.len());
        for joint in &self.joints {
            let values = first.map_or(&[][..], |row| row.values.as_slice());
            let reading = stated.unwrap_or_else(|| joint.likely(values));
            // The root has no offset in most files: then both readings are one.
            let is_ignored = reading == PositionChannels::Ignore && joint.parent.is_some();
            if joint.has_position() && (joint.offset != DVec3::ZERO || is_ignored) {
                match named.iter_mut().find(|(of, _)| *of == reading) {
                    Some((_, names)) => names.push(&joint.name),
                    None => named.push((reading, vec![&joint.name])),
                }
            }
            readings.push(reading);
        }
        let sentence = |(reading, names): (PositionChannels, Vec<&str>)| {
            let how = match reading {
                PositionChannels::Replace => "replace the OFFSET",
                PositionChannels::Add => "are added to the OFFSET",
                PositionChannels::Ignore => "are left out below the root",
            };
            let more = match names.len() {
                1 => String::new(),
                count => format!(" and {} more", count - 1),
            };
            format!(
                "position channels {how} of {}{more} (--bvh-positions)",
                names[0]
            )
        };
        let sentences = named.into_iter().map(sentence).collect();
        (readings, sentences)
    }

    /// Position and rotation of each joint in a row, in the file's unit.
    pub(super) fn worlds(&self, row: &[f64], readings: &[PositionChannels]) -> Vec<(DVec3, DQuat)> {
        let mut worlds: Vec<(DVec3, DQuat)> = Vec::with_capacity(self.joints.len());
        for (joint, reading) in self.joints.iter().zip(readings) {
            let (offset, turn) = joint.local(row, *reading);
            let above = joint.parent.map(|parent| worlds[parent]);
            let (position, rotation) = above.unwrap_or((DVec3::ZERO, DQuat::IDENTITY));
            worlds.push((position + rotation * offset, (rotation * turn).normalize()));
        }
        worlds
    }
}

impl Joint {
    fn has_position(&self) -> bool {
        let is_position = |channel: &Channel| matches!(channel, Channel::Position(_));
        self.channels.iter().any(is_position)
    }

    /// The position of a row; along axes without a channel that of `rest`.
    fn position(&self, row: &[f64], rest: DVec3) -> DVec3 {
        let mut position = rest;
        for (channel, value) in self.channels.iter().zip(&row[self.first..]) {
            if let Channel::Position(axis) = channel {
                position[*axis] = *value;
            }
        }
        position
    }

    /// The reading by which the joint is nearer to its offset in a row.
    fn likely(&self, row: &[f64]) -> PositionChannels {
        if row.is_empty() {
            return PositionChannels::Replace;
        }
        let replaced = self.position(row, self.offset) - self.offset;
        let added = self.position(row, DVec3::ZERO);
        match replaced.length() <= added.length() {
            true => PositionChannels::Replace,
            false => PositionChannels::Add,
        }
    }

    /// Offset and turn from the joint above, in a row.
    fn local(&self, row: &[f64], reading: PositionChannels) -> (DVec3, DQuat) {
        let offset = match (reading, self.parent) {
            (PositionChannels::Add, _) => self.offset + self.position(row, DVec3::ZERO),
            (PositionChannels::Ignore, Some(_)) => self.offset,
            (PositionChannels::Replace | PositionChannels::Ignore, _) => {
                self.position(row, self.offset)
            }
        };
        let mut turn = DQuat::IDENTITY;
        for (channel, value) in self.channels.iter().zip(&row[self.first..]) {
            if let Channel::Rotation(axis) = channel {
                let angle = (value % 360.0).to_radians();
                turn *= DQuat::from_axis_angle(DVec3::AXES[*axis], angle);
            }
        }
        (offset, turn)
    }
}

/// The numbers of a frame.
pub(super) struct Row {
    pub(super) line: u32,
    pub(super) values: Vec<f64>,
}

/// The frames.
pub(super) struct Motion {
    /// The frame time, seconds, as it is stated.
    pub(super) step_s: f64,
    pub(super) rows: Vec<Row>,
}

impl Motion {
    fn read(text: &mut Text<'_>, skeleton: &Skeleton) -> Result<Self, BvhError> {
        let stated = after_colon(text, "Frames")?;
        let frames = text.count("Frames", &stated)?;
        let stated = after_colon(text, "Frame Time")?;
        let step_s = text.finite("Frame Time", &stated)?;
        let mut rows = Vec::new();
        while text.next_line() {
            let found = rows.len() + 1;
            if found > frames {
                return Err(text.wrong(BvhDefect::Frames {
                    found,
                    stated: frames,
                }));
            }
            let words = text.words.clone();
            let found = words.clone().count();
            let expected = skeleton.columns;
            if found != expected {
                return Err(text.wrong(BvhDefect::Numbers { found, expected }));
            }
            let mut values = Vec::with_capacity(expected);
            for (column, word) in words.enumerate() {
                values.push(text.finite(&format!("number {} of the row", column + 1), word)?);
            }
            let line = text.line;
            rows.push(Row { line, values });
        }
        if rows.len() < frames {
            let (found, stated) = (rows.len(), frames);
            return Err(text.wrong(BvhDefect::Frames { found, stated }));
        }
        Ok(Self { step_s, rows })
    }
}

/// The text behind a title and its colon.
fn after_colon(text: &mut Text<'_>, title: &'static str) -> Result<String, BvhError> {
    let is_there = text.words.clone().next().is_some() || text.next_line();
    if !is_there {
        let before = title.to_owned();
        return Err(text.wrong(BvhDefect::Ends { before }));
    }
    let words: Vec<&str> = text.words.by_ref().collect();
    let line = words.join(" ");
    let (said, value) = line.split_once(':').unwrap_or((&line, ""));
    if !said.trim_end().eq_ignore_ascii_case(title) {
        let (found, expected) = (said.to_owned(), title);
        return Err(text.wrong(BvhDefect::Word { found, expected }));
    }
    Ok(value.trim().to_owned())
}
