//! What a scene says of its bodies is what its engine did, once and finite.
//!
//! Proved by small scenes whose outcome is known. Time is counted in ticks; nothing here reads a clock.

use core::num::NonZeroU32;

use glam::{Quat, Vec3};
use rhumb_protocol::limits::{COORDINATE_MAX, FORCE_MAX};
use rhumb_protocol::message::RemovalCause;
use rhumb_protocol::scene::{
    BodyKind, BodyTerms, Command, Material, Pace, SceneTerms, Shape, ShapeId,
};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, Damping, Integrator, Rate, Verbatim};
use rhumb_server::{Digest, Scene};
use rhumb_sims::{NAMES, Script, by_name};

const FLOOR: BodyId = BodyId::new(0, 0);
const BALL: BodyId = BodyId::new(1, 0);

fn terms() -> SceneTerms {
    SceneTerms {
        integrator: Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::new(4).expect("four is not zero"),
        },
        gravity: Vec3::new(0.0, -10.0, 0.0),
        pace: Pace::Lockstep,
        material: Material {
            friction: 0.5,
            restitution: 0.0,
            density: 1_000.0,
        },
        damping: Damping {
            linear: 0.0,
            angular: 0.5,
        },
    }
}

fn motion(position: Vec3, linear: Vec3) -> Verbatim {
    Verbatim::new(
        position.to_array(),
        [0.0, 0.0, 0.0, 1.0],
        linear.to_array(),
        [0.0; 3],
    )
    .expect("the test makes it valid")
}

fn add(scene: &mut Scene, id: BodyId, kind: BodyKind, shape: u32, place: Verbatim) {
    let terms = BodyTerms::plain(id, kind, ShapeId(shape));
    let motion = place;
    scene
        .apply(&Command::AddBody { terms, motion })
        .expect("the test makes it valid");
}

