//! A scene that uses every command, for tests.
//!
//! Boxes, balls, capsules, cylinders and hulls on a floor, with kinematic platforms and a pendulum. Sends random
//! commands of every kind that a single member may send; the scene accepts all of them.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, Hull, Joint, JointFrame, JointId, JointKind, JointLimits,
    Material, SceneConfig, Shape, ShapeId,
};
use rhumb_reckoning::{BodyId, BodyState, Damping, Tick};

use crate::script::{Cluster, GRAVITY, SceneRng, Script, motion, still};

/// Every kind of body, and every command.
#[derive(Clone, Debug)]
pub struct Zoo {
    bodies: u32,
    rng: SceneRng,
    /// Generations of the free bodies, whose indices follow those of [`FIRST`].
    generations: Vec<u16>,
    /// Generation of the pendulum's lower part.
    bob: u16,
}

impl Zoo {
    /// A scene of `bodies` free dynamic bodies, at least one.
    #[must_use]
    pub fn new(bodies: u32, seed: u64) -> Self {
        Self {
            bodies: bodies.max(1),
            rng: SceneRng::new(seed),
            generations: Vec::new(),
            bob: 0,
        }
    }

    fn begin(&mut self, out: &mut Vec<Command>) {
        for (shape, number) in SHAPES.into_iter().chain([wedge()]).zip(0..) {
            let id = ShapeId(number);
            out.push(Command::AddShape { id, shape });
        }
        for (id, kind, shape, position) in FIXTURES {
            let id = BodyId::new(id, 0);
            out.push(Command::AddBody {
                desc: BodyDesc::plain(id, kind, ShapeId(shape)),
                motion: still(position),
            });
        }
        out.push(Command::SetVelocity {
            id: CAROUSEL,
            linear: Vec3::ZERO,
            angular: Vec3::new(0.0, 0.5, 0.0),
        });
        out.push(Command::AddJoint {
            id: HINGE,
            joint: hanging(POST, ARM, JointKind::Revolute(None)).into(),
        });
        self.hang_bob(out);
        let mut places = self.rng.clone();
        for (position, place) in CLUSTER.places(self.bodies, &mut places).zip(0..) {
            self.generations.push(0);
            let motion = motion(position, self.rng.rotation(), Vec3::ZERO, Vec3::ZERO);
            self.add(place, motion, out);
        }
    }

    /// Adds the pendulum's lower part, each time with another kind of joint.
    fn hang_bob(&mut self, out: &mut Vec<Command>) {
        let id = BodyId::new(BOB, self.bob);
        out.push(Command::AddBody {
            desc: BodyDesc::plain(id, BodyKind::Dynamic, WEDGE),
            motion: still(Vec3::new(8.0, 2.5, 8.0)),
        });
        let limits = |most: f32| JointLimits { least: -most, most };
        let kind = match self.bob % 3 {
            0 => JointKind::Spherical(Some([limits(0.5), limits(1.0), limits(0.5)])),
            1 => JointKind::Prismatic(Some(limits(0.5))),
            _ => JointKind::Fixed,
        };
        let joint = hanging(ARM, id, kind);
        out.push(Command::AddJoint {
            id: LINK,
            joint: joint.into(),
        });
    }

    /// Adds the next body at an index.
    fn add(&mut self, place: u32, motion: BodyState, out: &mut Vec<Command>) {
        let shape = MOVING[self.rng.below(MOVING.len() as u32) as usize];
        let mut desc = BodyDesc::plain(self.id(place), BodyKind::Dynamic, ShapeId(shape));
        if place % 2 == 1 {
            desc.material = Some(Material {
                friction: 0.9,
                restitution: 0.5,
                density: 200.0,
            });
        }
        if place % 3 == 1 {
            desc.damping = Some(Damping {
                linear: 0.5,
                angular: 0.5,
            });
        }
        if place % 5 == 1 {
            desc.gravity_scale = 0.25;
        }
        out.push(Command::AddBody { desc, motion });
    }

