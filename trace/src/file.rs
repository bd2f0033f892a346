//! MCAP files: written, with the facts of a scene, and read, of any writer.
//!
//! Compression runs on the caller's thread, so equal messages give equal bytes on any machine. The first message of a
//! topic declares it: a topic without messages is not in the file. The facts are the engine's parameters of
//! predictions, kept as metadata, so that a reader needs no script and no server.
//!
//! Reading needs no summary, no index and no end: a file is read from its beginning, and one that ends too early gives
//! everything before that. Chunks may be in any order; messages come in the order of their log times.
//!
//! [`read_states`] reads the states of a tick from a message of a trace; `messages` defines its fields. Poses on a grid come
//! without velocities.

use std::collections::BTreeMap;
use std::fmt;
use std::io::{Seek, Write};
use std::num::NonZeroU32;
use std::str::FromStr;

use glam::Vec3;
use mcap::records::{MessageHeader, Metadata, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::write::NoSeek;
use mcap::{Compression, MAGIC, McapError, WriteOptions, Writer};
use prost::Message as _;
use rhumb_protocol::limits::{EXTENT_MAX, EXTENT_MIN};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Hull, SceneConfig, Shape, ShapeId};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{
    BodyId, BodyState, Damping, Inertia, Integrator, Rate, Tick, ToleranceScale,
};

use crate::drawing::Placed;
use crate::messages::{GridHistory, Placement, STEPS, States};
use crate::topics::{Schema, Topic, TraceSink};

/// An MCAP file that is being written.
pub struct TraceFile<W: Write + Seek> {
    writer: Writer<W>,
    buffer: Vec<u8>,
}

/// Options of every file: zstd on the caller's thread, with indexes and checksums.
fn options(library: &str) -> WriteOptions {
    WriteOptions::new()
        .compression(Some(Compression::Zstd))
        .compression_threads(0)
        .library(library)
}

impl<W: Write> TraceFile<NoSeek<W>> {
    /// Begins a file that only grows: after a crash it can be read up to the last chunk that was finished.
    ///
    /// # Errors
    ///
    /// [`McapError`] if the sink cannot be written.
    pub fn growing(to: W, library: &str) -> Result<Self, McapError> {
        let options = options(library).disable_seeking(true);
        Ok(Self {
            writer: options.create(NoSeek::new(to))?,
            buffer: Vec::new(),
        })
    }
}

impl<W: Write + Seek> TraceFile<W> {
    /// Begins a file; `library` names the program that writes it.
    ///
    /// # Errors
    ///
    /// [`McapError`] if the sink cannot be written.
    pub fn new(to: W, library: &str) -> Result<Self, McapError> {
        Ok(Self {
            writer: options(library).create(to)?,
            buffer: Vec::new(),
        })
    }

    /// Writes a metadata record.
    ///
    /// # Errors
    ///
    /// [`McapError`] if the sink cannot be written.
    pub fn put_metadata(
        &mut self,
        name: String,
        metadata: BTreeMap<String, String>,
    ) -> Result<(), McapError> {
        self.writer.write_metadata(&Metadata { name, metadata })
    }

    /// Ends the present chunk. A reader then finds all messages so far, even if nothing follows.
    ///
    /// # Errors
    ///
    /// [`McapError`] if the sink cannot be written.
    pub fn flush(&mut self) -> Result<(), McapError> {
        self.writer.flush()
    }

    /// Writes the indexes and closes the file.
    ///
    /// # Errors
    ///
    /// [`McapError`] if the sink cannot be written.
    pub fn finish(mut self) -> Result<W, McapError> {
        self.writer.finish()?;
        Ok(self.writer.into_inner())
    }

    fn declare(&mut self, schema: Schema, topic: &str) -> Result<u16, McapError> {
        let mut metadata = BTreeMap::new();
        if matches!(schema, Schema::Wire(_)) {
            metadata.insert("protocol".to_owned(), "rhumb/1".to_owned());
        }
        let schema = schema.message_schema();
        let schema = (self.writer).add_schema(&schema.name, &schema.encoding, &schema.data)?;
        self.writer
            .add_channel(schema, topic, "protobuf", &metadata)
    }
}

