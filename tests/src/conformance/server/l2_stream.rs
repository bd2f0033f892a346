//! L2.1: what a stream brings in the end, whatever its lane loses.

use glam::Vec3;
use rhumb_protocol::message::{ClientMessage, ServerMessage, StreamChoice};
use rhumb_reckoning::Tick;

use super::scenery::{NORMAL, ball, ball_shape, body, floor, floor_shape, lockstep};
use crate::conformance::case::{Case, Feature};
use crate::conformance::outcome::{CaseResult, Stop, ensure, should};
use crate::conformance::peer::{LaneAction, LossyClient};
use crate::conformance::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    let case = |id: &str, name: &str, cites: &str| {
        Case::server(id, name)
            .cites(cites)
            .needs(&[Feature::Lockstep])
    };
    vec![
        case(
            "L2.1.1",
            "an advance is answered by a stream that is complete at its tick",
            "PROTOCOL 4.9-1, 4.9-2, 6.4-1",
        )
        .play(no_farther),
        case(
            "L2.1.2",
            "of a lane that loses every third datagram all is refreshed",
            "PROTOCOL 6.7-3, 6.7-8, 6.4-3",
        )
        .play(|trial| {
            let mut follower = scene(trial, NORMAL)?;
            let mut count = 0_u32;
            follower.sift(move |_| {
                count += 1;
                if count.is_multiple_of(3) {
                    LaneAction::Lost
                } else {
                    LaneAction::Comes
                }
            });
            for tick in 1..=60 {
                follower.advance(Tick::new(tick))?;
            }
            undoubted(&follower)
        }),
        case(
            "L2.1.3",
            "datagrams that come twice or late change nothing",
            "PROTOCOL 6.6-4, 6.6-3",
        )
        .play(|trial| {
            let mut follower = scene(trial, NORMAL)?;
            let mut dice = trial.dice();
            follower.sift(move |_| {
                [LaneAction::Twice, LaneAction::Late, LaneAction::Comes][dice.below(3)]
            });
            for tick in 1..=60 {
                follower.advance(Tick::new(tick))?;
            }
            undoubted(&follower)
        }),
        case(
            "L2.1.4",
            "a stream that begins where one has ended has another id",
            "PROTOCOL 5.8-2, 5.8-6, 6.5-3",
        )
        .play(begins_anew),
    ]
}

/// To the tick that was asked for, and no farther.
fn no_farther(trial: &mut Trial<'_>) -> CaseResult {
    let mut follower = scene(trial, NORMAL)?;
    follower.advance(Tick::new(10))?;
    let watermark_tick = follower.replica()?.stream().watermark_tick();
    ensure(
        watermark_tick == Tick::new(10),
        "nothing beyond what was asked for",
    )?;
    // What it stepped to shows to who joins then.
    let mut late = trial.guest_of(&follower.scene)?;
    late.hello()?;
    let (joined, _) = late.join(StreamChoice::Full)?;
    let tick = joined.start.tick;
    ensure(
        tick == Tick::new(10),
        format!("it stands at 10, and not at {tick}"),
    )
}

/// Datagrams of the stream before may still be on their way.
fn begins_anew(trial: &mut Trial<'_>) -> CaseResult {
    let mut guest = trial.guest()?;
    let mut before = guest.enter(lockstep(), NORMAL)?.start.stream;
    for _ in 0..8 {
        guest.say(&ClientMessage::Leave);
        guest.await_message("left", |message| {
            matches!(message, ServerMessage::Left).then_some(())
        })?;
        let (joined, _) = guest.join(NORMAL)?;
        let stream = joined.start.stream;
        should(
            stream != before,
            format!("it has another id, and not {stream} again"),
        )?;
        before = stream;
    }
    Ok(())
}

/// A member of a scene with a ball above a floor.
fn scene(trial: &mut Trial<'_>, choice: StreamChoice) -> Result<LossyClient, Stop> {
    let mut follower = trial.follower()?;
    follower.create(lockstep())?;
    let granted = follower.join(choice)?;
    follower.must(ball_shape())?;
    follower.must(floor_shape())?;
    follower.must(floor(body(granted, 0)?))?;
    follower.must(ball(body(granted, 1)?, Vec3::new(0.0, 3.0, 0.0), Vec3::X))?;
    Ok(follower)
}

/// That the copy is converged, and no sum was another.
fn undoubted(follower: &LossyClient) -> CaseResult {
    let stream = follower.replica()?.stream();
    ensure(stream.is_converged(), "nothing is missing in the end")?;
    let received = stream.statistics();
    ensure(received.mismatches == 0, "every sum is the copy's own")
}
