//! Projectiles in free flight, launched again after each fall.
//!
//! Each starts from its own pad on a grid of 3 m, at 12–18 m/s upward and up to 2 m/s sideways. When it falls below
//! the level of the pads (there is no ground), its controller moves it back to its pad and launches it again at
//! random. So almost all bodies fly freely at any time, without contacts. No damping; friction 0.5, no bounce. Nothing
//! rests.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, SceneConfig, Shape};
use rhumb_reckoning::{BodyId, BodyState, Tick};

use crate::builder::SceneBuilder;
use crate::controller::{Controller, flight};
use crate::defaults::{motion, surface};
use crate::rng::SceneRng;
use crate::script::Script;

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
