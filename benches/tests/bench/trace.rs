//! Traces read back by the format's own library.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

use crate::support::experiment;
use foxglove::messages::{SceneEntity, SceneUpdate};
use mcap::records::Metadata;
use mcap::sans_io::IndexedReaderOptions;
use prost::Message;
use rhumb_bench::record::{Experiment, Mode};
use rhumb_bench::trace::{self, Progress, TraceError, TraceOptions};
use rhumb_reckoning::BodyId;
use rhumb_trace::{GridHistory, GridPose, Packet, Poses, STEPS, States};

/// Draws every tick; bodies count as resting after one tick.
const FINE: TraceOptions = TraceOptions {
    scene_hz: 10.0,
    resting_after_s: 0.1,
    scene_bodies_max: 100,
};

/// An empty folder for one test.
fn folder(name: &str) -> PathBuf {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&path);
    fs::create_dir_all(&path).expect("the target folder is writable");
    path
}

fn written(name: &str) -> Vec<u8> {
    let path = folder(name).join("trace.mcap");
    let bytes = trace::write(&path, &experiment(), &FINE, &mut |_| {}).expect("the disk has space");
    let file = fs::read(path).expect("the file exists");
    assert_eq!(file.len() as u64, bytes);
    file
}

/// Messages by topic, with their times.
fn messages(file: &[u8]) -> BTreeMap<String, Vec<(u64, Vec<u8>)>> {
    let mut topics: BTreeMap<String, Vec<_>> = BTreeMap::new();
    for message in mcap::MessageStream::new(file).expect("the file is a trace") {
        let message = message.expect("every checksum holds");
        assert_eq!(message.log_time, message.publish_time);
        let schema = message
            .channel
            .schema
            .as_ref()
            .expect("every topic has a schema");
        assert_eq!(schema.encoding, "protobuf");
        let topic = topics.entry(message.channel.topic.clone()).or_default();
        topic.push((message.log_time, message.data.into_owned()));
    }
    topics
}

/// A message's columns of residuals, row by row.
fn rows(columns: [&Vec<i64>; 7]) -> Vec<GridPose> {
    let count = columns[0].len();
    (0..count)
        .map(|row| columns.map(|column| column[row]))
        .collect()
}

fn residuals(poses: &Poses) -> Vec<GridPose> {
    rows([
        &poses.step_px,
        &poses.step_py,
        &poses.step_pz,
        &poses.step_qx,
        &poses.step_qy,
        &poses.step_qz,
        &poses.step_qw,
    ])
}

fn ids(index: &[u32], generation: &[u32]) -> Vec<BodyId> {
    let pairs = index.iter().zip(generation);
    pairs
        .map(|(index, generation)| BodyId::new(*index, *generation as u16))
        .collect()
}

/// Asserts that a pose of the grid is the nearest to an exact one.
fn assert_near(pose: GridPose, exact: [f32; 7]) {
    for (part, exact) in pose.iter().zip(exact) {
        let error = (*part as f64 / STEPS - f64::from(exact)).abs();
        assert!(error <= 0.5 / STEPS, "{error}");
    }
}

/// The run of a mode.
fn run(experiment: &Experiment, mode: Mode) -> &rhumb_bench::record::Run {
    let mut runs = experiment.loads[0].runs.iter();
    runs.find(|run| run.config.mode == mode)
        .expect("the mode ran")
}

#[test]
fn loads_after_the_first_have_poses_on_the_grid() {
    let mut experiment = experiment();
    experiment.loads.push(experiment.loads[0].clone());
    let path = folder("grid").join("trace.mcap");
    trace::write(&path, &experiment, &FINE, &mut |_| {}).expect("the disk has space");
    let topics = messages(&fs::read(path).expect("the file exists"));
    let (exact, grid) = (&topics["/n3/truth/state"], &topics["/n3-2/truth/state"]);
    assert_eq!(exact.len(), grid.len());
    let (mut history, mut compared) = (GridHistory::default(), 0);
    for ((_, exact), (_, grid)) in exact.iter().zip(grid) {
        let exact = States::decode(&**exact).expect("a message");
        let grid = States::decode(&**grid).expect("a message");
        assert_eq!(
            (&exact.index, &exact.awake, exact.placed.len()),
            (&grid.index, &grid.awake, grid.placed.len())
        );
        assert!(grid.px.is_empty() && grid.vx.is_empty() && exact.step_px.is_empty());
        let residuals = rows([
            &grid.step_px,
            &grid.step_py,
            &grid.step_pz,
            &grid.step_qx,
            &grid.step_qy,
            &grid.step_qz,
            &grid.step_qw,
        ]);
        let bodies = ids(&grid.index, &grid.generation);
        for (row, (id, residual)) in bodies.iter().zip(residuals).enumerate() {
            let pose = history.decode(*id, residual);
            let columns = [
                &exact.px, &exact.py, &exact.pz, &exact.qx, &exact.qy, &exact.qz, &exact.qw,
            ];
            assert_near(pose, columns.map(|column| column[row]));
            compared += 1;
        }
    }
    assert!(compared > 5, "{compared}");
}

