//! L1.4: lifetime of scenes and memberships.

use glam::Vec3;
use rhumb_protocol::message::{ClientMessage, Denial, SceneEvent, ServerMessage, StreamChoice};
use rhumb_protocol::scene::{Command, SceneConfig, Stepping};
use rhumb_reckoning::Tick;

use super::scenery::{NORMAL, ball, ball_shape, body, lockstep};
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::feature::Feature;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::RawClient;
use crate::trial::Trial;

/// The cases of the group: promise, citations, test function.
const CASES: &[CaseRow] = &[
    (
        1,
        "joining a scene that does not exist is denied with 0",
        "PROTOCOL 4.7-1, 4.2-3",
        |trial| {
            let mut client = trial.client()?;
            client.hello()?;
            denied(
                &mut client,
                &ClientMessage::Join(NORMAL),
                Denial::NoSuchScene,
            )
        },
    ),
    (
        2,
        "deleting a scene that does not exist is denied with 0",
        "PROTOCOL 4.7-1",
        |trial| {
            let mut client = trial.client()?;
            client.hello()?;
            denied(&mut client, &ClientMessage::Delete, Denial::NoSuchScene)
        },
    ),
    (
        3,
        "creating a scene that exists is denied",
        "PROTOCOL 3.3-1, 4.7-1",
        |trial| {
            let mut client = trial.client()?;
            client.hello()?;
            client.create(lockstep())?;
            denied(
                &mut client,
                &ClientMessage::Create(lockstep()),
                Denial::SceneExists,
            )
        },
    ),
    (
        4,
        "a welcome contains the configuration of a scene that exists",
        "PROTOCOL 3.1-4",
        |trial| {
            let mut client = trial.client()?;
            client.hello()?;
            client.create(lockstep())?;
            let mut other = trial.client_of(&client.scene.clone())?;
            let reported = other.hello()?.scene;
            ensure(
                reported == Some(lockstep()),
                format!("its configuration, not {reported:?}"),
            )
        },
    ),
    (
        5,
        "a client that is not a member may delete the scene, and all members are notified",
        "PROTOCOL 3.3-1, 3.3-2",
        deleted,
    ),
    (
        6,
        "a client that leaves and joins again starts a new membership and finds its bodies",
        "PROTOCOL 3.3-3, 4.4-1",
        left,
    ),
    (
        7,
        "answers come in the order of their requests",
        "PROTOCOL 4.2-2, 4.2-3",
        in_order,
    ),
    (
        8,
        "a scene name may have 64 bytes of every permitted character",
        "PROTOCOL 2.3-2",
        long_name,
    ),
    (
        9,
        "connections of two scenes receive nothing of each other",
        "PROTOCOL 3.1-3",
        two_scenes,
    ),
    (
        12,
        "a pong contains the number of its ping and the newest tick",
        "PROTOCOL 4.9-5",
        pinged,
    ),
    (
        14,
        "an inspection contains tick and number of bodies",
        "PROTOCOL 4.10-1",
        inspected,
    ),
];

/// Cases that need free-running scenes.
const FREE_RUNNING: &[CaseRow] = &[
    (
        10,
        "a free-running scene pauses while it has no members",
        "PROTOCOL 3.3-4",
        stands_still,
    ),
    (
        11,
        "advancing a free-running scene is denied with 8",
        "PROTOCOL 4.2-3",
        |trial| {
            let mut client = trial.client()?;
            client.enter(free(), NORMAL)?;
            let advance = ClientMessage::Advance { to: Tick::new(5) };
            denied(&mut client, &advance, Denial::NotLockstep)
        },
    ),
    (
        13,
        "a free-running scene keeps the rate of its configuration",
        "PROTOCOL 4.9-6",
        clock,
    ),
];

pub(super) fn cases() -> Vec<Case> {
    let cases = table("L1.4", &[Feature::Lockstep], CASES);
    cases
        .chain(table("L1.4", &[Feature::FreeRunning], FREE_RUNNING))
        .collect()
}

