//! Fuzzers of the paper's protocol: arbitrary bytes, and arbitrary messages.
//!
//! Promises: messages are decoded the same however the bytes are split. A decoded message is encoded as it was, except
//! for parts that the protocol does not fix. A scene continues and sends finite states for all bytes of its
//! client, and ends with it.

use glam::{Quat, Vec3};
use rhumb_app::{
    AddJoint, AppOptions, ApplyForce, ApplyTorque, AttachShape, ConvexMesh, CreateDynamicActor,
    CreateStaticActor, DetachShape, FramedMessage, Grip, HEADER_BYTES, HeightGrid, Id, Kind, Logon,
    MalformedMessage, Message, MessageFraming, Motion, Place, SetWorld, Surface, Surfacing,
    TriangleMesh,
};

use super::script::Script;
use crate::{PluginServer, PluginSession};

/// Number of actions of one script, so that it ends soon.
const ACTS_MAX: usize = 80;

/// Arbitrary bytes; the first selects how the rest is split.
pub fn app_messages(data: &[u8]) {
    let Some((cut, stream)) = data.split_first() else {
        return;
    };
    let whole = read(stream, stream.len().max(1));
    let pieces = read(stream, usize::from(*cut).max(1));
    // NaNs are not equal, but their text is.
    assert_eq!(format!("{whole:?}"), format!("{pieces:?}"));
    for framed in &whole.0 {
        let mut written = Vec::new();
        framed.message.encode(framed.index, &mut written);
        let again = Message::from_datagram(&written).expect("bytes that were just encoded");
        assert_eq!(format!("{again:?}"), format!("{:?}", framed.message));
    }
    check_body(stream);
    let _ = Message::from_datagram(stream);
}

/// The body of a message whose type is in the first two bytes: if it decodes, it is encoded as it was.
fn check_body(bytes: &[u8]) {
    let Some((code, body)) = bytes.split_first_chunk::<2>() else {
        return;
    };
    let place = usize::from(u16::from_be_bytes(*code));
    let kind = Kind::ALL[place % Kind::ALL.len()];
    if let Ok(message) = Message::decode(kind, body) {
        let mut written = Vec::new();
        message.encode(0, &mut written);
        // A long text is truncated when it is encoded.
        if !matches!(message, Message::Error(_)) {
            assert_eq!(&written[HEADER_BYTES..], body, "{message:?}");
        }
    }
}

fn read(stream: &[u8], piece: usize) -> (Vec<FramedMessage>, Option<MalformedMessage>) {
    let (mut frames, mut all) = (MessageFraming::default(), Vec::new());
    for bytes in stream.chunks(piece) {
        frames.push(bytes);
        loop {
            match frames.next_message() {
                Ok(Some(framed)) => all.push(framed),
                Ok(None) => break,
                Err(malformed) => return (all, Some(malformed)),
            }
        }
    }
    (all, None)
}

/// A script of messages, frames and bytes.
pub fn app_scene(data: &[u8]) {
    let mut script = Script::new(data);
    let mut server = PluginServer::new(AppOptions::default());
    let mut logon = Vec::new();
    Message::Logon(Logon::new(7, "words")).encode(0, &mut logon);
    let mut session = PluginSession::begin(&mut server, 1, &logon);
    session.send(&mut server, &logon);
    send(&mut server, &mut session, &world(&mut script));
    // Raw bytes may begin a message that later bytes complete.
    let (mut frames, mut bare) = (0, false);
    for _ in 0..ACTS_MAX {
        if !script.goes_on() || session.closed {
            break;
        }
        match script.below(16) {
            0..4 => {
                let seconds = script.one_of(&[0.089, 0.0167, 0.5]);
                send(
                    &mut server,
                    &mut session,
                    &Message::AdvanceTime((7, seconds)),
                );
                frames += 1;
            }
            4 if script.below(4) == 0 => {
                bare = true;
                session.send(&mut server, script.bytes(60));
            }
            _ => {
                let message = message(&mut script);
                send(&mut server, &mut session, &message);
            }
        }
    }
    for state in session.last_states().values() {
        let finite = state.position.is_finite() && state.linear.is_finite();
        let is_state = finite && state.angular.is_finite() && state.rotation.is_normalized();
        assert!(is_state, "{state:?}");
    }
    if !session.closed {
        assert_eq!(
            session.received(Kind::TimeAdvanced),
            frames,
            "the scene continues"
        );
        send(&mut server, &mut session, &Message::Logoff(7));
        assert!(
            session.closed || bare,
            "a client that logs off is disconnected"
        );
    }
    let ended = !server.has_scene(7);
    assert!(ended || !session.closed, "a scene ends with its client");
}

fn send(server: &mut PluginServer, session: &mut PluginSession, message: &Message) {
    let mut bytes = Vec::new();
    message.encode(0, &mut bytes);
    session.send(server, &bytes);
}

