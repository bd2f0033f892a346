//! Tests of skeletons: turns, positions, frame times, wrong files.

use glam::DQuat;

use super::super::bvh::{FIRST, PositionChannels};
use super::*;

/// A root, a joint that turns, a joint without channels, a joint with a position, and an end.
const SKELETON: &str = "HIERARCHY\n\
    ROOT Hips\n{\n  OFFSET 0 0 0\n  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n\
    \x20 JOINT Left Leg {\n    OFFSET 10 0 0\n    CHANNELS 3 Xrotation Yrotation Zrotation\n\
    \x20   JOINT Shin\n    {\n      OFFSET 0 -20 0\n      CHANNELS 0\n\
    \x20     JOINT Foot\n      {\n        OFFSET 5 0 0\n        CHANNELS 6 Xposition Yposition Zposition Xrotation Yrotation Zrotation\n\
    \x20       End Site\n        {\n          OFFSET 0 -1 0\n        }\n      }\n    }\n  }\n}\n\
    MOTION\n";
const ROWS: [&str; 2] = [
    "100 50 20 90 0 0 0 90 0 5 -20 0 0 0 0",
    "110 50 20 90 90 0 0 0 0 6 -19 0 0 0 0",
];

fn file(rows: &[&str], frame_time: &str) -> String {
    let count = rows.len();
    format!(
        "{SKELETON}Frames: {count}\nFrame Time: {frame_time}\n{}\n",
        rows.join("\n")
    )
}

fn centimetres() -> ReadOptions {
    ReadOptions {
        unit: Some(Metres::new(0.01)),
        ..ReadOptions::default()
    }
}

fn plain(text: &str, options: &ReadOptions) -> Recording {
    read_bvh("skeleton", text, options).expect("a skeleton")
}

/// Position of a body in a frame, centimetres.
fn at(recording: &Recording, body: u32, frame: usize) -> [f32; 3] {
    let mut placed = recording.truth.placed.iter();
    let first = placed.find(|placed| placed.desc.id.index() == body);
    let first = first.expect("a body").observation.motion;
    let mut rows = recording.truth.ticks[..frame].iter().flatten();
    let last = rows.rfind(|of| of.id.index() == body);
    let state = last.map_or(first, |of| of.motion);
    state.position().map(|metres| (metres * 1e5).round() / 1e3)
}

#[test]
fn turns_are_multiplied_in_the_order_of_the_channels_of_each_joint() {
    let text = file(&ROWS, "0.0166667");
    let recording = plain(&text, &centimetres());
    assert_eq!(
        recording.truth.placed.len(),
        3,
        "ends and joints without channels are no bodies"
    );
    // A quarter turn about z puts the leg, 10 along x, along y.
    assert_eq!(at(&recording, 1, 0), [100.0, 60.0, 20.0]);
    // The leg turns about its own y; the foot's position is nearer to what leads to it than zero is.
    assert_eq!(at(&recording, 2, 0), [120.0, 60.0, 15.0]);
    // Then about the turned x: first z, then x.
    assert_eq!(at(&recording, 1, 1), [110.0, 60.0, 20.0]);
    assert_eq!(at(&recording, 2, 1), [110.0, 66.0, 1.0]);
    let turned = recording.truth.ticks[0][0].motion.rotation();
    let half = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2)
        * DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2);
    assert!((DQuat::from_array(turned.map(f64::from)).dot(half).abs() - 1.0).abs() < 1e-6);
}

#[test]
fn positions_of_a_joint_have_three_readings_and_the_first_frame_chooses() {
    let flat = "0 0 0 0 0 0 0 0 0";
    let place = |foot: &str, positions| {
        let rows = [
            format!("{flat} {foot} 0 0 0"),
            format!("{flat} {foot} 0 0 1"),
        ];
        let options = ReadOptions {
            positions,
            ..centimetres()
        };
        let text = file(&[&rows[0], &rows[1]], "0.01");
        let recording = plain(&text, &options);
        let [x, y, _] = at(&recording, 2, 0);
        let said = recording
            .notes
            .iter()
            .find(|note| note.contains("--bvh-positions"));
        (x, y, said.cloned().expect("a note"))
    };
    // The foot's offset from the leg is 5, -20.
    let (x, y, note) = place("6 -19 0", None);
    assert_eq!((x, y), (16.0, -19.0), "{note}");
    assert!(note.contains("replace the OFFSET of Foot"), "{note}");
    let (x, y, note) = place("1 1 0", None);
    assert_eq!((x, y), (16.0, -19.0), "{note}");
    assert!(note.contains("are added to the OFFSET of Foot"), "{note}");
    let (x, y, _) = place("6 1 0", Some(PositionChannels::Add));
    assert_eq!((x, y), (21.0, -19.0));
    let (x, y, _) = place("6 1 0", Some(PositionChannels::Replace));
    assert_eq!((x, y), (16.0, 1.0));
    let (x, y, note) = place("6 1 0", Some(PositionChannels::Ignore));
    assert_eq!((x, y), (15.0, -20.0), "{note}");
}

#[test]
fn a_frame_time_of_few_decimals_is_that_of_a_whole_rate() {
    for (time, ticks, seconds, is_said) in [
        ("0.0333333", 30, 1, true),
        ("0.033333", 30, 1, true),
        ("0.0083333", 120, 1, true),
        ("0.008333", 120, 1, true),
        ("0.0041667", 240, 1, true),
        ("0.01", 100, 1, false),
        ("0.0333667", 30_000, 1_001, true),
    ] {
        let recording = plain(&file(&ROWS, time), &centimetres());
        let rate = recording.integrator.rate;
        assert_eq!((rate.ticks(), rate.seconds()), (ticks, seconds), "{time}");
        let said = recording
            .notes
            .iter()
            .any(|note| note.contains("is taken as"));
        assert_eq!(said, is_said, "{time}: {:?}", recording.notes);
    }
    let options = ReadOptions {
        rate: Rate::new(50, 1),
        ..centimetres()
    };
    // A rate that is given comes before the one of the file.
    assert_eq!(
        plain(&file(&ROWS, "0"), &options).integrator.rate.ticks(),
        50
    );
}

