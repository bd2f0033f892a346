//! Worlds of MJCF as scenes: masses, joints, classes, contacts, refusals.

use glam::Vec3;
use rhumb_protocol::scene::{BodyKind, JointKind, Shape, ShapeId};
use rhumb_reckoning::BodyId;

use crate::assemble::LoadedScene;
use crate::files::MemoryFiles;
use crate::load::{load, load_text};
use crate::model::LoadOptions;
use crate::report::{Effect, LoadError};

pub(super) fn read(inside: &str) -> Result<LoadedScene, LoadError> {
    let text = format!("<mujoco model='m'>\n{inside}</mujoco>");
    load_text(
        &MemoryFiles::default(),
        "m.xml",
        &text,
        &LoadOptions::default(),
    )
}

pub(super) fn mass(scene: &LoadedScene, body: usize) -> f32 {
    let desc = scene.bodies[body]
        .builder
        .desc(BodyId::new(0, 0), ShapeId(0));
    desc.mass.map_or(0.0, |mass| mass.mass)
}

#[test]
fn classes_and_angles_reach_the_bodies() {
    let scene = read(
        "<compiler angle='radian' eulerseq='zyx'/><option gravity='0 0 -1' timestep='0.005'/>
        <default><geom density='500'/><default class='thin'><geom type='capsule' size='0.1 0.5'/></default></default>
        <worldbody><geom type='plane' size='1 1 1'/>
          <body name='b' pos='0 0 2' euler='1.5707963267948966 0 0' childclass='thin'><freejoint/><geom/></body>
        </worldbody>",
    )
    .expect("a world");
    assert_eq!(scene.config.gravity, Vec3::new(0.0, 0.0, -1.0));
    assert_eq!(scene.config.integrator.rate.ticks(), 200);
    assert_eq!(scene.bodies[0].builder.kind(), BodyKind::Fixed);
    assert!(matches!(
        scene.bodies[0].builder.shape(),
        Shape::HalfSpace { .. }
    ));
    assert!(
        (mass(&scene, 1) - 17.802_36).abs() < 1e-4,
        "{}",
        mass(&scene, 1)
    );
    let [x, y, z, qx, qy, qz, ..] = scene.bodies[1].builder.state().expect("sound").parts();
    assert_eq!([x, y, z, qx, qy], [0.0, 0.0, 2.0, 0.0, 0.0]);
    assert!((qz - 0.5_f32.sqrt()).abs() < 1e-6);
    assert!(scene.report.is_empty(), "{:?}", scene.report);
}

#[test]
fn flags_of_the_options_hold() {
    let world = "<worldbody><geom size='1 1 1' type='box'/><body name='b'><freejoint/><geom size='1'/></body></worldbody>";
    let off = "<option><flag contact='disable' gravity='disable' energy='enable'/></option>";
    let scene = read(&format!("{world}{off}")).expect("a world");
    assert_eq!(scene.config.gravity, Vec3::ZERO);
    let solids = |shape: &Shape| match shape {
        Shape::Compound(compound) => compound.parts().len(),
        _ => 1,
    };
    let left = scene.bodies.iter();
    assert_eq!(left.map(|body| solids(body.builder.shape())).max(), Some(0));
    assert!(mass(&scene, scene.bodies.len() - 1) > 4_000.0);
    let subjects: Vec<_> = scene
        .report
        .notes()
        .iter()
        .map(|note| note.subject.as_str())
        .collect();
    assert_eq!(subjects, ["flag energy", "geom"]);
    let on = read(&format!("<option><flag contact='enable'/></option>{world}")).expect("a world");
    assert!(on.report.is_empty() && on.config.gravity.z < -9.0 && on.bodies.len() == 2);
}

#[test]
fn frictions_that_differ_are_listed_and_equal_ones_are_not() {
    let subjects = |ground: &str, ball: &str| {
        let scene = read(&format!(
            "<worldbody><geom type='plane' size='1 1 1' friction='{ground}'/>
              <body><freejoint/><geom size='0.1' friction='0.5'/><geom size='0.2' friction='{ball}'/></body></worldbody>"
        ));
        let notes = scene.expect("a world").report;
        let notes = notes.notes().iter();
        notes.map(|note| note.subject.clone()).collect::<Vec<_>>()
    };
    assert!(subjects("0.5", "0.5").is_empty());
    assert_eq!(subjects("0.9", "0.5"), ["friction of pairs"]);
    let both = ["geom friction of several geoms", "friction of pairs"];
    assert_eq!(subjects("0.5", "0.9"), both);
}

