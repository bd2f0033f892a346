//! One script in every language ends with one hash of poses.
//!
//! The script piles up bodies of five shapes beside a compound, an arm on a hinge with a motor, a character and a vehicle,
//! disturbs them, and asks one query. This file has it in Rust, over the client itself, and in each of the coordinates that
//! do not round.

use std::process;

use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::{BodyParams, Coordinates, JoinCondition, JoinParams, RemoteScene};
use rhumb_client::scene::{
    Answer, BodyBuilder, BodyDesc, BodyKind, Character, CharacterStep, Command, Compound, Joint,
    JointFrame, JointId, JointKind, JointLimits, JumpFrom, Locomotion, Motor, Part, Query, Shape,
    Vehicle, Wheel, WheelInput,
};
use rhumb_client::{BodyCentres, BodyId, Client, JoinMode, JoinOptions, PipelineDepth, Trust};
use rhumb_conformance::fnv::Fnv;
use rhumb_tests::ServerProcess;
use tempfile::TempDir;

use super::c::{Compiled, Linked};
use super::{has, has_all, root, run_well};
use crate::SERVER;

const PILED: u16 = 60;
const TICKS: u16 = 150;
const HINGE: JointId = JointId(7);
/// Beginning and way of the query's ray.
const RAY: [Vec3; 2] = [Vec3::new(-0.625, 50.0, -0.625), Vec3::new(0.0, -100.0, 0.0)];

fn shape(i: u16) -> Shape {
    match i % 5 {
        0 => Shape::ball(0.25),
        1 => Shape::cuboid(0.5, 0.25, 0.5),
        2 => Shape::capsule(0.5, 0.25),
        3 => Shape::cylinder(0.5, 0.25),
        _ => Shape::cone(0.5, 0.25),
    }
}

fn position(i: u16) -> Vec3 {
    let place = |place: u16| f32::from(place % 2) * 1.25 - 0.625;
    Vec3::new(place(i), 1.0 + 1.5 * f32::from(i / 4), place(i / 2))
}

fn spin(i: u16) -> Vec3 {
    Vec3::new(0.0, 0.5 * f32::from(i % 3), 0.0)
}

fn dumbbell() -> Shape {
    let part = |shape, x, z, rotation| Part {
        position: Vec3::new(x, 0.0, z),
        rotation,
        shape,
    };
    let parts = vec![
        part(Shape::ball(0.25), -0.5, 0.0, Quat::IDENTITY),
        part(Shape::ball(0.25), 0.5, 0.0, Quat::IDENTITY),
        part(
            Shape::cuboid(0.125, 0.5, 0.25),
            0.0,
            0.25,
            Quat::from_xyzw(0.5, 0.5, 0.5, 0.5),
        ),
    ];
    Shape::Compound(Compound::new(parts).expect("three parts"))
}

/// A compound; an anchor, and an arm that hangs on it by a hinge; a walker; a car.
fn built() -> [(BodyKind, Shape, Vec3); 5] {
    let anchor = Shape::cuboid(0.25, 0.25, 0.25);
    let arm = Shape::cuboid(0.25, 1.0, 0.25);
    let walker = Shape::capsule(0.5, 0.25);
    let car = Shape::cuboid(0.75, 0.25, 1.5);
    [
        (BodyKind::Dynamic, dumbbell(), Vec3::new(-4.0, 2.0, 0.0)),
        (BodyKind::Fixed, anchor, Vec3::new(4.0, 4.0, 0.0)),
        (BodyKind::Dynamic, arm, Vec3::new(4.0, 2.5, 0.0)),
        (BodyKind::Kinematic, walker, Vec3::new(7.0, 1.0, 3.0)),
        (BodyKind::Dynamic, car, Vec3::new(-7.0, 1.0, 5.0)),
    ]
}

