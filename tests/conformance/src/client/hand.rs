//! Messages that a raw server sends to admit a client to a scene of one ball.
//!
//! Expected results come from a session of this project that receives the same messages.

use glam::Vec3;
use rhumb_protocol::message::{
    ClientMessage, Extensions, Joined, SceneEvent, ServerMessage, StreamChoice, Welcome,
};
use rhumb_protocol::packet::{
    Head, LargestPacket, LossReport, Low16, PacketKind, StreamId, Watermark,
};
use rhumb_protocol::scene::{BodyDesc, BodyKind, IdRange, SceneConfig, Shape, ShapeId};
use rhumb_protocol::stream::StreamStart;
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_reckoning::{
    Anchor, BodyId, BodyState, Integrator, LengthBound, PackedRotation, Predictor, QuantisedState,
    Rate, Tick, Tolerance, Track,
};

use crate::outcome::{CaseResult, Stop};
use crate::peer::RawServer;

/// The stream id of the raw server.
pub(super) const STREAM: StreamId = StreamId(5);
/// The number of the first packet.
pub(super) const NEXT: u64 = 100;
/// The tick of its snapshot.
pub(super) const TICK: u64 = 1_000;
/// Number of scene events included in the snapshot.
pub(super) const SCENE_EVENTS: u64 = 10;
/// The ball.
pub(super) const BALL: BodyId = BodyId::new(3, 0);
/// The ball's shape.
pub(super) const SHAPE: ShapeId = ShapeId(1);

/// A lockstep scene at sixty ticks a second.
pub(super) fn config() -> SceneConfig {
    SceneConfig {
        integrator: Integrator {
            rate: Rate::HZ_60,
            substeps: core::num::NonZeroU32::MIN,
        },
        gravity: Vec3::new(0.0, -9.81, 0.0),
        ..SceneConfig::default()
    }
}

/// A welcome to a scene that exists.
pub(super) fn welcome() -> Welcome {
    Welcome {
        version: 1,
        scene: Some(config()),
        extensions: Extensions::NONE,
    }
}

/// A `Joined` with the start of the stream.
pub(super) fn joined() -> Joined {
    let length =
        LengthBound::from_micrometres(10_000).expect("one centimetre is a valid tolerance");
    let tolerance = Tolerance::Surface(length);
    Joined {
        choice: StreamChoice::Within(tolerance),
        config: config(),
        start: StreamStart {
            stream: STREAM,
            tolerance,
            integrator: config().integrator,
            publish_interval: core::num::NonZeroU32::MIN,
            largest_packet: LargestPacket::DEFAULT,
            gravity: config().gravity,
            tick: Tick::new(TICK),
            next: NEXT,
            scene_events: SCENE_EVENTS,
        },
        granted: IdRange::EMPTY,
        extensions: Extensions::NONE,
    }
}

/// The ball's shape.
pub(super) fn shape() -> SceneEvent {
    SceneEvent::ShapeAdded {
        id: SHAPE,
        shape: Shape::Ball { radius: 0.5 },
    }
}

/// A moving ball with this predictor.
pub(super) fn ball(id: BodyId, predictor: Predictor) -> SceneEvent {
    let moves = predictor != Predictor::Rest;
    let linear = if moves { [1.0, 2.0, -3.0] } else { [0.0; 3] };
    let angular = if moves { [0.5, 0.0, 1.0] } else { [0.0; 3] };
    let place = [id.index() as f32, 10.0, 0.0];
    let body_state = BodyState::new(place, [0.0, 0.0, 0.0, 1.0], linear, angular);
    let on_its_grid = QuantisedState {
        position: [id.index() as i32, 10, 0],
        rotation: PackedRotation::from_parts(3, [0; 3]).expect("the identity is a valid rotation"),
        linear: [1, 2, -3],
        angular: [5, 0, 10],
    };
    let anchor = match predictor.acceleration() {
        Some(_) => Anchor::Quantised(on_its_grid),
        None => Anchor::Exact(body_state.expect("a finite body state")),
    };
    SceneEvent::BodyPlaced {
        desc: BodyDesc::plain(id, BodyKind::Dynamic, SHAPE),
        inertia: None,
        track: Track {
            origin: Tick::new(TICK - 1),
            predictor,
            anchor,
            parent: None,
        },
        alias: None,
    }
}

