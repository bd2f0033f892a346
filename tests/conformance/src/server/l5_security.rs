//! L5.1: attacks of one client must not affect others.
//!
//! In each case a well-behaved client runs beside a hostile one, and its promises must hold all the time.

use glam::Vec3;
use rhumb_netsim::RawPeerConfig;
use rhumb_protocol::Instant;
use rhumb_protocol::limits::CONTROL_WAITING_BYTES_MAX;
use rhumb_protocol::message::{ClientMessage, ResyncCause, ServerMessage, StreamChoice};
use rhumb_protocol::packet::{LossReport, Low16, StreamId};
use rhumb_protocol::scene::{Command, CommandError};
use rhumb_reckoning::{BodyId, Tick};

use super::scenery::{NORMAL, ball, ball_shape, body, lockstep};
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::feature::Feature;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::{LossyClient, RawClient};
use crate::trial::Trial;

/// Close code for a client that does not read its control bytes.
const CONTROL_OVERFLOW: u64 = 0x102;

/// The cases of the group: promise, citations, test function.
const CASES: &[CaseRow] = &[
    (
        1,
        "random datagrams are dropped without any effect",
        "PROTOCOL 2.5-4, 5.8-8, 3.5-8",
        |trial| beside(trial, noise),
    ),
    (
        2,
        "a body with an index that was not granted is refused",
        "PROTOCOL 4.4-2, 4.6-9",
        not_granted,
    ),
    (
        3,
        "a body of another scene is not accessible",
        "PROTOCOL 3.1-3, 4.4-7",
        other_scene,
    ),
    (
        4,
        "datagrams of greased kinds are dropped",
        "PROTOCOL 3.5-8, 3.5-16",
        |trial| beside(trial, greased),
    ),
    (
        5,
        "loss reports for packets that were never sent do not affect others",
        "PROTOCOL 6.7-6, 5.13-1",
        |trial| beside(trial, loss_reports),
    ),
    (
        7,
        "endless pings are answered, each with its number",
        "PROTOCOL 4.2-2",
        |trial| beside(trial, pings),
    ),
    (
        9,
        "random bytes on the control stream end only that connection",
        "PROTOCOL 2.5-3",
        |trial| beside(trial, chance),
    ),
    (
        10,
        "endless requests for snapshots are answered only as often as they can be combined",
        "PROTOCOL 4.8-9",
        |trial| beside(trial, snapshots),
    ),
    (
        11,
        "commands beyond the queue limit of a tick are applied, or close with code 4",
        "PROTOCOL 7-1, 7-2",
        waiting,
    ),
    (
        12,
        "connections that send only hello do not affect others",
        "PROTOCOL 1.4-4, 3.4-1",
        |trial| {
            beside(trial, |trial, _| {
                for _ in 0..60 {
                    let mut client = trial.client()?;
                    client.hello()?;
                    client.connection.close(0);
                }
                Ok(())
            })
        },
    ),
    (
        13,
        "a client cannot learn a scene's name",
        "PROTOCOL 3.1-3, 4.7-1",
        |trial| {
            let mut client = trial.client()?;
            client.hello()?;
            client.create(lockstep())?;
            let mut other = trial.client()?;
            let welcome = other.hello()?;
            ensure(welcome.scene.is_none(), "its scene does not exist")?;
            other.send(&ClientMessage::Join(NORMAL));
            let received = other.barrier()?;
            ensure(
                matches!(received[..], [ServerMessage::Denied(_)]),
                format!("denied, not {received:?}"),
            )
        },
    ),
];

/// Cases that wait for a timer of the server.
const SLOW: &[CaseRow] = &[(
    8,
    "a client that does not read is closed before it affects others",
    "PROTOCOL 3.4-2, 7-2",
    never_reads,
)];

pub(super) fn cases() -> Vec<Case> {
    let cases = table("L5.1", &[Feature::Lockstep], CASES);
    cases
        .chain(table("L5.1", &[Feature::Lockstep], SLOW).map(Case::slow))
        .collect()
}

