//! Fuzzes the decoders of recordings with arbitrary bytes.
//!
//! Promises: an invalid recording is refused with a message, and memory stays proportional to its bytes. A valid
//! foreign recording contains the numbers of its bytes.

use std::collections::{BTreeMap, BTreeSet};

use rhumb_bench::recording::{
    ReadOptions, Recording, RecordingError, Velocities, mcap, read_bytes, rhtrace, write_rhtrace,
};
use rhumb_reckoning::{BodyId, Metres};

use super::script::Script;

/// The first byte selects the form of the rest: a file of any form, a message of ROS 2, a second version of a foreign
/// recording, a file of any form whose unit is stated, packed foreign recording, unpacked foreign recording, or trace.
pub fn recordings(data: &[u8]) {
    let Some((form, bytes)) = data.split_first() else {
        return;
    };
    match form {
        200 => return any(bytes, &ReadOptions::default()),
        201 => return any(&ros2(bytes), &ReadOptions::default()),
        202 => return any(&[b"RHTRACE2", bytes].concat(), &ReadOptions::default()),
        203 => {
            let unit = Some(Metres::new(0.01));
            let options = ReadOptions {
                unit,
                ..ReadOptions::default()
            };
            return any(bytes, &options);
        }
        _ => {}
    }
    match form % 4 {
        0 => drop(reported(rhtrace::read("fuzz", bytes))),
        1 => foreign(bytes),
        2 => foreign(&boxes(&mut Script::new(bytes))),
        _ => drop(reported(mcap::read("fuzz", bytes, &ReadOptions::default()))),
    }
}

/// A valid recording; formats the error of an invalid one.
fn reported<E: std::error::Error>(read: Result<Recording, E>) -> Option<Recording> {
    if let Err(error) = &read {
        assert!(!error.to_string().is_empty());
    }
    read.ok()
}

/// A file of any form; what is read is written, and read again as the same.
fn any(bytes: &[u8], options: &ReadOptions) {
    let read: Result<Recording, RecordingError> = read_bytes("fuzz", bytes, options);
    if let Some(recording) = reported(read) {
        let written = write_rhtrace(&recording).expect("few bodies");
        let again = read_bytes("fuzz", &written, options).expect("what is written is read");
        assert_eq!(again.truth.digest, recording.truth.digest);
        assert_eq!(again.integrator, recording.integrator);
        assert_eq!(stays(&again), stays(&recording));
    }
}

/// Tick and first state of each body, by index, and of its removal.
fn stays(recording: &Recording) -> Vec<(u64, Option<u64>, [f32; 13])> {
    let truth = &recording.truth;
    let removed: BTreeMap<BodyId, u64> = truth
        .removed
        .iter()
        .map(|(tick, id)| (*id, tick.value()))
        .collect();
    let mut stays: Vec<_> = truth.placed.iter().collect();
    stays.sort_by_key(|placed| (placed.desc.id.index(), placed.tick));
    let begins: BTreeSet<(u64, u32)> = stays
        .iter()
        .map(|placed| (placed.tick.value(), placed.desc.id.index()))
        .collect();
    let stays = stays.into_iter().map(|placed| {
        let (id, first) = (placed.desc.id, placed.tick.value());
        // Where another body of its index begins, the frame before is the last.
        let last = |gone: u64| match gone > first && begins.contains(&(gone, id.index())) {
            true => gone - 1,
            false => gone,
        };
        let gone = removed.get(&id).copied().map(last);
        (placed.tick.value(), gone, placed.observation.motion.parts())
    });
    stays.collect()
}

/// An MCAP file with one message, whose first byte chooses its schema.
fn ros2(bytes: &[u8]) -> Vec<u8> {
    const SCHEMAS: [&str; 3] = [
        "tf2_msgs/msg/TFMessage",
        "nav_msgs/msg/Odometry",
        "geometry_msgs/msg/PoseStamped",
    ];
    let (choice, message) = bytes.split_first().unwrap_or((&0, &[]));
    let schema = SCHEMAS[usize::from(*choice) % SCHEMAS.len()];
    let options = ::mcap::WriteOptions::new().compression(None);
    let mut writer = options
        .create(std::io::Cursor::new(Vec::new()))
        .expect("memory");
    let schema = writer.add_schema(schema, "ros2msg", b"-").expect("memory");
    let channel = writer.add_channel(schema, "/t", "cdr", &BTreeMap::new());
    let header = ::mcap::records::MessageHeader {
        channel_id: channel.expect("memory"),
        sequence: 0,
        log_time: 0,
        publish_time: 0,
    };
    writer
        .write_to_known_channel(&header, message)
        .expect("memory");
    writer.finish().expect("memory");
    writer.into_inner().into_inner()
}

