//! An invalid command is refused with the right error, and has no effect.
//!
//! A raw peer sends unchecked commands: every field of every command gets every kind of wrong number, and each limit
//! is reached and exceeded by the smallest step. The scene's checksum, tick and number of bodies must not change.

use core::f32::consts::TAU;

use glam::{Quat, Vec3};
use rhumb_protocol::limits::{
    ANGULAR_MAX, COORDINATE_MAX, DAMPING_MAX, DENSITY_MAX, DENSITY_MIN, EXTENT_MAX, EXTENT_MIN,
    FORCE_MAX, FRICTION_MAX, GRAVITY_MAX, GRAVITY_SCALE_MAX, LINEAR_MAX, MASS_MAX,
};
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::message::{ClientMessage, Extensions, ServerMessage};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, CommandError, Invalid, Joint, JointFrame, JointId, JointKind,
    JointLimits, Mass, Material, Quantity, SceneConfig, Shape, ShapeId, Sleep, SleepThresholds,
};
use rhumb_protocol::session::Event;
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_reckoning::{BodyId, BodyState, Damping, Tick};
use rhumb_sims::{Script, Zoo};
use rhumb_tests::{RawPeer, Table};

/// A raw peer in a scene, with a body of its own of each kind, and a shape.
struct Rig {
    table: Table,
    raw_peer: RawPeer,
    ball: BodyId,
}

/// A session creates a scene with a few bodies, and advances it by one step.
fn begin(table: &mut Table) {
    let mut script = Zoo::new(5, 3);
    let peer = table.create("good", script.config(), StreamChoice::Full);
    let mut commands = Vec::new();
    script.commands(Tick::ZERO, &mut commands);
    let now = table.now();
    let session = table.session(peer);
    for command in commands {
        session.command(command).expect("a valid command");
    }
    session.advance(now, Tick::new(1)).expect("a member");
    table.run_until_idle();
}

const BALL: ShapeId = ShapeId(100);

impl Rig {
    fn new() -> Self {
        let mut table = Table::default();
        begin(&mut table);
        let mut raw_peer = RawPeer::enter(&mut table, "good");
        let shape = Shape::Ball { radius: 0.5 };
        let add = Command::AddShape { id: BALL, shape };
        raw_peer.command(&mut table, add).expect("an unused id");
        let ball = raw_peer.granted.id(0).expect("a member has indices");
        let mut rig = Self {
            table,
            raw_peer,
            ball,
        };
        let mut desc = BodyDesc::plain(ball, BodyKind::Dynamic, BALL);
        // The greatest push makes no velocity of it that is beyond the limits.
        let (mass, moments) = (MASS_MAX, Some(Vec3::splat(MASS_MAX * 100.0)));
        desc.mass = Some(Mass { mass, moments });
        rig.command(add_body(desc, still()))
            .expect("an unused index");
        rig
    }

    fn command(&mut self, command: Command) -> Result<(), CommandError> {
        self.raw_peer.command(&mut self.table, command)
    }

    /// Requires that the command is refused with this error, and has no effect.
    fn assert_refused(&mut self, command: Command, expected: CommandError) {
        let before = self.raw_peer.inspect(&mut self.table);
        assert_eq!(self.command(command.clone()), Err(expected), "{command:?}");
        assert_eq!(
            self.raw_peer.inspect(&mut self.table),
            before,
            "{command:?}"
        );
        assert_eq!(self.raw_peer.closed(&self.table), None);
    }
}

fn still() -> BodyState {
    moving(Vec3::new(0.0, 50.0, 0.0), Vec3::ZERO, Vec3::ZERO)
}

fn moving(position: Vec3, linear: Vec3, angular: Vec3) -> BodyState {
    let rotation = [0.0, 0.0, 0.0, 1.0];
    BodyState::new(
        position.to_array(),
        rotation,
        linear.to_array(),
        angular.to_array(),
    )
    .expect("a finite motion")
}

fn add_body(desc: BodyDesc, motion: BodyState) -> Command {
    Command::AddBody { desc, motion }
}

/// Three vectors, each with another component replaced.
fn each_place(value: f32) -> [Vec3; 3] {
    [Vec3::X, Vec3::Y, Vec3::Z]
        .map(|axis| Vec3::select(axis.cmpgt(Vec3::ZERO), Vec3::splat(value), Vec3::ZERO))
}

