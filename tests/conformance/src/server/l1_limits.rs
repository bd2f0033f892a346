//! L1.5: limits: accepted at the limit, refused beyond it.
//!
//! A server may refuse earlier if it uses the right denial (PROTOCOL 7-2, 7-3); then only the denial is checked.

use glam::Vec3;
use rhumb_protocol::limits::{
    ADVANCE_TICKS_MAX, DAMPINGS_MAX, DENSITY_MAX, EXTENT_MAX, GRANT, GRANTED_MAX, MASS_MAX,
    MEMBERS_PER_SCENE_MAX, RANGES_PER_MEMBER_MAX, RESERVE_MAX, SCENES_MAX, STREAMS_PER_SCENE_MAX,
};
use rhumb_protocol::message::{ClientMessage, Denial, ServerMessage, StreamChoice};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, CommandError, IdRange, Invalid, Mass, Material, Quantity, Shape,
};
use rhumb_reckoning::{Damping, LengthBound, Tick, Tolerance};

use super::scenery::{BALL, NORMAL, ball, ball_shape, body, lockstep, moving};
use crate::case::Case;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::RawClient;
use crate::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    let case = Case::lockstep_server;
    let mut cases = of_numbers();
    cases.push(
        case(
            "L1.5.11",
            "a dynamic body beyond MOMENT_MAX is refused; a static one, or one with a mass, is not",
            "PROTOCOL 7-1, 4.5-5",
        )
        .play(moment_most),
    );
    cases.push(
        case(
            "L1.5.12",
            "a push beyond LINEAR_MAX or ANGULAR_MAX is refused with its quantity, and one that slows is not",
            "PROTOCOL 7-1, 4.5-7",
        )
        .play(push_most),
    );
    cases
}

/// Limits of numbers of indices, ranges, ticks, streams, members, dampings and scenes.
fn of_numbers() -> Vec<Case> {
    let case = Case::lockstep_server;
    vec![
        case(
            "L1.5.1",
            "a member is granted GRANT indices of its own",
            "PROTOCOL 4.3-3, 4.4-2, 2.4-1, 7-1",
        )
        .play(granted),
        case(
            "L1.5.2",
            "a reservation grants the requested number of new indices",
            "PROTOCOL 7-1, 4.4-2",
        )
        .play(reserved),
        case(
            "L1.5.3",
            "indices beyond the limit are denied with 7",
            "PROTOCOL 7-2, 7-3",
        )
        .play(granted_most),
        case(
            "L1.5.4",
            "ranges beyond the limit are denied with 7",
            "PROTOCOL 7-1, 7-2, 7-3",
        )
        .play(ranges_most),
        case(
            "L1.5.5",
            "an advance may be ADVANCE_TICKS_MAX ticks ahead, but not one more",
            "PROTOCOL 4.9-4",
        )
        .play(advance_most),
        case(
            "L1.5.6",
            "a scene has at most STREAMS_PER_SCENE_MAX streams, and one more is denied with its code",
            "PROTOCOL 7-1, 7-2, 7-3, 4.7-1",
        )
        .play(streams_most),
        case(
            "L1.5.7",
            "members with the same choice share one stream",
            "PROTOCOL 6.1-1, 5.8-3",
        )
        .play(one_stream),
        case(
            "L1.5.8",
            "a scene has at most MEMBERS_PER_SCENE_MAX members, and one more is denied with its code",
            "PROTOCOL 7-1, 7-2, 7-3, 4.7-1",
        )
        .play(members_most),
        case(
            "L1.5.9",
            "bodies have at most DAMPINGS_MAX dampings, and one more is refused with its error",
            "PROTOCOL 7-1, 7-2, 7-3, 4.4-7",
        )
        .play(dampings_most),
        case(
            "L1.5.10",
            "a server has at most SCENES_MAX scenes",
            "PROTOCOL 7-1, 7-2, 4.7-1",
        )
        .alone()
        .play(scenes_most),
    ]
}

