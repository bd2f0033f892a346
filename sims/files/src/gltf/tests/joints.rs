//! Joints of glTF: kinds, frames, limits, drives, and what is refused.

use glam::{Quat, Vec3};
use rhumb_protocol::limits::EXTENT_MAX;
use rhumb_protocol::scene::{BodyKind, JointKind, JointLimits, LockedAxes, Motor};

use super::{file, plain};
use crate::assemble::LoadedScene;
use crate::files::MemoryFiles;
use crate::load::load_text;
use crate::model::LoadOptions;

/// A frame of 2 kg and a door of 1 kg, joined at nodes below them, and the world. `door`: more of the door's node.
fn joined(joints: &str, [other, door]: [&str; 2]) -> String {
    let nodes = format!(
        r#"
        {{"name": "frame", "translation": [0, 2, 0], "children": [1], "extensions": {{"KHR_physics_rigid_bodies": {{"motion": {{"mass": 2}}}}}}}},
        {{"name": "pivot", "translation": [0.5, 0, 0], "extensions": {{"KHR_physics_rigid_bodies": {{
            "joint": {{"joint": 0, "connectedNode": {other}, "enableCollision": true}}}}}}}},
        {{"name": "door", "translation": [1, 2, 0], "children": [3], "extensions": {{"KHR_physics_rigid_bodies": {{"motion": {{"mass": 1}}}}}}}},
        {{"name": "edge", "translation": [-0.5, 0, 0]{door}}},
        {{"name": "post", "translation": [0.5, 2, 0]}}"#
    );
    let rest = format!(
        r#", "extensions": {{"KHR_physics_rigid_bodies": {{"physicsJoints": [{joints}]}}}}"#
    );
    file(&nodes, &rest)
}

const HELD: &str = r#"{"linearAxes": [0, 1, 2], "min": 0, "max": 0}"#;

fn notes(scene: &LoadedScene) -> String {
    let notes = scene.report.notes().iter();
    notes.map(|note| format!("{note}\n")).collect()
}

#[test]
fn limits_that_leave_one_turn_are_a_hinge_with_its_drive() {
    let joint = format!(
        r#"{{"limits": [{HELD}, {{"angularAxes": [0, 2], "max": 0}}, {{"angularAxes": [1], "min": -1, "max": 0.5}}],
        "drives": [{{"type": "angular", "mode": "acceleration", "axis": 1, "maxForce": 7, "positionTarget": 0.25,
            "velocityTarget": 0.125, "stiffness": 40, "damping": 3}}]}}"#
    );
    // 0.6 rad about y.
    let turned = r#", "rotation": [0, 0.29552022, 0, 0.9553365]"#;
    let scene = plain(&joined(&joint, ["3", turned]));
    let [one] = scene.joints.as_slice() else {
        panic!("{}", notes(&scene));
    };
    assert_eq!((one.name.as_str(), one.bodies), ("pivot", [0, 1]));
    let (least, most) = (-1.0, 0.5);
    let limits = Some(JointLimits { least, most });
    assert_eq!(one.joint.kind, JointKind::Revolute(limits));
    assert!(one.joint.collide);
    let motor = Motor {
        velocity: 0.125,
        force: 7.0,
        ..Motor::at_position(0.25, 40.0, 3.0)
    };
    assert_eq!(
        one.joint.motors,
        [None, None, None, Some(motor), None, None]
    );
    let [first, second] = one.joint.frames;
    assert!(first.anchor.distance(Vec3::new(0.5, 0.0, 0.0)) < 1e-6);
    assert!(second.anchor.distance(Vec3::new(-0.5, 0.0, 0.0)) < 1e-6);
    assert!((first.rotation * Vec3::X).distance(Vec3::Y) < 1e-6);
    // The door begins as far open as its node is turned.
    let open = first.rotation.inverse() * second.rotation;
    assert!(
        open.angle_between(Quat::from_rotation_x(0.6)) < 1e-3,
        "{open}"
    );
    assert!(!notes(&scene).contains("joint"), "{}", notes(&scene));
}

