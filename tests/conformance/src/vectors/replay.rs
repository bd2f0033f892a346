//! Golden streams replayed to a session.

use bytes::Bytes;
use rhumb_protocol::limits::LOST_NUMBERS_MAX;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::session::{ClientSession, Replica};
use rhumb_protocol::stream::ErrorBound;
use rhumb_protocol::{Endpoint, Instant, Peer};
use rhumb_reckoning::{BodyId, Tick};
use serde_json::{Value, json};

use crate::fnv::Fnv;
use crate::grammar::unhex;

/// The server, as each session names it.
const SERVER: Peer = Peer(0);

/// The state of a member, in the form of the vectors.
#[must_use]
pub fn known(replica: &Replica) -> Value {
    let stream = replica.stream();
    let mut known = json!({
        "watermark": stream.watermark_tick().value(),
        "complete": stream.complete().value(),
        "converged": stream.is_converged(),
        "next": stream.loss_report().next.0,
        "missing": stream.missing(),
        "checksum": format!("{:016x}", stream.state_checksum()),
    });
    // The prediction of a body is not specified while something is missing (PROTOCOL 6.8).
    if stream.is_converged() {
        known["poses"] = json!(format!("{:016x}", poses(replica)));
    }
    if matches!(replica.choice(), StreamChoice::Capped { .. }) {
        // Error scales are multiples of one eighth.
        let error_scale = stream.error_scale_at(stream.watermark_tick());
        known["error_scale_eighths"] = json!(error_scale.map(|factor| (factor * 8.0) as u64));
    }
    known
}

/// The state of a member, with all that another end or an application can observe: the form of scripted streams.
#[must_use]
pub(crate) fn known_in_full(replica: &Replica) -> Value {
    let stream = replica.stream();
    let mut known = known(replica);
    let watermark = stream.watermark_tick();
    let lost = stream.missing_packets().take(LOST_NUMBERS_MAX);
    known["lost"] = lost.map(|number| number as u16).collect();
    known["abandoned"] = json!(stream.lost() as u16);
    let report = stream.loss_report();
    let named: Vec<_> = report.lost.iter().map(|number| number.0).collect();
    known["requests"] = json!([report.repair_symbols, named]);
    let joints = replica.joints().iter().map(|(id, _)| id.0);
    known["joints"] = joints.collect();
    known["resync"] = json!(
        stream
            .has_lost_sync()
            .then(|| u8::from(stream.has_mismatched()))
    );
    if matches!(replica.choice(), StreamChoice::Capped { .. }) {
        let scales = recent(watermark, 6).map(|tick| stream.error_scale_at(tick));
        known["error_scales"] = scales
            .map(|factor| factor.map(|factor| (factor * 8.0) as u64))
            .collect();
    }
    let rows = replica.bodies().map(|desc| body_row(replica, desc.id));
    known["bodies"] = rows.collect();
    known
}

/// The tick after one, that one, and some before it, newest first.
fn recent(tick: Tick, count: u64) -> impl Iterator<Item = Tick> {
    let ticks = (tick.value() + 1).saturating_sub(count)..=tick.value() + 1;
    ticks.rev().map(Tick::new)
}

/// Index, generation, origin, the ticks about the watermark at which the error is known, and the motions at these.
fn body_row(replica: &Replica, id: BodyId) -> Value {
    let stream = replica.stream();
    let origin = stream.track(id).map(|track| track.origin.value());
    let (mut ticks, mut motions) = (Vec::new(), Fnv::START);
    for tick in recent(stream.watermark_tick(), 4) {
        if matches!(stream.bound_at(id, tick), Some(ErrorBound::Within(_)))
            && let Some(motion) = stream.predicted_motion(id, tick)
        {
            ticks.push(tick.value());
            motions.fold_motion(&motion);
        }
    }
    let motions = format!("{:016x}", motions.value());
    json!([id.index(), id.generation(), origin, ticks, motions])
}

/// True if an actual state has what an expected one states; the actual one may have more words.
#[must_use]
pub fn agrees(expected: &Value, actual: &Value) -> bool {
    let words = expected.as_object().into_iter().flatten();
    words
        .into_iter()
        .all(|(word, value)| actual.get(word) == Some(value))
}

/// FNV-1a over the bits of each body's predicted motion at the watermark, in order of index.
fn poses(replica: &Replica) -> u64 {
    let stream = replica.stream();
    let mut digest = Fnv::START;
    for desc in replica.bodies() {
        if let Some(motion) = stream.predicted_motion(desc.id, stream.watermark_tick()) {
            digest.fold_motion(&motion);
        }
    }
    digest.value()
}

/// A session that waits for its server's first message.
///
/// # Panics
///
/// Never: the name of its scene is valid.
#[must_use]
pub fn greeted() -> ClientSession {
    let mut session = ClientSession::new("golden".parse().expect("a valid scene name"));
    session.handle_opened(Instant::ZERO, SERVER);
    session
}

/// Delivers an event of a stream to a session.
///
/// # Panics
///
/// When the event is malformed.
pub fn deliver(session: &mut ClientSession, event: &Value) {
    let bytes = || Bytes::from(unhex(event[1].as_str().expect("digits")));
    match event[0].as_str() {
        Some("control") => session.handle_control(Instant::ZERO, SERVER, &bytes()),
        Some("datagram") => session.handle_datagram(Instant::ZERO, SERVER, &bytes()),
        _ => {}
    }
}

/// Delivers the data of a stream's member to a session; returns for each recorded state its index, the expected and
/// the actual state.
///
/// # Panics
///
/// When an event is malformed.
#[must_use]
pub fn replayed(events: &[Value]) -> Vec<(usize, Value, Value)> {
    let mut session = greeted();
    let mut states = Vec::new();
    for (place, event) in events.iter().enumerate() {
        deliver(&mut session, event);
        if event[0] == "known" {
            let replica = session.replica().expect("a member");
            states.push((place, event[1].clone(), known_in_full(replica)));
        }
    }
    states
}