impl<W: Write + Seek> TraceSink for TraceFile<W> {
    type Error = McapError;

    /// Writes a message with log and publish time `at_ns`.
    fn put(
        &mut self,
        topic: &mut Topic,
        at_ns: u64,
        message: &impl prost::Message,
    ) -> Result<(), McapError> {
        let channel_id = match topic.channel {
            Some(channel) => channel,
            None => *topic
                .channel
                .insert(self.declare(topic.schema, &topic.name)?),
        };
        self.buffer.clear();
        message
            .encode(&mut self.buffer)
            .expect("a vector grows as needed");
        let header = MessageHeader {
            channel_id,
            sequence: topic.sequence,
            log_time: at_ns,
            publish_time: at_ns,
        };
        topic.sequence += 1;
        self.writer.write_to_known_channel(&header, &self.buffer)
    }
}

/// The log time of a tick, nanoseconds: the tick times the step, rounded to the nearest, from zero at tick 0.
///
/// This is the one rule of all traces and recordings, and of what is shown live.
#[must_use]
pub fn log_time_ns(rate: Rate, tick: u64) -> u64 {
    let (ticks, seconds) = (u128::from(rate.ticks()), u128::from(rate.seconds()));
    let ns = (u128::from(tick) * seconds * 1_000_000_000 + ticks / 2) / ticks;
    u64::try_from(ns).unwrap_or(u64::MAX)
}

/// The parameters of an engine that predictions need.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneFacts {
    /// Rate and substeps.
    pub integrator: Integrator,
    /// Gravity, m/s², world frame.
    pub gravity: Vec3,
    /// Damping of bodies without one of their own.
    pub damping: Damping,
}

impl SceneFacts {
    /// The facts of a scene's config.
    #[must_use]
    pub const fn of(config: &SceneConfig) -> Self {
        Self {
            integrator: config.integrator,
            gravity: config.gravity,
            damping: config.damping,
        }
    }

    /// The values of a metadata record.
    #[must_use]
    pub fn to_metadata(&self) -> BTreeMap<String, String> {
        let Integrator { rate, substeps } = self.integrator;
        let Vec3 { x, y, z } = self.gravity;
        let Damping { linear, angular } = self.damping;
        [
            ("rate", format!("{}/{}", rate.ticks(), rate.seconds())),
            ("step_s", rate.step().seconds().to_string()),
            ("substeps", substeps.to_string()),
            ("gravity", format!("{x} {y} {z}")),
            ("damping", format!("{linear} {angular}")),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into()
    }

    /// The facts of a metadata record; `None` if it lacks one of them, as those of earlier versions do.
    #[must_use]
    pub fn of_metadata(record: &BTreeMap<String, String>) -> Option<Self> {
        let (ticks, seconds) = record.get("rate")?.split_once('/')?;
        let [x, y, z] = numbers(record.get("gravity")?)?;
        let [linear, angular] = numbers(record.get("damping")?)?;
        let damped = [linear, angular].iter().all(|damping| *damping >= 0.0);
        let substeps: NonZeroU32 = record.get("substeps")?.parse().ok()?;
        damped.then_some(Self {
            integrator: Integrator {
                rate: Rate::new(ticks.parse().ok()?, seconds.parse().ok()?)?,
                substeps,
            },
            gravity: Vec3::new(x, y, z),
            damping: Damping { linear, angular },
        })
    }
}

/// Parses `COUNT` finite numbers with spaces between them.
fn numbers<const COUNT: usize>(text: &str) -> Option<[f32; COUNT]> {
    let numbers: Vec<f32> = text
        .split_whitespace()
        .map(f32::from_str)
        .collect::<Result<_, _>>()
        .ok()?;
    let finite = numbers.iter().all(|number| number.is_finite());
    numbers.try_into().ok().filter(|_| finite)
}

/// Longest accepted record. A damaged file may state any length and must not cause an allocation of that size.
const RECORD_BYTES_MAX: usize = 64 << 20;

/// The whole messages of a file that a reader wants, and its metadata.
#[derive(Clone, Debug, Default)]
pub struct FileContents {
    /// The channels, by their ids in the file.
    pub channels: BTreeMap<u16, StoredChannel>,
    /// The wanted messages by log time; those of equal times as in the file.
    pub messages: Vec<StoredMessage>,
    /// Names and values of the metadata records, as in the file.
    pub metadata: Vec<(String, BTreeMap<String, String>)>,
    /// The end of the file.
    pub end: FileEnd,
    /// Whole messages of all channels.
    pub message_count: u64,
    /// The greatest log time of them, nanoseconds.
    pub last_ns: u64,
}

/// The end of a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FileEnd {
    /// The file ends with its footer.
    #[default]
    Whole,
    /// The footer is missing: the file is still written, its writing was interrupted, or it was cut.
    Early,
}

