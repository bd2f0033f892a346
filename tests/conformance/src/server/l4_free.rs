//! L4.2: free-running scenes, streams that change, and budgets.

use std::num::NonZeroU32;
use std::time::Duration;

use glam::Vec3;
use rhumb_protocol::limits::TICK_JUMP_MAX;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{Command, PublishSchedule, SceneConfig, Stepping};
use rhumb_protocol::session::Event;
use rhumb_protocol::stream::Budget;
use rhumb_reckoning::{Tick, Ticks, Tolerance};

use super::scenery::{EXACT, NORMAL, ball, ball_shape, body, floor, floor_shape, lockstep};
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::feature::Feature;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::{LaneAction, LossyClient, compare, compare_recorded, datagram};
use crate::trial::Trial;

/// The cases of the group: promise, citations, test function.
const CASES: &[CaseRow] = &[
    (
        1,
        "a free-running scene keeps its tolerance",
        "PROTOCOL 6.3-7, 3.3-4, 6.8-2",
        |trial| runs(trial, NORMAL, 0, (1, 0)),
    ),
    (
        2,
        "a free-running scene keeps its tolerance on a bad lane",
        "PROTOCOL 6.3-7, 6.8-4, 6.15-2",
        |trial| runs(trial, EXACT, 8, (1, 0)),
    ),
];

/// Cases that need other features.
const FREE_RUNNING_SCHEDULE: &[CaseRow] = &[(
    3,
    "a free-running scene publishes every other tick with a lookahead of three ticks",
    "PROTOCOL 6.3-1, 6.3-3",
    |trial| runs(trial, NORMAL, 0, (2, 3)),
)];

/// Cases that wait for a timer of the server.
const SLOW: &[CaseRow] = &[(
    4,
    "an idle stream sends watermarks at increasing intervals",
    "PROTOCOL 6.4-2",
    silence,
)];

/// Cases that need other features.
const LOCKSTEP: &[CaseRow] = &[
    (
        5,
        "a member that changes its stream stays within tolerance all the time",
        "PROTOCOL 4.8-8, 4.8-10, 4.8-12, 4.8-13",
        changes,
    ),
    (
        6,
        "a late joiner has the same copy as an earlier member",
        "PROTOCOL 6.11-1, 6.11-2, 6.11-3, 6.1-2, 6.13-5",
        late,
    ),
    (
        7,
        "a member that requests a new snapshot has the same copy as the others",
        "PROTOCOL 4.8-5, 6.11-1",
        resyncs,
    ),
    (
        8,
        "a scene continues after a pause",
        "PROTOCOL 4.9-1, 6.4-1",
        pause,
    ),
    (
        10,
        "a change of gravity applies to tracks that are sent afterwards",
        "PROTOCOL 6.9-1, 6.9-2, 6.9-3, 6.9-5",
        gravity,
    ),
    (
        11,
        "the tracks of two members of one stream are bit-identical",
        "PROTOCOL 6.1-2, 6.6-14, 6.12-1, 6.12-2",
        same,
    ),
];

/// Cases that need other features.
const LOCKSTEP_BUDGETS: &[CaseRow] = &[(
    9,
    "a stream with a budget states its error scale",
    "PROTOCOL 6.16-1, 6.16-5, 6.16-9, 6.16-11, 5.17-1",
    budget,
)];

pub(super) fn cases() -> Vec<Case> {
    let cases = table("L4.2", &[Feature::FreeRunning], CASES);
    cases
        .chain(table(
            "L4.2",
            &[Feature::FreeRunning, Feature::PublishSchedule],
            FREE_RUNNING_SCHEDULE,
        ))
        .chain(table("L4.2", &[Feature::FreeRunning], SLOW).map(Case::slow))
        .chain(table("L4.2", &[Feature::Lockstep], LOCKSTEP))
        .chain(table(
            "L4.2",
            &[Feature::Lockstep, Feature::Budgets],
            LOCKSTEP_BUDGETS,
        ))
        .collect()
}

/// Adds balls that fall onto a floor, a few at a time, from above one another.
fn balls(subscriber: &mut LossyClient, count: u32) -> CaseResult {
    let granted = subscriber.granted;
    subscriber.must(ball_shape())?;
    subscriber.must(floor_shape())?;
    subscriber.must(floor(body(granted, 0)?))?;
    for place in 1..=count {
        let at = Vec3::new(
            (place % 4) as f32 * 0.8,
            1.0 + place as f32,
            (place % 3) as f32 * 0.7,
        );
        subscriber.must(ball(body(granted, place)?, at, Vec3::ZERO))?;
    }
    Ok(())
}

fn enter(
    trial: &mut Trial<'_>,
    config: SceneConfig,
    choice: StreamChoice,
) -> Result<LossyClient, Stop> {
    let mut subscriber = trial.subscriber()?;
    subscriber.create(config)?;
    subscriber.join(choice)?;
    Ok(subscriber)
}

