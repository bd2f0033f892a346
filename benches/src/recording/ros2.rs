//! Poses of bodies in messages of ROS 2, read and written as a bag; CDR.
//!
//! Time is that of the header, not that of the log. A static transform is no motion: it hangs a frame on another one for
//! the whole recording. The twist of odometry is in the frame of its child, and is turned into that of the pose.
//!
//! CDR is XCDR1 and XCDR2, in either byte order. Bytes behind a message are ignored, as writers pad them. Memory stays
//! within the bytes that are there, whatever a count claims.
//!
//! A bag is MCAP with `/clock`, `/tf` and `/tf_static`. Frames are called `body_` and the body's index, and hang on `world`.
//! Every body that is there has a transform at every tick, so that a buffer of tf knows it at any moment. Fixed bodies are
//! static transforms. Moments begin at one second: a stamp of zero means "the latest" to tf.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Seek, Write};

use glam::{DQuat, DVec3};
use mcap::records::{MessageHeader, Metadata};
use mcap::{McapError, WriteOptions};
use rhumb_protocol::scene::BodyKind;
use rhumb_reckoning::{BodyId, BodyState, Tick};

use super::error::{Place, RowDefect};
use super::poses::{TimedPose, TimedPoses, TooManyBodies};
use super::recorded::Recording;
use crate::record::{Change, Changes};
use crate::recording::error::CdrError;

/// The schema of transforms.
pub(super) const TRANSFORMS: &str = "tf2_msgs/msg/TFMessage";
/// The schema of odometry.
pub(super) const ODOMETRY: &str = "nav_msgs/msg/Odometry";
/// The schema of a pose with a stamp.
pub(super) const POSE: &str = "geometry_msgs/msg/PoseStamped";

/// Least bytes of a transform: its header, two empty texts, seven numbers.
const TRANSFORM_BYTES: usize = 72;

/// A reason why a message is not taken.
pub(super) enum Refusal {
    Cdr(CdrError),
    Row(RowDefect),
    Bodies(TooManyBodies),
}

impl From<CdrError> for Refusal {
    fn from(cause: CdrError) -> Self {
        Self::Cdr(cause)
    }
}

impl From<TooManyBodies> for Refusal {
    fn from(cause: TooManyBodies) -> Self {
        Self::Bodies(cause)
    }
}

/// A transform of a frame that is above.
struct Hung {
    parent: String,
    stamped: Stamped,
    place: Place,
}

/// Transforms that may be static, by the frames that they place.
#[derive(Default)]
pub(super) struct Statics {
    /// The last one of each frame on a topic of static ones.
    latched: BTreeMap<String, Hung>,
    /// Those of stamp zero on other topics, which are the first ones of a simulated time if their frames have others.
    zeros: BTreeMap<String, Vec<Hung>>,
    /// Frames whose latched transforms change.
    changed: BTreeSet<String>,
    /// The topic of each child frame of odometry.
    odometers: BTreeMap<String, String>,
}

impl Statics {
    fn latch(&mut self, child: &str, hung: Hung) {
        let said = |hung: &Hung| (hung.stamped.position, hung.stamped.rotation);
        let now = said(&hung);
        let before = self.latched.insert(child.to_owned(), hung);
        if before.is_some_and(|before| said(&before) != now) {
            self.changed.insert(child.to_owned());
        }
    }

    /// The name of the body of an odometer: its child frame, and its topic if another one has that frame.
    fn odometer(&mut self, topic: &str, child: &str) -> String {
        if child.is_empty() {
            return topic.to_owned();
        }
        let first = self.odometers.entry(child.to_owned());
        let first = first.or_insert_with(|| topic.to_owned());
        if first == topic {
            child.to_owned()
        } else {
            format!("{child} of {topic}")
        }
    }

