//! The JSON scene: read, written, and refused by name.

use super::*;
use crate::files::MemoryFiles;
use crate::load::load_text;

fn load(text: &str) -> Result<LoadedScene, LoadError> {
    load_text(
        &MemoryFiles::default(),
        "scene.json",
        text,
        &LoadOptions::default(),
    )
}

const ARM: &str = "<robot name='arm'><link name='world'/>\
    <link name='a'><inertial><origin xyz='0.1 0 0.2' rpy='1 2 3'/><mass value='2'/><inertia ixx='.1' iyy='.2' izz='.25'/></inertial>\
    <collision><geometry><box size='1 2 3'/></geometry></collision></link>\
    <joint name='j' type='revolute'><parent link='world'/><child link='a'/><axis xyz='1 1 0'/>\
    <limit lower='-5' upper='.5'/><dynamics damping='.1'/></joint></robot>";

#[test]
fn a_robot_written_as_json_reads_back_to_the_bit() {
    let robot = load(ARM).expect("a robot");
    let file = SceneFile::of(&robot);
    let text = serde_json::to_string(&file).expect("numbers are finite");
    let again = load(&text).expect("it was written here");
    let ids = crate::assemble::FreeIds::default();
    assert_eq!(again.commands(ids), robot.commands(ids));
    assert_eq!(again.config, robot.config);
    assert!(again.report.is_empty());
}

#[test]
fn every_number_of_a_body_reads_back_to_the_bit() {
    // Zeros with a sign, numbers below the smallest normal one, and rotations that are a unit within their rounding.
    let wheel = |turn: f32| Quat::from_rotation_y(turn) * Quat::from_rotation_x(-turn * 0.7);
    let rotations = (0..2_000_i16).map(|turn| wheel(f32::from(turn) * 0.013));
    let odd = [Quat::from_xyzw(-0.0, 0.0, -0.0, 1.0), -Quat::IDENTITY];
    for rotation in rotations.chain(odd) {
        let [x, y, z, w] = rotation.to_array();
        let builder = BodyDesc::dynamic(Shape::ball(0.1))
            .position(Vec3::new(-0.0, 1e-45, x * 1e4))
            .rotation(rotation)
            .linear_velocity(Vec3::new(-0.0, y * 1e-39, -w))
            .angular_velocity(Vec3::new(z, -0.0, 0.0));
        let body = LoadedBody {
            name: "b".to_owned(),
            builder,
            tick: 0,
            frame_position: Vec3::ZERO,
            frame_rotation: Quat::IDENTITY,
        };
        let config = SceneConfig::default();
        let scene = LoadedScene {
            name: "s".to_owned(),
            config,
            bodies: vec![body],
            joints: Vec::new(),
            report: Report::default(),
        };
        let text = serde_json::to_string(&SceneFile::of(&scene)).expect("numbers are finite");
        let again = load(&text).expect("it was written here");
        let ids = crate::assemble::FreeIds::default();
        assert_eq!(again.commands(ids), scene.commands(ids), "{rotation}");
    }
}

#[test]
fn a_body_that_no_scene_adds_is_refused_by_its_name_in_words_of_the_file() {
    let body = |kind: &str, shape: &str| {
        format!("{{\"name\": \"b\", {kind}, \"shape\": {shape}, \"position\": [0, 1, 0]}}")
    };
    let scene = |bodies: &str, joints: &str| {
        format!("{{\"version\": 1, \"bodies\": [{bodies}], \"joints\": [{joints}]}}")
    };
    let dynamic = "\"dynamic\": true";
    let ball = "{\"ball\": {\"radius\": 0.5}}";
    let mesh = "{\"mesh\": {\"points\": [[0,0,0],[1,0,0],[0,1,0]], \"triangles\": [[0,1,2]]}}";
    let hull = "{\"hull\": {\"points\": [[0,0,0],[1,0,0],[0,1,0],[0,0,1]]}}";
    let part = "{\"position\": [1,0,0], \"shape\": {\"ball\": {\"radius\": 0.3}}}";
    let compound = format!("{{\"compound\": {{\"parts\": [{part}]}}}}");
    let joint = "{\"name\": \"j\", \"bodies\": [0, 0], \"kind\": \"fixed\", \"frames\": [{\"position\": [0,1,0]}, {\"position\": [0,0,0]}]}";
    let both = "\"dynamic\": true, \"kinematic\": true";
    for (text, words) in [
        (scene(&body(both, ball), ""), ["body 0 \"b\"", "both true"]),
        (
            scene(&body(dynamic, mesh), ""),
            ["body 0 \"b\"", "no volume"],
        ),
        (
            scene(&body(dynamic, hull), ""),
            ["body 0 \"b\"", "0.25, 0.25, 0.25] m: subtract"],
        ),
        (
            scene(&body(dynamic, &compound), ""),
            ["body 0 \"b\"", "[1.0, 0.0, 0.0] m: subtract"],
        ),
        (
            scene(&body(dynamic, ball), joint),
            ["joint 0 \"j\"", "body 0 \"b\" with itself"],
        ),
    ] {
        let sentence = load(&text).expect_err("it is wrong").to_string();
        assert!(sentence.starts_with("scene.json"), "{sentence}");
        assert!(
            words.iter().all(|word| sentence.contains(word)),
            "{sentence}"
        );
        assert!(!sentence.contains("BodyBuilder"), "{sentence}");
    }
    let own = "\"dynamic\": true, \"mass\": 1, \"moments\": [1, 1, 1]";
    assert!(load(&scene(&body(own, hull), "")).is_ok());
    assert!(load(&scene(&body("\"dynamic\": false", hull), "")).is_ok());
}

