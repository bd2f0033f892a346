//! L3.3: joints constrain the specified directions, and leave the others free.

use glam::{DVec3, Quat, Vec3};
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, Joint, JointFrame, JointId, JointKind, JointLimits,
};
use rhumb_reckoning::{BodyId, Motion, Tick};

use super::scenery::{BALL, ball, ball_shape, body, lockstep, moving};
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::feature::Feature;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::LossyClient;
use crate::trial::Trial;

/// The cases of the group: promise, citations, test function.
const CASES: &[CaseRow] = &[
    (
        1,
        "a spherical joint keeps a pendulum's length",
        "PROTOCOL 2.6-24, 2.6-23",
        |trial| {
            hangs(trial, JointKind::Spherical(None), |there| {
                let length = there.pose().position.length();
                let off = (length - 2.0).abs();
                ensure(off <= 0.02, format!("2 m from the anchor, not {length}"))
            })
        },
    ),
    (
        2,
        "a spherical joint lets a pendulum swing",
        "PROTOCOL 2.6-24, 2.6-23",
        |trial| {
            let mut lowest = 0.0_f64;
            let mut hanging = hang(trial, JointKind::Spherical(None))?;
            for tick in 1..=90 {
                hanging.subscriber.advance(Tick::new(tick))?;
                lowest = lowest.min(hanging.there()?.pose().position.y);
            }
            ensure(
                lowest <= -1.8,
                format!("it swings down, not only to {lowest} m"),
            )
        },
    ),
    (
        3,
        "a fixed joint holds a body up",
        "PROTOCOL 2.6-24, 2.6-23",
        |trial| {
            hangs(trial, JointKind::Fixed, |there| {
                let off = (there.pose().position - DVec3::X * 2.0).length();
                ensure(off <= 0.05, format!("it stays in place, not {off} m away"))
            })
        },
    ),
    (
        4,
        "a revolute joint turns about its x axis only",
        "PROTOCOL 2.6-24, 2.6-23",
        |trial| {
            // Gravity has no torque about x for a body that lies along x, so the body stays in place.
            hangs(trial, JointKind::Revolute(None), |there| {
                let off = (there.pose().position - DVec3::X * 2.0).length();
                ensure(off <= 0.05, format!("it stays in place, not {off} m away"))
            })
        },
    ),
    (
        5,
        "a prismatic joint slides along its x axis only",
        "PROTOCOL 2.6-24, 2.6-23",
        |trial| {
            let mut hanging = hang(trial, JointKind::Prismatic(None))?;
            let place = hanging.place_after_a_second(Vec3::X)?;
            ensure(
                (place.x - 3.0).abs() <= 0.05,
                format!("it slides by one metre, and is at {place}"),
            )?;
            ensure(
                place.y.abs() <= 0.05,
                format!("it stays at its height, not at {place}"),
            )
        },
    ),
    (
        6,
        "a prismatic joint stops at its limits",
        "PROTOCOL 2.6-24, 2.6-23",
        |trial| {
            let limits = JointLimits {
                least: -0.25,
                most: 0.25,
            };
            let mut hanging = hang(trial, JointKind::Prismatic(Some(limits)))?;
            let place = hanging.place_after_a_second(Vec3::X * 2.0)?;
            ensure(
                (1.7..=2.3).contains(&place.x),
                format!("it stays within 0.25 m, not at {place}"),
            )
        },
    ),
    (
        7,
        "a late joiner receives a joint as it was made",
        "PROTOCOL 2.6-24, 2.6-23",
        reported,
    ),
    (
        8,
        "a body is free after its joint is removed",
        "PROTOCOL 2.6-24, 2.6-23",
        |trial| {
            let mut hanging = hang(trial, JointKind::Fixed)?;
            hanging.subscriber.advance(Tick::new(10))?;
            hanging
                .subscriber
                .must(Command::RemoveJoint { id: JointId(0) })?;
            hanging.subscriber.advance(Tick::new(70))?;
            let height = hanging.there()?.pose().position.y;
            ensure(
                height <= -4.0,
                format!("it falls, and is not still at {height} m"),
            )
        },
    ),
];

pub(super) fn cases() -> Vec<Case> {
    table("L3.3", &[Feature::Lockstep], CASES).collect()
}

/// A ball two metres beside a static one, and a joint between them.
struct HangingBall {
    subscriber: LossyClient,
    body: BodyId,
    joint: Joint,
}

impl HangingBall {
    fn there(&self) -> Result<Motion, Stop> {
        let stream = self.subscriber.replica()?.stream();
        let no_body = || Stop::Fail("the body does not exist".into());
        stream
            .predicted_motion(self.body, stream.complete())
            .ok_or_else(no_body)
    }

    /// The position a second after the ball was given a velocity, m/s.
    fn place_after_a_second(&mut self, linear: Vec3) -> Result<DVec3, Stop> {
        self.subscriber.must(Command::SetVelocity {
            id: self.body,
            linear,
            angular: Vec3::ZERO,
        })?;
        self.subscriber.advance(Tick::new(60))?;
        Ok(self.there()?.pose().position)
    }
}

fn hang(trial: &mut Trial<'_>, kind: JointKind) -> Result<HangingBall, Stop> {
    let mut subscriber = trial.subscriber()?;
    subscriber.create(lockstep())?;
    let granted = subscriber.join(StreamChoice::Full)?;
    let (hook, hanging) = (body(granted, 0)?, body(granted, 1)?);
    subscriber.must(ball_shape())?;
    subscriber.must(Command::AddBody {
        desc: BodyDesc::plain(hook, BodyKind::Fixed, BALL),
        motion: moving(Vec3::ZERO, Vec3::ZERO),
    })?;
    subscriber.must(ball(hanging, Vec3::X * 2.0, Vec3::ZERO))?;
    let frame = |anchor| JointFrame {
        anchor,
        rotation: Quat::IDENTITY,
    };
    let joint = Joint {
        kind,
        bodies: [hook, hanging],
        frames: [frame(Vec3::ZERO), frame(Vec3::X * -2.0)],
        collide: false,
        motors: [None; 6],
        strength: None,
    };
    let id = JointId(0);
    subscriber.must(Command::AddJoint {
        id,
        joint: joint.into(),
    })?;
    Ok(HangingBall {
        subscriber,
        body: hanging,
        joint,
    })
}

/// Checks a condition at every tick of two seconds.
fn hangs(trial: &mut Trial<'_>, kind: JointKind, holds: fn(Motion) -> CaseResult) -> CaseResult {
    let mut hanging = hang(trial, kind)?;
    for tick in 1..=120 {
        hanging.subscriber.advance(Tick::new(tick))?;
        holds(hanging.there()?)?;
    }
    Ok(())
}

fn reported(trial: &mut Trial<'_>) -> CaseResult {
    let limits = JointLimits {
        least: -1.0,
        most: 0.5,
    };
    let hanging = hang(trial, JointKind::Revolute(Some(limits)))?;
    let mut late = trial.client_of(&hanging.subscriber.scene.clone())?;
    late.hello()?;
    let (_, scene_events) = late.join(StreamChoice::Full)?;
    let is_it = |scene_event: &rhumb_protocol::message::SceneEvent| {
        matches!(
            scene_event,
            rhumb_protocol::message::SceneEvent::JointAdded { id: JointId(0), joint } if *joint == hanging.joint
        )
    };
    ensure(
        scene_events.iter().any(is_it),
        format!("as it was made, not {scene_events:?}"),
    )
}