    /// Adds the poses of static ones at the beginning of the others.
    pub(super) fn add_to(mut self, poses: &mut TimedPoses) -> Result<(), Refusal> {
        for (child, mut hung) in self.zeros {
            if poses.known(&child).is_none() {
                let last = hung.pop().map(|last| (child, last));
                self.latched.extend(last);
                continue;
            }
            for Hung {
                parent,
                stamped,
                place,
            } in hung
            {
                let body = of_parent(poses, &child, &parent)?;
                push(poses, body, stamped, None, &place);
            }
        }
        if let Some(frame) = self.changed.first() {
            poses.left_out.push(format!(
                "static transforms of {} frames change, such as that of {frame}: the last one holds throughout",
                self.changed.len()
            ));
        }
        let first = poses.poses.iter().map(|pose| pose.at_ns).min();
        for (child, hung) in self.latched {
            let Hung {
                parent,
                stamped,
                place,
            } = hung;
            let body = of_parent(poses, &child, &parent)?;
            poses.poses.push(TimedPose {
                at_ns: first.unwrap_or_default(),
                body,
                position: stamped.position,
                rotation: stamped.rotation,
                velocity: None,
                place,
            });
        }
        Ok(())
    }
}

/// A pose and its moment.
struct Stamped {
    at_ns: i64,
    position: DVec3,
    rotation: DQuat,
}

/// Takes the poses of a message.
pub(super) fn take(
    schema: &str,
    bytes: &[u8],
    place: &Place,
    topic: &str,
    (poses, statics): (&mut TimedPoses, &mut Statics),
) -> Result<(), Refusal> {
    let mut cdr = Cdr::new(bytes)?;
    match schema {
        TRANSFORMS => {
            for _ in 0..cdr.count(TRANSFORM_BYTES)? {
                let (at_ns, parent) = header(&mut cdr)?;
                let child = cdr.text()?;
                let stamped = pose(&mut cdr, at_ns)?;
                let is_latched = topic.ends_with("tf_static");
                if is_latched || at_ns == 0 {
                    let parent = parent.to_owned();
                    let place = place.clone();
                    let hung = Hung {
                        parent,
                        stamped,
                        place,
                    };
                    if is_latched {
                        statics.latch(child, hung);
                    } else {
                        statics
                            .zeros
                            .entry(child.to_owned())
                            .or_default()
                            .push(hung);
                    }
                    continue;
                }
                let body = of_parent(poses, child, parent)?;
                push(poses, body, stamped, None, place);
            }
        }
        POSE => {
            let (at_ns, frame) = header(&mut cdr)?;
            poses.of_frame(frame);
            let body = poses.body(topic, None)?;
            let stamped = pose(&mut cdr, at_ns)?;
            push(poses, body, stamped, None, place);
        }
        _ => {
            let (at_ns, frame) = header(&mut cdr)?;
            poses.of_frame(frame);
            let child = cdr.text()?;
            let stamped = pose(&mut cdr, at_ns)?;
            cdr.f64s::<36>()?;
            let (linear, angular) = (cdr.f64s::<3>()?, cdr.f64s::<3>()?);
            let body = poses.body(&statics.odometer(topic, child), None)?;
            let turn = stamped.rotation;
            let velocity = [linear, angular].map(|vector| turn * DVec3::from_array(vector));
            push(poses, body, stamped, Some(velocity), place);
        }
    }
    Ok(())
}

/// The moment, nanoseconds, and the frame of a header.
fn header<'a>(cdr: &mut Cdr<'a>) -> Result<(i64, &'a str), CdrError> {
    let (seconds, nanoseconds) = (cdr.i32()?, cdr.u32()?);
    let at_ns = i64::from(seconds) * 1_000_000_000 + i64::from(nanoseconds);
    Ok((at_ns, cdr.text()?))
}

fn pose(cdr: &mut Cdr<'_>, at_ns: i64) -> Result<Stamped, CdrError> {
    let position = DVec3::from_array(cdr.f64s()?);
    let rotation = DQuat::from_array(cdr.f64s()?);
    Ok(Stamped {
        at_ns,
        position,
        rotation,
    })
}

/// The number of a frame, which hangs on the same one as before.
fn of_parent(poses: &mut TimedPoses, child: &str, parent: &str) -> Result<usize, Refusal> {
    let body = poses.body(child, Some(parent))?;
    if poses.bodies[body].parent.as_deref() == Some(parent) {
        Ok(body)
    } else {
        let frame = child.to_owned();
        Err(Refusal::Row(RowDefect::Parent { frame }))
    }
}

