//! Ragdolls: ten bodies and nine joints each, dropped on a floor with blocks.
//!
//! A doll is 1.8 m tall with a density of 1,000 kg/m³: trunk, head, and two parts per limb. Neck, shoulders and hips
//! are spherical joints, elbows and knees revolute, all limited; joined parts do not collide. Dolls fall from about 3
//! m with random rotations, every third onto a block of one metre. Friction 0.7, no bounce, damping 0.2 and 1 1/s. A
//! body sleeps after half a second below 0.3 m/s.

use glam::Vec3;
use rhumb_protocol::limits::JOINTS_MAX;
use rhumb_protocol::scene::{
    BodyKind, Command, Joint, JointFrame, JointId, JointKind, JointLimits, SceneConfig, Shape,
    ShapeId, Sleep, SleepThresholds,
};
use rhumb_reckoning::{BodyId, Damping, Tick};

use crate::script::{SceneBuilder, SceneRng, Script, motion, still, surface};

/// Falling dolls.
#[derive(Clone, Debug)]
pub struct Ragdolls {
    dolls: u32,
    rng: SceneRng,
    joints: u32,
}

impl Ragdolls {
    /// Default number of bodies: twenty dolls.
    pub const BODIES: u32 = 20 * PARTS_COUNT as u32;

    /// As many whole dolls as fit into `bodies` bodies, at least one and at most 7,000.
    #[must_use]
    pub fn new(bodies: u32, seed: u64) -> Self {
        Self {
            dolls: (bodies / PARTS_COUNT as u32).clamp(1, DOLLS_MAX),
            rng: SceneRng::new(seed),
            joints: 0,
        }
    }

    fn place_doll(
        &mut self,
        middle: Vec3,
        shapes: &[ShapeId],
        builder: &mut SceneBuilder,
        out: &mut Vec<Command>,
    ) {
        let rotation = self.rng.rotation();
        let spin = self.rng.vector();
        let mut bodies = [BodyId::new(0, 0); PARTS_COUNT];
        for ((body, part), shape) in bodies.iter_mut().zip(&PARTS).zip(shapes) {
            // Offset from the trunk, about which the doll rotates and spins.
            let offset = (part.1 - PARTS[TRUNK].1).as_dvec3();
            let arm = (rotation.as_dquat() * offset).as_vec3();
            let start = motion(middle + arm, rotation, spin.cross(arm), spin);
            *body = builder.body(BodyKind::Dynamic, *shape, start, out);
        }
        for (first, second, anchor, kind) in JOINTS {
            let joint = Joint {
                kind,
                bodies: [bodies[first], bodies[second]],
                frames: [first, second].map(|part| JointFrame::at(anchor - PARTS[part].1)),
                collide: false,
                motors: [None; 6],
                strength: None,
            };
            let id = JointId(self.joints);
            self.joints += 1;
            out.push(Command::AddJoint {
                id,
                joint: joint.into(),
            });
        }
    }
}

impl Script for Ragdolls {
    fn name(&self) -> &'static str {
        "ragdolls"
    }

    fn config(&self) -> SceneConfig {
        SceneConfig {
            material: surface(0.7, 1_000.0),
            damping: Damping {
                linear: 0.2,
                angular: 1.0,
            },
            sleep: Sleep::Below(SleepThresholds::by_speed(0.3, 0.5)),
            ..SceneConfig::default()
        }
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        if tick != Tick::ZERO {
            return;
        }
        let mut builder = SceneBuilder::default();
        builder.floor(250.0, out);
        let half_extents = Vec3::splat(0.5);
        let block = builder.shape(Shape::Cuboid { half_extents }, out);
        let side = (1..)
            .find(|side: &u32| side * side >= self.dolls)
            .unwrap_or(1);
        let middle = (side - 1) as f32 * 0.5;
        let grid_point = |place: u32| {
            let (x, z) = (
                (place % side) as f32 - middle,
                (place / side) as f32 - middle,
            );
            Vec3::new(x * SPACING, 0.0, z * SPACING)
        };
        for place in (0..self.dolls).filter(|place| place % 3 == 0) {
            let there = still(grid_point(place) + Vec3::Y * 0.3);
            builder.body(BodyKind::Fixed, block, there, out);
        }
        let shapes: Vec<_> = PARTS
            .into_iter()
            .map(|(shape, _)| builder.shape(shape, out))
            .collect();
        for place in 0..self.dolls {
            let height = 3.5 + self.rng.signed();
            let middle = grid_point(place) + Vec3::Y * height;
            self.place_doll(middle, &shapes, &mut builder, out);
        }
    }
}

