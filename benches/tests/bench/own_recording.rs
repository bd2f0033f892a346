//! Motion that other programs recorded is read, or refused with its place.
//!
//! The same motion is written in every form: two bodies that swing and turn, as a function of time.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::num::NonZeroU32;

use foxglove::Encode;
use foxglove::messages::{
    FrameTransform, FrameTransforms, Pose, PosesInFrame, Quaternion, Timestamp, Vector3,
};
use glam::{DQuat, DVec3, Vec3};
use mcap::WriteOptions;
use mcap::records::MessageHeader;
use prost::Message;
use rhumb_bench::record::{Experiment, Load, Run};
use rhumb_bench::recording::{
    MissingPoses, ReadOptions, Recording, RecordingError, read, write_bag, write_rhtrace,
};
use rhumb_bench::replay::{EnabledFeatures, ReplayConfig, run};
use rhumb_bench::trace::{TraceOptions, write};
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::scene::{BodyDesc, BodyKind, SceneConfig, Shape, ShapeId};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, BodyState, Metres, Rate, Tick, Ticks, Tolerance};
use rhumb_trace::{Placed, SceneFacts, SceneTopics, StateForm, States, TraceFile, log_time_ns};

/// Pose of a body at a time, seconds.
fn pose(body: u32, t: f64) -> (DVec3, DQuat) {
    let at = DVec3::new(
        (t + f64::from(body)).sin(),
        1.0 + 0.2 * (3.0 * t).cos(),
        2.0 * f64::from(body),
    );
    (at, DQuat::from_rotation_y(t))
}

/// Reads a file of these bytes.
fn reading(name: &str, bytes: &[u8], options: &ReadOptions) -> Result<Recording, RecordingError> {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("own-recording");
    std::fs::create_dir_all(&folder).expect("a folder");
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("a file");
    read(&path, options)
}

pub(crate) fn plain(name: &str, bytes: &[u8]) -> Recording {
    reading(name, bytes, &ReadOptions::default()).expect("it is a recording")
}

/// The sentence with which a text is refused.
fn refused(name: &str, bytes: &[u8]) -> String {
    let refused = reading(name, bytes, &ReadOptions::default());
    refused.expect_err("it is no recording").to_string()
}

/// Every pose of a recording is that of the motion, and its velocities are those of the motion but for rounding.
pub(crate) fn compare(recording: &Recording, hertz: f64, frames: usize) {
    assert_eq!(recording.ticks() as usize, frames - 1);
    assert_eq!(recording.truth.placed.len(), 2);
    let rate = recording.integrator.rate;
    let found = f64::from(rate.ticks()) / f64::from(rate.seconds());
    assert!((found / hertz - 1.0).abs() < 1e-6, "{found}");
    for (frame, row) in (1..).zip(&recording.truth.ticks) {
        assert_eq!(row.len(), 2, "{frame}");
        for observation in row {
            let t = f64::from(frame) / hertz;
            let (at, turned) = pose(observation.id.index(), t);
            let parts = observation.motion.parts().map(f64::from);
            let [x, y, z, qx, qy, qz, qw, vx, vy, vz, wx, wy, wz] = parts;
            assert!((DVec3::new(x, y, z) - at).length() < 1e-5, "{frame}");
            let alike = DQuat::from_xyzw(qx, qy, qz, qw).dot(turned).abs();
            assert!((alike - 1.0).abs() < 1e-6, "{frame}");
            let linear = DVec3::new(
                (t + f64::from(observation.id.index())).cos(),
                -0.6 * (3.0 * t).sin(),
                0.0,
            );
            let off = (DVec3::new(vx, vy, vz) - linear).length();
            assert!(off < 0.03, "{frame}: {off}");
            let off = (DVec3::new(wx, wy, wz) - DVec3::Y).length();
            assert!(off < 0.01, "{frame}: {off}");
        }
    }
    keeps_its_tolerance(recording);
}

pub(crate) fn keeps_its_tolerance(recording: &Recording) {
    assert_eq!(replayed(recording).breaches, []);
}