#[test]
fn a_passive_joint_pushes_no_more_than_its_spring_and_its_damping_can() {
    let body =
        |joint: &str| format!("<worldbody><body>{joint}<geom size='0.1'/></body></worldbody>");
    for (joint, most) in [
        (
            "<joint stiffness='3' damping='0.5' range='-90 60'/>",
            3.0 * std::f32::consts::FRAC_PI_2 + 5.0,
        ),
        (
            "<joint stiffness='3' springref='45' range='-90 60'/>",
            3.0 * std::f32::consts::FRAC_PI_4 * 3.0,
        ),
        ("<joint damping='0.5'/>", 5.0),
        ("<joint type='slide' stiffness='20' range='-0.5 2'/>", 40.0),
    ] {
        let scene = read(&body(joint)).expect("a world");
        let motors = scene.joints[0].joint.motors;
        let force = motors
            .iter()
            .flatten()
            .map(|motor| motor.force)
            .next()
            .expect("a motor");
        assert!(
            (force - most).abs() < 1e-3 * most,
            "{joint}: {force} N or N m, not {most}"
        );
    }
}

#[test]
fn forces_of_higher_powers_are_listed() {
    let subjects = |joint: &str| {
        let body = format!("<body><joint {joint}/><geom size='0.1'/></body>");
        let scene = read(&format!("<worldbody>{body}</worldbody>")).expect("a world");
        let notes = scene.report.notes().iter();
        notes.map(|note| note.subject.clone()).collect::<Vec<_>>()
    };
    let plain = subjects("stiffness='5 0 0' damping='1 0'");
    assert_eq!(plain, ["damping of joints"]);
    let higher = subjects("stiffness='5 3 2' damping='0 2'");
    let of = |name: &str| format!("joint {name} of higher powers");
    assert_eq!(higher[..2], [of("stiffness"), of("damping")]);
}

#[test]
fn the_armature_of_a_joint_is_in_the_moments_of_the_body_that_it_turns() {
    let ball = 0.4 * 0.01;
    for (joint, moments, effect) in [
        (
            "<joint axis='0 1 0' armature='0.002'/>",
            [ball, ball + 0.002, ball],
            Some(Effect::Approximated),
        ),
        // No solid has a moment above the sum of the others.
        (
            "<joint axis='0 0 1' armature='1'/>",
            [0.5 + ball, 0.5 + ball, 1.0 + 2.0 * ball],
            Some(Effect::Approximated),
        ),
        (
            "<joint type='ball' armature='0.3'/>",
            [ball + 0.3; 3],
            Some(Effect::Approximated),
        ),
        (
            "<joint type='slide' armature='2'/>",
            [ball; 3],
            Some(Effect::Left),
        ),
        ("<joint armature='0'/>", [ball; 3], None),
    ] {
        let scene = read(&format!(
            "<worldbody><body>{joint}<geom size='0.1' mass='1'/></body></worldbody>"
        ));
        let scene = scene.expect("a world");
        let desc = scene.bodies[1].builder.desc(BodyId::new(0, 0), ShapeId(0));
        let own = desc.mass.and_then(|mass| mass.moments).expect("moments");
        let mut own = own.to_array().map(f64::from);
        own.sort_by(f64::total_cmp);
        let mut right = moments;
        right.sort_by(f64::total_cmp);
        for (own, right) in own.into_iter().zip(right) {
            assert!(
                (own - right).abs() < 0.011 * right,
                "{joint}: {own} {right}"
            );
        }
        let notes = scene.report.notes().iter();
        let note = notes.filter(|note| note.subject == "joint armature");
        let effects: Vec<_> = note.map(|note| note.effect).collect();
        assert_eq!(effects, Vec::from_iter(effect), "{joint}");
        assert!((desc.mass.expect("a mass").mass - 1.0).abs() < 1e-6);
        assert!(scene.joints[0].joint.motors.iter().all(Option::is_none));
    }
}

#[test]
fn only_a_body_with_an_armature_has_its_moments_raised_and_says_so() {
    let inertial = "<inertial pos='0 0 0' mass='1' diaginertia='1 1 3'/>";
    for (armature, least, notes) in [("", 1.0, 0), ("armature='0.5'", 1.75, 1)] {
        let scene = read(&format!(
            "<compiler balanceinertia='false'/><worldbody><body>{inertial}<joint axis='0 0 1' {armature}/></body></worldbody>"
        ));
        let scene = scene.expect("a world");
        let desc = &scene.bodies.last().expect("a body").builder;
        let desc = desc.desc(BodyId::new(0, 0), ShapeId(0));
        let own = desc.mass.and_then(|mass| mass.moments).expect("moments");
        assert!(
            (own.min_element() - least).abs() < 1e-5,
            "{armature}: {own}"
        );
        let all = scene.report.notes().iter();
        let raised = all.filter(|note| note.subject == "moments with an armature");
        assert_eq!(raised.count(), notes, "{armature}");
    }
}

