//! Random commands about a few objects, so that they contradict each other.

use glam::Vec3;
use rhumb_protocol::limits::{ANGULAR_MAX, COORDINATE_MAX, FORCE_MAX, GRAVITY_MAX, LINEAR_MAX};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, CollisionGroups, Command, Compound, Edges, Heights, Hull, Joint,
    JointFrame, JointId, JointKind, JointLimits, JointStrength, LockedAxes, Mass, Material, Mesh,
    Motor, Part, Shape, ShapeId, Sleep, SleepThresholds, Spring,
};
use rhumb_reckoning::{BodyId, BodyState, Damping, ToleranceScale};

use super::script::Script;
use super::walking::walking;

/// Ids of shapes and joints are below this.
const THINGS: usize = 5;

/// The random commands of a script about these bodies, as many as its data have.
#[must_use]
pub fn random_commands(data: &[u8], bodies: &[BodyId]) -> Vec<Command> {
    let mut script = Script::new(data);
    let mut commands = Vec::new();
    while script.goes_on() {
        commands.push(command(&mut script, bodies));
    }
    commands
}

/// A random command about one of these bodies.
pub(super) fn command(script: &mut Script<'_>, bodies: &[BodyId]) -> Command {
    let id = if bodies.is_empty() {
        BodyId::new(0, 0)
    } else {
        script.one_of(bodies)
    };
    match script.below(29) {
        0 | 1 => Command::AddShape {
            id: shape_id(script),
            shape: shape(script),
        },
        2 => Command::RemoveShape {
            id: shape_id(script),
        },
        3..6 => Command::AddBody {
            desc: config(script, id),
            motion: motion(script),
        },
        6 => Command::RemoveBody { id },
        7 => Command::SetPose {
            id,
            position: place(script, COORDINATE_MAX),
            rotation: script.rotation(),
        },
        8 => Command::SetVelocity {
            id,
            linear: script.vector(LINEAR_MAX),
            angular: script.vector(ANGULAR_MAX),
        },
        kind @ (9..13 | 21 | 22) => push(script, id, kind),
        13 => Command::SetGravity {
            gravity: script.vector(GRAVITY_MAX),
        },
        14 => Command::AddJoint {
            id: joint_id(script),
            joint: joint(script, id, bodies).into(),
        },
        15 => Command::RemoveJoint {
            id: joint_id(script),
        },
        16..20 => Command::ChangeBody {
            desc: config(script, id),
        },
        20 => Command::ChangeJoint {
            id: joint_id(script),
            joint: joint(script, id, bodies).into(),
        },
        23 => Command::Sleep { id },
        24 => Command::Wake { id },
        _ => walking(script, id),
    }
}

/// A random force, torque or impulse, of the kind with this number in [`command`].
fn push(script: &mut Script<'_>, id: BodyId, kind: usize) -> Command {
    match kind {
        9 => Command::Force {
            id,
            force: strength(script),
        },
        10 => Command::Torque {
            id,
            torque: strength(script),
        },
        11 => Command::Impulse {
            id,
            impulse: strength(script),
        },
        12 => Command::TorqueImpulse {
            id,
            impulse: strength(script),
        },
        21 => Command::ForceAt {
            id,
            force: strength(script),
            point: place(script, COORDINATE_MAX),
        },
        _ => Command::ImpulseAt {
            id,
            impulse: strength(script),
            point: place(script, COORDINATE_MAX),
        },
    }
}

fn mass(script: &mut Script<'_>) -> Mass {
    let mass = script.one_of(&[1e-3, 0.5, 10.0, 1e6]);
    let moment = |script: &mut Script<'_>| mass * script.one_of(&[1e-6, 0.1, 0.4, 1e8]);
    Mass {
        mass,
        moments: script
            .any::<bool>()
            .then(|| Vec3::new(moment(script), moment(script), moment(script))),
    }
}

fn shape_id(script: &mut Script<'_>) -> ShapeId {
    ShapeId(script.below(THINGS) as u32)
}

fn joint_id(script: &mut Script<'_>) -> JointId {
    JointId(script.below(THINGS) as u32)
}

/// A position, usually near the others.
fn place(script: &mut Script<'_>, most: f32) -> Vec3 {
    if script.below(6) == 0 {
        script.vector(most)
    } else {
        script.sane_vector(4.0)
    }
}