fn beside(
    trial: &mut Trial<'_>,
    other: &LossyClient,
    choice: StreamChoice,
) -> Result<LossyClient, Stop> {
    let mut subscriber = trial.subscriber_of(&other.scene.clone())?;
    subscriber.greet()?;
    subscriber.join(choice)?;
    Ok(subscriber)
}

fn runs(
    trial: &mut Trial<'_>,
    choice: StreamChoice,
    disturbed: usize,
    publish_schedule: (u32, u32),
) -> CaseResult {
    let config = SceneConfig {
        stepping: Stepping::FreeRunning,
        publish_schedule: PublishSchedule {
            publish_interval: NonZeroU32::new(publish_schedule.0).unwrap_or(NonZeroU32::MIN),
            lookahead: Ticks::new(publish_schedule.1),
        },
        ..lockstep()
    };
    let mut copy = enter(trial, config, choice)?;
    let mut truth = beside(trial, &copy, StreamChoice::Full)?;
    balls(&mut copy, 8)?;
    if disturbed > 0 {
        let mut dice = trial.dice();
        copy.filter_datagrams(move |_| {
            if dice.below(disturbed) == 0 {
                LaneAction::Lost
            } else {
                LaneAction::Comes
            }
        });
    }
    copy.record();
    truth.record();
    for _ in 0..60 {
        copy.turn_for(Duration::from_millis(10));
        truth.turn_for(Duration::from_millis(10));
    }
    let is_published = |subscriber: &LossyClient| {
        let ticks = subscriber.recorded.iter().flatten().map(|(tick, _)| *tick);
        ticks
            .skip(1)
            .all(|tick| config.publish_schedule.publishes(tick))
    };
    ensure(
        is_published(&truth),
        "complete ticks are the published ones",
    )?;
    let compared = compare_recorded(&copy, &truth)?;
    ensure(
        compared >= 10,
        format!("enough ticks are comparable, not only {compared}"),
    )
}

fn silence(trial: &mut Trial<'_>) -> CaseResult {
    let config = SceneConfig {
        stepping: Stepping::FreeRunning,
        gravity: Vec3::ZERO,
        ..lockstep()
    };
    let mut subscriber = enter(trial, config, NORMAL)?;
    subscriber.turn_for(Duration::from_secs(3));
    let before = subscriber.arrived;
    subscriber.turn_for(Duration::from_secs(6));
    let came = subscriber.arrived - before;
    // One every 150 ticks: two or three in six seconds, and an answer or two to earlier loss reports.
    ensure(
        (1..=8).contains(&came),
        format!("{came} datagrams came in six idle seconds"),
    )
}

fn changes(trial: &mut Trial<'_>) -> CaseResult {
    let mut copy = enter(trial, lockstep(), NORMAL)?;
    let mut truth = beside(trial, &copy, StreamChoice::Full)?;
    balls(&mut copy, 8)?;
    let mut tick = 0;
    for choice in [EXACT, StreamChoice::Full, NORMAL] {
        copy.task(|session| session.subscribe(choice))?;
        let mut waited = 0;
        // Packets before the new snapshot are lost to the new copy, and are refreshed while the scene advances.
        while waited < 20 || (waited < 2_000 && copy.replica()?.choice() != choice) {
            (tick, waited) = (tick + 1, waited + 1);
            copy.advance(Tick::new(tick))?;
            truth.complete(Tick::new(tick))?;
            compare(copy.replica()?, truth.replica()?, Tick::new(tick), 1.0)?;
        }
        let now = copy.replica()?.choice();
        ensure(now == choice, format!("it follows {choice:?}, not {now:?}"))?;
    }
    Ok(())
}

/// Requires that two copies of one stream are bit-identical at a tick.
fn alike(one: &LossyClient, other: &LossyClient, tick: Tick) -> CaseResult {
    let (one, other) = (one.replica()?, other.replica()?);
    let sums = (
        one.stream().state_checksum(),
        other.stream().state_checksum(),
    );
    ensure(
        sums.0 == sums.1,
        format!("their checksums at {tick} are {sums:x?}"),
    )?;
    for desc in one.bodies() {
        let id = desc.id;
        let predicted_motion = one.stream().predicted_motion(id, tick);
        ensure(
            predicted_motion == other.stream().predicted_motion(id, tick),
            format!("the motions of {id} at {tick} are equal"),
        )?;
    }
    ensure(
        one.bodies().count() == other.bodies().count(),
        "they hold the same bodies",
    )
}

fn late(trial: &mut Trial<'_>) -> CaseResult {
    let mut first = enter(trial, lockstep(), EXACT)?;
    balls(&mut first, 10)?;
    let mut others: Vec<LossyClient> = Vec::new();
    for tick in 1..=60 {
        let tick = Tick::new(tick);
        if tick.value().is_multiple_of(20) {
            others.push(beside(trial, &first, EXACT)?);
        }
        first.advance(tick)?;
        for other in &mut others {
            other.complete(tick)?;
            alike(&first, other, tick)?;
        }
    }
    Ok(())
}