    fn id(&self, place: u32) -> BodyId {
        BodyId::new(FIRST + place, self.generations[place as usize])
    }

    /// Sends one command, or two related ones, to one of the dynamic bodies.
    fn change_settings(&mut self, out: &mut Vec<Command>) {
        let place = self.rng.below(self.bodies);
        let id = self.id(place);
        let vector = self.rng.vector();
        match self.rng.below(8) {
            0 => out.push(Command::Force {
                id,
                force: vector * 20_000.0,
            }),
            1 => out.push(Command::Torque {
                id,
                torque: vector * 2_000.0,
            }),
            2 => out.push(Command::Impulse {
                id,
                impulse: vector * 500.0,
            }),
            3 => out.push(Command::TorqueImpulse {
                id,
                impulse: vector * 50.0,
            }),
            4 => out.push(Command::SetVelocity {
                id,
                linear: vector * 5.0,
                angular: vector * 5.0,
            }),
            5 => out.push(Command::SetPose {
                id,
                position: Vec3::new(0.0, 8.0, 0.0) + vector * 4.0,
                rotation: self.rng.rotation(),
            }),
            6 => {
                out.push(Command::RemoveBody { id });
                self.generations[place as usize] += 1;
                let position = Vec3::new(0.0, 8.0, 0.0) + vector * 4.0;
                let motion = motion(position, Quat::IDENTITY, vector, Vec3::ZERO);
                self.add(place, motion, out);
            }
            _ => out.push(Command::SetPose {
                id: STEP,
                position: Vec3::new(6.0, 0.5, 0.0) + vector * 0.25,
                rotation: Quat::IDENTITY,
            }),
        }
    }

    /// Sends the commands of fixed ticks.
    fn routine(&mut self, tick: u64, out: &mut Vec<Command>) {
        if tick.is_multiple_of(120) {
            let there = if tick.is_multiple_of(240) { 1.0 } else { -1.0 };
            out.push(Command::SetVelocity {
                id: LIFT,
                linear: Vec3::new(0.0, there, 0.0),
                angular: Vec3::ZERO,
            });
        }
        if tick % 10 == 5 {
            let along = (tick % 200) as f32 * 0.02;
            out.push(Command::SetPose {
                id: PADDLE,
                position: Vec3::new(along - 2.0, 0.6, 5.0),
                rotation: Quat::IDENTITY,
            });
        }
        match tick % 600 {
            300 => out.push(Command::SetGravity {
                gravity: Vec3::new(0.5, -3.0, 0.0),
            }),
            360 => out.push(Command::SetGravity { gravity: GRAVITY }),
            400 => out.push(Command::RemoveShape { id: SPARE }),
            401 => out.push(Command::AddShape {
                id: SPARE,
                shape: Shape::Ball { radius: 0.1 },
            }),
            // The link is removed by itself here, and later together with the body.
            200 => out.push(Command::RemoveJoint { id: LINK }),
            220 => {
                let joint = hanging(ARM, BodyId::new(BOB, self.bob), JointKind::Spherical(None));
                out.push(Command::AddJoint {
                    id: LINK,
                    joint: joint.into(),
                });
            }
            450 => {
                let id = BodyId::new(BOB, self.bob);
                out.push(Command::RemoveBody { id });
                self.bob += 1;
                self.hang_bob(out);
            }
            _ => {}
        }
    }
}

impl Script for Zoo {
    fn name(&self) -> &'static str {
        "zoo"
    }

    fn config(&self) -> SceneConfig {
        SceneConfig {
            material: Material {
                friction: 0.5,
                restitution: 0.1,
                density: 500.0,
            },
            damping: Damping {
                linear: 0.05,
                angular: 0.1,
            },
            ..SceneConfig::default()
        }
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        if tick == Tick::ZERO {
            self.begin(out);
        }
        self.routine(tick.value(), out);
        // One second in four has no commands, so that bodies come to rest.
        if tick.value() % 240 < 180 && tick.value() % 6 == 3 {
            self.change_settings(out);
        }
    }
}