#[test]
fn a_copy_is_written_by_its_second_differences() {
    let experiment = experiment();
    let topics = messages(&written("copies"));
    let frames = &run(&experiment, Mode::Rhumb).frames;
    let (mut history, mut compared) = (GridHistory::default(), 0);
    for (_, bytes) in &topics["/n3/rhumb/seen"] {
        let poses = Poses::decode(&**bytes).expect("a message");
        assert!(!poses.from_truth);
        let changed = &frames[poses.frame as usize].changed;
        let bodies = ids(&poses.index, &poses.generation);
        assert_eq!(bodies.len(), changed.len());
        for ((id, residual), exact) in bodies.iter().zip(residuals(&poses)).zip(changed) {
            assert_eq!(*id, exact.id);
            let ([px, py, pz], [qx, qy, qz, qw]) = (exact.position, exact.rotation);
            assert_near(history.decode(*id, residual), [px, py, pz, qx, qy, qz, qw]);
            compared += 1;
        }
    }
    assert!(compared > 5, "{compared}");
}

#[test]
fn a_stream_of_states_is_written_as_no_difference_and_by_its_sizes() {
    let experiment = experiment();
    let topics = messages(&written("naive"));
    for (_, bytes) in &topics["/n3/naive/seen"] {
        let poses = Poses::decode(&**bytes).expect("a message");
        assert!(poses.from_truth && poses.px.is_empty());
        assert!(residuals(&poses).iter().all(|residual| *residual == [0; 7]));
    }
    for (mode, name) in [(Mode::Naive, "naive"), (Mode::Rhumb, "rhumb")] {
        let sizes = run(&experiment, mode).captured.iter();
        let sizes = sizes.filter(|captured| {
            captured.direction == rhumb_bench::record::PacketDirection::StateDown
        });
        let packets = topics[&format!("/n3/{name}/wire/state-down")].iter();
        for (captured, (_, bytes)) in sizes.zip(packets) {
            let packet = Packet::decode(&**bytes).expect("a message");
            assert_eq!(packet.length as usize, captured.bytes.len());
            let kept = if mode == Mode::Rhumb {
                captured.bytes.len()
            } else {
                0
            };
            assert_eq!(packet.data.len(), kept, "{name}");
        }
    }
}

fn metadata(file: &[u8]) -> BTreeMap<String, BTreeMap<String, String>> {
    let summary = mcap::Summary::read(file)
        .expect("the file is intact")
        .expect("the file has an index");
    let read = |index| {
        let Metadata { name, metadata } =
            mcap::read::metadata(file, index).expect("the record exists");
        (name, metadata)
    };
    summary.metadata_indexes.iter().map(read).collect()
}

/// The one entity of a scene message.
fn entity(data: &[u8]) -> SceneEntity {
    let mut update = SceneUpdate::decode(data).expect("the message is a scene");
    assert!(update.deletions.is_empty());
    assert_eq!(update.entities.len(), 1);
    update.entities.remove(0)
}

#[test]
fn every_topic_has_every_message() {
    let topics = messages(&written("counts"));
    let counts: Vec<_> = topics
        .iter()
        .map(|(topic, all)| (topic.as_str(), all.len()))
        .collect();
    let expected = [
        ("/n3/integrated/stats", 4),
        ("/n3/naive/moving", 4),
        ("/n3/naive/resting", 2),
        ("/n3/naive/seen", 4),
        ("/n3/naive/stats", 4),
        ("/n3/naive/wire/state-down", 4),
        ("/n3/rhumb/breaches", 1),
        ("/n3/rhumb/moving", 4),
        ("/n3/rhumb/resting", 2),
        ("/n3/rhumb/seen", 4),
        ("/n3/rhumb/stats", 4),
        ("/n3/rhumb/wire/control-down", 1),
        ("/n3/rhumb/wire/control-up", 1),
        ("/n3/rhumb/wire/state-down", 3),
        ("/n3/rhumb/wire/state-up", 1),
        ("/n3/truth/moving", 5),
        ("/n3/truth/poses", 5),
        ("/n3/truth/resting", 2),
        ("/n3/truth/state", 5),
        ("/n3/truth/static", 1),
    ];
    assert_eq!(counts, expected);
}

