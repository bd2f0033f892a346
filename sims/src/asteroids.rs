//! Asteroids: rocks that fly inside a sphere and keep their speed.
//!
//! The scene of a public benchmark of networking products for games (KinematicSoup, *UnityNetworkTransformBenchmark*,
//! its `SphereRingBenchmark`), with its numbers. Its model files are replaced by ours: eight rocks of 55 to 116
//! corners, 2.8–3.7 × 1.8–2.8 × 2.1–3.0 m, the same for every seed; scales are uniform over 751 steps. No gravity, no
//! damping, friction 0.6, no bounce; a rock of scale s has a mass of s³ kg. Nothing rests.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DVec3, Quat, Vec3};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, Hull, Material, SceneConfig, Shape, ShapeId,
};
use rhumb_reckoning::{BodyId, BodyState, Tick};

use crate::controller::{Controller, flight};
use crate::defaults::{INTEGRATOR, motion, still, surface};
use crate::rng::SceneRng;
use crate::rock::Rock;
use crate::script::Script;

/// The rocks' rotation: with gyroscopic forces, or without them as in many engines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spin {
    /// Gyroscopic forces act, so the axis of a spin wanders.
    Gyroscopic,
    /// No gyroscopic forces: the axis of a spin stays.
    Plain,
}

/// Rocks around a central sphere.
#[derive(Clone, Debug)]
pub struct Asteroids {
    flock: Flock,
    spin: Spin,
}

impl Asteroids {
    /// Number of rocks in the benchmark.
    pub const ROCKS: u32 = 250;

    /// A scene of `rocks` rocks.
    #[must_use]
    pub fn new(rocks: u32, seed: u64, spin: Spin) -> Self {
        Self {
            flock: Flock::new(rocks, seed),
            spin,
        }
    }
}

impl Script for Asteroids {
    fn name(&self) -> &'static str {
        match self.spin {
            Spin::Gyroscopic => "asteroids",
            Spin::Plain => "asteroids-plain",
        }
    }

    fn config(&self) -> SceneConfig {
        SceneConfig {
            gravity: Vec3::ZERO,
            material: surface(FRICTION, 1.0),
            ..SceneConfig::default()
        }
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        if tick != Tick::ZERO {
            return;
        }
        let (id, shape) = (CENTRE_SHAPE, Shape::Ball { radius: CENTRE });
        out.push(Command::AddShape { id, shape });
        out.push(Command::AddBody {
            desc: BodyDesc::plain(BodyId::new(0, 0), BodyKind::Fixed, id),
            motion: still(Vec3::ZERO),
        });
        let mut known = BTreeSet::new();
        for (flock_rock, index) in self.flock.members.iter().zip(1..) {
            let rock = &self.flock.rocks[flock_rock.rock as usize];
            let id = ShapeId(1 + flock_rock.rock * (SCALE_STEPS + 1) + flock_rock.step);
            if known.insert(id) {
                let scale = flock_rock.scale() as f32;
                let points: Vec<_> = rock.points.iter().map(|point| *point * scale).collect();
                let hull = Hull::new(&points).expect("rocks are thick, and within the limits");
                let shape = Shape::Hull(hull);
                out.push(Command::AddShape { id, shape });
            }
            let mut desc = BodyDesc::plain(BodyId::new(index, 0), BodyKind::Dynamic, id);
            desc.gyroscopic = self.spin == Spin::Gyroscopic;
            desc.material = Some(Material {
                friction: FRICTION,
                restitution: 0.0,
                density: (1.0 / rock.volume) as f32,
            });
            let motion = flock_rock.motion;
            out.push(Command::AddBody { desc, motion });
        }
    }

    fn controller(&self) -> Option<Box<dyn Controller>> {
        let members = self.flock.members.iter();
        Some(Box::new(Herding {
            bounds: self.flock.bounds,
            thrusts: members
                .map(|flock_rock| (flock_rock.mass(), flock_rock.speed))
                .collect(),
        }))
    }
}

/// Keeps rocks at their speeds and within bounds.
struct Herding {
    /// Radius of the bounds, metres.
    bounds: f64,
    /// Mass in kg and target speed in m/s of each rock; their body indices start at one.
    thrusts: Vec<(f64, f64)>,
}