fn push(
    poses: &mut TimedPoses,
    body: usize,
    stamped: Stamped,
    velocity: Option<[DVec3; 2]>,
    place: &Place,
) {
    poses.poses.push(TimedPose {
        at_ns: stamped.at_ns,
        body,
        position: stamped.position,
        rotation: stamped.rotation,
        velocity,
        place: place.clone(),
    });
}

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
            _ => {
                let number = u16::from_be_bytes([*zero, *number]);
                return Err(CdrError::Encoding { number });
            }
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

    fn f64s<const COUNT: usize>(&mut self) -> Result<[f64; COUNT], CdrError> {
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

/// The schema of the simulated time.
const CLOCK: &str = "rosgraph_msgs/msg/Clock";
/// The frame of the world.
const WORLD: &str = "world";
/// The first moment, nanoseconds.
const BEGIN_NS: u64 = 1_000_000_000;
/// The definition of a transform, with those of its parts, as bags hold them.
const TRANSFORMS_TEXT: &str = "\
geometry_msgs/TransformStamped[] transforms
================================================================================
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/Transform
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
";
/// The definition of the time.
const CLOCK_TEXT: &str = "\
builtin_interfaces/Time clock
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
";
/// The quality of service of a topic whose last message late subscribers get, as bags hold it.
///
/// rosbag2 reads nine keys of a profile, and opens no bag that lacks one. Numbers are those of rmw: keep last, reliable,
/// transient local, automatic; a duration is the endless one. Source: `convert<Rosbag2QoS>::decode` in
/// rosbag2_storage/src/rosbag2_storage/qos.cpp of ros2/rosbag2 at 01f25dd.
const LATCHED: &str = "\
- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
";
/// A record of this name without metadata of the bag says that policies are numbers, which every version reads; without
/// the record newer ones expect words. Source: `MCAPStorage::read_metadata` in
/// rosbag2_storage_mcap/src/mcap_storage.cpp of ros2/rosbag2 at 0286032.
const OF_BAG: (&str, &str) = ("rosbag2", "serialized_metadata");

/// Writes a bag.
///
/// # Errors
///
/// [`McapError`] when the file cannot be written.
pub fn write_bag(recording: &Recording, to: impl Write + Seek) -> Result<(), McapError> {
    let options = WriteOptions::new().profile("ros2").library("rhumb");
    let mut writer = options.create(to)?;
    let transforms = writer.add_schema(TRANSFORMS, "ros2msg", TRANSFORMS_TEXT.as_bytes())?;
    let clock = writer.add_schema(CLOCK, "ros2msg", CLOCK_TEXT.as_bytes())?;
    let latched = BTreeMap::from([("offered_qos_profiles".to_owned(), LATCHED.to_owned())]);
    let none = BTreeMap::new();
    let clock = writer.add_channel(clock, "/clock", "cdr", &none)?;
    let moving = writer.add_channel(transforms, "/tf", "cdr", &none)?;
    let truth = &recording.truth;
    let mut kinds = truth.placed.iter().map(|one| one.desc.kind);
    let fixed = match kinds.any(|kind| kind == BodyKind::Fixed) {
        true => Some(writer.add_channel(transforms, "/tf_static", "cdr", &latched)?),
        false => None,
    };
    let (name, key) = OF_BAG;
    writer.write_metadata(&Metadata {
        name: name.to_owned(),
        metadata: BTreeMap::from([(key.to_owned(), String::new())]),
    })?;
    let mut put = |channel_id, sequence, at_ns, message: &CdrWriter| {
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time: at_ns,
            publish_time: at_ns,
        };
        writer.write_to_known_channel(&header, &message.0)
    };
    let rate = recording.integrator.rate;
    let mut changes = truth.changes();
    let mut there: BTreeMap<BodyId, BodyState> = BTreeMap::new();
    let mut still: BTreeMap<BodyId, BodyState> = BTreeMap::new();
    for frame in 0..=truth.ticks.len() {
        let row = frame
            .checked_sub(1)
            .map_or(&[][..], |row| &truth.ticks[row]);
        for observation in row {
            there.insert(observation.id, observation.motion);
        }
        let number = frame as u64;
        let begun = still.len();
        let gone = change(&mut changes, number, [&mut there, &mut still]);
        let ns = u128::from(number) * u128::from(rate.seconds()) * 1_000_000_000;
        let at_ns = BEGIN_NS + (ns / u128::from(rate.ticks())) as u64;
        let sequence = frame as u32;
        put(clock, sequence, at_ns, &CdrWriter::new().time(at_ns))?;
        if let Some(fixed) = fixed.filter(|_| still.len() > begun) {
            put(fixed, sequence, at_ns, &message(&still, at_ns))?;
        }
        put(moving, sequence, at_ns, &message(&there, at_ns))?;
        there.retain(|id, _| !gone.contains(id));
    }
    writer.finish()?;
    Ok(())
}

