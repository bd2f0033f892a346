//! Observations of a scene equal its engine's states, once and finite.
//!
//! Proved by small scenes with known outcome. Time is counted in ticks; no test reads a clock.

use glam::{Quat, Vec3};
use rhumb_protocol::limits::{COORDINATE_MAX, FORCE_MAX};
use rhumb_protocol::message::RemovalCause;
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, CommandError, Hull, Joint, JointFrame, JointId, JointKind,
    JointLimits, Material, SceneConfig, Shape, ShapeId, Sleep, SleepThresholds,
};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, BodyState, Damping};
use rhumb_scene::Scene;

const FLOOR: BodyId = BodyId::new(0, 0);
const BALL: BodyId = BodyId::new(1, 0);

fn config() -> SceneConfig {
    SceneConfig {
        gravity: Vec3::new(0.0, -10.0, 0.0),
        damping: Damping {
            linear: 0.0,
            angular: 0.5,
        },
        ..SceneConfig::default()
    }
}

fn motion(position: Vec3, linear: Vec3) -> BodyState {
    BodyState::new(
        position.to_array(),
        [0.0, 0.0, 0.0, 1.0],
        linear.to_array(),
        [0.0; 3],
    )
    .expect("the test makes it valid")
}

fn add(scene: &mut Scene, id: BodyId, kind: BodyKind, shape: u32, place: BodyState) {
    let desc = BodyDesc::plain(id, kind, ShapeId(shape));
    let motion = place;
    scene
        .apply(&Command::AddBody { desc, motion })
        .expect("the test makes it valid");
}

/// Shape 0 is a slab of 20 × 2 × 20 m, shape 1 a ball of radius 0.5 m.
fn empty() -> Scene {
    let mut scene = Scene::new(config()).expect("the test makes it valid");
    for (id, shape) in [
        Shape::Cuboid {
            half_extents: Vec3::new(10.0, 1.0, 10.0),
        },
        Shape::Ball { radius: 0.5 },
    ]
    .into_iter()
    .enumerate()
    {
        let id = ShapeId(id as u32);
        scene
            .apply(&Command::AddShape { id, shape })
            .expect("the test makes it valid");
    }
    scene
}

/// A ball at rest on a floor whose top is y = 0.
fn ball_on_floor() -> Scene {
    let mut scene = empty();
    let (floor, ball) = (Vec3::new(0.0, -1.0, 0.0), Vec3::new(0.0, 0.5, 0.0));
    add(
        &mut scene,
        FLOOR,
        BodyKind::Fixed,
        0,
        motion(floor, Vec3::ZERO),
    );
    add(
        &mut scene,
        BALL,
        BodyKind::Dynamic,
        1,
        motion(ball, Vec3::ZERO),
    );
    scene
}

/// The command that moves a body without turning it.
fn set_pose(id: BodyId, position: Vec3) -> Command {
    Command::SetPose {
        id,
        position,
        rotation: Quat::IDENTITY,
    }
}

fn step_and_observe(scene: &mut Scene) -> Vec<Observation> {
    scene
        .step()
        .expect("an engine of Rapier steps what it was given");
    scene.observations().to_vec()
}

fn fall_asleep(scene: &mut Scene) {
    for _ in 0..300 {
        scene
            .step()
            .expect("an engine of Rapier steps what it was given");
        if scene.awake_count() == 0 {
            return;
        }
    }
    panic!("nothing fell asleep in five seconds");
}

fn linear(observation: &Observation) -> Vec3 {
    Vec3::from_slice(&observation.motion.parts()[7..10])
}

#[test]
fn a_body_that_falls_asleep_is_observed_once_more() {
    let mut scene = ball_on_floor();
    let mut farewells = 0;
    for _ in 0..300 {
        for observation in step_and_observe(&mut scene) {
            assert_eq!(observation.id, BALL);
            if observation.activity == Activity::Asleep {
                farewells += 1;
                assert_eq!(observation.motion, observation.motion.stilled());
            } else {
                assert_eq!(farewells, 0);
            }
        }
    }
    assert_eq!(farewells, 1);
    let mut all = Vec::new();
    scene.observe_all(&mut all);
    assert_eq!(all.len(), 2);
    assert!(all.iter().all(|one| one.activity == Activity::Asleep));
}

