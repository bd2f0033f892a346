//! A tower of twenty boxes, and a wall of ten by ten that a ball strikes.
//!
//! The tower has boxes of 1 m and stays up. The wall has bricks of 1 × 0.5 × 0.5 m; after two seconds a ball of 1 m
//! and 4,000 kg/m³ hits it at 15 m/s. Friction 0.7, no bounce, damping 0.05 and 0.05 1/s, for the ball 0.05 and 3 1/s.
//! All bodies sleep again about ten seconds later.

use glam::Vec3;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, Material, SceneConfig, Shape, ShapeId};
use rhumb_reckoning::{Damping, Tick};

use crate::builder::SceneBuilder;
use crate::defaults::{motion, still, surface};
use crate::rng::SceneRng;
use crate::script::Script;

/// Towers and walls.
#[derive(Clone, Debug)]
pub struct Stack {
    pairs: u32,
    rng: SceneRng,
    builder: SceneBuilder,
    ball: ShapeId,
}

impl Stack {
    /// Bodies of one tower, one wall and one ball.
    pub const BODIES: u32 = TOWER + SIDE * SIDE + 1;

    /// As many pairs of tower and wall as fit into `bodies` bodies, at least one and at most 300.
    #[must_use]
    pub fn new(bodies: u32, seed: u64) -> Self {
        Self {
            pairs: (bodies / Self::BODIES).clamp(1, PAIRS_MAX),
            rng: SceneRng::new(seed),
            builder: SceneBuilder::default(),
            ball: ShapeId(0),
        }
    }

    fn build(&mut self, out: &mut Vec<Command>) {
        self.builder.floor(60.0 + APART * self.pairs as f32, out);
        let cuboid = |half_extents| Shape::Cuboid { half_extents };
        let (block, brick) = (Vec3::splat(0.5), Vec3::new(0.5, 0.25, 0.25));
        let block = self.builder.shape(cuboid(block), out);
        let brick = self.builder.shape(cuboid(brick), out);
        self.ball = self.builder.shape(Shape::Ball { radius: 0.5 }, out);
        for pair in 0..self.pairs {
            let along = APART * pair as f32;
            for storey in 0..TOWER {
                // Up to a centimetre, so that no two towers are equal.
                let offset = self.rng.vector() * Vec3::new(0.01, 0.0, 0.01);
                let place = Vec3::new(-8.0, storey as f32 + 0.5, along) + offset;
                self.builder
                    .body(BodyKind::Dynamic, block, still(place), out);
            }
            for place in 0..SIDE * SIDE {
                let (column, row) = ((place % SIDE) as f32, (place / SIDE) as f32);
                let place = Vec3::new(column - 4.5, row * 0.5 + 0.25, along);
                self.builder
                    .body(BodyKind::Dynamic, brick, still(place), out);
            }
        }
    }

    fn strike(&mut self, out: &mut Vec<Command>) {
        for pair in 0..self.pairs {
            let off = self.rng.vector() * Vec3::new(1.5, 0.5, 0.0);
            let position = Vec3::new(0.0, 2.5, APART * pair as f32 - 6.0) + off;
            let flight = motion(position, glam::Quat::IDENTITY, STRIKE, Vec3::ZERO);
            let shape = self.ball;
            let heavy = |id| BodyDesc {
                material: Some(Material {
                    density: 4_000.0,
                    ..MATERIAL
                }),
                damping: Some(Damping {
                    linear: 0.05,
                    angular: 3.0,
                }),
                ..BodyDesc::plain(id, BodyKind::Dynamic, shape)
            };
            self.builder.with(heavy, flight, out);
        }
    }
}

impl Script for Stack {
    fn name(&self) -> &'static str {
        "stack"
    }

    fn config(&self) -> SceneConfig {
        SceneConfig {
            material: MATERIAL,
            damping: Damping {
                linear: 0.05,
                angular: 0.05,
            },
            ..SceneConfig::default()
        }
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        match tick.value() {
            0 => self.build(out),
            120 => self.strike(out),
            _ => {}
        }
    }
}

/// Limited by the size of the floor.
const PAIRS_MAX: u32 = 300;
/// Boxes of a tower.
const TOWER: u32 = 20;
/// Bricks per row, and number of rows.
const SIDE: u32 = 10;
/// Distance between two walls, metres.
const APART: f32 = 30.0;
/// Velocity of the ball, m/s.
const STRIKE: Vec3 = Vec3::new(0.0, 2.0, 15.0);

const MATERIAL: Material = surface(0.7, 500.0);