impl Controller for Herding {
    fn before_step(
        &mut self,
        _: Tick,
        motion: &dyn Fn(BodyId) -> Option<BodyState>,
        out: &mut Vec<Command>,
    ) {
        for ((mass, target), index) in self.thrusts.iter().zip(1..) {
            let id = BodyId::new(index, 0);
            let Some(motion) = motion(id) else { continue };
            let (position, velocity) = flight(&motion);
            let acceleration = self.acceleration(position.as_dvec3(), velocity.as_dvec3(), *target);
            if let Some(acceleration) = acceleration {
                let force = (acceleration * *mass).as_vec3();
                out.push(Command::Force { id, force });
            }
        }
    }
}

impl Herding {
    /// Acceleration in m/s²: towards the centre outside the bounds; along the velocity, to the target speed, inside.
    fn acceleration(&self, position: DVec3, velocity: DVec3, target: f64) -> Option<DVec3> {
        let squared = position.length_squared();
        if squared > self.bounds * self.bounds {
            return Some(position * (-HOMEWARD / libm::sqrt(squared)));
        }
        let squared = velocity.length_squared();
        if squared == 0.0 || (squared - target * target).abs() <= NEAR_ENOUGH {
            return None;
        }
        let speed = libm::sqrt(squared);
        let wanted = (target - speed) / INTEGRATOR.rate.step().seconds();
        Some(velocity * (wanted.clamp(-THRUST, THRUST) / speed))
    }
}

/// Initial state of all rocks, shared by script and controller.
#[derive(Clone, Debug)]
struct Flock {
    rocks: Vec<Rock>,
    members: Vec<FlockRock>,
    /// Radius of the bounds, metres.
    bounds: f64,
}

#[derive(Clone, Copy, Debug)]
struct FlockRock {
    rock: u32,
    /// Step of the rock's scale.
    step: u32,
    /// Target speed, m/s.
    speed: f64,
    motion: BodyState,
}

impl FlockRock {
    fn scale(&self) -> f64 {
        0.25 + 0.75 * f64::from(self.step) / f64::from(SCALE_STEPS)
    }

    fn mass(&self) -> f64 {
        let scale = self.scale();
        scale * scale * scale
    }
}

impl Flock {
    fn new(count: u32, seed: u64) -> Self {
        let mut shaping = SceneRng::new(ROCKS_SEED);
        let rocks: Vec<_> = (0..ROCKS).map(|_| rock(&mut shaping)).collect();
        let bounds = (50.0 * libm::cbrt(f64::from(count) / 1_000.0)).max(10.0);
        let mut rng = SceneRng::new(seed);
        let mut free_space = FreeSpace::default();
        let members = (0..count).map(|_| flock_rock(&rocks, bounds, &mut free_space, &mut rng));
        Self {
            members: members.collect(),
            rocks,
            bounds,
        }
    }
}

fn rock(rng: &mut SceneRng) -> Rock {
    let between = |rng: &mut SceneRng, least: f64, most: f64| {
        least + (most - least) * (f64::from(rng.signed()) * 0.5 + 0.5)
    };
    let extents = DVec3::new(
        between(rng, 2.8, 3.7),
        between(rng, 1.8, 2.8),
        between(rng, 2.1, 3.0),
    );
    Rock::new(55 + rng.below(62), extents, rng)
}

fn flock_rock(
    rocks: &[Rock],
    bounds: f64,
    free_space: &mut FreeSpace,
    rng: &mut SceneRng,
) -> FlockRock {
    let mut flock_rock = FlockRock {
        rock: rng.below(ROCKS),
        step: rng.below(SCALE_STEPS + 1),
        speed: 2.5 + 1.5 * f64::from(rng.signed()),
        motion: still(Vec3::ZERO),
    };
    let position = rng.in_ball().as_dvec3() * bounds;
    let scale = flock_rock.scale();
    let position = free_space.take(
        position,
        2.0 * scale,
        rocks[flock_rock.rock as usize].radius * scale,
    );
    let direction = loop {
        let drawn = rng.in_ball().as_dvec3();
        let length = libm::sqrt(drawn.length_squared());
        if length > 0.1 {
            break drawn / length;
        }
    };
    let rotation: Quat = rng.rotation();
    let linear = (direction * flock_rock.speed).as_vec3();
    let angular = (rng.in_ball().as_dvec3() * MOST_SPIN).as_vec3();
    flock_rock.motion = motion(position.as_vec3(), rotation, linear, angular);
    flock_rock
}

/// Occupied balls, in the cells of a grid that is wider than the reach of any two.
#[derive(Debug, Default)]
struct FreeSpace {
    cells: BTreeMap<[i32; 3], Vec<(DVec3, f64)>>,
}