#[test]
fn bodies_sleep_as_their_scene_configures() {
    let sleeps_after = |sleep| {
        let mut scene =
            Scene::new(SceneConfig { sleep, ..config() }).expect("the test makes it valid");
        scene
            .apply(&Command::SetGravity {
                gravity: Vec3::ZERO,
            })
            .unwrap();
        let (id, shape) = (ShapeId(1), Shape::Ball { radius: 0.5 });
        scene.apply(&Command::AddShape { id, shape }).unwrap();
        let slow = motion(Vec3::ZERO, Vec3::new(0.2, 0.0, 0.0));
        add(&mut scene, BALL, BodyKind::Dynamic, 1, slow);
        (1..=120).find(|_| {
            scene
                .step()
                .expect("an engine of Rapier steps what it was given");
            scene.awake_count() == 0
        })
    };
    let config = |speed, seconds| Sleep::Below(SleepThresholds::by_speed(speed, seconds));
    assert_eq!(sleeps_after(Sleep::Settled), None);
    assert_eq!(sleeps_after(config(0.19, 0.1)), None);
    let soon = sleeps_after(config(0.21, 0.1)).expect("it is still");
    let later = sleeps_after(config(0.21, 1.0)).expect("it is still");
    assert!(
        (6..10).contains(&soon) && (60..64).contains(&later),
        "{soon}, {later}"
    );
}

#[test]
fn a_sleeping_body_wakes_when_a_command_moves_it() {
    let id = BALL;
    let up = Vec3::new(0.0, 50.0, 0.0);
    for command in [
        Command::Force { id, force: up },
        Command::Torque { id, torque: up },
        Command::Impulse { id, impulse: up },
        Command::TorqueImpulse { id, impulse: up },
        Command::SetVelocity {
            id,
            linear: up,
            angular: Vec3::ZERO,
        },
        set_pose(id, up),
        set_pose(FLOOR, Vec3::new(0.0, -20.0, 0.0)),
        Command::RemoveBody { id: FLOOR },
        Command::SetGravity { gravity: up },
    ] {
        let mut scene = ball_on_floor();
        fall_asleep(&mut scene);
        scene.apply(&command).unwrap();
        let woken = |one: &Observation| one.id == BALL && one.activity == Activity::Awake;
        assert!(
            step_and_observe(&mut scene).iter().any(woken),
            "{command:?}"
        );
    }
}

#[test]
fn commands_without_effect_wake_nothing() {
    let mut scene = ball_on_floor();
    fall_asleep(&mut scene);
    let place = scene.observation(BALL).unwrap().motion;
    for command in [
        Command::Force {
            id: BALL,
            force: Vec3::ZERO,
        },
        Command::SetVelocity {
            id: BALL,
            linear: Vec3::ZERO,
            angular: Vec3::ZERO,
        },
        Command::SetPose {
            id: BALL,
            position: place.position().into(),
            rotation: Quat::from_array(place.rotation()),
        },
        Command::SetGravity {
            gravity: scene.gravity(),
        },
    ] {
        scene.apply(&command).unwrap();
        assert_eq!(step_and_observe(&mut scene), []);
    }
}

#[test]
fn a_displaced_static_body_is_observed_once() {
    let mut scene = ball_on_floor();
    fall_asleep(&mut scene);
    let position = Vec3::new(50.0, 0.0, 0.0);
    scene.apply(&set_pose(FLOOR, position)).unwrap();
    let first = step_and_observe(&mut scene)[0];
    assert_eq!((first.id, first.activity), (FLOOR, Activity::Asleep));
    assert_eq!(first.motion.position(), position.to_array());
    assert!(
        step_and_observe(&mut scene)
            .iter()
            .all(|one| one.id == BALL)
    );
}

#[test]
fn a_force_acts_for_one_tick_and_an_impulse_at_once() {
    let mass = 1_000.0 * 4.0 / 3.0 * core::f32::consts::PI * 0.125;
    let push = Vec3::new(60.0 * mass, 0.0, 0.0);
    for (command, change) in [
        (
            Command::Force {
                id: BALL,
                force: push,
            },
            1.0,
        ),
        (
            Command::Impulse {
                id: BALL,
                impulse: push / 60.0,
            },
            1.0,
        ),
    ] {
        let mut scene = empty();
        add(
            &mut scene,
            BALL,
            BodyKind::Dynamic,
            1,
            motion(Vec3::ZERO, Vec3::ZERO),
        );
        scene.apply(&command).unwrap();
        for _ in 0..3 {
            let speed = linear(&step_and_observe(&mut scene)[0]).x;
            assert!((speed - change).abs() < 1e-4, "{command:?}: {speed}");
        }
    }
}

