//! Invalid commands are refused, and a refused command changes nothing.
//!
//! The rules of ids are proved one by one. Two scenes prove that a refusal has no effect: both get random commands
//! with absurd numbers and dead ids, but the second only those that the first accepted. A double replaces the engine
//! to test a fault.

use glam::{Quat, Vec3};
use proptest::prelude::*;
use rhumb_protocol::limits::{DAMPINGS_MAX, INDICES_MAX, JOINTS_MAX, SHAPES_MAX};
use rhumb_protocol::message::RemovalCause;
use rhumb_protocol::scene::{
    Answer, BodyDesc, BodyEvent, BodyKind, Command, CommandError, Contact, Hull, Invalid, Joint,
    JointFrame, JointId, JointKind, JointLimits, JumpFrom, LockedAxes, Locomotion, Material,
    Quantity, Query, SceneConfig, Shape, ShapeId, WheelInput,
};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, BodyState, Damping, Inertia, Tick, Twist};
use rhumb_scene::engine::{
    BodyProperties, Engine, EngineFault, Push, UnanswerableQuery, UnusableShape,
};
use rhumb_scene::{Digest, Scene, SceneFault};

fn config() -> SceneConfig {
    SceneConfig {
        gravity: Vec3::new(0.0, -10.0, 0.0),
        material: Material {
            friction: 0.5,
            restitution: 0.5,
            density: 1_000.0,
        },
        ..SceneConfig::default()
    }
}

const SHAPE: ShapeId = ShapeId(3);

fn with_shape() -> Scene {
    let mut scene = Scene::new(config()).expect("the test makes it valid");
    let shape = Shape::Ball { radius: 0.5 };
    scene
        .apply(&Command::AddShape { id: SHAPE, shape })
        .expect("the test makes it valid");
    scene
}

fn body(index: u32, generation: u16, kind: BodyKind) -> Command {
    let id = BodyId::new(index, generation);
    let identity = [0.0, 0.0, 0.0, 1.0];
    Command::AddBody {
        desc: BodyDesc::plain(id, kind, SHAPE),
        motion: BodyState::new([0.0; 3], identity, [0.0; 3], [0.0; 3])
            .expect("the test makes it valid"),
    }
}

#[test]
fn generations_of_an_index_only_grow() {
    let mut scene = with_shape();
    let id = BodyId::new(4, 2);
    scene.apply(&body(4, 2, BodyKind::Dynamic)).unwrap();
    for generation in [1, 2, 3] {
        let taken = CommandError::BodyIdTaken(BodyId::new(4, generation));
        let answer = scene.apply(&body(4, generation, BodyKind::Dynamic));
        assert_eq!(answer, Err(taken));
    }
    assert_eq!((scene.vacancy(4), scene.vacancy(5)), (None, Some(0)));
    scene.apply(&Command::RemoveBody { id }).unwrap();
    assert_eq!(scene.vacancy(4), Some(3));
    assert_eq!(
        scene.apply(&Command::RemoveBody { id }),
        Err(CommandError::UnknownBody(id))
    );
    let answer = scene.apply(&body(4, 2, BodyKind::Dynamic));
    assert_eq!(answer, Err(CommandError::BodyIdTaken(id)));
    scene.apply(&body(4, 3, BodyKind::Dynamic)).unwrap();
    let beyond = scene.apply(&body(INDICES_MAX, 0, BodyKind::Dynamic));
    let id = BodyId::new(INDICES_MAX, 0);
    assert_eq!(beyond, Err(CommandError::NotGranted(id)));
}

