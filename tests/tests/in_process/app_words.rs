//! A scene stays valid whatever a client of the paper's protocol sends.
//!
//! The tests send random messages about a few objects, with valid, extreme or invalid numbers, so that the messages
//! contradict each other in every way. Other tests have shapes, contacts and joints with a known outcome.

use glam::{Quat, Vec3};
use rhumb_app::{
    AddJoint, AppOptions, ApplyForce, ApplyTorque, AttachShape, ConvexMesh, CreateDynamicActor,
    CreateStaticActor, DetachShape, Grip, HeightGrid, Id, Kind, Logon, Message, Motion, Surface,
    Surfacing, TriangleMesh,
};
use rhumb_tests::{Dice, PluginServer, PluginSession, plugin_world, seed};

const fn id(object: u32) -> Id {
    Id {
        simulation: 7,
        object,
    }
}

fn send(server: &mut PluginServer, session: &mut PluginSession, message: &Message) {
    send_with_index(server, session, 0, message);
}

/// Sends a message with an index.
fn send_with_index(
    server: &mut PluginServer,
    session: &mut PluginSession,
    index: u32,
    message: &Message,
) {
    let mut bytes = Vec::new();
    message.encode(index, &mut bytes);
    session.send(server, &bytes);
}

/// A server, and a client that has logged on and defined its world.
fn logged_on() -> (PluginServer, PluginSession) {
    let mut server = PluginServer::new(AppOptions::default());
    let mut logon = Vec::new();
    Message::Logon(Logon::new(7, "words")).encode(0, &mut logon);
    let mut session = PluginSession::begin(&mut server, 1, &logon);
    session.send(&mut server, &logon);
    let world = plugin_world(7, -5.0);
    send(&mut server, &mut session, &world);
    (server, session)
}

const FRAME: Message = Message::AdvanceTime((7, 0.089));

const STONE: Surface = Surface {
    density: 1_000.0,
    static_friction: 0.5,
    kinetic_friction: 0.5,
    restitution: 0.0,
};

/// Attaches the shape of an actor's number to it.
fn attach(object: u32) -> Message {
    Message::AttachShape(AttachShape {
        actor: id(object),
        shape: id(object),
        surface: STONE,
        rotation: Quat::IDENTITY,
        position: Vec3::ZERO,
    })
}

fn ball(server: &mut PluginServer, session: &mut PluginSession, object: u32, position: Vec3) {
    let motion = Motion {
        actor: id(object),
        position,
        rotation: Quat::IDENTITY,
        gravity_modifier: 1.0,
        linear: Vec3::ZERO,
        angular: Vec3::ZERO,
    };
    for message in [
        Message::AddSphere((id(object), Vec3::ZERO, 0.5)),
        Message::CreateDynamicActor(CreateDynamicActor { motion, flags: 1 }),
        attach(object),
    ] {
        send(server, session, &message);
    }
}

fn joint(joint: u32, first: Grip, second: Grip, free: Vec3) -> Message {
    Message::AddJoint(AddJoint {
        joint: id(joint),
        first,
        second,
        linear_lower: Vec3::ZERO,
        linear_upper: Vec3::ZERO,
        angular_lower: free,
        angular_upper: Vec3::ZERO,
    })
}

const fn grip(object: u32, anchor: Vec3) -> Grip {
    Grip {
        actor: id(object),
        rotation: Quat::IDENTITY,
        anchor,
    }
}

/// A static actor whose shape has the same number.
fn stand(server: &mut PluginServer, session: &mut PluginSession, object: u32, position: Vec3) {
    for message in [
        Message::CreateStaticActor(CreateStaticActor {
            actor: id(object),
            position,
            rotation: Quat::IDENTITY,
            flags: 0,
        }),
        attach(object),
    ] {
        send(server, session, &message);
    }
}

/// The corners of a box, from two opposite ones.
fn corners(least: Vec3, most: Vec3) -> Vec<Vec3> {
    let corner = |bits: u32| {
        let part = |axis: usize| [least, most][(bits >> axis & 1) as usize][axis];
        Vec3::new(part(0), part(1), part(2))
    };
    (0..8).map(corner).collect()
}

fn frames(server: &mut PluginServer, session: &mut PluginSession, count: usize) {
    for _ in 0..count {
        send(server, session, &FRAME);
    }
}

