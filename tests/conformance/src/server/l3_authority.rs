//! L3.5: authority over bodies, and their states at the server.

use glam::Vec3;
use rhumb_protocol::message::{
    AuthorityError, ClientMessage, SceneEvent, ServerMessage, StreamChoice, TakeAuthority,
};
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, CommandError};
use rhumb_protocol::session::Event;
use rhumb_reckoning::{BodyId, BodyState, Tick, Tolerance};

use super::scenery::{BALL, NORMAL, ball, ball_shape, body, lockstep, moving};
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::feature::Feature;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::{LossyClient, RawClient};
use crate::trial::Trial;

/// Tolerance of the upstream.
const CLOSE: Tolerance = Tolerance::FINE;

/// The cases of the group: promise, citations, test function.
const CASES: &[CaseRow] = &[
    (
        1,
        "a grant of authority contains the stream, the tick and the motion of the bodies",
        "PROTOCOL 4.11-1, 4.11-3, 6.14-1",
        granted,
    ),
    (
        2,
        "authority over a body that does not exist is denied",
        "PROTOCOL 4.11-3",
        |trial| {
            refused(trial, |client| {
                let id = body(client.granted, 9)?;
                Ok((id, AuthorityError::UnknownBody(id)))
            })
        },
    ),
    (
        3,
        "authority over a body that is not kinematic is denied",
        "PROTOCOL 4.11-3",
        |trial| {
            refused(trial, |client| {
                let id = body(client.granted, 5)?;
                client.must(ball(id, Vec3::Y * 9.0, Vec3::ZERO))?;
                Ok((id, AuthorityError::NotKinematic(id)))
            })
        },
    ),
    (
        4,
        "authority over another member's body is denied",
        "PROTOCOL 4.11-3",
        others,
    ),
    (
        5,
        "no member may move a body that is under authority",
        "PROTOCOL 4.11-6",
        steered,
    ),
    (
        6,
        "taking authority over no bodies releases all",
        "PROTOCOL 4.11-1, 4.11-7",
        ended,
    ),
    (
        7,
        "when the publisher leaves, its body stands still and is free",
        "PROTOCOL 4.11-7, 3.3-3",
        left,
    ),
    (
        8,
        "in lockstep the server's bodies follow the upstream at each tick",
        "PROTOCOL 6.14-8, 6.14-10, 6.14-12, 6.14-3, 6.14-4",
        |trial| published_bodies_move(trial, 3),
    ),
    (
        9,
        "one client has authority over two hundred bodies",
        "PROTOCOL 6.14-6, 6.14-12",
        |trial| published_bodies_move(trial, 200),
    ),
    (
        10,
        "in lockstep an upstream packet in a datagram is dropped",
        "PROTOCOL 6.14-9",
        other_way,
    ),
    (
        11,
        "a malformed packet in an Upstream message moves no body",
        "PROTOCOL 2.5-4, 6.14-6",
        malformed,
    ),
    (
        12,
        "a request for authority takes effect in the order of the control stream",
        "PROTOCOL 4.11-2",
        in_order,
    ),
    (
        13,
        "a denied request leaves the previous authority unchanged",
        "PROTOCOL 4.11-3",
        goes_on,
    ),
    (
        14,
        "a publisher that falls silent, and one that is active again or gives up, are scene events",
        "PROTOCOL 4.6-12, 4.8-1",
        silent,
    ),
];

pub(super) fn cases() -> Vec<Case> {
    table("L3.5", &[Feature::Lockstep, Feature::Authority], CASES).collect()
}

/// Adds a kinematic ball at a position.
fn lift(id: BodyId, at: Vec3) -> Command {
    Command::AddBody {
        desc: BodyDesc::plain(id, BodyKind::Kinematic, BALL),
        motion: moving(at, Vec3::ZERO),
    }
}

