//! Snapshot of a scene for a joining member.
//!
//! Encodes only; the scene runner sends it.

use rhumb_protocol::message::{SceneEvent, ServerMessage};

use crate::body_placement;
use crate::scene::Scene;
use crate::streams::Stream;

/// Appends the snapshot from its changes of gravity on: bodies, joints, silent publishers, and the end (PROTOCOL 4.8). Its shapes go
/// before, in the bytes of their events.
pub(crate) fn append_snapshot(
    scene: &Scene,
    stream: &Stream,
    silences: impl Iterator<Item = SceneEvent>,
    bytes: &mut Vec<u8>,
) {
    let mut add = |scene_event| ServerMessage::SceneEvent(scene_event).encode(bytes);
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
    silences.for_each(add);
    ServerMessage::SnapshotEnd.encode(bytes);
}