/// A replay within 20 mm.
fn replayed(recording: &Recording) -> Run {
    let config = ReplayConfig {
        tolerance: Tolerance::from_metres(Metres::new(0.02)).expect("within bounds"),
        link: "".parse().expect("a perfect link"),
        publish_interval: NonZeroU32::MIN,
        seed: 1,
        lookahead: Ticks::ZERO,
        budget: None,
        largest_packet: LargestPacket::DEFAULT,
        features: EnabledFeatures::ALL,
    };
    run(recording, &config, &mut |_| {}).expect("it is replayed")
}

/// Rows of both bodies, with the columns in this order.
fn rows(columns: &str, separator: &str, hertz: f64, frames: u32) -> String {
    let mut text = columns.replace(' ', separator) + "\n";
    for frame in 0..frames {
        for body in 0..2 {
            let t = f64::from(frame) / hertz;
            let (at, turned) = pose(body, t);
            let value = |column: &str| match column {
                "time" => format!("{t}"),
                "body" => format!("box {body}").replace(' ', "_"),
                "x" => at.x.to_string(),
                "y" => at.y.to_string(),
                "z" => at.z.to_string(),
                "qx" => turned.x.to_string(),
                "qy" => turned.y.to_string(),
                "qz" => turned.z.to_string(),
                "qw" => turned.w.to_string(),
                _ => "0".to_owned(),
            };
            let values: Vec<_> = columns.split(' ').map(value).collect();
            text += &values.join(separator);
            text += "\n";
        }
    }
    text
}

const COLUMNS: &str = "time body x y z qx qy qz qw";

#[test]
fn rows_are_read_in_any_order_of_columns_between_any_marks_at_any_constant_rate() {
    for (number, hertz) in [60.0, 29.97, 119.88, 100.0, 30_000.0 / 1_001.0]
        .into_iter()
        .enumerate()
    {
        let text = rows(COLUMNS, ",", hertz, 90);
        compare(
            &plain(&format!("rate-{number}.csv"), text.as_bytes()),
            hertz,
            90,
        );
    }
    for (number, separator) in [";", "\t", " "].into_iter().enumerate() {
        let text = format!(
            "# of a camera\n\n{}",
            rows("qw qx qy qz time x y z body seen", separator, 60.0, 90)
        );
        compare(
            &plain(&format!("marks-{number}.txt"), text.as_bytes()),
            60.0,
            90,
        );
    }
    // One body after the other.
    let text = rows(COLUMNS, ",", 60.0, 90);
    let (head, body) = text.split_once('\n').expect("a header");
    let mut lines: Vec<&str> = body.lines().collect();
    lines.sort_by_key(|line| line.contains("box_1"));
    compare(
        &plain(
            "sorted.csv",
            format!("{head}\n{}", lines.join("\n")).as_bytes(),
        ),
        60.0,
        90,
    );
}

#[test]
fn a_file_without_a_header_has_nine_columns_or_the_eight_of_one_body() {
    let text = rows(COLUMNS, ",", 60.0, 90);
    let (_, nine) = text.split_once('\n').expect("a header");
    compare(&plain("nine.csv", nine.as_bytes()), 60.0, 90);
    let eight: String = (0..90)
        .map(|frame| {
            format!(
                "{} {} 0 0 0 0 0 1\n",
                1_700_000_000.0 + f64::from(frame) / 100.0,
                frame
            )
        })
        .collect();
    let one = plain("eight.tum", eight.as_bytes());
    assert_eq!((one.truth.placed.len(), one.ticks()), (1, 89));
    assert_eq!(one.integrator.rate, Rate::new(100, 1).expect("a rate"));
}