fn resyncs(trial: &mut Trial<'_>) -> CaseResult {
    let mut first = enter(trial, lockstep(), EXACT)?;
    balls(&mut first, 10)?;
    first.advance(Tick::new(30))?;
    let mut other = beside(trial, &first, EXACT)?;
    // All datagrams are lost for so long that only a snapshot helps.
    let last = 30 + TICK_JUMP_MAX + 400;
    other.filter_datagrams(move |bytes| match datagram::tick_of(bytes) {
        // In this scene the tick fits into its low bits.
        Some(tick) if u64::from(tick) > last => LaneAction::Comes,
        _ => LaneAction::Lost,
    });
    for tick in (30..=last + 1).step_by(200).chain([last + 1]) {
        first.advance(Tick::new(tick))?;
    }
    let tick = Tick::new(last + 1);
    other.complete(tick)?;
    if other.resyncs == 0 {
        return Err(Stop::Inconclusive(
            "the suite did not request a snapshot".into(),
        ));
    }
    alike(&first, &other, tick)
}

fn pause(trial: &mut Trial<'_>) -> CaseResult {
    let mut subscriber = enter(trial, lockstep(), EXACT)?;
    balls(&mut subscriber, 4)?;
    subscriber.advance(Tick::new(20))?;
    let before = subscriber.arrived;
    subscriber.turn_for(Duration::from_millis(300));
    ensure(
        subscriber.arrived == before,
        "no packet comes while no tick is requested",
    )?;
    let tick = subscriber.replica()?.stream().complete();
    ensure(tick == Tick::new(20), "the scene pauses")?;
    for tick in 21..=40 {
        subscriber.advance(Tick::new(tick))?;
    }
    Ok(())
}

fn budget(trial: &mut Trial<'_>) -> CaseResult {
    let choice = StreamChoice::Capped {
        tolerance: Tolerance::EXACT,
        budget: Budget::new(1_000, 1_150)
            .ok_or_else(|| Stop::Inconclusive("the budget is invalid".into()))?,
    };
    let mut copy = enter(trial, lockstep(), choice)?;
    let mut truth = beside(trial, &copy, StreamChoice::Full)?;
    balls(&mut copy, 20)?;
    let mut exceeded = 0;
    for tick in 1..=180 {
        let tick = Tick::new(tick);
        copy.advance(tick)?;
        truth.complete(tick)?;
        let factor = copy.replica()?.stream().error_scale_at(tick);
        let factor =
            factor.ok_or_else(|| Stop::Fail(format!("no error scale is stated for {tick}")))?;
        exceeded += u32::from(factor > 1.0);
        compare(copy.replica()?, truth.replica()?, tick, factor)?;
    }
    ensure(
        exceeded > 0,
        "the error scale must exceed one: a thousand bytes per second are too few for twenty balls",
    )
}

fn gravity(trial: &mut Trial<'_>) -> CaseResult {
    let mut copy = enter(trial, lockstep(), NORMAL)?;
    let mut truth = beside(trial, &copy, StreamChoice::Full)?;
    balls(&mut copy, 6)?;
    let mut late = None;
    for tick in 1..=120_u64 {
        let at = Tick::new(tick);
        if tick.is_multiple_of(30) {
            let way = [Vec3::X, Vec3::Y, Vec3::NEG_Y][(tick / 30 % 3) as usize];
            copy.must(Command::SetGravity { gravity: way * 4.0 })?;
            copy.must(Command::SetGravity { gravity: way * 8.0 })?;
        }
        copy.advance(at)?;
        truth.complete(at)?;
        compare(copy.replica()?, truth.replica()?, at, 1.0)?;
        if tick == 65 {
            late = Some(beside(trial, &copy, NORMAL)?);
        }
        if let Some(late) = &mut late {
            late.complete(at)?;
            alike(&copy, late, at)?;
        }
    }
    Ok(())
}

fn same(trial: &mut Trial<'_>) -> CaseResult {
    let mut one = enter(trial, lockstep(), EXACT)?;
    let mut other = beside(trial, &one, EXACT)?;
    balls(&mut one, 10)?;
    let mut dice = trial.dice();
    other.filter_datagrams(move |_| {
        if dice.below(5) == 0 {
            LaneAction::Lost
        } else {
            LaneAction::Comes
        }
    });
    for tick in 1..=90 {
        let tick = Tick::new(tick);
        one.advance(tick)?;
        // A member that requests a tick notices its loss soon; another one waits for seconds (6.7-2).
        other.advance(tick)?;
        alike(&one, &other, tick)?;
    }
    let reported = other
        .events
        .iter()
        .any(|event| matches!(event, Event::ChecksumMismatch));
    ensure(!reported, "each checksum equals the one of the copy")
}
