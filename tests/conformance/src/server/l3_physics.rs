//! L3.1: motion of bodies, with any physics engine.
//!
//! Tolerances allow an engine that integrates once per tick of the scene.

use glam::{DVec3, Vec3};
use rhumb_protocol::message::StreamChoice;
use rhumb_reckoning::{BodyId, Motion, Tick};

use super::scenery::{
    EXACT, G, RADIUS, ball, ball_shape, body, floor, floor_shape, lockstep, weightless,
};
use crate::case::Case;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::LossyClient;
use crate::trial::Trial;

/// Ticks per second.
pub(super) const SECOND: u64 = 60;
/// Duration of a tick, in seconds.
pub(super) const TICK: f64 = 1.0 / 60.0;

pub(super) fn cases() -> Vec<Case> {
    let case = Case::lockstep_server;
    vec![
        case(
            "L3.1.1",
            "a ball falls with the acceleration of gravity",
            "PROTOCOL 2.6-17, 4.4-6",
        )
        .play(falls),
        case(
            "L3.1.2",
            "a ball without forces keeps its velocity",
            "PROTOCOL 2.6-17",
        )
        .play(coasts),
        case(
            "L3.1.3",
            "a ball that falls on a floor comes to rest there",
            "PROTOCOL 2.6-16, 6.3-9",
        )
        .play(rests),
    ]
}

/// A member of a new scene with the ball's shape, and the first body id that it may add.
pub(super) fn alone(
    trial: &mut Trial<'_>,
    gravity: bool,
    choice: StreamChoice,
) -> Result<(LossyClient, BodyId), Stop> {
    let mut subscriber = trial.subscriber()?;
    let config = lockstep();
    subscriber.create(if gravity { config } else { weightless(config) })?;
    let granted = subscriber.join(choice)?;
    subscriber.must(ball_shape())?;
    Ok((subscriber, body(granted, 0)?))
}

/// The motion of a body at the newest tick.
pub(super) fn now(subscriber: &LossyClient, id: BodyId) -> Result<Motion, Stop> {
    let stream = subscriber.replica()?.stream();
    let no_body = || Stop::Fail(format!("{id} does not exist"));
    stream
        .predicted_motion(id, stream.complete())
        .ok_or_else(no_body)
}

fn falls(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = alone(trial, true, StreamChoice::Full)?;
    subscriber.must(ball(id, Vec3::new(0.0, 100.0, 0.0), Vec3::ZERO))?;
    subscriber.advance(Tick::new(SECOND))?;
    let motion = now(&subscriber, id)?;
    let fallen = 100.0 - motion.pose().position.y;
    let g = f64::from(G);
    // Engines may integrate velocity or position first: a difference of half a tick's path in each direction.
    ensure(
        (fallen - g / 2.0).abs() <= g * TICK,
        format!("it falls by g/2 in a second, not {fallen}"),
    )?;
    let speed = motion.twist().linear.y;
    ensure(
        (speed + g).abs() <= g * TICK,
        format!("its speed is g then, not {speed}"),
    )?;
    let aside = motion.pose().position.x.abs() + motion.pose().position.z.abs();
    ensure(aside <= 1e-6, "it falls straight down")
}

fn coasts(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = alone(trial, false, StreamChoice::Full)?;
    subscriber.must(ball(id, Vec3::ZERO, Vec3::new(3.0, -2.0, 1.0)))?;
    subscriber.advance(Tick::new(SECOND))?;
    let motion = now(&subscriber, id)?;
    let way = DVec3::new(3.0, -2.0, 1.0);
    let off = (motion.pose().position - way).length();
    ensure(
        off <= 1e-3,
        format!("it moves with its velocity, not {off} m off"),
    )?;
    let slower = (motion.twist().linear - way).length();
    ensure(
        slower <= 1e-4,
        format!("it keeps its velocity, not {slower} m/s off"),
    )
}

fn rests(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = alone(trial, true, EXACT)?;
    let under = body(subscriber.granted, 1)?;
    subscriber.must(floor_shape())?;
    subscriber.must(floor(under))?;
    subscriber.must(ball(id, Vec3::new(0.0, 1.5, 0.0), Vec3::ZERO))?;
    for second in 1..=8 {
        subscriber.advance(Tick::new(second * SECOND))?;
    }
    let height = now(&subscriber, id)?.pose().position.y;
    let off = (height - f64::from(RADIUS)).abs();
    // Engines let bodies overlap or keep them apart by up to a centimetre.
    ensure(
        off <= 0.01,
        format!("it lies on the floor, not {off} m away"),
    )?;
    let floor = now(&subscriber, under)?.pose().position.y;
    ensure(floor == -1.0, "a fixed body does not move")?;
    let track = subscriber.replica()?.stream().track(id);
    let rest = track.is_some_and(|track| track.is_exact_rest());
    ensure(
        rest,
        "after some seconds it sleeps, and its track is an exact rest",
    )
}
