//! L4.1: bodies are within their tolerances, as the full stream has them.

use rhumb_protocol::message::StreamChoice;
use rhumb_reckoning::{Tick, Tolerance};
use rhumb_sims::by_name;

use super::scenery::{NORMAL, lockstep};
use crate::conformance::case::{Case, Feature};
use crate::conformance::outcome::{Play, Stop};
use crate::conformance::peer::{Fate, Follower, compare};
use crate::conformance::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    let case = |id: &str, name: &str| {
        Case::server(id, name)
            .cites("PROTOCOL 6.3-7, 6.3-10, 6.1-2, 6.10-1")
            .needs(&[Feature::Lockstep])
    };
    vec![
        case(
            "L4.1.1",
            "balls in a pit are within five centimetres at every tick",
        )
        .play(|trial| follow(trial, "ball-pit", 20, NORMAL, 0)),
        case(
            "L4.1.2",
            "balls in a pit are within half a millimetre at every tick",
        )
        .play(|trial| {
            follow(
                trial,
                "ball-pit",
                20,
                StreamChoice::Within(Tolerance::EXACT),
                0,
            )
        }),
        case(
            "L4.1.3",
            "what a copy is vouched for holds on a lane that loses one in five",
        )
        .play(|trial| follow(trial, "ball-pit", 20, NORMAL, 5)),
    ]
}

/// Follows a script by two streams, one of them the full one, and compares at every tick; `lost`: one datagram in so many.
fn follow(
    trial: &mut Trial<'_>,
    script: &str,
    bodies: u32,
    choice: StreamChoice,
    lost: usize,
) -> Play {
    let scene = trial.scene();
    let unknown = || Stop::Inconclusive(format!("no script {script}"));
    let mut script = by_name(script, bodies, trial.conditions.seed).ok_or_else(unknown)?;
    let mut leader = trial.follower_of(&scene)?;
    leader.create(rhumb_protocol::scene::SceneTerms {
        pace: lockstep().pace,
        cadence: lockstep().cadence,
        ..script.terms()
    })?;
    leader.join(choice)?;
    let mut truth = trial.follower_of(&scene)?;
    truth.greet()?;
    truth.join(StreamChoice::Full)?;
    if lost > 0 {
        let mut dice = trial.dice();
        leader.sift(move |_| {
            if dice.below(lost) == 0 {
                Fate::Lost
            } else {
                Fate::Comes
            }
        });
    }
    for tick in 0..TICKS {
        step(&mut leader, script.as_mut(), Tick::new(tick))?;
        truth.complete(Tick::new(tick + 1))?;
        compare(
            leader.replica()?,
            truth.replica()?,
            Tick::new(tick + 1),
            1.0,
        )?;
    }
    Ok(())
}

const TICKS: u64 = 240;

/// The script's commands of a tick, and the step behind them.
fn step(leader: &mut Follower, script: &mut dyn rhumb_sims::Script, tick: Tick) -> Play {
    let mut commands = Vec::new();
    script.commands(tick, &mut commands);
    for command in commands {
        leader.wish(|session| session.command(command))?;
    }
    leader.advance(tick.next())
}
