//! L3.5: who drives which bodies, and where the server has them then.

use glam::Vec3;
use rhumb_protocol::message::{
    AuthorityError, ClientMessage, ServerMessage, StreamChoice, TakeAuthority,
};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, CommandError};
use rhumb_protocol::session::Event;
use rhumb_reckoning::{BodyId, BodyState, Tick, Tolerance};

use super::scenery::{BALL, NORMAL, ball, ball_shape, body, lockstep, moving};
use super::{CaseRow, table};
use crate::conformance::case::{Case, Feature};
use crate::conformance::outcome::{CaseResult, Stop, ensure};
use crate::conformance::peer::{LossyClient, RawClient};
use crate::conformance::trial::Trial;

/// How closely the server is to know.
const CLOSE: Tolerance = Tolerance::FINE;

/// What each case of the group promises, cites and does.
const CASES: &[CaseRow] = &[
    (
        1,
        "who drives is reported its stream, the tick, and how its bodies move",
        "PROTOCOL 4.11-1, 4.11-3, 6.14-1",
        granted,
    ),
    (
        2,
        "a body that is not there is not driven",
        "PROTOCOL 4.11-3",
        |trial| {
            refused(trial, |guest| {
                let id = body(guest.granted, 9)?;
                Ok((id, AuthorityError::UnknownBody(id)))
            })
        },
    ),
    (
        3,
        "a body that is not kinematic is not driven",
        "PROTOCOL 4.11-3",
        |trial| {
            refused(trial, |guest| {
                let id = body(guest.granted, 5)?;
                guest.must(ball(id, Vec3::Y * 9.0, Vec3::ZERO))?;
                Ok((id, AuthorityError::NotKinematic(id)))
            })
        },
    ),
    (
        4,
        "a body of another member's is not driven",
        "PROTOCOL 4.11-3",
        others,
    ),
    (
        5,
        "what is driven is not put elsewhere, by nobody",
        "PROTOCOL 4.11-6",
        steered,
    ),
    (
        6,
        "who drives none drives none any more",
        "PROTOCOL 4.11-1, 4.11-7",
        ended,
    ),
    (
        7,
        "a body whose driver left stands still and is free",
        "PROTOCOL 4.11-7, 3.3-3",
        left,
    ),
    (
        8,
        "in lockstep the server has bodies where their driver sent, at each tick",
        "PROTOCOL 6.14-8, 6.14-10, 6.14-12, 6.14-3, 6.14-4",
        |trial| drives(trial, 3),
    ),
    (
        9,
        "two hundred bodies are driven at once",
        "PROTOCOL 6.14-6, 6.14-12",
        |trial| drives(trial, 200),
    ),
    (
        10,
        "a packet of an upstream that comes as a datagram in lockstep is dropped",
        "PROTOCOL 6.14-9",
        other_way,
    ),
    (
        11,
        "a malformed packet in an Upstream moves nothing",
        "PROTOCOL 2.5-4, 6.14-6",
        malformed,
    ),
    (
        12,
        "a task to drive acts in the order of the control stream",
        "PROTOCOL 4.11-2",
        in_order,
    ),
    (
        13,
        "a task that is refused leaves what was driven before",
        "PROTOCOL 4.11-3",
        goes_on,
    ),
];

pub(super) fn cases() -> Vec<Case> {
    table("L3.5", &[Feature::Lockstep, Feature::AuthorityGrant], CASES).collect()
}

/// Puts a kinematic ball somewhere.
fn lift(id: BodyId, at: Vec3) -> Command {
    Command::AddBody {
        desc: BodyDesc::plain(id, BodyKind::Kinematic, BALL),
        motion: moving(at, Vec3::ZERO),
    }
}

fn member(trial: &mut Trial<'_>) -> Result<(RawClient, BodyId), Stop> {
    let mut guest = trial.guest()?;
    guest.enter(lockstep(), NORMAL)?;
    guest.must(ball_shape())?;
    let id = body(guest.granted, 0)?;
    guest.must(lift(id, Vec3::ONE))?;
    Ok((guest, id))
}

type AuthorityAnswer = Result<rhumb_protocol::message::AuthorityGrant, AuthorityError>;

fn take_authority(guest: &mut RawClient, bodies: &[BodyId]) -> Result<AuthorityAnswer, Stop> {
    guest.say(&ClientMessage::TakeAuthority(TakeAuthority {
        tolerance: CLOSE,
        bodies: bodies.to_vec(),
    }));
    guest.await_message("answer to drive", |message| match message {
        ServerMessage::AuthorityGrant(driving) => Some(Ok(driving)),
        ServerMessage::AuthorityDenied(error) => Some(Err(error)),
        _ => None,
    })
}