#[test]
fn unknown_fields_are_noted_and_wrong_ones_refused_by_name() {
    let body = |more: &str| {
        format!(
            "{{\"version\": 1, \"bodies\": [{{\"dynamic\": true, \"shape\": {{\"ball\": {{\"radius\": 0.5}}}}, \"position\": [0, 1, 0]{more}}}]}}"
        )
    };
    let scene = load(&body(", \"colour\": \"red\"")).expect("a ball");
    assert_eq!(scene.report.notes()[0].subject, "colour of body 0");
    for (text, word) in [
        (body(", \"mass\": -1"), "body 0: mass is -1"),
        (body(", \"mass\": 1e60"), "mass"),
        (body(", \"moments\": [5, 6, 7]"), "body 0: moments without mass"),
        (body("").replace("0.5", "0.5, \"colour\": 1"), "unknown field `colour`"),
        (body(", \"mass\": \"much\""), "invalid type"),
        (body("").replace("0.5", "0"), "radius of a ball"),
        (body("").replace(": 1,", ": 2,"), "version above 1"),
        (body("").replace("}]}", "}], \"step_s\": 0}"), "step_s"),
        (body("")[..60].to_owned(), "EOF"),
        (body("").replace("}]}", "}], \"joints\": [{\"bodies\": [0, 7], \"kind\": \"fixed\", \"frames\": [{\"position\": [0,0,0]}, {\"position\": [0,0,0]}]}]}"), "no body"),
        (body("").replace("}]}", "}], \"joints\": [{\"bodies\": [0, 0], \"kind\": {\"generic\": {\"locked\": 64, \"limits\": [null, null, null, null, null, null]}}, \"frames\": [{\"position\": [0,0,0]}, {\"position\": [0,0,0]}]}]}"), "bits 0 to 5"),
        (body("").replace("}]}", "}], \"joints\": [{\"bodies\": [0, 0], \"kind\": \"fixed\", \"motors\": {\"6\": {\"position\": 0, \"velocity\": 0, \"stiffness\": 1, \"damping\": 1, \"force\": 1}}, \"frames\": [{\"position\": [0,0,0]}, {\"position\": [0,0,0]}]}]}"), "axis of a motor is 0 to 5"),
    ] {
        let sentence = load(&text).expect_err("it is wrong").to_string();
        assert!(sentence.starts_with("scene.json") && sentence.contains(word), "{text}\n{sentence}");
    }
}

fn refused(text: &str) -> String {
    let options = LoadOptions::default();
    let read = load_text(&MemoryFiles::default(), "s.json", text, &options);
    read.expect_err(text).to_string()
}

#[test]
fn a_wrong_field_is_named_with_its_body_in_words_of_the_format() {
    let body = |more: &str| {
        let ball = r#"{"dynamic": true, "shape": {"ball": {"radius": 1}}, "position": [0, 0, 0]}"#;
        let own = r#"{"name": "b", "dynamic": true, "position": [0, 0, 0]"#;
        format!(r#"{{"bodies": [{ball}, {own}{more}}}]}}"#)
    };
    let ball = r#", "shape": {"ball": {"radius": 1}}"#;
    for (text, words) in [
        (body(""), "s.json:1: body 1 \"b\": missing field `shape`"),
        (
            body(r#", "shape": {"ball": {"radius": 1}, "cuboid": {"half_extents": [1, 1, 1]}}"#),
            "s.json:1: shape of body 1 \"b\": ",
        ),
        (
            body(r#", "shape": {"bal": {"radius": 1}}"#),
            "shape of body 1 \"b\": unknown word `bal`, expected one of `ball`",
        ),
        (
            body(&format!(r#"{ball}, "tick": 1.5"#)),
            "tick of body 1 \"b\": invalid type: floating point `1.5`, expected a whole number from zero",
        ),
        (
            body(&format!(r#"{ball}, "linear": [1, 2]"#)),
            "linear of body 1 \"b\": invalid length 2, expected an array of length 3",
        ),
        (r#"{"bodies": [[]]}"#.to_owned(), "body 0: invalid "),
        (
            r#"{"bodies": {}}"#.to_owned(),
            "bodies of the scene: invalid type: object, expected a list",
        ),
        (
            r#"{"substeps": "4"}"#.to_owned(),
            "substeps of the scene: invalid type: string \"4\", expected a whole number from zero",
        ),
        (
            r#"{"joints": [{"name": "j", "bodies": [0, -1], "kind": "fixed", "frames": []}]}"#
                .to_owned(),
            "bodies of joint 0 \"j\": invalid value: integer `-1`, expected a whole number from zero",
        ),
        (r#"{"bodies": [}"#.to_owned(), "not well formed"),
    ] {
        let sentence = refused(&text);
        assert!(sentence.contains(words), "{sentence}\n{words}");
        let types = ["u32", "usize", "struct", "SceneFile", "sequence"];
        assert!(
            types.iter().all(|name| !sentence.contains(name)),
            "{sentence}"
        );
    }
}
