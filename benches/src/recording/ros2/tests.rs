//! Messages and bags of ROS 2: read, written, and refused by name.

use std::collections::BTreeMap;
use std::io::Cursor;

use mcap::WriteOptions;
use mcap::records::MessageHeader;

use super::*;
use crate::recording::{ReadOptions, Recording, RecordingError, read_bytes};

/// Nanoseconds of milliseconds.
fn ns(at_ms: u32) -> u64 {
    u64::from(at_ms) * 1_000_000
}

/// A file of messages: topic, schema, log time in milliseconds, bytes.
fn file(messages: &[(&str, &str, u64, Vec<u8>)]) -> Vec<u8> {
    let options = WriteOptions::new().compression(None);
    let mut writer = options.create(Cursor::new(Vec::new())).expect("memory");
    for (sequence, (topic, schema, log_ms, data)) in (0..).zip(messages) {
        let schema = writer.add_schema(schema, "ros2msg", b"-").expect("memory");
        let channel = writer.add_channel(schema, topic, "cdr", &BTreeMap::new());
        let header = MessageHeader {
            channel_id: channel.expect("memory"),
            sequence,
            log_time: log_ms * 1_000_000,
            publish_time: log_ms * 1_000_000,
        };
        writer
            .write_to_known_channel(&header, data)
            .expect("memory");
    }
    writer.finish().expect("memory");
    writer.into_inner().into_inner()
}

fn read(messages: &[(&str, &str, u64, Vec<u8>)]) -> Result<Recording, RecordingError> {
    read_bytes("ros", &file(messages), &ReadOptions::default())
}

/// A moment of the clock at which recordings are made, milliseconds.
const NOW: u32 = 1_700_000_000;

#[test]
fn transforms_hang_on_moving_and_on_static_frames_by_the_time_of_their_headers() {
    let unturned = [0.0, 0.0, 0.0, 1.0];
    let at = |x: f64, z: f64| {
        [
            x,
            0.0,
            z,
            unturned[0],
            unturned[1],
            unturned[2],
            unturned[3],
        ]
    };
    let mut messages = vec![(
        "/tf_static",
        TRANSFORMS,
        5,
        CdrWriter::new()
            .u32(1)
            .transform(0, "base", "lidar", at(0.0, 0.5))
            .0,
    )];
    for frame in 0..20 {
        let bytes = CdrWriter::new().u32(1).transform(
            ns(NOW + 40 * frame),
            "odom",
            "base",
            at(0.1 * f64::from(frame), 0.0),
        );
        // Log times jitter by more than a frame.
        let log_ms = u64::from(NOW + 40 * frame + frame * 37 % 50);
        messages.push(("/tf", TRANSFORMS, log_ms, bytes.0));
    }
    let recording = read(&messages).expect("it is sound");
    assert_eq!(recording.integrator.rate.ticks(), 25);
    assert_eq!((recording.ticks(), recording.bodies()), (19, 2));
    let last = &recording.truth.ticks[18];
    let places: Vec<_> = last
        .iter()
        .map(|observed| observed.motion.position())
        .collect();
    assert_eq!(places.len(), 2);
    assert!(
        places.iter().all(|place| (place[0] - 1.9).abs() < 1e-6),
        "{places:?}"
    );
    assert!(
        places.iter().any(|place| (place[2] - 0.5).abs() < 1e-6),
        "{places:?}"
    );
}