#[test]
fn falling_balls_come_to_rest_on_a_mesh_and_on_a_hull() {
    let (mut server, mut session) = logged_on();
    // A mesh of four metres whose actor is 3 m up, and a convex block whose top is 2 m above its actor.
    let sheet = TriangleMesh {
        shape: id(20),
        points: vec![
            Vec3::new(-2.0, -2.0, 0.0),
            Vec3::new(2.0, -2.0, 0.0),
            Vec3::new(2.0, 2.0, 0.0),
            Vec3::new(-2.0, 2.0, 0.0),
        ],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    };
    send(&mut server, &mut session, &Message::AddTriangleMesh(sheet));
    stand(&mut server, &mut session, 20, Vec3::new(0.0, 0.0, 3.0));
    let block = ConvexMesh {
        shape: id(21),
        points: corners(Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, 1.0, 2.0)),
    };
    send(&mut server, &mut session, &Message::AddConvexMesh(block));
    stand(&mut server, &mut session, 21, Vec3::new(10.0, 0.0, -1.0));
    ball(&mut server, &mut session, 10, Vec3::new(0.5, 0.25, 5.0));
    ball(&mut server, &mut session, 11, Vec3::new(10.2, 0.0, 3.0));
    // A hull may be off its origin: a cube of one metre whose actor is at a corner.
    let cube = ConvexMesh {
        shape: id(12),
        points: corners(Vec3::ZERO, Vec3::ONE),
    };
    send(&mut server, &mut session, &Message::AddConvexMesh(cube));
    let motion = Motion {
        actor: id(12),
        position: Vec3::new(-1.5, -1.5, 3.5),
        rotation: Quat::IDENTITY,
        gravity_modifier: 1.0,
        linear: Vec3::ZERO,
        angular: Vec3::ZERO,
    };
    for message in [
        Message::CreateDynamicActor(CreateDynamicActor { motion, flags: 0 }),
        Message::AttachShape(AttachShape {
            actor: id(12),
            shape: id(12),
            surface: STONE,
            rotation: Quat::IDENTITY,
            position: Vec3::ZERO,
        }),
    ] {
        send(&mut server, &mut session, &message);
    }
    frames(&mut server, &mut session, 30);
    assert_eq!(
        session.received(Kind::Error),
        0,
        "{:?}",
        session.tcp_messages
    );
    let last = session.last_states();
    for (actor, expected) in [
        (10, Vec3::new(0.5, 0.25, 3.5)),
        (11, Vec3::new(10.2, 0.0, 1.5)),
        (12, Vec3::new(-1.5, -1.5, 3.0)),
    ] {
        let off = last[&actor].position.distance(expected);
        assert!(off < 0.03, "{actor}: {:?}, not {expected}", last[&actor]);
    }
}

#[test]
fn each_collision_of_two_prims_is_reported_once() {
    let (mut server, mut session) = logged_on();
    let block = Message::AddBox((id(20), Vec3::new(4.0, 4.0, 2.0)));
    send(&mut server, &mut session, &block);
    stand(&mut server, &mut session, 20, Vec3::ZERO);
    let above = Vec3::new(0.0, 0.0, 3.0);
    ball(&mut server, &mut session, 10, above);
    for times in 1..=2 {
        frames(&mut server, &mut session, 20);
        let all = session
            .datagram_messages
            .iter()
            .chain(&session.tcp_messages);
        let reported: Vec<_> = all
            .filter_map(|message| match message {
                Message::ActorsCollided(contact) => Some(*contact),
                _ => None,
            })
            .collect();
        assert_eq!(reported.len(), times, "{reported:?}");
        let contact = reported[times - 1];
        assert_eq!((contact.colliding, contact.collided), (id(10), id(20)));
        assert!(contact.normal.z > 0.99, "{contact:?}");
        assert!(contact.point.distance(Vec3::Z) < 0.1, "{contact:?}");
        assert!(contact.separation.abs() < 0.1, "{contact:?}");
        // The ball is lifted again, and falls.
        let up = Message::UpdateActorPosition((id(10), above));
        send(&mut server, &mut session, &up);
    }
}