#[test]
fn settings_of_a_joint_that_moves_freely_are_listed() {
    let scene = read(
        "<worldbody><body><joint type='free' armature='0.1' springdamper='1 1' damping='0' stiffness='2'/>\
         <geom size='0.1'/></body></worldbody>",
    );
    let scene = scene.expect("a world");
    let notes = scene.report.notes().iter();
    let left: Vec<_> = notes
        .map(|note| (note.subject.as_str(), note.effect))
        .collect();
    let all = ["armature", "springdamper", "stiffness"];
    let all = all.map(|name| format!("joint {name}"));
    let all: Vec<_> = all
        .iter()
        .map(|name| (name.as_str(), Effect::Left))
        .collect();
    assert_eq!(left, all);
}

#[test]
fn a_fly_of_grams_and_small_steps_keeps_its_proportions() {
    let scene = read(
        "<option timestep='0.0001' gravity='0 0 -981'/><worldbody><body name='thorax'><freejoint/>\
         <geom size='0.1' mass='3e-4'/><body name='wing'><joint stiffness='0.5' damping='0.01' armature='1e-6'/>\
         <geom size='0.05' pos='0 0.1 0' mass='1e-6'/></body></body></worldbody>",
    );
    let scene = scene.expect("a world");
    let integrator = scene.config.integrator;
    assert_eq!(
        (integrator.rate.ticks(), integrator.substeps.get()),
        (1_000, 10)
    );
    assert!((mass(&scene, 0) - 0.3).abs() < 1e-6 && (mass(&scene, 1) - 1e-3).abs() < 1e-9);
    // A kilogram of the file has the same acceleration as before: of the wing and its rotor about the joint.
    let inertia = 1e-6 * (0.4 * 0.05 * 0.05 + 0.1 * 0.1) + 1e-6;
    let motor = scene.joints[0].joint.motors[3].expect("a spring");
    let right = 0.5 / inertia;
    let off = f64::from(motor.stiffness) / right - 1.0;
    assert!(off.abs() < 1e-3, "{motor:?} {right}");
    let subjects = scene
        .report
        .notes()
        .iter()
        .map(|note| note.subject.as_str());
    let subjects: Vec<_> = subjects.collect();
    assert!(
        subjects.contains(&"masses") && subjects.contains(&"step"),
        "{subjects:?}"
    );
}

#[test]
fn a_mesh_as_thin_as_a_wing_is_a_box_and_a_thicker_one_a_hull() {
    for (thickness, is_box) in [(0.003, true), (0.01, false)] {
        let corner = |at: usize| {
            let [x, y, z] = [at & 1, at >> 1 & 1, at >> 2];
            format!("{x} {y} {} ", z as f64 * thickness)
        };
        let corners: String = (0..8).map(corner).collect();
        let scene = read(&format!(
            "<asset><mesh name='m' vertex='{corners}'/></asset>\
             <worldbody><body><freejoint/><geom type='mesh' mesh='m'/></body></worldbody>"
        ));
        let scene = scene.expect("a world");
        let shape = match scene.bodies[0].builder.shape() {
            Shape::Compound(compound) => compound.parts()[0].shape.clone(),
            shape => shape.clone(),
        };
        assert_eq!(matches!(shape, Shape::Cuboid { .. }), is_box, "{shape:?}");
        assert_eq!(matches!(shape, Shape::Hull(_)), !is_box, "{shape:?}");
    }
}

#[test]
fn a_spring_with_a_time_constant_has_it_whatever_the_body_weighs() {
    for size in ["0.1", "0.5"] {
        let scene = read(&format!(
            "<worldbody><body><joint springdamper='0.2 0.5' stiffness='7' range='-90 90'/>\
             <geom size='{size}' pos='0 0.3 0'/></body></worldbody>"
        ));
        let scene = scene.expect("a world");
        let motor = scene.joints[0].joint.motors[3].expect("a spring");
        assert!((motor.stiffness - 100.0).abs() < 1e-2, "{motor:?}");
        assert!((motor.damping - 10.0).abs() < 1e-3, "{motor:?}");
        assert!(motor.force > 1.0, "{motor:?}");
    }
}