#[test]
fn all_topics_share_one_time_axis() {
    let topics = messages(&written("times"));
    let times = |topic: &str| {
        topics[topic]
            .iter()
            .map(|(time, _)| *time)
            .collect::<Vec<_>>()
    };
    let ticks = [100_000_000, 200_000_000, 300_000_000, 400_000_000];
    assert_eq!(times("/n3/rhumb/stats"), ticks);
    assert_eq!(times("/n3/integrated/stats"), ticks);
    assert_eq!(times("/n3/truth/state")[0], 0);
    assert_eq!(times("/n3/truth/state")[1..], ticks);
    assert_eq!(times("/n3/rhumb/breaches"), [400_000_000]);
}

#[test]
fn the_metadata_describes_the_run() {
    let records = metadata(&written("metadata"));
    let names: Vec<_> = records.keys().map(String::as_str).collect();
    let runs = [
        "rhumb.run.n3.integrated",
        "rhumb.run.n3.naive",
        "rhumb.run.n3.rhumb",
        "rhumb.truth.n3",
    ];
    assert_eq!(names[0], "rhumb.experiment");
    assert_eq!(names[1..], runs);
    assert_eq!(
        records["rhumb.experiment"]["command"],
        "rhumb-bench evaluate --scene <fall>"
    );
    let run = &records["rhumb.run.n3.rhumb"];
    for (name, value) in [
        ("tolerance_m", "0.05"),
        ("step_s", "0.1"),
        ("truth_hash", "0123456789abcdef"),
        ("join_wire_bytes_down", "4000"),
        ("publish_ns_total", "1000000"),
        ("mismatches", "0"),
        ("place", "2"),
    ] {
        assert_eq!(run[name], value, "{name}");
    }
    assert!(!records["rhumb.run.n3.naive"].contains_key("tolerance_m"));
}

#[test]
fn the_file_is_indexed_and_compressed() {
    let file = written("indexed");
    let summary = mcap::Summary::read(&file)
        .expect("the file is intact")
        .expect("the file has an index");
    assert!(!summary.chunk_indexes.is_empty());
    assert!(
        summary
            .chunk_indexes
            .iter()
            .all(|chunk| chunk.compression == "zstd")
    );
    assert!(
        summary
            .chunk_indexes
            .iter()
            .all(|chunk| !chunk.message_index_offsets.is_empty())
    );
    // A reader with only the index finds the start of a given topic.
    let reader = mcap::sans_io::IndexedReader::new_with_options(
        &summary,
        IndexedReaderOptions::new().include_topics(["/n3/truth/state"]),
    );
    assert!(reader.is_ok());
}

/// A viewer that seeks shows the last message of each topic at or before the chosen time.
#[test]
fn the_last_message_of_each_topic_is_the_complete_scene() {
    let topics = messages(&written("seek"));
    // Ball and capsule always; the cylinder, placed after tick 1 and removed after tick 3, at ticks 2 and 3.
    for (copy, bodies) in [
        ("truth", [2, 2, 3, 3, 2]),
        ("naive", [0, 2, 3, 3, 2]),
        ("rhumb", [0, 2, 3, 3, 2]),
    ] {
        for (tick, bodies) in bodies
            .into_iter()
            .enumerate()
            .filter(|(_, bodies)| *bodies > 0)
        {
            let time_ns = tick as u64 * 100_000_000;
            let last = |topic: &str| {
                let all = &topics[&format!("/n3/{copy}/{topic}")];
                let before = all.iter().rev().find(|(time, _)| *time <= time_ns);
                entity(&before.expect("each topic has begun").1)
            };
            let (moving, resting) = (last("moving"), last("resting"));
            assert_eq!(
                (moving.id.as_str(), resting.id.as_str()),
                ("moving", "resting")
            );
            // A capsule is a cylinder and two balls.
            let capsules = 1;
            let drawn = |e: &SceneEntity| e.cubes.len() + e.spheres.len() + e.cylinders.len();
            assert_eq!(
                drawn(&moving) + drawn(&resting),
                bodies + 2 * capsules,
                "{copy} {tick}"
            );
        }
    }
    assert_eq!(entity(&topics["/n3/truth/static"][0].1).cubes.len(), 1);
}

#[test]
fn a_still_body_is_drawn_as_resting() {
    let topics = messages(&written("rest"));
    for copy in ["truth", "naive", "rhumb"] {
        let (time, data) = topics[&format!("/n3/{copy}/resting")]
            .last()
            .expect("there is one");
        // Asleep at tick 2, drawn as resting one tick later.
        assert_eq!(*time, 300_000_000, "{copy}");
        assert_eq!(entity(data).cylinders.len(), 1);
        assert_eq!(entity(data).spheres.len(), 2);
    }
}