#[test]
fn a_shape_stays_while_a_body_has_it() {
    let mut scene = with_shape();
    let (id, shape) = (SHAPE, Shape::Ball { radius: 1.0 });
    let add = |id| Command::AddShape {
        id,
        shape: shape.clone(),
    };
    assert_eq!(scene.apply(&add(id)), Err(CommandError::ShapeIdTaken(id)));
    scene.apply(&body(0, 0, BodyKind::Dynamic)).unwrap();
    let remove = Command::RemoveShape { id };
    assert_eq!(scene.apply(&remove), Err(CommandError::ShapeInUse(id)));
    scene
        .apply(&Command::RemoveBody {
            id: BodyId::new(0, 0),
        })
        .unwrap();
    scene.apply(&remove).unwrap();
    assert_eq!(scene.apply(&remove), Err(CommandError::UnknownShape(id)));
    let unknown = scene.apply(&body(0, 1, BodyKind::Dynamic));
    assert_eq!(unknown, Err(CommandError::UnknownShape(id)));
    let id = ShapeId(SHAPES_MAX);
    let beyond = scene.apply(&add(id));
    assert_eq!(beyond, Err(CommandError::UnknownShape(id)));
}

#[test]
fn only_dynamic_bodies_are_pushed_and_static_ones_have_no_velocity() {
    let mut scene = with_shape();
    let (still, moved) = (BodyId::new(0, 0), BodyId::new(1, 0));
    scene.apply(&body(0, 0, BodyKind::Fixed)).unwrap();
    scene.apply(&body(1, 0, BodyKind::Kinematic)).unwrap();
    let (linear, angular) = (Vec3::X, Vec3::Y);
    for (id, velocity) in [
        (still, Err(CommandError::NotPushable(still))),
        (moved, Ok(())),
    ] {
        let refused = Err(CommandError::NotPushable(id));
        let impulse = linear;
        assert_eq!(scene.apply(&Command::Force { id, force: linear }), refused);
        assert_eq!(
            scene.apply(&Command::Torque { id, torque: linear }),
            refused
        );
        assert_eq!(scene.apply(&Command::Impulse { id, impulse }), refused);
        assert_eq!(
            scene.apply(&Command::TorqueImpulse { id, impulse }),
            refused
        );
        let set = Command::SetVelocity {
            id,
            linear,
            angular,
        };
        assert_eq!(scene.apply(&set), velocity);
    }
}

#[test]
fn the_number_of_different_dampings_is_limited() {
    let mut scene = with_shape();
    let damped = |index: u32| {
        let Command::AddBody { mut desc, motion } = body(index, 0, BodyKind::Dynamic) else {
            unreachable!()
        };
        desc.damping = Some(Damping {
            linear: index as f32,
            angular: 0.0,
        });
        Command::AddBody { desc, motion }
    };
    let most = DAMPINGS_MAX as u32;
    for index in 0..most {
        scene.apply(&damped(index)).unwrap();
    }
    let answer = scene.apply(&damped(most));
    assert_eq!(answer, Err(CommandError::TooManyDampings));
    scene.apply(&body(most, 0, BodyKind::Dynamic)).unwrap();
}

#[test]
fn a_joint_needs_two_living_bodies_and_a_free_id() {
    let mut scene = with_shape();
    let [a, b] = [0, 1].map(|index| BodyId::new(index, 0));
    let add = |id, bodies| Command::AddJoint {
        id,
        joint: Joint::plain(JointKind::Fixed, bodies, [JointFrame::at(Vec3::ZERO); 2]).into(),
    };
    let id = JointId(7);
    scene.apply(&body(0, 0, BodyKind::Fixed)).unwrap();
    let answer = scene.apply(&add(id, [a, b]));
    assert_eq!(answer, Err(CommandError::UnknownBody(b)));
    scene.apply(&body(1, 0, BodyKind::Fixed)).unwrap();
    let answer = scene.apply(&add(id, [b, b]));
    assert_eq!(answer, Err(CommandError::JoinedToItself(b)));
    let beyond = JointId(JOINTS_MAX);
    let answer = scene.apply(&add(beyond, [a, b]));
    assert_eq!(answer, Err(CommandError::UnknownJoint(beyond)));
    scene.apply(&add(id, [a, b])).unwrap();
    let answer = scene.apply(&add(id, [b, a]));
    assert_eq!(answer, Err(CommandError::JointIdTaken(id)));
    let remove = Command::RemoveJoint { id };
    scene.apply(&remove).unwrap();
    assert_eq!(scene.apply(&remove), Err(CommandError::UnknownJoint(id)));
}