/// A numeric field of a command, and its valid range.
struct Field {
    quantity: Quantity,
    least: f32,
    most: f32,
    /// Makes the command with this value in the field; scalar fields use the sum of the components.
    command: Box<dyn Fn(Vec3) -> Command>,
}

impl Field {
    fn new(
        quantity: Quantity,
        (least, most): (f32, f32),
        command: impl Fn(Vec3) -> Command + 'static,
    ) -> Self {
        Self {
            quantity,
            least,
            most,
            command: Box::new(command),
        }
    }
}

/// A range symmetric to zero.
const fn within(most: f32) -> (f32, f32) {
    (-most, most)
}

/// Fields of commands about a body.
fn fields_of_commands(id: BodyId) -> Vec<Field> {
    let zero = Vec3::ZERO;
    let rotation = Quat::IDENTITY;
    vec![
        Field::new(
            Quantity::Position,
            within(COORDINATE_MAX),
            move |position| Command::SetPose {
                id,
                position,
                rotation,
            },
        ),
        Field::new(Quantity::Linear, within(LINEAR_MAX), move |linear| {
            Command::SetVelocity {
                id,
                linear,
                angular: zero,
            }
        }),
        Field::new(Quantity::Angular, within(ANGULAR_MAX), move |angular| {
            Command::SetVelocity {
                id,
                linear: zero,
                angular,
            }
        }),
        Field::new(Quantity::Force, within(FORCE_MAX), move |force| {
            Command::Force { id, force }
        }),
        Field::new(Quantity::Torque, within(FORCE_MAX), move |torque| {
            Command::Torque { id, torque }
        }),
        Field::new(Quantity::Impulse, within(FORCE_MAX), move |impulse| {
            Command::Impulse { id, impulse }
        }),
        Field::new(Quantity::TorqueImpulse, within(FORCE_MAX), move |impulse| {
            Command::TorqueImpulse { id, impulse }
        }),
        Field::new(Quantity::Gravity, within(GRAVITY_MAX), |gravity| {
            Command::SetGravity { gravity }
        }),
    ]
}

/// Fields of a new body.
fn fields_of_bodies(id: BodyId) -> Vec<Field> {
    let plain = BodyDesc::plain(id, BodyKind::Dynamic, BALL);
    let made = move |material: Material| {
        let material = Some(material);
        add_body(BodyDesc { material, ..plain }, still())
    };
    let damped = move |linear: f32, angular: f32| {
        let damping = Some(Damping { linear, angular });
        add_body(BodyDesc { damping, ..plain }, still())
    };
    vec![
        Field::new(Quantity::Friction, (0.0, FRICTION_MAX), move |v| {
            made(Material {
                friction: v.element_sum(),
                ..WOOD
            })
        }),
        Field::new(Quantity::Restitution, (0.0, 1.0), move |v| {
            made(Material {
                restitution: v.element_sum(),
                ..WOOD
            })
        }),
        Field::new(Quantity::Density, (DENSITY_MIN, DENSITY_MAX), move |v| {
            made(Material {
                density: v.element_sum(),
                ..WOOD
            })
        }),
        Field::new(Quantity::Damping, (0.0, DAMPING_MAX), move |v| {
            damped(v.element_sum(), 0.0)
        }),
        Field::new(Quantity::Damping, (0.0, DAMPING_MAX), move |v| {
            damped(0.0, v.element_sum())
        }),
        Field::new(
            Quantity::GravityScale,
            within(GRAVITY_SCALE_MAX),
            move |v| {
                let gravity_scale = v.element_sum();
                add_body(
                    BodyDesc {
                        gravity_scale,
                        ..plain
                    },
                    still(),
                )
            },
        ),
    ]
}

const WOOD: Material = Material {
    friction: 0.5,
    restitution: 0.5,
    density: 700.0,
};

