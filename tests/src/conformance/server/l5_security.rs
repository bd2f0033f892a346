//! L5.1: what nobody may do to others, however it tries.
//!
//! In each case somebody behaves well beside who does not: what the one is promised holds all the while.

use glam::Vec3;
use rhumb_protocol::Instant;
use rhumb_protocol::message::{ClientMessage, ResyncCause, ServerMessage, StreamChoice};
use rhumb_protocol::packet::{LossReport, Low16, StreamId};
use rhumb_protocol::scene::{Command, CommandError};
use rhumb_protocol::session::CloseCode;
use rhumb_reckoning::{BodyId, Tick};

use super::scenery::{NORMAL, ball, ball_shape, body, lockstep};
use super::{CaseRow, table};
use crate::conformance::case::{Case, Feature};
use crate::conformance::outcome::{CaseResult, Stop, ensure};
use crate::conformance::peer::{LossyClient, RawClient};
use crate::conformance::trial::Trial;

/// Too many control bytes wait for who does not read them.
const CONTROL_OVERFLOW: u64 = 0x102;

/// What each case of the group promises, cites and does.
const CASES: &[CaseRow] = &[
    (
        1,
        "datagrams of chance are dropped, and nothing comes of them",
        "PROTOCOL 2.5-4, 5.8-4, 3.5-16",
        |trial| beside(trial, noise),
    ),
    (
        2,
        "a body of an index that was not granted is refused",
        "PROTOCOL 4.4-2, 4.6-8",
        not_granted,
    ),
    (
        3,
        "a body of another scene is not there",
        "PROTOCOL 3.1-3, 4.4-7",
        other_scene,
    ),
    (
        4,
        "datagrams of greased kinds are dropped",
        "PROTOCOL 3.5-16, 3.5-7",
        |trial| beside(trial, greased),
    ),
    (
        5,
        "loss_reports that name all that was never sent cost others nothing",
        "PROTOCOL 6.7-7, 5.13-1",
        |trial| beside(trial, loss_reports),
    ),
    (
        7,
        "pings without end are answered, each by its number",
        "PROTOCOL 4.2-2",
        |trial| beside(trial, pings),
    ),
    (
        9,
        "bytes of chance on the control stream end one connection, and no other",
        "PROTOCOL 2.5-3",
        |trial| beside(trial, chance),
    ),
    (
        10,
        "snapshots without end are reported as often as they can be reported together",
        "PROTOCOL 4.8-9",
        |trial| beside(trial, snapshots),
    ),
    (
        11,
        "commands beyond what may wait for a tick are applied all the same, or close with code 4",
        "PROTOCOL 7-1, 7-2",
        waiting,
    ),
    (
        12,
        "who says nothing but hello, again and again, costs others nothing",
        "PROTOCOL 1.4-4, 3.4-1",
        |trial| {
            beside(trial, |trial, _| {
                for _ in 0..60 {
                    let mut guest = trial.guest()?;
                    guest.hello()?;
                    guest.line.close(0);
                }
                Ok(())
            })
        },
    ),
    (
        13,
        "a scene's name is not reported to who does not say it",
        "PROTOCOL 3.1-3, 4.7-1",
        |trial| {
            let mut guest = trial.guest()?;
            guest.hello()?;
            guest.create(lockstep())?;
            let mut other = trial.guest()?;
            let welcome = other.hello()?;
            ensure(welcome.scene.is_none(), "its scene is not there")?;
            other.say(&ClientMessage::Join(NORMAL));
            let received = other.barrier()?;
            ensure(
                matches!(received[..], [ServerMessage::Denied(_)]),
                format!("denied, not {received:?}"),
            )
        },
    ),
];

/// Those that wait for a clock of the server's.
const SLOW: &[CaseRow] = &[(
    8,
    "who does not read is closed before it costs others",
    "PROTOCOL 7-2",
    deaf,
)];

pub(super) fn cases() -> Vec<Case> {
    let cases = table("L5.1", &[Feature::Lockstep], CASES);
    cases
        .chain(table("L5.1", &[Feature::Lockstep], SLOW).map(Case::slow))
        .collect()
}