#[test]
fn several_joints_of_a_body_are_one_or_a_chain_of_the_same_mass() {
    let body = |joints: &str| {
        format!("<worldbody><body>{joints}<geom size='0.1' mass='3'/></body></worldbody>")
    };
    let planar = "<joint type='slide' axis='1 0 0'/><joint type='slide' axis='0 0 -1' range='0 2'/><joint axis='0 1 0'/>";
    let scene = read(&body(planar)).expect("a world");
    assert_eq!((scene.bodies.len(), scene.joints.len()), (2, 1));
    let JointKind::Generic(locked, limits) = scene.joints[0].joint.kind else {
        panic!("three free axes");
    };
    assert_eq!(locked.bits().count_ones(), 3);
    assert_eq!(limits.iter().flatten().count(), 1);
    let apart = "<joint axis='0 1 0'/><joint axis='1 0 0' pos='0 0 0.5'/>";
    let scene = read(&body(apart)).expect("a world");
    assert_eq!((scene.bodies.len(), scene.joints.len()), (3, 2));
    let sum = mass(&scene, 1) + mass(&scene, 2);
    assert!((sum - 3.0).abs() < 1e-6 && mass(&scene, 1) > 0.1);
    assert_eq!(scene.joints[1].bodies, [1, 2]);
}

#[test]
fn an_included_robot_inside_a_body_is_not_lost_and_a_loop_is_named() {
    let mut files = MemoryFiles::default();
    files.insert("x/m.xml", "<mujoco><worldbody><body><joint/><geom size='1'/><include file='parts/arm.xml'/></body></worldbody></mujoco>");
    files.insert(
        "x/parts/arm.xml",
        "<mujocoinclude><body name='arm'><joint/><geom size='1'/></body></mujocoinclude>",
    );
    let scene = load(&files, "x/m.xml", &LoadOptions::default()).expect("a world");
    assert_eq!(scene.joints.len(), 2);
    assert_eq!(scene.bodies[2].name, "arm");
    files.insert(
        "x/parts/arm.xml",
        "<mujocoinclude>\n<include file='m.xml'/></mujocoinclude>",
    );
    let error = load(&files, "x/m.xml", &LoadOptions::default()).expect_err("a loop");
    assert_eq!(
        error.to_string(),
        "x/parts/arm.xml:2: x/m.xml includes itself"
    );
    files.insert(
        "x/parts/arm.xml",
        "<mujocoinclude><include file='arm.xml'/></mujocoinclude>",
    );
    let error = load(&files, "x/m.xml", &LoadOptions::default()).expect_err("a missing file");
    assert!(error.to_string().contains("includes itself"), "{error}");
}

#[test]
fn ten_million_bodies_by_replication_are_refused_at_once() {
    let ball = "<body><freejoint/><geom size='0.1'/></body>";
    let inner = format!("<replicate count='3000' offset='1 0 0'>{ball}</replicate>");
    let nested = format!(
        "<worldbody>\n<replicate count='3400' offset='0 1 0'>{inner}</replicate></worldbody>"
    );
    for (text, line) in [
        (nested, 3),
        (
            format!(
                "<worldbody><replicate count='1e8' offset='1 0 0'>{ball}</replicate></worldbody>"
            ),
            2,
        ),
    ] {
        let sentence = read(&text).expect_err("too many").to_string();
        assert!(
            sentence.starts_with(&format!("m.xml:{line}:")),
            "{sentence}"
        );
        assert!(sentence.contains("all files and copies"), "{sentence}");
    }
    let empty = "<replicate count='500000'>".repeat(3) + &"</replicate>".repeat(3);
    let sep = "x".repeat(1_000_000);
    let long = format!("<replicate count='900000' sep='{sep}'><body/></replicate>");
    let frames = "<frame/>".repeat(1_000);
    let frames = format!("<replicate count='900000'>{frames}</replicate>");
    let wide = format!("<replicate count='900000'><geom user='{sep}' size='1'/></replicate>");
    let other =
        format!("<replicate count='1000'>{ball}</replicate>").replace("<body", "<body name='a'");
    let pairs = "<contact><exclude body1='a' body2='a'/></contact>".repeat(1_000);
    for (text, what) in [
        (empty, "elements"),
        (long, "bytes"),
        (frames, "elements"),
        (wide, "bytes"),
    ] {
        let sentence = read(&format!("<worldbody>\n{text}</worldbody>"));
        let sentence = sentence.expect_err("too many").to_string();
        let start = format!("m.xml:3: the number of {what} of all files and copies");
        assert!(sentence.starts_with(&start), "{sentence}");
    }
    let sentence = read(&format!("<worldbody>{other}</worldbody>{pairs}"));
    let sentence = sentence.expect_err("too many").to_string();
    assert!(sentence.contains("elements of all files"), "{sentence}");
    let few =
        format!("<worldbody><replicate count='4' offset='1 0 0'>{ball}</replicate></worldbody>");
    assert_eq!(read(&few).expect("four").bodies.len(), 4);
}

