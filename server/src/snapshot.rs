//! Snapshot of a scene for a joining member.
//!
//! Encodes only; the scene runner sends it.

use rhumb_protocol::message::{SceneEvent, ServerMessage};

use crate::body_placement;
use crate::scene::Scene;
use crate::streams::Stream;

/// Every shape, change of gravity, body and joint, and the end (PROTOCOL 4.8).
pub(crate) fn snapshot(scene: &Scene, stream: &Stream) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut add = |scene_event| ServerMessage::SceneEvent(scene_event).encode(&mut bytes);
    for (id, shape) in scene.shapes() {
        let shape = shape.clone();
        add(SceneEvent::ShapeAdded { id, shape });
    }
    // A track continues under the gravity of its time.
    for (since, gravity) in stream.gravity_changes() {
        add(SceneEvent::GravityChanged { since, gravity });
    }
    for (id, track) in stream.sender.tracks() {
        if let Some(config) = scene.body(id) {
            add(body_placement::scene_event(
                scene,
                *config,
                track,
                stream.alias(id),
            ));
        }
    }
    for (id, joint) in scene.joints().iter() {
        let joint = *joint;
        add(SceneEvent::JointAdded { id, joint });
    }
    ServerMessage::SnapshotEnd.encode(&mut bytes);
    bytes
}