#[test]
fn a_wrong_row_is_named_by_its_line_and_column() {
    let whole = rows(COLUMNS, ",", 60.0, 20);
    let line = |number: usize, with: &str| {
        let mut lines: Vec<&str> = whole.lines().collect();
        lines[number - 1] = with;
        lines.join("\n")
    };
    let half = &whole[..whole.len() - 30];
    for (number, (text, words)) in [
        (
            line(5, "0.03,box_1,0,0,0,0,0,0"),
            "line 5: has 8 fields, and there are 9 columns",
        ),
        (
            line(6, "0.03,box_1,0,x,0,0,0,0,1"),
            "line 6: column y: \"x\" is no number",
        ),
        (
            line(7, "0.05,box_1,NaN,0,0,0,0,0,1"),
            "line 7: the position is not finite",
        ),
        (
            line(7, "0.05,box_1,1e30,0,0,0,0,0,1"),
            "line 7: the position is not finite or too large",
        ),
        (
            line(7, "inf,box_1,0,0,0,0,0,0,1"),
            "line 7: the time is not finite",
        ),
        (
            line(8, "0.05,box_0,0,0,0,0,0,0,0"),
            "line 8: the quaternion has length 0, not 1",
        ),
        (
            line(8, "0.05,box_0,0,0,0,1,1,0,0"),
            "line 8: the quaternion has length 1.41",
        ),
        (
            line(8, "0.0333,box_0,0,0,0,0,0,0,1"),
            "has a pose of this frame already, by line",
        ),
        (
            line(9, "0.0575,box_1,0,0,0,0,0,0,1"),
            "the times keep no constant rate: line 9 lies 4",
        ),
        (
            line(1, "time,body,x,y,z,qx,qy,qz"),
            "line 1 is neither a row of numbers nor a header: it does not name qw",
        ),
        (half.to_owned(), "has "),
        (
            "time,body,x,y,z,qx,qy,qz,qw\n".to_owned(),
            "needs two frames",
        ),
        (
            "Dear all,\n".to_owned(),
            "it does not name time, x, y, z, qx, qy, qz, qw",
        ),
    ]
    .into_iter()
    .enumerate()
    {
        let said = refused(&format!("wrong-{number}.csv"), text.as_bytes());
        assert!(said.contains(words), "{words}: {said}");
    }
}

#[test]
fn a_body_comes_with_its_first_pose_and_goes_in_a_long_gap() {
    let whole = rows(COLUMNS, ",", 60.0, 90);
    // Lines of body 1: it comes at frame 10, lacks frames 20 to 22 and 40 to 49, and goes after frame 79.
    let is_there = |(number, line): &(usize, &str)| {
        let frame = number.saturating_sub(1) / 2;
        !line.contains("box_1")
            || (10..80).contains(&frame) && !(20..23).contains(&frame) && !(40..50).contains(&frame)
    };
    let lines: Vec<_> = whole
        .lines()
        .enumerate()
        .filter(is_there)
        .map(|(_, line)| line)
        .collect();
    let text = lines.join("\n");
    let recording = plain("gaps.csv", text.as_bytes());
    let placed: Vec<_> = recording
        .truth
        .placed
        .iter()
        .map(|placed| (placed.tick.value(), placed.desc.id))
        .collect();
    let (one, again) = (BodyId::new(1, 0), BodyId::new(1, 1));
    assert_eq!(placed, [(0, BodyId::new(0, 0)), (10, one), (50, again)]);
    assert_eq!(
        recording.truth.removed,
        [(Tick::new(39), one), (Tick::new(79), again)]
    );
    let filled = recording.truth.ticks[20]
        .iter()
        .find(|of| of.id == one)
        .expect("it is filled");
    let (at, _) = pose(1, 21.0 / 60.0);
    assert!((filled.motion.position()[0] as f64 - at.x).abs() < 1e-3);
    keeps_its_tolerance(&recording);

    let options = ReadOptions {
        missing: MissingPoses::Hold,
        ..ReadOptions::default()
    };
    let held = reading("hold.csv", text.as_bytes(), &options).expect("it is a recording");
    assert_eq!((held.truth.placed.len(), held.truth.removed.len()), (2, 0));
    assert!(
        held.truth.ticks[44].iter().all(|of| of.id != one),
        "it has not moved"
    );
    keeps_its_tolerance(&held);
}