#[test]
fn a_scene_at_rest_draws_nothing_as_moving() {
    let mut experiment = experiment();
    for row in &mut experiment.loads[0].truth.ticks {
        row.retain(|observation| observation.id.index() == 2);
    }
    experiment.loads[0]
        .truth
        .placed
        .retain(|placed| placed.desc.id.index() == 2);
    experiment.loads[0].runs.truncate(1);
    let path = folder("still").join("trace.mcap");
    trace::write(&path, &experiment, &FINE, &mut |_| {}).expect("the disk has space");
    let topics = messages(&fs::read(path).expect("the file exists"));
    let (_, moving) = topics["/n3/truth/moving"].last().expect("there is one");
    let moving = entity(moving);
    assert!(moving.cylinders.is_empty() && moving.spheres.is_empty());
}

#[test]
fn errors_are_shown_by_colour() {
    let topics = messages(&written("colour"));
    let colour = |tick: usize| {
        let (_, data) = &topics["/n3/rhumb/moving"][tick - 1];
        let ball = *entity(data)
            .spheres
            .last()
            .expect("the ball falls all the time");
        ball.color.expect("it has a colour")
    };
    // Exact is blue; over tolerance violet.
    assert!(colour(1).b > colour(1).r);
    assert!(colour(4).r > 0.7 && colour(4).b > 0.8 && colour(4).g < 0.2);
}

#[test]
fn one_record_gives_one_file() {
    assert_eq!(written("once"), written("again"));
}

#[test]
fn too_many_bodies_are_not_drawn_but_recorded() {
    let path = folder("undrawn").join("trace.mcap");
    let options = TraceOptions {
        scene_bodies_max: 2,
        ..FINE
    };
    trace::write(&path, &experiment(), &options, &mut |_| {}).expect("the disk has space");
    let topics = messages(&fs::read(path).expect("the file exists"));
    assert!(
        topics
            .keys()
            .all(|topic| !topic.ends_with("moving") && !topic.ends_with("static"))
    );
    assert_eq!(topics["/n3/truth/state"].len(), 5);
    assert_eq!(topics["/n3/rhumb/seen"].len(), 4);
}

#[test]
fn progress_ends_at_its_total() {
    let mut reports = Vec::new();
    let path = folder("progress").join("trace.mcap");
    trace::write(&path, &experiment(), &FINE, &mut |progress| {
        reports.push(progress);
    })
    .expect("the disk has space");
    assert_eq!(reports.len(), 5);
    assert_eq!(reports.last(), Some(&Progress { done: 5, of: 5 }));
}

#[test]
fn an_error_names_the_missing_folder() {
    let path = folder("nowhere").join("missing").join("trace.mcap");
    let error =
        trace::write(&path, &experiment(), &FINE, &mut |_| {}).expect_err("the folder is missing");
    assert!(matches!(error, TraceError::Create { .. }));
    assert!(error.to_string().contains("trace.mcap.partial"), "{error}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_reported_and_leaves_no_file() {
    let path = folder("full").join("trace.mcap");
    let partial = path.with_extension("mcap.partial");
    std::os::unix::fs::symlink("/dev/full", &partial).expect("a link can be created");
    let error =
        trace::write(&path, &experiment(), &FINE, &mut |_| {}).expect_err("the disk is full");
    let TraceError::Write { path: named, cause } = &error else {
        panic!("{error}");
    };
    assert_eq!(*named, partial);
    assert_eq!(cause.kind(), std::io::ErrorKind::StorageFull);
    assert!(
        error.to_string().contains("No space left on device"),
        "{error}"
    );
    assert!(!path.exists() && fs::symlink_metadata(&partial).is_err());
}

#[test]
fn the_layout_shows_the_topics_of_the_smallest_load() {
    let mut experiment = experiment();
    let mut larger = experiment.loads[0].clone();
    for run in &mut larger.runs {
        run.config.bodies = 500;
    }
    experiment.loads.insert(0, larger);
    let layout: serde_json::Value =
        serde_json::from_str(&trace::layout(&experiment)).expect("the layout is JSON");
    let shown = &layout["configById"]["3D!copy"]["topics"];
    assert_eq!(shown["/n3/rhumb/moving"]["visible"], true);
    assert_eq!(shown["/n3/rhumb/resting"]["visible"], true);
    let paths = &layout["configById"]["Plot!error"]["paths"];
    assert_eq!(paths[1]["value"], "/n3/rhumb/stats.error_m_max");
    let topics = messages(&written("layout"));
    for topic in shown.as_object().expect("the layout names topics").keys() {
        assert!(topics.contains_key(topic), "{topic}");
    }
}
