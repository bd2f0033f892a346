//! L1.8: sessions over several connections.

use glam::Vec3;
use rhumb_protocol::message::{
    ClientMessage, ServerMessage, SessionKey, SessionRequest, SessionState,
};
use rhumb_protocol::scene::{Command, CommandError, ShapeId};
use rhumb_protocol::session::CloseCode;

use super::scenery::{NORMAL, ball, ball_shape, body, lockstep};
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::RawClient;
use crate::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    table("L1.8", &[], ROWS).collect()
}

const ROWS: &[CaseRow] = &[
    (
        1,
        "a session with an unknown key begins, and is announced before joined",
        "PROTOCOL 4.16-2, 4.16-5",
        begins,
    ),
    (
        2,
        "a session continues over another connection, with its numbers and indices",
        "PROTOCOL 4.16-2, 4.16-5, 4.4-1",
        goes_on,
    ),
    (
        3,
        "another connection that takes a session up closes the first one with code 32",
        "PROTOCOL 4.16-4",
        taken,
    ),
    (
        4,
        "refusals that the client has not seen are repeated after the snapshot",
        "PROTOCOL 4.16-6",
        repeats,
    ),
    (
        5,
        "the last key before a join counts",
        "PROTOCOL 4.16-1",
        last_counts,
    ),
    (6, "leaving ends the session", "PROTOCOL 4.16-10", leaving),
    (
        7,
        "a client without a session gets none",
        "PROTOCOL 4.16-5",
        without,
    ),
    (
        8,
        "durable counts the commands of a scene with a command log, and comes from no other",
        "PROTOCOL 4.16-9",
        durable,
    ),
    (
        9,
        "a member that sends a session is closed with code 2",
        "PROTOCOL 4.16-1",
        too_late,
    ),
];

const KEY: SessionKey = SessionKey([0x5a; 16]);

fn request(key: SessionKey, answered: u64) -> ClientMessage {
    ClientMessage::Session(SessionRequest { key, answered })
}

/// Joins with a session, and returns its state.
fn join(client: &mut RawClient, key: SessionKey, answered: u64) -> Result<SessionState, Stop> {
    client.send(&request(key, answered));
    client.send(&ClientMessage::Join(NORMAL));
    let state = client.await_message("session before joined", |message| match message {
        ServerMessage::Session(state) => Some(Ok(state)),
        ServerMessage::Joined(_) => Some(Stop::fail("joined comes without a session")),
        ServerMessage::Denied(denial) => Some(Stop::fail(format!("denied: {denial}"))),
        _ => None,
    })??;
    client.granted = client.snapshot()?.0.granted;
    client.commands = state.commands;
    Ok(state)
}

/// The first connection: a new scene, and a session in it.
fn first(trial: &mut Trial<'_>) -> Result<(RawClient, SessionState), Stop> {
    let mut client = trial.client()?;
    client.hello()?;
    client.create(lockstep())?;
    let state = join(&mut client, KEY, 0)?;
    Ok((client, state))
}

/// Another connection about the same scene.
fn again(trial: &mut Trial<'_>, before: &RawClient) -> Result<RawClient, Stop> {
    let mut client = trial.client_of(&before.scene)?;
    client.hello()?;
    Ok(client)
}

fn begins(trial: &mut Trial<'_>) -> CaseResult {
    let (_client, state) = first(trial)?;
    ensure(!state.resumed, "no session had this key")?;
    ensure(state.commands == 0, "it has no commands yet")
}

fn goes_on(trial: &mut Trial<'_>) -> CaseResult {
    let (mut client, _) = first(trial)?;
    client.must(ball_shape())?;
    let of_first = body(client.granted, 0)?;
    client.must(ball(of_first, Vec3::Y, Vec3::ZERO))?;
    client.connection.close(1);
    let mut second = again(trial, &client)?;
    let state = join(&mut second, KEY, 2)?;
    ensure(state.resumed, "the scene knows the session")?;
    ensure(state.commands == 2, "two commands are done")?;
    let range = (second.granted.first(), second.granted.count());
    let before = (client.granted.first(), client.granted.count());
    ensure(range == before, "the indices are those of the session")?;
    // The answer names number 2, which `must` waits for.
    second.must(Command::RemoveBody { id: of_first }).map(drop)
}

fn taken(trial: &mut Trial<'_>) -> CaseResult {
    let (mut client, _) = first(trial)?;
    let mut second = again(trial, &client)?;
    let state = join(&mut second, KEY, 0)?;
    ensure(state.resumed, "the scene knows the session")?;
    client.must_be_closed(CloseCode::SESSION_TAKEN)?;
    second.barrier().map(drop)
}

fn repeats(trial: &mut Trial<'_>) -> CaseResult {
    let (mut client, _) = first(trial)?;
    client.must(ball_shape())?;
    let unknown = ShapeId(77);
    let refused = client.command(Command::RemoveShape { id: unknown })?;
    ensure(refused.is_err(), "there is no such shape")?;
    client.connection.close(1);
    let mut second = again(trial, &client)?;
    join(&mut second, KEY, 1)?;
    let repeated = second.outcome_of(1)?;
    let expected = Err(CommandError::UnknownShape(unknown));
    ensure(
        repeated == expected,
        format!("the refusal of command 1, not {repeated:?}"),
    )
}

fn last_counts(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    client.hello()?;
    client.create(lockstep())?;
    let other = SessionKey([3; 16]);
    client.send(&request(other, 0));
    join(&mut client, KEY, 0)?;
    client.connection.close(1);
    let mut second = again(trial, &client)?;
    ensure(
        !join(&mut second, other, 0)?.resumed,
        "the first key began no session",
    )?;
    let mut third = again(trial, &client)?;
    ensure(join(&mut third, KEY, 0)?.resumed, "the second key did")
}

fn leaving(trial: &mut Trial<'_>) -> CaseResult {
    let (mut client, _) = first(trial)?;
    client.send(&ClientMessage::Leave);
    client.await_message("left", |message| {
        matches!(message, ServerMessage::Left).then_some(())
    })?;
    let state = join(&mut client, KEY, 0)?;
    ensure(!state.resumed, "the session is over")
}

fn without(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    client.hello()?;
    client.create(lockstep())?;
    client.send(&ClientMessage::Join(NORMAL));
    let has_session = client.await_message("joined", |message| match message {
        ServerMessage::Session(_) => Some(true),
        ServerMessage::Joined(_) => Some(false),
        _ => None,
    })?;
    ensure(!has_session, "it sent no key")
}

fn durable(trial: &mut Trial<'_>) -> CaseResult {
    let (mut client, state) = first(trial)?;
    client.send(&ClientMessage::Command(ball_shape()));
    if state.durable {
        let one =
            |message| matches!(message, ServerMessage::Durable { commands: 1, .. }).then_some(());
        client.await_message("durable", one)?;
        client.connection.close(1);
        // Sends no other command.
        let mut second = again(trial, &client)?;
        join(&mut second, KEY, 1)?;
        return second.await_message("durable again", one);
    }
    client
        .outcome_of(0)?
        .map_err(|error| Stop::Fail(format!("refused: {error}")))?;
    let later = client.barrier()?;
    let durable = |message: &ServerMessage| matches!(message, ServerMessage::Durable { .. });
    ensure(!later.iter().any(durable), "the scene has no command log")
}

fn too_late(trial: &mut Trial<'_>) -> CaseResult {
    let (mut client, _) = first(trial)?;
    client.send(&request(KEY, 0));
    client.must_be_closed(CloseCode::VIOLATION)
}
