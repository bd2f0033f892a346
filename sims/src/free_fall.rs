//! Bodies of every shape in free flight with spin and without contacts.
//!
//! Shows only an integrator's effect on free bodies; used to test predictors.

use glam::Vec3;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, SceneConfig, Shape, ShapeId};
use rhumb_reckoning::{BodyId, Damping, Tick};

use crate::cluster::Cluster;
use crate::defaults::{motion, surface};
use crate::rng::SceneRng;
use crate::script::Script;

/// Bodies that start 20 m apart, at most 5 m/s fast upward and with spins up to 3 rad/s about each axis.
///
/// Every second body has its own damping, every third its own gravity scale. They diverge so slowly that none meet in
/// the first four seconds.
#[derive(Clone, Debug)]
pub struct FreeFall {
    bodies: u32,
    rng: SceneRng,
}

impl FreeFall {
    /// A scene of `bodies` bodies.
    #[must_use]
    pub fn new(bodies: u32, seed: u64) -> Self {
        Self {
            bodies,
            rng: SceneRng::new(seed),
        }
    }
}

impl Script for FreeFall {
    fn name(&self) -> &'static str {
        "free-fall"
    }

    fn config(&self) -> SceneConfig {
        SceneConfig {
            material: surface(0.5, 1_000.0),
            ..SceneConfig::default()
        }
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        if tick != Tick::ZERO {
            return;
        }
        for (shape, number) in SHAPES.into_iter().zip(0..) {
            let id = ShapeId(number);
            out.push(Command::AddShape { id, shape });
        }
        let mut places = self.rng.clone();
        for (position, index) in CLUSTER.places(self.bodies, &mut places).zip(0..) {
            let shape = ShapeId(index % SHAPES.len() as u32);
            let mut desc = BodyDesc::plain(BodyId::new(index, 0), BodyKind::Dynamic, shape);
            if index % 2 == 1 {
                desc.damping = Some(Damping {
                    linear: 0.1,
                    angular: 0.2,
                });
            }
            if index % 3 == 1 {
                desc.gravity_scale = 0.5;
            }
            let linear = self.rng.vector() * 2.5 + Vec3::new(0.0, 2.5, 0.0);
            let angular = self.rng.vector() * 3.0;
            let motion = motion(position, self.rng.rotation(), linear, angular);
            out.push(Command::AddBody { desc, motion });
        }
    }
}

const SHAPES: [Shape; 4] = [
    Shape::Ball { radius: 0.5 },
    Shape::Cuboid {
        half_extents: Vec3::new(0.2, 0.4, 0.8),
    },
    Shape::Capsule {
        half_height: 0.6,
        radius: 0.25,
    },
    Shape::Cylinder {
        half_height: 0.5,
        radius: 0.3,
    },
];

const CLUSTER: Cluster = Cluster {
    centre: Vec3::new(0.0, 100.0, 0.0),
    lowest: 50.0,
    spacing: 20.0,
    jitter: 1.0,
};
