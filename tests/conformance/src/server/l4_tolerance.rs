//! L4.1: bodies stay within tolerance of the full stream.
//!
//! Two streams follow the same scene, one of them the full one. Every body of the copy is compared at every complete
//! tick. Scenes are this project's scripts, which do not depend on an engine.

use std::num::NonZeroU32;

use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{Command, IdRange, PublishSchedule, SceneConfig, Stepping};
use rhumb_reckoning::{
    BodyId, LengthBound, Metres, Radians, Tick, Ticks, Tolerance, ToleranceScale,
};
use rhumb_sims::{Script, by_name};

use super::scenery::{EXACT, NORMAL};
use crate::case::Case;
use crate::feature::Feature;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::{LaneAction, LossyClient, compare};
use crate::trial::Trial;

/// One scene, and how it is followed.
#[derive(Clone, Copy, Debug)]
struct Setup {
    script: &'static str,
    bodies: u32,
    choice: StreamChoice,
    ticks: u64,
    /// One datagram in this number is lost, one is duplicated, one is delayed; none at zero.
    disturbed: usize,
    /// Publish interval and lookahead, in ticks.
    publish_schedule: (u32, u32),
    /// Number of ticks that are requested ahead.
    depth: u64,
    /// True if bodies have different tolerance scales.
    tolerance_scales: bool,
}

impl Setup {
    const fn of(script: &'static str, bodies: u32, choice: StreamChoice) -> Self {
        Self {
            script,
            bodies,
            choice,
            ticks: 180,
            disturbed: 0,
            publish_schedule: (1, 0),
            depth: 1,
            tolerance_scales: false,
        }
    }
}

pub(super) fn cases() -> Vec<Case> {
    let promise = "PROTOCOL 6.3-7, 6.3-10, 6.1-2, 6.1-4, 6.10-1, 6.8-2, 6.8-4";
    let mut number = 0;
    let mut case = |name: String, cites: &str, setup: Setup| {
        number += 1;
        Case::server(&format!("L4.1.{number}"), &name)
            .cites(promise)
            .cites(cites)
            .needs(&[Feature::Lockstep])
            .play(move |trial| follow(trial, setup))
    };
    let mut cases = Vec::new();
    for (script, bodies, cites) in [
        ("ball-pit", 20, "PROTOCOL 6.2-1, 6.2-4"),
        ("cubes", 12, "PROTOCOL 6.2-6"),
        ("ragdolls", 4, "PROTOCOL 2.6-24"),
        ("stack", 10, "PROTOCOL 6.3-9"),
        ("dominoes", 12, "PROTOCOL 6.3-9"),
        ("tumbler", 12, "PROTOCOL 6.2-3"),
        ("rain", 12, "PROTOCOL 6.13-2, 6.3-5"),
        ("free-fall", 12, "PROTOCOL 6.9-1"),
        ("asteroids", 8, "PROTOCOL 2.6-19, 4.6-3"),
        ("zoo", 12, "PROTOCOL 6.1-5, 6.2-3"),
    ] {
        for (word, choice) in [("five centimetres", NORMAL), ("five millimetres", EXACT)] {
            let name = format!("{script}: the error of every body is within {word} at every tick");
            cases.push(case(name, cites, Setup::of(script, bodies, choice)));
        }
    }
    let (pit, zoo) = (
        Setup::of("ball-pit", 20, NORMAL),
        Setup::of("zoo", 12, EXACT),
    );
    for (name, cites, setup) in disturbed(pit, zoo).into_iter().chain(otherwise(pit, zoo)) {
        cases.push(case(name.to_owned(), cites, setup));
    }
    cases
}

/// Setups with lanes that lose, duplicate and reorder.
fn disturbed(pit: Setup, zoo: Setup) -> Vec<(&'static str, &'static str, Setup)> {
    vec![
        (
            "a ball pit on a bad lane: complete ticks are within tolerance",
            "PROTOCOL 6.7-3, 6.6-13, 6.6-14, 6.8-5, 6.7-8",
            Setup {
                disturbed: 6,
                ..pit
            },
        ),
        (
            "a zoo on a bad lane: complete ticks are within tolerance",
            "PROTOCOL 6.7-3, 6.13-7, 6.13-12, 6.6-8",
            Setup {
                disturbed: 5,
                ..zoo
            },
        ),
        (
            "a tumbler on a bad lane: attached bodies are within tolerance too",
            "PROTOCOL 6.7-3, 6.8-4",
            Setup {
                disturbed: 6,
                ..Setup::of("tumbler", 12, EXACT)
            },
        ),
        (
            "a zoo that is published every other tick, on a bad lane",
            "PROTOCOL 6.3-1",
            Setup {
                publish_schedule: (2, 0),
                depth: 2,
                disturbed: 6,
                ..zoo
            },
        ),
    ]
}

