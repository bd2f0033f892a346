//! L3.2: what commands do, and what each is refused for.

use glam::{Quat, Vec3};
use rhumb_protocol::message::{
    ClientMessage, RemovalCause, SceneEvent, ServerMessage, StreamChoice,
};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, CommandError, Compound, Heights, Joint, JointFrame, JointId,
    JointKind, Part, Shape, ShapeId,
};
use rhumb_reckoning::BodyId;

use super::scenery::{
    BALL, FLOOR, NORMAL, ball, ball_shape, body, floor, floor_shape, lockstep, moving,
};
use super::{CaseRow, table};
use crate::conformance::case::{Case, Feature};
use crate::conformance::outcome::{CaseResult, Stop, ensure};
use crate::conformance::peer::RawClient;
use crate::conformance::trial::Trial;

/// What is there when a command is refused: a ball, a floor, a kinematic ball, a joint between ball and floor.
struct Fixtures {
    ball: BodyId,
    floor: BodyId,
    lift: BodyId,
    nobody: BodyId,
}

/// What is said, and what it must be refused by.
type Refused = fn(&Fixtures) -> (Command, CommandError);

/// Each error that a single member can come to, with the command that comes to it.
const REFUSED: [(&str, Refused); 17] = [
    ("taking out a body that is not there", |cast| {
        (
            Command::RemoveBody { id: cast.nobody },
            CommandError::UnknownBody(cast.nobody),
        )
    }),
    ("moving a body that is not there", |cast| {
        let (id, linear) = (cast.nobody, Vec3::X);
        let angular = Vec3::ZERO;
        (
            Command::SetVelocity {
                id,
                linear,
                angular,
            },
            CommandError::UnknownBody(id),
        )
    }),
    ("a body of another generation than is there", |cast| {
        let id = BodyId::new(cast.ball.index(), cast.ball.generation() + 1);
        (Command::RemoveBody { id }, CommandError::UnknownBody(id))
    }),
    ("forgetting a shape that is not known", |_| {
        let id = ShapeId(77);
        (Command::RemoveShape { id }, CommandError::UnknownShape(id))
    }),
    ("a body of a shape that is not known", |cast| {
        let shape = ShapeId(77);
        let desc = BodyDesc::plain(cast.nobody, BodyKind::Dynamic, shape);
        let motion = moving(Vec3::Y * 50.0, Vec3::ZERO);
        (
            Command::AddBody { desc, motion },
            CommandError::UnknownShape(shape),
        )
    }),
    ("a body of an index that is in use", |cast| {
        let command = ball(cast.ball, Vec3::Y * 50.0, Vec3::ZERO);
        (command, CommandError::BodyIdTaken(cast.ball))
    }),
    ("a shape of a number that is in use", |_| {
        (ball_shape(), CommandError::ShapeIdTaken(BALL))
    }),
    ("forgetting a shape that a body has", |_| {
        (
            Command::RemoveShape { id: BALL },
            CommandError::ShapeInUse(BALL),
        )
    }),
    ("a force on a static body", |cast| {
        let force = Vec3::X;
        (
            Command::Force {
                id: cast.floor,
                force,
            },
            CommandError::NotPushable(cast.floor),
        )
    }),
    ("an impulse on a kinematic body", |cast| {
        let impulse = Vec3::X;
        (
            Command::Impulse {
                id: cast.lift,
                impulse,
            },
            CommandError::NotPushable(cast.lift),
        )
    }),
    ("a torque on a kinematic body", |cast| {
        let torque = Vec3::X;
        (
            Command::Torque {
                id: cast.lift,
                torque,
            },
            CommandError::NotPushable(cast.lift),
        )
    }),
    ("a torque impulse on a static body", |cast| {
        let impulse = Vec3::X;
        (
            Command::TorqueImpulse {
                id: cast.floor,
                impulse,
            },
            CommandError::NotPushable(cast.floor),
        )
    }),
    ("a velocity of a static body", |cast| {
        let (linear, angular) = (Vec3::X, Vec3::ZERO);
        let id = cast.floor;
        (
            Command::SetVelocity {
                id,
                linear,
                angular,
            },
            CommandError::NotPushable(id),
        )
    }),
    ("letting go of a joint that is not there", |_| {
        let id = JointId(9);
        (Command::RemoveJoint { id }, CommandError::UnknownJoint(id))
    }),
    ("a joint of a number that is in use", |cast| {
        let id = JointId(0);
        let joint = joint(cast.ball, cast.lift);
        (
            Command::AddJoint { id, joint },
            CommandError::JointIdTaken(id),
        )
    }),
    ("a joint of a body to itself", |cast| {
        let joint = joint(cast.ball, cast.ball);
        let id = JointId(1);
        (
            Command::AddJoint { id, joint },
            CommandError::JoinedToItself(cast.ball),
        )
    }),
    ("a joint to a body that is not there", |cast| {
        let joint = joint(cast.ball, cast.nobody);
        let id = JointId(1);
        (
            Command::AddJoint { id, joint },
            CommandError::UnknownBody(cast.nobody),
        )
    }),
];