#[test]
fn a_file_without_a_unit_is_refused() {
    let whole = file(&ROWS, "0.01");
    let unit = read_bvh("s", &whole, &ReadOptions::default())
        .expect_err("no unit")
        .to_string();
    assert!(unit.contains("--unit cm"), "{unit}");
}

/// Refuses the file with one part in place of another by these words.
fn refuse(cases: &[(&str, &str, &str)]) {
    let whole = file(&ROWS, "0.01");
    for (from, to, words) in cases {
        let text = whole.replacen(from, to, 1);
        let read = read_bvh("s", &text, &centimetres());
        let error = read.expect_err(words).to_string();
        assert!(error.contains(words), "{words}: {error}");
    }
}

#[test]
fn wrong_frames_are_refused_with_their_line() {
    refuse(&[
        (
            "6 -19 0",
            "NaN -19 0",
            "line 29: number 10 of the row: \"NaN\" is no finite number",
        ),
        (
            "6 -19 0",
            "6 -19",
            "line 29: the row has 14 numbers, and there are 15 channels",
        ),
        (
            "Frames: 2",
            "Frames: 3",
            "line 29: the file ends after 2 rows, and Frames says 3",
        ),
        (
            "Frames: 2",
            "Frames: 1",
            "line 29: this is row 2, and Frames says 1",
        ),
        (
            "Frames: 2",
            "Frames: many",
            "line 26: Frames: \"many\" is no count, which is a whole number from 0 to 4294967295",
        ),
        (
            "Frames: 2",
            "Frames: -3",
            "line 26: Frames: \"-3\" is no count",
        ),
        (
            "Frame Time: 0.01",
            "Frame Time: inf",
            "line 27: Frame Time: \"inf\"",
        ),
        (
            "Frame Time: 0.01",
            "Rate: 100",
            "line 27: \"Rate\" stands in the place of Frame Time",
        ),
        (
            "Frame Time: 0.01",
            "Frame Time: 0",
            "0 s is the step of no rate from 1 to 1000 Hz: --rate HZ states the rate of the frames",
        ),
        (
            "Frame Time: 0.01",
            "Frame Time: 1e300",
            "1e300 s is the step of no rate",
        ),
    ]);
}

#[test]
fn a_wrong_skeleton_is_refused_with_its_line() {
    refuse(&[
        (
            "OFFSET 10 0 0",
            "OFFSET 10 0 x",
            "line 7: z of OFFSET: \"x\"",
        ),
        (
            "OFFSET 10 0 0",
            "OFFSET 10 0",
            "line 8: z of OFFSET: \"CHANNELS\"",
        ),
        (
            "    OFFSET 10 0 0\n",
            "",
            "line 7: joint \"Left Leg\" has no OFFSET",
        ),
        (
            "CHANNELS 3",
            "CHANNELS 4",
            "line 9: \"JOINT\" stands in the place of a channel",
        ),
        (
            "CHANNELS 3",
            "CHANNELS 99999999999999999999",
            "line 8: the number of CHANNELS",
        ),
        (
            "CHANNELS 3",
            "CHANNELS -1",
            "line 8: the number of CHANNELS: \"-1\" is no count",
        ),
        (
            "Xposition Yposition",
            "Xposition xposition",
            "line 5: joint \"Hips\" has the channel Xposition twice",
        ),
        (
            "End Site",
            "Hand Site",
            "line 17: \"Hand\" stands in the place of",
        ),
        (
            "ROOT Hips\n",
            "ROOT Hips\nROOT Hips\n",
            "line 3: \"ROOT\" stands in the place of {",
        ),
        (
            "110 50 20",
            "1e12 50 20",
            "line 29: the position is not finite or too large",
        ),
    ]);
    let still = "HIERARCHY\nROOT a {\nOFFSET 0 0 0\n}\nMOTION\n";
    let error = read_bvh("s", still, &centimetres()).expect_err("no channel");
    assert!(
        error.to_string().contains("line 5: no joint has a channel"),
        "{error}"
    );
}

#[test]
fn a_cut_file_is_refused_at_its_end() {
    let whole = file(&ROWS, "0.01");
    let last = whole.trim_end().rfind('\n').expect("rows");
    for end in FIRST.len()..=last {
        let error = read_bvh("s", &whole[..end], &centimetres())
            .expect_err("it is cut")
            .to_string();
        assert!(error.contains("line "), "{end}: {error}");
    }
    for frames in ["18446744073709551615", "10000000"] {
        let text = whole.replacen("Frames: 2", &format!("Frames: {frames}"), 1);
        assert!(read_bvh("s", &text, &centimetres()).is_err(), "{frames}");
    }
}

#[test]
fn a_joint_may_turn_twice_about_one_axis() {
    let text = file(&ROWS, "0.01").replacen(
        "Xrotation Yrotation Zrotation",
        "Zrotation Xrotation Zrotation",
        1,
    );
    assert_eq!(plain(&text, &centimetres()).truth.placed.len(), 3);
}

#[test]
fn equal_names_are_two_bodies() {
    let text = file(&ROWS, "0.01").replace("Foot", "Hips");
    assert_eq!(plain(&text, &centimetres()).truth.placed.len(), 3);
}