fn hinge(bodies: &[BodyId], motor: Motor) -> Box<Joint> {
    let place = usize::from(PILED) + 2;
    let limits = JointLimits {
        least: -0.5,
        most: 1.0,
    };
    let frames = [-0.5, 1.0].map(|y| JointFrame::at(Vec3::new(0.0, y, 0.0)));
    let pair = [bodies[place], bodies[place + 1]];
    let mut joint = Joint::plain(JointKind::Revolute(Some(limits)), pair, frames);
    joint.motors[3] = Some(motor);
    Box::new(joint)
}

/// The commands that add the hinge, and that let the walker walk and the car roll.
fn beginning(bodies: &[BodyId]) -> Vec<Command> {
    let motor = Motor {
        force: 2000.0,
        ..Motor::with_velocity(1.0, 4.0)
    };
    let [walker, car] = [4, 5].map(|place| bodies[usize::from(PILED) + place]);
    let set = |id, locomotion: Locomotion| Command::SetLocomotion {
        id,
        locomotion: Box::new(locomotion),
    };
    let wheel = |i: u16| {
        let x = if i.is_multiple_of(2) { -0.75 } else { 0.75 };
        let z = if i < 2 { -1.25 } else { 1.25 };
        Wheel::at(Vec3::new(x, -0.125, z), 0.25)
    };
    let character = Character::default().step(CharacterStep::new(0.5, 0.125));
    let wheels = (0..4).map(wheel).collect();
    vec![
        Command::AddJoint {
            id: HINGE,
            joint: hinge(bodies, motor),
        },
        set(walker, character.into()),
        Command::SetVelocity {
            id: walker,
            linear: Vec3::new(-1.0, 0.0, -0.5),
            angular: Vec3::ZERO,
        },
        set(car, Vehicle { wheels }.into()),
    ]
}

/// The front wheels steer, the rear ones push.
fn inputs() -> Vec<WheelInput> {
    let input = |steering, force| WheelInput {
        steering,
        force,
        brake: 0.0,
    };
    vec![
        input(0.25, 0.0),
        input(0.25, 0.0),
        input(0.0, 2000.0),
        input(0.0, 2000.0),
    ]
}

fn commands(tick: u16, bodies: &[BodyId]) -> Vec<Command> {
    match tick {
        20 => vec![Command::SetWheels {
            id: bodies[usize::from(PILED) + 5],
            inputs: inputs(),
        }],
        30 => vec![
            Command::Impulse {
                id: bodies[1],
                impulse: Vec3::new(200.0, 100.0, 0.0),
            },
            Command::SetVelocity {
                id: bodies[6],
                linear: Vec3::new(0.0, 4.0, 1.0),
                angular: Vec3::X,
            },
        ],
        40 => vec![Command::Jump {
            id: bodies[usize::from(PILED) + 4],
            speed: 4.0,
            from: JumpFrom::Ground,
        }],
        60 => vec![Command::RemoveBody { id: bodies[4] }],
        75 => vec![Command::ChangeJoint {
            id: HINGE,
            joint: hinge(bodies, Motor::at_position(0.75, 30.0, 5.0)),
        }],
        90 => vec![Command::SetGravity {
            gravity: Vec3::new(1.0, -9.75, 0.0),
        }],
        _ => Vec::new(),
    }
}

/// All poses at the end of the script, and what its query found.
#[derive(Debug, PartialEq)]
pub(super) struct Outcome {
    poses: Vec<(Vec3, Quat)>,
    distances: Vec<f32>,
}

impl Outcome {
    /// The line that each program prints.
    pub(super) fn line(&self) -> String {
        let mut hash = Fnv::START;
        let poses = self.poses.iter().flat_map(|(at, turned)| {
            let numbers = at.to_array().into_iter();
            numbers.chain(turned.to_array())
        });
        for number in poses.chain(self.distances.iter().copied()) {
            hash.fold(&number.to_le_bytes());
        }
        let (bodies, hits, hash) = (self.poses.len(), self.distances.len(), hash.value());
        format!("{bodies} bodies, {hits} hits, hash {hash:016x}\n")
    }
}

fn floor() -> BodyBuilder {
    BodyDesc::fixed(Shape::cuboid(10.0, 0.5, 10.0)).at(0.0, -0.5, 0.0)
}