#[test]
fn a_scene_config_is_checked() {
    let mut wrong = config();
    wrong.gravity.x = f32::NAN;
    let answer = Scene::new(wrong).map(|_| ());
    assert_eq!(answer, Err(Invalid::not_finite(Quantity::Gravity)));
}

/// An engine without a world: it loses one body and then fails.
struct Double {
    steps: u32,
    loses: BodyId,
}

impl Engine for Double {
    fn add_shape(&mut self, _: ShapeId, _: &Shape) -> Result<(), UnusableShape> {
        Ok(())
    }

    fn remove_shape(&mut self, _: ShapeId) {}
    fn add_joint(&mut self, _: JointId, _: &Joint) {}
    fn remove_joint(&mut self, _: JointId) {}
    fn add(&mut self, _: &BodyProperties, _: BodyState) {}
    fn change(&mut self, _: &BodyDesc, _: &BodyProperties) {}
    fn set_activity(&mut self, _: BodyId, _: Activity) {}
    fn overloaded_joints(&self, _: &mut Vec<JointId>) {}
    fn set_locomotion(&mut self, _: BodyId, _: &Locomotion) {}
    fn jump(&mut self, _: BodyId, _: f32, _: JumpFrom) {}
    fn set_wheels(&mut self, _: BodyId, _: &[WheelInput]) {}
    fn ground_events(&self, _: &mut Vec<BodyEvent>) {}

    fn remove(&mut self, _: BodyId) {}
    fn set_pose(&mut self, _: BodyId, _: Vec3, _: Quat) {}
    fn set_velocity(&mut self, _: BodyId, _: Twist) {}
    fn push(&mut self, _: BodyId, _: Push) {}
    fn set_gravity(&mut self, _: Vec3) {}

    fn step(&mut self, lost: &mut Vec<(BodyId, RemovalCause)>) -> Result<(), EngineFault> {
        self.steps += 1;
        if self.steps == 1 {
            lost.push((self.loses, RemovalCause::NotFinite));
        }
        self.fault().map_or(Ok(()), Err)
    }

    fn observe(&self, _: &mut Vec<Observation>) {}

    fn observe_one(&self, _: BodyId) -> Option<Observation> {
        None
    }

    fn inertia(&self, _: BodyId) -> Option<Inertia> {
        None
    }

    fn contacts(&self, _: BodyId, _: &mut Vec<Contact>) {}
    fn sensed(&self, _: BodyId, _: &mut Vec<(BodyId, BodyId)>) {}

    fn query(&self, _: &Query) -> Result<Answer, UnanswerableQuery> {
        Err(UnanswerableQuery)
    }

    fn awake_count(&self) -> usize {
        0
    }

    fn fault(&self) -> Option<EngineFault> {
        (self.steps > 1).then_some(EngineFault::Panicked)
    }
}

#[test]
fn a_faulted_scene_takes_no_steps_and_no_commands() {
    let loses = BodyId::new(0, 0);
    let engine = Box::new(Double { steps: 0, loses });
    let mut scene = Scene::with_engine(config(), engine).unwrap();
    let shape = Shape::Ball { radius: 0.5 };
    let add = Command::AddShape { id: SHAPE, shape };
    scene.apply(&add).unwrap();
    scene.apply(&body(0, 0, BodyKind::Dynamic)).unwrap();
    let stepped = scene.step().unwrap();
    assert_eq!(stepped.removed, [(loses, RemovalCause::NotFinite)]);
    assert_eq!(scene.body_count(), 0);
    let fault = SceneFault::Engine(EngineFault::Panicked);
    for _ in 0..2 {
        assert_eq!(scene.step(), Err(fault));
        assert_eq!(scene.tick(), Tick::new(1));
        let answer = scene.apply(&Command::RemoveShape { id: SHAPE });
        assert_eq!(answer, Err(CommandError::SceneFaulted));
    }
}

