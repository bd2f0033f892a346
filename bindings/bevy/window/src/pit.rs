//! The pit: a floor, a ring of walls, and balls above them.

use std::f32::consts::{PI, TAU};

use bevy::math::{Quat, Vec3};
use rhumb_client::scene::{BodyBuilder, BodyDesc, Material, SceneConfig, Shape, Stepping};

/// Radius of the ring, metres.
const RING: f32 = 6.0;
/// Walls of the ring.
const WALLS: u8 = 24;
/// Half the height and half the thickness of a wall, metres.
const WALL: (f32, f32) = (1.0, 0.15);
/// Balls along each edge of the falling block, and layers of it.
const BALLS: (u8, u8) = (8, 6);
const RADIUS: f32 = 0.4;
/// Mass of a cubic metre, kg.
const DENSITY: f32 = 1_000.0;

/// Runs by the server's clock; balls bounce a little.
pub(crate) fn config() -> SceneConfig {
    SceneConfig {
        stepping: Stepping::FreeRunning,
        material: Material {
            friction: 0.4,
            restitution: 0.4,
            density: DENSITY,
        },
        ..SceneConfig::default()
    }
}

/// All bodies of the scene.
pub(crate) fn bodies() -> Vec<BodyBuilder> {
    let mut bodies = vec![BodyDesc::fixed(Shape::cuboid(12.0, 0.5, 12.0)).at(0.0, -0.5, 0.0)];
    let half_length = (RING + 2.0 * WALL.1) * (PI / f32::from(WALLS)).tan();
    let wall = Shape::cuboid(half_length, WALL.0, WALL.1);
    bodies.extend((0..WALLS).map(|i| {
        let turn = Quat::from_rotation_y(TAU * f32::from(i) / f32::from(WALLS));
        let at = turn * Vec3::new(0.0, WALL.0, RING + WALL.1);
        let body = BodyDesc::fixed(wall.clone()).at(at.x, at.y, at.z);
        body.rotation(rhumb_client::glam::Quat::from_array(turn.to_array()))
    }));
    let (edge, layers) = BALLS;
    let from_middle = |i: u8| 2.2 * RADIUS * (f32::from(i) - 0.5 * f32::from(edge - 1));
    for layer in 0..layers {
        for (row, column) in (0..edge).flat_map(|row| (0..edge).map(move |column| (row, column))) {
            // Each layer is a little aside of the one below, so that balls roll off each other.
            let aside = 0.1 * f32::from(layer % 3);
            let height = 5.0 + 2.2 * RADIUS * f32::from(layer);
            let at = [
                from_middle(row) + aside,
                height,
                from_middle(column) - aside,
            ];
            bodies.push(BodyDesc::dynamic(Shape::ball(RADIUS)).position(at));
        }
    }
    bodies
}

/// The mass of a ball, kg; `None` for another shape.
pub(crate) fn ball_mass(shape: &Shape) -> Option<f32> {
    match shape {
        Shape::Ball { radius } => Some(DENSITY * 4.0 / 3.0 * PI * radius.powi(3)),
        _ => None,
    }
}