/// Spacing of dolls, metres; none touch before they land.
const SPACING: f32 = 2.2;

const fn limb(half_height: f32, radius: f32) -> Shape {
    Shape::Capsule {
        half_height,
        radius,
    }
}

/// Limited by the number of joints.
const DOLLS_MAX: u32 = 7_000;
const _: () = assert!(DOLLS_MAX * (PARTS_COUNT as u32 - 1) <= JOINTS_MAX);
const PARTS_COUNT: usize = 10;
const TRUNK: usize = 0;

/// Shape and position of each part of a standing doll, metres from the point between its feet: trunk, head, then
/// alternately left and right: upper arms, forearms, thighs, shins.
const PARTS: [(Shape, Vec3); PARTS_COUNT] = [
    (limb(0.22, 0.14), Vec3::new(0.0, 1.15, 0.0)),
    (Shape::Ball { radius: 0.12 }, Vec3::new(0.0, 1.68, 0.0)),
    (limb(0.12, 0.05), Vec3::new(-0.24, 1.25, 0.0)),
    (limb(0.12, 0.05), Vec3::new(0.24, 1.25, 0.0)),
    (limb(0.11, 0.045), Vec3::new(-0.24, 0.92, 0.0)),
    (limb(0.11, 0.045), Vec3::new(0.24, 0.92, 0.0)),
    (limb(0.16, 0.07), Vec3::new(-0.1, 0.62, 0.0)),
    (limb(0.16, 0.07), Vec3::new(0.1, 0.62, 0.0)),
    (limb(0.16, 0.055), Vec3::new(-0.1, 0.2, 0.0)),
    (limb(0.16, 0.055), Vec3::new(0.1, 0.2, 0.0)),
];

/// First part, second part, position of the joint, kind.
const JOINTS: [(usize, usize, Vec3, JointKind); 9] = [
    (TRUNK, 1, Vec3::new(0.0, 1.54, 0.0), ball(0.6, 0.8, 0.5)),
    (TRUNK, 2, Vec3::new(-0.2, 1.4, 0.0), ball(1.4, 0.8, 1.2)),
    (TRUNK, 3, Vec3::new(0.2, 1.4, 0.0), ball(1.4, 0.8, 1.2)),
    (2, 4, Vec3::new(-0.24, 1.085, 0.0), hinge(-2.2, 0.0)),
    (3, 5, Vec3::new(0.24, 1.085, 0.0), hinge(-2.2, 0.0)),
    (TRUNK, 6, Vec3::new(-0.1, 0.83, 0.0), ball(1.2, 0.5, 0.6)),
    (TRUNK, 7, Vec3::new(0.1, 0.83, 0.0), ball(1.2, 0.5, 0.6)),
    (6, 8, Vec3::new(-0.1, 0.41, 0.0), hinge(0.0, 2.2)),
    (7, 9, Vec3::new(0.1, 0.41, 0.0), hinge(0.0, 2.2)),
];

const fn within(most: f32) -> JointLimits {
    JointLimits { least: -most, most }
}

/// A spherical joint limited about x, y and z in both directions, radians.
const fn ball(x: f32, y: f32, z: f32) -> JointKind {
    JointKind::Spherical(Some([within(x), within(y), within(z)]))
}

/// A revolute joint about x, radians.
const fn hinge(least: f32, most: f32) -> JointKind {
    JointKind::Revolute(Some(JointLimits { least, most }))
}