#[test]
fn elements_of_all_included_files_are_counted_together() {
    let mut files = MemoryFiles::default();
    let geoms = "<geom size='1'/>".repeat(20_000);
    let text = format!("<mujocoinclude><worldbody>{geoms}</worldbody></mujocoinclude>");
    files.insert("b.xml", text);
    let includes = "<include file='b.xml'/>".repeat(900);
    files.insert("m.xml", format!("<mujoco>{includes}</mujoco>"));
    let error = load(&files, "m.xml", &LoadOptions::default()).expect_err("too many");
    let sentence = error.to_string();
    assert!(
        sentence.starts_with("b.xml:1: the number of elements of all files"),
        "{sentence}"
    );
    let spaces = " ".repeat(10 << 20);
    files.insert("b.xml", format!("<mujocoinclude>{spaces}</mujocoinclude>"));
    let error = load(&files, "m.xml", &LoadOptions::default()).expect_err("too many");
    let sentence = error.to_string();
    assert!(
        sentence.starts_with("m.xml:1: the number of bytes of all files"),
        "{sentence}"
    );
    let value = "x".repeat(1 << 20);
    let classes: String = (0..900)
        .map(|number| format!("<default class='{number}'/>"))
        .collect();
    let nested = format!("<default><geom user='{value}'/>{classes}</default>");
    let sentence = read(&nested).expect_err("too many").to_string();
    assert!(sentence.contains("bytes of all files"), "{sentence}");
}

/// Names of the pairs of a world's bodies that do not touch, of those that touch others.
pub(super) fn apart(scene: &LoadedScene) -> Vec<[&str; 2]> {
    let groups = |place: usize| {
        let desc = scene.bodies[place]
            .builder
            .desc(BodyId::new(0, 0), ShapeId(0));
        desc.groups
    };
    let mut pairs = Vec::new();
    for one in 0..scene.bodies.len() {
        for other in one + 1..scene.bodies.len() {
            let (a, b) = (groups(one), groups(other));
            if a.members & b.touches == 0 || b.members & a.touches == 0 {
                pairs.push([one, other].map(|place| scene.bodies[place].name.as_str()));
            }
        }
    }
    pairs
}

/// Names and pairs are those of MuJoCo 4.0.0.
#[test]
fn exclusions_and_loops_hold_in_each_copy_as_in_mujoco() {
    let body = |name: &str, inner: &str| {
        format!("<body name='{name}'><freejoint name='j{name}'/><geom size='0.1'/>{inner}</body>")
    };
    let copies = |count: usize, inner: &str| {
        format!("<replicate count='{count}' offset='1 0 0'>{inner}</replicate>")
    };
    let two = body("a", "") + &body("b", "");
    let world = |inside: String, pair: [&str; 2]| {
        let [one, other] = pair;
        let pair = format!("body1='{one}' body2='{other}'");
        read(&format!(
            "<worldbody>{inside}</worldbody><contact><exclude {pair}/></contact><equality><weld {pair}/></equality>"
        ))
        .expect("a world")
    };
    for (inside, pair, expected) in [
        (
            copies(3, &two),
            ["a", "b"],
            vec![["a0", "b0"], ["a1", "b1"], ["a2", "b2"]],
        ),
        (copies(3, &two), ["a0", "b1"], vec![["a0", "b1"]]),
        (
            body("o", "") + &copies(2, &body("a", "")),
            ["a", "o"],
            vec![["o", "a0"], ["o", "a1"]],
        ),
        (
            copies(2, &(body("a", "") + &copies(2, &body("b", "")))),
            ["a", "b"],
            vec![["a0", "b00"], ["a0", "b10"], ["a1", "b01"], ["a1", "b11"]],
        ),
        (
            copies(2, &copies(2, &two)),
            ["a", "b"],
            vec![
                ["a00", "b00"],
                ["a10", "b10"],
                ["a01", "b01"],
                ["a11", "b11"],
            ],
        ),
    ] {
        let scene = world(inside, pair);
        assert_eq!(apart(&scene), expected);
        let welds = scene.joints.iter().map(|joint| {
            let mut ends = joint.bodies;
            ends.sort_unstable();
            ends.map(|place| scene.bodies[place].name.as_str())
        });
        assert_eq!(welds.collect::<Vec<_>>(), expected);
    }
}

