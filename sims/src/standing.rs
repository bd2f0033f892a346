//! Bodies that stand: a tower and a wall, a ring of dominoes, sleeping boxes.
//!
//! The tower has twenty boxes of 1 m and stays up. The wall has ten by ten bricks of 1 × 0.5 × 0.5 m; after two
//! seconds a ball of 1 m and 4,000 kg/m³ hits it at 15 m/s. Friction 0.7, no bounce, damping 0.05 and 0.05 1/s, for
//! the ball 0.05 and 3 1/s. All bodies sleep again about ten seconds later.
//!
//! The dominoes are stones of 0.2 × 1 × 0.5 m, 0.55 m apart, with a gap before the first, so the last one falls on the
//! floor. The first is struck after half a second, when all sleep or are about to; each strikes the next. Friction
//! 0.5, no bounce, damping 0.05 and 0.05 1/s.
//!
//! The sleeping boxes start at rest on a floor, so all sleep after the engine's half second. Friction 0.5, no bounce,
//! damping 0.05 and 0.05 1/s; boxes of 0.5 to 1 m, 1.5 m apart.

use core::f64::consts::PI;

use glam::Vec3;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, Material, SceneConfig, Shape, ShapeId};
use rhumb_reckoning::{BodyId, Damping, Tick};

use crate::script::{SceneBuilder, SceneRng, Script, about_y, damped, motion, still, surface};

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

/// A ring of stones.
#[derive(Clone, Debug)]
pub struct Dominoes {
    stones: u32,
    rng: SceneRng,
    first: Option<BodyId>,
}

impl Dominoes {
    /// Default number of stones.
    pub const STONES: u32 = 200;

    /// A ring of `stones` stones, at least one.
    #[must_use]
    pub fn new(stones: u32, seed: u64) -> Self {
        Self {
            stones: stones.max(1),
            rng: SceneRng::new(seed),
            first: None,
        }
    }

    fn build(&mut self, out: &mut Vec<Command>) {
        // Positions around the ring, some of which stay empty; stones of a small ring must not touch.
        let places = (self.stones + GAP).max(12);
        let radius = STONE_SPACING * f64::from(places) / (2.0 * PI);
        let mut builder = SceneBuilder::default();
        builder.floor(radius as f32 + 10.0, out);
        let half_extents = Vec3::new(0.1, 0.5, 0.25);
        let stone = builder.shape(Shape::Cuboid { half_extents }, out);
        for place in 0..self.stones {
            let angle = 2.0 * PI * f64::from(place) / f64::from(places);
            let offset = f64::from(self.rng.signed()) * 0.02;
            let position = Vec3::new(
                (radius * libm::sin(angle)) as f32,
                half_extents.y,
                (radius * libm::cos(angle)) as f32,
            );
            let there = motion(position, about_y(angle + offset), Vec3::ZERO, Vec3::ZERO);
            let id = builder.body(BodyKind::Dynamic, stone, there, out);
            self.first.get_or_insert(id);
        }
    }
}

impl Script for Dominoes {
    fn name(&self) -> &'static str {
        "dominoes"
    }

    fn config(&self) -> SceneConfig {
        damped(surface(0.5, 500.0))
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        match (tick.value(), self.first) {
            (0, _) => self.build(out),
            // The ring runs along x at its first stone, whose upper edge is struck in that direction.
            (30, Some(id)) => out.push(Command::SetVelocity {
                id,
                linear: Vec3::new(0.75, 0.0, 0.0),
                angular: Vec3::new(0.0, 0.0, -1.5),
            }),
            _ => {}
        }
    }
}

/// Distance between neighbours along the ring, metres.
const STONE_SPACING: f64 = 0.55;
/// Number of empty positions.
const GAP: u32 = 4;

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
