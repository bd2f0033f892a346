//! A scene's script: its trait, its controller, a builder, random numbers.
//!
//! Applies nothing: the caller sends a script's commands, steps the scene, and polls the script again. A controller's
//! commands depend on the bodies' motions. Invariant: they are a function of the script's name, number of bodies and
//! seed, and of the motions, bit exact on every platform.
//!
//! Random numbers are PCG integers, converted to f32 by exact steps, so every platform draws the same bits. Many bodies
//! close together stand in a cubic grid filled layer by layer from below; each position is offset randomly from its grid
//! point.

use core::num::NonZeroU32;

use glam::{Quat, Vec3};
use rand_pcg::Pcg32;
use rand_pcg::rand_core::Rng;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, Material, SceneConfig, Shape, ShapeId};
use rhumb_reckoning::{BodyId, BodyState, Damping, Integrator, Rate, Tick};

/// A sequence of numbers determined by its seed.
#[derive(Clone, Debug)]
pub(crate) struct SceneRng {
    draws: Pcg32,
}

impl SceneRng {
    /// The generator's stream number; any odd constant works, this is PCG's own example.
    const STREAM: u64 = 0x0a02_bdbf_7bb3_c0a7;

    pub(crate) fn new(seed: u64) -> Self {
        Self {
            draws: Pcg32::new(seed, Self::STREAM),
        }
    }

    /// A number in [−1, 1), a multiple of 2⁻²³.
    pub(crate) fn signed(&mut self) -> f32 {
        (self.draws.next_u32() >> 8) as f32 / 8_388_608.0 - 1.0
    }

    /// Each component in [−1, 1).
    pub(crate) fn vector(&mut self) -> Vec3 {
        let (x, y, z) = (self.signed(), self.signed(), self.signed());
        Vec3::new(x, y, z)
    }

    /// A uniformly distributed point in the unit ball.
    pub(crate) fn in_ball(&mut self) -> Vec3 {
        loop {
            let drawn = self.vector();
            let squared: f64 = drawn
                .to_array()
                .map(|part| f64::from(part) * f64::from(part))
                .iter()
                .sum();
            if squared <= 1.0 {
                return drawn;
            }
        }
    }

    /// A number below `count`, which must not be zero.
    pub(crate) fn below(&mut self, count: u32) -> u32 {
        ((u64::from(self.draws.next_u32()) * u64::from(count)) >> 32) as u32
    }

    /// A unit quaternion; its distribution is not uniform, which scripts do not need.
    pub(crate) fn rotation(&mut self) -> Quat {
        let axis = self.vector();
        // The constant real part keeps the length away from zero. Square root and division round alike everywhere.
        let [x, y, z, w] = [axis.x, axis.y, axis.z, 0.25].map(f64::from);
        let length = libm::sqrt(x * x + y * y + z * z + w * w);
        let [x, y, z, w] = [x, y, z, w].map(|part| (part / length) as f32);
        Quat::from_xyzw(x, y, z, w)
    }
}

/// A cube of positions around a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cluster {
    /// Centre of the cube; it is raised if the cube would reach below `lowest`.
    pub(crate) centre: Vec3,
    /// Least height of a position, metres.
    pub(crate) lowest: f32,
    /// Spacing of the grid, metres.
    pub(crate) spacing: f32,
    /// Largest offset from the grid point along each axis, metres.
    pub(crate) jitter: f32,
}

impl Cluster {
    /// `count` positions; neighbours are at least `spacing − 2·jitter` apart.
    pub(crate) fn places(self, count: u32, rng: &mut SceneRng) -> impl Iterator<Item = Vec3> {
        let side = (1..).find(|side: &u32| side.pow(3) >= count).unwrap_or(1);
        let half = (side - 1) as f32 * self.spacing * 0.5;
        let bottom = (self.centre.y - half).max(self.lowest + self.jitter);
        let corner = Vec3::new(self.centre.x - half, bottom, self.centre.z - half);
        (0..count).map(move |place| {
            let (x, z, y) = (place % side, place / side % side, place / (side * side));
            let grid_point = Vec3::new(x as f32, y as f32, z as f32) * self.spacing;
            corner + grid_point + rng.vector() * self.jitter
        })
    }
}

/// A scene as a sequence of commands.
///
/// A script assigns ids of shapes and bodies from zero upward. A scene that receives no other commands accepts all of
/// the script's.
pub trait Script: Send {
    /// Name on the command line.
    fn name(&self) -> &'static str;

    /// Config with which the scene is created.
    fn config(&self) -> SceneConfig;