#[test]
fn joints_hold_actors_together_and_to_the_world() {
    let (mut server, mut session) = logged_on();
    ball(&mut server, &mut session, 10, Vec3::new(0.0, 0.0, 20.0));
    ball(&mut server, &mut session, 11, Vec3::new(2.0, 0.0, 20.0));
    // The first hangs from the world by a hinge about y, the second is joined to the first.
    let hinge = Vec3::new(0.0, 1.0, 0.0);
    let hung = joint(
        1,
        grip(10, Vec3::ZERO),
        grip(999, Vec3::new(0.0, 0.0, 20.0)),
        hinge,
    );
    let held = joint(
        2,
        grip(10, Vec3::new(2.0, 0.0, 0.0)),
        grip(11, Vec3::ZERO),
        Vec3::ZERO,
    );
    send(&mut server, &mut session, &hung);
    send(&mut server, &mut session, &held);
    for _ in 0..6 {
        send(&mut server, &mut session, &FRAME);
    }
    let last = session.last_states();
    let (first, second) = (last[&10].position, last[&11].position);
    assert!(first.distance(Vec3::new(0.0, 0.0, 20.0)) < 0.05, "{first}");
    assert!((second.distance(first) - 2.0).abs() < 0.05, "{second}");
    assert!(
        second.z < 19.0 && second.y.abs() < 0.05,
        "it swings: {second}"
    );
    send(&mut server, &mut session, &Message::RemoveJoint(id(1)));
    for _ in 0..6 {
        send(&mut server, &mut session, &FRAME);
    }
    let first = session.last_states()[&10].position;
    assert!(first.z < 19.0, "a body without a joint falls: {first}");
    assert_eq!(session.received(Kind::Error), 0);
}

#[test]
fn an_error_found_at_a_frame_names_the_last_message_about_the_object() {
    let (mut server, mut session) = logged_on();
    ball(&mut server, &mut session, 10, Vec3::new(0.0, 0.0, 20.0));
    let to_itself = joint(1, grip(10, Vec3::ZERO), grip(10, Vec3::X), Vec3::ZERO);
    send_with_index(&mut server, &mut session, 41, &to_itself);
    // The actor's position is valid, but its centre of mass is too far away.
    ball(&mut server, &mut session, 11, Vec3::new(1e5, 0.0, 0.0));
    let off_its_middle = Message::AttachShape(AttachShape {
        actor: id(11),
        shape: id(11),
        surface: STONE,
        rotation: Quat::IDENTITY,
        position: Vec3::new(10.0, 0.0, 0.0),
    });
    send_with_index(&mut server, &mut session, 42, &off_its_middle);
    send_with_index(&mut server, &mut session, 43, &FRAME);
    let named = session
        .tcp_messages
        .iter()
        .filter_map(|message| match message {
            Message::Error(fault) => Some(fault.index),
            _ => None,
        });
    assert_eq!(named.collect::<Vec<_>>(), [42, 41]);
    assert_eq!(session.received(Kind::TimeAdvanced), 1);
}

/// Random messages about a few objects.
struct RandomMessages(Dice);

impl RandomMessages {
    fn one_in(&mut self, count: usize) -> bool {
        self.0.below(count) == 0
    }

    fn number(&mut self, most: f32) -> f32 {
        if self.one_in(60) {
            let absurd = [f32::NAN, f32::INFINITY, 1e30, -1e9, 0.0, 1e-30, -0.0];
            return absurd[self.0.below(absurd.len())];
        }
        (self.0.below(2_001) as f32 / 1_000.0 - 1.0) * most
    }

    fn vector(&mut self, most: f32) -> Vec3 {
        Vec3::new(self.number(most), self.number(most), self.number(most))
    }

    fn rotation(&mut self) -> Quat {
        match self.0.below(4) {
            0 => Quat::from_xyzw(self.number(1.0), self.number(1.0), 0.0, self.number(1.0)),
            1 => Quat::from_rotation_x(self.0.below(6) as f32),
            _ => Quat::IDENTITY,
        }
    }

    fn object_id(&mut self) -> Id {
        id(self.0.below(6) as u32)
    }

    fn surface(&mut self) -> Surface {
        Surface {
            density: self.number(2_000.0),
            static_friction: self.number(1.0),
            kinetic_friction: self.number(1.0),
            restitution: self.number(1.0),
        }
    }

    fn grip(&mut self) -> Grip {
        Grip {
            actor: self.object_id(),
            rotation: self.rotation(),
            anchor: self.vector(1.0),
        }
    }