#[test]
fn frames_of_rates_of_their_own_are_interpolated_where_that_is_asked_for() {
    let mut messages = Vec::new();
    for (step_ms, child, speed) in [(40, "base", 1.0), (50, "arm", 0.5)] {
        for frame in 0..30 {
            let x = f64::from(step_ms * frame) * 1e-3 * speed;
            let numbers = [x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
            let bytes = CdrWriter::new().u32(1);
            let bytes = bytes
                .transform(ns(NOW + step_ms * frame), "odom", child, numbers)
                .0;
            messages.push(("/tf", TRANSFORMS, u64::from(NOW + step_ms * frame), bytes));
        }
    }
    let error = read(&messages).expect_err("two rates").to_string();
    assert!(error.contains("--resample HZ interpolates"), "{error}");
    let options = ReadOptions {
        resample: rhumb_reckoning::Rate::new(20, 1),
        ..ReadOptions::default()
    };
    let recording = read_bytes("ros", &file(&messages), &options).expect("sound");
    let seventh: Vec<f32> = recording.truth.ticks[6]
        .iter()
        .map(|observed| observed.motion.position()[0])
        .collect();
    assert!(
        (seventh[0] - 0.35).abs() < 1e-6 && (seventh[1] - 0.175).abs() < 1e-6,
        "{seventh:?}"
    );
}

#[test]
fn a_simulated_time_begins_at_zero_and_a_lone_stamp_of_zero_is_static() {
    let at = |x: f64| [x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let message = |at_ms: u32, parent: &str, child: &str, x: f64| {
        let bytes = CdrWriter::new().u32(1);
        let bytes = bytes.transform(ns(at_ms), parent, child, at(x)).0;
        ("/tf", TRANSFORMS, u64::from(at_ms), bytes)
    };
    let moving = (0..20).map(|frame| message(frame * 100, "world", "box", f64::from(frame) * 0.1));
    let mut messages: Vec<_> = moving.collect();
    messages.push(message(0, "box", "lidar", 0.5));
    for resample in [None, rhumb_reckoning::Rate::new(10, 1)] {
        let options = ReadOptions {
            resample,
            ..ReadOptions::default()
        };
        let recording = read_bytes("ros", &file(&messages), &options).expect("sound");
        assert_eq!((recording.ticks(), recording.truth.placed.len()), (19, 2));
        let first = &recording.truth.placed[0];
        assert_eq!(first.tick.value(), 0);
        assert_eq!(first.observation.motion.position()[0], 0.0);
        let last: Vec<f32> = recording.truth.ticks[18]
            .iter()
            .map(|observed| observed.motion.position()[0])
            .collect();
        assert!(
            (last[0] - 1.9).abs() < 1e-6 && (last[1] - 2.4).abs() < 1e-6,
            "{last:?}"
        );
    }
}

#[test]
fn two_odometers_of_one_child_frame_are_two_bodies() {
    let message = |topic: &'static str, frame: u32, y: f64| {
        let writer = CdrWriter::new()
            .header(ns(NOW + 20 * frame), "odom")
            .text("base");
        let x = 0.02 * f64::from(frame);
        let writer = writer
            .f64s(&[x, y, 0.0, 0.0, 0.0, 0.0, 1.0])
            .f64s(&[0.0; 36]);
        let writer = writer
            .f64s(&[1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
            .f64s(&[0.0; 36]);
        (topic, ODOMETRY, u64::from(NOW + 20 * frame), writer.0)
    };
    let both = |frame| [message("/odom0", frame, 0.0), message("/odom1", frame, 1.0)];
    let messages: Vec<_> = (0..10).flat_map(both).collect();
    let recording = read(&messages).expect("two robots");
    let places = recording.truth.placed.iter();
    let places: Vec<f32> = places
        .map(|one| one.observation.motion.position()[1])
        .collect();
    assert_eq!(places, [0.0, 1.0]);
    let notes = recording.notes.join("\n");
    assert!(!notes.contains("frames"), "{notes}");
}

#[test]
fn static_transforms_that_change_are_said() {
    let map = |x: f64| {
        let bytes = CdrWriter::new().u32(1);
        bytes
            .transform(0, "world", "map", [x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
            .0
    };
    let moving = |frame: u32| {
        let numbers = [0.1 * f64::from(frame), 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        let bytes = CdrWriter::new().u32(1);
        let bytes = bytes
            .transform(ns(NOW + 40 * frame), "map", "base", numbers)
            .0;
        ("/tf", TRANSFORMS, u64::from(NOW + 40 * frame), bytes)
    };
    for (second, is_said) in [(5.0, false), (9.0, true)] {
        let mut messages: Vec<_> = (0..10).map(moving).collect();
        messages.insert(0, ("/tf_static", TRANSFORMS, 5, map(5.0)));
        messages.push(("/tf_static", TRANSFORMS, u64::from(NOW), map(second)));
        let notes = read(&messages).expect("sound").notes.join("\n");
        let said = notes.contains("1 frames change, such as that of map: the last one holds");
        assert_eq!(said, is_said, "{notes}");
    }
}

#[test]
fn the_twist_of_odometry_is_turned_into_the_frame_of_its_pose() {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let messages: Vec<_> = (0..10)
        .map(|frame| {
            let y = 0.02 * f64::from(frame);
            // Heading along y, driving at 1 m/s ahead.
            let writer = CdrWriter::new()
                .header(ns(NOW + 20 * frame), "odom")
                .text("base");
            let writer = writer
                .f64s(&[0.0, y, 0.0, 0.0, 0.0, half, half])
                .f64s(&[0.0; 36]);
            let writer = writer
                .f64s(&[1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
                .f64s(&[0.0; 36]);
            ("/odom", ODOMETRY, u64::from(NOW + 20 * frame), writer.0)
        })
        .collect();
    let recording = read(&messages).expect("it is sound");
    let velocity = recording.truth.placed[0]
        .observation
        .motion
        .motion()
        .twist()
        .linear;
    assert!((velocity - DVec3::Y).length() < 1e-6, "{velocity}");
    assert!(recording.notes.iter().all(|note| !note.contains("fitted")));
}

#[test]
fn wrong_messages_are_refused_with_topic_and_time() {
    let pose = |numbers: [f64; 7]| CdrWriter::new().header(ns(NOW), "map").f64s(&numbers).0;
    let good = pose([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    let cut = good[..good.len() - 9].to_vec();
    let mut old = good.clone();
    old[1] = 3;
    for (bytes, part) in [
        (
            pose([0.0; 7]),
            "the message of /goal at 2 s: the quaternion has length 0",
        ),
        (
            pose([f64::NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
            "the position is not finite or too large: 1e6 m from zero at most",
        ),
        (cut, "/goal at 2 s: byte"),
        (old, "/goal at 2 s: encoding 3 of CDR is not read"),
        (vec![0, 1], "/goal at 2 s: byte 0"),
    ] {
        let error = read(&[("/goal", POSE, 2_000, bytes)])
            .expect_err(part)
            .to_string();
        assert!(error.contains(part), "{error}");
    }
    let many = CdrWriter::new().u32(u32::MAX).0;
    let error = read(&[("/tf", TRANSFORMS, 0, many)])
        .expect_err("a claim")
        .to_string();
    assert!(
        error.contains("a sequence of 4294967295 elements"),
        "{error}"
    );
}

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