/// A channel of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoredChannel {
    /// Its topic.
    pub topic: String,
    /// The name of its schema; empty without one.
    pub schema: String,
    /// The encoding of its messages, such as `protobuf`.
    pub encoding: String,
}

/// A message of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoredMessage {
    /// The id of its channel.
    pub channel: u16,
    /// Its log time, nanoseconds.
    pub log_ns: u64,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

/// Reason why a file is not read.
#[derive(Debug)]
pub enum ContentsError {
    /// The file does not begin as an MCAP file.
    NotMcap,
    /// It ends within its first chunk, so that nothing of it is whole.
    CutAtOnce {
        /// Its length.
        bytes: usize,
    },
    /// A record is damaged.
    Damaged {
        /// Number of whole messages before the defect.
        after: u64,
        /// The defect.
        cause: Box<McapError>,
    },
}

impl fmt::Display for ContentsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotMcap => f.write_str("this is no MCAP file: it does not begin as one"),
            Self::CutAtOnce { bytes } => write!(
                f,
                "the MCAP file ends after {bytes} bytes, within its first chunk: no message of it is whole"
            ),
            Self::Damaged { after, cause } => {
                write!(
                    f,
                    "the MCAP file is damaged behind its first {after} messages: {cause}"
                )
            }
        }
    }
}

impl std::error::Error for ContentsError {}

impl FileContents {
    /// Reads a file; of its messages those on channels that `wants` accepts.
    ///
    /// # Errors
    ///
    /// [`ContentsError`] for a file that is no MCAP file, or has a damaged record. One that ends early is no error.
    pub fn read(
        bytes: &[u8],
        wants: &dyn Fn(&StoredChannel) -> bool,
    ) -> Result<Self, ContentsError> {
        if !bytes.starts_with(MAGIC) {
            return Err(ContentsError::NotMcap);
        }
        let mut contents = Self {
            end: FileEnd::Early,
            ..Self::default()
        };
        let mut parts = Parts {
            contents: &mut contents,
            schemas: BTreeMap::new(),
            wanted: BTreeMap::new(),
            wants,
        };
        match parts.take_all(bytes) {
            Ok(()) => {}
            Err(McapError::UnexpectedEof) => contents.end = FileEnd::Early,
            Err(cause) => {
                return Err(ContentsError::Damaged {
                    after: contents.message_count,
                    cause: Box::new(cause),
                });
            }
        }
        contents.messages.sort_by_key(|message| message.log_ns);
        Ok(contents)
    }

    /// Refuses a file that ends within its first chunk: what it has is not known. `bytes`: its length.
    ///
    /// # Errors
    ///
    /// [`ContentsError::CutAtOnce`].
    pub fn check_begun(&self, bytes: usize) -> Result<(), ContentsError> {
        match self.end {
            FileEnd::Early if self.channels.is_empty() => Err(ContentsError::CutAtOnce { bytes }),
            _ => Ok(()),
        }
    }

