//! A test scene of avatars that a client moves, and their trajectories.
//!
//! A trajectory is a function of the tick, so that published states can be checked afterwards.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, Material, SceneConfig, Shape, ShapeId};
use rhumb_reckoning::{BodyId, BodyState, Damping, Tick, ToleranceScale};
use rhumb_sims::Script;

/// A floor, avatars that no client moves yet, a box on a small platform, and a body that always turns.
///
/// The turning body ensures that a full stream of the scene has an update at every tick.
#[derive(Clone, Copy, Debug)]
pub struct Avatars(pub u32);

/// Index of the floor.
const FLOOR: u32 = 0;
/// Index of the turning body.
const TURNING: u32 = 1;
/// Index of the platform, which is kinematic like the avatars.
const PLATFORM: u32 = 2;
/// Index of the box on the platform.
const FREIGHT: u32 = 3;
const AVATARS: u32 = 4;

/// Radius of an avatar's circular path, in metres.
const PATH_RADIUS: f64 = 3.0;
/// Walking speed in m/s, for four of every six seconds.
const WALK: f64 = 1.4;
const TICKS_WALKING: u64 = 240;
const TICKS_STANDING: u64 = 120;

impl Avatars {
    /// Id of an avatar.
    #[must_use]
    pub const fn id(place: u32) -> BodyId {
        BodyId::new(AVATARS + place, 0)
    }

    /// Id of the platform.
    #[must_use]
    pub const fn platform() -> BodyId {
        BodyId::new(PLATFORM, 0)
    }

    /// Id of the box on the platform.
    #[must_use]
    pub const fn freight() -> BodyId {
        BodyId::new(FREIGHT, 0)
    }

    /// Id of the floor.
    #[must_use]
    pub const fn floor() -> BodyId {
        BodyId::new(FLOOR, 0)
    }

    /// Initial state of the platform.
    #[must_use]
    pub fn platform_start() -> BodyState {
        still(Vec3::new(0.0, 0.5, 20.0))
    }

    /// State of an avatar at a tick: it walks along a circle, with regular pauses.
    #[must_use]
    pub fn walk(place: u32, tick: Tick) -> BodyState {
        let shifted = tick.value() + 37 * u64::from(place);
        let round = shifted / (TICKS_WALKING + TICKS_STANDING);
        let within = shifted % (TICKS_WALKING + TICKS_STANDING);
        let walked = round * TICKS_WALKING + within.min(TICKS_WALKING);
        let speed = if within < TICKS_WALKING { WALK } else { 0.0 };
        let angle = walked as f64 / 60.0 * WALK / PATH_RADIUS;
        let (sin, cos) = angle.sin_cos();
        let middle = f64::from(place) * 8.0;
        let position = [
            (middle + PATH_RADIUS * cos) as f32,
            0.8,
            (PATH_RADIUS * sin) as f32,
        ];
        let linear = [(-speed * sin) as f32, 0.0, (speed * cos) as f32];
        let turn = Quat::from_rotation_y(-angle as f32);
        let angular = [0.0, (-speed / PATH_RADIUS) as f32, 0.0];
        BodyState::new(position, turn.to_array(), linear, angular).expect("finite numbers")
    }
}

fn still(position: Vec3) -> BodyState {
    let upright = [0.0, 0.0, 0.0, 1.0];
    BodyState::new(position.to_array(), upright, [0.0; 3], [0.0; 3]).expect("finite numbers")
}

impl Script for Avatars {
    fn name(&self) -> &'static str {
        "avatars"
    }

    fn config(&self) -> SceneConfig {
        SceneConfig {
            gravity: Vec3::new(0.0, -9.8, 0.0),
            material: Material {
                friction: 0.8,
                restitution: 0.0,
                density: 1_000.0,
            },
            damping: Damping {
                linear: 0.0,
                angular: 0.05,
            },
            ..SceneConfig::default()
        }
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        if tick != Tick::ZERO {
            return;
        }
        let slab = |x, y, z| Shape::Cuboid {
            half_extents: Vec3::new(x, y, z),
        };
        let capsule = Shape::Capsule {
            half_height: 0.5,
            radius: 0.3,
        };
        let shapes = [
            slab(60.0, 0.5, 60.0),
            slab(1.0, 0.1, 1.0),
            slab(0.2, 0.2, 0.2),
            capsule,
        ];
        for (id, shape) in (0..).map(ShapeId).zip(shapes) {
            out.push(Command::AddShape { id, shape });
        }
        let mut add = |index, kind, shape, motion| {
            let tolerance_scale = match kind {
                BodyKind::Kinematic => ToleranceScale::AVATAR,
                BodyKind::Fixed | BodyKind::Dynamic => ToleranceScale::USUAL,
            };
            let desc = BodyDesc {
                tolerance_scale,
                ..BodyDesc::plain(BodyId::new(index, 0), kind, ShapeId(shape))
            };
            out.push(Command::AddBody { desc, motion });
        };
        add(FLOOR, BodyKind::Fixed, 0, still(Vec3::new(0.0, -0.5, 0.0)));
        add(
            TURNING,
            BodyKind::Kinematic,
            2,
            still(Vec3::new(0.0, 30.0, 0.0)),
        );
        add(PLATFORM, BodyKind::Kinematic, 1, Self::platform_start());
        add(
            FREIGHT,
            BodyKind::Dynamic,
            2,
            still(Vec3::new(0.0, 0.8, 20.0)),
        );
        for place in 0..self.0 {
            add(
                AVATARS + place,
                BodyKind::Kinematic,
                3,
                Self::walk(place, Tick::ZERO).stilled(),
            );
        }
        out.push(Command::SetVelocity {
            id: BodyId::new(TURNING, 0),
            linear: Vec3::ZERO,
            angular: Vec3::Y,
        });
    }
}