/// A foreign recording before compression.
fn foreign(plain: &[u8]) {
    let packed = zstd::encode_all(plain, 1).expect("compressing bytes");
    let read = reported(rhtrace::read("fuzz", &packed));
    // Velocities that are fitted are not those of the bytes.
    let is_own = |recording: &Recording| recording.velocities == Velocities::Recorded;
    if let Some(recording) = read.filter(is_own) {
        assert_eq!(
            written(&recording, plain),
            plain,
            "a recording has one encoding"
        );
    }
}

/// A foreign recording that is valid except for some numbers.
fn boxes(script: &mut Script<'_>) -> Vec<u8> {
    let bodies = 1 + script.below(3) as u16;
    let frames = 1 + script.below(5) as u32;
    let mut bytes = rhtrace::MAGIC.to_vec();
    bytes.extend(u32::from(bodies).to_le_bytes());
    bytes.extend(frames.to_le_bytes());
    let mut put = |numbers: &[f32]| bytes.extend(numbers.iter().flat_map(|n| n.to_le_bytes()));
    put(&[1.0 / 60.0, 0.0, script.number(10.0), 0.0]);
    for _ in 0..bodies {
        let half = script.sane_vector(1.0).abs() + 0.1;
        put(&half.to_array());
        put(&[half.as_dvec3().length() as f32]);
    }
    for frame in 0..frames {
        let row: Vec<u16> = (0..bodies).filter(|_| frame == 0 || script.any()).collect();
        bytes.extend((row.len() as u16).to_le_bytes());
        for body in row {
            bytes.extend(body.to_le_bytes());
            let mut put =
                |numbers: &[f32]| bytes.extend(numbers.iter().flat_map(|n| n.to_le_bytes()));
            put(&script.vector(10.0).to_array());
            put(&script.rotation().to_array());
            put(&script.vector(10.0).to_array());
            put(&script.vector(10.0).to_array());
            bytes.push(script.any());
        }
    }
    bytes
}

/// The bytes of a recording; what it does not keep is copied from the original bytes: its step, its flags, and the shapes
/// of bodies without a record.
fn written(recording: &Recording, from: &[u8]) -> Vec<u8> {
    let truth = &recording.truth;
    let mut to = rhtrace::MAGIC.to_vec();
    to.extend_from_slice(&from[to.len()..to.len() + 4]);
    to.extend((truth.ticks.len() as u32 + 1).to_le_bytes());
    to.extend_from_slice(&from[to.len()..to.len() + 4]);
    put(&mut to, &recording.gravity.to_array());
    let bodies = u32::from_le_bytes([from[8], from[9], from[10], from[11]]);
    let shapes: BTreeMap<u32, _> = truth
        .placed
        .iter()
        .map(|placed| (placed.desc.id.index(), &placed.shape))
        .collect();
    for body in 0..bodies {
        if let Some(rhumb_protocol::scene::Shape::Cuboid { half_extents }) = shapes.get(&body) {
            put(&mut to, &half_extents.to_array());
        } else {
            to.extend_from_slice(&from[to.len()..to.len() + 12]);
        }
        to.extend_from_slice(&from[to.len()..to.len() + 4]);
    }
    for frame in 0..=truth.ticks.len() {
        let placed = truth.placed.iter();
        let placed = placed.filter(|placed| placed.tick.value() == frame as u64);
        let mut row: Vec<_> = placed.map(|placed| placed.observation).collect();
        if let Some(before) = frame.checked_sub(1) {
            row.extend(&truth.ticks[before]);
        }
        row.sort_by_key(|observation| observation.id.index());
        to.extend((row.len() as u16).to_le_bytes());
        for observation in row {
            to.extend((observation.id.index() as u16).to_le_bytes());
            put(&mut to, &observation.motion.parts());
            to.push(from[to.len()]);
        }
    }
    to
}

fn put(to: &mut Vec<u8>, numbers: &[f32]) {
    to.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
}