/// What else each case of the group promises, cites and does.
const CASES: &[CaseRow] = &[
    (
        31,
        "commands that come together are answered by scene_events, then by one Applied",
        "PROTOCOL 4.6-9, 4.6-10",
        together,
    ),
    (
        32,
        "a command of the future is refused with 19, and has a number",
        "PROTOCOL 3.5-13, 4.4-1",
        future,
    ),
    (
        33,
        "a body that is taken out is gone for everybody, with its joints",
        "PROTOCOL 4.4-5, 4.6-2",
        joints_go,
    ),
    (
        34,
        "an index is used again with a greater generation only",
        "PROTOCOL 2.4-2, 4.4-2",
        generations,
    ),
    (
        35,
        "who is no owner may command a body too",
        "PROTOCOL 4.4-3",
        not_owner,
    ),
    (
        39,
        "scene_events of a command are reported to every member alike",
        "PROTOCOL 4.6-5, 4.6-9",
        told_alike,
    ),
    (
        40,
        "a rotation within a thousandth of unit length is taken",
        "PROTOCOL 4.5-2, 4.5-1",
        unit_length,
    ),
    (
        41,
        "what is refused leaves no trace, however many come",
        "PROTOCOL 4.4-7",
        no_trace,
    ),
];

/// Those of shapes without an inside.
const SHEETS: &[CaseRow] = &[(
    36,
    "a dynamic body without an inside is refused with 17",
    "PROTOCOL 2.6-13",
    |trial| no_inside(trial, sheet()?),
)];

/// Those of shapes of parts.
const COMPOUNDS: &[CaseRow] = &[(
    38,
    "a body of no parts is a body",
    "PROTOCOL 2.6-17",
    no_parts,
)];

/// Those of both.
const SHEETS_IN_COMPOUNDS: &[CaseRow] = &[(
    37,
    "a dynamic body with a part without an inside is refused with 17",
    "PROTOCOL 2.6-13",
    |trial| {
        let part = Part {
            position: Vec3::ZERO,
            rotation: Quat::IDENTITY,
            shape: sheet()?,
        };
        let compound = Compound::new(vec![part]);
        no_inside(trial, compound.map(Shape::Compound).map_err(|_| none())?)
    },
)];

pub(super) fn cases() -> Vec<Case> {
    let refused = REFUSED.iter().zip(1..).map(|((what, refused), number)| {
        let name = format!("{what} is refused by its own error, and does nothing");
        Case::server(&format!("L3.2.{number}"), &name)
            .cites("PROTOCOL 4.4-7, 4.6-8, 4.4-4")
            .needs(&[Feature::Lockstep])
            .play(|trial| is_refused(trial, *refused))
    });
    let (lockstep, sheets) = (Feature::Lockstep, Feature::Sheets);
    let compounds = Feature::Compounds;
    refused
        .chain(table("L3.2", &[lockstep], CASES))
        .chain(table("L3.2", &[lockstep, sheets], SHEETS))
        .chain(table("L3.2", &[lockstep, compounds], COMPOUNDS))
        .chain(table(
            "L3.2",
            &[lockstep, sheets, compounds],
            SHEETS_IN_COMPOUNDS,
        ))
        .collect()
}

fn none() -> Stop {
    Stop::Inconclusive("the suite has no such shape".into())
}

fn sheet() -> Result<Shape, Stop> {
    let heights = Heights::new(2, 1.0, 1.0, &[0.0; 4]);
    heights.map(Shape::Heights).map_err(|_| none())
}

fn joint(first: BodyId, second: BodyId) -> Joint {
    let frame = JointFrame {
        anchor: Vec3::ZERO,
        rotation: Quat::IDENTITY,
    };
    Joint {
        kind: JointKind::Spherical(None),
        bodies: [first, second],
        frames: [frame; 2],
        collide: false,
    }
}

fn member(trial: &mut Trial<'_>) -> Result<RawClient, Stop> {
    let mut guest = trial.guest()?;
    guest.enter(lockstep(), NORMAL)?;
    Ok(guest)
}

