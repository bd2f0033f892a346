//! Bodies that a simulator of its own moves: how they walk, and their scene.
//!
//! A walk is a function of the tick, so that what was said of it can be judged afterwards.

use core::num::NonZeroU32;

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, Material, PublishSchedule, SceneConfig, Shape, ShapeId, Stepping,
};
use rhumb_reckoning::{BodyId, BodyState, Damping, Integrator, Rate, Tick, ToleranceScale};
use rhumb_sims::Script;

/// A floor, avatars that nothing moves yet, a box on a small platform, and a body that always turns.
///
/// The last one is there so that a full stream of the scene has something to say at every tick.
#[derive(Clone, Copy, Debug)]
pub struct Avatars(pub u32);

/// The floor is the first body.
const FLOOR: u32 = 0;
/// The one that turns.
const TURNING: u32 = 1;
/// The platform, kinematic as the avatars are.
const PLATFORM: u32 = 2;
/// What lies on it.
const FREIGHT: u32 = 3;
const AVATARS: u32 = 4;

/// Metres from the middle of its way to an avatar.
const WAY_RADIUS: f64 = 3.0;
/// m/s, for four of every six seconds.
const WALK: f64 = 1.4;
const TICKS_WALKING: u64 = 240;
const TICKS_STANDING: u64 = 120;

impl Avatars {
    /// One of the avatars.
    #[must_use]
    pub const fn id(place: u32) -> BodyId {
        BodyId::new(AVATARS + place, 0)
    }

    /// The platform.
    #[must_use]
    pub const fn platform() -> BodyId {
        BodyId::new(PLATFORM, 0)
    }

    /// The box on the platform.
    #[must_use]
    pub const fn freight() -> BodyId {
        BodyId::new(FREIGHT, 0)
    }

    /// The floor.
    #[must_use]
    pub const fn floor() -> BodyId {
        BodyId::new(FLOOR, 0)
    }

    /// Where the platform is before anybody moves it.
    #[must_use]
    pub fn berth() -> BodyState {
        still(Vec3::new(0.0, 0.5, 20.0))
    }

    /// Where an avatar is at a tick, and how it walks: along a circle, with a rest now and then.
    #[must_use]
    pub fn walk(place: u32, tick: Tick) -> BodyState {
        let shifted = tick.value() + 37 * u64::from(place);
        let round = shifted / (TICKS_WALKING + TICKS_STANDING);
        let within = shifted % (TICKS_WALKING + TICKS_STANDING);
        let walked = round * TICKS_WALKING + within.min(TICKS_WALKING);
        let speed = if within < TICKS_WALKING { WALK } else { 0.0 };
        let angle = walked as f64 / 60.0 * WALK / WAY_RADIUS;
        let (sin, cos) = angle.sin_cos();
        let middle = f64::from(place) * 8.0;
        let position = [
            (middle + WAY_RADIUS * cos) as f32,
            0.8,
            (WAY_RADIUS * sin) as f32,
        ];
        let linear = [(-speed * sin) as f32, 0.0, (speed * cos) as f32];
        let turn = Quat::from_rotation_y(-angle as f32);
        let angular = [0.0, (-speed / WAY_RADIUS) as f32, 0.0];
        BodyState::new(position, turn.to_array(), linear, angular).expect("a walk is finite")
    }
}

fn still(position: Vec3) -> BodyState {
    let upright = [0.0, 0.0, 0.0, 1.0];
    BodyState::new(position.to_array(), upright, [0.0; 3], [0.0; 3]).expect("places are finite")
}

impl Script for Avatars {
    fn name(&self) -> &'static str {
        "avatars"
    }

    fn config(&self) -> SceneConfig {
        SceneConfig {
            integrator: Integrator {
                rate: Rate::HZ_60,
                substeps: NonZeroU32::new(4).expect("four is not zero"),
            },
            gravity: Vec3::new(0.0, -9.8, 0.0),
            stepping: Stepping::Lockstep,
            material: Material {
                friction: 0.8,
                restitution: 0.0,
                density: 1_000.0,
            },
            damping: Damping {
                linear: 0.0,
                angular: 0.05,
            },
            sleep: None,
            publish_schedule: PublishSchedule::EACH_TICK,
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
                BodyKind::Static | BodyKind::Dynamic => ToleranceScale::USUAL,
            };
            let desc = BodyDesc {
                tolerance_scale,
                ..BodyDesc::plain(BodyId::new(index, 0), kind, ShapeId(shape))
            };
            out.push(Command::AddBody { desc, motion });
        };
        add(FLOOR, BodyKind::Static, 0, still(Vec3::new(0.0, -0.5, 0.0)));
        add(
            TURNING,
            BodyKind::Kinematic,
            2,
            still(Vec3::new(0.0, 30.0, 0.0)),
        );
        add(PLATFORM, BodyKind::Kinematic, 1, Self::berth());
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
