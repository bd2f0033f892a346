//! The ball pit, and a crowd: balls in a pen with boxes asleep around it.
//!
//! The scene comes from the paper. Details that the paper leaves open:
//!
//! - **Walls.** A wall of radius R is a ring of ⌈10·√R⌉ upright cuboids, solid instead of a mesh sheet. Their inner
//!   faces touch the circle of radius R from outside, so their edges are at most 5 cm off the circle. Each is 5 m
//!   high, 0.5 m thick and long enough to meet its neighbours at the *outer* edge; inside they overlap, so there is no
//!   gap.
//! - **Floor.** A cuboid of 220 × 10 × 220 m with its top at y = 0, thick enough to prevent tunnelling.
//! - **Spawner.** All balls of a cycle appear at its first tick, at rest, in a cubic grid with a spacing of 1.1 m.
//!   Each is offset by up to 4 cm per axis, so centres are at least 1.02 m apart and none overlap. The centre of the
//!   grid is 15 m above the pit's; a grid that would reach below 6 m, the clearance of the walls, is raised.
//!
//! A crowd: balls that fall and roll in a pen, and boxes asleep around it. `awake_percent` sets the share of bodies in
//! motion; the engine decides how many are really awake. The balls start in a cubic grid, ten metres up and more, over
//! a pen half as wide again as the grid. So they fall, spread and collide for some seconds. The boxes start at rest,
//! as in `rest`, well away from the pen. Friction 0.2 as in the ball pit, no bounce, damping 0 and 0.05 1/s.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, SceneConfig, Shape, ShapeId};
use rhumb_reckoning::{BodyId, BodyState, Damping, Tick};

use crate::script::{Cluster, INTEGRATOR, SceneBuilder, SceneRng, Script, motion, still, surface};

/// The paper's evaluation scene.
#[derive(Clone, Debug)]
pub struct BallPit {
    balls_per_cycle: u32,
    cycles: u32,
    rng: SceneRng,
    /// Index of the next body.
    next: u32,
}

impl BallPit {
    /// Balls per cycle in the paper.
    pub const BALLS_PER_CYCLE: u32 = 500;
    /// Number of balls at which the paper's experiment ends.
    pub const BALLS: u32 = 10_000;
    /// Length of a cycle, simulated seconds.
    pub const CYCLE_SECONDS: u32 = 30;
    /// Walls, of radii 10 m, 20 m, ... 100 m.
    pub const WALLS: u32 = 10;

    /// A pit with `cycles` cycles of `balls_per_cycle` balls.
    #[must_use]
    pub fn new(balls_per_cycle: u32, cycles: u32, seed: u64) -> Self {
        Self {
            balls_per_cycle,
            cycles,
            rng: SceneRng::new(seed),
            next: 0,
        }
    }

    /// `balls` per cycle, and as many cycles as stay within [`Self::BALLS`], at least one.
    #[must_use]
    pub fn sized(balls: u32, seed: u64) -> Self {
        let cycles = (Self::BALLS / balls.max(1)).max(1);
        Self::new(balls, cycles, seed)
    }

    /// The pit of the paper.
    #[must_use]
    pub fn paper(seed: u64) -> Self {
        Self::sized(Self::BALLS_PER_CYCLE, seed)
    }

    /// Number of cuboids of a wall; walls count from one.
    fn segments(wall: u32) -> u32 {
        libm::ceil(10.0 * libm::sqrt(f64::from(wall * 10))) as u32
    }

    fn build(&mut self, out: &mut Vec<Command>) {
        out.push(Command::AddShape {
            id: FLOOR,
            shape: Shape::Cuboid {
                half_extents: Vec3::new(110.0, 5.0, 110.0),
            },
        });
        self.place(
            BodyKind::Fixed,
            FLOOR,
            still(Vec3::new(0.0, -5.0, 0.0)),
            out,
        );
        for wall in 1..=Self::WALLS {
            self.build_wall(wall, out);
        }
        out.push(Command::AddShape {
            id: BALL,
            shape: Shape::Ball { radius: 0.5 },
        });
    }

