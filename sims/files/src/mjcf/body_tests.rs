//! Bodies of MJCF beside MuJoCo 4.0.0: exclusions, gravity, names, notes.

use rhumb_protocol::scene::ShapeId;
use rhumb_reckoning::BodyId;

use super::tests::{apart, read};
use crate::assemble::LoadedScene;

/// Subjects of all notes.
fn subjects(scene: &LoadedScene) -> Vec<&str> {
    let notes = scene.report.notes().iter();
    notes.map(|note| note.subject.as_str()).collect()
}

/// MuJoCo lets the same balls fall through the same ground.
#[test]
fn exclusions_of_the_world_and_of_bodies_that_nothing_moves_hold_for_their_geoms() {
    let inner = "<body name='s2'><geom name='g3' size='1'/></body>";
    let fixed = format!(
        "<body name='s'><geom name='g1' size='1'/><geom name='g2' size='1'/>{inner}</body>"
    );
    let ball = "<body name='b'><freejoint/><geom size='0.1'/></body>";
    for (one, other, expected) in [
        ("world", "b", vec![["fl", "b"]]),
        ("b", "world", vec![["fl", "b"]]),
        ("s", "b", vec![["g1", "b"], ["g2", "b"]]),
        ("b", "s2", vec![["g3", "b"]]),
    ] {
        let scene = read(&format!(
            "<worldbody><geom name='fl' type='plane' size='1 1 1'/>{fixed}{ball}</worldbody>\
             <contact><exclude body1='{one}' body2='{other}'/></contact>"
        ))
        .expect("a world");
        assert_eq!(apart(&scene), expected, "{one} {other}");
        assert!(scene.report.is_empty(), "{:?}", scene.report);
    }
}

#[test]
fn an_exclusion_of_a_part_of_a_body_holds_for_the_whole_body_and_is_listed() {
    let hand = "<body name='hand'><geom name='palm' size='0.1'/></body>";
    let arm = format!("<body name='arm'><freejoint/>ARM{hand}</body>");
    let ball = "<body name='b'><freejoint/><geom size='0.1'/></body>";
    for (own, part, pairs, notes) in [
        ("<geom size='0.1'/>", "hand", 1, 1),
        ("<geom size='0.1'/>", "arm", 1, 1),
        // MuJoCo, too, has nothing to exclude of a body without geoms.
        (
            "<inertial pos='0 0 0' mass='1' diaginertia='1 1 1'/>",
            "arm",
            0,
            0,
        ),
        (
            "<inertial pos='0 0 0' mass='1' diaginertia='1 1 1'/>",
            "hand",
            1,
            0,
        ),
    ] {
        let arm = arm.replace("ARM", own);
        let scene = read(&format!(
            "<worldbody>{arm}{ball}</worldbody><contact><exclude body1='{part}' body2='b'/></contact>"
        ))
        .expect("a world");
        assert_eq!(apart(&scene).len(), pairs, "{own} {part}");
        let listed = vec!["excluded contacts of a part"; notes];
        assert_eq!(subjects(&scene), listed, "{own} {part}");
    }
}

#[test]
fn the_excluded_body_of_several_joints_is_the_last_of_their_chain() {
    let joints = "<joint axis='0 1 0'/><joint axis='1 0 0' pos='0 0 0.5'/>";
    let scene = read(&format!(
        "<worldbody><geom name='fl' type='plane' size='1 1 1'/><body name='c'>{joints}<geom size='0.1'/></body></worldbody>\
         <contact><exclude body1='c' body2='world'/></contact>"
    ))
    .expect("a world");
    assert!(apart(&scene).contains(&["fl", "c"]), "{:?}", apart(&scene));
}

#[test]
fn compensated_gravity_is_a_factor_on_that_of_the_body() {
    let body = |own: &str, inner: &str| {
        format!(
            "<worldbody><body name='b' {own}><freejoint/><geom size='0.1' mass='1'/>\
             <body {inner}><geom size='0.1' mass='3'/></body></body></worldbody>"
        )
    };
    for (own, inner, factor, notes) in [
        ("", "", 1.0, vec![]),
        ("gravcomp='1'", "gravcomp='1'", 0.0, vec![]),
        ("gravcomp='1.5'", "gravcomp='1.5'", -0.5, vec![]),
        ("gravcomp='1'", "", 0.75, vec!["body gravcomp"]),
        ("", "gravcomp='1'", 0.25, vec!["body gravcomp"]),
    ] {
        let scene = read(&body(own, inner)).expect("a world");
        let desc = scene.bodies[0].builder.desc(BodyId::new(0, 0), ShapeId(0));
        assert_eq!(desc.gravity_scale, factor, "{own} {inner}");
        assert_eq!(subjects(&scene), notes, "{own} {inner}");
    }
}

#[test]
fn a_body_keeps_its_name_from_a_geom_of_the_world() {
    let scene = read(
        "<worldbody><geom name='arm' type='plane' size='1 1 1'/><geom name='fl' size='1'/>\
         <body name='arm'><freejoint/><geom name='arm' size='0.1'/></body></worldbody>",
    )
    .expect("a world");
    let names: Vec<_> = scene.bodies.iter().map(|body| body.name.as_str()).collect();
    assert_eq!(names, ["geom arm", "fl", "arm"]);
    assert_eq!(subjects(&scene), ["geom \"arm\""]);
}

