//! The upstreams of the vectors, replayed to a server's end.

use std::collections::BTreeMap;

use rhumb_protocol::message::{ClientMessage, Frames, ServerMessage, TakeAuthority};
use rhumb_protocol::packet::{Datagram, LargestPacket};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, Shape, ShapeId};
use rhumb_protocol::session::UpstreamReceiver;
use rhumb_protocol::stream::PredictionParameters;
use rhumb_reckoning::{BodyId, Damping, Integrator, Motion, Rate, Tick, Tolerance};
use serde_json::{Value, json};

use crate::fnv::Fnv;
use crate::grammar::unhex;

/// The state of the server's end of an upstream at each step of its events.
///
/// # Panics
///
/// When the events do not begin with a grant, or one of them is malformed.
#[must_use]
pub fn upstream_states(events: &[Value]) -> Vec<Value> {
    let [grant, events @ ..] = events else {
        panic!("an upstream begins with its grant");
    };
    let mut receiver = receiver_of(&bytes_of(grant));
    // A packet on the other lane is dropped (PROTOCOL 6.14-9).
    let lockstep = grant[2] == "lockstep";
    let (mut frames, mut states) = (Frames::new(), Vec::new());
    let mut placed = BTreeMap::new();
    for event in events {
        match event[0].as_str() {
            Some("datagram") if !lockstep => receive(&mut receiver, &bytes_of(event)),
            Some("control") => {
                frames.push(&bytes_of(event));
                while let Some(packet) = packet_of(&mut frames) {
                    if lockstep {
                        receive(&mut receiver, &packet);
                    }
                }
            }
            Some("step") => {
                let tick = Tick::new(event[1].as_u64().expect("a tick"));
                states.push(state(&mut receiver, tick, &mut placed));
            }
            _ => {}
        }
    }
    states
}

fn receive(receiver: &mut UpstreamReceiver, bytes: &[u8]) {
    receiver.handle_datagram(&Datagram::open(bytes).expect("a head"));
}

/// The packet of the next message of the client, which is an `Upstream`.
fn packet_of(frames: &mut Frames) -> Option<Vec<u8>> {
    let framed = frames.next_frame().expect("frames")?;
    match ClientMessage::decode(&framed) {
        Ok(Some(ClientMessage::Upstream(packet))) => Some(packet),
        other => panic!("an upstream has no such message: {other:?}"),
    }
}

/// The state in the step to a tick, which leaves the poses of the bodies in `placed`.
fn state(
    receiver: &mut UpstreamReceiver,
    tick: Tick,
    placed: &mut BTreeMap<BodyId, Motion>,
) -> Value {
    let motions = receiver.motions(tick).map(|(id, motion)| {
        let mut digest = Fnv::START;
        digest.fold_motion(&held(id, motion, placed));
        format!("{:016x}", digest.value())
    });
    let motions: Vec<_> = motions.collect();
    json!({
        "watermark": receiver.watermark_tick().value(),
        "lost touch": receiver.has_lost_sync(),
        "bodies": motions,
    })
}

/// The motion that a body gets: one whose pose a command may not set leaves it where it was, and still (PROTOCOL 6.14-13).
fn held(id: BodyId, motion: Motion, placed: &mut BTreeMap<BodyId, Motion>) -> Motion {
    let pose = motion.pose();
    let command = Command::SetPose {
        id,
        position: pose.position.as_vec3(),
        rotation: pose.rotation.as_quat(),
    };
    if command.check().is_ok() {
        placed.insert(id, motion);
    }
    match placed.get(&id) {
        Some(last) if command.check().is_err() => last.stilled(),
        _ => motion,
    }
}

/// The receiver of a granted upstream of kinematic balls of half a metre.
fn receiver_of(grant: &[u8]) -> UpstreamReceiver {
    let mut frames = Frames::new();
    frames.push(grant);
    let framed = frames.next_frame().expect("a frame").expect("a whole one");
    let Ok(Some(ServerMessage::AuthorityGrant(grant))) = ServerMessage::decode(&framed) else {
        panic!("an upstream begins with its grant");
    };
    let request = TakeAuthority {
        tolerance: Tolerance::from_micrometres(5_000).expect("within range"),
        largest_packet: LargestPacket::GREATEST,
        bodies: grant.bodies.iter().map(|(id, _)| *id).collect(),
    };
    let integrator = Integrator {
        rate: Rate::HZ_60,
        substeps: 4.try_into().expect("not zero"),
    };
    let ball = Shape::Ball { radius: 0.5 };
    UpstreamReceiver::new(&grant, &request, integrator, |id| {
        let desc = BodyDesc::plain(id, BodyKind::Kinematic, ShapeId(0));
        let damping = Damping::default();
        Some(PredictionParameters::of(&desc, &ball, damping, None))
    })
}

/// The bytes of an event.
fn bytes_of(event: &Value) -> Vec<u8> {
    unhex(event[1].as_str().expect("digits"))
}