fn member(trial: &mut Trial<'_>) -> Result<RawClient, Stop> {
    let mut client = trial.client()?;
    client.enter(lockstep(), NORMAL)?;
    Ok(client)
}

fn granted(trial: &mut Trial<'_>) -> CaseResult {
    let mut one = member(trial)?;
    let mut other = trial.client_of(&one.scene.clone())?;
    other.hello()?;
    other.join(NORMAL)?;
    let (a, b) = (one.granted, other.granted);
    ensure(
        a.count() == GRANT && b.count() == GRANT,
        format!("{GRANT}, not {a:?} and {b:?}"),
    )?;
    let apart = a.first() + a.count() <= b.first() || b.first() + b.count() <= a.first();
    ensure(apart, format!("{a:?} and {b:?} do not overlap"))?;
    one.must(ball_shape())?;
    for place in [0, GRANT - 1] {
        let at = Vec3::X * place as f32;
        let id = body(one.granted, place)?;
        one.must(ball(id, at, Vec3::ZERO))?;
    }
    let id = body(b, 0)?;
    match one.command(ball(id, Vec3::Y * 9.0, Vec3::ZERO))? {
        Err(CommandError::NotGranted(_)) => Ok(()),
        other => Stop::fail(format!("an index of another member: {other:?}")),
    }
}

fn reserve(client: &mut RawClient, count: u32) -> Result<Result<IdRange, Denial>, Stop> {
    client.send(&ClientMessage::Reserve { count });
    client.await_message("answer to reserve", |message| match message {
        ServerMessage::Reserved(range) => Some(Ok(range)),
        ServerMessage::Denied(denial) => Some(Err(denial)),
        _ => None,
    })
}

fn reserved(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = member(trial)?;
    let more = match reserve(&mut client, 10)? {
        Ok(more) => more,
        Err(denial) => return Stop::fail(format!("ten indices are denied: {denial}")),
    };
    ensure(more.count() == 10, format!("ten indices, not {more:?}"))?;
    let first = client.granted;
    let apart = more.first() >= first.first() + first.count()
        || more.first() + more.count() <= first.first();
    ensure(apart, format!("{more:?} does not overlap {first:?}"))?;
    client.must(ball_shape())?;
    client
        .must(ball(body(more, 9)?, Vec3::ZERO, Vec3::ZERO))
        .map(drop)
}

fn granted_most(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = member(trial)?;
    if reserve_or_be_denied(&mut client, RESERVE_MAX)? {
        ensure(
            !reserve_or_be_denied(&mut client, 1)?,
            format!("one index beyond {GRANTED_MAX} is denied"),
        )?;
    }
    client.barrier().map(drop)
}

fn ranges_most(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = member(trial)?;
    // The first range was granted by joining.
    for _ in 1..RANGES_PER_MEMBER_MAX {
        if !reserve_or_be_denied(&mut client, 1)? {
            return client.barrier().map(drop);
        }
    }
    ensure(
        !reserve_or_be_denied(&mut client, 1)?,
        format!("one range beyond {RANGES_PER_MEMBER_MAX} is denied"),
    )
}

/// True if this number of indices is granted; if not, the denial must be the specified one.
fn reserve_or_be_denied(client: &mut RawClient, count: u32) -> Result<bool, Stop> {
    match reserve(client, count)? {
        Ok(range) => {
            ensure(range.count() == count, format!("{count}, not {range:?}"))?;
            Ok(true)
        }
        Err(denial) => {
            ensure(
                denial == Denial::NoIndicesLeft,
                format!("indices are denied with 7, not with: {denial}"),
            )?;
            Ok(false)
        }
    }
}

fn advance_most(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = member(trial)?;
    let beyond = Tick::new(ADVANCE_TICKS_MAX + 1);
    client.send(&ClientMessage::Advance { to: beyond });
    let received = client.barrier()?;
    let denied = [ServerMessage::Denied(Denial::TooFarAhead)];
    ensure(
        received == denied,
        format!("{beyond} is denied, not {received:?}"),
    )?;
    client.send(&ClientMessage::Advance {
        to: Tick::new(ADVANCE_TICKS_MAX),
    });
    let received = client.barrier()?;
    ensure(
        received.is_empty(),
        format!("{ADVANCE_TICKS_MAX} ticks are accepted, not {received:?}"),
    )
}

