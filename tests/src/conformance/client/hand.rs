//! What a server made of bytes says to let a client in: a scene of one ball.
//!
//! Its truth is a session of this house that hears the same.

use glam::Vec3;
use rhumb_protocol::message::{
    ClientMessage, Extensions, Joined, Notice, ServerMessage, StreamChoice, Welcome,
};
use rhumb_protocol::packet::{Echo, Head, Kind, Low16, StreamId, Vouch};
use rhumb_protocol::scene::{
    BodyKind, BodyTerms, Cadence, IdRange, Material, Pace, SceneTerms, Shape, ShapeId,
};
use rhumb_protocol::stream::StreamStart;
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_reckoning::{
    Anchor, BodyId, Damping, Integrator, LengthBound, PackedRotation, Predictor, Rate, Snapped,
    Tick, Tolerance, Track, Verbatim,
};

use crate::conformance::outcome::{Play, Stop};
use crate::conformance::peer::Host;

/// The stream of a server made of bytes.
pub(super) const STREAM: StreamId = StreamId(5);
/// Its first packet's number.
pub(super) const NEXT: u64 = 100;
/// The tick of its snapshot.
pub(super) const TICK: u64 = 1_000;
/// Notices that the snapshot includes.
pub(super) const NOTICES: u64 = 10;
/// The ball.
pub(super) const BALL: BodyId = BodyId::new(3, 0);
/// The ball's shape.
pub(super) const SHAPE: ShapeId = ShapeId(1);

/// A lockstep scene at sixty ticks a second.
pub(super) fn terms() -> SceneTerms {
    SceneTerms {
        integrator: Integrator {
            rate: Rate::HZ_60,
            substeps: core::num::NonZeroU32::MIN,
        },
        gravity: Vec3::new(0.0, -9.81, 0.0),
        pace: Pace::Lockstep,
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
        cadence: Cadence::EACH_TICK,
    }
}

/// A welcome to a scene that exists.
pub(super) fn welcome() -> Welcome {
    Welcome {
        version: 1,
        scene: Some(terms()),
        extensions: Extensions::NONE,
    }
}

/// Where the stream begins.
pub(super) fn joined() -> Joined {
    let length = LengthBound::from_micrometres(10_000).expect("a centimetre is offered");
    let tolerance = Tolerance::Surface(length);
    Joined {
        choice: StreamChoice::Within(tolerance),
        terms: terms(),
        start: StreamStart {
            stream: STREAM,
            tolerance,
            integrator: terms().integrator,
            every: core::num::NonZeroU32::MIN,
            gravity: terms().gravity,
            tick: Tick::new(TICK),
            next: NEXT,
            notices: NOTICES,
        },
        granted: IdRange::EMPTY,
        extensions: Extensions::NONE,
    }
}

/// The ball's shape.
pub(super) fn shape() -> Notice {
    Notice::ShapeAdded {
        id: SHAPE,
        shape: Shape::Ball { radius: 0.5 },
    }
}

/// A ball that flies on.
pub(super) fn ball(id: BodyId, predictor: Predictor) -> Notice {
    let moves = predictor != Predictor::Rest;
    let linear = if moves { [1.0, 2.0, -3.0] } else { [0.0; 3] };
    let angular = if moves { [0.5, 0.0, 1.0] } else { [0.0; 3] };
    let place = [id.index() as f32, 10.0, 0.0];
    let verbatim = Verbatim::new(place, [0.0, 0.0, 0.0, 1.0], linear, angular);
    let on_its_grid = Snapped {
        position: [id.index() as i32, 10, 0],
        rotation: PackedRotation::from_parts(3, [0; 3]).expect("no turn is a rotation"),
        linear: [1, 2, -3],
        angular: [5, 0, 10],
    };
    let anchor = match predictor.push() {
        Some(_) => Anchor::Snapped(on_its_grid),
        None => Anchor::Verbatim(verbatim.expect("it is finite")),
    };
    Notice::BodyPlaced {
        terms: BodyTerms::plain(id, BodyKind::Dynamic, SHAPE),
        inertia: None,
        track: Track {
            origin: Tick::new(TICK - 1),
            predictor,
            anchor,
            carrier: None,
        },
        seat: None,
    }
}

/// What a client calls a body in what it tells.
pub(super) fn name(id: BodyId) -> String {
    format!("{}:{}", id.index(), id.generation())
}

/// Hears its hello and welcomes it.
pub(super) fn welcomed(host: &mut Host) -> Play {
    host.await_message("hello", |message| {
        matches!(message, ClientMessage::Hello { .. }).then_some(())
    })?;
    host.say(&ServerMessage::Welcome(welcome()));
    Ok(())
}

/// Welcomes it, and waits for its wish to join.
pub(super) fn wants_in(host: &mut Host) -> Play {
    welcomed(host)?;
    host.await_message("join", |message| {
        matches!(message, ClientMessage::Join(_)).then_some(())
    })
}

/// Makes it a member of a scene of one ball.
pub(super) fn let_in(host: &mut Host) -> Play {
    wants_in(host)?;
    snapshot(host, &[shape(), ball(BALL, Predictor::Ballistic)]);
    told(host, "joined").map(drop)
}

/// Says a snapshot of these notices.
pub(super) fn snapshot(host: &mut Host, notices: &[Notice]) {
    host.say(&ServerMessage::Joined(joined()));
    for notice in notices {
        host.say(&ServerMessage::Notice(notice.clone()));
    }
    host.say(&ServerMessage::SnapshotEnd);
}

/// The next line that is of this kind.
pub(super) fn told(host: &mut Host, is: &str) -> Result<serde_json::Value, Stop> {
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
        let told = told(host, "tick")?;
        if told["tick"] == tick {
            return Ok(told);
        }
    }
}

/// Vouches for a tick; `next` as the packets stand.
pub(super) fn vouch(host: &mut Host, next: u64, tick: u64, notices: u64) -> Play {
    let vouch = Vouch {
        next: Low16::of(next),
        tick: Low16::of(tick),
        notices: Low16::of(notices),
    };
    host.throw(&vouch.encode(STREAM))
}

/// The next echo of the client's.
pub(super) fn echo(host: &mut Host) -> Result<Echo, Stop> {
    loop {
        let Some(bytes) = host.next_datagram()? else {
            return Stop::fail("the client says no echo");
        };
        let mut reader = Reader::new(&bytes);
        let head = Head::decode(&mut reader);
        let head = head.map_err(|why| Stop::Fail(format!("its datagram is malformed: {why:?}")))?;
        if head.kind == Kind::Echo {
            if head.stream != STREAM {
                return Stop::fail(format!("it echoes {}, which is none", head.stream));
            }
            let echo = Echo::decode(reader);
            return echo.map_err(|why| Stop::Fail(format!("its echo is malformed: {why:?}")));
        }
    }
}

/// That the client still listens: what it is shown to have missed it asks for. The packet before `next` is missing then.
pub(super) fn must_go_on(host: &mut Host, next: u64, tick: u64, notices: u64) -> Play {
    let wanted = Low16::of(next - 1);
    let mut asked = Vec::new();
    // Behind many datagrams one may be lost, as any datagram may be.
    for _ in 0..3 {
        vouch(host, next, tick, notices)?;
        asked = echo(host)?.lost;
        if asked.contains(&wanted) {
            return Ok(());
        }
    }
    Stop::fail(format!("it asks for {asked:?}, not for {wanted:?}"))
}
