//! A world for tests; the engine after a panic and after a breakdown.

use glam::{Quat, Vec3};
use rapier3d::prelude::RigidBodyType;
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Joint, JointId, Material, SceneConfig, Shape, ShapeId, Sleep,
};
use rhumb_reckoning::{BodyId, BodyState, Damping, Twist};

use super::{RapierEngine, *};
use crate::engine::interface::{BodyProperties, Engine};

/// A world without gravity, friction and damping, unless a test sets them.
pub(super) struct TestWorld {
    pub(super) engine: RapierEngine,
    pub(super) material: Material,
    /// Of the bodies that are added.
    pub(super) sleep: Sleep,
    count: u32,
    joints: u32,
}

impl TestWorld {
    pub(super) fn new(gravity: Vec3) -> Self {
        let config = SceneConfig {
            gravity,
            sleep: Sleep::Never,
            ..SceneConfig::default()
        };
        Self {
            engine: RapierEngine::new(&config),
            material: Material {
                friction: 0.0,
                restitution: 0.0,
                density: 1_000.0,
            },
            sleep: Sleep::Never,
            count: 0,
            joints: 0,
        }
    }

    /// Adds a body at rest; `change` has the last word on its description.
    pub(super) fn add(
        &mut self,
        kind: BodyKind,
        shape: Shape,
        at: Vec3,
        change: impl FnOnce(&mut BodyDesc),
    ) -> BodyId {
        let (id, shape_id) = (BodyId::new(self.count, 0), ShapeId(self.count));
        self.count += 1;
        self.engine
            .add_shape(shape_id, &shape)
            .expect("the test's shapes are sound");
        let mut desc = BodyDesc::plain(id, kind, shape_id);
        change(&mut desc);
        let properties = BodyProperties {
            desc,
            material: self.material,
            damping: Damping::default(),
            sleep: self.sleep,
        };
        let rotation = Quat::IDENTITY.to_array();
        let state = BodyState::new(at.to_array(), rotation, [0.0; 3], [0.0; 3]);
        self.engine.add(&properties, state.expect("a pose"));
        id
    }

    pub(super) fn join(&mut self, joint: &Joint) -> JointId {
        let id = JointId(self.joints);
        self.joints += 1;
        self.engine.add_joint(id, joint);
        id
    }

    pub(super) fn set_velocity(&mut self, id: BodyId, linear: Vec3, angular: Vec3) {
        let twist = Twist {
            linear: linear.as_dvec3(),
            angular: angular.as_dvec3(),
        };
        self.engine.set_velocity(id, twist);
    }

    pub(super) fn step(&mut self) {
        let mut lost = Vec::new();
        self.engine.step(&mut lost).expect("the engine runs");
        assert_eq!(lost, [], "a body is lost");
    }

    pub(super) fn state(&self, id: BodyId) -> BodyState {
        let observation = self.engine.observe_one(id).expect("the body is there");
        observation.motion
    }

    pub(super) fn position(&self, id: BodyId) -> Vec3 {
        Vec3::from_array(self.state(id).position())
    }

    pub(super) fn rotation(&self, id: BodyId) -> Quat {
        Quat::from_array(self.state(id).rotation())
    }

    pub(super) fn velocity(&self, id: BodyId) -> Vec3 {
        self.velocities(id)[0]
    }

    pub(super) fn spin(&self, id: BodyId) -> Vec3 {
        self.velocities(id)[1]
    }

    fn velocities(&self, id: BodyId) -> [Vec3; 2] {
        let [.., vx, vy, vz, wx, wy, wz] = self.state(id).parts();
        [Vec3::new(vx, vy, vz), Vec3::new(wx, wy, wz)]
    }
}

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
