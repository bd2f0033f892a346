//! Tests of poses from arrays and trajectories.

use std::io::Write as _;

use super::*;
use crate::recording::npy::tests::written;
use crate::recording::read_bytes;

/// An archive without packing, as `numpy.savez` writes it.
pub(in crate::recording) fn archive(members: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut archive = rawzip::ZipArchiveWriter::new(&mut bytes);
    for (name, member) in members {
        let path = format!("{name}.npy");
        let file = archive.new_file(&path);
        let (mut entry, config) = file.start().expect("memory");
        let mut writer = config.wrap(&mut entry);
        writer.write_all(member).expect("memory");
        let (_, descriptor) = writer.finish().expect("memory");
        entry.finish(descriptor).expect("memory");
    }
    archive.finish().expect("memory");
    bytes
}

fn read(members: &[(&str, Vec<u8>)], options: &ReadOptions) -> Result<Recording, RecordingError> {
    read_bytes("a", &archive(members), options)
}

fn frames(count: usize, of: impl Fn(f64) -> Vec<f64>) -> Vec<f64> {
    (0..count).flat_map(|frame| of(frame as f64)).collect()
}

#[test]
fn a_trajectory_of_free_bodies_has_mujocos_order_and_axes() {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    // A quarter of a turn about z, w first; the spin is along the body's x, the world's y.
    let qpos = frames(10, |frame| {
        vec![0.01 * frame, 0.0, 1.0, half, 0.0, 0.0, half]
    });
    let qvel = frames(10, |_| vec![1.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
    let members = [
        ("qpos", written("(10, 7)", &qpos)),
        ("qvel", written("(10, 6)", &qvel)),
        ("timestep", written("()", &[0.01])),
        ("gravity", written("(3,)", &[0.0, 0.0, -9.81])),
        ("half_extents", written("(1, 3)", &[0.1, 0.2, 0.3])),
        ("inertia", written("(1, 3)", &[1.0, 2.0, 2.5])),
    ];
    let recording = read(&members, &ReadOptions::default()).expect("sound");
    assert_eq!(recording.integrator.rate.ticks(), 100);
    let placed = &recording.truth.placed[0];
    let motion = placed.observation.motion.motion();
    assert!((motion.twist().angular - DVec3::Y * 2.0).length() < 1e-6);
    assert!((motion.pose().rotation.z - half).abs() < 1e-6);
    assert_eq!(placed.shape, Shape::cuboid(0.1, 0.2, 0.3));
    assert!(placed.inertia.is_some());
    assert!((recording.gravity.z + 9.81).abs() < 1e-5);
}

#[test]
fn an_unsaid_order_a_gap_and_wrong_shapes_are_handled_by_name() {
    let mut position = frames(12, |frame| vec![frame, 0.0, 0.0, 0.0, frame, 0.0]);
    position[6 * 5] = f64::NAN;
    let rotation = frames(12, |_| vec![0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    let time = frames(12, |frame| vec![100.0 + 0.05 * frame]);
    let members = [
        ("time", written("(12,)", &time)),
        ("position", written("(12, 2, 3)", &position)),
        ("rotation", written("(12, 2, 4)", &rotation)),
    ];
    let error = read(&members, &ReadOptions::default())
        .expect_err("no order")
        .to_string();
    assert!(error.contains("--quaternion wxyz or xyzw"), "{error}");
    let options = ReadOptions {
        quaternion: Some(QuaternionOrder::Xyzw),
        ..ReadOptions::default()
    };
    let recording = read(&members, &options).expect("sound");
    // The gap of one frame is filled.
    assert_eq!((recording.ticks(), recording.truth.placed.len()), (11, 2));
    let rate = recording.integrator.rate;
    assert_eq!((rate.ticks(), rate.seconds()), (20, 1));
    for (place, member, part) in [
        (
            1,
            written("(12, 6)", &position),
            "array position has to be shape (frames, bodies, 3)",
        ),
        (
            2,
            written("(12, 1, 4)", &rotation[..48]),
            "array rotation has not as many frames and bodies as position",
        ),
        (
            0,
            written("(11,)", &time[..11]),
            "array time has not as many",
        ),
        (
            0,
            written("(12,)", &[f64::NAN; 12]),
            "body 0 of frame 0 in time: the time",
        ),
    ] {
        let mut members = members.clone();
        members[place].1 = member;
        let error = read(&members, &options).expect_err(part).to_string();
        assert!(error.contains(part), "{error}");
    }
    let error = read(&members[..1], &options)
        .expect_err("no poses")
        .to_string();
    assert!(
        error.starts_with("of the arrays time none are poses"),
        "{error}"
    );
}

#[test]
fn arrays_that_claim_lengths_without_numbers_take_no_memory() {
    let step = ("timestep", written("()", &[0.01]));
    for shape in [
        "(100000000000, 0, 3)",
        "(18446744073709551615, 0, 3)",
        "(0, 9, 3)",
    ] {
        let quaternions = shape.replace('3', "4");
        let members = [
            step.clone(),
            ("position", written(shape, &[])),
            ("quat_xyzw", written(&quaternions, &[])),
        ];
        let error = read(&members, &ReadOptions::default()).expect_err(shape);
        assert!(!error.to_string().is_empty());
    }
}

#[test]
fn numbers_of_the_engine_beyond_a_scene_s_are_refused_by_name() {
    let qpos = frames(10, |frame| vec![0.01 * frame, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
    let whole = [
        ("qpos", written("(10, 7)", &qpos)),
        ("timestep", written("()", &[0.01])),
    ];
    for (name, numbers) in [
        ("substeps", vec![0.0]),
        ("substeps", vec![1e9]),
        ("substeps", vec![f64::NAN]),
        ("linear_damping", vec![-1.0]),
        ("angular_damping", vec![f64::INFINITY]),
        ("gravity", vec![0.0, f64::NAN, 0.0]),
        ("gravity", vec![0.0, 0.0, -1e4]),
    ] {
        let shape = format!("({},)", numbers.len());
        let mut members = whole.to_vec();
        members.push((name, written(&shape, &numbers)));
        let error = read(&members, &ReadOptions::default()).expect_err(name);
        assert!(error.to_string().contains(name), "{error}");
    }
}

/// An archive of a ball's ten poses, and another array.
fn with(name: &'static str, shape: &str, values: &[f64]) -> Result<Recording, RecordingError> {
    let position = frames(10, |frame| vec![frame, 0.0, 0.0]);
    let rotation = frames(10, |_| vec![0.0, 0.0, 0.0, 1.0]);
    let members = [
        ("timestep", written("()", &[0.01])),
        ("position", written("(10, 1, 3)", &position)),
        ("quat_xyzw", written("(10, 1, 4)", &rotation)),
        (name, written(shape, values)),
    ];
    read(&members, &ReadOptions::default())
}

#[test]
fn an_array_that_does_not_fit_is_refused_with_what_is_needed() {
    for (name, shape, values, needed) in [
        (
            "gravity",
            "(2,)",
            &[0.0, -9.8][..],
            "(2,), and needs shape (3,)",
        ),
        (
            "half_extents",
            "(2, 3)",
            &[1.0; 6],
            "(2, 3), and needs shape (1, 3)",
        ),
        ("radius", "(2,)", &[1.0; 2], "(2,), and needs shape (1,)"),
        ("inertia", "(2, 3)", &[1.0; 6], "needs shape (1, 3)"),
        ("linear_damping", "(2,)", &[1.0; 2], "needs shape ()"),
        ("half_extents", "(1, 3)", &[-1.0, 1.0, 1.0], "body 0"),
        ("radius", "(1,)", &[f64::NAN], "body 0"),
        (
            "substeps",
            "()",
            &[2.5],
            "2.5, and needs a whole number from 1 to 16",
        ),
        (
            "inertia",
            "(1, 3)",
            &[1.0, 1.0, 5.0],
            "the sum of the other two",
        ),
        ("inertia", "(1, 3)", &[1.0, 1.0, 0.0], "body 0"),
    ] {
        let error = with(name, shape, values).expect_err(name).to_string();
        let has = |part: &str| error.contains(part);
        assert!(has(&format!("array {name}")) && has(needed), "{error}");
    }
    for (name, shape, values) in [
        ("gravity", "(1, 3)", &[0.0, -9.8, 0.0][..]),
        ("half_extents", "(3,)", &[1.0; 3]),
        ("radius", "()", &[1.0]),
        ("inertia", "(3,)", &[1.0, 1.0, 2.0]),
        ("substeps", "(1,)", &[2.0]),
    ] {
        assert!(with(name, shape, values).is_ok(), "{name}");
    }
}

#[test]
fn velocities_of_one_kind_and_unknown_arrays_are_noted() {
    let notes = |name| {
        let recording = with(name, "(10, 1, 3)", &[0.0; 30]).expect("sound");
        recording.notes.join("\n")
    };
    let linear = notes("linear");
    assert!(
        linear.contains("linear without angular, so all"),
        "{linear}"
    );
    let angular = notes("angular_velocity");
    assert!(
        angular.contains("angular_velocity without linear"),
        "{angular}"
    );
    let misspelt = notes("linear_vel");
    assert!(misspelt.contains("not read: linear_vel"), "{misspelt}");
}

#[test]
fn arrays_that_say_what_another_says_are_noted() {
    let notes = |name, shape, values: &[f64]| {
        let recording = with(name, shape, values).expect("sound");
        recording.notes.join("\n")
    };
    let second = notes("xpos", "(10, 1, 3)", &[0.0; 30]);
    assert!(second.contains("position is read, so not xpos"), "{second}");
    let alone = notes("qvel", "(10, 6)", &[0.0; 60]);
    assert!(alone.contains("qvel is not read without qpos"), "{alone}");
    let times: Vec<f64> = (0..10).map(|frame| f64::from(frame) * 0.1).collect();
    let step = notes("time", "(10,)", &times);
    assert!(step.contains("time is read, so not timestep"), "{step}");
}

#[test]
fn rows_of_one_body_are_read_from_a_lone_array() {
    let rows = frames(5, |frame| {
        vec![frame * 0.1, frame, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    });
    let options = ReadOptions {
        quaternion: Some(QuaternionOrder::Wxyz),
        ..ReadOptions::default()
    };
    let recording = read_bytes("a", &written("(5, 8)", &rows), &options).expect("sound");
    assert_eq!(
        recording.truth.placed[0].observation.motion.rotation(),
        [0.0, 0.0, 0.0, 1.0]
    );
    let wrong = read_bytes("a", &written("(5, 7)", &rows[..35]), &options);
    assert!(
        wrong
            .expect_err("a column is missing")
            .to_string()
            .contains("array a has to be rows")
    );
}