/// A choice whose tolerance depends on `number`.
fn within(number: usize) -> StreamChoice {
    let micrometres = 50_000 + number as u32;
    let length = LengthBound::from_micrometres(micrometres).expect("within range");
    StreamChoice::Within(Tolerance::Surface(length))
}

fn streams_most(trial: &mut Trial<'_>) -> CaseResult {
    let mut members = vec![member(trial)?];
    let scene = members[0].scene.clone();
    let mut denied = false;
    while !denied {
        let mut client = trial.client_of(&scene)?;
        client.hello()?;
        denied = !join_or_be_denied(&mut client, within(members.len()), Denial::TooManyStreams)?;
        if denied {
            // Joining an existing stream is still allowed.
            client.join(NORMAL)?;
        }
        members.push(client);
        ensure(
            denied || members.len() <= STREAMS_PER_SCENE_MAX,
            format!("no scene has more than {STREAMS_PER_SCENE_MAX} streams"),
        )?;
    }
    Ok(())
}

/// True if the client becomes a member; if not, this denial is required.
fn join_or_be_denied(
    client: &mut RawClient,
    choice: StreamChoice,
    wanted: Denial,
) -> Result<bool, Stop> {
    client.send(&ClientMessage::Join(choice));
    let received = client.barrier()?;
    let denials = received.iter().find_map(|message| match message {
        ServerMessage::Denied(denial) => Some(*denial),
        _ => None,
    });
    ensure(
        denials.is_none_or(|denial| denial == wanted),
        format!("one more is denied with {wanted:?}, not {received:?}"),
    )?;
    let joined = |message: &ServerMessage| matches!(message, ServerMessage::Joined(_));
    ensure(
        denials.is_some() || received.iter().any(joined),
        format!("a join is answered, not by {received:?}"),
    )?;
    Ok(denials.is_none())
}

fn one_stream(trial: &mut Trial<'_>) -> CaseResult {
    let mut one = trial.client()?;
    let first = one.enter(lockstep(), NORMAL)?;
    let mut other = trial.client_of(&one.scene.clone())?;
    other.hello()?;
    let (same, _) = other.join(NORMAL)?;
    let mut third = trial.client_of(&one.scene.clone())?;
    third.hello()?;
    let (another, _) = third.join(within(7))?;
    ensure(
        same.start.stream == first.start.stream,
        "members with the same choice receive the same stream",
    )?;
    ensure(
        another.start.stream != first.start.stream,
        "another choice has another stream",
    )
}

fn members_most(trial: &mut Trial<'_>) -> CaseResult {
    let mut members = vec![member(trial)?];
    let scene = members[0].scene.clone();
    loop {
        let mut client = trial.client_of(&scene)?;
        client.hello()?;
        if !join_or_be_denied(&mut client, NORMAL, Denial::TooManyMembers)? {
            return Ok(());
        }
        members.push(client);
        ensure(
            members.len() <= MEMBERS_PER_SCENE_MAX,
            format!("no scene has more than {MEMBERS_PER_SCENE_MAX} members"),
        )?;
    }
}

fn dampings_most(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = member(trial)?;
    client.must(ball_shape())?;
    let mut refused = None;
    for number in 0..=DAMPINGS_MAX as u32 {
        let mut desc = BodyDesc::plain(body(client.granted, number)?, BodyKind::Dynamic, BALL);
        desc.damping = Some(Damping {
            linear: 1.0 + number as f32 / 128.0,
            angular: 0.0,
        });
        let motion = moving(Vec3::X * (2 * number) as f32, Vec3::ZERO);
        match client.command(Command::AddBody { desc, motion })? {
            Ok(_) => {}
            Err(error) => {
                refused = Some(error);
                break;
            }
        }
    }
    match refused {
        Some(CommandError::TooManyDampings) => Ok(()),
        // A server that asks for a token may give a client fewer of its own.
        Some(CommandError::OverQuota) if client.token.is_some() => Ok(()),
        other => Stop::fail(format!(
            "one damping beyond {DAMPINGS_MAX} is refused with TooManyDampings, not {other:?}"
        )),
    }
}

