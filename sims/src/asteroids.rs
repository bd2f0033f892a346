//! Asteroids: rocks that fly inside a sphere and keep their speed.
//!
//! The scene of a public benchmark of networking products for games (KinematicSoup, *UnityNetworkTransformBenchmark*,
//! its `SphereRingBenchmark`), with its numbers. Its model files are replaced by ours: eight rocks of 55 to 116
//! corners, 2.8–3.7 × 1.8–2.8 × 2.1–3.0 m, the same for every seed; scales are uniform over 751 steps. No gravity, no
//! damping, friction 0.6, no bounce; a rock of scale s has a mass of s³ kg. Nothing rests.
//!
//! Rocks: irregular convex hulls around their centre of mass. Jittered points of a uniform spiral on a sphere are
//! scaled along three axes and tapered by a projection that keeps all of them corners. Volume and centre are computed
//! in f64, so the bits are equal on every platform.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DVec3, Quat, Vec3};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, Hull, Material, SceneConfig, Shape, ShapeId,
};
use rhumb_reckoning::{BodyId, BodyState, Tick};

use crate::script::{Controller, INTEGRATOR, SceneRng, Script, flight, motion, still, surface};

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

/// A rock of scale one.
#[derive(Clone, Debug)]
struct Rock {
    /// Corners relative to the centre of mass, metres.
    pub(crate) points: Vec<Vec3>,
    /// Volume, m³.
    pub(crate) volume: f64,
    /// Distance of the farthest corner, metres.
    pub(crate) radius: f64,
}

impl Rock {
    /// A rock with `corners` corners and these extents along x, y and z, metres.
    pub(crate) fn new(corners: u32, extents: DVec3, rng: &mut SceneRng) -> Self {
        let mut points: Vec<_> = directions(corners, rng)
            .map(|direction| direction / (1.0 + TAPER * direction.dot(DVec3::new(0.6, 0.0, 0.8))))
            .collect();
        let least = points.iter().copied().fold(points[0], DVec3::min);
        let most = points.iter().copied().fold(points[0], DVec3::max);
        for point in &mut points {
            *point = (*point - (least + most) * 0.5) * extents / (most - least);
        }
        let (volume, centre) = solid(&points);
        let points: Vec<_> = points
            .iter()
            .map(|point| (*point - centre).as_vec3())
            .collect();
        let squared = points.iter().map(|point| point.as_dvec3().length_squared());
        let radius = libm::sqrt(squared.fold(0.0, f64::max));
        Self {
            points,
            volume,
            radius,
        }
    }
}

/// Difference in size between the two ends.
const TAPER: f64 = 0.2;
/// Largest jitter of a direction, as a share of the spacing.
const SHAKE: f64 = 0.25;

/// Unit vectors on a spiral of equal areas, with jitter.
fn directions(count: u32, rng: &mut SceneRng) -> impl Iterator<Item = DVec3> {
    let golden = core::f64::consts::PI * (3.0 - libm::sqrt(5.0));
    let apart = libm::sqrt(4.0 * core::f64::consts::PI / f64::from(count));
    (0..count).map(move |place| {
        let height = 1.0 - (2.0 * f64::from(place) + 1.0) / f64::from(count);
        let around = libm::sqrt(1.0 - height * height);
        let angle = golden * f64::from(place);
        let even = DVec3::new(around * libm::cos(angle), height, around * libm::sin(angle));
        let shaken = even + rng.vector().as_dvec3() * (SHAKE * apart);
        shaken / libm::sqrt(shaken.length_squared())
    })
}

/// Volume and centre of mass of the hull of points of which no four are coplanar.
///
/// A triangle with all other points on one side is a face; the tetrahedra from the origin to the faces make up the
/// solid. Cost is about cubic in the number of points, because most triangles are rejected early.
fn solid(points: &[DVec3]) -> (f64, DVec3) {
    let (mut volume, mut moment) = (0.0, DVec3::ZERO);
    for (i, a) in points.iter().enumerate() {
        for (j, b) in points.iter().enumerate().skip(i + 1) {
            for (k, c) in points.iter().enumerate().skip(j + 1) {
                let normal = (*b - *a).cross(*c - *a);
                let sides = || {
                    let others = points.iter().enumerate();
                    let others = others.filter(|(place, _)| ![i, j, k].contains(place));
                    others.map(|(_, other)| normal.dot(*other - *a) > 0.0)
                };
                let above = sides().next().unwrap_or(false);
                if sides().all(|side| side == above) {
                    let sixth = normal.dot(*a) * if above { -1.0 } else { 1.0 } / 6.0;
                    volume += sixth;
                    moment += (*a + *b + *c) * (sixth * 0.25);
                }
            }
        }
    }
    (volume, moment / volume)
}

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

    #[test]
    fn a_tetrahedron_has_a_sixth_of_the_volume_and_its_centre_at_the_mean_corner() {
        let shift = DVec3::new(3.0, -2.0, 5.0);
        let points = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|point| point + shift);
        let (volume, centre) = solid(&points);
        assert!((volume - 1.0 / 6.0).abs() < 1e-12);
        assert!((centre - shift - DVec3::splat(0.25)).length() < 1e-12);
    }

    #[test]
    fn a_rock_of_many_corners_has_nearly_the_volume_of_its_ellipsoid() {
        let extents = DVec3::new(3.0, 2.0, 2.5);
        let rock = Rock::new(116, extents, &mut SceneRng::new(5));
        let ellipsoid = core::f64::consts::PI / 6.0 * extents.element_product();
        assert_eq!(rock.points.len(), 116);
        assert!(
            rock.volume > 0.85 * ellipsoid && rock.volume < ellipsoid,
            "{}",
            rock.volume
        );
        assert!(rock.radius > 1.4 && rock.radius < 1.75, "{}", rock.radius);
    }
}