fn cast(guest: &mut RawClient) -> Result<Fixtures, Stop> {
    let id = |place| body(guest.granted, place);
    let cast = Fixtures {
        ball: id(0)?,
        floor: id(1)?,
        lift: id(2)?,
        nobody: id(3)?,
    };
    guest.must(ball_shape())?;
    guest.must(floor_shape())?;
    guest.must(floor(cast.floor))?;
    guest.must(ball(cast.ball, Vec3::Y * 5.0, Vec3::ZERO))?;
    guest.must(Command::AddBody {
        desc: BodyDesc::plain(cast.lift, BodyKind::Kinematic, BALL),
        motion: moving(Vec3::new(5.0, 5.0, 0.0), Vec3::ZERO),
    })?;
    let joint = joint(cast.ball, cast.floor);
    let id = JointId(0);
    guest.must(Command::AddJoint { id, joint })?;
    Ok(cast)
}

/// What anybody who joins now is reported of the scene.
fn reported(trial: &mut Trial<'_>, guest: &RawClient) -> Result<Vec<SceneEvent>, Stop> {
    let mut late = trial.guest_of(&guest.scene.clone())?;
    late.hello()?;
    Ok(late.join(StreamChoice::Full)?.1)
}

fn is_refused(trial: &mut Trial<'_>, refused: Refused) -> CaseResult {
    let mut guest = member(trial)?;
    let cast = cast(&mut guest)?;
    let before = reported(trial, &guest)?;
    let (command, error) = refused(&cast);
    let outcome = guest.command(command)?;
    ensure(
        outcome == Err(error),
        format!("refused by {error:?}, not {outcome:?}"),
    )?;
    let received = guest.barrier()?;
    ensure(
        received.is_empty(),
        format!("no scene_event of it, not {received:?}"),
    )?;
    ensure(reported(trial, &guest)? == before, "the scene is as before")
}

fn together(trial: &mut Trial<'_>) -> CaseResult {
    let mut guest = member(trial)?;
    let id = body(guest.granted, 0)?;
    let commands = [
        ball_shape(),
        Command::RemoveShape { id: ShapeId(99) },
        ball(id, Vec3::ZERO, Vec3::ZERO),
        Command::RemoveBody { id },
    ];
    guest.say_together(&commands.map(ClientMessage::Command));
    let received = guest.barrier()?;
    let scene_events: Vec<_> = received
        .iter()
        .filter_map(|message| match message {
            ServerMessage::SceneEvent(scene_event) => Some(scene_event),
            _ => None,
        })
        .collect();
    let order = matches!(
        scene_events[..],
        [
            SceneEvent::ShapeAdded { .. },
            SceneEvent::BodyPlaced { .. },
            SceneEvent::BodyRemoved {
                cause: RemovalCause::Command,
                ..
            }
        ]
    );
    ensure(
        order,
        format!("a scene_event of each, in order, not {scene_events:?}"),
    )?;
    let last = matches!(
        received.last(),
        Some(ServerMessage::Applied { through: 3, .. })
    );
    ensure(
        last,
        format!("Applied through the last comes last, not {received:?}"),
    )?;
    let refused =
        |message: &ServerMessage| matches!(message, ServerMessage::Refused { number: 1, .. });
    ensure(
        received.iter().any(refused),
        "and the one that is wrong is refused by its number",
    )
}

fn future(trial: &mut Trial<'_>) -> CaseResult {
    let mut guest = member(trial)?;
    guest.utter(&[5, 7, 0x8a, 1, 2, 3]);
    let outcome = guest.outcome_of(0)?;
    ensure(
        outcome == Err(CommandError::UnknownCommand),
        format!("refused with 19, not {outcome:?}"),
    )?;
    guest.commands = 1;
    guest.must(ball_shape()).map(drop)
}

fn joints_go(trial: &mut Trial<'_>) -> CaseResult {
    let mut guest = member(trial)?;
    let cast = cast(&mut guest)?;
    guest.must(Command::RemoveBody { id: cast.floor })?;
    let left = reported(trial, &guest)?;
    let joint_left =
        |scene_event: &SceneEvent| matches!(scene_event, SceneEvent::JointAdded { .. });
    ensure(!left.iter().any(joint_left), "its joint is gone with it")?;
    let outcome = guest.command(Command::RemoveJoint { id: JointId(0) })?;
    let error = Err(CommandError::UnknownJoint(JointId(0)));
    ensure(
        outcome == error,
        format!("and cannot be let go of, not {outcome:?}"),
    )?;
    let again = joint(cast.ball, cast.lift);
    let id = JointId(0);
    guest.must(Command::AddJoint { id, joint: again }).map(drop)
}

fn generations(trial: &mut Trial<'_>) -> CaseResult {
    let mut guest = member(trial)?;
    guest.must(ball_shape())?;
    let first = body(guest.granted, 0)?;
    let of = |step: u16| BodyId::new(first.index(), first.generation() + step);
    let add = |id| ball(id, Vec3::ZERO, Vec3::ZERO);
    guest.must(add(of(1)))?;
    guest.must(Command::RemoveBody { id: of(1) })?;
    for step in [0, 1] {
        let outcome = guest.command(add(of(step)))?;
        let error = Err(CommandError::BodyIdTaken(of(step)));
        ensure(
            outcome == error,
            format!("generation {step} was there, not {outcome:?}"),
        )?;
    }
    guest.must(add(of(2))).map(drop)
}