#[test]
fn copies_have_the_names_that_mujoco_gives_them() {
    let ball = "<body name='a'><joint name='j'/><geom size='0.1'/></body>";
    let scene = read(&format!(
        "<worldbody><replicate count='2' sep='_'><replicate count='10' sep='-'>{ball}</replicate></replicate></worldbody>"
    ))
    .expect("a world");
    let names: Vec<_> = scene.bodies[1..]
        .iter()
        .map(|body| body.name.as_str())
        .collect();
    assert_eq!(
        [names[0], names[9], names[10]],
        ["a-00_0", "a-09_0", "a-00_1"]
    );
    assert_eq!(scene.joints[11].name, "j-01_1");
    let twice = "<worldbody><body name='a'/><body name='a'/></worldbody>\n<contact><exclude body1='a' body2='a'/></contact>";
    let sentence = read(twice).expect_err("two have one name").to_string();
    assert_eq!(sentence, "m.xml:3: two have the name of body \"a\"");
}

/// Pose and axis of the joint, and the mass, are those of MuJoCo 4.0.0.
#[test]
fn joints_and_inertias_inside_frames_are_those_of_their_body() {
    let frame = "<frame pos='1 0 0' euler='90 0 0'>";
    let joint = "<joint name='x' pos='0 0 1' axis='0 1 0'/>";
    let mass = "<inertial mass='3' pos='0 0 1' diaginertia='1 1 1'/>";
    let scene = read(&format!(
        "<worldbody><body name='q'>{frame}{joint}{mass}<geom size='1'/></frame></body></worldbody>"
    ))
    .expect("a world");
    assert_eq!((scene.bodies.len(), scene.joints.len()), (2, 1));
    assert_eq!(self::mass(&scene, 1), 3.0);
    let frame = scene.joints[0].joint.frames[0];
    assert!((frame.anchor - Vec3::new(1.0, -1.0, 0.0)).length() < 1e-6);
    assert!((frame.rotation * Vec3::X - Vec3::Z).length() < 1e-6);
}

#[test]
fn wrong_files_are_refused_where_they_are_wrong() {
    for (inside, word) in [
        (
            "<worldbody><geom size='nan'/></worldbody>",
            "must be a number",
        ),
        (
            "<worldbody><geom type='box' size='1 1'/></worldbody>",
            "must have 3",
        ),
        (
            "<worldbody><geom type='ball' size='1'/></worldbody>",
            "stands for nothing",
        ),
        (
            "<worldbody><geom class='x' size='1'/></worldbody>",
            "no default class \"x\"",
        ),
        (
            "<worldbody><geom type='mesh' mesh='x'/></worldbody>",
            "no mesh \"x\"",
        ),
        (
            "<worldbody><geom type='capsule' size='1' fromto='0 0 0 0 0 0'/></worldbody>",
            "two different",
        ),
        (
            "<worldbody><body quat='0 0 0 0'/></worldbody>",
            "no orientation",
        ),
        (
            "<worldbody/><contact><exclude body1='a' body2='b'/></contact>",
            "no body \"a\"",
        ),
        (
            "<asset><mesh name='m' vertex='0 0 0 1'/></asset>",
            "at least 12",
        ),
        (
            "<asset><mesh name='m' vertex='0 0 0 1 0 0 0 1 0 0 0 1' face='0 1 9'/></asset>",
            "face",
        ),
    ] {
        let sentence = read(inside).expect_err(inside).to_string();
        assert!(
            sentence.starts_with("m.xml:2:") && sentence.contains(word),
            "{sentence}"
        );
    }
    let deep = format!(
        "<worldbody>{}{}</worldbody>",
        "<body>".repeat(190),
        "</body>".repeat(190)
    );
    assert!(read(&deep).is_ok());
    let joints = "<body><joint type='free'/><geom size='1'/></body>";
    let scene = read(&format!(
        "<worldbody>{joints}</worldbody><tendon><spatial/></tendon>"
    ));
    assert_eq!(
        scene.expect("a world").report.notes()[0].subject,
        "tendon spatial"
    );
}