    /// A sentence on a file that ends early: how much of it is whole. `None` for a whole file.
    #[must_use]
    pub fn note(&self) -> Option<String> {
        match self.end {
            FileEnd::Whole => None,
            FileEnd::Early => Some(format!(
                "the file has no end: its {} whole messages are used, up to {} s of log time",
                self.message_count,
                self.last_ns as f64 / 1e9
            )),
        }
    }

    /// The topic of a message.
    #[must_use]
    pub fn topic(&self, message: &StoredMessage) -> &str {
        let channel = self.channels.get(&message.channel);
        channel.map_or("", |channel| &channel.topic)
    }
}

/// A file while it is read.
struct Parts<'a> {
    contents: &'a mut FileContents,
    schemas: BTreeMap<u16, String>,
    wanted: BTreeMap<u16, bool>,
    wants: &'a dyn Fn(&StoredChannel) -> bool,
}

impl Parts<'_> {
    fn take_all(&mut self, bytes: &[u8]) -> Result<(), McapError> {
        let options = LinearReaderOptions::default()
            .with_skip_end_magic(true)
            .with_validate_chunk_crcs(true)
            .with_record_length_limit(RECORD_BYTES_MAX);
        let mut reader = LinearReader::new_with_options(options);
        let mut rest = bytes;
        while let Some(event) = reader.next_event() {
            match event? {
                LinearReadEvent::ReadRequest(wanted) => {
                    let (read, after) = rest.split_at(wanted.min(rest.len()));
                    reader.insert(read.len()).copy_from_slice(read);
                    reader.notify_read(read.len());
                    rest = after;
                }
                LinearReadEvent::Record { opcode, data } => self.take(opcode, data)?,
            }
        }
        Ok(())
    }

    fn take(&mut self, opcode: u8, data: &[u8]) -> Result<(), McapError> {
        // Others say nothing of the messages.
        let kinds = [
            op::SCHEMA,
            op::CHANNEL,
            op::MESSAGE,
            op::METADATA,
            op::FOOTER,
        ];
        if !kinds.contains(&opcode) {
            return Ok(());
        }
        match mcap::parse_record(opcode, data)? {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id);
                let stored = StoredChannel {
                    schema: schema.cloned().unwrap_or_default(),
                    topic: channel.topic,
                    encoding: channel.message_encoding,
                };
                self.declare(channel.id, stored)?;
            }
            Record::Message { header, data } => {
                let wanted = self.wanted.get(&header.channel_id);
                let unknown = || McapError::UnknownChannel(header.sequence, header.channel_id);
                let is_wanted = *wanted.ok_or_else(unknown)?;
                let contents = &mut *self.contents;
                contents.message_count += 1;
                contents.last_ns = contents.last_ns.max(header.log_time);
                if is_wanted {
                    contents.messages.push(StoredMessage {
                        channel: header.channel_id,
                        log_ns: header.log_time,
                        bytes: data.into_owned(),
                    });
                }
            }
            Record::Metadata(metadata) => {
                let contents = &mut self.contents;
                contents.metadata.push((metadata.name, metadata.metadata));
            }
            Record::Footer(_) => self.contents.end = FileEnd::Whole,
            _ => {}
        }
        Ok(())
    }

    /// A channel may be declared again, in a later chunk or in the summary, but not otherwise than before.
    fn declare(&mut self, id: u16, stored: StoredChannel) -> Result<(), McapError> {
        let known = self.contents.channels.get(&id);
        if known.is_some_and(|known| *known != stored) {
            return Err(McapError::ConflictingChannels(stored.topic));
        }
        self.wanted.insert(id, (self.wants)(&stored));
        self.contents.channels.insert(id, stored);
        Ok(())
    }
}

