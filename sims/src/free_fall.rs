//! Bodies in free flight: of every shape, or launched again after each fall.
//!
//! Free fall shows only an integrator's effect on free bodies; it is used to test predictors.
//!
//! In the rain, projectiles are launched again after each fall. Each starts from its own pad on a grid of 3 m, at
//! 12–18 m/s upward and up to 2 m/s sideways. When it falls below the level of the pads (there is no ground), its
//! controller moves it back to its pad and launches it again at random. So almost all bodies fly freely at any time,
//! without contacts. No damping; friction 0.5, no bounce. Nothing rests.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, SceneConfig, Shape, ShapeId};
use rhumb_reckoning::{BodyId, BodyState, Damping, Tick};

use crate::script::{Cluster, Controller, SceneBuilder, SceneRng, Script, flight, motion, surface};

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

/// A scene of projectiles.
#[derive(Clone, Debug)]
pub struct Rain {
    projectiles: u32,
    seed: u64,
}

impl Rain {
    /// Default number of projectiles.
    pub const PROJECTILES: u32 = 400;

    /// A scene of `projectiles` projectiles.
    #[must_use]
    pub const fn new(projectiles: u32, seed: u64) -> Self {
        Self { projectiles, seed }
    }
}

impl Script for Rain {
    fn name(&self) -> &'static str {
        "rain"
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
        let mut builder = SceneBuilder::default();
        let shapes = PROJECTILES.map(|shape| builder.shape(shape, out));
        let mut rng = SceneRng::new(self.seed);
        for place in 0..self.projectiles {
            let shape = shapes[place as usize % shapes.len()];
            let (linear, angular) = throw(&mut rng);
            // Different heights, so that they do not fall all at once.
            let height = 6.0 + 6.0 * rng.signed();
            let position = pad(place, self.projectiles) + Vec3::Y * height;
            let start = motion(position, rng.rotation(), linear, angular);
            let config = |id: BodyId| BodyDesc::plain(id, BodyKind::Dynamic, shape);
            builder.with(config, start, out);
        }
    }

    fn controller(&self) -> Option<Box<dyn Controller>> {
        Some(Box::new(Thrower {
            projectiles: self.projectiles,
            rng: SceneRng::new(!self.seed),
        }))
    }
}

/// Launches fallen projectiles again.
struct Thrower {
    projectiles: u32,
    rng: SceneRng,
}

impl Controller for Thrower {
    fn before_step(
        &mut self,
        _: Tick,
        motion: &dyn Fn(BodyId) -> Option<BodyState>,
        out: &mut Vec<Command>,
    ) {
        for place in 0..self.projectiles {
            let id = BodyId::new(place, 0);
            let Some((position, velocity)) = motion(id).as_ref().map(flight) else {
                continue;
            };
            if position.y < 0.0 && velocity.y < 0.0 {
                let (linear, angular) = throw(&mut self.rng);
                out.push(Command::SetPose {
                    id,
                    position: pad(place, self.projectiles),
                    rotation: Quat::IDENTITY,
                });
                out.push(Command::SetVelocity {
                    id,
                    linear,
                    angular,
                });
            }
        }
    }
}

/// Position of a projectile's pad.
fn pad(place: u32, projectiles: u32) -> Vec3 {
    let side = (1..)
        .find(|side: &u32| side * side >= projectiles)
        .unwrap_or(1);
    let middle = (side - 1) as f32 * 0.5;
    let (x, z) = (
        (place % side) as f32 - middle,
        (place / side) as f32 - middle,
    );
    Vec3::new(x * SPACING, 0.0, z * SPACING)
}

/// Random linear and angular launch velocity, m/s and rad/s.
fn throw(rng: &mut SceneRng) -> (Vec3, Vec3) {
    let linear = Vec3::new(0.0, 15.0, 0.0) + rng.vector() * Vec3::new(2.0, 3.0, 2.0);
    (linear, rng.vector() * 3.0)
}

/// Spacing of the pads, metres.
const SPACING: f32 = 3.0;

const PROJECTILES: [Shape; 3] = [
    Shape::Ball { radius: 0.15 },
    Shape::Cuboid {
        half_extents: Vec3::new(0.3, 0.05, 0.05),
    },
    Shape::Capsule {
        half_height: 0.2,
        radius: 0.08,
    },
];
