//! A recording as a bag of ROS 2: MCAP with `/clock`, `/tf` and `/tf_static`.
//!
//! Frames are called `body_` and the body's index, and hang on `world`. Every body that is there has a transform at every
//! tick, so that a buffer of tf knows it at any moment. Fixed bodies are static transforms. Moments begin at one second: a
//! stamp of zero means "the latest" to tf.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use mcap::records::{MessageHeader, Metadata};
use mcap::{McapError, WriteOptions};
use rhumb_protocol::scene::BodyKind;
use rhumb_reckoning::{BodyId, BodyState};

use super::recorded::Recording;
use super::ros2::TRANSFORMS;

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
    let (mut placed, mut removed) = (
        truth.placed.iter().peekable(),
        truth.removed.iter().peekable(),
    );
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
        while let Some(one) = placed.next_if(|one| one.tick.value() <= number) {
            match one.desc.kind {
                BodyKind::Fixed => still.insert(one.desc.id, one.observation.motion),
                _ => there.insert(one.desc.id, one.observation.motion),
            };
        }
        let ns = u128::from(number) * u128::from(rate.seconds()) * 1_000_000_000;
        let at_ns = BEGIN_NS + (ns / u128::from(rate.ticks())) as u64;
        let sequence = frame as u32;
        put(clock, sequence, at_ns, &CdrWriter::new().time(at_ns))?;
        if let Some(fixed) = fixed.filter(|_| still.len() > begun) {
            put(fixed, sequence, at_ns, &message(&still, at_ns))?;
        }
        put(moving, sequence, at_ns, &message(&there, at_ns))?;
        while let Some((_, id)) = removed.next_if(|(tick, _)| tick.value() <= number) {
            there.remove(id);
        }
    }
    writer.finish()?;
    Ok(())
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
mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::recording::{ReadOptions, read_bytes};

    /// One body that is there throughout, one from 0.1 s to 0.3 s, and a fixed one.
    fn recording() -> Recording {
        let mut text = "time,body,x,y,z,qx,qy,qz,qw\n0,wall,9,9,9,0,0,0,1\n".to_owned();
        for frame in 0..60 {
            let (t, x) = (f64::from(frame) / 100.0, f64::from(frame) * 0.01);
            text += &format!("{t},a,{x},1,2,0,0,0.6,0.8\n");
            if (10..=30).contains(&frame) {
                text += &format!("{t},b,{x},5,0,0,0,0,1\n");
            }
        }
        read_bytes("r", text.as_bytes(), &ReadOptions::default()).expect("sound")
    }

    #[test]
    fn a_bag_is_read_again_with_the_same_poses_at_the_same_rate() {
        let recording = recording();
        let mut file = Cursor::new(Vec::new());
        write_bag(&recording, &mut file).expect("memory");
        let bytes = file.into_inner();
        let again = read_bytes("r", &bytes, &ReadOptions::default()).expect("a bag");
        assert_eq!(again.integrator.rate, recording.integrator.rate);
        assert_eq!((again.ticks(), again.truth.placed.len()), (59, 3));
        let stays = |of: &Recording| {
            let placed = of
                .truth
                .placed
                .iter()
                .map(|one| (one.tick.value(), one.desc.kind));
            let mut placed: Vec<_> = placed.collect();
            placed.sort_unstable_by_key(|(tick, kind)| (*tick, format!("{kind:?}")));
            let removed: Vec<u64> = of
                .truth
                .removed
                .iter()
                .map(|(tick, _)| tick.value())
                .collect();
            (placed, removed)
        };
        assert_eq!(stays(&again), stays(&recording));
        let poses = |of: &Recording| -> Vec<([f32; 3], [f32; 4])> {
            let rows = of.truth.ticks.iter().flatten();
            let mut poses: Vec<_> = rows
                .map(|one| (one.motion.position(), one.motion.rotation()))
                .collect();
            poses.sort_by_key(|pose| format!("{pose:?}"));
            poses
        };
        assert_eq!(poses(&again), poses(&recording));
    }

    /// The keys of a text of YAML, each with those that it is in, and its value.
    fn entries(text: &str) -> Vec<(String, String)> {
        let mut above: Vec<(usize, &str)> = Vec::new();
        let mut entries = Vec::new();
        for line in text.lines() {
            // An element of a list is two deeper than its mark.
            let inner = line.trim_start_matches([' ', '-']);
            let (key, value) = inner.split_once(':').expect("a key");
            above.retain(|(depth, _)| *depth < line.len() - inner.len());
            above.push((line.len() - inner.len(), key));
            let keys: Vec<&str> = above.iter().map(|(_, key)| *key).collect();
            entries.push((keys.join("."), value.trim().to_owned()));
        }
        entries
    }

    /// Keys and numbers as rosbag2 reads them: `convert<Rosbag2QoS>::decode` and `convert<rmw_time_t>::decode` in qos.cpp of
    /// ros2/rosbag2 at 01f25dd, with the policies of rmw.
    #[test]
    fn a_latched_topic_has_each_key_that_rosbag2_reads() {
        let endless = ["9223372036", "854775807"];
        let expected = [
            ("history", "1"),
            ("depth", "1"),
            ("reliability", "1"),
            ("durability", "1"),
            ("deadline", ""),
            ("deadline.sec", endless[0]),
            ("deadline.nsec", endless[1]),
            ("lifespan", ""),
            ("lifespan.sec", endless[0]),
            ("lifespan.nsec", endless[1]),
            ("liveliness", "1"),
            ("liveliness_lease_duration", ""),
            ("liveliness_lease_duration.sec", endless[0]),
            ("liveliness_lease_duration.nsec", endless[1]),
            ("avoid_ros_namespace_conventions", "false"),
        ];
        let expected = expected.map(|(key, value)| (key.to_owned(), value.to_owned()));
        let mut file = Cursor::new(Vec::new());
        write_bag(&recording(), &mut file).expect("memory");
        let bytes = file.into_inner();
        let summary = mcap::Summary::read(&bytes).expect("sound").expect("one");
        let channels = summary.channels.values();
        let profiles = channels.filter_map(|channel| {
            let profile = channel.metadata.get("offered_qos_profiles")?;
            Some((channel.topic.as_str(), entries(profile)))
        });
        let profiles: Vec<_> = profiles.collect();
        assert_eq!(profiles, [("/tf_static", expected.to_vec())]);
        let records = summary.metadata_indexes.iter().map(|of| of.name.as_str());
        assert_eq!(records.collect::<Vec<_>>(), ["rosbag2"]);
    }

    #[test]
    fn a_bag_without_fixed_bodies_has_no_topic_for_them() {
        let text = "time,body,x,y,z,qx,qy,qz,qw\n0,a,0,0,0,0,0,0,1\n1,a,1,0,0,0,0,0,1\n";
        let recording = read_bytes("r", text.as_bytes(), &ReadOptions::default()).expect("sound");
        let mut file = Cursor::new(Vec::new());
        write_bag(&recording, &mut file).expect("memory");
        let bytes = file.into_inner();
        let summary = mcap::Summary::read(&bytes).expect("sound").expect("one");
        let topics = summary
            .channels
            .values()
            .map(|channel| channel.topic.as_str());
        let mut topics: Vec<_> = topics.collect();
        topics.sort_unstable();
        assert_eq!(topics, ["/clock", "/tf"]);
    }

    #[test]
    fn a_message_is_the_bytes_that_ros_writes() {
        let message = CdrWriter::new().u32(1).transform(
            1_500_000_000,
            "w",
            "b",
            [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        );
        let [zero, one] = [0.0_f64, 1.0].map(f64::to_le_bytes);
        // Encapsulation, count, seconds, nanoseconds, "w", padding, "b", padding to eight, numbers.
        let mut expected = vec![0, 1, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0];
        expected.extend(500_000_000_u32.to_le_bytes());
        expected.extend([2, 0, 0, 0, b'w', 0, 0, 0, 2, 0, 0, 0, b'b', 0]);
        expected.resize(36, 0);
        for number in [one, zero, zero, zero, zero, zero, one] {
            expected.extend(number);
        }
        assert_eq!(message.0, expected);
    }
}