#[test]
fn an_impulse_meets_the_mass_that_a_change_before_it_gave() {
    let mut scene = empty();
    let still = motion(Vec3::ZERO, Vec3::ZERO);
    add(&mut scene, BALL, BodyKind::Dynamic, 1, still);
    step_and_observe(&mut scene);
    let mut desc = *scene.body(BALL).unwrap();
    desc.material = Some(Material {
        density: 10_000.0,
        ..scene.config().material
    });
    let mass = 10_000.0 * 4.0 / 3.0 * core::f32::consts::PI * 0.125;
    let impulse = Vec3::new(mass, 0.0, 0.0);
    scene.apply(&Command::ChangeBody { desc }).unwrap();
    let push = Command::Impulse { id: BALL, impulse };
    scene.apply(&push).unwrap();
    assert!((linear(&step_and_observe(&mut scene)[0]).x - 1.0).abs() < 1e-4);
}

#[test]
fn a_kinematic_body_keeps_its_velocity_and_reaches_its_target() {
    let mut scene = empty();
    let speed = Vec3::new(6.0, 0.0, 0.0);
    add(
        &mut scene,
        BALL,
        BodyKind::Kinematic,
        1,
        motion(Vec3::ZERO, speed),
    );
    for tick in 1..=60 {
        let one = step_and_observe(&mut scene)[0];
        assert_eq!(linear(&one), speed);
        assert!((one.motion.position()[0] - 0.1 * tick as f32).abs() < 1e-5);
    }
    // Nothing tells that other poses follow the first one.
    for (height, speed) in [(1.0, 0.0), (2.0, 60.0)] {
        let position = Vec3::new(6.0, height, 0.0);
        scene.apply(&set_pose(BALL, position)).unwrap();
        let one = step_and_observe(&mut scene)[0];
        assert_eq!(one.motion.position(), position.to_array());
        assert!((linear(&one) - Vec3::new(0.0, speed, 0.0)).length() < 1e-2);
    }
    let position = Vec3::new(6.0, 2.0, 0.0);
    let one = step_and_observe(&mut scene)[0];
    assert_eq!(one.motion.position(), position.to_array());
    assert_eq!(linear(&one), Vec3::ZERO);
    fall_asleep(&mut scene);
}

#[test]
fn the_opposite_quaternion_is_not_a_turn() {
    let mut scene = empty();
    let place = motion(Vec3::ZERO, Vec3::ZERO);
    add(&mut scene, BALL, BodyKind::Kinematic, 1, place);
    let id = BALL;
    for rotation in [Quat::IDENTITY, -Quat::IDENTITY, Quat::IDENTITY] {
        let position = Vec3::ZERO;
        let there = Command::SetPose {
            id,
            position,
            rotation,
        };
        scene.apply(&there).unwrap();
        let parts = step_and_observe(&mut scene)[0].motion.parts();
        assert!(parts[7..].iter().all(|part| part.abs() < 1e-3), "{parts:?}");
    }
}

#[test]
fn a_body_that_leaves_the_world_is_removed_with_its_cause() {
    let mut scene = empty();
    let edge = Vec3::new(COORDINATE_MAX - 1.0, 0.0, 0.0);
    let out = Vec3::new(300.0, 0.0, 0.0);
    add(&mut scene, BALL, BodyKind::Dynamic, 1, motion(edge, out));
    let stepped = scene.step().unwrap();
    assert_eq!(stepped.removed, [(BALL, RemovalCause::LeftWorld)]);
    assert_eq!(scene.observations(), []);
    assert_eq!((scene.body_count(), scene.awake_count()), (0, 0));
    assert_eq!(scene.body(BALL), None);
    let again = BodyId::new(1, 1);
    add(
        &mut scene,
        again,
        BodyKind::Dynamic,
        1,
        motion(Vec3::ZERO, out),
    );
    assert_eq!(step_and_observe(&mut scene)[0].id, again);
}