/// A vector of any length up to the limit.
fn strength(script: &mut Script<'_>) -> Vec3 {
    let most = script.one_of(&[10.0, 1e4, FORCE_MAX]);
    script.vector(most)
}

fn motion(script: &mut Script<'_>) -> BodyState {
    let position = place(script, COORDINATE_MAX).to_array();
    let rotation = script.rotation().to_array();
    let (linear, angular) = (script.vector(50.0), script.vector(30.0));
    let motion = BodyState::new(position, rotation, linear.to_array(), angular.to_array());
    motion.unwrap_or_else(|_| {
        BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3])
            .expect("the rest state at the origin")
    })
}

fn config(script: &mut Script<'_>, id: BodyId) -> BodyDesc {
    let kind = script.one_of(&[
        BodyKind::Dynamic,
        BodyKind::Dynamic,
        BodyKind::Fixed,
        BodyKind::Kinematic,
    ]);
    let plain = BodyDesc::plain(id, kind, shape_id(script));
    if script.any() {
        return plain;
    }
    BodyDesc {
        material: script.any::<bool>().then(|| Material {
            friction: script.number(1.0).abs(),
            restitution: script.number(1.0).abs(),
            density: script.number(2e3).abs(),
        }),
        damping: script.any::<bool>().then(|| Damping {
            linear: script.number(2.0).abs(),
            angular: script.number(2.0).abs(),
        }),
        gravity_scale: script.number(2.0),
        gyroscopic: script.any(),
        tolerance_scale: ToleranceScale::new(script.below(7) as i8 - 3)
            .expect("one of seven tolerance scales"),
        locked: LockedAxes::new(script.below(64) as u8).unwrap_or_default(),
        mass: script.any::<bool>().then(|| mass(script)),
        groups: CollisionGroups {
            members: script.any(),
            touches: script.any(),
        },
        dominance: script.any(),
        sensor: script.below(4) == 0,
        swept: script.any(),
        sleep: script.any::<bool>().then(|| sleep(script)),
        enabled: script.below(4) > 0,
        ..plain
    }
}

/// A rule of sleep, usually valid.
fn sleep(script: &mut Script<'_>) -> Sleep {
    match script.below(3) {
        0 => Sleep::Settled,
        1 => Sleep::Never,
        _ => Sleep::Below(SleepThresholds {
            speed: script.number(1.0).abs(),
            angular_speed: script.number(1.0).abs(),
            seconds: script.number(1.0).abs(),
        }),
    }
}

/// A mode of contact at edges.
fn edges(script: &mut Script<'_>) -> Edges {
    script.one_of(&[Edges::Plain, Edges::Smooth])
}

/// A length, usually valid for a body.
fn length(script: &mut Script<'_>) -> f32 {
    match script.below(8) {
        0 => script.number(1e4),
        1 => 1e-3,
        2 => 1e4,
        _ => script.sane(2.0).abs() + 0.01,
    }
}

/// A random shape; shapes whose constructors check nothing may be invalid.
fn shape(script: &mut Script<'_>) -> Shape {
    match script.below(9) {
        8 => {
            let parts = (0..script.below(4)).map(|_| Part {
                position: script.vector(2.0),
                rotation: script.rotation(),
                shape: simple(script),
            });
            let parts: Vec<_> = parts.collect();
            Compound::new(parts).map_or_else(|_| ball(script), Shape::Compound)
        }
        _ => simple(script),
    }
}

fn ball(script: &mut Script<'_>) -> Shape {
    Shape::Ball {
        radius: length(script),
    }
}

