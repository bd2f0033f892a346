//! Scenes in which so many bodies overlap that a step would not end.
//!
//! Each heap is one of those that took a server down: by commands before the first step, by poses, by shapes, kinds and
//! groups that change, by motion, by spin, by the pull of joints, and within a step that has parts. Proved by what the
//! scene refuses, and by the steps that it still takes. A heap at the limit is stepped, and so is every lawful scene
//! here. Caught: 516 kB of commands ended a server of 3 GiB.

use glam::{Quat, Vec3};
use rhumb_protocol::message::ClientMessage;
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, CollisionGroups, Command, CommandError, Hull, Joint, JointFrame, JointId,
    JointKind, SceneConfig, Shape, ShapeId, Stepping,
};
use rhumb_protocol::{Peer, Span};
use rhumb_reckoning::{BodyId, BodyState, Tick};
use rhumb_scene::engine::EngineFault;
use rhumb_scene::{Scene, SceneFault};

use crate::links::Links;

const LIMIT: u32 = 16_384;
const PEER: Peer = Peer(1);

fn scene(shapes: &[Shape]) -> Scene {
    let mut scene = Scene::new(SceneConfig::default()).expect("a plain scene");
    scene.bound_crowding(LIMIT);
    for (id, shape) in (0..).zip(shapes) {
        let (id, shape) = (ShapeId(id), shape.clone());
        scene
            .apply(&Command::AddShape { id, shape })
            .expect("a sound command");
    }
    scene
}

fn add(index: u32, kind: BodyKind, position: Vec3, velocity: Vec3) -> Command {
    turned(index, kind, position, velocity, Quat::IDENTITY)
}

fn turned(index: u32, kind: BodyKind, position: Vec3, velocity: Vec3, turn: Quat) -> Command {
    let desc = BodyDesc::plain(BodyId::new(index, 0), kind, ShapeId(0));
    let (position, velocity) = (position.to_array(), velocity.to_array());
    let motion = BodyState::new(position, turn.to_array(), velocity, [0.0; 3]).expect("finite");
    Command::AddBody { desc, motion }
}

/// A point of a spiral through a ball of this radius: no two are equal.
fn spiral(index: u32, of: u32, radius: f32) -> Vec3 {
    let height = 1.0 - 2.0 * (index as f32 + 0.5) / of as f32;
    let (sine, cosine) = (index as f32 * 2.4).sin_cos();
    let across = (1.0 - height * height).sqrt();
    radius * Vec3::new(across * cosine, height, across * sine)
}

/// Adds as many bodies as the scene takes; all others must be refused for the crowd.
fn crowd(scene: &mut Scene, commands: impl Iterator<Item = Command>) -> usize {
    let mut taken = 0;
    for command in commands {
        match scene.apply(&command) {
            Ok(()) => taken += 1,
            Err(error) => assert_eq!(error, CommandError::TooCrowded),
        }
    }
    taken
}

#[test]
fn heaps_that_would_not_end_are_refused_beyond_the_limit_and_what_is_left_steps() {
    let ball = |index| {
        add(
            index,
            BodyKind::Dynamic,
            spiral(index, 5_000, 0.05),
            Vec3::ZERO,
        )
    };
    let cuboid = |index| {
        add(
            index,
            BodyKind::Dynamic,
            spiral(index, 1_500, 0.1),
            Vec3::ZERO,
        )
    };
    let crossed = |index| {
        let turn = Quat::from_rotation_y(index as f32 * 0.01) * Quat::from_rotation_z(1.57);
        turned(
            index,
            BodyKind::Dynamic,
            Vec3::Y * index as f32 * 1e-3,
            Vec3::ZERO,
            turn,
        )
    };
    let heaps: [(&str, Shape, Vec<Command>); 4] = [
        ("balls", Shape::ball(0.5), (0..5_000).map(ball).collect()),
        (
            "boxes",
            Shape::cuboid(0.5, 0.5, 0.5),
            (0..1_500).map(cuboid).collect(),
        ),
        (
            "capsules",
            Shape::capsule(50.0, 0.1),
            (0..10_000).map(crossed).collect(),
        ),
        (
            "cylinders",
            Shape::cylinder(0.5, 0.5),
            (0..1_000).map(cuboid).collect(),
        ),
    ];
    for (name, shape, commands) in heaps {
        let mut scene = scene(&[shape]);
        let taken = crowd(&mut scene, commands.into_iter());
        // Boxes of capsules are thin where these point along an axis.
        assert!((50..2_000).contains(&taken), "{name}: {taken}");
        scene.step().expect("a step of few pairs");
        assert_eq!(scene.body_count(), taken, "{name}");
    }
}