/// A number that can be sent but is absurd.
fn absurd() -> impl Strategy<Value = f32> {
    prop::sample::select(vec![
        0.0,
        -1.0,
        -1e5,
        1e3,
        1e9,
        1e-3,
        1e4,
        1e6,
        f32::MAX,
        f32::NAN,
        f32::INFINITY,
        1e-40,
    ])
}

/// Mostly a number of this range.
fn number(from: f32, to: f32) -> impl Strategy<Value = f32> {
    prop_oneof![40 => from..to, 1 => absurd()]
}

fn vector(most: f32) -> impl Strategy<Value = Vec3> {
    let component = || number(-most, most);
    (component(), component(), component()).prop_map(|(x, y, z)| Vec3::new(x, y, z))
}

fn rotation() -> impl Strategy<Value = Quat> {
    prop_oneof![
        9 => Just(Quat::IDENTITY),
        9 => (-1.0_f32..1.0).prop_map(Quat::from_rotation_x),
        1 => Just(Quat::from_xyzw(0.0, 0.0, 0.0, 1.0004)),
        1 => Just(Quat::from_xyzw(0.0, 0.0, 0.0, 0.0)),
        1 => (absurd(), absurd()).prop_map(|(x, w)| Quat::from_xyzw(x, 0.0, 0.0, w)),
    ]
}

fn id() -> impl Strategy<Value = BodyId> {
    let (index, generation) = (0..6_u32, prop::sample::select(vec![0_u16, 0, 0, 0, 1, 2]));
    prop_oneof![
        30 => (index, generation).prop_map(|(index, generation)| BodyId::new(index, generation)),
        1 => Just(BodyId::new(u32::MAX, u16::MAX)),
    ]
}

/// From tiny to world-sized, mostly within the limits.
fn extent() -> impl Strategy<Value = f32> {
    prop_oneof![16 => 0.1_f32..2.0, 1 => Just(1e-3), 1 => Just(1e4), 1 => absurd()]
}

/// Points on a coarse grid, so that many coincide or lie in lines and planes, or almost.
fn hull() -> impl Strategy<Value = Hull> {
    let coordinate = || (-4_i8..=4).prop_map(|step| f32::from(step) * 0.25);
    let point = (coordinate(), coordinate(), coordinate());
    let points = prop::collection::vec(point, 4..60);
    let sizes = (
        extent(),
        extent(),
        prop_oneof![3 => Just(0.0), 1 => 0.0_f32..0.01],
    );
    (points, sizes, rotation()).prop_filter_map(
        "its numbers are refused",
        |(points, sizes, turn)| {
            let (size, flatness, jitter) = sizes;
            let spoiled = |(place, (x, y, z)): (usize, (f32, f32, f32))| {
                let divergence_time = jitter * (place % 7) as f32;
                turn * (Vec3::new(x + divergence_time, y * flatness, z - divergence_time) * size)
            };
            let points: Vec<_> = points.into_iter().enumerate().map(spoiled).collect();
            Hull::new(&points).ok()
        },
    )
}

fn shape() -> impl Strategy<Value = Shape> {
    prop_oneof![
        hull().prop_map(Shape::Hull),
        extent().prop_map(|radius| Shape::Ball { radius }),
        (extent(), extent(), extent()).prop_map(|(x, y, z)| Shape::Cuboid {
            half_extents: Vec3::new(x, y, z)
        }),
        (extent(), extent()).prop_map(|(half_height, radius)| Shape::Capsule {
            half_height,
            radius
        }),
        (extent(), extent()).prop_map(|(half_height, radius)| Shape::Cylinder {
            half_height,
            radius
        }),
    ]
}

