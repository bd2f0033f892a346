//! L3.6: bodies and joints change as commands say, and members learn of it.

use glam::Vec3;
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, CommandError, Joint, JointFrame, JointId, JointKind,
    JointStrength, LockedAxes,
};
use rhumb_reckoning::{BodyId, Motion, Tick};

use super::scenery::{BALL, EXACT, ball, ball_shape, body, lockstep, moving};
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
        "a changed gravity scale acts from then on, and members learn of it",
        "PROTOCOL 4.4-6, 4.6-8",
        |trial| {
            let mut falling = Falling::new(trial)?;
            falling.to(30)?;
            let desc = BodyDesc {
                gravity_scale: 0.0,
                ..falling.desc
            };
            falling.subscriber.must(Command::ChangeBody { desc })?;
            falling.to(31)?;
            let known = falling.subscriber.replica()?.body(desc.id);
            ensure(known == Some(desc), format!("{desc:?}, not {known:?}"))?;
            let before = falling.there()?.twist().linear;
            falling.to(91)?;
            let off = (falling.there()?.twist().linear - before).length();
            ensure(
                off <= 0.05,
                format!("it keeps its velocity, not {off} m/s off"),
            )
        },
    ),
    (
        2,
        "a locked axis takes no motion",
        "PROTOCOL 2.6-20, 4.6-8",
        |trial| {
            let mut falling = Falling::new(trial)?;
            let desc = BodyDesc {
                locked: LockedAxes::EACH[1],
                ..falling.desc
            };
            falling.subscriber.must(Command::ChangeBody { desc })?;
            falling.to(60)?;
            let height = falling.there()?.pose().position.y;
            ensure(height.abs() <= 0.01, format!("it stays, not at {height} m"))
        },
    ),
    (
        3,
        "a disabled body stands still, and neither an impulse nor its joint moves it",
        "PROTOCOL 2.6-21, 2.6-27",
        |trial| {
            let mut falling = Falling::new(trial)?;
            falling.to(30)?;
            let desc = BodyDesc {
                enabled: false,
                ..falling.desc
            };
            falling.subscriber.must(Command::ChangeBody { desc })?;
            falling.to(31)?;
            let before = falling.there()?.pose().position;
            let impulse = Vec3::X;
            let outcome = falling.subscriber.command(Command::Impulse {
                id: desc.id,
                impulse,
            })?;
            let error = Err(CommandError::BodyDisabled(desc.id));
            falling.join(Joint::plain(JointKind::Fixed, falling.bodies, CENTRES))?;
            ensure(outcome == error, format!("{error:?}, not {outcome:?}"))?;
            falling.to(91)?;
            let off = (falling.there()?.pose().position - before).length();
            ensure(off <= 0.01, format!("it stands still, not {off} m away"))
        },
    ),
    (
        4,
        "an impulse at a point moves and turns a body",
        "PROTOCOL 4.4-6",
        |trial| {
            let mut falling = Falling::new(trial)?;
            let mass = 1_000.0 * 4.0 / 3.0 * core::f32::consts::PI * 0.125;
            falling.subscriber.must(Command::ImpulseAt {
                id: falling.desc.id,
                impulse: Vec3::Z * mass,
                point: Vec3::X * 0.5,
            })?;
            falling.to(1)?;
            let twist = falling.there()?.twist();
            // Two fifths of the mass times the square of the radius.
            let spin = -0.5 / (0.4 * 0.25);
            let off = (twist.linear.z - 1.0).abs() + (twist.angular.y - spin).abs() * 0.1;
            ensure(
                off <= 0.05,
                format!("1 m/s and {spin} rad/s, not {twist:?}"),
            )
        },
    ),
    (
        5,
        "a rope bounds a distance, and a changed joint acts in its place",
        "PROTOCOL 2.6-24, 4.6-8",
        |trial| {
            let mut falling = Falling::new(trial)?;
            falling.join(Joint::plain(JointKind::Rope(2.5), falling.bodies, CENTRES))?;
            falling.to(120)?;
            let length = falling.there()?.pose().position.distance(POST.as_dvec3());
            ensure(length <= 2.55, format!("at most 2.5 m, not {length}"))?;
            falling.subscriber.must(Command::ChangeJoint {
                id: JointId(0),
                joint: Joint::plain(JointKind::Rope(50.0), falling.bodies, CENTRES).into(),
            })?;
            falling.to(180)?;
            let length = falling.there()?.pose().position.distance(POST.as_dvec3());
            ensure(
                length >= 4.0,
                format!("it falls on, not only to {length} m"),
            )
        },
    ),
    (
        6,
        "a joint that bears more than its strength is removed, and members learn of it",
        "PROTOCOL 2.6-26",
        |trial| {
            let mut falling = Falling::new(trial)?;
            let frames = [JointFrame::at(-POST), JointFrame::at(Vec3::ZERO)];
            let mut joint = Joint::plain(JointKind::Fixed, falling.bodies, frames);
            joint.strength = Some(JointStrength {
                force: 100.0,
                torque: 1e9,
            });
            falling.join(joint)?;
            falling.to(60)?;
            let left = falling.subscriber.replica()?.joints().len();
            ensure(left == 0, "no joint is left")?;
            let height = falling.there()?.pose().position.y;
            ensure(height <= -3.0, format!("it falls, not only to {height} m"))
        },
    ),
];

pub(super) fn cases() -> Vec<Case> {
    table("L3.6", &[Feature::Lockstep], CASES).collect()
}

/// Place of a static ball.
const POST: Vec3 = Vec3::new(-2.0, 0.0, 0.0);
/// Frames of a joint at the centres of its bodies.
const CENTRES: [JointFrame; 2] = [JointFrame::at(Vec3::ZERO); 2];

/// A ball that falls from the origin, and a static one beside it.
struct Falling {
    subscriber: LossyClient,
    desc: BodyDesc,
    bodies: [BodyId; 2],
}

impl Falling {
    fn new(trial: &mut Trial<'_>) -> Result<Self, Stop> {
        let mut subscriber = trial.subscriber()?;
        subscriber.create(lockstep())?;
        let granted = subscriber.join(EXACT)?;
        let bodies = [body(granted, 0)?, body(granted, 1)?];
        subscriber.must(ball_shape())?;
        subscriber.must(Command::AddBody {
            desc: BodyDesc::plain(bodies[0], BodyKind::Fixed, BALL),
            motion: moving(POST, Vec3::ZERO),
        })?;
        subscriber.must(ball(bodies[1], Vec3::ZERO, Vec3::ZERO))?;
        Ok(Self {
            subscriber,
            desc: BodyDesc::plain(bodies[1], BodyKind::Dynamic, BALL),
            bodies,
        })
    }

    fn join(&mut self, joint: Joint) -> CaseResult {
        let id = JointId(0);
        self.subscriber
            .must(Command::AddJoint {
                id,
                joint: joint.into(),
            })
            .map(drop)
    }

    fn to(&mut self, tick: u64) -> CaseResult {
        self.subscriber.advance(Tick::new(tick))
    }

    fn there(&self) -> Result<Motion, Stop> {
        let stream = self.subscriber.replica()?.stream();
        let no_body = || Stop::Fail("the body does not exist".into());
        stream
            .predicted_motion(self.desc.id, stream.complete())
            .ok_or_else(no_body)
    }
}