/// The contents of one message of the topic `truth/state`.
#[derive(Clone, Debug)]
pub struct TickStates {
    /// The tick.
    pub tick: Tick,
    /// Observations after its step.
    pub observed: Vec<Observation>,
    /// Bodies placed after its step.
    pub placed: Vec<Placed>,
    /// Bodies that were removed in its step or after it, with the tick.
    pub removed: Vec<(Tick, BodyId)>,
    /// True if the observations are exact; otherwise they are poses on the grid, whose velocities stand at zero.
    pub is_exact: bool,
}

/// Reads the messages of a topic `truth/state`, in order.
#[derive(Clone, Debug, Default)]
pub struct StatesReader(GridHistory);

impl StatesReader {
    /// Decodes the next message. `None` if a motion, shape, kind or id in it is invalid.
    ///
    /// # Errors
    ///
    /// [`prost::DecodeError`] if the bytes are not such a message.
    pub fn read(&mut self, bytes: &[u8]) -> Result<Option<TickStates>, prost::DecodeError> {
        let states = States::decode(bytes)?;
        Ok(parse(&states, &mut self.0))
    }
}

/// Decodes one message of exact states. `None` if a motion, shape, kind or id in it is invalid.
///
/// # Errors
///
/// [`prost::DecodeError`] if the bytes are not such a message.
pub fn read_states(bytes: &[u8]) -> Result<Option<TickStates>, prost::DecodeError> {
    StatesReader::default().read(bytes)
}

fn parse(states: &States, history: &mut GridHistory) -> Option<TickStates> {
    let tick = Tick::new(states.tick);
    let is_on_grid = !states.step_px.is_empty();
    let is_exact = !is_on_grid && states.vx.len() == states.px.len();
    let observed = (0..states.index.len()).map(|place| match is_on_grid {
        true => grid_observation(states, place, history),
        false => observation(states, place, history),
    });
    let placed = states
        .placed
        .iter()
        .map(|placement| placed(tick, placement));
    let removed = states.removed_index.iter().zip(&states.removed_generation);
    let removed = removed.map(|(index, generation)| Some((tick, id(*index, *generation)?)));
    Some(TickStates {
        tick,
        observed: observed.collect::<Option<_>>()?,
        placed: placed.collect::<Option<_>>()?,
        removed: removed.collect::<Option<_>>()?,
        is_exact,
    })
}

fn id(index: u32, generation: u32) -> Option<BodyId> {
    Some(BodyId::new(index, u16::try_from(generation).ok()?))
}

/// An observation on the grid: a pose at rest.
fn grid_observation(
    states: &States,
    place: usize,
    history: &mut GridHistory,
) -> Option<Observation> {
    let columns = [
        &states.step_px,
        &states.step_py,
        &states.step_pz,
        &states.step_qx,
        &states.step_qy,
        &states.step_qz,
        &states.step_qw,
    ];
    let mut residual = [0; 7];
    for (part, column) in residual.iter_mut().zip(columns) {
        *part = *column.get(place)?;
    }
    let id = id(*states.index.get(place)?, *states.generation.get(place)?)?;
    let pose = history.decode(id, residual);
    let mut parts = [0.0; 13];
    for (part, steps) in parts.iter_mut().zip(pose) {
        *part = (steps as f64 / STEPS) as f32;
    }
    Some(Observation {
        id,
        motion: motion(&parts)?,
        activity: activity(*states.awake.get(place)?),
    })
}

/// An exact observation, which begins the history of its body anew. A topic on the grid has exact poses where one is too
/// far out; they have no velocities.
fn observation(states: &States, place: usize, history: &mut GridHistory) -> Option<Observation> {
    let columns = [
        &states.px, &states.py, &states.pz, &states.qx, &states.qy, &states.qz, &states.qw,
        &states.vx, &states.vy, &states.vz, &states.wx, &states.wy, &states.wz,
    ];
    let mut parts = [0.0; 13];
    let has_velocities = !states.vx.is_empty();
    for (number, (part, column)) in parts.iter_mut().zip(columns).enumerate() {
        if number < 7 || has_velocities {
            *part = *column.get(place)?;
        }
    }
    let index = *states.index.get(place)?;
    let generation = *states.generation.get(place)?;
    let id = id(index, generation)?;
    history.forget(id);
    Some(Observation {
        id,
        motion: motion(&parts)?,
        activity: activity(*states.awake.get(place)?),
    })
}

