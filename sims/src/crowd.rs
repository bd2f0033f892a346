//! A crowd: balls that fall and roll in a pen, and boxes asleep around it.
//!
//! `awake_percent` sets the share of bodies in motion; the engine decides how many are really awake. The balls start
//! in a cubic grid, ten metres up and more, over a pen half as wide again as the grid. So they fall, spread and
//! collide for some seconds. The boxes start at rest, as in `rest`, well away from the pen. Friction 0.2 as in the
//! ball pit, no bounce, damping 0 and 0.05 1/s.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyKind, Command, SceneConfig, Shape};
use rhumb_reckoning::Tick;

use crate::ball_pit::BallPit;
use crate::builder::SceneBuilder;
use crate::cluster::Cluster;
use crate::defaults::{motion, still};
use crate::rng::SceneRng;
use crate::script::Script;

/// Balls in motion, and boxes asleep.
#[derive(Clone, Debug)]
pub struct Crowd {
    bodies: u32,
    balls: u32,
    rng: SceneRng,
}

impl Crowd {
    /// A scene of `bodies` bodies, of which `awake_percent` percent are balls in motion.
    #[must_use]
    pub fn new(bodies: u32, awake_percent: u32, seed: u64) -> Self {
        let balls = u64::from(bodies) * u64::from(awake_percent.min(100)) / 100;
        Self {
            bodies,
            balls: balls as u32,
            rng: SceneRng::new(seed),
        }
    }

    /// Half the width of the pen, metres.
    fn pen(&self) -> f32 {
        let side = (1..).find(|side: &u32| side.pow(3) >= self.balls);
        side.unwrap_or(1) as f32 * BALLS.spacing * 0.75 + 1.0
    }

    fn build_pen(&self, builder: &mut SceneBuilder, out: &mut Vec<Command>) {
        let half = self.pen();
        let half_extents = Vec3::new(half + 1.0, WALL * 0.5, 0.5);
        let wall = builder.shape(Shape::Cuboid { half_extents }, out);
        let quarter = Quat::from_xyzw(
            0.0,
            core::f32::consts::FRAC_1_SQRT_2,
            0.0,
            core::f32::consts::FRAC_1_SQRT_2,
        );
        for (x, z, turn) in [
            (0.0, half + 0.5, Quat::IDENTITY),
            (0.0, -half - 0.5, Quat::IDENTITY),
            (half + 0.5, 0.0, quarter),
            (-half - 0.5, 0.0, quarter),
        ] {
            let place = motion(Vec3::new(x, WALL * 0.5, z), turn, Vec3::ZERO, Vec3::ZERO);
            builder.body(BodyKind::Fixed, wall, place, out);
        }
    }

    /// Positions of boxes on a square grid around the pen, row by row.
    fn sleepers(&self, count: u32) -> impl Iterator<Item = Vec3> {
        let hole = ((self.pen() + 3.0) / APART).ceil() as i32;
        let enough = |half: &i32| {
            let places = |half: i32| (2 * i64::from(half) + 1).pow(2);
            places(*half) - places(hole) >= i64::from(count)
        };
        let half = (hole..).find(enough).unwrap_or(hole);
        let outside = move |(x, z): &(i32, i32)| x.abs() > hole || z.abs() > hole;
        (-half..=half)
            .flat_map(move |x| (-half..=half).map(move |z| (x, z)))
            .filter(outside)
            .take(count as usize)
            .map(|(x, z)| Vec3::new(x as f32 * APART, BOX, z as f32 * APART))
    }
}

impl Script for Crowd {
    fn name(&self) -> &'static str {
        "crowd"
    }

    fn config(&self) -> SceneConfig {
        BallPit::new(1, 1, 1).config()
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        if tick != Tick::ZERO {
            return;
        }
        let sleepers: Vec<_> = self.sleepers(self.bodies - self.balls).collect();
        let reach = sleepers
            .iter()
            .map(|place| place.x.abs().max(place.z.abs()));
        let mut builder = SceneBuilder::default();
        builder.floor(reach.fold(self.pen(), f32::max) + 10.0, out);
        self.build_pen(&mut builder, out);
        let ball = builder.shape(Shape::Ball { radius: 0.5 }, out);
        let half_extents = Vec3::splat(BOX);
        let cuboid = builder.shape(Shape::Cuboid { half_extents }, out);
        for place in BALLS.places(self.balls, &mut self.rng) {
            builder.body(BodyKind::Dynamic, ball, still(place), out);
        }
        for place in sleepers {
            builder.body(BodyKind::Dynamic, cuboid, still(place), out);
        }
    }
}

/// Half the width of a box, metres.
const BOX: f32 = 0.5;
/// Distance between the centres of neighbouring boxes, metres.
const APART: f32 = 1.5;
/// Height of the pen, metres. The balls start higher, but none flies out.
const WALL: f32 = 10.0;
const BALLS: Cluster = Cluster {
    centre: Vec3::new(0.0, 0.0, 0.0),
    lowest: 10.0,
    spacing: 1.1,
    jitter: 0.04,
};

#[cfg(test)]
mod tests {
    use super::*;

    fn dynamic(bodies: u32, awake_percent: u32) -> Vec<Vec3> {
        let mut commands = Vec::new();
        Crowd::new(bodies, awake_percent, 1).commands(Tick::ZERO, &mut commands);
        let place = |command: &Command| {
            assert_eq!(command.check(), Ok(()));
            match command {
                Command::AddBody { desc, motion } if desc.kind == BodyKind::Dynamic => {
                    Some(Vec3::from_array(motion.position()))
                }
                _ => None,
            }
        };
        commands.iter().filter_map(place).collect()
    }

    #[test]
    fn the_crowd_has_the_requested_bodies_and_the_requested_share_in_the_air() {
        for (bodies, percent, balls) in [(1_000, 5, 50), (1_000, 100, 1_000), (7, 0, 0), (0, 5, 0)]
        {
            let places = dynamic(bodies, percent);
            assert_eq!(places.len(), bodies as usize);
            let above = places.iter().filter(|place| place.y > 5.0);
            assert_eq!(above.count(), balls);
        }
    }

    #[test]
    fn nothing_overlaps_and_no_box_lies_in_the_pen() {
        let places = dynamic(400, 10);
        let pen = Crowd::new(400, 10, 1).pen();
        for (number, place) in places.iter().enumerate() {
            let flat = place.x.abs().max(place.z.abs());
            assert!(if number < 40 {
                flat < pen
            } else {
                flat > pen + 1.5
            });
            for other in &places[..number] {
                assert!(place.distance(*other) > 1.0);
            }
        }
    }
}