fn member(trial: &mut Trial<'_>) -> Result<(RawClient, BodyId), Stop> {
    let mut client = trial.client()?;
    client.enter(lockstep(), NORMAL)?;
    client.must(ball_shape())?;
    let id = body(client.granted, 0)?;
    client.must(lift(id, Vec3::ONE))?;
    Ok((client, id))
}

type AuthorityAnswer = Result<rhumb_protocol::message::AuthorityGrant, AuthorityError>;

fn take_authority(client: &mut RawClient, bodies: &[BodyId]) -> Result<AuthorityAnswer, Stop> {
    client.send(&ClientMessage::TakeAuthority(TakeAuthority {
        tolerance: CLOSE,
        largest_packet: LargestPacket::DEFAULT,
        bodies: bodies.to_vec(),
    }));
    client.await_message(
        "answer to the request for authority",
        |message| match message {
            ServerMessage::AuthorityGrant(grant) => Some(Ok(grant)),
            ServerMessage::AuthorityDenied(error) => Some(Err(error)),
            _ => None,
        },
    )
}

fn must_take_authority(
    client: &mut RawClient,
    bodies: &[BodyId],
) -> Result<rhumb_protocol::message::AuthorityGrant, Stop> {
    take_authority(client, bodies)?
        .map_err(|error| Stop::Fail(format!("authority is denied: {error}")))
}

fn granted(trial: &mut Trial<'_>) -> CaseResult {
    let (mut client, id) = member(trial)?;
    let grant = must_take_authority(&mut client, &[id])?;
    ensure(grant.tick == Tick::ZERO, "the grant has the newest tick")?;
    let wanted = [(id, moving(Vec3::ONE, Vec3::ZERO))];
    ensure(
        grant.bodies == wanted,
        format!(
            "it contains the body's present state, not {:?}",
            grant.bodies
        ),
    )
}

fn refused(
    trial: &mut Trial<'_>,
    which: fn(&mut RawClient) -> Result<(BodyId, AuthorityError), Stop>,
) -> CaseResult {
    let (mut client, _) = member(trial)?;
    let (wanted, error) = which(&mut client)?;
    let answer = take_authority(&mut client, &[wanted])?;
    ensure(
        answer == Err(error),
        format!("the answer is {error}, not {answer:?}"),
    )
}

fn others(trial: &mut Trial<'_>) -> CaseResult {
    let (mut one, id) = member(trial)?;
    let mut other = trial.client_of(&one.scene.clone())?;
    other.hello()?;
    other.join(NORMAL)?;
    let answer = take_authority(&mut other, &[id])?;
    ensure(
        answer == Err(AuthorityError::NotYours(id)),
        format!("the error names another member's body, not {answer:?}"),
    )?;
    must_take_authority(&mut one, &[id]).map(drop)
}

fn steered(trial: &mut Trial<'_>) -> CaseResult {
    let (mut client, id) = member(trial)?;
    must_take_authority(&mut client, &[id])?;
    let mut other = trial.client_of(&client.scene.clone())?;
    other.hello()?;
    other.join(NORMAL)?;
    let pose = Command::SetPose {
        id,
        position: Vec3::ZERO,
        rotation: glam::Quat::IDENTITY,
    };
    let velocity = Command::SetVelocity {
        id,
        linear: Vec3::X,
        angular: Vec3::ZERO,
    };
    for member in [&mut client, &mut other] {
        for command in [pose.clone(), velocity.clone()] {
            let outcome = member.command(command)?;
            let refused = Err(CommandError::UnderAuthority(id));
            ensure(
                outcome == refused,
                format!("refused because the body is under authority, not {outcome:?}"),
            )?;
        }
    }
    Ok(())
}

fn free_again(client: &mut RawClient, id: BodyId) -> CaseResult {
    let (linear, angular) = (Vec3::X, Vec3::ZERO);
    let set = Command::SetVelocity {
        id,
        linear,
        angular,
    };
    client.must(set).map(drop)
}

fn ended(trial: &mut Trial<'_>) -> CaseResult {
    let (mut client, id) = member(trial)?;
    must_take_authority(&mut client, &[id])?;
    must_take_authority(&mut client, &[])?;
    free_again(&mut client, id)
}