/// Shapes by number; no body uses the last one, and [`WEDGE`] follows.
const SHAPES: [Shape; 7] = [
    Shape::Cuboid {
        half_extents: Vec3::new(30.0, 1.0, 30.0),
    },
    Shape::Cuboid {
        half_extents: Vec3::new(2.0, 0.25, 2.0),
    },
    Shape::Cuboid {
        half_extents: Vec3::new(0.3, 0.4, 0.5),
    },
    Shape::Ball { radius: 0.4 },
    Shape::Capsule {
        half_height: 0.4,
        radius: 0.25,
    },
    Shape::Cylinder {
        half_height: 0.4,
        radius: 0.3,
    },
    Shape::Ball { radius: 0.1 },
];

/// The shapes of dynamic bodies.
const MOVING: [u32; 5] = [2, 3, 4, 5, WEDGE.0];

const SPARE: ShapeId = ShapeId(6);
const WEDGE: ShapeId = ShapeId(7);

/// A prism over a triangle, around its centre of mass.
fn wedge() -> Shape {
    let corners = [(-0.3, -0.2), (0.6, -0.2), (-0.3, 0.4)];
    let at = |z: f32| corners.map(|(x, y)| Vec3::new(x, y, z));
    let points = [at(-0.4), at(0.4)].concat();
    Shape::Hull(Hull::new(&points).expect("the wedge has a volume"))
}

/// A joint from which the second body hangs one metre below the first, half of it in each.
fn hanging(first: BodyId, second: BodyId, kind: JointKind) -> Joint {
    let half = Vec3::new(0.0, 0.5, 0.0);
    Joint {
        kind,
        bodies: [first, second],
        frames: [JointFrame::at(-half), JointFrame::at(half)],
        collide: false,
        motors: [None; 6],
        strength: None,
    }
}

/// Joint between the post and the arm.
const HINGE: JointId = JointId(0);
/// Joint between the arm and the bob.
const LINK: JointId = JointId(1);

/// Floor, step, carousel, lift, paddle, post and arm: index, kind, shape, position.
const FIXTURES: [(u32, BodyKind, u32, Vec3); 7] = [
    (0, BodyKind::Fixed, 0, Vec3::new(0.0, -1.0, 0.0)),
    (1, BodyKind::Fixed, 1, Vec3::new(6.0, 0.5, 0.0)),
    (2, BodyKind::Kinematic, 1, Vec3::new(0.0, 0.3, 0.0)),
    (3, BodyKind::Kinematic, 1, Vec3::new(-6.0, 1.0, 0.0)),
    (4, BodyKind::Kinematic, 1, Vec3::new(-2.0, 0.6, 5.0)),
    (5, BodyKind::Fixed, 2, Vec3::new(8.0, 4.5, 8.0)),
    (6, BodyKind::Dynamic, 4, Vec3::new(8.0, 3.5, 8.0)),
];

const STEP: BodyId = BodyId::new(1, 0);
const CAROUSEL: BodyId = BodyId::new(2, 0);
const LIFT: BodyId = BodyId::new(3, 0);
const PADDLE: BodyId = BodyId::new(4, 0);
const POST: BodyId = BodyId::new(5, 0);
const ARM: BodyId = BodyId::new(6, 0);
/// Index of the pendulum's lower part.
const BOB: u32 = FIXTURES.len() as u32;
/// Index of the first free dynamic body.
const FIRST: u32 = BOB + 1;

const CLUSTER: Cluster = Cluster {
    centre: Vec3::new(0.0, 6.0, 0.0),
    lowest: 3.0,
    spacing: 1.6,
    jitter: 0.1,
};
