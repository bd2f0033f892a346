//! L3.2: effects of commands, and the errors that refuse them.

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
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::feature::Feature;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::RawClient;
use crate::trial::Trial;

/// The scene in which commands are refused: a ball, a floor, a kinematic ball, a joint between ball and floor.
struct Fixtures {
    ball: BodyId,
    floor: BodyId,
    lift: BodyId,
    missing: BodyId,
}

/// A command, and the error that must refuse it.
type Refused = fn(&Fixtures) -> (Command, CommandError);

/// Each error that one member can cause, with a command that causes it.
const REFUSED: [(&str, Refused); 17] = [
    ("removing a body that does not exist", |fixtures| {
        (
            Command::RemoveBody {
                id: fixtures.missing,
            },
            CommandError::UnknownBody(fixtures.missing),
        )
    }),
    ("moving a body that does not exist", |fixtures| {
        let (id, linear) = (fixtures.missing, Vec3::X);
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
    ("a body with the wrong generation", |fixtures| {
        let id = BodyId::new(fixtures.ball.index(), fixtures.ball.generation() + 1);
        (Command::RemoveBody { id }, CommandError::UnknownBody(id))
    }),
    ("removing a shape that does not exist", |_| {
        let id = ShapeId(77);
        (Command::RemoveShape { id }, CommandError::UnknownShape(id))
    }),
    (
        "adding a body with a shape that does not exist",
        |fixtures| {
            let shape = ShapeId(77);
            let desc = BodyDesc::plain(fixtures.missing, BodyKind::Dynamic, shape);
            let motion = moving(Vec3::Y * 50.0, Vec3::ZERO);
            (
                Command::AddBody { desc, motion },
                CommandError::UnknownShape(shape),
            )
        },
    ),
    ("adding a body with an index in use", |fixtures| {
        let command = ball(fixtures.ball, Vec3::Y * 50.0, Vec3::ZERO);
        (command, CommandError::BodyIdTaken(fixtures.ball))
    }),
    ("adding a shape with an id in use", |_| {
        (ball_shape(), CommandError::ShapeIdTaken(BALL))
    }),
    ("removing a shape that a body uses", |_| {
        (
            Command::RemoveShape { id: BALL },
            CommandError::ShapeInUse(BALL),
        )
    }),
    ("applying a force to a fixed body", |fixtures| {
        let force = Vec3::X;
        (
            Command::Force {
                id: fixtures.floor,
                force,
            },
            CommandError::NotPushable(fixtures.floor),
        )
    }),
    ("applying an impulse to a kinematic body", |fixtures| {
        let impulse = Vec3::X;
        (
            Command::Impulse {
                id: fixtures.lift,
                impulse,
            },
            CommandError::NotPushable(fixtures.lift),
        )
    }),
    ("applying a torque to a kinematic body", |fixtures| {
        let torque = Vec3::X;
        (
            Command::Torque {
                id: fixtures.lift,
                torque,
            },
            CommandError::NotPushable(fixtures.lift),
        )
    }),
    ("applying a torque impulse to a fixed body", |fixtures| {
        let impulse = Vec3::X;
        (
            Command::TorqueImpulse {
                id: fixtures.floor,
                impulse,
            },
            CommandError::NotPushable(fixtures.floor),
        )
    }),
    ("setting the velocity of a fixed body", |fixtures| {
        let (linear, angular) = (Vec3::X, Vec3::ZERO);
        let id = fixtures.floor;
        (
            Command::SetVelocity {
                id,
                linear,
                angular,
            },
            CommandError::NotPushable(id),
        )
    }),
    ("removing a joint that does not exist", |_| {
        let id = JointId(9);
        (Command::RemoveJoint { id }, CommandError::UnknownJoint(id))
    }),
    ("adding a joint with an id in use", |fixtures| {
        let id = JointId(0);
        let joint = joint(fixtures.ball, fixtures.lift);
        (
            Command::AddJoint {
                id,
                joint: joint.into(),
            },
            CommandError::JointIdTaken(id),
        )
    }),
    ("joining a body to itself", |fixtures| {
        let joint = joint(fixtures.ball, fixtures.ball);
        let id = JointId(1);
        (
            Command::AddJoint {
                id,
                joint: joint.into(),
            },
            CommandError::JoinedToItself(fixtures.ball),
        )
    }),
    ("adding a joint to a body that does not exist", |fixtures| {
        let joint = joint(fixtures.ball, fixtures.missing);
        let id = JointId(1);
        (
            Command::AddJoint {
                id,
                joint: joint.into(),
            },
            CommandError::UnknownBody(fixtures.missing),
        )
    }),
];

/// The other cases of the group: promise, citations, test function.
const CASES: &[CaseRow] = &[
    (
        31,
        "commands in one write are answered by their scene events, then by one Applied",
        "PROTOCOL 4.6-10, 4.6-11",
        together,
    ),
    (
        32,
        "an unknown command is refused with 19, and is counted",
        "PROTOCOL 3.5-5, 4.4-1",
        future,
    ),
    (
        33,
        "a removed body is removed for all members, with its joints",
        "PROTOCOL 4.4-5, 4.6-2",
        joints_go,
    ),
    (
        34,
        "an index is reused only with a greater generation",
        "PROTOCOL 2.4-2, 4.4-2",
        generations,
    ),
    (
        35,
        "a member may command another member's body",
        "PROTOCOL 4.4-3",
        not_owner,
    ),
    (
        39,
        "all members receive the same scene events of a command",
        "PROTOCOL 4.6-5, 4.6-10",
        notified_alike,
    ),
    (
        40,
        "a rotation within a thousandth of unit length is accepted",
        "PROTOCOL 4.5-2, 4.5-1",
        unit_length,
    ),
    (
        41,
        "refused commands have no effect, however many come",
        "PROTOCOL 4.4-7",
        no_trace,
    ),
];

/// Cases that need shapes without a volume.
const SHEETS: &[CaseRow] = &[(
    36,
    "a dynamic body without a volume is refused with 17",
    "PROTOCOL 2.6-5",
    |trial| no_inside(trial, sheet()?),
)];

/// Cases that need compound shapes.
const COMPOUNDS: &[CaseRow] = &[(
    38,
    "a body with an empty compound shape is valid",
    "PROTOCOL 2.6-9",
    no_parts,
)];

/// Cases that need both.
const SHEETS_IN_COMPOUNDS: &[CaseRow] = &[(
    37,
    "a dynamic body with a part without a volume is refused with 17",
    "PROTOCOL 2.6-5",
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
        let name = format!("{what} is refused with its own error and has no effect");
        Case::server(&format!("L3.2.{number}"), &name)
            .cites("PROTOCOL 4.4-7, 4.6-9, 4.4-4")
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
    Stop::Inconclusive("the suite built an invalid shape".into())
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
        motors: [None; 6],
        strength: None,
    }
}

fn member(trial: &mut Trial<'_>) -> Result<RawClient, Stop> {
    let mut client = trial.client()?;
    client.enter(lockstep(), NORMAL)?;
    Ok(client)
}

fn fixtures(client: &mut RawClient) -> Result<Fixtures, Stop> {
    let id = |place| body(client.granted, place);
    let fixtures = Fixtures {
        ball: id(0)?,
        floor: id(1)?,
        lift: id(2)?,
        missing: id(3)?,
    };
    client.must(ball_shape())?;
    client.must(floor_shape())?;
    client.must(floor(fixtures.floor))?;
    client.must(ball(fixtures.ball, Vec3::Y * 5.0, Vec3::ZERO))?;
    client.must(Command::AddBody {
        desc: BodyDesc::plain(fixtures.lift, BodyKind::Kinematic, BALL),
        motion: moving(Vec3::new(5.0, 5.0, 0.0), Vec3::ZERO),
    })?;
    let joint = joint(fixtures.ball, fixtures.floor);
    let id = JointId(0);
    client.must(Command::AddJoint {
        id,
        joint: joint.into(),
    })?;
    Ok(fixtures)
}

/// The snapshot of the scene that a late joiner receives.
fn reported(trial: &mut Trial<'_>, client: &RawClient) -> Result<Vec<SceneEvent>, Stop> {
    let mut late = trial.client_of(&client.scene.clone())?;
    late.hello()?;
    Ok(late.join(StreamChoice::Full)?.1)
}

fn is_refused(trial: &mut Trial<'_>, refused: Refused) -> CaseResult {
    let mut client = member(trial)?;
    let fixtures = fixtures(&mut client)?;
    let before = reported(trial, &client)?;
    let (command, error) = refused(&fixtures);
    let outcome = client.command(command)?;
    ensure(
        outcome == Err(error),
        format!("refused with {error:?}, not {outcome:?}"),
    )?;
    let received = client.barrier()?;
    ensure(
        received.is_empty(),
        format!("no scene event, not {received:?}"),
    )?;
    ensure(
        reported(trial, &client)? == before,
        "the scene is unchanged",
    )
}

fn together(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = member(trial)?;
    let id = body(client.granted, 0)?;
    let commands = [
        ball_shape(),
        Command::RemoveShape { id: ShapeId(99) },
        ball(id, Vec3::ZERO, Vec3::ZERO),
        Command::RemoveBody { id },
    ];
    client.send_together(&commands.map(ClientMessage::Command));
    let received = client.barrier()?;
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
        format!("one scene event per command, in order, not {scene_events:?}"),
    )?;
    let last = matches!(
        received.last(),
        Some(ServerMessage::Applied { through: 3, .. })
    );
    ensure(
        last,
        format!("Applied for the last command comes last, not {received:?}"),
    )?;
    let refused =
        |message: &ServerMessage| matches!(message, ServerMessage::Refused { number: 1, .. });
    ensure(
        received.iter().any(refused),
        "the invalid command is refused by its number",
    )
}

fn future(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = member(trial)?;
    client.send_bytes(&[5, 7, 0x8a, 1, 2, 3]);
    let outcome = client.outcome_of(0)?;
    ensure(
        outcome == Err(CommandError::UnknownCommand),
        format!("refused with 19, not {outcome:?}"),
    )?;
    client.commands = 1;
    client.must(ball_shape()).map(drop)
}

fn joints_go(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = member(trial)?;
    let fixtures = fixtures(&mut client)?;
    client.must(Command::RemoveBody { id: fixtures.floor })?;
    let left = reported(trial, &client)?;
    let joint_left =
        |scene_event: &SceneEvent| matches!(scene_event, SceneEvent::JointAdded { .. });
    ensure(!left.iter().any(joint_left), "its joint is removed too")?;
    let outcome = client.command(Command::RemoveJoint { id: JointId(0) })?;
    let error = Err(CommandError::UnknownJoint(JointId(0)));
    ensure(
        outcome == error,
        format!("removing the joint again is refused, not {outcome:?}"),
    )?;
    let again = joint(fixtures.ball, fixtures.lift);
    let id = JointId(0);
    client
        .must(Command::AddJoint {
            id,
            joint: again.into(),
        })
        .map(drop)
}

fn generations(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = member(trial)?;
    client.must(ball_shape())?;
    let first = body(client.granted, 0)?;
    let of = |step: u16| BodyId::new(first.index(), first.generation() + step);
    let add = |id| ball(id, Vec3::ZERO, Vec3::ZERO);
    client.must(add(of(1)))?;
    client.must(Command::RemoveBody { id: of(1) })?;
    for step in [0, 1] {
        let outcome = client.command(add(of(step)))?;
        let error = Err(CommandError::BodyIdTaken(of(step)));
        ensure(
            outcome == error,
            format!("generation {step} was used before, not {outcome:?}"),
        )?;
    }
    client.must(add(of(2))).map(drop)
}

fn not_owner(trial: &mut Trial<'_>) -> CaseResult {
    let mut owner = member(trial)?;
    let fixtures = fixtures(&mut owner)?;
    let mut other = trial.client_of(&owner.scene.clone())?;
    other.hello()?;
    other.join(NORMAL)?;
    other.must(Command::Impulse {
        id: fixtures.ball,
        impulse: Vec3::X,
    })?;
    other.must(Command::RemoveBody { id: fixtures.ball })?;
    owner.await_message(
        "message that its body is removed",
        |message| match message {
            ServerMessage::SceneEvent(SceneEvent::BodyRemoved { id, cause }) => {
                (id == fixtures.ball && cause == RemovalCause::Command).then_some(())
            }
            _ => None,
        },
    )
}

fn no_inside(trial: &mut Trial<'_>, shape: Shape) -> CaseResult {
    let mut client = member(trial)?;
    let id = ShapeId(5);
    client.must(Command::AddShape { id, shape })?;
    let motion = moving(Vec3::ZERO, Vec3::ZERO);
    let desc = |kind, place| Ok(BodyDesc::plain(body(client.granted, place)?, kind, id));
    let dynamic: Result<_, Stop> = desc(BodyKind::Dynamic, 0);
    let still: Result<_, Stop> = desc(BodyKind::Fixed, 0);
    let (dynamic, still) = (dynamic?, still?);
    let outcome = client.command(Command::AddBody {
        desc: dynamic,
        motion,
    })?;
    ensure(
        outcome == Err(CommandError::NoInside(id)),
        format!("NoInside, not {outcome:?}"),
    )?;
    let desc = still;
    client.must(Command::AddBody { desc, motion }).map(drop)
}

fn no_parts(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = member(trial)?;
    let id = ShapeId(5);
    let compound = Compound::new(Vec::new()).map_err(|_| none())?;
    let shape = Shape::Compound(compound);
    client.must(Command::AddShape { id, shape })?;
    let desc = BodyDesc::plain(body(client.granted, 0)?, BodyKind::Dynamic, id);
    let motion = moving(Vec3::ZERO, Vec3::ZERO);
    client.must(Command::AddBody { desc, motion }).map(drop)
}

fn notified_alike(trial: &mut Trial<'_>) -> CaseResult {
    let mut one = member(trial)?;
    let mut other = trial.client_of(&one.scene.clone())?;
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
    one.send_together(&commands.map(ClientMessage::Command));
    let first = scene_events(one.barrier()?);
    let second = scene_events(other.barrier()?);
    ensure(
        first.len() == 3,
        format!("three scene events, not {first:?}"),
    )?;
    ensure(
        first == second,
        format!("the other member receives the same, not {second:?}"),
    )
}

fn unit_length(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = member(trial)?;
    let fixtures = fixtures(&mut client)?;
    let set = |w: f32| Command::SetPose {
        id: fixtures.ball,
        position: Vec3::Y * 5.0,
        rotation: Quat::from_xyzw(0.0, 0.0, 0.0, w),
    };
    client.must(set(1.000_4))?;
    client.must(set(0.999_6))?;
    let outcome = client.command(set(1.01))?;
    let refused = matches!(outcome, Err(CommandError::Invalid(_)));
    ensure(
        refused,
        format!("a greater deviation is refused, not {outcome:?}"),
    )
}

fn no_trace(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = member(trial)?;
    let fixtures = fixtures(&mut client)?;
    let before = reported(trial, &client)?;
    for (_, refused) in REFUSED {
        for _ in 0..20 {
            let (command, error) = refused(&fixtures);
            let outcome = client.command(command)?;
            ensure(
                outcome == Err(error),
                format!("refused with {error:?}, not {outcome:?}"),
            )?;
        }
    }
    ensure(
        reported(trial, &client)? == before,
        "the scene is unchanged",
    )
}