/// Setups with other tolerances or other steps.
fn otherwise(pit: Setup, zoo: Setup) -> Vec<(&'static str, &'static str, Setup)> {
    let parts = Tolerance::parts(Metres::new(0.01), Radians::new(0.002)).expect("within range");
    let coarse = LengthBound::from_micrometres(200_000).expect("within range");
    vec![
        (
            "a ball pit with separate bounds for position and rotation",
            "PROTOCOL 4.2-1",
            Setup {
                choice: StreamChoice::Within(parts),
                ..pit
            },
        ),
        (
            "a ball pit within twenty centimetres",
            "PROTOCOL 4.2-1",
            Setup {
                choice: StreamChoice::Within(Tolerance::Surface(coarse)),
                ..pit
            },
        ),
        (
            "a ball pit with tolerance scales: each body is within its own tolerance",
            "PROTOCOL 2.6-13",
            Setup {
                tolerance_scales: true,
                ..pit
            },
        ),
        (
            "a zoo with tolerance scales: each body is within its own tolerance",
            "PROTOCOL 2.6-13",
            Setup {
                tolerance_scales: true,
                ..zoo
            },
        ),
        (
            "a ball pit whose ticks are requested ten ahead",
            "PROTOCOL 4.9-1, 6.3-12",
            Setup { depth: 10, ..pit },
        ),
        (
            "a ball pit that is published every third tick",
            "PROTOCOL 5.6-18, 6.3-1, 6.3-2, 4.9-3",
            Setup {
                publish_schedule: (3, 0),
                depth: 3,
                ..pit
            },
        ),
    ]
}

/// Follows a script by two streams, one of them the full one, and compares them at every published tick.
fn follow(trial: &mut Trial<'_>, setup: Setup) -> CaseResult {
    let scene = trial.scene();
    let unknown = || Stop::Inconclusive(format!("no script {}", setup.script));
    let mut script =
        by_name(setup.script, setup.bodies, trial.conditions.seed).ok_or_else(unknown)?;
    let mut leader = trial.subscriber_of(&scene)?;
    let (publish_interval, lookahead) = setup.publish_schedule;
    let config = SceneConfig {
        stepping: Stepping::Lockstep,
        publish_schedule: PublishSchedule {
            publish_interval: NonZeroU32::new(publish_interval).unwrap_or(NonZeroU32::MIN),
            lookahead: Ticks::new(lookahead),
        },
        ..script.config()
    };
    leader.create(config)?;
    leader.join(setup.choice)?;
    let mut truth = trial.subscriber_of(&scene)?;
    truth.greet()?;
    truth.join(StreamChoice::Full)?;
    disturb(trial, &mut leader, setup.disturbed);
    let mut worst = 0.0_f64;
    let mut judged = 0;
    for tick in 0..setup.ticks {
        command(
            &mut leader,
            script.as_mut(),
            Tick::new(tick),
            setup.tolerance_scales,
        )?;
        let to = Tick::new(tick + 1);
        if (tick + 1) % setup.depth == 0 {
            leader.advance(to)?;
        } else {
            leader.ask_for(to)?;
        }
        if config.publish_schedule.publishes(to) && (tick + 1) % setup.depth == 0 {
            truth.complete(to)?;
            worst = worst.max(compare(leader.replica()?, truth.replica()?, to, 1.0)?);
            judged += 1;
        }
    }
    trial.note(format!(
        "{judged} ticks; at worst {worst:.3} of the tolerance"
    ));
    let received = leader.replica()?.stream().statistics();
    ensure(
        received.mismatches == 0,
        "every checksum over tracks equals the copy's own",
    )
}

fn disturb(trial: &Trial<'_>, subscriber: &mut LossyClient, one_in: usize) {
    if one_in == 0 {
        return;
    }
    let mut dice = trial.dice();
    subscriber.filter_datagrams(move |_| match dice.below(one_in) {
        0 => LaneAction::Lost,
        1 if dice.below(2) == 0 => LaneAction::Twice,
        1 => LaneAction::Late,
        _ => LaneAction::Comes,
    });
}

/// Sends the script's commands of a tick, with body ids in the granted range.
fn command(
    leader: &mut LossyClient,
    script: &mut dyn Script,
    tick: Tick,
    tolerance_scales: bool,
) -> CaseResult {
    let mut commands = Vec::new();
    script.commands(tick, &mut commands);
    for mut command in commands {
        rename(&mut command, leader.granted)?;
        if tolerance_scales && let Command::AddBody { desc, .. } = &mut command {
            let step = (desc.id.index() % 7) as i8 - 3;
            desc.tolerance_scale = ToleranceScale::new(step).unwrap_or(ToleranceScale::USUAL);
        }
        leader.task(|session| session.command(command))?;
    }
    Ok(())
}

/// Moves the body ids of a command into the granted range: scripts count them from zero.
pub(super) fn rename(command: &mut Command, granted: IdRange) -> CaseResult {
    let named = |id: &mut BodyId| -> CaseResult {
        let first = granted.id(0).map_or(0, BodyId::generation);
        if id.index() >= granted.count() {
            return Err(Stop::Inconclusive("the script has too many bodies".into()));
        }
        *id = BodyId::new(granted.first() + id.index(), first + id.generation());
        Ok(())
    };
    match command {
        Command::AddBody { desc, .. } | Command::ChangeBody { desc } => named(&mut desc.id),
        Command::RemoveBody { id }
        | Command::SetPose { id, .. }
        | Command::SetVelocity { id, .. }
        | Command::Force { id, .. }
        | Command::Torque { id, .. }
        | Command::Impulse { id, .. }
        | Command::TorqueImpulse { id, .. }
        | Command::ForceAt { id, .. }
        | Command::ImpulseAt { id, .. }
        | Command::Sleep { id }
        | Command::Wake { id } => named(id),
        Command::AddJoint { joint, .. } | Command::ChangeJoint { joint, .. } => {
            joint.bodies.iter_mut().try_for_each(named)
        }
        Command::AddShape { .. }
        | Command::RemoveShape { .. }
        | Command::SetGravity { .. }
        | Command::RemoveJoint { .. }
        | Command::SetEvents { .. }
        | Command::SetLocomotion { .. }
        | Command::Jump { .. }
        | Command::SetWheels { .. } => Ok(()),
    }
}