/// The script over the client itself.
pub(super) fn expected(server: &ServerProcess) -> Outcome {
    let trust = Trust::Fingerprint(server.fingerprint);
    let options = JoinOptions {
        mode: JoinMode::Create(Default::default()),
        ..JoinOptions::default()
    };
    let connection =
        Client::connect(&server.address.to_string(), trust).expect("the server is there");
    let mut client = connection
        .join_with("script", options)
        .expect("the scene is new");
    let piled = (0..PILED).map(|i| {
        let body = BodyDesc::dynamic(shape(i)).position(position(i));
        body.angular_velocity(spin(i))
    });
    let built = built().map(|(kind, shape, at)| {
        let body = match kind {
            BodyKind::Fixed => BodyDesc::fixed(shape),
            BodyKind::Kinematic => BodyDesc::kinematic(shape),
            _ => BodyDesc::dynamic(shape),
        };
        body.position(at)
    });
    // The compound's centre of mass is not its origin; the bindings convert its poses, in Rust the application does.
    let (all, found) = BodyCentres::centred(std::iter::once(floor()).chain(piled).chain(built));
    let bodies = client.add_bodies(all).expect("the bodies are valid");
    let mut centres = BodyCentres::default();
    centres.keep(&bodies, &found);
    assert!(!centres.is_empty(), "the compound lies off its centre");
    for command in beginning(&bodies) {
        client.command(command).expect("the command is valid");
    }
    for tick in 0..TICKS {
        for command in commands(tick, &bodies) {
            client.command(command).expect("the command is valid");
        }
        client.advance(PipelineDepth::LOCKSTEP).expect("a tick");
    }
    let view = client.view();
    let pose = |id: &BodyId| {
        let rotation = view.rotation(*id)?;
        let position = view.position(*id)?;
        Some((centres.position_out(*id, position, rotation), rotation))
    };
    let poses: Vec<_> = bodies.iter().filter_map(pose).collect();
    let query = Query::ray(RAY[0], RAY[1]).finding(8);
    let answers = client
        .ask(vec![query])
        .expect("an answer")
        .answers
        .expect("hits");
    let [Answer::Hits(hits)] = answers.as_slice() else {
        panic!("one ray has one answer");
    };
    let distances: Vec<_> = hits.iter().map(|hit| hit.distance).collect();
    client.delete().expect("the scene is there");
    // One of the pile was removed; the floor and what was built are there.
    assert_eq!(poses.len(), usize::from(PILED) + 5);
    assert!(!distances.is_empty(), "the ray hits the pile");
    Outcome { poses, distances }
}

#[test]
fn the_script_in_c_and_cpp_ends_with_the_hash_of_the_script_in_rust() {
    let server = SERVER.serve_without_log("127.0.0.1:0");
    let expected = expected(&server);
    for (source, linked) in [
        ("tests/script.c", Linked::Shared),
        ("tests/script.c", Linked::Static),
        ("tests/script.cpp", Linked::Shared),
    ] {
        if let Some(program) = Compiled::new(source, linked) {
            let out = program.run_with(&server);
            assert_eq!(out, expected.line(), "{source}, {linked:?}");
        }
    }
}

#[test]
fn the_script_in_javascript_ends_with_the_hash_of_the_script_in_rust() {
    // The client of browsers is built with the page, where the system has its target.
    let module = rhumb_viewer::asset("/client/rhumb.wasm");
    let module = module.filter(|_| has("node"));
    if !has_all("Node and the client of browsers", module.is_some()) {
        return;
    }
    let folder = TempDir::new().expect("a folder for the socket");
    let [socket, wasm] = ["rhumb.sock", "rhumb.wasm"].map(|name| folder.path().join(name));
    let bytes = module.expect("it is there").bytes;
    std::fs::write(&wasm, bytes).expect("a file of its own");
    let path = socket.to_str().expect("a path of letters");
    let server = SERVER.serve_with("127.0.0.1:0", &["--socket", path]);
    let expected = expected(&server).line();
    let mut node = process::Command::new("node");
    node.args([&root().join("bindings/web/test/script.mjs"), &wasm, &socket]);
    assert_eq!(run_well(&mut node), expected);
}