/// Shape 0 is a slab of 20 × 2 × 20 m, shape 1 a ball of radius 0.5 m.
fn empty() -> Scene {
    let mut scene = Scene::new(terms()).expect("the test makes it valid");
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

/// A ball that lies on a floor whose top is y = 0.
fn ball_on_floor() -> Scene {
    let mut scene = empty();
    let (floor, ball) = (Vec3::new(0.0, -1.0, 0.0), Vec3::new(0.0, 0.5, 0.0));
    add(
        &mut scene,
        FLOOR,
        BodyKind::Static,
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

fn seen(scene: &mut Scene) -> Vec<Observation> {
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
fn a_body_that_falls_asleep_is_seen_once_more() {
    let mut scene = ball_on_floor();
    let mut farewells = 0;
    for _ in 0..300 {
        for observation in seen(&mut scene) {
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
fn a_sleeping_body_wakes_for_what_moves_it() {
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
        Command::SetPose {
            id,
            position: up,
            rotation: Quat::IDENTITY,
        },
        Command::SetPose {
            id: FLOOR,
            position: Vec3::new(0.0, -20.0, 0.0),
            rotation: Quat::IDENTITY,
        },
        Command::RemoveBody { id: FLOOR },
        Command::SetGravity { gravity: up },
    ] {
        let mut scene = ball_on_floor();
        fall_asleep(&mut scene);
        scene.apply(&command).unwrap();
        let woken = |one: &Observation| one.id == BALL && one.activity == Activity::Awake;
        assert!(seen(&mut scene).iter().any(woken), "{command:?}");
    }
}

#[test]
fn what_changes_nothing_wakes_nothing() {
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
        assert_eq!(seen(&mut scene), []);
    }
}

#[test]
fn a_static_body_is_seen_once_where_it_was_put() {
    let mut scene = ball_on_floor();
    fall_asleep(&mut scene);
    let position = Vec3::new(50.0, 0.0, 0.0);
    let rotation = Quat::IDENTITY;
    let id = FLOOR;
    let there = Command::SetPose {
        id,
        position,
        rotation,
    };
    scene.apply(&there).unwrap();
    let first = seen(&mut scene)[0];
    assert_eq!((first.id, first.activity), (FLOOR, Activity::Asleep));
    assert_eq!(first.motion.position(), position.to_array());
    assert!(seen(&mut scene).iter().all(|one| one.id == BALL));
}

#[test]
fn a_force_acts_for_one_tick_and_a_blow_at_once() {
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
            let speed = linear(&seen(&mut scene)[0]).x;
            assert!((speed - change).abs() < 1e-4, "{command:?}: {speed}");
        }
    }
}

#[test]
fn a_kinematic_body_keeps_its_velocity_and_goes_where_it_is_told() {
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
        let one = seen(&mut scene)[0];
        assert_eq!(linear(&one), speed);
        assert!((one.motion.position()[0] - 0.1 * tick as f32).abs() < 1e-5);
    }
    let position = Vec3::new(6.0, 1.0, 0.0);
    let rotation = Quat::IDENTITY;
    let id = BALL;
    let there = Command::SetPose {
        id,
        position,
        rotation,
    };
    scene.apply(&there).unwrap();
    let one = seen(&mut scene)[0];
    assert_eq!(one.motion.position(), position.to_array());
    assert!((linear(&one) - Vec3::new(0.0, 60.0, 0.0)).length() < 1e-2);
    let one = seen(&mut scene)[0];
    assert_eq!(one.motion.position(), position.to_array());
    assert_eq!(linear(&one), Vec3::ZERO);
    fall_asleep(&mut scene);
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
    assert_eq!(seen(&mut scene)[0].id, again);
}

#[test]
fn a_blow_beyond_measure_costs_no_body() {
    let mut scene = ball_on_floor();
    let id = ShapeId(2);
    let shape = Shape::Ball { radius: 1e-3 };
    scene.apply(&Command::AddShape { id, shape }).unwrap();
    let mote = BodyId::new(2, 0);
    let mut terms = BodyTerms::plain(mote, BodyKind::Dynamic, id);
    let motion = motion(Vec3::new(0.0, 1.0, 0.0), Vec3::ZERO);
    terms.material = Some(Material {
        density: 1e-3,
        ..scene.terms().material
    });
    scene.apply(&Command::AddBody { terms, motion }).unwrap();
    let most = Vec3::new(0.0, -FORCE_MAX, FORCE_MAX);
    let id = mote;
    for command in [
        Command::Impulse { id, impulse: most },
        Command::TorqueImpulse { id, impulse: most },
        Command::Force { id, force: most },
        Command::Torque { id, torque: most },
    ] {
        scene.apply(&command).unwrap();
        assert_eq!(scene.step().unwrap().removed, []);
    }
}

/// Runs a script and hands each tick's observations to `check`.
fn run(script: &mut dyn Script, ticks: u32, mut check: impl FnMut(&Scene)) -> Scene {
    let mut scene = Scene::new(script.terms()).expect("the test makes it valid");
    let mut commands = Vec::new();
    for _ in 0..ticks {
        commands.clear();
        script.commands(scene.tick(), &mut commands);
        for command in &commands {
            let answer = scene.apply(command);
            assert_eq!(answer, Ok(()), "{command:?} at {}", scene.tick());
        }
        assert_eq!(
            scene
                .step()
                .expect("an engine of Rapier steps what it was given")
                .removed,
            []
        );
        check(&scene);
    }
    scene
}

#[test]
fn one_seed_gives_one_truth_and_a_trace_gives_its_digest() {
    for name in NAMES {
        let script = |seed| by_name(name, 30, seed).unwrap();
        let mut traced = Digest::START;
        let scene = run(script(1).as_mut(), 400, |scene| {
            traced.fold_tick(scene.tick(), scene.observations());
            let ids = scene.observations().iter().map(|one| one.id);
            assert!(ids.is_sorted_by(|a, b| a < b));
        });
        assert_eq!(scene.digest(), traced);
        let again = run(script(1).as_mut(), 400, |_| {});
        assert_eq!(scene.digest(), again.digest(), "{name}");
        let other = run(script(2).as_mut(), 400, |_| {});
        assert_ne!(scene.digest(), other.digest(), "{name}");
    }
}

/// Measured once; another value means that every recorded trace and every other machine disagrees with this build.
#[test]
fn the_truth_is_the_same_to_the_bit_in_every_build() {
    for (name, digest) in [
        ("ball-pit", 0x1761_74c9_5f0f_5f77),
        ("free-fall", 0x7caf_2e48_1470_0023),
        ("zoo", 0xeab5_48b7_1ab7_7f7f),
    ] {
        let scene = run(by_name(name, 50, 1).unwrap().as_mut(), 600, |_| {});
        assert_eq!(scene.digest().value(), digest, "{name}: {}", scene.digest());
    }
}

#[test]
fn what_an_observation_leaves_out_has_not_changed() {
    let mut known = std::collections::BTreeMap::new();
    let mut script = by_name("zoo", 20, 5).unwrap();
    run(script.as_mut(), 1_500, |scene| {
        for one in scene.observations() {
            known.insert(one.id, one.motion);
        }
        let mut all = Vec::new();
        scene.observe_all(&mut all);
        assert_eq!(all.len(), scene.body_count());
        for one in all {
            let before = *known.entry(one.id).or_insert(one.motion);
            assert_eq!(before, one.motion, "{} at {}", one.id, scene.tick());
        }
    });
}

#[test]
fn no_ball_leaves_the_pit() {
    let mut script = by_name("ball-pit", 500, 11).unwrap();
    let balls = |scene: &Scene| {
        let dynamic = |terms: &&BodyTerms| terms.kind == BodyKind::Dynamic;
        scene.bodies().filter(dynamic).count()
    };
    let scene = run(script.as_mut(), 1_800, |_| {});
    assert_eq!(balls(&scene), 500);
    let mut all = Vec::new();
    scene.observe_all(&mut all);
    for one in all {
        if scene.body(one.id).unwrap().kind == BodyKind::Dynamic {
            let [x, y, z] = one.motion.position();
            assert!(x.abs() < 105.0 && z.abs() < 105.0 && y > -1.0);
        }
    }
}