#[test]
fn an_absurd_push_is_refused_and_removes_no_body() {
    let mut scene = ball_on_floor();
    let id = ShapeId(2);
    let shape = Shape::Ball { radius: 1e-3 };
    scene.apply(&Command::AddShape { id, shape }).unwrap();
    let mote = BodyId::new(2, 0);
    let mut desc = BodyDesc::plain(mote, BodyKind::Dynamic, id);
    let motion = motion(Vec3::new(0.0, 1.0, 0.0), Vec3::ZERO);
    desc.material = Some(Material {
        density: 1e-3,
        ..scene.config().material
    });
    scene.apply(&Command::AddBody { desc, motion }).unwrap();
    let most = Vec3::new(0.0, -FORCE_MAX, FORCE_MAX);
    let id = mote;
    for command in [
        Command::Impulse { id, impulse: most },
        Command::TorqueImpulse { id, impulse: most },
        Command::Force { id, force: most },
        Command::Torque { id, torque: most },
    ] {
        assert!(scene.apply(&command).is_err(), "{command:?}");
        assert_eq!(scene.step().unwrap().removed, []);
    }
}

/// The corners of a box around its centre.
fn box_hull(half: Vec3) -> Shape {
    let corner = |place: u8| {
        let side = |bit: u8| if place & bit == 0 { -1.0 } else { 1.0 };
        half * Vec3::new(side(1), side(2), side(4))
    };
    let corners: Vec<_> = (0..8).map(corner).collect();
    Shape::Hull(Hull::new(&corners).expect("the test makes it valid"))
}

#[test]
fn a_hull_has_its_centre_of_mass_at_the_origin_and_its_solids_mass() {
    let half = Vec3::new(0.5, 0.25, 1.0);
    let pushed_body = |shape: Shape| {
        let mut scene = empty();
        let id = ShapeId(2);
        scene.apply(&Command::AddShape { id, shape }).unwrap();
        let place = motion(Vec3::ZERO, Vec3::ZERO);
        add(&mut scene, BALL, BodyKind::Dynamic, 2, place);
        scene
            .apply(&Command::SetGravity {
                gravity: Vec3::ZERO,
            })
            .unwrap();
        let (force, torque) = (Vec3::new(600.0, 0.0, 0.0), Vec3::new(0.0, 50.0, 9.0));
        scene.apply(&Command::Force { id: BALL, force }).unwrap();
        scene.apply(&Command::Torque { id: BALL, torque }).unwrap();
        step_and_observe(&mut scene);
        step_and_observe(&mut scene)[0].motion.parts()
    };
    let (hull, cuboid) = (
        pushed_body(box_hull(half)),
        pushed_body(Shape::Cuboid { half_extents: half }),
    );
    for (one, other) in hull.into_iter().zip(cuboid) {
        assert!((one - other).abs() < 1e-5, "{hull:?} is not {cuboid:?}");
    }
    // A corner hull keeps its origin as centre of mass, though its neighbours are all on one side.
    let corner = Hull::new(&[Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z]).unwrap();
    let pushed = pushed_body(Shape::Hull(corner));
    let speed = 600.0 / 60.0 / (1_000.0 / 6.0);
    assert!((pushed[7] - speed).abs() < 1e-5, "{pushed:?}");
    assert!(pushed[8..10].iter().all(|part| part.abs() < 1e-6));
}

#[test]
fn hulls_come_to_rest_on_a_floor() {
    let mut scene = ball_on_floor();
    let id = ShapeId(2);
    let shape = box_hull(Vec3::splat(0.5));
    scene.apply(&Command::AddShape { id, shape }).unwrap();
    let box_id = BodyId::new(2, 0);
    let place = motion(Vec3::new(3.0, 2.0, 0.0), Vec3::ZERO);
    add(&mut scene, box_id, BodyKind::Dynamic, 2, place);
    fall_asleep(&mut scene);
    let [_, height, _] = scene.observation(box_id).unwrap().motion.position();
    assert!((height - 0.5).abs() < 0.02, "{height}");
}

const JOINT: JointId = JointId(3);