#[test]
fn rotations_with_w_first_are_noticed() {
    // The values of w, x, y, z under the names of x, y, z, w.
    let text =
        rows("time body x y z qw qx qy qz", ",", 60.0, 20).replace("qw,qx,qy,qz", "qx,qy,qz,qw");
    let recording = plain("w-first.csv", text.as_bytes());
    let noticed = recording.notes.iter().any(|note| note.contains("w first"));
    assert!(noticed, "{:?}", recording.notes);
    let right = plain("w-last.csv", rows(COLUMNS, ",", 60.0, 20).as_bytes());
    assert!(!right.notes.iter().any(|note| note.contains("w first")));
}

/// An MCAP file of messages by topic, with their times in nanoseconds.
pub(crate) fn mcap_of<T: Message + Encode>(topic: &str, messages: &[(u64, T)]) -> Vec<u8> {
    let mut writer = WriteOptions::new()
        .create(Cursor::new(Vec::new()))
        .expect("memory");
    let schema = T::get_schema().expect("Foxglove's types have schemas");
    let schema = writer
        .add_schema(&schema.name, &schema.encoding, &schema.data)
        .expect("memory");
    let channel = writer
        .add_channel(schema, topic, "protobuf", &BTreeMap::new())
        .expect("memory");
    for (sequence, (at_ns, message)) in (0..).zip(messages) {
        let header = MessageHeader {
            channel_id: channel,
            sequence,
            log_time: *at_ns,
            publish_time: *at_ns,
        };
        writer
            .write_to_known_channel(&header, &message.encode_to_vec())
            .expect("memory");
    }
    writer.finish().expect("memory");
    writer.into_inner().into_inner()
}

pub(crate) fn stamp(at_ns: u64) -> Option<Timestamp> {
    Some(Timestamp::new(
        (at_ns / 1_000_000_000) as u32,
        (at_ns % 1_000_000_000) as u32,
    ))
}

pub(crate) fn vector(of: DVec3) -> Option<Vector3> {
    let DVec3 { x, y, z } = of;
    Some(Vector3 { x, y, z })
}

pub(crate) fn quaternion(of: DQuat) -> Option<Quaternion> {
    let [x, y, z, w] = of.to_array();
    Some(Quaternion { x, y, z, w })
}

pub(crate) fn drawn(body: u32, t: f64) -> Pose {
    let (at, turned) = pose(body, t);
    Pose {
        position: vector(at),
        orientation: quaternion(turned),
    }
}

/// Moments of frames, as a camera's clock says them: whole nanoseconds, from any origin.
pub(crate) fn moments(hertz: f64, frames: u32) -> Vec<(u64, f64)> {
    let moment = |frame| {
        let t = f64::from(frame) / hertz;
        (1_700_000_000_000_000_000 + (t * 1e9) as u64, t)
    };
    (0..frames).map(moment).collect()
}

#[test]
fn transforms_and_poses_of_foxglove_are_bodies() {
    let times = moments(60.0, 90);
    let each = |of: &dyn Fn(u64, f64) -> FrameTransforms| -> Vec<_> {
        times
            .iter()
            .map(|(at_ns, t)| (*at_ns, of(*at_ns, *t)))
            .collect()
    };
    let transform =
        |parent: &str, child: String, at_ns, (at, turned): (DVec3, DQuat)| FrameTransform {
            timestamp: stamp(at_ns),
            parent_frame_id: parent.to_owned(),
            child_frame_id: child,
            translation: vector(at),
            rotation: quaternion(turned),
        };
    let transforms = each(&|at_ns, t| FrameTransforms {
        transforms: (0..2)
            .map(|body| transform("world", format!("box{body}"), at_ns, pose(body, t)))
            .collect(),
    });
    compare(&plain("tf.mcap", &mcap_of("/tf", &transforms)), 60.0, 90);

    let poses: Vec<_> = times
        .iter()
        .map(|(at_ns, t)| {
            let message = PosesInFrame {
                timestamp: stamp(*at_ns),
                frame_id: "world".to_owned(),
                poses: (0..2).map(|body| drawn(body, *t)).collect(),
            };
            (*at_ns, message)
        })
        .collect();
    compare(&plain("poses.mcap", &mcap_of("/poses", &poses)), 60.0, 90);
}