/// Extents of new shapes.
fn fields_of_shapes() -> Vec<Field> {
    let shapes: [fn(f32) -> Shape; 6] = [
        |radius| Shape::Ball { radius },
        |y| Shape::Cuboid {
            half_extents: Vec3::new(1.0, y, 1.0),
        },
        |half_height| Shape::Capsule {
            half_height,
            radius: 1.0,
        },
        |radius| Shape::Capsule {
            half_height: 1.0,
            radius,
        },
        |half_height| Shape::Cylinder {
            half_height,
            radius: 1.0,
        },
        |radius| Shape::Cylinder {
            half_height: 1.0,
            radius,
        },
    ];
    let id = ShapeId(500);
    let field = |shape: fn(f32) -> Shape| {
        Field::new(Quantity::Extent, (EXTENT_MIN, EXTENT_MAX), move |v| {
            Command::AddShape {
                id,
                shape: shape(v.element_sum()),
            }
        })
    };
    let mut fields: Vec<_> = shapes.into_iter().map(field).collect();
    let hull = move |first| Command::AddShape {
        id,
        shape: hull_of(&[first, CORNERS[0], CORNERS[1], CORNERS[2]]),
    };
    let most = EXTENT_MAX;
    fields.push(Field::new(Quantity::Extent, (-most, most), hull));
    fields
}

const CORNERS: [Vec3; 3] = [
    Vec3::new(0.0, 100.0, 0.0),
    Vec3::new(0.0, 0.0, 100.0),
    Vec3::new(-100.0, -100.0, -100.0),
];

/// A hull decoded from bytes, unchecked.
fn hull_of(points: &[Vec3]) -> Shape {
    let mut bytes = Writer::new();
    bytes.u8(4);
    bytes.u8(points.len() as u8);
    for point in points {
        bytes.f32s(&point.to_array());
    }
    Shape::decode(&mut Reader::new(&bytes.into_bytes())).expect("the right number of points")
}

/// Anchors and limits of new joints between the ball and the zoo's floor.
fn fields_of_joints(ball: BodyId) -> Vec<Field> {
    let joint = move |kind, anchor| Command::AddJoint {
        id: JointId(500),
        joint: Box::new(Joint {
            kind,
            bodies: [BodyId::new(0, 0), ball],
            frames: [JointFrame::at(Vec3::ZERO), JointFrame::at(anchor)],
            collide: true,
            motors: [None; 6],
            strength: None,
        }),
    };
    let limits = |least, most| JointLimits { least, most };
    let most = EXTENT_MAX;
    vec![
        Field::new(Quantity::Anchor, (-most, most), move |v| {
            joint(JointKind::Fixed, v)
        }),
        Field::new(Quantity::JointLimit, (0.5, TAU), move |v| {
            let limits = limits(0.5, v.element_sum());
            joint(JointKind::Revolute(Some(limits)), Vec3::ZERO)
        }),
        Field::new(Quantity::JointLimit, (0.5 - TAU, 0.5), move |v| {
            let limits = limits(v.element_sum(), 0.5);
            joint(JointKind::Spherical(Some([limits; 3])), Vec3::ZERO)
        }),
        Field::new(Quantity::JointLimit, (-most, 0.5), move |v| {
            let limits = limits(v.element_sum(), 0.5);
            joint(JointKind::Prismatic(Some(limits)), Vec3::ZERO)
        }),
    ]
}

/// All fields, for the rig's ball and its next body.
fn fields(rig: &Rig) -> Vec<Field> {
    let unused = rig.raw_peer.granted.id(1).expect("a member has indices");
    let mut fields = fields_of_commands(rig.ball);
    fields.extend(fields_of_bodies(unused));
    fields.extend(fields_of_shapes());
    fields.extend(fields_of_joints(rig.ball));
    fields
}

#[test]
fn every_number_that_is_not_finite_is_refused_by_its_name() {
    let mut rig = Rig::new();
    for Field {
        quantity, command, ..
    } in fields(&rig)
    {
        for wrong in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for vector in each_place(wrong) {
                let expected = CommandError::Invalid(Invalid::not_finite(quantity));
                rig.assert_refused(command(vector), expected);
            }
        }
    }
}

#[test]
fn a_value_beyond_a_limit_is_refused_by_its_name() {
    let mut rig = Rig::new();
    for field in fields(&rig) {
        let just_beyond = [field.least.next_down(), field.most.next_up()];
        for beyond in just_beyond.into_iter().chain([f32::MIN, f32::MAX]) {
            for vector in each_place(beyond) {
                let expected = CommandError::Invalid(Invalid::out_of_range(field.quantity));
                rig.assert_refused((field.command)(vector), expected);
            }
        }
    }
}