#[test]
fn attributes_and_sections_that_nothing_reads_are_listed() {
    let world = |body: &str| format!("<worldbody><body name='b' {body}</body></worldbody>");
    let ball = "<freejoint/><geom size='0.1'/>";
    let contact = "<contact><exclude body1='b' body2='b'";
    for (text, subject) in [
        (world(&format!("posi='1 0 0'>{ball}")), "body posi"),
        (
            world(&format!("><frame posi='1 0 0'>{ball}</frame>")),
            "frame posi",
        ),
        (
            world("><freejoint/><inertial pos='0 0 0' mass='1' diaginertia='1 1 1' mas='1'/>"),
            "inertial mas",
        ),
        (world(&format!(">{ball}")) + "<foo/>", "foo"),
        (world(&format!(">{ball}")) + "<foo><bar/></foo>", "foo bar"),
        (
            world(&format!(">{ball}")) + "<compiler angel='radian'/>",
            "compiler angel",
        ),
        (
            world(&format!(">{ball}")) + &format!("{contact} solref='1 1'/></contact>"),
            "exclude solref",
        ),
        (
            world(&format!(">{ball}")) + "<equality><weld body1='b' solref='0.1 1'/></equality>",
            "weld solref",
        ),
        (
            world(&format!(">{ball}"))
                + "<asset><mesh name='m' vertex='0 0 0 1 0 0 0 1 0 0 0 1' maxhullvert='8'/></asset>",
            "mesh maxhullvert",
        ),
    ] {
        let scene = read(&text).expect(subject);
        assert_eq!(subjects(&scene), [subject], "{text}");
    }
    let plain = "<compiler angle='radian'/><actuator/><size/><visual/>";
    let scene = read(&(world(&format!(">{ball}")) + plain)).expect("a world");
    assert!(scene.report.is_empty(), "{:?}", scene.report);
}

/// MuJoCo's legs turn alone; here a light body that must turn several heavy ones drives them apart.
#[test]
fn armatures_of_many_joints_on_a_light_body_are_reduced_to_what_it_carries() {
    let leg = "<body><joint axis='0 0 1' armature='1'/><geom size='0.08' mass='0.04'/>\
        <body><joint axis='0 1 0' armature='1'/><geom size='0.08' mass='0.04'/></body></body>";
    let torso = 0.4 * 0.3 * 0.0625;
    let leg_moment = 0.4 * 0.04 * 0.0064;
    for (legs, base, added) in [
        (1, "<freejoint/>", 1.0),
        (2, "<freejoint/>", 1.0),
        (3, "<freejoint/>", 8.0 * torso / 3.0),
        (4, "<freejoint/>", 8.0 * torso / 4.0),
        (4, "", 1.0),
    ] {
        let legs = leg.repeat(legs);
        let scene = read(&format!(
            "<worldbody><body>{base}<geom size='0.25' mass='0.3'/>{legs}</body></worldbody>"
        ))
        .expect("a world");
        // The fixed ball is a body of its own, and the joints are made to the world.
        let first = if base.is_empty() { 2 } else { 1 };
        let most = |place: usize| {
            let desc = &scene.bodies[place].builder;
            let desc = desc.desc(BodyId::new(0, 0), ShapeId(0));
            let moments = desc.mass.and_then(|mass| mass.moments).expect("moments");
            f64::from(moments.max_element())
        };
        // The least moments of a solid with this one are half of it each.
        for (body, right) in [(first, leg_moment + added), (first + 1, leg_moment + 1.0)] {
            let off = most(body) / right - 1.0;
            assert!(off.abs() < 1e-3, "{} {right}", most(body));
        }
        let notes = scene.report.notes().iter();
        let notes = notes.filter(|note| note.subject == "joint \"joint\" armature");
        let values: Vec<_> = notes.map(|note| note.value.as_str()).collect();
        let reduced = if added < 1.0 {
            scene.joints.len() / 2
        } else {
            0
        };
        assert_eq!(values.len(), reduced);
        let start = |value: &&str| value.starts_with("1 kg m², now 0.0");
        assert!(values.iter().all(start), "{values:?}");
    }
}

/// Mass and centre are those of MuJoCo 4.0.0.
#[test]
fn points_without_triangles_weigh_as_their_hull_and_by_the_rule_of_the_mesh() {
    for (rule, mass, centre) in [
        ("", 1_000.0 / 6.0, 0.25),
        ("inertia='convex'", 1_000.0 / 6.0, 0.25),
        ("inertia='exact'", 1_000.0 / 6.0, 0.25),
        ("inertia='shell'", 2_366.025_4, 0.262_891_7),
    ] {
        let mesh = format!("<mesh name='m' vertex='0 0 0 1 0 0 0 1 0 0 0 1' {rule}/>");
        let scene = read(&format!(
            "<asset>{mesh}</asset><worldbody><body><freejoint/><geom type='mesh' mesh='m'/></body></worldbody>"
        ))
        .expect("a world");
        let own = super::tests::mass(&scene, 0);
        assert!((own / mass - 1.0).abs() < 1e-6, "{rule}: {own}");
        let [x, y, z, ..] = scene.bodies[0].builder.state().expect("sound").parts();
        assert!(
            [x, y, z].iter().all(|at| (at - centre).abs() < 1e-6),
            "{rule}"
        );
        assert!(scene.report.is_empty(), "{:?}", scene.report);
    }
}
