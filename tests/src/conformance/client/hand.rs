//! What a server made of bytes says to let a client in: a scene of one ball.
//!
//! Its truth is a session of this house that hears the same.

use glam::Vec3;
use rhumb_protocol::message::{
    ClientMessage, Extensions, Joined, SceneEvent, ServerMessage, StreamChoice, Welcome,
};
use rhumb_protocol::packet::{Head, LossReport, Low16, PacketKind, StreamId, Watermark};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, IdRange, Material, PublishSchedule, SceneConfig, Shape, ShapeId, Stepping,
};
use rhumb_protocol::stream::StreamStart;
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_reckoning::{
    Anchor, BodyId, BodyState, Damping, Integrator, LengthBound, PackedRotation, Predictor,
    QuantisedState, Rate, Tick, Tolerance, Track,
};

use crate::conformance::outcome::{CaseResult, Stop};
use crate::conformance::peer::Host;

/// The stream of a server made of bytes.
pub(super) const STREAM: StreamId = StreamId(5);
/// Its first packet's number.
pub(super) const NEXT: u64 = 100;
/// The tick of its snapshot.
pub(super) const TICK: u64 = 1_000;
/// SceneEvents that the snapshot includes.
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
        stepping: Stepping::Lockstep,
        material: Material {
            friction: 0.5,
            restitution: 0.0,
            density: 1_000.0,
        },
        damping: Damping {
            linear: 0.0,
            angular: 0.0,
        },
        sleep: None,
        publish_schedule: PublishSchedule::EACH_TICK,
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

/// Where the stream begins.
pub(super) fn joined() -> Joined {
    let length = LengthBound::from_micrometres(10_000).expect("a centimetre is offered");
    let tolerance = Tolerance::Surface(length);
    Joined {
        choice: StreamChoice::Within(tolerance),
        config: config(),
        start: StreamStart {
            stream: STREAM,
            tolerance,
            integrator: config().integrator,
            publish_interval: core::num::NonZeroU32::MIN,
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

/// A ball that flies on.
pub(super) fn ball(id: BodyId, predictor: Predictor) -> SceneEvent {
    let moves = predictor != Predictor::Rest;
    let linear = if moves { [1.0, 2.0, -3.0] } else { [0.0; 3] };
    let angular = if moves { [0.5, 0.0, 1.0] } else { [0.0; 3] };
    let place = [id.index() as f32, 10.0, 0.0];
    let body_state = BodyState::new(place, [0.0, 0.0, 0.0, 1.0], linear, angular);
    let on_its_grid = QuantisedState {
        position: [id.index() as i32, 10, 0],
        rotation: PackedRotation::from_parts(3, [0; 3]).expect("no turn is a rotation"),
        linear: [1, 2, -3],
        angular: [5, 0, 10],
    };
    let anchor = match predictor.acceleration() {
        Some(_) => Anchor::Quantised(on_its_grid),
        None => Anchor::Exact(body_state.expect("it is finite")),
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

/// What a client calls a body in what it tells.
pub(super) fn name(id: BodyId) -> String {
    format!("{}:{}", id.index(), id.generation())
}

/// Hears its hello and welcomes it.
pub(super) fn welcomed(host: &mut Host) -> CaseResult {
    host.await_message("hello", |message| {
        matches!(message, ClientMessage::Hello { .. }).then_some(())
    })?;
    host.say(&ServerMessage::Welcome(welcome()));
    Ok(())
}

/// Welcomes it, and waits for its wish to join.
pub(super) fn wants_in(host: &mut Host) -> CaseResult {
    welcomed(host)?;
    host.await_message("join", |message| {
        matches!(message, ClientMessage::Join(_)).then_some(())
    })
}

/// Makes it a member of a scene of one ball.
pub(super) fn let_in(host: &mut Host) -> CaseResult {
    wants_in(host)?;
    snapshot(host, &[shape(), ball(BALL, Predictor::Ballistic)]);
    reported(host, "joined").map(drop)
}

/// Says a snapshot of these scene_events.
pub(super) fn snapshot(host: &mut Host, scene_events: &[SceneEvent]) {
    host.say(&ServerMessage::Joined(joined()));
    for scene_event in scene_events {
        host.say(&ServerMessage::SceneEvent(scene_event.clone()));
    }
    host.say(&ServerMessage::SnapshotEnd);
}

/// The next line that is of this kind.
pub(super) fn reported(host: &mut Host, is: &str) -> Result<serde_json::Value, Stop> {
    loop {
        host.must_be_supported()?;
        match host.next_line()? {
            Some(line) if line["is"] == is => return Ok(line),
            Some(_) => {}
            None => return Stop::fail(format!("the client does not tell {is:?}")),
        }
    }
}

/// What it tells of a tick, which it comes to tell of.
pub(super) fn told_tick(host: &mut Host, tick: u64) -> Result<serde_json::Value, Stop> {
    loop {
        let reported = reported(host, "tick")?;
        if reported["tick"] == tick {
            return Ok(reported);
        }
    }
}

/// Vouches for a tick; `next` as the packets stand.
pub(super) fn watermark(host: &mut Host, next: u64, tick: u64, scene_events: u64) -> CaseResult {
    let watermark = Watermark {
        next: Low16::of(next),
        tick: Low16::of(tick),
        scene_events: Low16::of(scene_events),
    };
    host.throw(&watermark.encode(STREAM))
}

/// The next loss_report of the client's.
pub(super) fn loss_report(host: &mut Host) -> Result<LossReport, Stop> {
    loop {
        let Some(bytes) = host.next_datagram()? else {
            return Stop::fail("the client says no loss_report");
        };
        let mut reader = Reader::new(&bytes);
        let head = Head::decode(&mut reader);
        let head = head.map_err(|why| Stop::Fail(format!("its datagram is malformed: {why:?}")))?;
        if head.kind == PacketKind::LossReport {
            if head.stream != STREAM {
                return Stop::fail(format!("it loss_reports {}, which is none", head.stream));
            }
            let loss_report = LossReport::decode(reader);
            return loss_report
                .map_err(|why| Stop::Fail(format!("its loss_report is malformed: {why:?}")));
        }
    }
}

/// That the client still listens: what it is shown to have missed it asks for. The packet before `next` is missing then.
pub(super) fn must_go_on(host: &mut Host, next: u64, tick: u64, scene_events: u64) -> CaseResult {
    let wanted = Low16::of(next - 1);
    let mut asked = Vec::new();
    // Behind many datagrams one may be lost, as any datagram may be.
    for _ in 0..3 {
        watermark(host, next, tick, scene_events)?;
        asked = loss_report(host)?.lost;
        if asked.contains(&wanted) {
            return Ok(());
        }
    }
    Stop::fail(format!("it asks for {asked:?}, not for {wanted:?}"))
}