fn must_drive(
    guest: &mut RawClient,
    bodies: &[BodyId],
) -> Result<rhumb_protocol::message::AuthorityGrant, Stop> {
    take_authority(guest, bodies)?.map_err(|error| Stop::Fail(format!("it may not drive: {error}")))
}

fn granted(trial: &mut Trial<'_>) -> CaseResult {
    let (mut guest, id) = member(trial)?;
    let driving = must_drive(&mut guest, &[id])?;
    ensure(driving.tick == Tick::ZERO, "at the newest tick")?;
    let wanted = [(id, moving(Vec3::ONE, Vec3::ZERO))];
    ensure(
        driving.bodies == wanted,
        format!("where it is, not {:?}", driving.bodies),
    )
}

fn refused(
    trial: &mut Trial<'_>,
    which: fn(&mut RawClient) -> Result<(BodyId, AuthorityError), Stop>,
) -> CaseResult {
    let (mut guest, _) = member(trial)?;
    let (wanted, error) = which(&mut guest)?;
    let answer = take_authority(&mut guest, &[wanted])?;
    ensure(answer == Err(error), format!("{error}, not {answer:?}"))
}

fn others(trial: &mut Trial<'_>) -> CaseResult {
    let (mut one, id) = member(trial)?;
    let mut other = trial.guest_of(&one.scene.clone())?;
    other.hello()?;
    other.join(NORMAL)?;
    let answer = take_authority(&mut other, &[id])?;
    ensure(
        answer == Err(AuthorityError::NotYours(id)),
        format!("it is another's, not {answer:?}"),
    )?;
    must_drive(&mut one, &[id]).map(drop)
}

fn steered(trial: &mut Trial<'_>) -> CaseResult {
    let (mut guest, id) = member(trial)?;
    must_drive(&mut guest, &[id])?;
    let mut other = trial.guest_of(&guest.scene.clone())?;
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
    for who in [&mut guest, &mut other] {
        for command in [pose.clone(), velocity.clone()] {
            let outcome = who.command(command)?;
            let driven = Err(CommandError::UnderAuthority(id));
            ensure(
                outcome == driven,
                format!("refused, since it is driven; not {outcome:?}"),
            )?;
        }
    }
    Ok(())
}

fn free_again(guest: &mut RawClient, id: BodyId) -> CaseResult {
    let (linear, angular) = (Vec3::X, Vec3::ZERO);
    let set = Command::SetVelocity {
        id,
        linear,
        angular,
    };
    guest.must(set).map(drop)
}

fn ended(trial: &mut Trial<'_>) -> CaseResult {
    let (mut guest, id) = member(trial)?;
    must_drive(&mut guest, &[id])?;
    must_drive(&mut guest, &[])?;
    free_again(&mut guest, id)
}

fn left(trial: &mut Trial<'_>) -> CaseResult {
    let (mut guest, id) = member(trial)?;
    must_drive(&mut guest, &[id])?;
    let mut other = trial.guest_of(&guest.scene.clone())?;
    other.hello()?;
    other.join(NORMAL)?;
    guest.say(&ClientMessage::Leave);
    guest.await_message("answer to leave", |message| {
        matches!(message, ServerMessage::Left).then_some(())
    })?;
    free_again(&mut other, id)
}

/// Where a driven body is sent to be at a tick: on a circle of its own.
fn mode(place: u32, tick: u64) -> BodyState {
    let angle = tick as f32 * 0.05;
    let middle = Vec3::new((place % 20) as f32 * 6.0, 0.0, (place / 20) as f32 * 6.0);
    let at = middle + Vec3::new(angle.cos(), 0.0, angle.sin());
    let speed = 0.05 * 60.0;
    moving(at, Vec3::new(-angle.sin(), 0.0, angle.cos()) * speed)
}