#[test]
fn a_value_at_a_limit_is_accepted_and_the_scene_continues() {
    for number in 0..fields(&Rig::new()).len() {
        for edge in 0..2 {
            let mut rig = Rig::new();
            let field = fields(&rig).swap_remove(number);
            let [along_x, ..] = each_place([field.least, field.most][edge]);
            assert_eq!(
                rig.command((field.command)(along_x)),
                Ok(()),
                "{}",
                field.quantity
            );
            rig.raw_peer
                .send(&mut rig.table, &ClientMessage::Advance { to: Tick::new(5) });
            let (_, tick, _) = rig.raw_peer.inspect(&mut rig.table);
            assert_eq!(tick, 5, "{} at {along_x}", field.quantity);
        }
    }
}

#[test]
fn a_rotation_is_of_unit_length_or_refused() {
    let mut rig = Rig::new();
    let id = rig.ball;
    for wrong in [
        Quat::from_xyzw(0.0, 0.0, 0.0, 0.0),
        Quat::from_xyzw(0.0, 0.0, 0.0, 1.1),
        Quat::from_xyzw(f32::NAN, 0.0, 0.0, 1.0),
        Quat::from_xyzw(f32::INFINITY, 0.0, 0.0, 1.0),
        Quat::from_xyzw(1.0, 1.0, 1.0, 1.0),
        Quat::from_xyzw(f32::MAX, f32::MAX, 0.0, 0.0),
    ] {
        let command = Command::SetPose {
            id,
            position: Vec3::ZERO,
            rotation: wrong,
        };
        let expected = CommandError::Invalid(Invalid::not_finite(Quantity::Rotation));
        rig.assert_refused(command, expected);
    }
}

#[test]
fn the_motion_of_an_added_body_keeps_the_limits_too() {
    let mut rig = Rig::new();
    let desc = BodyDesc::plain(rig.raw_peer.granted.id(1).unwrap(), BodyKind::Dynamic, BALL);
    let far = Vec3::new(0.0, COORDINATE_MAX.next_up(), 0.0);
    let fast = Vec3::new(LINEAR_MAX.next_up(), 0.0, 0.0);
    let spinning = Vec3::new(0.0, 0.0, ANGULAR_MAX.next_up());
    for (motion, quantity) in [
        (moving(far, Vec3::ZERO, Vec3::ZERO), Quantity::Position),
        (moving(Vec3::ZERO, fast, Vec3::ZERO), Quantity::Linear),
        (moving(Vec3::ZERO, Vec3::ZERO, spinning), Quantity::Angular),
    ] {
        let expected = CommandError::Invalid(Invalid::out_of_range(quantity));
        rig.assert_refused(add_body(desc, motion), expected);
    }
}

