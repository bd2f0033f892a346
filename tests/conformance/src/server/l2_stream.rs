//! L2.1: the final content of a stream, whatever its lane loses.

use glam::Vec3;
use rhumb_protocol::message::{ClientMessage, ServerMessage, StreamChoice};
use rhumb_reckoning::Tick;

use super::scenery::{NORMAL, ball, ball_shape, body, floor, floor_shape, lockstep};
use crate::case::Case;
use crate::outcome::{CaseResult, Stop, ensure, should};
use crate::peer::{LaneAction, LossyClient};
use crate::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    let case = Case::lockstep_server;
    vec![
        case(
            "L2.1.1",
            "an advance is answered by a stream that is complete at its tick",
            "PROTOCOL 4.9-1, 4.9-2, 6.4-1",
        )
        .play(no_farther),
        case(
            "L2.1.2",
            "on a lane that loses every third datagram everything is refreshed",
            "PROTOCOL 6.7-3, 6.7-8, 6.4-3",
        )
        .play(|trial| {
            let mut subscriber = scene(trial, NORMAL)?;
            let mut count = 0_u32;
            subscriber.filter_datagrams(move |_| {
                count += 1;
                if count.is_multiple_of(3) {
                    LaneAction::Lost
                } else {
                    LaneAction::Comes
                }
            });
            for tick in 1..=60 {
                subscriber.advance(Tick::new(tick))?;
            }
            is_consistent(&subscriber)
        }),
        case(
            "L2.1.3",
            "repeated and late datagrams change nothing",
            "PROTOCOL 6.6-4, 6.6-3",
        )
        .play(|trial| {
            let mut subscriber = scene(trial, NORMAL)?;
            let mut dice = trial.dice();
            subscriber.filter_datagrams(move |_| {
                [LaneAction::Twice, LaneAction::Late, LaneAction::Comes][dice.below(3)]
            });
            for tick in 1..=60 {
                subscriber.advance(Tick::new(tick))?;
            }
            is_consistent(&subscriber)
        }),
        case(
            "L2.1.4",
            "a stream that begins after another has ended has a new id",
            "PROTOCOL 5.8-3, 5.8-4, 6.5-3",
        )
        .play(begins_anew),
    ]
}

/// Steps to the requested tick, and no farther.
fn no_farther(trial: &mut Trial<'_>) -> CaseResult {
    let mut subscriber = scene(trial, NORMAL)?;
    subscriber.advance(Tick::new(10))?;
    let watermark_tick = subscriber.replica()?.stream().watermark_tick();
    ensure(
        watermark_tick == Tick::new(10),
        "no tick beyond the requested one",
    )?;
    // A late joiner sees the newest tick.
    let mut late = trial.client_of(&subscriber.scene)?;
    late.hello()?;
    let (joined, _) = late.join(StreamChoice::Full)?;
    let tick = joined.start.tick;
    ensure(
        tick == Tick::new(10),
        format!("the scene is at tick 10, not {tick}"),
    )
}

/// Datagrams of the previous stream may still be in flight.
fn begins_anew(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    let mut before = client.enter(lockstep(), NORMAL)?.start.stream;
    for _ in 0..8 {
        client.send(&ClientMessage::Leave);
        client.await_message("left", |message| {
            matches!(message, ServerMessage::Left).then_some(())
        })?;
        let (joined, _) = client.join(NORMAL)?;
        let stream = joined.start.stream;
        should(
            stream != before,
            format!("it has a new id, not {stream} again"),
        )?;
        before = stream;
    }
    Ok(())
}

/// A member of a scene with a ball above a floor.
fn scene(trial: &mut Trial<'_>, choice: StreamChoice) -> Result<LossyClient, Stop> {
    let mut subscriber = trial.subscriber()?;
    subscriber.create(lockstep())?;
    let granted = subscriber.join(choice)?;
    subscriber.must(ball_shape())?;
    subscriber.must(floor_shape())?;
    subscriber.must(floor(body(granted, 0)?))?;
    subscriber.must(ball(body(granted, 1)?, Vec3::new(0.0, 3.0, 0.0), Vec3::X))?;
    Ok(subscriber)
}

/// Requires that the copy is complete, and that no checksum differed.
fn is_consistent(subscriber: &LossyClient) -> CaseResult {
    let stream = subscriber.replica()?.stream();
    ensure(stream.is_converged(), "nothing is missing at the end")?;
    let received = stream.statistics();
    ensure(
        received.mismatches == 0,
        "every checksum equals the copy's own",
    )
}