    /// Appends the commands that precede the step from `tick`.
    ///
    /// Called once for each tick, from [`Tick::ZERO`] on without a gap.
    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>);

    /// The scene's controller, if it has one; equal on every call.
    fn controller(&self) -> Option<Box<dyn Controller>> {
        None
    }
}

/// Acts on bodies from inside the server or the local process, without network traffic.
pub trait Controller: Send {
    /// Appends the commands that precede the step from `tick`: forces, velocities and poses, nothing else.
    ///
    /// `motion` returns the current state of a body, or `None` if the body does not exist at this tick.
    fn before_step(
        &mut self,
        tick: Tick,
        motion: &dyn Fn(BodyId) -> Option<BodyState>,
        out: &mut Vec<Command>,
    );
}

/// Position and linear velocity of a body, world frame, m and m/s.
pub(crate) fn flight(motion: &BodyState) -> (Vec3, Vec3) {
    let parts = motion.parts();
    (
        Vec3::from_slice(&parts[..3]),
        Vec3::from_slice(&parts[7..10]),
    )
}

/// The next free ids.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SceneBuilder {
    bodies: u32,
    shapes: u32,
}

impl SceneBuilder {
    pub(crate) fn shape(&mut self, shape: Shape, out: &mut Vec<Command>) -> ShapeId {
        let id = ShapeId(self.shapes);
        self.shapes += 1;
        out.push(Command::AddShape { id, shape });
        id
    }

    /// Adds a body with the scene's default material and damping.
    pub(crate) fn body(
        &mut self,
        kind: BodyKind,
        shape: ShapeId,
        motion: BodyState,
        out: &mut Vec<Command>,
    ) -> BodyId {
        self.with(|id| BodyDesc::plain(id, kind, shape), motion, out)
    }

    /// Adds a body with any descriptor.
    pub(crate) fn with(
        &mut self,
        desc: impl FnOnce(BodyId) -> BodyDesc,
        motion: BodyState,
        out: &mut Vec<Command>,
    ) -> BodyId {
        let id = BodyId::new(self.bodies, 0);
        self.bodies += 1;
        let desc = desc(id);
        out.push(Command::AddBody { desc, motion });
        id
    }

    /// Adds a slab with its top at y = 0 that reaches `half` metres each way, thick enough to prevent tunnelling.
    pub(crate) fn floor(&mut self, half: f32, out: &mut Vec<Command>) -> BodyId {
        let half_extents = Vec3::new(half, 5.0, half);
        let slab = self.shape(Shape::Cuboid { half_extents }, out);
        let place = still(Vec3::new(0.0, -5.0, 0.0));
        self.body(BodyKind::Fixed, slab, place, out)
    }
}

/// Rotation about y by an angle, radians.
pub(crate) fn about_y(angle: f64) -> Quat {
    let (sin, cos) = (libm::sin(angle * 0.5), libm::cos(angle * 0.5));
    Quat::from_xyzw(0.0, sin as f32, 0.0, cos as f32)
}

/// Rotation about z by an angle, radians.
pub(crate) fn about_z(angle: f64) -> Quat {
    let (sin, cos) = (libm::sin(angle * 0.5), libm::cos(angle * 0.5));
    Quat::from_xyzw(0.0, 0.0, sin as f32, cos as f32)
}

/// Integrator of all scenes: 60 Hz, four substeps.
pub(crate) const INTEGRATOR: Integrator = Integrator {
    rate: Rate::HZ_60,
    substeps: NonZeroU32::new(4).expect("four is not zero"),
};

/// Earth's gravity, along y, m/s².
pub(crate) const GRAVITY: Vec3 = Vec3::new(0.0, -9.806_65, 0.0);

/// A material without bounce; density in kg/m³.
pub(crate) const fn surface(friction: f32, density: f32) -> Material {
    Material {
        friction,
        restitution: 0.0,
        density,
    }
}

/// A scene whose bodies are slowed a little, by 0.05 1/s.
pub(crate) fn damped(material: Material) -> SceneConfig {
    SceneConfig {
        material,
        damping: Damping {
            linear: 0.05,
            angular: 0.05,
        },
        ..SceneConfig::default()
    }
}

/// A body state; the script guarantees finite parts and a unit quaternion.
pub(crate) fn motion(position: Vec3, rotation: Quat, linear: Vec3, angular: Vec3) -> BodyState {
    BodyState::new(
        position.to_array(),
        rotation.to_array(),
        linear.to_array(),
        angular.to_array(),
    )
    .expect("scripts place bodies at finite poses")
}

/// A state at rest.
pub(crate) fn still(position: Vec3) -> BodyState {
    motion(position, Quat::IDENTITY, Vec3::ZERO, Vec3::ZERO)
}
