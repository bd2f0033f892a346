//! Dominoes in a ring: the first is struck, and each strikes the next.
//!
//! Stones of 0.2 × 1 × 0.5 m, 0.55 m apart, with a gap before the first, so the last one falls on the floor. The first
//! is struck after half a second, when all sleep or are about to. Friction 0.5, no bounce, damping 0.05 and 0.05 1/s.

use core::f64::consts::PI;

use glam::Vec3;
use rhumb_protocol::scene::{BodyKind, Command, SceneConfig, Shape};
use rhumb_reckoning::{BodyId, Tick};

use crate::builder::{SceneBuilder, about_y};
use crate::defaults::{damped, motion, surface};
use crate::rng::SceneRng;
use crate::script::Script;

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
