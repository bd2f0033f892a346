//! L4.71: a client follows a scene of a server, both from any implementer.
//!
//! Each client is tested with each server. If a case fails here but not with the suite's own peers, client and server
//! interpret the documents differently.

use rhumb_protocol::message::StreamChoice;
use rhumb_reckoning::{LengthBound, Tolerance};

use super::case::{Case, CaseRow};
use super::outcome::{CaseResult, Stop, ensure};
use super::peer::{LivePair, Setting};
use super::trial::Trial;

/// All cases of this module.
pub(super) fn cases() -> Vec<Case> {
    let case = |(number, name, cites, play): &CaseRow| {
        Case::pair(&format!("L4.71.{number}"), name)
            .cites(cites)
            .play(*play)
    };
    CASES.iter().map(case).collect()
}

/// The cases of the group: promise, citations, test function.
const CASES: &[CaseRow] = &[
    (
        1,
        "a client follows a ball pit bit-exactly",
        "PROTOCOL 6.1-2, 6.3-10, 6.11-1; RECKONING 3.4-1",
        |trial| followed(trial, Setting::of("ball-pit", 30)),
    ),
    (
        2,
        "a client follows torque-free rotation bit-exactly",
        "PROTOCOL 6.1-2, 2.6-19; RECKONING 2.6-1, 3.7-1",
        |trial| followed(trial, Setting::of("asteroids", 12)),
    ),
    (
        3,
        "a client follows jointed bodies bit-exactly",
        "PROTOCOL 6.1-2, 4.8-1; RECKONING 4.4-4",
        |trial| followed(trial, Setting::of("ragdolls", 3)),
    ),
    (
        4,
        "a client follows bodies that come to rest bit-exactly",
        "PROTOCOL 6.1-2, 6.3-9; RECKONING 4.7-1",
        |trial| followed(trial, Setting::of("dominoes", 12)),
    ),
    (
        5,
        "a client follows a full stream bit-exactly",
        "PROTOCOL 5.12-1, 6.10-1, 6.10-3",
        |trial| {
            followed(
                trial,
                Setting::of("ball-pit", 20).with_task("subscribe full"),
            )
        },
    ),
    (
        6,
        "a client follows a stream with a budget bit-exactly",
        "PROTOCOL 5.17-1, 6.16-1",
        |trial| {
            let task = "subscribe 1000 budget 2000";
            followed(trial, Setting::of("ball-pit", 40).with_task(task))
        },
    ),
    (
        7,
        "a client that advances the scene receives the ticks bit-exactly",
        "PROTOCOL 4.9-1, 4.9-2, 6.4-1",
        asked_for,
    ),
    (
        8,
        "a client that changes its stream follows the new one bit-exactly",
        "PROTOCOL 4.8-8, 4.8-10, 4.8-12",
        changed,
    ),
];

/// Number of ticks that a client follows.
const TICKS: u64 = 120;

fn followed(trial: &mut Trial<'_>, setting: Setting) -> CaseResult {
    let mut pair = LivePair::begin(trial, &setting, None)?;
    for _ in 0..TICKS {
        pair.step()?;
    }
    pair.must_follow()
}

fn asked_for(trial: &mut Trial<'_>) -> CaseResult {
    let last = 60;
    let task = format!("subscribe 10000 advance {last}");
    let mut pair = LivePair::begin(trial, &Setting::of("ball-pit", 20).with_task(&task), None)?;
    pair.until("sixty ticks", |pair| pair.newest() >= last)?;
    pair.must_follow()?;
    ensure(
        pair.newest() == last,
        "the scene steps only the requested ticks",
    )
}

fn changed(trial: &mut Trial<'_>) -> CaseResult {
    let length = LengthBound::from_micrometres(50_000);
    let length = length.map_err(|_| Stop::Inconclusive("error of the suite".into()))?;
    let choice = StreamChoice::Within(Tolerance::Surface(length));
    let setting = Setting::of("ball-pit", 20).with_task("subscribe 10000 change 50000");
    let mut pair = LivePair::begin(trial, &setting, Some(choice))?;
    for _ in 0..TICKS {
        pair.step()?;
        if pair.has_reported("following") {
            break;
        }
        pair.pass_over();
    }
    pair.until("other stream", |pair| pair.has_reported("following"))?;
    pair.pass_over();
    for _ in 0..TICKS {
        pair.step()?;
    }
    pair.must_follow()
}