fn id(script: &mut Script<'_>) -> Id {
    Id {
        simulation: 7,
        object: script.below(6) as u32,
    }
}

fn world(script: &mut Script<'_>) -> Message {
    let height = script.number(5.0);
    Message::SetWorld(SetWorld {
        plane: id(script),
        gravity: script.vector(20.0),
        static_friction: 0.5,
        kinetic_friction: 0.5,
        restitution: 0.0,
        margin: 0.0,
        height,
        normal: if script.any() {
            Vec3::Z
        } else {
            script.vector(1.0)
        },
    })
}

fn surface(script: &mut Script<'_>) -> Surface {
    Surface {
        density: script.number(2e3),
        static_friction: script.number(1.0),
        kinetic_friction: script.number(1.0),
        restitution: script.number(1.0),
    }
}

fn grip(script: &mut Script<'_>) -> Grip {
    Grip {
        actor: id(script),
        rotation: script.rotation(),
        anchor: script.vector(1.0),
    }
}

fn motion(script: &mut Script<'_>) -> Motion {
    Motion {
        actor: id(script),
        position: script.vector(5.0),
        rotation: script.rotation(),
        gravity_modifier: script.number(2.0),
        linear: script.vector(30.0),
        angular: script.vector(20.0),
    }
}

fn shape(script: &mut Script<'_>) -> Message {
    let shape = id(script);
    match script.below(8) {
        0 => Message::AddSphere((shape, script.vector(1.0), script.number(1.0).abs())),
        1 => Message::AddCapsule((shape, script.number(1.0).abs(), script.number(3.0).abs())),
        2 => Message::AddBox((shape, script.vector(2.0).abs())),
        3 => {
            let points = points(script);
            Message::AddConvexMesh(ConvexMesh { shape, points })
        }
        4 => {
            let points = points(script);
            let mut corner = || script.below(points.len() + 2) as u32;
            let triangles = (0..6).map(|_| [corner(), corner(), corner()]).collect();
            Message::AddTriangleMesh(TriangleMesh {
                shape,
                points,
                triangles,
            })
        }
        5 => Message::AddHeightField(HeightGrid {
            shape,
            rows: 3,
            columns: 3,
            row_spacing: script.number(2.0).abs(),
            column_spacing: script.number(2.0).abs(),
            heights: (0..9).map(|_| script.number(2.0)).collect(),
        }),
        6 => Message::AddPlane((shape, script.number(1.0), script.vector(1.0))),
        _ => Message::RemoveShape(shape),
    }
}

fn points(script: &mut Script<'_>) -> Vec<Vec3> {
    (0..script.below(12)).map(|_| script.vector(2.0)).collect()
}

fn message(script: &mut Script<'_>) -> Message {
    let actor = id(script);
    match script.below(24) {
        0..4 => shape(script),
        4 => Message::CreateStaticActor(CreateStaticActor {
            actor,
            position: script.vector(5.0),
            rotation: script.rotation(),
            flags: script.any(),
        }),
        5..8 => Message::CreateDynamicActor(CreateDynamicActor {
            motion: motion(script),
            flags: script.any(),
        }),
        8 => Message::RemoveActor(actor),
        9..12 => Message::AttachShape(AttachShape {
            actor,
            shape: id(script),
            surface: surface(script),
            rotation: script.rotation(),
            position: script.vector(1.0),
        }),
        12 => Message::DetachShape(DetachShape {
            actor,
            shape: id(script),
        }),
        13 => Message::UpdateShapeMaterial(Surfacing {
            actor,
            shape: id(script),
            surface: surface(script),
        }),
        14 => Message::AddJoint(AddJoint {
            joint: actor,
            first: grip(script),
            second: grip(script),
            linear_lower: script.vector(1.0),
            linear_upper: script.vector(1.0),
            angular_lower: script.vector(1.0),
            angular_upper: script.vector(1.0),
        }),
        15 => Message::RemoveJoint(actor),
        16 => Message::SetDynamicActor(motion(script)),
        17 => Message::UpdateLinearVelocity((actor, script.vector(50.0))),
        18 => Message::UpdateGravityModifier((actor, script.number(1.0))),
        19 => Message::ApplyForce(ApplyForce {
            actor,
            force: script.vector(1e5),
        }),
        20 => Message::ApplyTorque(ApplyTorque {
            actor,
            torque: script.vector(1e4),
        }),
        21 => Message::SetStaticActor(Place {
            actor,
            position: script.vector(5.0),
            rotation: script.rotation(),
        }),
        22 => Message::UpdateActorOrientation((actor, Quat::from_rotation_x(script.sane(3.0)))),
        _ => Message::GetMass(actor),
    }
}
