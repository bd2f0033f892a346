//! A rotating drum with bodies inside, which never rest.
//!
//! Twelve kinematic staves on a circle of 4 m about z, 6 m long inside, and two ends close the drum. The controller
//! rotates all of them together at 1 rad/s, so nothing is pinched between them. Inside: balls, boxes and capsules of
//! 0.2 to 0.3 m. Friction 0.8, no bounce, damping 0.05 and 0.05 1/s.

use core::f64::consts::PI;

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyKind, Command, SceneConfig, Shape};
use rhumb_reckoning::{BodyId, BodyState, Tick};

use crate::script::{
    Controller, INTEGRATOR, SceneBuilder, SceneRng, Script, about_z, damped, motion, still, surface,
};

/// A drum with bodies inside.
#[derive(Clone, Debug)]
pub struct Tumbler {
    bodies: u32,
    rng: SceneRng,
}

impl Tumbler {
    /// Default number of bodies inside.
    pub const BODIES: u32 = 200;
    /// Largest number of bodies that fit inside.
    pub const BODIES_MAX: u32 = 448;

    /// A drum with `bodies` bodies inside, at most [`Self::BODIES_MAX`].
    #[must_use]
    pub fn new(bodies: u32, seed: u64) -> Self {
        Self {
            bodies: bodies.min(Self::BODIES_MAX),
            rng: SceneRng::new(seed),
        }
    }

    fn fill(&mut self, builder: &mut SceneBuilder, out: &mut Vec<Command>) {
        let shapes = SHAPES.map(|shape| builder.shape(shape, out));
        // Positions of a grid inside the drum, from below.
        let (across, deep) = (7, 8);
        for place in 0..self.bodies {
            let (x, z, y) = (
                place % across,
                place / across % deep,
                place / (across * deep),
            );
            let grid_point = Vec3::new(
                x as f32 - (across - 1) as f32 * 0.5,
                y as f32 - 3.5,
                z as f32 - (deep - 1) as f32 * 0.5,
            );
            let position = grid_point * Vec3::new(0.65, 0.55, 0.65) + self.rng.vector() * 0.01;
            let shape = shapes[self.rng.below(shapes.len() as u32) as usize];
            builder.body(BodyKind::Dynamic, shape, still(position), out);
        }
    }
}

impl Script for Tumbler {
    fn name(&self) -> &'static str {
        "tumbler"
    }

    fn config(&self) -> SceneConfig {
        damped(surface(0.8, 500.0))
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        if tick != Tick::ZERO {
            return;
        }
        let mut builder = SceneBuilder::default();
        let half = (RADIUS + THICKNESS) * libm::tan(PI / f64::from(STAVES));
        let half_extents = Vec3::new(half as f32, (THICKNESS * 0.5) as f32, 4.0);
        let stave = builder.shape(Shape::Cuboid { half_extents }, out);
        let half_extents = Vec3::new(5.0, 5.0, 0.5);
        let end = builder.shape(Shape::Cuboid { half_extents }, out);
        for number in 0..STAVES + ENDS.len() as u32 {
            let (position, rotation) = part_at(number, 0.0);
            let there = motion(position, rotation, Vec3::ZERO, Vec3::ZERO);
            let shape = if number < STAVES { stave } else { end };
            builder.body(BodyKind::Kinematic, shape, there, out);
        }
        self.fill(&mut builder, out);
    }

    fn controller(&self) -> Option<Box<dyn Controller>> {
        Some(Box::new(Turning))
    }
}

/// Rotates the drum.
struct Turning;

impl Controller for Turning {
    fn before_step(
        &mut self,
        tick: Tick,
        motion: &dyn Fn(BodyId) -> Option<BodyState>,
        out: &mut Vec<Command>,
    ) {
        let seconds = tick.next().value() as f64 * INTEGRATOR.rate.step().seconds();
        for number in 0..STAVES + ENDS.len() as u32 {
            let id = BodyId::new(number, 0);
            if motion(id).is_some() {
                let (position, rotation) = part_at(number, SPEED * seconds);
                out.push(Command::SetPose {
                    id,
                    position,
                    rotation,
                });
            }
        }
    }
}

/// Pose of a stave, or of an end, after the drum has rotated by `turned`, rad.
fn part_at(number: u32, turned: f64) -> (Vec3, Quat) {
    // Whole turns are removed, so that angles stay precise after hours.
    let whole = 2.0 * PI;
    let turned = turned - whole * libm::floor(turned / whole);
    if let Some(end) = number.checked_sub(STAVES) {
        return (Vec3::Z * ENDS[end as usize], about_z(turned));
    }
    let angle = whole * f64::from(number) / f64::from(STAVES) + turned;
    let distance = RADIUS + THICKNESS * 0.5;
    let position = Vec3::new(
        (-distance * libm::sin(angle)) as f32,
        (distance * libm::cos(angle)) as f32,
        0.0,
    );
    (position, about_z(angle))
}

const STAVES: u32 = 12;
/// Centres of the ends along z, metres.
const ENDS: [f32; 2] = [-3.5, 3.5];
/// Distance from the axis to the inner face of a stave, metres.
const RADIUS: f64 = 4.0;
/// Thickness of a stave, metres.
const THICKNESS: f64 = 0.5;
/// Angular speed of the drum, rad/s.
const SPEED: f64 = 1.0;

const SHAPES: [Shape; 3] = [
    Shape::Ball { radius: 0.25 },
    Shape::Cuboid {
        half_extents: Vec3::new(0.2, 0.2, 0.2),
    },
    Shape::Capsule {
        half_height: 0.1,
        radius: 0.15,
    },
];