#[test]
fn lawful_heaps_carpets_and_bodies_on_large_ones_are_taken() {
    let mut scene = scene(&[
        Shape::cuboid(0.5, 0.5, 0.5),
        Shape::cuboid(500.0, 0.5, 500.0),
    ]);
    for index in 0..20_000_u32 {
        let place = Vec3::new(
            (index % 100) as f32,
            (index / 10_000) as f32,
            (index / 100 % 100) as f32,
        );
        scene
            .apply(&add(index, BodyKind::Dynamic, place, Vec3::ZERO))
            .expect("a sound command");
    }
    for (index, kind) in [(20_000, BodyKind::Fixed), (20_001, BodyKind::Kinematic)] {
        let desc = BodyDesc::plain(BodyId::new(index, 0), kind, ShapeId(1));
        let motion = BodyState::new([0.0, -1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        let motion = motion.expect("finite");
        scene
            .apply(&Command::AddBody { desc, motion })
            .expect("a sound command");
    }
    // Fixed bodies do not meet one another.
    for index in 30_000..31_000 {
        let place = Vec3::new(-900.0, 0.0, 0.0);
        scene
            .apply(&add(index, BodyKind::Fixed, place, Vec3::ZERO))
            .expect("a sound command");
    }
    scene.step().expect("a step of few pairs");
}

#[test]
fn a_tray_of_any_shape_under_thousands_of_balls_is_no_crowd() {
    let corners: Vec<Vec3> = (0..8)
        .map(|corner| {
            let side = |bit: u32| if corner & (1 << bit) == 0 { -1.0 } else { 1.0 };
            Vec3::new(10.0 * side(0), 0.1 * side(1), 10.0 * side(2))
        })
        .collect();
    let trays = [
        Shape::cuboid(10.0, 0.1, 10.0),
        Shape::cylinder(0.1, 15.0),
        Shape::Hull(Hull::new(&corners).expect("eight corners")),
        Shape::RoundedCuboid {
            half_extents: Vec3::new(10.0, 0.1, 10.0),
            radius: 0.05,
        },
    ];
    for tray in trays {
        let name = format!("{tray:?}");
        let mut scene = scene(&[Shape::ball(0.1), tray]);
        for index in 0..3_600_u32 {
            let across = |number: u32| (number as f32 - 29.5) * 0.21;
            let place = Vec3::new(across(index % 60), 0.2, across(index / 60));
            let ball = add(index, BodyKind::Dynamic, place, Vec3::ZERO);
            scene.apply(&ball).expect("balls apart");
        }
        scene.step().expect("a step without pairs");
        let desc = BodyDesc::plain(BodyId::new(3_600, 0), BodyKind::Fixed, ShapeId(1));
        let motion = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        let motion = motion.expect("finite");
        let added = scene.apply(&Command::AddBody { desc, motion });
        assert_eq!(added, Ok(()), "{name}");
        scene.step().expect("a step of few pairs");
    }
}

/// Bodies that stand apart, of a scene that has been stepped.
fn apart(count: u32, kind: BodyKind, velocity: impl Fn(Vec3) -> Vec3) -> Scene {
    let mut scene = scene(&[Shape::ball(0.5), Shape::ball(40.0)]);
    for index in 0..count {
        let place = spiral(index, count, 60.0);
        scene
            .apply(&add(index, kind, place, velocity(place)))
            .expect("a sound command");
    }
    scene.step().expect("a step of few pairs");
    scene
}

fn too_crowded(scene: &mut Scene) {
    let (tick, digest) = (scene.tick(), scene.digest());
    let fault = scene.step().expect_err("it is too crowded");
    assert!(
        matches!(fault, SceneFault::TooCrowded { limit: LIMIT, .. }),
        "{fault}"
    );
    assert_eq!(
        (scene.tick(), scene.digest()),
        (tick, digest),
        "nothing has changed"
    );
}

#[test]
fn poses_shapes_kinds_and_motion_that_crowd_a_scene_fail_the_step_before_it_begins() {
    let mut scene = apart(1_000, BodyKind::Dynamic, |_| Vec3::ZERO);
    for index in 0..1_000 {
        let (id, position) = (BodyId::new(index, 0), spiral(index, 1_000, 0.1));
        let rotation = Quat::IDENTITY;
        scene
            .apply(&Command::SetPose {
                id,
                position,
                rotation,
            })
            .expect("a sound command");
    }
    too_crowded(&mut scene);

    let mut scene = apart(1_000, BodyKind::Dynamic, |_| Vec3::ZERO);
    for desc in scene.bodies().copied().collect::<Vec<_>>() {
        let desc = BodyDesc {
            shape: ShapeId(1),
            ..desc
        };
        scene
            .apply(&Command::ChangeBody { desc })
            .expect("a sound command");
    }
    too_crowded(&mut scene);

    // At 60 Hz all of them reach the centre in the second step.
    let mut scene = apart(1_000, BodyKind::Dynamic, |place| -place * 15.0);
    let steps = (0..8).take_while(|_| scene.step().is_ok()).count();
    assert!(steps < 8, "{steps}");
    too_crowded(&mut scene);
}

#[test]
fn a_fixed_crowd_that_begins_to_move_fails_the_step() {
    let mut scene = scene(&[Shape::ball(0.5)]);
    for index in 0..1_000 {
        let place = spiral(index, 1_000, 0.1);
        scene
            .apply(&add(index, BodyKind::Fixed, place, Vec3::ZERO))
            .expect("a sound command");
    }
    scene.step().expect("a step of few pairs");
    for desc in scene.bodies().copied().collect::<Vec<_>>() {
        let desc = BodyDesc {
            kind: BodyKind::Dynamic,
            ..desc
        };
        scene
            .apply(&Command::ChangeBody { desc })
            .expect("a sound command");
    }
    too_crowded(&mut scene);
}

/// Steps that a scene takes, of so many.
fn steps(scene: &mut Scene, most: usize) -> usize {
    (0..most).take_while(|_| scene.step().is_ok()).count()
}

fn apply(scene: &mut Scene, commands: impl IntoIterator<Item = Command>) {
    for command in commands {
        scene.apply(&command).expect("a sound command");
    }
}

/// As [`add`], at rest, with the last word on its description.
fn described(index: u32, place: Vec3, change: impl FnOnce(&mut BodyDesc)) -> Command {
    let mut command = add(index, BodyKind::Kinematic, place, Vec3::ZERO);
    if let Command::AddBody { desc, .. } = &mut command {
        change(desc);
    }
    command
}

fn pose(index: u32, position: Vec3) -> Command {
    let (id, rotation) = (BodyId::new(index, 0), Quat::IDENTITY);
    Command::SetPose {
        id,
        position,
        rotation,
    }
}

#[test]
fn rods_that_spin_into_one_another_are_a_crowd() {
    for kind in [BodyKind::Dynamic, BodyKind::Kinematic] {
        let mut scene = scene(&[Shape::capsule(50.0, 0.1)]);
        for index in 0..400 {
            let place = Vec3::new((index % 20) as f32, 0.0, (index / 20) as f32) * 0.5;
            let desc = BodyDesc {
                // Kinematic rods meet one another as sensors.
                sensor: kind == BodyKind::Kinematic,
                ..BodyDesc::plain(BodyId::new(index, 0), kind, ShapeId(0))
            };
            let (turn, spin) = (Quat::IDENTITY.to_array(), [40.0, 0.0, 40.0]);
            let motion = BodyState::new(place.to_array(), turn, [0.0; 3], spin).expect("finite");
            apply(&mut scene, [Command::AddBody { desc, motion }]);
        }
        assert_eq!(steps(&mut scene, 8), 1, "{kind:?}");
        too_crowded(&mut scene);
    }
}

#[test]
fn kinematic_bodies_that_poses_put_into_a_pile_or_on_one_another_as_sensors_are_a_crowd() {
    let mut scene = apart(300, BodyKind::Kinematic, |_| Vec3::ZERO);
    let pile = |index| {
        let place = Vec3::X * 90.0 + spiral(index, 150, 0.1);
        add(300 + index, BodyKind::Dynamic, place, Vec3::ZERO)
    };
    apply(&mut scene, (0..150).map(pile));
    scene.step().expect("a lawful pile");
    let onto = Vec3::X * 90.0;
    apply(&mut scene, (0..300).map(|index| pose(index, onto)));
    too_crowded(&mut scene);

    let mut scene = scene_of_sensors(60.0);
    scene.step().expect("a step of few pairs");
    apply(&mut scene, (0..400).map(|index| pose(index, Vec3::ZERO)));
    too_crowded(&mut scene);
}

/// 400 kinematic sensors on a sphere of this radius.
fn scene_of_sensors(radius: f32) -> Scene {
    let mut scene = scene(&[Shape::ball(0.5)]);
    let sensor = |index| {
        let place = spiral(index, 400, radius);
        described(index, place, |desc| desc.sensor = true)
    };
    apply(&mut scene, (0..400).map(sensor));
    scene
}

#[test]
fn sensors_that_gather_by_less_than_their_size_in_a_tick_are_a_crowd() {
    let mut scene = scene_of_sensors(10.0);
    let mut ticks = 0;
    let fault = loop {
        let radius = 10.0 - 0.4 * ticks as f32;
        assert!(radius > -0.4, "all sensors are at one point");
        let poses = (0..400).map(|index| pose(index, spiral(index, 400, radius.max(0.0))));
        apply(&mut scene, poses);
        ticks += 1;
        if let Err(fault) = scene.step() {
            break fault;
        }
    };
    assert!(matches!(fault, SceneFault::TooCrowded { .. }), "{fault}");
}

#[test]
fn bodies_that_never_touch_are_no_crowd_until_they_may() {
    let mut scene = scene(&[Shape::ball(0.5)]);
    let place = |index| spiral(index % 1_000, 1_000, 0.1);
    let kinematic = |index| add(index, BodyKind::Kinematic, place(index), Vec3::ZERO);
    let apart = |index| {
        described(index, place(index) + Vec3::X * 10.0, |desc| {
            desc.kind = BodyKind::Dynamic;
            desc.groups = CollisionGroups {
                members: 1,
                touches: 2,
            };
        })
    };
    let sensor = |index| {
        let place = place(index) - Vec3::X * 10.0;
        described(index, place, |desc| {
            (desc.kind, desc.sensor) = (BodyKind::Fixed, true);
        })
    };
    apply(&mut scene, (0..1_000).map(kinematic));
    apply(&mut scene, (1_000..2_000).map(apart));
    apply(&mut scene, (2_000..3_000).map(sensor));
    for _ in 0..2 {
        scene.step().expect("pairs that nothing is made of");
    }
    let bodies = scene.bodies().copied().collect::<Vec<_>>();
    let changed = bodies[1_000..2_000].iter().map(|desc| Command::ChangeBody {
        desc: BodyDesc {
            groups: CollisionGroups::ALL,
            ..*desc
        },
    });
    apply(&mut scene, changed);
    too_crowded(&mut scene);
}

#[test]
fn bodies_that_cannot_meet_are_taken_as_long_as_it_costs_little_to_find_that_out() {
    let mut scene = scene(&[Shape::ball(0.5)]);
    let fixed = |index| {
        let place = spiral(index, 6_000, 0.1);
        add(index, BodyKind::Fixed, place, Vec3::ZERO)
    };
    let taken = crowd(&mut scene, (0..6_000).map(fixed));
    assert!((2_000..4_000).contains(&taken), "{taken}");
    scene.step().expect("a step of few pairs");
}

#[test]
fn bodies_that_cannot_meet_and_gather_slowly_are_a_crowd_by_a_sample_of_them() {
    let mut scene = scene(&[Shape::ball(0.5)]);
    scene.bound_crowding(1_024);
    // Less than their size in a tick, and half a second to the centre.
    let kinematic = |index| {
        let place = spiral(index, 2_000, 12.0);
        add(index, BodyKind::Kinematic, place, -place * 2.0)
    };
    apply(&mut scene, (0..2_000).map(kinematic));
    let taken = steps(&mut scene, 40);
    assert!((20..32).contains(&taken), "{taken}");
}

#[test]
fn bodies_that_joints_pull_onto_one_point_are_a_crowd() {
    let mut scene = apart(400, BodyKind::Dynamic, |_| Vec3::ZERO);
    let anchor = add(1_000, BodyKind::Fixed, Vec3::ZERO, Vec3::ZERO);
    apply(&mut scene, [anchor]);
    scene.step().expect("a step of few pairs");
    let joints = (0..400).map(|index| {
        let bodies = [1_000, index].map(|index| BodyId::new(index, 0));
        let frames = [JointFrame::at(Vec3::ZERO); 2];
        let joint = Joint::plain(JointKind::Spherical(None), bodies, frames);
        let id = JointId(index);
        Command::AddJoint {
            id,
            joint: Box::new(joint),
        }
    });
    apply(&mut scene, joints);
    assert!(steps(&mut scene, 60) < 60);
    too_crowded(&mut scene);
}

#[test]
fn a_crowd_in_the_middle_of_a_step_ends_it() {
    let mut scene = scene(&[Shape::ball(0.5)]);
    // Across a sphere of six metres within a step.
    let ball = |index| {
        let place = spiral(index, 400, 6.0);
        add(index, BodyKind::Dynamic, place, -place * 120.0)
    };
    apply(&mut scene, (0..400).map(ball));
    // Two swept balls meet in the middle of the step.
    for (index, side) in [(400, -1.0), (401, 1.0)] {
        let place = Vec3::new(side * 6.5, 100.0, 0.0);
        let mut command = add(index, BodyKind::Dynamic, place, -Vec3::X * side * 720.0);
        if let Command::AddBody { desc, .. } = &mut command {
            desc.swept = true;
        }
        apply(&mut scene, [command]);
    }
    let fault = scene.step().expect_err("it is too crowded");
    assert_eq!(fault, SceneFault::Engine(EngineFault::Crowded));
}

#[test]
fn fast_bodies_that_stop_at_one_point_of_a_half_space_are_a_crowd() {
    let mut scene = scene(&[Shape::ball(0.05), Shape::HalfSpace { normal: Vec3::Y }]);
    let plane = described(1_000, Vec3::ZERO, |desc| {
        (desc.kind, desc.shape) = (BodyKind::Fixed, ShapeId(1));
    });
    apply(&mut scene, [plane]);
    let mut count = 0;
    for index in 0..2_400 {
        let place = spiral(index, 2_400, 3.0);
        if place.y < 2.25 {
            continue;
        }
        count += 1;
        let ball = add(index, BodyKind::Dynamic, place, -place * 300.0);
        apply(&mut scene, [ball]);
    }
    assert!(count > 250, "{count}");
    assert_eq!(steps(&mut scene, 3), 1);
    too_crowded(&mut scene);
}

#[test]
fn a_scene_without_the_bound_steps_whatever_overlaps() {
    let mut scene = Scene::new(SceneConfig::default()).expect("a plain scene");
    let (id, shape) = (ShapeId(0), Shape::ball(0.5));
    scene
        .apply(&Command::AddShape { id, shape })
        .expect("a sound command");
    for index in 0..300 {
        let place = spiral(index, 300, 0.1);
        scene
            .apply(&add(index, BodyKind::Dynamic, place, Vec3::ZERO))
            .expect("a sound command");
    }
    scene.step().expect("a step of few pairs");
}

#[test]
fn a_crowded_scene_continues_without_the_commands_that_crowd_it() {
    let mut links = Links::new();
    links.begin(PEER, Stepping::Lockstep);
    let message = |command| ClientMessage::Command(command);
    let shape = Command::AddShape {
        id: ShapeId(0),
        shape: Shape::ball(0.5),
    };
    let mut messages = vec![message(shape)];
    let place = |index| {
        add(
            index,
            BodyKind::Dynamic,
            spiral(index, 400, 60.0),
            Vec3::ZERO,
        )
    };
    messages.extend((0..400).map(|index| message(place(index))));
    messages.push(ClientMessage::Advance { to: Tick::new(1) });
    links.send(PEER, &messages);
    links.pass(Span::from_millis(20));
    assert_eq!(links.counts(PEER).refused, None);
    let crowd = |index| {
        let (id, position) = (BodyId::new(index, 0), spiral(index, 400, 0.1));
        let rotation = Quat::IDENTITY;
        message(Command::SetPose {
            id,
            position,
            rotation,
        })
    };
    let mut messages: Vec<_> = (0..400).map(crowd).collect();
    messages.push(ClientMessage::Advance { to: Tick::new(5) });
    links.send(PEER, &messages);
    links.pass(Span::from_millis(20));
    links.send(PEER, &[ClientMessage::Inspect]);
    let counts = links.counts(PEER);
    assert_eq!(counts.refused, Some(CommandError::TooCrowded));
    assert_eq!(counts.inspected, Some((Tick::new(5), 400)));
}