/// The ball half a metre below the middle of a floating slab, joined to it.
fn joined_ball(kind: JointKind) -> Scene {
    let mut scene = empty();
    let (slab, ball) = (Vec3::ZERO, Vec3::new(0.0, -2.0, 0.0));
    add(
        &mut scene,
        FLOOR,
        BodyKind::Fixed,
        0,
        motion(slab, Vec3::ZERO),
    );
    add(
        &mut scene,
        BALL,
        BodyKind::Dynamic,
        1,
        motion(ball, Vec3::ZERO),
    );
    let joint = Joint {
        kind,
        bodies: [FLOOR, BALL],
        frames: [
            JointFrame::at(Vec3::new(0.0, -1.0, 0.0)),
            JointFrame::at(Vec3::new(0.0, 1.0, 0.0)),
        ],
        collide: false,
        motors: [None; 6],
        strength: None,
    };
    scene
        .apply(&Command::AddJoint {
            id: JOINT,
            joint: joint.into(),
        })
        .expect("the test makes it valid");
    scene
}

fn place(scene: &Scene, id: BodyId) -> Vec3 {
    Vec3::from_array(
        scene
            .observation(id)
            .expect("it is there")
            .motion
            .position(),
    )
}

#[test]
fn a_joint_leaves_the_motions_of_its_kind_free() {
    let push = Vec3::new(0.0, 0.0, 900.0);
    let along = |kind| {
        let mut scene = joined_ball(kind);
        scene
            .apply(&Command::Impulse {
                id: BALL,
                impulse: push,
            })
            .unwrap();
        for _ in 0..20 {
            step_and_observe(&mut scene);
        }
        place(&scene, BALL)
    };
    let still = Vec3::new(0.0, -2.0, 0.0);
    // A pendulum about x swings along z, and nothing slides along x.
    assert!((along(JointKind::Fixed) - still).length() < 0.02);
    assert!((along(JointKind::Prismatic(None)) - still).length() < 0.02);
    for kind in [JointKind::Revolute(None), JointKind::Spherical(None)] {
        let swung = along(kind);
        assert!(swung.z > 0.3, "{kind:?}: {swung}");
        assert!(((swung - Vec3::NEG_Y).length() - 1.0).abs() < 0.02);
    }
    let narrow = JointLimits {
        least: -0.1,
        most: 0.1,
    };
    let limited = along(JointKind::Revolute(Some(narrow)));
    assert!(limited.z > 0.02 && limited.z < 0.15, "{limited}");
    let limited = along(JointKind::Spherical(Some([narrow; 3])));
    assert!(limited.z > 0.02 && limited.z < 0.15, "{limited}");
}

#[test]
fn removing_a_joint_or_its_body_wakes_the_joined_bodies() {
    for command in [
        Command::RemoveJoint { id: JOINT },
        Command::RemoveBody { id: FLOOR },
    ] {
        let mut scene = joined_ball(JointKind::Fixed);
        fall_asleep(&mut scene);
        scene.apply(&command).unwrap();
        assert_eq!(scene.joints().iter().count(), 0);
        for _ in 0..30 {
            step_and_observe(&mut scene);
        }
        assert!(place(&scene, BALL).y < -3.0, "{command:?}");
        let answer = scene.apply(&Command::RemoveJoint { id: JOINT });
        assert_eq!(answer, Err(CommandError::UnknownJoint(JOINT)));
    }
}

#[test]
fn a_lost_body_takes_its_joints_along() {
    let mut scene = joined_ball(JointKind::Spherical(None));
    scene.apply(&Command::RemoveJoint { id: JOINT }).unwrap();
    let other = BodyId::new(2, 0);
    let edge = Vec3::new(COORDINATE_MAX - 1.0, 0.0, 0.0);
    let out = Vec3::new(300.0, 0.0, 0.0);
    add(&mut scene, other, BodyKind::Dynamic, 1, motion(edge, out));
    let joint = Joint {
        kind: JointKind::Prismatic(None),
        bodies: [FLOOR, other],
        frames: [JointFrame::at(Vec3::ZERO); 2],
        collide: true,
        motors: [None; 6],
        strength: None,
    };
    scene
        .apply(&Command::AddJoint {
            id: JOINT,
            joint: joint.into(),
        })
        .unwrap();
    let stepped = scene.step().unwrap();
    assert_eq!(stepped.removed, [(other, RemovalCause::LeftWorld)]);
    assert_eq!(scene.joints().iter().count(), 0);
    let joint = Joint {
        bodies: [FLOOR, BALL],
        ..joint
    };
    scene
        .apply(&Command::AddJoint {
            id: JOINT,
            joint: joint.into(),
        })
        .unwrap();
    step_and_observe(&mut scene);
}