fn not_owner(trial: &mut Trial<'_>) -> CaseResult {
    let mut owner = member(trial)?;
    let cast = cast(&mut owner)?;
    let mut other = trial.guest_of(&owner.scene.clone())?;
    other.hello()?;
    other.join(NORMAL)?;
    other.must(Command::Impulse {
        id: cast.ball,
        impulse: Vec3::X,
    })?;
    other.must(Command::RemoveBody { id: cast.ball })?;
    owner.await_message("word that its body is gone", |message| match message {
        ServerMessage::SceneEvent(SceneEvent::BodyRemoved { id, cause }) => {
            (id == cast.ball && cause == RemovalCause::Command).then_some(())
        }
        _ => None,
    })
}

fn no_inside(trial: &mut Trial<'_>, shape: Shape) -> CaseResult {
    let mut guest = member(trial)?;
    let id = ShapeId(5);
    guest.must(Command::AddShape { id, shape })?;
    let motion = moving(Vec3::ZERO, Vec3::ZERO);
    let desc = |kind, place| Ok(BodyDesc::plain(body(guest.granted, place)?, kind, id));
    let dynamic: Result<_, Stop> = desc(BodyKind::Dynamic, 0);
    let still: Result<_, Stop> = desc(BodyKind::Static, 0);
    let (dynamic, still) = (dynamic?, still?);
    let outcome = guest.command(Command::AddBody {
        desc: dynamic,
        motion,
    })?;
    ensure(
        outcome == Err(CommandError::NoInside(id)),
        format!("NoInside, not {outcome:?}"),
    )?;
    let desc = still;
    guest.must(Command::AddBody { desc, motion }).map(drop)
}

fn no_parts(trial: &mut Trial<'_>) -> CaseResult {
    let mut guest = member(trial)?;
    let id = ShapeId(5);
    let compound = Compound::new(Vec::new()).map_err(|_| none())?;
    let shape = Shape::Compound(compound);
    guest.must(Command::AddShape { id, shape })?;
    let desc = BodyDesc::plain(body(guest.granted, 0)?, BodyKind::Dynamic, id);
    let motion = moving(Vec3::ZERO, Vec3::ZERO);
    guest.must(Command::AddBody { desc, motion }).map(drop)
}

fn told_alike(trial: &mut Trial<'_>) -> CaseResult {
    let mut one = member(trial)?;
    let mut other = trial.guest_of(&one.scene.clone())?;
    other.hello()?;
    other.join(StreamChoice::Full)?;
    let scene_events = |received: Vec<ServerMessage>| -> Vec<_> {
        let scene_events = received.into_iter().filter_map(|message| match message {
            ServerMessage::SceneEvent(scene_event) => Some(scene_event),
            _ => None,
        });
        scene_events.collect()
    };
    let forgotten = Command::RemoveShape { id: FLOOR };
    let commands = [ball_shape(), floor_shape(), forgotten];
    one.say_together(&commands.map(ClientMessage::Command));
    let first = scene_events(one.barrier()?);
    let second = scene_events(other.barrier()?);
    ensure(
        first.len() == 3,
        format!("three scene_events, not {first:?}"),
    )?;
    ensure(
        first == second,
        format!("the other hears the same, not {second:?}"),
    )
}

fn unit_length(trial: &mut Trial<'_>) -> CaseResult {
    let mut guest = member(trial)?;
    let cast = cast(&mut guest)?;
    let set = |w: f32| Command::SetPose {
        id: cast.ball,
        position: Vec3::Y * 5.0,
        rotation: Quat::from_xyzw(0.0, 0.0, 0.0, w),
    };
    guest.must(set(1.000_4))?;
    guest.must(set(0.999_6))?;
    let outcome = guest.command(set(1.01))?;
    let refused = matches!(outcome, Err(CommandError::Invalid(_)));
    ensure(
        refused,
        format!("one farther off is refused, not {outcome:?}"),
    )
}

fn no_trace(trial: &mut Trial<'_>) -> CaseResult {
    let mut guest = member(trial)?;
    let cast = cast(&mut guest)?;
    let before = reported(trial, &guest)?;
    for (_, refused) in REFUSED {
        for _ in 0..20 {
            let (command, error) = refused(&cast);
            let outcome = guest.command(command)?;
            ensure(
                outcome == Err(error),
                format!("refused by {error:?}, not {outcome:?}"),
            )?;
        }
    }
    ensure(reported(trial, &guest)? == before, "the scene is as before")
}