#[test]
fn limits_that_leave_one_displacement_are_a_slide_and_drives_in_newton_are_for_its_mass() {
    let joint = r#"{"limits": [{"linearAxes": [0, 1], "max": 0}, {"linearAxes": [2], "min": -0.5}, {"angularAxes": [0, 1, 2], "max": 0}],
        "drives": [{"type": "linear", "mode": "force", "axis": 2, "stiffness": 40, "damping": 6}]}"#;
    let scene = plain(&joined(joint, ["4", ""]));
    let [one] = scene.joints.as_slice() else {
        panic!("{}", notes(&scene));
    };
    // The second node hangs on nothing that moves.
    assert_eq!(one.bodies, [0, 2]);
    assert_eq!(scene.bodies[2].name, "world");
    assert_eq!(scene.bodies[2].builder.kind(), BodyKind::Fixed);
    let JointKind::Prismatic(Some(limits)) = one.joint.kind else {
        panic!("{:?}", one.joint.kind);
    };
    assert_eq!((limits.least, limits.most), (-0.5, EXTENT_MAX));
    let motor = one.joint.motors[0].expect("a drive");
    assert_eq!((motor.stiffness, motor.damping), (20.0, 3.0));
    let [first, second] = one.joint.frames;
    assert!((first.rotation * Vec3::X).distance(Vec3::Z) < 1e-6);
    assert!(second.anchor.distance(Vec3::new(0.5, 2.0, 0.0)) < 1e-6);
}