fn left(trial: &mut Trial<'_>) -> CaseResult {
    let (mut client, id) = member(trial)?;
    must_take_authority(&mut client, &[id])?;
    let mut other = trial.client_of(&client.scene.clone())?;
    other.hello()?;
    other.join(NORMAL)?;
    client.send(&ClientMessage::Leave);
    client.await_message("answer to leave", |message| {
        matches!(message, ServerMessage::Left).then_some(())
    })?;
    free_again(&mut other, id)
}

fn silent(trial: &mut Trial<'_>) -> CaseResult {
    let (mut client, id) = member(trial)?;
    let grant = must_take_authority(&mut client, &[id])?;
    client.send(&ClientMessage::Advance { to: Tick::new(60) });
    let wanted = SceneEvent::PublisherSilent {
        since: grant.tick.next(),
        bodies: vec![id],
    };
    let about_silence = |message| match message {
        ServerMessage::SceneEvent(
            event @ (SceneEvent::PublisherSilent { .. } | SceneEvent::PublisherActive { .. }),
        ) => Some(event),
        _ => None,
    };
    let event = client.await_message("scene event of a silent publisher", about_silence)?;
    ensure(event == wanted, format!("it is {wanted:?}, not {event:?}"))?;
    let mut other = trial.client_of(&client.scene.clone())?;
    other.hello()?;
    other.send(&ClientMessage::Join(NORMAL));
    let event = other.await_message("silent publisher in the snapshot", about_silence)?;
    ensure(
        event == wanted,
        format!("a snapshot repeats it, not {event:?}"),
    )?;
    must_take_authority(&mut client, &[])?;
    client.send(&ClientMessage::Advance { to: Tick::new(61) });
    let event = client.await_message("scene event of the end of a silence", about_silence)?;
    let active = SceneEvent::PublisherActive {
        tick: Tick::new(61),
        bodies: vec![id],
    };
    ensure(event == active, format!("it is {active:?}, not {event:?}"))
}

/// The published state of a body at a tick: on a circle of its own.
fn mode(place: u32, tick: u64) -> BodyState {
    let angle = tick as f32 * 0.05;
    let middle = Vec3::new((place % 20) as f32 * 6.0, 0.0, (place / 20) as f32 * 6.0);
    let at = middle + Vec3::new(angle.cos(), 0.0, angle.sin());
    let speed = 0.05 * 60.0;
    moving(at, Vec3::new(-angle.sin(), 0.0, angle.cos()) * speed)
}

fn published_bodies_move(trial: &mut Trial<'_>, count: u32) -> CaseResult {
    let mut publisher = trial.subscriber()?;
    publisher.create(lockstep())?;
    let granted = publisher.join(StreamChoice::Full)?;
    publisher.must(ball_shape())?;
    let ids: Result<Vec<BodyId>, Stop> = (0..count).map(|place| body(granted, place)).collect();
    let ids = ids?;
    for (place, id) in (0..).zip(&ids) {
        let at = mode(place, 0).motion().pose().position.as_vec3();
        publisher.must(lift(*id, at))?;
    }
    publisher.task(|session| session.take_authority(CLOSE, &ids))?;
    publisher.until("answer to the request for authority", |event| match event {
        Event::AuthorityGrant(_) => Some(Ok(())),
        Event::AuthorityDenied(error) => Some(Stop::fail(format!("authority is denied: {error}"))),
        _ => None,
    })??;
    for tick in 1..=60 {
        let sent: Vec<_> = (0..)
            .zip(&ids)
            .map(|(place, id)| (*id, mode(place, tick)))
            .collect();
        publisher.task(|session| session.publish(Tick::new(tick), &sent))?;
        publisher.advance(Tick::new(tick))?;
        near(&publisher, &sent, Tick::new(tick))?;
    }
    Ok(())
}