/// Places bodies at a frame, and returns those that go: they are there in that frame.
fn change(
    changes: &mut Changes<'_>,
    frame: u64,
    [there, still]: [&mut BTreeMap<BodyId, BodyState>; 2],
) -> BTreeSet<BodyId> {
    let mut gone = BTreeSet::new();
    while let Some(change) = changes.until(Tick::new(frame)) {
        match change {
            Change::Placed(_, one) => {
                let id = one.desc.id;
                gone.remove(&id);
                let to = match one.desc.kind {
                    BodyKind::Fixed => &mut *still,
                    _ => &mut *there,
                };
                to.insert(id, one.observation.motion);
            }
            Change::Removed(id) => {
                gone.insert(id);
            }
        }
    }
    gone
}

/// The transforms of these bodies.
fn message(bodies: &BTreeMap<BodyId, BodyState>, at_ns: u64) -> CdrWriter {
    let start = CdrWriter::new().u32(bodies.len() as u32);
    bodies.iter().fold(start, |message, (id, state)| {
        let [px, py, pz, x, y, z, w, ..] = state.parts().map(f64::from);
        message.transform(at_ns, WORLD, &name(*id), [px, py, pz, x, y, z, w])
    })
}

/// The frame of a body.
fn name(id: BodyId) -> String {
    match id.generation() {
        0 => format!("body_{}", id.index()),
        generation => format!("body_{}_{generation}", id.index()),
    }
}

/// Writes fields of XCDR1 in little-endian order.
pub(super) struct CdrWriter(pub(super) Vec<u8>);

impl CdrWriter {
    pub(super) fn new() -> Self {
        Self(vec![0, 1, 0, 0])
    }

    fn put(mut self, align: usize, bytes: &[u8]) -> Self {
        while !(self.0.len() - 4).is_multiple_of(align) {
            self.0.push(0);
        }
        self.0.extend_from_slice(bytes);
        self
    }

    pub(super) fn u32(self, number: u32) -> Self {
        self.put(4, &number.to_le_bytes())
    }

    pub(super) fn f64s(self, numbers: &[f64]) -> Self {
        numbers
            .iter()
            .fold(self, |to, number| to.put(8, &number.to_le_bytes()))
    }

    pub(super) fn text(self, text: &str) -> Self {
        let bytes = [text.as_bytes(), &[0]].concat();
        self.u32(bytes.len() as u32).put(1, &bytes)
    }

    fn time(self, at_ns: u64) -> Self {
        let second = 1_000_000_000;
        self.u32((at_ns / second) as u32)
            .u32((at_ns % second) as u32)
    }

    pub(super) fn header(self, at_ns: u64, frame: &str) -> Self {
        self.time(at_ns).text(frame)
    }

    pub(super) fn transform(
        self,
        at_ns: u64,
        parent: &str,
        child: &str,
        numbers: [f64; 7],
    ) -> Self {
        self.header(at_ns, parent).text(child).f64s(&numbers)
    }
}

#[cfg(test)]
mod tests;
