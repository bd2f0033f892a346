//! The state of a copy as digits, for comparison with another client.
//!
//! The words are those of `spec/vectors/README.md`.

use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::session::Replica;
use serde_json::{Value, json};

/// The state of a copy: equal for every implementation that has read the same bytes.
pub(crate) fn digest(replica: &Replica) -> Value {
    let stream = replica.stream();
    let watermark = stream.watermark_tick();
    let mut json = json!({
        "watermark": watermark.value(),
        "complete": stream.complete().value(),
        "converged": stream.is_converged(),
        "next": stream.loss_report().next.0,
        "missing": stream.missing(),
        "checksum": format!("{:016x}", stream.state_checksum()),
    });
    // The prediction of a body is not specified while something is missing (PROTOCOL 6.8). Before the origin of a body's
    // newest track, and while bodies come and go between two ticks of a view, it depends on what a view needs, so that
    // clients differ.
    let is_begun = |id| {
        let track = stream.track(id);
        track.is_some_and(|track| track.origin <= watermark)
    };
    if stream.is_converged()
        && !stream.is_changing()
        && replica.bodies().all(|desc| is_begun(desc.id))
    {
        json["poses"] = json!(format!("{:016x}", poses(replica)));
    }
    if matches!(replica.choice(), StreamChoice::Capped { .. }) {
        // Error scales are multiples of one eighth.
        let scale = stream.error_scale_at(watermark);
        json["error_scale_eighths"] = json!(scale.map(|factor| (factor * 8.0) as u64));
    }
    json
}

/// FNV-1a over the doubles of each body's predicted motion at the watermark, in order of index.
fn poses(replica: &Replica) -> u64 {
    let stream = replica.stream();
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for desc in replica.bodies() {
        let Some(motion) = stream.predicted_motion(desc.id, stream.watermark_tick()) else {
            continue;
        };
        for byte in motion.parts().into_iter().flat_map(f64::to_le_bytes) {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
    hash
}