#[test]
fn joints_that_leave_nothing_or_all_turns_are_read_and_those_that_hold_nothing_are_listed() {
    let kind = |joint: &str, other| {
        let scene = plain(&joined(joint, [other, ""]));
        let kind = scene.joints.first().map(|one| one.joint.kind);
        (kind, notes(&scene))
    };
    let fixed = format!(r#"{{"limits": [{HELD}, {{"angularAxes": [0, 1, 2], "max": 0}}]}}"#);
    assert_eq!(kind(&fixed, "3").0, Some(JointKind::Fixed));
    let ball = format!(
        r#"{{"limits": [{HELD}], "drives": [{{"type": "angular", "mode": "force", "axis": 0, "stiffness": 1}}]}}"#
    );
    let (kind_of_ball, listed) = kind(&ball, "3");
    assert_eq!(kind_of_ball, Some(JointKind::Spherical(None)));
    assert!(!listed.contains("joint drive"), "{listed}");
    let soft = format!(
        r#"{{"limits": [{HELD}, {{"angularAxes": [0, 2], "max": 0}}, {{"angularAxes": [1], "min": -7, "max": 0.5, "stiffness": 9, "damping": 1}}]}}"#
    );
    let (hinge, listed) = kind(&soft, "3");
    assert_eq!(hinge, Some(JointKind::Revolute(None)));
    assert!(listed.contains("joint limit stiffness"), "{listed}");
    assert!(listed.contains("joint limit damping"), "{listed}");
    assert!(listed.contains("joint limit left out"), "{listed}");
    for (joint, other) in [
        (
            r#"{"limits": [{"linearAxes": [0, 1, 2], "max": 0.5}]}"#,
            "3",
        ),
        (fixed.as_str(), "0"),
    ] {
        let (kind, listed) = kind(joint, other);
        assert_eq!(kind, None, "{joint}");
        assert!(listed.contains("joint left out"), "{joint}: {listed}");
    }
}

#[test]
fn limits_that_leave_several_motions_lock_the_others_and_each_has_its_drive() {
    let loaded = |joint: &str| {
        let scene = plain(&joined(joint, ["3", ""]));
        (scene.joints[0].joint, notes(&scene))
    };
    let of = |bits| LockedAxes::new(bits).expect("six bits");
    let universal =
        format!(r#"{{"limits": [{HELD}, {{"angularAxes": [0], "max": 0, "min": 0}}]}}"#);
    let (joint, listed) = loaded(&universal);
    assert_eq!(joint.kind, JointKind::Generic(of(0b1111), [None; 6]));
    assert!(!listed.contains("joint"), "{listed}");
    let (least, most) = (-0.5, 0.25);
    let limits = Some(JointLimits { least, most });
    let screw = r#"{"limits": [{"linearAxes": [0, 1], "max": 0}, {"linearAxes": [2], "min": -0.5, "max": 0.25},
        {"angularAxes": [0, 1], "max": 0}], "drives": [
        {"type": "angular", "mode": "acceleration", "axis": 2, "maxForce": 7, "velocityTarget": 2, "damping": 3},
        {"type": "linear", "mode": "acceleration", "axis": 0, "damping": 3}]}"#;
    let (joint, listed) = loaded(screw);
    let kind = JointKind::Generic(of(0b1_1011), [None, None, limits, None, None, None]);
    assert_eq!(joint.kind, kind);
    let motor = Motor {
        force: 7.0,
        ..Motor::with_velocity(2.0, 3.0)
    };
    assert_eq!(joint.motors, [None, None, None, None, None, Some(motor)]);
    assert!(listed.contains("joint drive left out"), "{listed}");
    let cone =
        format!(r#"{{"limits": [{HELD}, {{"angularAxes": [1], "min": -0.5, "max": 0.25}}]}}"#);
    let (joint, listed) = loaded(&cone);
    assert_eq!(
        joint.kind,
        JointKind::Generic(of(0b111), [None, None, None, None, limits, None])
    );
    assert!(listed.contains("joint approximated"), "{listed}");
}

#[test]
fn a_joint_that_names_nothing_or_makes_no_sense_is_refused_by_name() {
    let refused = |joints: &str, other| {
        let text = joined(joints, [other, ""]);
        let files = MemoryFiles::default();
        let loaded = load_text(&files, "a.gltf", &text, &LoadOptions::default());
        loaded.expect_err("it is wrong").to_string()
    };
    for (joints, other, sentence) in [
        ("", "3", "the joint of pivot names joint 0, and there are 0"),
        (
            "{}",
            "9",
            "the joint of pivot names node 9, and there are 5",
        ),
        ("{}", "null", "the joint of pivot names node none"),
        (
            r#"{"limits": [{"linearAxes": [3], "max": 0}]}"#,
            "3",
            "joint of pivot: the axes of a limit are 0, 1 and 2",
        ),
        (
            r#"{"limits": [{"linearAxes": [0], "min": 1, "max": 0}]}"#,
            "3",
            "the min of a limit is at most its max",
        ),
    ] {
        let error = refused(joints, other);
        assert!(error.contains(sentence), "{sentence}: {error}");
    }
}

#[test]
fn a_drive_that_the_extension_does_not_know_is_refused_by_its_rule() {
    let right = r#""type": "angular", "mode": "force", "axis": 1, "stiffness": 4, "damping": 1, "maxForce": 2"#;
    let loaded = |drive: &str| {
        let joint = format!(
            r#"{{"limits": [{HELD}, {{"angularAxes": [0, 2], "max": 0}}], "drives": [{{{drive}}}]}}"#
        );
        let files = MemoryFiles::default();
        let text = joined(&joint, ["3", ""]);
        load_text(&files, "a.gltf", &text, &LoadOptions::default())
    };
    assert!(loaded(right).is_ok());
    for (own, wrong, rule) in [
        (r#""type": "angular", "#, "", "the type of a drive is"),
        ("angular", "turning", "the type of a drive is"),
        (r#""mode": "force", "#, "", "the mode of a drive is"),
        ("force", "velocity", "the mode of a drive is"),
        (r#""axis": 1"#, r#""axis": 5"#, "the axis of a drive is"),
        (r#""axis": 1, "#, "", "the axis of a drive is"),
        ("4", "-4", "stiffness and damping of a drive are"),
        (
            r#""damping": 1"#,
            r#""damping": -1"#,
            "stiffness and damping",
        ),
        (
            r#""maxForce": 2"#,
            r#""maxForce": -2"#,
            "maxForce of a drive is",
        ),
    ] {
        let drive = right.replacen(own, wrong, 1);
        let error = loaded(&drive).expect_err("it is wrong").to_string();
        let sentence = format!("joint of pivot: {rule}");
        assert!(error.contains(&sentence), "{sentence}: {error}");
    }
}

#[test]
fn a_limit_that_the_extension_does_not_know_is_refused_by_its_rule() {
    let loaded = |limit: &str| {
        let joint = format!(r#"{{"limits": [{HELD}, {{{limit}}}]}}"#);
        let files = MemoryFiles::default();
        let text = joined(&joint, ["3", ""]);
        load_text(&files, "a.gltf", &text, &LoadOptions::default())
    };
    let right = r#""angularAxes": [0, 2], "min": 0, "max": 0, "stiffness": 9, "damping": 1"#;
    assert!(loaded(right).is_ok());
    for (own, wrong, rule) in [
        (r#""angularAxes": [0, 2], "#, "", "a limit has linearAxes"),
        (
            "[0, 2]",
            r#"[0, 2], "linearAxes": [0]"#,
            "a limit has linearAxes",
        ),
        ("[0, 2]", "[]", "a limit has one to three axes"),
        ("[0, 2]", "[0, 0]", "a limit has one to three axes"),
        ("[0, 2]", "[0, 3]", "the axes of a limit are"),
        (r#""max": 0"#, r#""max": -1"#, "the min of a limit is"),
        ("9", "-9", "stiffness and damping of a limit"),
        (
            r#""damping": 1"#,
            r#""damping": -1"#,
            "stiffness and damping of a limit",
        ),
    ] {
        let limit = right.replacen(own, wrong, 1);
        let error = loaded(&limit).expect_err("it is wrong").to_string();
        let sentence = format!("joint of pivot: {rule}");
        assert!(error.contains(&sentence), "{limit}: {error}");
    }
}
