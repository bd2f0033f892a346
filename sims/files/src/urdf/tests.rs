//! Robots of URDF: links, joints, and what is refused.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyKind, LockedAxes, Shape, ShapeId};
use rhumb_reckoning::BodyId;

use crate::assemble::{LoadedJoint, LoadedScene};
use crate::files::MemoryFiles;
use crate::load::{load, load_text};
use crate::model::{Base, LoadOptions};
use crate::report::LoadError;

fn read(text: &str) -> Result<LoadedScene, LoadError> {
    load_text(
        &MemoryFiles::default(),
        "robot.urdf",
        text,
        &LoadOptions::default(),
    )
}

const MASS: &str = "<inertial><mass value='2'/><inertia ixx='1' iyy='2' izz='2.5' ixy='0' ixz='0' iyz='0'/></inertial>";

fn two_links(joint: &str) -> String {
    format!(
        "<robot name='r'>\n<link name='a'>{MASS}</link>\n<link name='b'>{MASS}</link>\n\
        <joint name='j' {joint}<parent link='a'/><child link='b'/></joint></robot>"
    )
}

#[test]
fn what_a_joint_says_and_cannot_have_is_listed() {
    for (joint, subjects) in [
        (
            "<dynamics damping='-3' friction='-1'/>",
            vec!["joint \"j\" damping", "joint \"j\" friction"],
        ),
        ("<dynamics dampng='3'/>", vec!["dynamics dampng"]),
        ("<limit lowr='-1' upper='1'/>", vec!["limit lowr"]),
        ("<limit lower='-1' upper='1'/>", vec![]),
    ] {
        let kind = match joint.contains("limit") {
            true => "revolute",
            false => "continuous",
        };
        let scene = read(&two_links(&format!("type='{kind}'>{joint}"))).expect("a robot");
        let notes = scene.report.notes().iter();
        let found: Vec<_> = notes.map(|note| note.subject.as_str()).collect();
        assert_eq!(found, subjects);
        assert!(scene.joints[0].joint.motors.iter().all(Option::is_none) || !joint.contains('-'));
    }
}

#[test]
fn moments_of_a_point_are_none() {
    let link = |moment: &str, shape: &str| {
        format!(
            "<robot name='r'><link name='a'><inertial><mass value='2'/>\
             <inertia ixx='{moment}' iyy='{moment}' izz='{moment}' ixy='0' ixz='0' iyz='0'/></inertial>{shape}</link></robot>"
        )
    };
    let shape = "<collision><geometry><sphere radius='0.5'/></geometry></collision>";
    for (moment, shape, right, notes) in [
        ("4e-18", shape, 0.2, 1),
        ("-5e-20", shape, 0.2, 1),
        ("1e-18", "", 0.008, 1),
        ("3e-6", shape, 3e-6, 0),
    ] {
        let scene = read(&link(moment, shape)).expect("a link");
        let desc = scene.bodies[0].builder.desc(BodyId::new(0, 0), ShapeId(0));
        let moments = desc.mass.and_then(|mass| mass.moments).expect("moments");
        assert!(
            (f64::from(moments.x) / right - 1.0).abs() < 1e-3,
            "{moments}"
        );
        assert_eq!(scene.report.notes().len(), notes, "{moment}");
    }
}

#[test]
fn the_rotation_of_the_inertial_turns_the_moments() {
    let text = "<robot name='r'><link name='a'><inertial><origin xyz='1 2 3' rpy='0 0 1.5707963267948966'/>\
        <mass value='4'/><inertia ixx='1' iyy='2' izz='2.5'/></inertial>\
        <collision><origin xyz='1 2 3'/><geometry><sphere radius='0.5'/></geometry></collision></link></robot>";
    let scene = read(text).expect("a robot");
    let [body] = scene.bodies.as_slice() else {
        panic!("one link is one body");
    };
    let desc = body.builder.desc(BodyId::new(0, 0), ShapeId(0));
    let moments = desc
        .mass
        .and_then(|mass| mass.moments)
        .expect("it has moments");
    assert!(
        (moments - Vec3::new(2.0, 1.0, 2.5)).length() < 1e-6,
        "{moments}"
    );
    let state = body.builder.state().expect("it is sound");
    assert_eq!(state.position(), [1.0, 2.0, 3.0]);
    assert_eq!(*body.builder.shape(), Shape::ball(0.5));
    assert_eq!(body.frame_position, Vec3::new(-1.0, -2.0, -3.0));
    assert!(scene.report.is_empty(), "{:?}", scene.report);
}

