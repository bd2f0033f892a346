//! Ten thousand sleeping boxes on a floor.
//!
//! Each starts at rest, so all sleep after the engine's half second. Friction 0.5, no bounce, damping 0.05 and 0.05
//! 1/s; boxes of 0.5 to 1 m, 1.5 m apart.

use glam::Vec3;
use rhumb_protocol::scene::{BodyKind, Command, SceneConfig, Shape};
use rhumb_reckoning::Tick;

use crate::builder::{SceneBuilder, about_y};
use crate::defaults::{damped, motion, surface};
use crate::rng::SceneRng;
use crate::script::Script;

/// Boxes at rest.
#[derive(Clone, Debug)]
pub struct Rest {
    boxes: u32,
    rng: SceneRng,
}

impl Rest {
    /// Number of boxes in the scene of that name.
    pub const BOXES: u32 = 10_000;

    /// A scene of `boxes` boxes.
    #[must_use]
    pub fn new(boxes: u32, seed: u64) -> Self {
        Self {
            boxes,
            rng: SceneRng::new(seed),
        }
    }
}

impl Script for Rest {
    fn name(&self) -> &'static str {
        "rest-10k"
    }

    fn config(&self) -> SceneConfig {
        damped(surface(0.5, 500.0))
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        if tick != Tick::ZERO {
            return;
        }
        let side = (1..)
            .find(|side: &u32| side * side >= self.boxes)
            .unwrap_or(1);
        let middle = (side - 1) as f32 * 0.5;
        let mut builder = SceneBuilder::default();
        builder.floor(middle * BOX_SPACING + 10.0, out);
        let shapes = HALVES.map(|half_extents| builder.shape(Shape::Cuboid { half_extents }, out));
        for place in 0..self.boxes {
            let kind = self.rng.below(HALVES.len() as u32) as usize;
            let (x, z) = (
                (place % side) as f32 - middle,
                (place / side) as f32 - middle,
            );
            let position = Vec3::new(x * BOX_SPACING, HALVES[kind].y, z * BOX_SPACING);
            let turn = about_y(f64::from(self.rng.signed()));
            let place = motion(position, turn, Vec3::ZERO, Vec3::ZERO);
            builder.body(BodyKind::Dynamic, shapes[kind], place, out);
        }
    }
}

/// Spacing, metres: larger than the diagonal of any box.
const BOX_SPACING: f32 = 1.5;

/// Half extents of the boxes, metres.
const HALVES: [Vec3; 3] = [
    Vec3::new(0.25, 0.25, 0.25),
    Vec3::new(0.5, 0.25, 0.35),
    Vec3::new(0.4, 0.5, 0.4),
];