/// Runs an attack in the same scene as a well-behaved member; then requires that the member continues correctly.
fn beside(
    trial: &mut Trial<'_>,
    does: fn(&mut Trial<'_>, &mut RawClient) -> CaseResult,
) -> CaseResult {
    let mut good = trial.subscriber()?;
    good.create(lockstep())?;
    let granted = good.join(NORMAL)?;
    good.must(ball_shape())?;
    good.must(ball(body(granted, 0)?, Vec3::ZERO, Vec3::X))?;
    let mut attacker = trial.client_of(&good.scene.clone())?;
    attacker.hello()?;
    attacker.join(StreamChoice::Full)?;
    good.advance(Tick::new(10))?;
    does(trial, &mut attacker)?;
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
        "its copy is correct",
    )
}

fn noise(trial: &mut Trial<'_>, attacker: &mut RawClient) -> CaseResult {
    let mut dice = trial.dice();
    for _ in 0..500 {
        let length = dice.below(1_150);
        let bytes: Vec<u8> = (0..length).map(|_| dice.below(256) as u8).collect();
        attacker.send_datagram(&bytes)?;
    }
    attacker.barrier().map(drop)
}

fn greased(_: &mut Trial<'_>, attacker: &mut RawClient) -> CaseResult {
    for kind in 0..=0xff_u8 {
        attacker.send_datagram(&[kind])?;
        attacker.send_datagram(&[kind, 0, 1, 2, 3])?;
    }
    attacker.send_datagram(&[])?;
    attacker.barrier().map(drop)
}

/// The stream of a member.
fn stream(attacker: &mut RawClient) -> Result<StreamId, Stop> {
    attacker.send(&ClientMessage::Resync(ResyncCause::LostSync));
    Ok(attacker.snapshot()?.0.start.stream)
}

fn loss_reports(_: &mut Trial<'_>, attacker: &mut RawClient) -> CaseResult {
    let stream = stream(attacker)?;
    for number in 0..400_u64 {
        let loss_report = LossReport {
            next: Low16::of(number * 97),
            abandoned: Low16::of(number),
            repair_symbols: (number % 33) as u8,
            lost: (0..64).map(|lost| Low16::of(number * 64 + lost)).collect(),
        };
        attacker.send_datagram(&loss_report.encode(stream))?;
    }
    attacker.barrier().map(drop)
}

fn pings(_: &mut Trial<'_>, attacker: &mut RawClient) -> CaseResult {
    let pings: Vec<_> = (0..5_000)
        .map(|number| ClientMessage::Ping {
            sent: Instant::from_nanos(number),
        })
        .collect();
    attacker.send_together(&pings);
    let mut next = 0;
    while next < 5_000 {
        next = attacker.await_message("pong", |message| match message {
            ServerMessage::Pong { sent, .. } => Some(sent.as_nanos() + 1),
            _ => None,
        })?;
    }
    Ok(())
}

fn chance(trial: &mut Trial<'_>, _: &mut RawClient) -> CaseResult {
    let mut dice = trial.dice();
    for _ in 0..40 {
        let mut client = trial.client()?;
        let bytes: Vec<u8> = (0..1 + dice.below(300))
            .map(|_| dice.below(256) as u8)
            .collect();
        client.send_bytes(&bytes);
        // Random bytes may be the start of a message; then the server waits for more.
        client.connection.finish();
    }
    Ok(())
}

fn snapshots(_: &mut Trial<'_>, attacker: &mut RawClient) -> CaseResult {
    attacker.send_together(&vec![ClientMessage::Resync(ResyncCause::LostSync); 500]);
    let received = attacker.barrier()?;
    let reported = received
        .iter()
        .filter(|message| matches!(message, ServerMessage::Joined(_)));
    let reported = reported.count();
    ensure(
        (1..=100).contains(&reported),
        format!("fewer than five hundred, not {reported}"),
    )
}

fn not_granted(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    client.enter(lockstep(), StreamChoice::Full)?;
    client.must(ball_shape())?;
    let beyond = BodyId::new(1_000_000, 0);
    match client.command(ball(beyond, Vec3::ZERO, Vec3::ZERO))? {
        Err(CommandError::NotGranted(id)) => ensure(id == beyond, "the error names it"),
        other => Stop::fail(format!("{other:?}; must be refused with NotGranted")),
    }
}