#[test]
fn a_file_of_nothing_that_moves_is_not_scaled() {
    let options = LoadOptions {
        base: Base::Fixed,
        ..LoadOptions::default()
    };
    let light = MASS.replace("value='2'", "value='1e-5'");
    for inertial in [MASS, &light, ""] {
        let text = format!("<robot name='r'><link name='a'>{inertial}</link></robot>");
        let scene = load_text(&MemoryFiles::default(), "robot.urdf", &text, &options);
        let scene = scene.expect("a link");
        assert_eq!(scene.bodies.len(), 1);
        assert!(scene.report.is_empty(), "{:?}", scene.report);
    }
}

#[test]
fn fixed_joints_merge_links_and_add_their_masses() {
    let scene = read(&two_links("type='fixed'><origin xyz='1 0 0'/>")).expect("a robot");
    assert_eq!((scene.bodies.len(), scene.joints.len()), (1, 0));
    let desc = scene.bodies[0].builder.desc(BodyId::new(0, 0), ShapeId(0));
    let mass = desc.mass.expect("it has a mass");
    assert_eq!(mass.mass, 4.0);
    // Each half is half a metre from the centre: 2 · 2 kg · 0.25 m² more across.
    let moments = mass.moments.expect("it has moments");
    assert!(
        (moments - Vec3::new(2.0, 5.0, 6.0)).length() < 1e-5,
        "{moments}"
    );
}

#[test]
fn a_joint_turns_about_its_axis_at_its_origin() {
    let joint = "type='revolute'><origin xyz='0 0 1' rpy='0 0 1.5707963267948966'/><axis xyz='0 2 0'/>\
        <limit lower='-4' upper='1' effort='3' velocity='1'/><dynamics friction='0.5'/>";
    let scene = read(&two_links(joint)).expect("a robot");
    let joint = scene.joints[0].joint;
    let limits = joint.kind.limits()[3].expect("it has limits");
    assert_eq!([limits.least, limits.most], [-4.0, 1.0]);
    let state = scene.bodies[1].builder.state().expect("it is sound");
    let [_, _, z, qx, qy, qz, w, ..] = state.parts();
    assert_eq!(z, 1.0);
    let turn = Quat::from_xyzw(qx, qy, qz, w);
    // y of the joint, which a quarter about z turns to -x.
    for (body, frame) in [Quat::IDENTITY, turn].into_iter().zip(joint.frames) {
        let axis = body * (frame.rotation * Vec3::X);
        assert!((axis + Vec3::X).length() < 1e-6, "{axis}");
    }
    let motor = joint.motors[3].expect("friction is a motor without force beyond it");
    assert_eq!((motor.force, motor.stiffness), (0.5, 0.0));
    assert_eq!(
        scene.report.notes().len(),
        1,
        "effort and velocity: {:?}",
        scene.report
    );
}

#[test]
fn a_joint_with_damping_has_its_dry_friction_in_a_joint_that_holds_nothing() {
    let joint = "type='prismatic'><axis xyz='0 0 1'/><dynamics damping='2' friction='0.5'/>";
    let scene = read(&two_links(joint)).expect("a robot");
    let [slide, brake] = scene.joints.as_slice() else {
        panic!("{:?}", scene.joints);
    };
    let force = |joint: &LoadedJoint| joint.joint.motors.map(|own| own.map(|own| own.force));
    assert_eq!(force(slide)[0], Some(20.0));
    assert_eq!(force(brake), [Some(0.5), None, None, None, None, None]);
    assert_eq!(brake.joint.kind.locked(), LockedAxes::NONE);
    assert_eq!(brake.joint.frames, slide.joint.frames);
    assert_eq!(brake.bodies, slide.bodies);
    assert_eq!(brake.name, format!("{} friction", slide.name));
}

