//! The engine after a panic, and kinematic bodies after a breakdown.

use rapier3d::prelude::RigidBodyType;
use rhumb_protocol::scene::{Material, Sleep};
use rhumb_reckoning::Damping;

use super::test_world::TestWorld;
use super::*;

#[test]
fn after_a_panic_the_engine_is_empty_and_takes_no_steps() {
    let (material, damping) = (
        Material {
            friction: 0.5,
            restitution: 0.0,
            density: 1_000.0,
        },
        Damping::default(),
    );
    let mut engine = RapierEngine::new(&SceneConfig {
        gravity: Vec3::ZERO,
        material,
        damping,
        ..SceneConfig::default()
    });
    let id = BodyId::new(0, 0);
    let ball = BodyProperties {
        sleep: Sleep::Settled,
        desc: BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(0)),
        material,
        damping,
    };
    let motion = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).unwrap();
    let shape = Shape::Ball { radius: 0.5 };
    assert_eq!(engine.add_shape(ball.desc.shape, &shape), Ok(()));
    engine.add(&ball, motion);
    let mut lost = Vec::new();
    assert_eq!(engine.step(&mut lost), Ok(()));
    assert_eq!(engine.awake_count(), 1);
    engine.contained(|_| panic!("as Rapier might"));
    assert_eq!(engine.fault(), Some(EngineFault::Panicked));
    engine.add(&ball, motion);
    engine.push(id, Push::Impulse(Vec3::X));
    assert_eq!(engine.step(&mut lost), Err(EngineFault::Panicked));
    assert_eq!(engine.observe_one(id), None);
    let mut observed = Vec::new();
    engine.observe(&mut observed);
    assert_eq!((observed, lost, engine.awake_count()), (vec![], vec![], 0));
}

#[test]
fn a_kinematic_body_outlives_what_it_is_joined_to() {
    let mut world = TestWorld::new(Vec3::ZERO);
    let shape = Shape::Ball { radius: 0.5 };
    let id = world.add(BodyKind::Kinematic, shape, Vec3::ZERO, |_| {});
    world.set_velocity(id, Vec3::new(1.0, 2.0, 3.0), Vec3::Y);
    let engine = &mut world.engine;
    let mut lost = Vec::new();
    assert_eq!(engine.step(&mut lost), Ok(()));
    let handle = engine.place(id).unwrap().handle;
    let body = &mut engine.world.bodies[handle];
    // The engine takes no velocities for a kinematic body.
    body.set_body_type(RigidBodyType::Dynamic, true);
    body.set_linvel(Vec3::splat(f32::NAN), true);
    body.set_angvel(Vec3::splat(f32::NAN), true);
    body.set_body_type(RigidBodyType::KinematicPositionBased, true);
    engine.look(&mut lost);
    assert_eq!(lost, vec![]);
    assert_eq!(velocities(engine, id), Some([1.0, 2.0, 3.0, 0.0, 1.0, 0.0]));
    let before = BodyDesc::plain(id, BodyKind::Kinematic, ShapeId(0));
    let now = BodyProperties {
        sleep: Sleep::Never,
        desc: BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(0)),
        material: world.material,
        damping: Damping::default(),
    };
    engine.change(&before, &now);
    assert_eq!(velocities(engine, id), Some([1.0, 2.0, 3.0, 0.0, 1.0, 0.0]));
}

#[test]
fn no_body_is_observed_faster_than_the_greatest_speed() {
    let mut world = TestWorld::new(Vec3::ZERO);
    world.material.restitution = 1.0;
    let hammer = Shape::cuboid(5.0, 5.0, 5.0);
    let hammer = world.add(BodyKind::Dynamic, hammer, Vec3::X * -50.0, |desc| {
        desc.swept = true;
    });
    let ball = world.add(BodyKind::Dynamic, Shape::ball(0.5), Vec3::ZERO, |desc| {
        desc.swept = true;
    });
    world.set_velocity(hammer, Vec3::X * 1_000.0, Vec3::ZERO);
    let mut fastest = 0.0_f32;
    for _ in 0..10 {
        world.step();
        let speed = world.velocity(ball).length();
        assert!(speed <= SPEED_MAX * 1.0001, "{speed} m/s");
        fastest = fastest.max(speed);
    }
    assert!(
        fastest > SPEED_MAX * 0.99,
        "{fastest} m/s of almost twice the hammer's"
    );
}

fn velocities(engine: &RapierEngine, id: BodyId) -> Option<[f32; 6]> {
    let [.., x, y, z, ax, ay, az] = engine.observe_one(id)?.motion.parts();
    Some([x, y, z, ax, ay, az])
}