fn free() -> SceneConfig {
    SceneConfig {
        stepping: Stepping::FreeRunning,
        ..lockstep()
    }
}

fn denied(client: &mut RawClient, request: &ClientMessage, denial: Denial) -> CaseResult {
    client.send(request);
    let received = client.barrier()?;
    ensure(
        received == [ServerMessage::Denied(denial)],
        format!("the only answer is the denial {denial}, not {received:?}"),
    )
}

fn deleted(trial: &mut Trial<'_>) -> CaseResult {
    let mut member = trial.client()?;
    member.enter(lockstep(), StreamChoice::Full)?;
    let mut other = trial.client_of(&member.scene.clone())?;
    other.hello()?;
    other.delete()?;
    member.await_message("message that the scene is deleted", |message| {
        matches!(message, ServerMessage::Deleted).then_some(())
    })?;
    // The former member is in the lobby again.
    denied(
        &mut member,
        &ClientMessage::Join(NORMAL),
        Denial::NoSuchScene,
    )?;
    member.create(lockstep())
}

fn left(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    client.enter(lockstep(), NORMAL)?;
    client.must(ball_shape())?;
    let id = body(client.granted, 0)?;
    client.must(ball(id, Vec3::ONE, Vec3::ZERO))?;
    client.send(&ClientMessage::Leave);
    client.await_message("answer to leave", |message| {
        matches!(message, ServerMessage::Left).then_some(())
    })?;
    let (_, scene_events) = client.join(NORMAL)?;
    let is_it = |scene_event: &SceneEvent| {
        matches!(
            scene_event,
            SceneEvent::BodyPlaced { desc, .. } if desc.id == id
        )
    };
    ensure(scene_events.iter().any(is_it), "its body still exists")?;
    // Command numbers of a membership start at 0.
    client.must(Command::RemoveBody { id }).map(drop)
}

fn in_order(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    client.hello()?;
    let mut bytes = Vec::new();
    for message in [
        ClientMessage::Join(NORMAL),
        ClientMessage::Create(lockstep()),
        ClientMessage::Create(lockstep()),
        ClientMessage::Delete,
        ClientMessage::Delete,
    ] {
        message.encode(&mut bytes);
    }
    client.send_bytes(&bytes);
    let received = client.barrier()?;
    let wanted = [
        ServerMessage::Denied(Denial::NoSuchScene),
        ServerMessage::Created,
        ServerMessage::Denied(Denial::SceneExists),
        ServerMessage::Deleted,
        ServerMessage::Denied(Denial::NoSuchScene),
    ];
    ensure(
        received == wanted,
        format!("answers in order, not {received:?}"),
    )
}

fn long_name(trial: &mut Trial<'_>) -> CaseResult {
    let own = trial.scene();
    let mut name = format!("aZ09-_./{own}");
    while name.len() < 64 {
        name.push('.');
    }
    name.truncate(64);
    let scene = name
        .parse()
        .map_err(|_| Stop::Inconclusive("the name is invalid".into()))?;
    let mut client = trial.client_of(&scene)?;
    client.enter(lockstep(), NORMAL)?;
    client.delete()
}

fn two_scenes(trial: &mut Trial<'_>) -> CaseResult {
    let (mut one, mut other) = (trial.client()?, trial.client()?);
    one.enter(lockstep(), StreamChoice::Full)?;
    other.enter(lockstep(), StreamChoice::Full)?;
    one.must(ball_shape())?;
    let id = body(one.granted, 0)?;
    one.must(ball(id, Vec3::ONE, Vec3::ZERO))?;
    one.send(&ClientMessage::Advance { to: Tick::new(5) });
    one.barrier()?;
    let received = other.barrier()?;
    ensure(
        received.is_empty(),
        format!("the other connection receives nothing, not {received:?}"),
    )?;
    ensure(
        other.datagrams.is_empty(),
        "the other connection receives no datagram",
    )
}