#[test]
fn a_frame_on_a_moving_frame_moves_with_it() {
    let times = moments(60.0, 30);
    let messages: Vec<_> = times
        .iter()
        .enumerate()
        .map(|(frame, (at_ns, t))| {
            let (at, turned) = pose(0, *t);
            let transform = |parent: &str, child: &str, at, turned| FrameTransform {
                timestamp: stamp(*at_ns),
                parent_frame_id: parent.to_owned(),
                child_frame_id: child.to_owned(),
                translation: vector(at),
                rotation: quaternion(turned),
            };
            let mut transforms = vec![transform("world", "arm", at, turned)];
            // The hand is screwed to the arm, which is said once.
            if frame == 0 {
                transforms.push(transform("arm", "hand", DVec3::X, DQuat::IDENTITY));
            }
            (*at_ns, FrameTransforms { transforms })
        })
        .collect();
    let recording = plain("chain.mcap", &mcap_of("/tf", &messages));
    for (frame, row) in (1..).zip(&recording.truth.ticks) {
        let (at, turned) = pose(0, f64::from(frame) / 60.0);
        let hand = row
            .iter()
            .find(|of| of.id.index() == 1)
            .expect("it moves with the arm");
        let expected = (at + turned * DVec3::X).as_vec3();
        assert!(
            (Vec3::from_array(hand.motion.position()) - expected).length() < 1e-4,
            "{frame}"
        );
    }
    let transform = |parent: &str, child: &str| FrameTransform {
        timestamp: stamp(1),
        parent_frame_id: parent.to_owned(),
        child_frame_id: child.to_owned(),
        ..FrameTransform::default()
    };
    let cycle = [
        (1, transform("a", "b")),
        (1, transform("b", "a")),
        (
            20_000_001,
            FrameTransform {
                timestamp: stamp(20_000_001),
                ..transform("b", "a")
            },
        ),
    ];
    let said = refused("cycle.mcap", &mcap_of("/tf", &cycle));
    assert!(said.contains("is its own parent"), "{said}");
    let other = [(1, transform("a", "b")), (2, transform("c", "b"))];
    let said = refused("parent.mcap", &mcap_of("/tf", &other));
    assert!(
        said.contains("the message of /tf at 0.000000002 s") && said.contains("another parent"),
        "{said}"
    );
}

#[test]
fn a_file_of_other_messages_is_refused_with_what_it_has() {
    let mut writer = WriteOptions::new()
        .create(Cursor::new(Vec::new()))
        .expect("memory");
    let schema = writer
        .add_schema("sensor_msgs/msg/Imu", "ros2msg", b"")
        .expect("memory");
    writer
        .add_channel(schema, "/imu", "cdr", &BTreeMap::new())
        .expect("memory");
    writer.finish().expect("memory");
    let said = refused("ros.mcap", &writer.into_inner().into_inner());
    assert!(
        said.contains("/imu of cdr sensor_msgs/msg/Imu; read are MCAP files"),
        "{said}"
    );
}

/// An `.rhtrace` of two boxes; body 1 comes at frame `from` and is gone after frame `to`.
fn rhtrace(step_s: f32, (from, to): (u32, u32)) -> Vec<u8> {
    let mut bytes = b"RHTRACE1".to_vec();
    bytes.extend(2_u32.to_le_bytes());
    bytes.extend(90_u32.to_le_bytes());
    let mut put =
        |numbers: &[f32]| bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    put(&[step_s, 0.0, 0.0, 0.0]);
    for _ in 0..2 {
        put(&[0.1, 0.1, 0.1, 0.03_f32.sqrt()]);
    }
    for frame in 0..90 {
        let there: Vec<u16> = (0..2)
            .filter(|body| *body == 0 || (from..=to).contains(&frame))
            .collect();
        bytes.extend((there.len() as u16).to_le_bytes());
        for body in there {
            bytes.extend(body.to_le_bytes());
            let (at, turned) = pose(body.into(), f64::from(frame) * f64::from(step_s));
            let motion = [
                &at.as_vec3().to_array()[..],
                &turned.as_quat().to_array(),
                &[0.0; 6],
            ]
            .concat();
            bytes.extend(motion.iter().flat_map(|number| number.to_le_bytes()));
            bytes.push(if body == 1 && frame == to { 3 } else { 1 });
        }
    }
    bytes
}

