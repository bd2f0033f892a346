//! The engine after a panic.

use rhumb_protocol::scene::{Material, Sleep};
use rhumb_reckoning::Damping;

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