/// The tick of a pong, and the time in nanoseconds since it was reached.
fn pong(client: &mut RawClient, number: u64) -> Result<(Tick, u64), Stop> {
    let number = rhumb_protocol::Instant::from_nanos(number);
    client.send(&ClientMessage::Ping { sent: number });
    client.await_message("pong", |message| match message {
        ServerMessage::Pong {
            sent,
            tick,
            since_tick_ns,
        } if sent == number => Some((tick, since_tick_ns)),
        _ => None,
    })
}

fn stands_still(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    client.enter(free(), NORMAL)?;
    client.send(&ClientMessage::Leave);
    client.await_message("answer to leave", |message| {
        matches!(message, ServerMessage::Left).then_some(())
    })?;
    let (before, _) = pong(&mut client, 1)?;
    // Enough time for several ticks, if the scene did not pause.
    let clock = rhumb_transport::Clock::start();
    while clock.now().as_nanos() < 200_000_000 {
        client.barrier()?;
    }
    let (after, _) = pong(&mut client, 2)?;
    ensure(
        before == after,
        format!("it stays at {before}, not {after}"),
    )?;
    let (joined, _) = client.join(NORMAL)?;
    ensure(
        joined.start.tick.value() <= before.value() + 1,
        "it continues from there",
    )
}

fn pinged(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    client.enter(lockstep(), NORMAL)?;
    for number in [0, 1, u64::MAX] {
        let (tick, _) = pong(&mut client, number)?;
        ensure(tick == Tick::ZERO, "no tick was requested")?;
    }
    client.send(&ClientMessage::Advance { to: Tick::new(3) });
    while let Some(_datagram) = client.next_datagram()? {
        if pong(&mut client, 7)?.0 == Tick::new(3) {
            return Ok(());
        }
    }
    Stop::fail("no pong contains the requested tick")
}

fn clock(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    client.enter(free(), NORMAL)?;
    let clock = rhumb_transport::Clock::start();
    let at = |client: &mut RawClient| -> Result<(f64, f64, f64), Stop> {
        let sent = clock.now().as_nanos() as f64;
        let (tick, since) = pong(client, 1)?;
        let received = clock.now().as_nanos() as f64;
        let scene = tick.value() as f64 / 60.0 + since as f64 / 1e9;
        Ok((
            f64::midpoint(sent, received) / 1e9,
            scene,
            (received - sent) / 1e9,
        ))
    };
    let (begin, begin_scene, first) = at(&mut client)?;
    while clock.now().as_nanos() < 700_000_000 {
        client.barrier()?;
    }
    let (end, end_scene, last) = at(&mut client)?;
    let (passed, went) = (end - begin, end_scene - begin_scene);
    // A late server may slow down (3.3-5), but it must not run faster.
    let slack = 2.0 / 60.0 + first + last;
    ensure(
        went <= passed + slack,
        format!("in {passed:.3} s the scene advances by {went:.3} s"),
    )?;
    ensure(
        went >= passed / 2.0 - slack,
        format!("in {passed:.3} s the scene advances by {went:.3} s"),
    )
}

fn inspected(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    client.enter(lockstep(), NORMAL)?;
    client.must(ball_shape())?;
    for place in 0..3 {
        let at = Vec3::X * (3 * place) as f32;
        let id = body(client.granted, place)?;
        client.must(ball(id, at, Vec3::ZERO))?;
    }
    client.send(&ClientMessage::Inspect);
    let reported = client.await_message("inspection", |message| match message {
        ServerMessage::Inspection(reported) => Some(reported),
        _ => None,
    })?;
    ensure(
        reported.bodies == 3 && reported.awake <= 3,
        format!("three bodies, not {}", reported.bodies),
    )?;
    ensure(reported.tick == Tick::ZERO, "no tick was requested")
}