    fn build_wall(&mut self, wall: u32, out: &mut Vec<Command>) {
        let radius = f64::from(wall * 10);
        let count = Self::segments(wall);
        let half_angle = core::f64::consts::PI / f64::from(count);
        let half_length = (radius + THICKNESS) * libm::tan(half_angle);
        let shape = ShapeId(wall);
        out.push(Command::AddShape {
            id: shape,
            shape: Shape::Cuboid {
                half_extents: Vec3::new(
                    half_length as f32,
                    (HEIGHT * 0.5) as f32,
                    (THICKNESS * 0.5) as f32,
                ),
            },
        });
        for segment in 0..count {
            // Rotated about y by the angle; unrotated, a segment lies along x with its outer face towards +z.
            let angle = 2.0 * half_angle * f64::from(segment);
            let distance = radius + THICKNESS * 0.5;
            let position = Vec3::new(
                (distance * libm::sin(angle)) as f32,
                (HEIGHT * 0.5) as f32,
                (distance * libm::cos(angle)) as f32,
            );
            let (y, w) = (libm::sin(angle * 0.5), libm::cos(angle * 0.5));
            let rotation = Quat::from_xyzw(0.0, y as f32, 0.0, w as f32);
            let place = motion(position, rotation, Vec3::ZERO, Vec3::ZERO);
            self.place(BodyKind::Fixed, shape, place, out);
        }
    }

    fn drop_balls(&mut self, out: &mut Vec<Command>) {
        let mut rng = self.rng.clone();
        for position in SPAWNER.places(self.balls_per_cycle, &mut rng) {
            self.place(BodyKind::Dynamic, BALL, still(position), out);
        }
        self.rng = rng;
    }

    fn place(&mut self, kind: BodyKind, shape: ShapeId, motion: BodyState, out: &mut Vec<Command>) {
        let id = BodyId::new(self.next, 0);
        self.next += 1;
        out.push(Command::AddBody {
            desc: BodyDesc::plain(id, kind, shape),
            motion,
        });
    }
}

impl Script for BallPit {
    fn name(&self) -> &'static str {
        "ball-pit"
    }

    fn config(&self) -> SceneConfig {
        SceneConfig {
            material: surface(0.2, 1_000.0),
            damping: Damping {
                linear: 0.0,
                angular: 0.05,
            },
            ..SceneConfig::default()
        }
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        if tick == Tick::ZERO {
            self.build(out);
        }
        let cycle_ticks = u64::from(Self::CYCLE_SECONDS * INTEGRATOR.rate.ticks());
        let cycle = tick.value() / cycle_ticks;
        if tick.value().is_multiple_of(cycle_ticks) && cycle < u64::from(self.cycles) {
            self.drop_balls(out);
        }
    }
}

const FLOOR: ShapeId = ShapeId(0);
/// The walls' shapes have their walls' numbers; this one follows them.
const BALL: ShapeId = ShapeId(BallPit::WALLS + 1);
/// Height of the walls, metres.
const HEIGHT: f64 = 5.0;
/// Thickness of the walls, metres.
const THICKNESS: f64 = 0.5;

const SPAWNER: Cluster = Cluster {
    centre: Vec3::new(0.0, 15.0, 0.0),
    lowest: 6.0,
    spacing: 1.1,
    jitter: 0.04,
};

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

    fn first(script: &mut BallPit) -> Vec<Command> {
        let mut commands = Vec::new();
        script.commands(Tick::ZERO, &mut commands);
        commands
    }

    fn balls(commands: &[Command]) -> Vec<Vec3> {
        let place = |command: &Command| match command {
            Command::AddBody { desc, motion } if desc.shape == BALL => {
                Some(Vec3::from_array(motion.position()))
            }
            _ => None,
        };
        commands.iter().filter_map(place).collect()
    }

    #[test]
    fn balls_start_apart_and_above_the_walls() {
        for count in [1, 2, 500, 3_000] {
            let places = balls(&first(&mut BallPit::new(count, 1, 7)));
            assert_eq!(places.len(), count as usize);
            for (i, place) in places.iter().enumerate() {
                assert!(place.y >= 6.0);
                for other in &places[..i] {
                    assert!(place.distance(*other) > 1.0);
                }
            }
        }
    }

    #[test]
    fn a_seed_fixes_every_command() {
        let script = |seed| first(&mut BallPit::paper(seed));
        assert_eq!(script(1), script(1));
        assert_ne!(script(1), script(2));
        assert!(script(1).iter().all(|command| command.check().is_ok()));
    }

    #[test]
    fn cycles_end_at_the_papers_ten_thousand() {
        let mut script = BallPit::paper(3);
        let mut commands = Vec::new();
        for cycle in 0..25 {
            script.commands(Tick::new(cycle * 1_800), &mut commands);
            script.commands(Tick::new(cycle * 1_800 + 1), &mut commands);
        }
        assert_eq!(balls(&commands).len(), 10_000);
    }

    #[test]
    fn walls_have_no_gap_and_are_at_most_five_centimetres_off_their_circle() {
        for wall in 1..=BallPit::WALLS {
            let radius = f64::from(wall * 10);
            let half_angle = core::f64::consts::PI / f64::from(BallPit::segments(wall));
            assert!(radius / half_angle.cos() - radius < 0.05);
        }
    }

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