fn shape_id() -> impl Strategy<Value = ShapeId> {
    prop_oneof![19 => (0..5_u32).prop_map(ShapeId), 1 => Just(ShapeId(u32::MAX))]
}

fn body_desc() -> impl Strategy<Value = BodyDesc> {
    let kind = prop_oneof![
        1 => Just(BodyKind::Fixed),
        6 => Just(BodyKind::Dynamic),
        2 => Just(BodyKind::Kinematic),
    ];
    let density = prop_oneof![Just(1e-3_f32), Just(1e6), number(1.0, 1e4)];
    let material = (number(0.0, 2.0), number(0.0, 1.0), density);
    let material = prop::option::of(material);
    let scale = number(-1.0, 2.0);
    (id(), kind, shape_id(), material, scale).prop_map(|(id, kind, shape, material, scale)| {
        let mut desc = BodyDesc::plain(id, kind, shape);
        desc.material = material.map(|(friction, restitution, density)| Material {
            friction,
            restitution,
            density,
        });
        desc.gravity_scale = scale;
        desc
    })
}

/// A body of a low index, and of a later generation if its index was used.
fn body_command() -> impl Strategy<Value = Option<Command>> {
    let place = (vector(2.0), rotation(), vector(20.0), vector(20.0));
    (body_desc(), place).prop_map(|(desc, (p, q, v, w))| {
        let made = BodyState::new(p.to_array(), q.to_array(), v.to_array(), w.to_array());
        made.ok().map(|motion| Command::AddBody { desc, motion })
    })
}

fn push_command() -> impl Strategy<Value = Option<Command>> {
    let size = prop::sample::select(vec![1.0, 100.0, 1e5, 3e8]);
    (id(), vector(3.0), size, 0..4).prop_map(|(id, vector, size, which)| {
        let (force, torque, impulse) = (vector * size, vector * size, vector * size);
        Some(match which {
            0 => Command::Force { id, force },
            1 => Command::Torque { id, torque },
            2 => Command::Impulse { id, impulse },
            _ => Command::TorqueImpulse { id, impulse },
        })
    })
}

fn joint_id() -> impl Strategy<Value = JointId> {
    prop_oneof![19 => (0..8_u32).prop_map(JointId), 1 => Just(JointId(JOINTS_MAX))]
}

fn limits() -> impl Strategy<Value = JointLimits> {
    (number(-1.0, 0.5), number(0.0, 3.0)).prop_map(|(least, most)| JointLimits { least, most })
}

fn joint() -> impl Strategy<Value = Joint> {
    let kind = prop_oneof![
        Just(JointKind::Fixed),
        prop::option::of([limits(), limits(), limits()]).prop_map(JointKind::Spherical),
        prop::option::of(limits()).prop_map(JointKind::Revolute),
        prop::option::of(limits()).prop_map(JointKind::Prismatic),
    ];
    let anchor = || prop_oneof![9 => vector(1.0), 1 => vector(1e4)];
    let frame =
        || (anchor(), rotation()).prop_map(|(anchor, rotation)| JointFrame { anchor, rotation });
    (kind, [id(), id()], [frame(), frame()], any::<bool>()).prop_map(
        |(kind, bodies, frames, collide)| Joint {
            kind,
            bodies,
            frames,
            collide,
            motors: [None; 6],
            strength: None,
        },
    )
}