    fn shape(&mut self) -> Message {
        let shape = self.object_id();
        let points = (0..self.0.below(12)).map(|_| self.vector(2.0)).collect();
        match self.0.below(7) {
            0 => Message::AddSphere((shape, Vec3::ZERO, self.number(1.0).abs())),
            1 => Message::AddCapsule((shape, self.number(1.0).abs(), self.number(3.0).abs())),
            2 => Message::AddBox((shape, self.vector(2.0).abs())),
            3 => Message::AddConvexMesh(ConvexMesh { shape, points }),
            4 => Message::AddTriangleMesh(TriangleMesh {
                shape,
                triangles: (0..self.0.below(9))
                    .map(|_| [self.0.below(12) as u32; 3].map(|p| p + self.0.below(3) as u32))
                    .collect(),
                points,
            }),
            5 => Message::AddHeightField(HeightGrid {
                shape,
                rows: 4,
                columns: 3,
                row_spacing: self.number(2.0).abs(),
                column_spacing: 1.0,
                heights: (0..12).map(|_| self.number(2.0)).collect(),
            }),
            _ => Message::RemoveShape(shape),
        }
    }

    fn motion(&mut self) -> Motion {
        Motion {
            actor: self.object_id(),
            position: self.vector(5.0),
            rotation: self.rotation(),
            gravity_modifier: self.number(2.0),
            linear: self.vector(30.0),
            angular: self.vector(20.0),
        }
    }

    fn word(&mut self) -> Message {
        let (actor, shape) = (self.object_id(), self.object_id());
        match self.0.below(24) {
            0..=4 => self.shape(),
            5 => Message::CreateStaticActor(CreateStaticActor {
                actor,
                position: self.vector(5.0),
                rotation: self.rotation(),
                flags: 1,
            }),
            6..=8 => Message::CreateDynamicActor(CreateDynamicActor {
                motion: self.motion(),
                flags: 1,
            }),
            9 => Message::RemoveActor(actor),
            10..=13 => Message::AttachShape(AttachShape {
                actor,
                shape,
                surface: self.surface(),
                rotation: self.rotation(),
                position: self.vector(1.0),
            }),
            14 => Message::DetachShape(DetachShape { actor, shape }),
            15 => Message::UpdateShapeMaterial(Surfacing {
                actor,
                shape,
                surface: self.surface(),
            }),
            16 => Message::AddJoint(AddJoint {
                joint: shape,
                first: self.grip(),
                second: self.grip(),
                linear_lower: Vec3::splat(self.0.below(2) as f32),
                linear_upper: Vec3::ZERO,
                angular_lower: Vec3::new(0.0, self.0.below(2) as f32, 0.0),
                angular_upper: Vec3::ZERO,
            }),
            17 => Message::RemoveJoint(shape),
            18 => Message::SetDynamicActor(self.motion()),
            19 => Message::UpdateLinearVelocity((actor, self.vector(50.0))),
            20 => Message::UpdateGravityModifier((actor, self.number(1.0))),
            21 => Message::ApplyForce(ApplyForce {
                actor,
                force: self.vector(1e5),
            }),
            22 => Message::ApplyTorque(ApplyTorque {
                actor,
                torque: self.vector(1e4),
            }),
            _ => Message::GetMass(actor),
        }
    }
}

#[test]
fn any_message_leaves_the_scene_running_with_finite_states() {
    let first = seed(0x0a99);
    for round in 0..120 {
        let mut babble = RandomMessages(Dice::new(first + round));
        let (mut server, mut session) = logged_on();
        let mut frames = 0;
        for _ in 0..150 {
            let word = babble.word();
            send(&mut server, &mut session, &word);
            if babble.one_in(4) {
                send(&mut server, &mut session, &FRAME);
                frames += 1;
            }
            assert!(
                !session.closed,
                "seed {}: closed after {word:?}",
                first + round
            );
        }
        assert_eq!(session.received(Kind::TimeAdvanced), frames);
        for state in session.last_states().values() {
            let finite = state.position.is_finite() && state.linear.is_finite();
            assert!(finite && state.rotation.is_normalized(), "{state:?}");
        }
        send(&mut server, &mut session, &Message::Logoff(7));
        assert!(session.closed && !server.has_scene(7));
    }
}