const fn activity(awake: bool) -> Activity {
    if awake {
        Activity::Awake
    } else {
        Activity::Asleep
    }
}

fn motion(parts: &[f32]) -> Option<BodyState> {
    let [px, py, pz, qx, qy, qz, qw, vx, vy, vz, wx, wy, wz] = *parts.first_chunk::<13>()?;
    BodyState::new([px, py, pz], [qx, qy, qz, qw], [vx, vy, vz], [wx, wy, wz]).ok()
}

fn placed(tick: Tick, placement: &Placement) -> Option<Placed> {
    let id = id(placement.index, placement.generation)?;
    let kind = match placement.kind {
        1 => BodyKind::Fixed,
        2 => BodyKind::Dynamic,
        3 => BodyKind::Kinematic,
        _ => return None,
    };
    let shape = shape(placement)?;
    shape.check().ok()?;
    let tolerance_scale = i8::try_from(placement.tolerance_scale)
        .ok()
        .and_then(ToleranceScale::new)?;
    Some(Placed {
        tick,
        desc: BodyDesc {
            tolerance_scale,
            damping: damping(&placement.damping)?,
            gravity_scale: placement.gravity_scale.unwrap_or(1.0),
            ..BodyDesc::plain(id, kind, ShapeId(0))
        },
        shape,
        inertia: inertia(&placement.inertia)?,
        observation: Observation {
            id,
            motion: motion(&placement.motion)?,
            activity: activity(placement.awake),
        },
    })
}

/// The damping of a body; `Some(None)` where it is the scene's.
fn damping(numbers: &[f32]) -> Option<Option<Damping>> {
    match *numbers {
        [] => Some(None),
        [linear, angular] if linear >= 0.0 && angular >= 0.0 => {
            Some(Some(Damping { linear, angular }))
        }
        _ => None,
    }
}

/// The inertia of a body; `Some(None)` where it is not stated.
fn inertia(numbers: &[f32]) -> Option<Option<Inertia>> {
    match *numbers {
        [] => Some(None),
        [a, b, c, x, y, z, w] => Inertia::new([a, b, c], [x, y, z, w]).ok().map(Some),
        _ => None,
    }
}

fn shape(placement: &Placement) -> Option<Shape> {
    let extents = placement.extents.as_slice();
    Some(match (placement.shape, extents) {
        // Height fields, meshes and compounds have no measures: a ball has their bounding radius, which is all that an
        // error needs.
        (0, &[]) => {
            let radius = placement.bounding_radius_m as f32;
            // NaN is none.
            let is_radius = radius > 0.0;
            is_radius.then_some(Shape::Ball {
                radius: radius.clamp(EXTENT_MIN, EXTENT_MAX),
            })?
        }
        (1, &[radius]) => Shape::Ball { radius },
        (2, &[x, y, z]) => Shape::Cuboid {
            half_extents: Vec3::new(x, y, z),
        },
        (3, &[half_height, radius]) => Shape::Capsule {
            half_height,
            radius,
        },
        (4, &[half_height, radius]) => Shape::Cylinder {
            half_height,
            radius,
        },
        (5, points) => {
            let points: Vec<_> = points.chunks_exact(3).map(Vec3::from_slice).collect();
            Shape::Hull(Hull::new(&points).ok()?)
        }
        (6, &[x, y, z, radius]) => Shape::RoundedCuboid {
            half_extents: Vec3::new(x, y, z),
            radius,
        },
        (7, &[half_height, radius]) => Shape::Cone {
            half_height,
            radius,
        },
        (8, &[x, y, z]) => Shape::HalfSpace {
            normal: Vec3::new(x, y, z),
        },
        _ => return None,
    })
}

#[cfg(test)]
mod tests;