fn moment_most(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = member(trial)?;
    let radius = EXTENT_MAX;
    client.must(Command::AddShape {
        id: BALL,
        shape: Shape::Ball { radius },
    })?;
    let mut heavy = BodyDesc::plain(body(client.granted, 0)?, BodyKind::Dynamic, BALL);
    heavy.material = Some(Material {
        density: DENSITY_MAX,
        friction: 0.5,
        restitution: 0.0,
    });
    let motion = moving(Vec3::ZERO, Vec3::ZERO);
    let desc = heavy;
    let beyond = CommandError::Invalid(Invalid::out_of_range(Quantity::Moments));
    match client.command(Command::AddBody { desc, motion })? {
        Err(error) if error == beyond => {}
        other => return Stop::fail(format!("{beyond:?}, not {other:?}")),
    }
    heavy.kind = BodyKind::Fixed;
    let desc = heavy;
    client.must(Command::AddBody { desc, motion })?;
    heavy.kind = BodyKind::Dynamic;
    let desc = heavy;
    match client.command(Command::ChangeBody { desc })? {
        Err(error) if error == beyond => {}
        other => return Stop::fail(format!("{beyond:?}, not {other:?}")),
    }
    heavy.mass = Some(Mass {
        mass: MASS_MAX,
        moments: None,
    });
    let desc = heavy;
    client.must(Command::ChangeBody { desc }).map(drop)
}

fn push_most(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = member(trial)?;
    client.must(ball_shape())?;
    let id = body(client.granted, 0)?;
    let mut desc = BodyDesc::plain(id, BodyKind::Dynamic, BALL);
    let (mass, moments) = (1.0, Some(Vec3::splat(0.1)));
    desc.mass = Some(Mass { mass, moments });
    let motion = moving(Vec3::ZERO, Vec3::ZERO);
    client.must(Command::AddBody { desc, motion })?;
    let impulse = |x: f32| Command::Impulse {
        id,
        impulse: Vec3::X * x,
    };
    let twist = |y: f32| Command::TorqueImpulse {
        id,
        impulse: Vec3::Y * y,
    };
    for (push, beyond) in [
        (impulse(900.0), None),
        (impulse(900.0), Some(Quantity::Linear)),
        (impulse(-1_800.0), None),
        (impulse(-200.0), Some(Quantity::Linear)),
        (twist(9.0), None),
        (twist(9.0), Some(Quantity::Angular)),
        (twist(-18.0), None),
    ] {
        let answer = client.command(push.clone())?;
        let refused = beyond.map(|quantity| CommandError::Invalid(Invalid::out_of_range(quantity)));
        if answer.err() != refused {
            return Stop::fail(format!("{push:?}: {refused:?} is due, not {answer:?}"));
        }
    }
    Ok(())
}

fn scenes_most(trial: &mut Trial<'_>) -> CaseResult {
    let mut clients = Vec::new();
    for _ in 0..=SCENES_MAX {
        let mut client = trial.client()?;
        client.hello()?;
        client.send(&ClientMessage::Create(lockstep()));
        let denied = client.await_message("answer to create", |message| match message {
            ServerMessage::Created => Some(None),
            ServerMessage::Denied(denial) => Some(Some(denial)),
            _ => None,
        })?;
        match denied {
            None => clients.push(client),
            Some(Denial::TooManyScenes) => {
                for client in &mut clients {
                    client.delete()?;
                }
                return client.create(lockstep());
            }
            Some(other) => return Stop::fail(format!("denied: {other}")),
        }
    }
    Stop::fail(format!("it has more than {SCENES_MAX} scenes"))
}