/// Requires that each body is within tolerance of its published state, plus rounding to f32.
fn near(publisher: &LossyClient, sent: &[(BodyId, BodyState)], tick: Tick) -> CaseResult {
    let stream = publisher.replica()?.stream();
    for (id, motion) in sent {
        let no_body = || Stop::Fail(format!("{id} does not exist"));
        let there = stream.predicted_motion(*id, tick).ok_or_else(no_body)?;
        let apart = rhumb_reckoning::Divergence::between(&motion.motion().pose(), &there.pose());
        let radius = rhumb_reckoning::Metres::new(f64::from(super::scenery::RADIUS));
        let share = CLOSE.share(&apart, radius);
        ensure(
            share <= 1.001,
            format!("{id} at {tick} has an error of {share:.3} times the tolerance"),
        )?;
    }
    Ok(())
}

/// The first packet of an upstream: a watermark without updates up to a tick.
fn watermark(stream: rhumb_protocol::packet::StreamId, tick: u64) -> Vec<u8> {
    use rhumb_protocol::packet::{Low16, Watermark};

    let watermark = Watermark {
        next: Low16::of(0),
        tick: Low16::of(tick),
        scene_events: Low16::of(0),
    };
    watermark.encode(stream)
}

fn other_way(trial: &mut Trial<'_>) -> CaseResult {
    let (mut client, id) = member(trial)?;
    let grant = must_take_authority(&mut client, &[id])?;
    client.send_datagram(&watermark(grant.stream, 5))?;
    client.barrier()?;
    // As a control message it is accepted; neither packet is answered.
    client.send(&ClientMessage::Upstream(watermark(grant.stream, 5)));
    let received = client.barrier()?;
    ensure(
        received.is_empty(),
        format!("no answer is sent, not {received:?}"),
    )
}

fn malformed(trial: &mut Trial<'_>) -> CaseResult {
    let (mut client, id) = member(trial)?;
    let grant = must_take_authority(&mut client, &[id])?;
    let good = watermark(grant.stream, 5);
    for end in 0..good.len() {
        client.send(&ClientMessage::Upstream(good[..end].to_vec()));
    }
    let mut dice = trial.dice();
    for _ in 0..200 {
        let mut bytes = good.clone();
        bytes.truncate(2 + dice.below(6));
        bytes.extend((0..dice.below(40)).map(|_| dice.below(256) as u8));
        client.send(&ClientMessage::Upstream(bytes));
    }
    // Random bytes may form a valid packet; the connection must not end.
    client.barrier().map(drop)
}

fn in_order(trial: &mut Trial<'_>) -> CaseResult {
    let (mut client, id) = member(trial)?;
    let (linear, angular) = (Vec3::X, Vec3::ZERO);
    let set = ClientMessage::Command(Command::SetVelocity {
        id,
        linear,
        angular,
    });
    let drive = ClientMessage::TakeAuthority(TakeAuthority {
        tolerance: CLOSE,
        largest_packet: LargestPacket::DEFAULT,
        bodies: vec![id],
    });
    let before = client.commands;
    client.send_together(&[set.clone(), drive, set]);
    ensure(
        client.outcome_of(before + 1)? == Err(CommandError::UnderAuthority(id)),
        "the command after the request is refused",
    )
}

fn goes_on(trial: &mut Trial<'_>) -> CaseResult {
    let (mut client, id) = member(trial)?;
    must_take_authority(&mut client, &[id])?;
    let missing = body(client.granted, 9)?;
    let answer = take_authority(&mut client, &[id, missing])?;
    ensure(
        answer == Err(AuthorityError::UnknownBody(missing)),
        format!("the request is denied, not {answer:?}"),
    )?;
    let (linear, angular) = (Vec3::X, Vec3::ZERO);
    let outcome = client.command(Command::SetVelocity {
        id,
        linear,
        angular,
    })?;
    ensure(
        outcome == Err(CommandError::UnderAuthority(id)),
        format!("the body is still under authority, not {outcome:?}"),
    )
}