/// A scene with somebody who behaves well, while a member of the same scene does something; then it goes on as promised.
fn beside(
    trial: &mut Trial<'_>,
    does: fn(&mut Trial<'_>, &mut RawClient) -> CaseResult,
) -> CaseResult {
    let mut good = trial.follower()?;
    good.create(lockstep())?;
    let granted = good.join(NORMAL)?;
    good.must(ball_shape())?;
    good.must(ball(body(granted, 0)?, Vec3::ZERO, Vec3::X))?;
    let mut rude = trial.guest_of(&good.scene.clone())?;
    rude.hello()?;
    rude.join(StreamChoice::Full)?;
    good.advance(Tick::new(10))?;
    does(trial, &mut rude)?;
    goes_on(&mut good, 10)
}

fn goes_on(good: &mut LossyClient, from: u64) -> CaseResult {
    for tick in from + 1..=from + 20 {
        good.advance(Tick::new(tick))?;
    }
    let id = body(good.granted, 0)?;
    good.must(Command::Impulse {
        id,
        impulse: Vec3::Y,
    })?;
    let received = good.replica()?.stream().statistics();
    ensure(
        received.mismatches == 0 && received.malformed == 0,
        "its copy is right",
    )
}

fn noise(trial: &mut Trial<'_>, rude: &mut RawClient) -> CaseResult {
    let mut dice = trial.dice();
    for _ in 0..500 {
        let length = dice.below(1_150);
        let bytes: Vec<u8> = (0..length).map(|_| dice.below(256) as u8).collect();
        rude.throw(&bytes)?;
    }
    rude.barrier().map(drop)
}

fn greased(_: &mut Trial<'_>, rude: &mut RawClient) -> CaseResult {
    for kind in 0..=0xff_u8 {
        rude.throw(&[kind])?;
        rude.throw(&[kind, 0, 1, 2, 3])?;
    }
    rude.throw(&[])?;
    rude.barrier().map(drop)
}

/// The stream that a member follows.
fn stream(rude: &mut RawClient) -> Result<StreamId, Stop> {
    rude.say(&ClientMessage::Resync(ResyncCause::LostSync));
    Ok(rude.snapshot()?.0.start.stream)
}

fn loss_reports(_: &mut Trial<'_>, rude: &mut RawClient) -> CaseResult {
    let stream = stream(rude)?;
    for number in 0..400_u64 {
        let loss_report = LossReport {
            next: Low16::of(number * 97),
            gone: Low16::of(number),
            repair_symbols: (number % 33) as u8,
            lost: (0..64).map(|lost| Low16::of(number * 64 + lost)).collect(),
        };
        rude.throw(&loss_report.encode(stream))?;
    }
    rude.barrier().map(drop)
}

fn pings(_: &mut Trial<'_>, rude: &mut RawClient) -> CaseResult {
    let pings: Vec<_> = (0..5_000)
        .map(|number| ClientMessage::Ping {
            sent: Instant::from_nanos(number),
        })
        .collect();
    rude.say_together(&pings);
    let mut next = 0;
    while next < 5_000 {
        next = rude.await_message("pong", |message| match message {
            ServerMessage::Pong { sent, .. } => Some(sent.as_nanos() + 1),
            _ => None,
        })?;
    }
    Ok(())
}

fn chance(trial: &mut Trial<'_>, _: &mut RawClient) -> CaseResult {
    let mut dice = trial.dice();
    for _ in 0..40 {
        let mut guest = trial.guest()?;
        let bytes: Vec<u8> = (0..1 + dice.below(300))
            .map(|_| dice.below(256) as u8)
            .collect();
        guest.utter(&bytes);
        // What chance says may be the beginning of a message; then nothing comes of it.
        guest.line.finish();
    }
    Ok(())
}

fn snapshots(_: &mut Trial<'_>, rude: &mut RawClient) -> CaseResult {
    rude.say_together(&vec![ClientMessage::Resync(ResyncCause::LostSync); 500]);
    let received = rude.barrier()?;
    let reported = received
        .iter()
        .filter(|message| matches!(message, ServerMessage::Joined(_)));
    let reported = reported.count();
    ensure(
        (1..=100).contains(&reported),
        format!("some of five hundred, not {reported}"),
    )
}

fn not_granted(trial: &mut Trial<'_>) -> CaseResult {
    let mut guest = trial.guest()?;
    guest.enter(lockstep(), StreamChoice::Full)?;
    guest.must(ball_shape())?;
    let beyond = BodyId::new(1_000_000, 0);
    match guest.command(ball(beyond, Vec3::ZERO, Vec3::ZERO))? {
        Err(CommandError::NotGranted(id)) => ensure(id == beyond, "the error names it"),
        other => Stop::fail(format!("{other:?}; must be refused by NotGranted")),
    }
}

fn other_scene(trial: &mut Trial<'_>) -> CaseResult {
    let mut one = trial.guest()?;
    one.enter(lockstep(), StreamChoice::Full)?;
    one.must(ball_shape())?;
    let id = body(one.granted, 0)?;
    one.must(ball(id, Vec3::ZERO, Vec3::ZERO))?;
    let mut other = trial.guest()?;
    other.enter(lockstep(), StreamChoice::Full)?;
    match other.command(Command::RemoveBody { id })? {
        Err(CommandError::UnknownBody(_)) => {}
        came => return Stop::fail(format!("{came:?}; must be refused by UnknownBody")),
    }
    one.must(Command::RemoveBody { id }).map(drop)
}

/// A member that asks for snapshots of a large scene and reads none of them.
fn deaf(trial: &mut Trial<'_>) -> CaseResult {
    let mut good = trial.follower()?;
    good.create(lockstep())?;
    let granted = good.join(NORMAL)?;
    good.must(ball_shape())?;
    for place in 0..2_000 {
        let at = Vec3::new((place % 50) as f32 * 3.0, 0.0, (place / 50) as f32 * 3.0);
        let id = body(granted, place)?;
        good.task(|session| session.command(ball(id, at, Vec3::ZERO)))?;
    }
    good.advance(Tick::new(1))?;
    let mut rude = trial.guest_of(&good.scene.clone())?;
    rude.hello()?;
    rude.line.read_control(false);
    rude.say(&ClientMessage::Join(StreamChoice::Full));
    let mut tick = 1;
    // Each snapshot takes some 100 kB; what may wait is a few MB more than what QUIC has under way.
    for _ in 0..400 {
        rude.say(&ClientMessage::Resync(ResyncCause::LostSync));
        tick += 1;
        good.advance(Tick::new(tick))?;
        while let Some(seen) = rude.line.hear(std::time::Duration::ZERO) {
            if let rhumb_transport::RawEvent::Ended(end) = seen {
                let overflow = rhumb_transport::RawPeerEnd::Closed(CONTROL_OVERFLOW);
                ensure(
                    end == overflow,
                    format!("code {CONTROL_OVERFLOW:#x}, not {end}"),
                )?;
                return goes_on(&mut good, tick);
            }
        }
    }
    Stop::fail("it may wait for tens of megabytes")
}

/// Commands behind an advance that is not there yet.
fn waiting(trial: &mut Trial<'_>) -> CaseResult {
    let mut guest = trial.guest()?;
    guest.enter(lockstep(), NORMAL)?;
    let command = ClientMessage::Command(Command::SetGravity {
        gravity: Vec3::ZERO,
    });
    let most = rhumb_protocol::limits::PENDING_COMMANDS_MAX;
    let mut together = vec![ClientMessage::Advance {
        to: Tick::new(rhumb_protocol::limits::ADVANCE_TICKS_MAX),
    }];
    together.resize(most + 500, command);
    guest.say_together(&together);
    // A server that steps meanwhile lets none of them wait so long; one that does not may close.
    match guest.outcome_of(guest.commands - 1) {
        Ok(Ok(_)) => guest.barrier().map(drop),
        Ok(Err(error)) => Stop::fail(format!("a change of gravity is refused: {error}")),
        Err(_) => guest.must_be_closed(CloseCode::LIMIT),
    }
}