#[test]
fn boxes_of_any_constant_rate_come_and_go_packed_or_not() {
    for hertz in [60.0, 29.97, 119.88] {
        let plainly = rhtrace((1.0 / hertz) as f32, (0, 100));
        let packed = zstd::encode_all(&*plainly, 1).expect("memory");
        for (name, bytes) in [("whole.rhtrace", &plainly), ("whole.rhtrace.zst", &packed)] {
            let recording = plain(name, bytes);
            assert!(
                recording.notes[0].contains("velocities are zero"),
                "{:?}",
                recording.notes
            );
            compare(&recording, hertz, 90);
        }
    }
    let recording = plain("late.rhtrace", &rhtrace(1.0 / 60.0, (30, 59)));
    let placed: Vec<_> = recording
        .truth
        .placed
        .iter()
        .map(|placed| placed.tick.value())
        .collect();
    assert_eq!(placed, [0, 30]);
    assert_eq!(
        recording.truth.removed,
        [(Tick::new(59), BodyId::new(1, 0))]
    );
    keeps_its_tolerance(&recording);
}

/// A recording as a server writes it: one ball from tick 500 on, without ticks 510 to 519.
fn served() -> Vec<u8> {
    let config = SceneConfig::default();
    let facts = SceneFacts::of(&config);
    let mut file = TraceFile::new(Cursor::new(Vec::new()), "test").expect("memory");
    let mut record = facts.to_metadata();
    record.insert("scene".to_owned(), "team/pit".to_owned());
    file.put_metadata("rhumb.scene.1.team_pit".to_owned(), record)
        .expect("memory");
    let mut topics = SceneTopics::new("/team/pit", 30);
    let id = BodyId::new(4, 2);
    let observation = |tick: u64| Observation {
        id,
        motion: BodyState::new(
            [tick as f32 * 0.01, 1.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [0.6, 0.0, 0.0],
            [0.0; 3],
        )
        .expect("finite"),
        activity: Activity::Awake,
    };
    let placed = |tick: u64| Placed {
        tick: Tick::new(tick),
        desc: BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(1)),
        shape: Shape::Ball { radius: 0.5 },
        observation: observation(tick),
        inertia: None,
    };
    for tick in (500..510).chain(520..530) {
        // The first message, and the first after missing ticks, have every body as placed.
        let is_whole = tick == 500 || tick == 520;
        let (observed, new) = if is_whole {
            (vec![], vec![placed(tick)])
        } else {
            (vec![observation(tick)], vec![])
        };
        let states = States::of(
            Tick::new(tick),
            &observed,
            (&new, &[]),
            &mut StateForm::Exact,
        );
        topics
            .put_states(
                &mut file,
                log_time_ns(config.integrator.rate, tick),
                &states,
            )
            .expect("memory");
    }
    file.finish().expect("memory").into_inner()
}

#[test]
fn a_recording_of_a_server_begins_at_its_first_tick_and_says_what_it_lacks() {
    let recording = plain("served.mcap", &served());
    assert_eq!(recording.name, "team/pit");
    assert_eq!(recording.facts(), SceneFacts::of(&SceneConfig::default()));
    assert_eq!(
        (recording.truth.placed.len(), recording.truth.removed.len()),
        (1, 0)
    );
    assert_eq!(recording.ticks(), 29);
    assert!(recording.truth.ticks[9..19].iter().all(Vec::is_empty));
    assert_eq!(recording.truth.ticks[19][0].motion.position()[0], 5.2);
    assert!(
        recording.notes[0].contains("lacks 10 ticks"),
        "{:?}",
        recording.notes
    );
    keeps_its_tolerance(&recording);
}

#[test]
fn a_cut_recording_of_a_server_is_read_up_to_there() {
    let whole = served();
    let mut read_ticks = Vec::new();
    for length in (100..whole.len()).step_by(7) {
        if let Ok(recording) = reading("cut.mcap", &whole[..length], &ReadOptions::default()) {
            read_ticks.push(recording.ticks());
        }
    }
    assert!(
        read_ticks.is_sorted() && read_ticks.last() == Some(&29),
        "{read_ticks:?}"
    );
}

