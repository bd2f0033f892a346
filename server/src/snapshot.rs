//! What a member hears of a scene at once, when it joins.
//!
//! Bytes only; who hears them is the room's matter.

use rhumb_protocol::message::{Notice, ServerMessage};

use crate::placing;
use crate::scene::Scene;
use crate::streams::Stream;

/// Every shape, change of gravity, body and joint, and the end (PROTOCOL 4.8).
pub(crate) fn snapshot(scene: &Scene, stream: &Stream) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut tell = |notice| ServerMessage::Notice(notice).encode(&mut bytes);
    for (id, shape) in scene.shapes() {
        let shape = shape.clone();
        tell(Notice::ShapeAdded { id, shape });
    }
    // A track goes on under the gravity that it was said under.
    for (since, gravity) in stream.gravity_changes() {
        tell(Notice::GravityChanged { since, gravity });
    }
    for (id, track) in stream.tracks() {
        if let Some(terms) = scene.body(id) {
            tell(placing::notice(scene, *terms, track, stream.seat(id)));
        }
    }
    for (id, joint) in scene.joints().iter() {
        let joint = *joint;
        tell(Notice::JointAdded { id, joint });
    }
    ServerMessage::SnapshotEnd.encode(&mut bytes);
    bytes
}