fn drives(trial: &mut Trial<'_>, count: u32) -> CaseResult {
    let mut driver = trial.follower()?;
    driver.create(lockstep())?;
    let granted = driver.join(StreamChoice::Full)?;
    driver.must(ball_shape())?;
    let ids: Result<Vec<BodyId>, Stop> = (0..count).map(|place| body(granted, place)).collect();
    let ids = ids?;
    for (place, id) in (0..).zip(&ids) {
        let at = mode(place, 0).motion().pose().position.as_vec3();
        driver.must(lift(*id, at))?;
    }
    driver.task(|session| session.take_authority(CLOSE, &ids))?;
    driver.until("answer to drive", |event| match event {
        Event::AuthorityGrant(_) => Some(Ok(())),
        Event::AuthorityDenied(error) => Some(Stop::fail(format!("it may not drive: {error}"))),
        _ => None,
    })??;
    for tick in 1..=60 {
        let sent: Vec<_> = (0..)
            .zip(&ids)
            .map(|(place, id)| (*id, mode(place, tick)))
            .collect();
        driver.task(|session| session.publish(Tick::new(tick), &sent))?;
        driver.advance(Tick::new(tick))?;
        near(&driver, &sent, Tick::new(tick))?;
    }
    Ok(())
}

/// That each body is within the driver's tolerance of where it was sent to be, and what rounding to f32 adds.
fn near(driver: &LossyClient, sent: &[(BodyId, BodyState)], tick: Tick) -> CaseResult {
    let stream = driver.replica()?.stream();
    for (id, motion) in sent {
        let gone = || Stop::Fail(format!("{id} is not there"));
        let there = stream.predicted_motion(*id, tick).ok_or_else(gone)?;
        let apart = rhumb_reckoning::Divergence::between(&motion.motion().pose(), &there.pose());
        let radius = rhumb_reckoning::Metres::new(f64::from(super::scenery::RADIUS));
        let share = CLOSE.share(&apart, radius);
        ensure(
            share <= 1.001,
            format!("{id} at {tick} is {share:.3} times the tolerance off"),
        )?;
    }
    Ok(())
}

/// The first packet of an upstream: says that nothing is sent up to a tick.
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
    let (mut guest, id) = member(trial)?;
    let driving = must_drive(&mut guest, &[id])?;
    guest.throw(&watermark(driving.stream, 5))?;
    guest.barrier()?;
    // By the way that counts it is taken, and nothing comes of either.
    guest.say(&ClientMessage::Upstream(watermark(driving.stream, 5)));
    let received = guest.barrier()?;
    ensure(
        received.is_empty(),
        format!("nothing is sent of it, not {received:?}"),
    )
}

fn malformed(trial: &mut Trial<'_>) -> CaseResult {
    let (mut guest, id) = member(trial)?;
    let driving = must_drive(&mut guest, &[id])?;
    let good = watermark(driving.stream, 5);
    for end in 0..good.len() {
        guest.say(&ClientMessage::Upstream(good[..end].to_vec()));
    }
    let mut dice = trial.dice();
    for _ in 0..200 {
        let mut bytes = good.clone();
        bytes.truncate(2 + dice.below(6));
        bytes.extend((0..dice.below(40)).map(|_| dice.below(256) as u8));
        guest.say(&ClientMessage::Upstream(bytes));
    }
    // Noise may happen to be a packet; what must not happen is that the connection ends.
    guest.barrier().map(drop)
}

fn in_order(trial: &mut Trial<'_>) -> CaseResult {
    let (mut guest, id) = member(trial)?;
    let (linear, angular) = (Vec3::X, Vec3::ZERO);
    let set = ClientMessage::Command(Command::SetVelocity {
        id,
        linear,
        angular,
    });
    let drive = ClientMessage::TakeAuthority(TakeAuthority {
        tolerance: CLOSE,
        bodies: vec![id],
    });
    let before = guest.commands;
    guest.say_together(&[set.clone(), drive, set]);
    ensure(
        guest.outcome_of(before + 1)? == Err(CommandError::UnderAuthority(id)),
        "what comes after it is refused",
    )
}

fn goes_on(trial: &mut Trial<'_>) -> CaseResult {
    let (mut guest, id) = member(trial)?;
    must_drive(&mut guest, &[id])?;
    let nobody = body(guest.granted, 9)?;
    let answer = take_authority(&mut guest, &[id, nobody])?;
    ensure(
        answer == Err(AuthorityError::UnknownBody(nobody)),
        format!("refused, not {answer:?}"),
    )?;
    let (linear, angular) = (Vec3::X, Vec3::ZERO);
    let outcome = guest.command(Command::SetVelocity {
        id,
        linear,
        angular,
    })?;
    ensure(
        outcome == Err(CommandError::UnderAuthority(id)),
        format!("it drives still, not {outcome:?}"),
    )
}