/// Tick and last tick of every stay of a recording, by index.
pub(crate) fn stays(recording: &Recording) -> Vec<(u32, u64, Option<u64>)> {
    let truth = &recording.truth;
    let end = |id: BodyId| truth.removed.iter().find(|(_, of)| *of == id);
    let stay = |placed: &Placed| {
        let id = placed.desc.id;
        let end = end(id).map(|(tick, _)| tick.value());
        (id.index(), placed.tick.value(), end)
    };
    let mut stays: Vec<_> = truth.placed.iter().map(stay).collect();
    stays.sort_unstable();
    stays
}

#[test]
fn a_body_of_one_frame_comes_and_goes_in_every_form() {
    let mut text = COLUMNS.replace(' ', ",") + "\n";
    for frame in 0..60 {
        let t = f64::from(frame) / 60.0;
        text += &format!("{t},there,{t},0,0,0,0,0,1\n");
        // Alone between two gaps, and once at the very end.
        if frame % 20 == 0 || frame == 59 {
            text += &format!("{t},lone,0,{t},0,0,0,0,1\n");
        }
    }
    let recording = plain("lone.csv", text.as_bytes());
    let lone = [0, 20, 40].map(|frame| (1, frame, Some(frame)));
    let expected = [&[(0, 0, None)][..], &lone, &[(1, 59, None)]].concat();
    assert_eq!(stays(&recording), expected);
    keeps_its_tolerance(&recording);

    let written = write_rhtrace(&recording).expect("few bodies");
    let again = plain("lone.rhtrace", &written);
    assert_eq!(stays(&again), expected);
    keeps_its_tolerance(&again);

    let mut file = Cursor::new(Vec::new());
    write_bag(&recording, &mut file).expect("memory");
    let again = plain("lone-bag.mcap", &file.into_inner());
    let mut begins: Vec<u64> = stays(&again).iter().map(|(_, begin, _)| *begin).collect();
    begins.sort_unstable();
    assert_eq!(begins, [0, 0, 20, 40, 59]);

    let load = Load {
        truth: recording.truth.clone(),
        facts: recording.facts(),
        runs: vec![replayed(&recording)],
        unfinished: Vec::new(),
    };
    let experiment = Experiment {
        command: String::new(),
        seed: 1,
        machine: String::new(),
        loads: vec![load],
    };
    let path = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("lone-trace.mcap");
    write(&path, &experiment, &TraceOptions::default(), &mut |_| {}).expect("the disk has space");
    let bytes = std::fs::read(&path).expect("it is written");
    assert_eq!(stays(&plain("lone-trace.mcap", &bytes)), expected);
}

#[test]
fn contradicting_poses_of_one_time_are_refused_or_said() {
    let mut text = COLUMNS.replace(' ', ",") + "\n";
    for frame in 0..10 {
        let t = f64::from(frame) / 10.0;
        text += &format!("{t},a,{t},0,0,0,0,0,1\n");
    }
    let equal = text.clone() + "0.1,a,0.1,0,0,0,0,0,1\n";
    let other = text + "0.1,a,900,0,0,0,0,0,1\n";
    let said = refused("dup.csv", other.as_bytes());
    assert!(
        said.contains("line 12: body a has another pose at the same time, by line 3"),
        "{said}"
    );
    plain("again.csv", equal.as_bytes());
    let options = ReadOptions {
        resample: Rate::new(20, 1),
        ..ReadOptions::default()
    };
    let notes = |text: &str| {
        let recording = reading("dup.csv", text.as_bytes(), &options).expect("the first counts");
        assert!(
            recording.truth.ticks[1]
                .iter()
                .all(|of| of.motion.position()[0] < 1.0)
        );
        recording.notes.join("\n")
    };
    let said = notes(&other);
    assert!(
        said.contains("1 poses are of a time that has another one of the body, up to 899.9000 m apart, as that of line 12"),
        "{said}"
    );
    let said = notes(&equal);
    assert!(!said.contains("apart"), "{said}");
}