fn simple(script: &mut Script<'_>) -> Shape {
    match script.below(11) {
        0 | 1 => ball(script),
        2 => Shape::Cuboid {
            half_extents: Vec3::new(length(script), length(script), length(script)),
        },
        3 => Shape::Capsule {
            half_height: length(script),
            radius: length(script),
        },
        4 => Shape::Cylinder {
            half_height: length(script),
            radius: length(script),
        },
        8 => Shape::RoundedCuboid {
            half_extents: Vec3::new(length(script), length(script), length(script)),
            radius: length(script),
        },
        9 => Shape::Cone {
            half_height: length(script),
            radius: length(script),
        },
        10 => Shape::HalfSpace {
            normal: script.rotation() * Vec3::Y,
        },
        5 => {
            let points = points(script, 4, 12);
            Hull::new(&points).map_or_else(|_| ball(script), Shape::Hull)
        }
        6 => {
            let points = points(script, 3, 10);
            let corner = |script: &mut Script<'_>| script.below(points.len() + 1) as u32;
            let count = 1 + script.below(10);
            let triangles = (0..count).map(|_| [corner(script), corner(script), corner(script)]);
            let triangles: Vec<_> = triangles.collect();
            let mesh = Mesh::new(&points, &triangles).map(|mesh| mesh.with_edges(edges(script)));
            mesh.map_or_else(|_| ball(script), Shape::Mesh)
        }
        _ => {
            let (rows, columns) = (2 + script.below(3), 2 + script.below(3));
            let heights = (0..rows * columns).map(|_| script.number(3.0));
            let heights: Vec<_> = heights.collect();
            let (across, along) = (length(script), length(script));
            let field = Heights::new(rows as u32, across, along, &heights)
                .map(|field| field.with_edges(edges(script)));
            field.map_or_else(|_| ball(script), Shape::Heights)
        }
    }
}

/// Points, some of which may coincide or be collinear or coplanar.
fn points(script: &mut Script<'_>, least: usize, more: usize) -> Vec<Vec3> {
    let count = least + script.below(more);
    let flat = script.one_of(&[Vec3::ONE, Vec3::ONE, Vec3::new(1.0, 1.0, 1e-4), Vec3::X]);
    let most = script.one_of(&[2.0, 2.0, 0.01, 5e3]);
    let point = |script: &mut Script<'_>| match script.below(6) {
        0 => Vec3::ZERO,
        1 => script.vector(most) * flat,
        _ => script.sane_vector(most) * flat,
    };
    (0..count).map(|_| point(script)).collect()
}

fn joint(script: &mut Script<'_>, first: BodyId, bodies: &[BodyId]) -> Joint {
    let second = if bodies.is_empty() {
        first
    } else {
        script.one_of(bodies)
    };
    let frame = |script: &mut Script<'_>| JointFrame {
        anchor: script.vector(2.0),
        rotation: script.rotation(),
    };
    let limits = |script: &mut Script<'_>| {
        let (one, other) = (script.number(1.0), script.number(1.0));
        JointLimits {
            least: one.min(other),
            most: one.max(other),
        }
    };
    let limited = script.any::<bool>();
    let kind = match script.below(7) {
        0 => JointKind::Fixed,
        1 => {
            JointKind::Spherical(limited.then(|| [limits(script), limits(script), limits(script)]))
        }
        2 => JointKind::Revolute(limited.then(|| limits(script))),
        3 => JointKind::Prismatic(limited.then(|| limits(script))),
        4 => JointKind::Rope(length(script)),
        5 => JointKind::Spring(Spring {
            length: length(script),
            stiffness: script.one_of(&[0.0, 10.0, 1e6]),
            damping: script.one_of(&[0.0, 10.0, 1e6]),
        }),
        _ => {
            let locked = LockedAxes::new(script.below(64) as u8).unwrap_or_default();
            let mut all = [None; 6];
            for (axis, of_axis) in all.iter_mut().enumerate() {
                if !locked.locks(axis) && script.any() {
                    *of_axis = Some(limits(script));
                }
            }
            JointKind::Generic(locked, all)
        }
    };
    let mut joint = Joint::plain(kind, [first, second], [frame(script), frame(script)]);
    joint.collide = script.any();
    joint.strength = script.any::<bool>().then(|| JointStrength {
        force: script.one_of(&[0.0, 100.0, FORCE_MAX]),
        torque: script.one_of(&[0.0, 100.0, FORCE_MAX]),
    });
    let bare = matches!(kind, JointKind::Rope(_) | JointKind::Spring(_));
    for (axis, motor) in joint.motors.iter_mut().enumerate() {
        if !bare && !kind.locked().locks(axis) && script.any() {
            *motor = Some(Motor {
                position: script.number(1.0),
                velocity: script.number(100.0),
                stiffness: script.one_of(&[0.0, 10.0, 1e6]),
                damping: script.one_of(&[0.0, 10.0, 1e6]),
                force: script.one_of(&[0.0, 10.0, FORCE_MAX]),
            });
        }
    }
    joint
}