/// Other axes, turned here by hand.
#[derive(Clone, Copy)]
enum Axes {
    Mirrored,
    Turned,
}

impl Axes {
    const fn coordinates(self) -> Coordinates {
        match self {
            Self::Mirrored => Coordinates::Unity,
            Self::Turned => Coordinates::ZUp,
        }
    }

    fn vector(self, v: Vec3) -> Vec3 {
        match self {
            Self::Mirrored => Vec3::new(v.x, v.y, -v.z),
            Self::Turned => Vec3::new(v.x, -v.z, v.y),
        }
    }

    /// A mirror turns a spin the other way.
    fn spin(self, v: Vec3) -> Vec3 {
        match self {
            Self::Mirrored => -self.vector(v),
            Self::Turned => self.vector(v),
        }
    }

    fn extents(self, x: f32, y: f32, z: f32) -> Shape {
        match self {
            Self::Mirrored => Shape::cuboid(x, y, z),
            Self::Turned => Shape::cuboid(x, z, y),
        }
    }

    /// Anchors, limits and motor of the hinge, whose axis is x in all axes.
    fn hinge(self, mut joint: Box<Joint>) -> Box<Joint> {
        for frame in &mut joint.frames {
            frame.anchor = self.vector(frame.anchor);
        }
        if matches!(self, Self::Mirrored) {
            let turned = |limits: JointLimits| JointLimits {
                least: -limits.most,
                most: -limits.least,
            };
            if let JointKind::Revolute(limits) = &mut joint.kind {
                *limits = limits.map(turned);
            }
            for motor in joint.motors.iter_mut().flatten() {
                (motor.position, motor.velocity) = (-motor.position, -motor.velocity);
            }
        }
        joint
    }

    /// The compound, whose turned part has its axes exchanged.
    fn dumbbell(self) -> Shape {
        let Shape::Compound(compound) = dumbbell() else {
            panic!("it is a compound");
        };
        let parts = compound.parts().iter().map(|part| {
            let axis = self.spin(Vec3::new(part.rotation.x, part.rotation.y, part.rotation.z));
            Part {
                position: self.vector(part.position),
                rotation: Quat::from_xyzw(axis.x, axis.y, axis.z, part.rotation.w),
                shape: self.shape(part.shape.clone()),
            }
        });
        Shape::Compound(Compound::new(parts.collect()).expect("three parts"))
    }

    fn shape(self, shape: Shape) -> Shape {
        match shape {
            Shape::Cuboid { half_extents: h } => self.extents(h.x, h.y, h.z),
            Shape::Compound(_) => self.dumbbell(),
            other => other,
        }
    }

    /// A character as it is, or a vehicle with its wheels' places and axes.
    fn locomotion(self, locomotion: Locomotion) -> Locomotion {
        let Locomotion::Vehicle(Vehicle { wheels }) = locomotion else {
            return locomotion;
        };
        let turned = |wheel: &Wheel| Wheel {
            position: self.vector(wheel.position),
            direction: self.vector(wheel.direction),
            axle: self.vector(wheel.axle),
            ..*wheel
        };
        let wheels = wheels.iter().map(turned).collect();
        Vehicle { wheels }.into()
    }

    /// A mirror turns a steering the other way.
    fn inputs(self, mut inputs: Vec<WheelInput>) -> Vec<WheelInput> {
        if matches!(self, Self::Mirrored) {
            for input in &mut inputs {
                input.steering = -input.steering;
            }
        }
        inputs
    }