/// The name of a body in a client's reports.
pub(super) fn name(id: BodyId) -> String {
    format!("{}:{}", id.index(), id.generation())
}

/// Receives the client's hello and sends the welcome.
pub(super) fn welcomed(server: &mut RawServer) -> CaseResult {
    server.await_message("hello", |message| {
        matches!(message, ClientMessage::Hello { .. }).then_some(())
    })?;
    server.send(&ServerMessage::Welcome(welcome()));
    Ok(())
}

/// Sends the welcome, and waits for the client's `Join`.
pub(super) fn awaits_join(server: &mut RawServer) -> CaseResult {
    welcomed(server)?;
    server.await_message("join", |message| {
        matches!(message, ClientMessage::Join(_)).then_some(())
    })
}

/// Makes the client a member of a scene of one ball.
pub(super) fn admit(server: &mut RawServer) -> CaseResult {
    awaits_join(server)?;
    snapshot(server, &[shape(), ball(BALL, Predictor::Ballistic)]);
    reported(server, "joined").map(drop)
}

/// Sends a snapshot with these scene events.
pub(super) fn snapshot(server: &mut RawServer, scene_events: &[SceneEvent]) {
    server.send(&ServerMessage::Joined(joined()));
    for scene_event in scene_events {
        server.send(&ServerMessage::SceneEvent(scene_event.clone()));
    }
    server.send(&ServerMessage::SnapshotEnd);
}

/// Waits for the next report of this kind.
pub(super) fn reported(server: &mut RawServer, is: &str) -> Result<serde_json::Value, Stop> {
    loop {
        server.must_be_supported()?;
        match server.next_line()? {
            Some(line) if line["is"] == is => return Ok(line),
            Some(_) => {}
            None => return Stop::fail(format!("the client does not report {is:?}")),
        }
    }
}

/// Waits for the client's report of this tick.
pub(super) fn reported_tick(server: &mut RawServer, tick: u64) -> Result<serde_json::Value, Stop> {
    loop {
        let reported = reported(server, "tick")?;
        if reported["tick"] == tick {
            return Ok(reported);
        }
    }
}

/// Sends a watermark for a tick; `next` is the number of the next packet.
pub(super) fn watermark(
    server: &mut RawServer,
    next: u64,
    tick: u64,
    scene_events: u64,
) -> CaseResult {
    let watermark = Watermark {
        next: Low16::of(next),
        tick: Low16::of(tick),
        scene_events: Low16::of(scene_events),
    };
    server.send_datagram(&watermark.encode(STREAM))
}

/// Waits for the client's next loss report.
pub(super) fn loss_report(server: &mut RawServer) -> Result<LossReport, Stop> {
    loop {
        let Some(bytes) = server.next_datagram()? else {
            return Stop::fail("the client sends no loss report");
        };
        let mut reader = Reader::new(&bytes);
        let head = Head::decode(&mut reader);
        let head = head.map_err(|why| Stop::Fail(format!("its datagram is malformed: {why:?}")))?;
        if head.kind == PacketKind::LossReport {
            if head.stream != STREAM {
                return Stop::fail(format!(
                    "its loss report is for {}, which is not its stream",
                    head.stream
                ));
            }
            let loss_report = LossReport::decode(reader);
            return loss_report
                .map_err(|why| Stop::Fail(format!("its loss report is malformed: {why:?}")));
        }
    }
}

/// Requires that the client still responds: it must report a packet that it is shown to have missed, the one before
/// `next`.
pub(super) fn must_go_on(
    server: &mut RawServer,
    next: u64,
    tick: u64,
    scene_events: u64,
) -> CaseResult {
    let wanted = Low16::of(next - 1);
    let mut asked = Vec::new();
    // After many datagrams this one may be lost too, so it is sent up to three times.
    for _ in 0..3 {
        watermark(server, next, tick, scene_events)?;
        asked = loss_report(server)?.lost;
        if asked.contains(&wanted) {
            return Ok(());
        }
    }
    Stop::fail(format!("it reports {asked:?} as lost, not {wanted:?}"))
}
