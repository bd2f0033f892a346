//! L1.6: a server refuses declared missing features, and grants all others.
//!
//! So a server cannot pass by a false declaration: it fails if it grants a feature that `--without` declares as
//! missing.

use std::num::NonZeroU32;

use glam::Vec3;
use rhumb_protocol::message::{ClientMessage, ServerMessage, StreamChoice, TakeAuthority};
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, Compound, Heights, PublishSchedule, SceneConfig, Shape, ShapeId,
    Stepping,
};
use rhumb_protocol::stream::Budget;
use rhumb_reckoning::{Ticks, Tolerance};

use super::scenery::{BALL, NORMAL, ball_shape, body, lockstep, moving};
use crate::case::Case;
use crate::feature::Feature;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::RawClient;
use crate::trial::Trial;

/// Returns true if a server grants a feature, and false if it refuses it as the protocol requires.
type FeatureCheck = fn(&mut Trial<'_>) -> Result<bool, Stop>;

const FEATURES: [(Feature, &str, FeatureCheck); 7] = [
    (Feature::Lockstep, "a lockstep scene", |trial| {
        created(trial, lockstep())
    }),
    (Feature::FreeRunning, "a free-running scene", |trial| {
        created(trial, free())
    }),
    (
        Feature::PublishSchedule,
        "a scene with a publish schedule",
        |trial| {
            let publish_schedule = PublishSchedule {
                publish_interval: NonZeroU32::new(2).unwrap_or(NonZeroU32::MIN),
                lookahead: Ticks::new(3),
            };
            created(
                trial,
                SceneConfig {
                    publish_schedule,
                    ..free()
                },
            )
        },
    ),
    (Feature::Budgets, "a stream with a budget", budget),
    (Feature::Authority, "authority over bodies", authority),
    (Feature::Sheets, "a shape without a volume", |trial| {
        let heights = Heights::new(2, 1.0, 1.0, &[0.0; 4]).map(Shape::Heights);
        made(
            trial,
            heights.map_err(|_| Stop::Inconclusive("the height field is invalid".into()))?,
        )
    }),
    (Feature::Compounds, "a compound shape", |trial| {
        let compound = Compound::new(Vec::new()).map(Shape::Compound);
        made(
            trial,
            compound.map_err(|_| Stop::Inconclusive("the compound is invalid".into()))?,
        )
    }),
];

pub(super) fn cases() -> Vec<Case> {
    let cases = FEATURES.iter().zip(1..).map(|(row, number)| {
        let (feature, what, asked) = row;
        let name = format!("{what} is granted if supported, and refused if declared missing");
        Case::server(&format!("L1.6.{number}"), &name)
            .cites("PROTOCOL 4.7-1, 7-3")
            .play(move |trial| claimed(trial, *feature, *asked))
    });
    cases.collect()
}

fn claimed(trial: &mut Trial<'_>, feature: Feature, asked: FeatureCheck) -> CaseResult {
    let lacks = trial.conditions.without.contains(&feature);
    let granted = asked(trial)?;
    match (lacks, granted) {
        (true, false) => Err(Stop::Unsupported("declared missing, and refused".into())),
        (true, true) => Stop::fail("the feature is declared missing, but granted"),
        (false, granted) => ensure(granted, "the feature is not declared missing, but refused"),
    }
}

/// A configuration with a stepping mode that the server supports.
fn any(trial: &Trial<'_>) -> SceneConfig {
    if trial.conditions.without.contains(&Feature::Lockstep) {
        free()
    } else {
        lockstep()
    }
}

fn free() -> SceneConfig {
    SceneConfig {
        stepping: Stepping::FreeRunning,
        ..lockstep()
    }
}

/// True if the next answer is the expected one, false if it is a denial; the connection stays open in both cases.
fn granted(client: &mut RawClient, yes: fn(&ServerMessage) -> bool) -> Result<bool, Stop> {
    let answer = client.await_message("answer", |message| match message {
        ServerMessage::Denied(_) | ServerMessage::AuthorityDenied(_) => Some(false),
        other => yes(&other).then_some(true),
    })?;
    client.barrier()?;
    Ok(answer)
}

fn created(trial: &mut Trial<'_>, config: SceneConfig) -> Result<bool, Stop> {
    let mut client = trial.client()?;
    client.hello()?;
    client.send(&ClientMessage::Create(config));
    let created = granted(&mut client, |message| {
        matches!(message, ServerMessage::Created)
    })?;
    let mut other = trial.client_of(&client.scene.clone())?;
    let exists = other.hello()?.scene.is_some();
    ensure(
        exists == created,
        "the scene exists if and only if it was created",
    )?;
    Ok(created)
}

fn budget(trial: &mut Trial<'_>) -> Result<bool, Stop> {
    let none = || Stop::Inconclusive("the budget is invalid".into());
    let mut client = trial.client()?;
    client.hello()?;
    client.create(any(trial))?;
    client.send(&ClientMessage::Join(StreamChoice::Capped {
        tolerance: Tolerance::NORMAL,
        budget: Budget::per_second(8_000).ok_or_else(none)?,
    }));
    granted(&mut client, |message| {
        matches!(message, ServerMessage::Joined(_))
    })
}

fn authority(trial: &mut Trial<'_>) -> Result<bool, Stop> {
    let mut client = trial.client()?;
    client.enter(any(trial), NORMAL)?;
    client.must(ball_shape())?;
    let id = body(client.granted, 0)?;
    client.must(Command::AddBody {
        desc: BodyDesc::plain(id, BodyKind::Kinematic, BALL),
        motion: moving(Vec3::ZERO, Vec3::ZERO),
    })?;
    client.send(&ClientMessage::TakeAuthority(TakeAuthority {
        tolerance: Tolerance::NORMAL,
        largest_packet: LargestPacket::DEFAULT,
        bodies: vec![id],
    }));
    granted(&mut client, |message| {
        matches!(message, ServerMessage::AuthorityGrant(_))
    })
}

fn made(trial: &mut Trial<'_>, shape: Shape) -> Result<bool, Stop> {
    let mut client = trial.client()?;
    client.enter(any(trial), NORMAL)?;
    let id = ShapeId(3);
    let made = client.command(Command::AddShape { id, shape })?;
    Ok(made.is_ok())
}