fn step_or_command() -> impl Strategy<Value = Option<Command>> {
    let position = prop_oneof![5 => vector(2.0), 1 => vector(1e5)];
    let pose = (id(), position, rotation()).prop_map(|(id, position, rotation)| Command::SetPose {
        id,
        position,
        rotation,
    });
    let velocity =
        (id(), vector(1e3), vector(100.0)).prop_map(|(id, linear, angular)| Command::SetVelocity {
            id,
            linear,
            angular,
        });
    prop_oneof![
        2 => (shape_id(), shape()).prop_map(|(id, shape)| Some(Command::AddShape { id, shape })),
        1 => shape_id().prop_map(|id| Some(Command::RemoveShape { id })),
        8 => body_command(),
        4 => (body_command(), 0..64_u8, any::<bool>()).prop_map(|(command, axes, enabled)| {
            Some(match command? {
                Command::AddBody { mut desc, .. } => {
                    desc.locked = LockedAxes::new(axes).unwrap_or_default();
                    (desc.sensor, desc.enabled) = (axes > 50, enabled);
                    Command::ChangeBody { desc }
                }
                other => other,
            })
        }),
        2 => (joint_id(), joint()).prop_map(|(id, joint)| Some(Command::ChangeJoint { id, joint: joint.into() })),
        2 => id().prop_map(|id| Some(Command::RemoveBody { id })),
        5 => (joint_id(), joint()).prop_map(|(id, joint)| Some(Command::AddJoint { id, joint: joint.into() })),
        1 => joint_id().prop_map(|id| Some(Command::RemoveJoint { id })),
        2 => pose.prop_map(Some),
        2 => velocity.prop_map(Some),
        4 => push_command(),
        1 => vector(100.0).prop_map(|gravity| Some(Command::SetGravity { gravity })),
        // A step.
        8 => Just(None),
    ]
}

/// The observable state of a scene.
#[derive(Debug, PartialEq)]
struct SceneView {
    all: Vec<Observation>,
    bodies: Vec<BodyDesc>,
    shapes: Vec<(ShapeId, Shape)>,
    joints: Vec<(JointId, Joint)>,
    gravity: Vec3,
    tick: Tick,
    digest: Digest,
}

impl SceneView {
    fn of(scene: &Scene) -> Self {
        let mut all = Vec::new();
        scene.observe_all(&mut all);
        Self {
            all,
            bodies: scene.bodies().copied().collect(),
            shapes: scene
                .shapes()
                .map(|(id, shape)| (id, shape.clone()))
                .collect(),
            joints: scene
                .joints()
                .iter()
                .map(|(id, joint)| (id, *joint))
                .collect(),
            gravity: scene.gravity(),
            tick: scene.tick(),
            digest: scene.digest(),
        }
    }
}

/// Two shapes and three bodies.
fn begun() -> Scene {
    let mut scene = with_shape();
    let floor = Shape::Cuboid {
        half_extents: Vec3::new(5.0, 0.5, 5.0),
    };
    for (number, shape) in [(0, Shape::Ball { radius: 0.5 }), (1, floor)] {
        let id = ShapeId(number);
        scene
            .apply(&Command::AddShape { id, shape })
            .expect("the test makes it valid");
    }
    for (index, kind) in [BodyKind::Fixed, BodyKind::Dynamic, BodyKind::Kinematic]
        .into_iter()
        .enumerate()
    {
        scene
            .apply(&body(index as u32, 0, kind))
            .expect("the test makes it valid");
    }
    scene
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn no_sequence_panics_and_refused_commands_change_nothing(
        actions in prop::collection::vec(step_or_command(), 1..100)
    ) {
        let (mut scene, mut accepted_only) = (begun(), begun());
        for action in actions {
            match action {
                Some(command) => match scene.apply(&command) {
                    Ok(()) => prop_assert_eq!(accepted_only.apply(&command), Ok(())),
                    Err(error) => prop_assert_ne!(error, CommandError::SceneFaulted),
                },
                None => {
                    let stepped = scene.step();
                    prop_assert!(stepped.is_ok());
                    prop_assert_eq!(stepped, accepted_only.step());
                }
            }
            let view = SceneView::of(&scene);
            prop_assert_eq!(view.all.len(), view.bodies.len());
            prop_assert_eq!(view, SceneView::of(&accepted_only));
        }
    }
}
