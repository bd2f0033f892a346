//! A Rapier world of a few bodies, for tests.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Joint, JointId, Material, SceneConfig, Shape, ShapeId, Sleep,
};
use rhumb_reckoning::{BodyId, BodyState, Damping, Twist};

use super::RapierEngine;
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