    fn command(self, command: Command) -> Command {
        match command {
            Command::SetLocomotion { id, locomotion } => Command::SetLocomotion {
                id,
                locomotion: Box::new(self.locomotion(*locomotion)),
            },
            Command::SetWheels { id, inputs } => Command::SetWheels {
                id,
                inputs: self.inputs(inputs),
            },
            Command::AddJoint { id, joint } => Command::AddJoint {
                id,
                joint: self.hinge(joint),
            },
            Command::ChangeJoint { id, joint } => Command::ChangeJoint {
                id,
                joint: self.hinge(joint),
            },
            Command::Impulse { id, impulse } => Command::Impulse {
                id,
                impulse: self.vector(impulse),
            },
            Command::SetVelocity {
                id,
                linear,
                angular,
            } => Command::SetVelocity {
                id,
                linear: self.vector(linear),
                angular: self.spin(angular),
            },
            Command::SetGravity { gravity } => Command::SetGravity {
                gravity: self.vector(gravity),
            },
            other => other,
        }
    }

    /// A pose in Rhumb's axes.
    fn pose_back(self, at: Vec3, q: Quat) -> (Vec3, Quat) {
        let back = |v: Vec3| match self {
            Self::Mirrored => Vec3::new(v.x, v.y, -v.z),
            Self::Turned => Vec3::new(v.x, v.z, -v.y),
        };
        let axis = back(Vec3::new(q.x, q.y, q.z));
        let axis = match self {
            Self::Mirrored => -axis,
            Self::Turned => axis,
        };
        (back(at), Quat::from_xyzw(axis.x, axis.y, axis.z, q.w))
    }
}

/// The script in other coordinates.
fn in_axes(server: &ServerProcess, axes: Axes) -> Outcome {
    let params = JoinParams {
        coordinates: axes.coordinates(),
        condition: JoinCondition::Create,
        ..JoinParams::default()
    };
    let trust = Trust::Fingerprint(server.fingerprint);
    let connection =
        Client::connect(&server.address.to_string(), trust).expect("the server is there");
    let mut scene = RemoteScene::join(connection, "script", &params).expect("the scene is new");
    let mut all = vec![BodyParams {
        position: axes.vector(Vec3::new(0.0, -0.5, 0.0)),
        ..BodyParams::new(BodyKind::Fixed, axes.extents(10.0, 0.5, 10.0))
    }];
    all.extend((0..PILED).map(|i| BodyParams {
        position: axes.vector(position(i)),
        angular_velocity: axes.spin(spin(i)),
        ..BodyParams::new(BodyKind::Dynamic, axes.shape(shape(i)))
    }));
    all.extend(built().map(|(kind, shape, at)| BodyParams {
        position: axes.vector(at),
        ..BodyParams::new(kind, axes.shape(shape))
    }));
    let bodies = scene.add_bodies(&all).expect("the bodies are valid");
    let begun = beginning(&bodies).into_iter();
    let begun = begun.map(|command| axes.command(command));
    scene
        .command(begun.collect())
        .expect("the commands are valid");
    for tick in 0..TICKS {
        let turned = commands(tick, &bodies).into_iter();
        let turned = turned.map(|command| axes.command(command));
        scene
            .command(turned.collect())
            .expect("the commands are valid");
        scene.advance(PipelineDepth::LOCKSTEP).expect("a tick");
    }
    let poses: Vec<_> = bodies
        .iter()
        .filter_map(|body| {
            let place = scene.place(*body).ok()?;
            Some(axes.pose_back(scene.positions()[place], scene.rotations()[place]))
        })
        .collect();
    let query = Query::ray(axes.vector(RAY[0]), axes.vector(RAY[1])).finding(8);
    let (_, hits) = scene.query(vec![query]).expect("an answer");
    let distances: Vec<_> = hits.iter().map(|hit| hit.distance).collect();
    scene.delete().expect("the scene is there");
    Outcome { poses, distances }
}

#[test]
fn the_script_in_mirrored_and_in_turned_axes_ends_with_the_same_poses() {
    // Equal numbers, but for the signs of zeros.
    let server = SERVER.serve_without_log("127.0.0.1:0");
    let expected = expected(&server);
    assert_eq!(in_axes(&server, Axes::Mirrored), expected);
    assert_eq!(in_axes(&server, Axes::Turned), expected);
}
