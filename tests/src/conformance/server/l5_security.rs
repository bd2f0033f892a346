//! L5.1: what nobody may do to others, and what malformed datagrams come to.

use glam::Vec3;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{Command, CommandError};
use rhumb_reckoning::Tick;

use super::scenery::{NORMAL, ball, ball_shape, body, lockstep};
use crate::conformance::case::{Case, Feature};
use crate::conformance::outcome::{Play, Stop, ensure};
use crate::conformance::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    vec![
        Case::server(
            "L5.1.1",
            "datagrams of chance are dropped, and nothing comes of them",
        )
        .cites("PROTOCOL 2.5-4, 5.8-4, 3.5-16")
        .needs(&[Feature::Lockstep])
        .play(noise),
        Case::server(
            "L5.1.2",
            "a body of an index that was not granted is refused",
        )
        .cites("PROTOCOL 4.4-2, 4.6-8")
        .needs(&[Feature::Lockstep])
        .play(not_granted),
        Case::server("L5.1.3", "a body of another scene is not there")
            .cites("PROTOCOL 3.1-3, 4.4-7")
            .needs(&[Feature::Lockstep])
            .play(other_scene),
    ]
}

fn noise(trial: &mut Trial<'_>) -> Play {
    let mut follower = trial.follower()?;
    follower.create(lockstep())?;
    let granted = follower.join(NORMAL)?;
    follower.must(ball_shape())?;
    follower.must(ball(body(granted, 0)?, Vec3::ZERO, Vec3::X))?;
    let mut guest = trial.guest_of(&follower.scene.clone())?;
    guest.hello()?;
    guest.join(StreamChoice::Full)?;
    let mut dice = trial.dice();
    for _ in 0..500 {
        let length = dice.below(200);
        let bytes: Vec<u8> = (0..length).map(|_| dice.below(256) as u8).collect();
        guest.throw(&bytes)?;
    }
    guest.barrier()?;
    follower.advance(Tick::new(30))?;
    guest.barrier().map(drop)
}

fn not_granted(trial: &mut Trial<'_>) -> Play {
    let mut guest = trial.guest()?;
    guest.enter(lockstep(), StreamChoice::Full)?;
    guest.must(ball_shape())?;
    let beyond = rhumb_reckoning::BodyId::new(1_000_000, 0);
    match guest.command(ball(beyond, Vec3::ZERO, Vec3::ZERO))? {
        Err(CommandError::NotGranted(id)) => ensure(id == beyond, "the error names it"),
        other => Stop::fail(format!("{other:?}; must be refused by NotGranted")),
    }
}

fn other_scene(trial: &mut Trial<'_>) -> Play {
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