#[test]
fn wrong_trees_are_refused_by_name() {
    let link = |name: &str| format!("<link name='{name}'>{MASS}</link>");
    let joint = |name: &str, from: &str, to: &str| {
        format!(
            "<joint name='{name}' type='continuous'><parent link='{from}'/><child link='{to}'/></joint>"
        )
    };
    let (a, b, c) = (link("a"), link("b"), link("c"));
    for (inside, word) in [
        (
            format!("{a}{b}{}{}", joint("i", "a", "b"), joint("j", "b", "a")),
            "hangs on itself",
        ),
        (
            format!("{a}{b}{c}{}{}", joint("i", "b", "c"), joint("j", "c", "b")),
            "\"b\" hangs on itself",
        ),
        (
            format!("{a}{b}{c}{}{}", joint("i", "a", "c"), joint("j", "b", "c")),
            "two joints",
        ),
        (format!("{a}{b}"), "2 links hang on no joint"),
        (format!("{a}{}", joint("i", "a", "x")), "no link \"x\""),
        (format!("{a}{a}"), "two have the name"),
        (format!("{a}{}", joint("i", "a", "a")), "hangs on itself"),
        (String::new(), "0 links"),
    ] {
        let error = read(&format!("<robot name='r'>\n{inside}</robot>")).expect_err("it is wrong");
        let sentence = error.to_string();
        assert!(sentence.contains(word), "{sentence}");
        assert!(sentence.starts_with("robot.urdf:"), "{sentence}");
    }
}

#[test]
fn wrong_numbers_are_refused_where_they_stand() {
    for (from, to, word) in [
        ("value='2'", "value='nan'", "must be a number"),
        ("value='2'", "value='1e300'", "must be a number"),
        ("value='2'", "value='-2'", "not negative"),
        ("ixx='1'", "ixx='1 2'", "has 2 numbers, and must have 1"),
        ("ixx='1'", "ixx='${m}'", "must be a number"),
    ] {
        let text = two_links("type='fixed'>").replacen(from, to, 1);
        let sentence = read(&text).expect_err("it is wrong").to_string();
        assert!(
            sentence.starts_with("robot.urdf:2:") && sentence.contains(word),
            "{sentence}"
        );
    }
    let whole = two_links("type='fixed'>");
    for cut in (0..whole.len() - 1).step_by(7) {
        assert!(read(&whole[..cut]).is_err(), "{cut}");
    }
}

#[test]
fn a_link_without_mass_is_fixed_as_the_root_and_light_elsewhere() {
    let text = format!(
        "<robot name='r'><link name='a'/><link name='b'/><link name='c'>{MASS}</link>\
        <joint name='i' type='continuous'><parent link='a'/><child link='b'/></joint>\
        <joint name='j' type='continuous'><parent link='b'/><child link='c'/></joint></robot>"
    );
    let scene = read(&text).expect("a robot");
    assert_eq!(scene.bodies[0].builder.kind(), BodyKind::Fixed);
    let desc = scene.bodies[1].builder.desc(BodyId::new(1, 0), ShapeId(0));
    assert_eq!(desc.mass.map(|mass| mass.mass), Some(0.02));
    assert_eq!(scene.report.notes().len(), 2, "{:?}", scene.report);
}

#[test]
fn meshes_of_packages_are_found_above_the_file_and_lost_ones_are_noted() {
    let mut files = MemoryFiles::default();
    let text = "<robot name='r'><link name='a'><collision><geometry><mesh filename='package://p/a.obj' scale='2 2 2'/>\
        </geometry></collision><collision><geometry><mesh filename='package://p/b.stl'/></geometry></collision></link></robot>";
    files.insert("x/p/urdf/r.urdf", text);
    files.insert(
        "x/p/a.obj",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n",
    );
    let scene = load(&files, "x/p/urdf/r.urdf", &LoadOptions::default()).expect("a robot");
    let lost: Vec<_> = scene
        .report
        .notes()
        .iter()
        .map(|note| note.value.as_str())
        .collect();
    assert!(lost.contains(&"package://p/b.stl"), "{lost:?}");
    assert!(matches!(scene.bodies[0].builder.shape(), Shape::Mesh(_)));
    let options = LoadOptions {
        base: Base::Free,
        ..LoadOptions::default()
    };
    let scene = load(&files, "x/p/urdf/r.urdf", &options).expect("a robot");
    assert!(!matches!(scene.bodies[0].builder.shape(), Shape::Mesh(_)));
    let desc = scene.bodies[0].builder.desc(BodyId::new(0, 0), ShapeId(0));
    // A sixth of a cube of 2 m, of water.
    let mass = desc.mass.map(|mass| mass.mass).expect("it has a mass");
    assert!((mass - 8_000.0 / 6.0).abs() < 0.01, "{mass}");
}