impl FreeSpace {
    const CELL: f64 = 4.0;

    fn cell(position: DVec3) -> [i32; 3] {
        let part = |part: f64| libm::floor(part / Self::CELL) as i32;
        [part(position.x), part(position.y), part(position.z)]
    }

    /// The first position from `position` outward whose ball of `clear` metres overlaps no occupied one; occupies a
    /// ball of `radius` there.
    fn take(&mut self, mut position: DVec3, clear: f64, radius: f64) -> DVec3 {
        let length = libm::sqrt(position.length_squared());
        let outward = if length > 0.0 {
            position / length
        } else {
            DVec3::X
        };
        while !self.is_free(position, clear) {
            position += outward * clear;
        }
        let cell = self.cells.entry(Self::cell(position)).or_default();
        cell.push((position, radius));
        position
    }

    fn is_free(&self, position: DVec3, clear: f64) -> bool {
        let reaches = |other: DVec3, radius: f64| {
            let reach = clear + radius;
            (position - other).length_squared() < reach * reach
        };
        if reaches(DVec3::ZERO, f64::from(CENTRE)) {
            return false;
        }
        let [x, y, z] = Self::cell(position);
        let around =
            (-1..=1).flat_map(|i| (-1..=1).flat_map(move |j| (-1..=1).map(move |k| [i, j, k])));
        let mut cells = around.filter_map(|[i, j, k]| self.cells.get(&[x + i, y + j, z + k]));
        !cells.any(|cell| cell.iter().any(|(other, radius)| reaches(*other, *radius)))
    }
}

/// Number of different rock shapes.
const ROCKS: u32 = 8;
/// Seed of the rock shapes: the benchmark's own.
const ROCKS_SEED: u64 = 2_323;
/// Number of scale steps between the smallest and the largest rock.
const SCALE_STEPS: u32 = 750;
const FRICTION: f32 = 0.6;
/// Radius of the central sphere, metres.
const CENTRE: f32 = 5.0;
const CENTRE_SHAPE: ShapeId = ShapeId(0);
/// Largest spin: 45° per second, in rad/s.
const MOST_SPIN: f64 = core::f64::consts::FRAC_PI_4;
/// Acceleration of a rock out of bounds, m/s².
const HOMEWARD: f64 = 10.0;
/// Acceleration towards the target speed, m/s².
const THRUST: f64 = 5.0;
/// Difference of squared speeds that is not corrected, m²/s².
const NEAR_ENOUGH: f64 = 0.001;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rocks_start_apart_within_the_benchmarks_ranges() {
        let flock = Flock::new(Asteroids::ROCKS, 7);
        assert!((flock.bounds - 31.498).abs() < 1e-3);
        for rock in &flock.rocks {
            assert!((55..=116).contains(&rock.points.len()));
            assert!((1.4..1.95).contains(&rock.radius), "{}", rock.radius);
        }
        for (place, flock_rock) in flock.members.iter().enumerate() {
            let (position, velocity) = flight(&flock_rock.motion);
            assert!((0.25..=1.0).contains(&flock_rock.scale()));
            assert!((1.0..=4.0).contains(&flock_rock.speed));
            assert!((f64::from(velocity.length()) - flock_rock.speed).abs() < 1e-4);
            let radius = |flock_rock: &FlockRock| {
                flock.rocks[flock_rock.rock as usize].radius * flock_rock.scale()
            };
            assert!(f64::from(position.length()) > 5.0 + radius(flock_rock));
            for other in &flock.members[..place] {
                let apart = flight(&other.motion).0.distance(position);
                assert!(f64::from(apart) > radius(flock_rock) + radius(other));
            }
        }
    }

    #[test]
    fn a_rock_returns_from_outside_and_regains_its_speed_inside() {
        let herding = Herding {
            bounds: 30.0,
            thrusts: Vec::new(),
        };
        let acceleration = |x, speed| herding.acceleration(DVec3::X * x, DVec3::Z * speed, 2.0);
        assert_eq!(acceleration(31.0, 2.0), Some(DVec3::X * -10.0));
        assert_eq!(acceleration(10.0, 2.0), None);
        assert_eq!(acceleration(10.0, 1.0), Some(DVec3::Z * 5.0));
        assert_eq!(acceleration(10.0, 4.0), Some(DVec3::Z * -5.0));
        let close = acceleration(10.0, 1.99).expect("it is too slow");
        assert!((close.z - 0.6).abs() < 1e-9, "{close}");
    }
}