#[test]
fn an_added_body_with_a_motion_that_is_not_finite_is_refused() {
    let mut rig = Rig::new();
    let desc = BodyDesc::plain(rig.raw_peer.granted.id(1).unwrap(), BodyKind::Dynamic, BALL);
    let mut bytes = Vec::new();
    ClientMessage::Command(add_body(desc, still())).encode(&mut bytes);
    let height = 50.0_f32.to_le_bytes();
    let place = bytes
        .windows(4)
        .position(|window| window == height)
        .unwrap();
    bytes[place..place + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    let received = rig.raw_peer.send_bytes(&mut rig.table, &bytes);
    let expected = CommandError::Invalid(Invalid::not_finite(Quantity::Position));
    let refused = |message: &ServerMessage| matches!(message, ServerMessage::Refused { error, .. } if *error == expected);
    assert!(received.iter().any(refused), "{received:?}");
    assert_eq!(rig.raw_peer.closed(&rig.table), None);
}

#[test]
fn a_hull_without_a_volume_is_refused_as_too_thin() {
    let mut rig = Rig::new();
    let thin = CommandError::Invalid(Invalid::out_of_range(Quantity::HullThickness));
    for points in [
        vec![Vec3::ZERO; 4],
        vec![Vec3::ONE; 255],
        (0..10).map(|i| Vec3::X * i as f32).collect(),
        (0..9)
            .map(|i| Vec3::new((i % 3) as f32, (i / 3) as f32, 1.0))
            .collect(),
    ] {
        let (id, shape) = (ShapeId(500), hull_of(&points));
        rig.assert_refused(Command::AddShape { id, shape }, thin);
    }
}

/// A moving ball.
const fn ball_of(id: BodyId, shape: ShapeId) -> BodyDesc {
    BodyDesc::plain(id, BodyKind::Dynamic, shape)
}

#[test]
fn commands_about_objects_that_do_not_exist_are_refused_by_their_name() {
    let mut rig = Rig::new();
    let dead = BodyId::new(rig.ball.index(), 7);
    let foreign = BodyId::new(4_000, 0);
    let no_shape = ShapeId(77);
    let remove = Command::RemoveBody { id: dead };
    rig.assert_refused(remove, CommandError::UnknownBody(dead));
    let (id, force) = (foreign, Vec3::X);
    rig.assert_refused(Command::Force { id, force }, CommandError::UnknownBody(id));
    let remove = Command::RemoveShape { id: no_shape };
    rig.assert_refused(remove, CommandError::UnknownShape(no_shape));
    let unused = rig.raw_peer.granted.id(1).unwrap();
    let add = add_body(ball_of(unused, no_shape), still());
    rig.assert_refused(add, CommandError::UnknownShape(no_shape));
}

#[test]
fn commands_about_used_or_foreign_ids_are_refused_by_their_name() {
    let mut rig = Rig::new();
    let granted = rig.raw_peer.granted;
    let later = BodyId::new(rig.ball.index(), 7);
    for taken in [rig.ball, later] {
        let add = add_body(ball_of(taken, BALL), still());
        rig.assert_refused(add, CommandError::BodyIdTaken(taken));
    }
    let foreign = BodyId::new(4_000, 0);
    let outside = BodyId::new(granted.first() + granted.count(), 0);
    for id in [foreign, outside] {
        let add = add_body(ball_of(id, BALL), still());
        rig.assert_refused(add, CommandError::NotGranted(id));
    }
    let remove = Command::RemoveShape { id: BALL };
    rig.assert_refused(remove, CommandError::ShapeInUse(BALL));
    let shape = Shape::Ball { radius: 1.0 };
    let add = Command::AddShape { id: BALL, shape };
    rig.assert_refused(add, CommandError::ShapeIdTaken(BALL));
    let (id, impulse) = (BodyId::new(0, 0), Vec3::X);
    let push = Command::Impulse { id, impulse };
    rig.assert_refused(push, CommandError::NotPushable(id));
}

#[test]
fn a_removed_body_stays_removed_and_its_index_can_be_reused() {
    let mut rig = Rig::new();
    let (id, torque) = (rig.ball, Vec3::X);
    rig.command(Command::RemoveBody { id }).unwrap();
    rig.assert_refused(
        Command::Torque { id, torque },
        CommandError::UnknownBody(id),
    );
    let again = add_body(ball_of(id, BALL), still());
    rig.assert_refused(again, CommandError::BodyIdTaken(id));
    let next = BodyId::new(id.index(), 1);
    assert_eq!(rig.command(add_body(ball_of(next, BALL), still())), Ok(()));
}

#[test]
fn a_scene_with_an_invalid_config_is_denied() {
    let script = Zoo::new(1, 1);
    const fn sleep(speed: f32, seconds: f32) -> Sleep {
        Sleep::Below(SleepThresholds::by_speed(speed, seconds))
    }
    let with = |change: fn(&mut SceneConfig)| {
        let mut config = script.config();
        change(&mut config);
        config
    };
    for config in [
        with(|config| config.gravity.y = f32::NAN),
        with(|config| config.gravity.x = GRAVITY_MAX.next_up()),
        with(|config| config.material.density = 0.0),
        with(|config| config.damping.linear = -1.0),
        with(|config| config.sleep = sleep(-0.1, 1.0)),
        with(|config| config.sleep = sleep(0.1, f32::NAN)),
    ] {
        let mut table = Table::default();
        let raw_peer = table.connect_raw_peer();
        let mut bytes = Vec::new();
        let scene = "wrong".parse().unwrap();
        ClientMessage::Hello {
            versions: vec![1],
            scene,
            extensions: Extensions::NONE,
        }
        .encode(&mut bytes);
        ClientMessage::Create(config).encode(&mut bytes);
        table.control(raw_peer, &bytes);
        assert_eq!(table.closed(raw_peer), None);
        let again = table.connect("wrong");
        let session = table.session(again);
        let event = std::iter::from_fn(|| session.poll_event()).next();
        assert!(matches!(event, Some(Event::Welcomed(welcome)) if welcome.scene.is_none()));
    }
}