fn other_scene(trial: &mut Trial<'_>) -> CaseResult {
    let mut one = trial.client()?;
    one.enter(lockstep(), StreamChoice::Full)?;
    one.must(ball_shape())?;
    let id = body(one.granted, 0)?;
    one.must(ball(id, Vec3::ZERO, Vec3::ZERO))?;
    let mut other = trial.client()?;
    other.enter(lockstep(), StreamChoice::Full)?;
    match other.command(Command::RemoveBody { id })? {
        Err(CommandError::UnknownBody(_)) => {}
        came => return Stop::fail(format!("{came:?}; must be refused with UnknownBody")),
    }
    one.must(Command::RemoveBody { id }).map(drop)
}

/// A member that requests snapshots of a large scene and reads none of them.
fn never_reads(trial: &mut Trial<'_>) -> CaseResult {
    let mut good = trial.subscriber()?;
    good.create(lockstep())?;
    let granted = good.join(NORMAL)?;
    good.must(ball_shape())?;
    for place in 0..2_000 {
        let at = Vec3::new((place % 50) as f32 * 3.0, 0.0, (place / 50) as f32 * 3.0);
        let id = body(granted, place)?;
        good.task(|session| session.command(ball(id, at, Vec3::ZERO)))?;
    }
    good.advance(Tick::new(1))?;
    let mut attacker = trial.client_of(&good.scene.clone())?;
    attacker.hello()?;
    attacker.connection.read_control(false);
    attacker.send(&ClientMessage::Join(StreamChoice::Full));
    let mut tick = 1;
    // Each snapshot has some 100 kB; a server may buffer a few MB more than QUIC has in flight.
    for _ in 0..400 {
        attacker.send(&ClientMessage::Resync(ResyncCause::LostSync));
        tick += 1;
        good.advance(Tick::new(tick))?;
        // Bytes from before the pause are processed too: a byte left out would garble the rest.
        attacker.take_in_all()?;
        if let Some(end) = &attacker.ended {
            let overflow = rhumb_netsim::RawPeerEnd::Closed(CONTROL_OVERFLOW);
            ensure(
                *end == overflow,
                format!("close code {CONTROL_OVERFLOW:#x}, not {end}"),
            )?;
            return goes_on(&mut good, tick);
        }
    }
    // It is still open, so the server must have left most of the requests unread or unanswered.
    attacker.connection.read_control(true);
    let answers = attacker.barrier()?;
    let (waited, snapshot) = waited_bytes(&answers, Tick::new(tick));
    let in_flight = RawPeerConfig::default().window_bytes as usize;
    let most = CONTROL_WAITING_BYTES_MAX + snapshot + in_flight;
    ensure(
        waited <= most,
        format!("{waited} bytes waited for the client, {most} are allowed"),
    )?;
    goes_on(&mut good, tick)
}

/// The bytes of messages before the first snapshot of tick `until`, and of the longest snapshot. Snapshots of earlier
/// ticks were made before the client read again.
fn waited_bytes(messages: &[ServerMessage], until: Tick) -> (usize, usize) {
    let (mut waited, mut is_waiting) = (0, true);
    let (mut snapshot, mut longest) = (0, 0);
    for message in messages {
        if let ServerMessage::Joined(joined) = message {
            is_waiting &= joined.start.tick < until;
            snapshot = 0;
        }
        let mut bytes = Vec::new();
        message.encode(&mut bytes);
        snapshot += bytes.len();
        waited += if is_waiting { bytes.len() } else { 0 };
        if *message == ServerMessage::SnapshotEnd {
            longest = longest.max(snapshot);
        }
    }
    (waited, longest)
}

/// Sends commands behind an advance that is not complete yet.
fn waiting(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    client.enter(lockstep(), NORMAL)?;
    let command = ClientMessage::Command(Command::SetGravity {
        gravity: Vec3::ZERO,
    });
    let most = rhumb_protocol::limits::PENDING_COMMANDS_MAX;
    let mut together = vec![ClientMessage::Advance {
        to: Tick::new(rhumb_protocol::limits::ADVANCE_TICKS_MAX),
    }];
    together.resize(most + 500, command);
    client.send_together(&together);
    // However many the server keeps, it reads the rest later and answers all.
    match client.outcome_of(client.commands - 1)? {
        Ok(_) => client.barrier().map(drop),
        Err(error) => Stop::fail(format!("a change of gravity is refused: {error}")),
    }
}
