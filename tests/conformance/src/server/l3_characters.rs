//! L3.8: characters walk and jump, and vehicles roll.
//!
//! The scene is a floor with a body above it. Tolerances allow for any engine.

use glam::Vec3;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{
    BodyDesc, BodyEvent, BodyKind, Character, Command, CommandError, Invalid, JumpFrom, Locomotion,
    Quantity, Shape, ShapeId, Vehicle, Wheel, WheelInput,
};
use rhumb_protocol::session::Event;
use rhumb_reckoning::{BodyId, Tick};

use super::scenery::{RADIUS, ball_shape, body, floor, floor_shape, lockstep, moving};
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::feature::Feature;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::{LossyClient, RawClient};
use crate::trial::Trial;

/// The cases of the group: promise, citations, test function.
const CASES: &[CaseRow] = &[
    (
        1,
        "a character walks by its velocity on the floor",
        "PROTOCOL 4.17-1, 4.17-3",
        walks,
    ),
    (
        2,
        "a character tells of the ground that it reaches and leaves",
        "PROTOCOL 4.17-4, 4.17-5, 4.17-7",
        tells_of_its_ground,
    ),
    (
        3,
        "a pose puts a character elsewhere",
        "PROTOCOL 4.17-6",
        is_put_elsewhere,
    ),
    (
        4,
        "a body that ceases to be kinematic ceases to be a character",
        "PROTOCOL 4.17-2",
        ceases,
    ),
    (
        5,
        "only a kinematic body of one convex shape is a character, only a dynamic one a vehicle",
        "PROTOCOL 4.17-1",
        refuses_bodies,
    ),
    (
        6,
        "a vehicle rolls by the force of its wheels, and stops by their brakes",
        "PROTOCOL 4.17-8, 4.17-9",
        rolls,
    ),
    (
        7,
        "a vehicle takes one input for each wheel",
        "PROTOCOL 4.17-8",
        refuses_inputs,
    ),
];

pub(super) fn cases() -> Vec<Case> {
    table("L3.8", &[Feature::Lockstep], CASES).collect()
}

/// The shape of the bodies that become characters and vehicles.
const CHASSIS: ShapeId = ShapeId(7);
/// Height at which a ball stands on the floor.
const STANDING: f64 = RADIUS as f64;

/// A member of a scene with a floor, and a body above it.
struct OnFloor {
    member: LossyClient,
    body: BodyId,
}

impl OnFloor {
    /// A ball that is a character, on the floor.
    fn character(trial: &mut Trial<'_>) -> Result<Self, Stop> {
        let scene = Self::begin(trial, BodyKind::Kinematic, ball_shape(), RADIUS + 0.03)?;
        let character = Locomotion::Character(Character::default());
        scene.with(character)
    }

    /// A box on four wheels, above the floor.
    fn vehicle(trial: &mut Trial<'_>) -> Result<Self, Stop> {
        let shape = Command::AddShape {
            id: CHASSIS,
            shape: Shape::cuboid(0.8, 0.2, 1.6),
        };
        let scene = Self::begin(trial, BodyKind::Dynamic, shape, 0.75)?;
        scene.with(Locomotion::Vehicle(four_wheels()))
    }

    fn begin(
        trial: &mut Trial<'_>,
        kind: BodyKind,
        shape: Command,
        height: f32,
    ) -> Result<Self, Stop> {
        let mut member = trial.subscriber()?;
        member.create(lockstep())?;
        let granted = member.join(StreamChoice::Full)?;
        let (ground, id) = (body(granted, 0)?, body(granted, 1)?);
        let Command::AddShape { id: shape_id, .. } = shape else {
            return Stop::fail("a case adds a shape");
        };
        for command in [
            floor_shape(),
            shape,
            floor(ground),
            Command::AddBody {
                desc: BodyDesc::plain(id, kind, shape_id),
                motion: moving(Vec3::Y * height, Vec3::ZERO),
            },
        ] {
            member.must(command)?;
        }
        Ok(Self { member, body: id })
    }

    fn with(mut self, locomotion: Locomotion) -> Result<Self, Stop> {
        let (id, locomotion) = (self.body, Box::new(locomotion));
        self.member
            .must(Command::SetLocomotion { id, locomotion })?;
        Ok(self)
    }

    fn advance(&mut self, to: u64) -> CaseResult {
        self.member.advance(Tick::new(to))
    }

    fn place(&self) -> Result<glam::DVec3, Stop> {
        let stream = self.member.replica()?.stream();
        let motion = stream.predicted_motion(self.body, stream.complete());
        let no_body = || Stop::Fail("the body does not exist".into());
        Ok(motion.ok_or_else(no_body)?.pose().position)
    }

    /// Waits for the next event of a body.
    fn event(&mut self) -> Result<(Tick, BodyEvent), Stop> {
        self.member
            .until("an event of a body", |event| match event {
                Event::Body { tick, event } => Some((tick, event)),
                _ => None,
            })
    }
}

fn four_wheels() -> Vehicle {
    let places = [(-0.8, -1.2), (0.8, -1.2), (-0.8, 1.2), (0.8, 1.2)];
    let wheel = |(x, z)| Wheel::at(Vec3::new(x, -0.1, z), 0.3);
    Vehicle {
        wheels: places.map(wheel).to_vec(),
    }
}

fn inputs(id: BodyId, count: usize, force: f32, brake: f32) -> Command {
    let input = WheelInput {
        steering: 0.0,
        force,
        brake,
    };
    Command::SetWheels {
        id,
        inputs: vec![input; count],
    }
}

fn walks(trial: &mut Trial<'_>) -> CaseResult {
    let mut scene = OnFloor::character(trial)?;
    scene.advance(10)?;
    scene.member.must(Command::SetVelocity {
        id: scene.body,
        linear: Vec3::X,
        angular: Vec3::ZERO,
    })?;
    scene.advance(70)?;
    let place = scene.place()?;
    ensure(
        (place.x - 1.0).abs() <= 0.1 && (place.y - STANDING).abs() <= 0.1,
        format!("a metre along x on the floor, not {place}"),
    )
}

fn tells_of_its_ground(trial: &mut Trial<'_>) -> CaseResult {
    let mut scene = OnFloor::character(trial)?;
    let id = scene.body;
    scene.advance(10)?;
    let (tick, event) = scene.event()?;
    ensure(
        event == BodyEvent::ReachedGround(id) && (1..=10).contains(&tick.value()),
        format!("it stands within ten ticks, not {event:?} at {tick:?}"),
    )?;
    let jump = |from| Command::Jump {
        id,
        speed: 4.0,
        from,
    };
    scene.member.must(jump(JumpFrom::Ground))?;
    scene.advance(20)?;
    let (tick, event) = scene.event()?;
    ensure(
        event == BodyEvent::LeftGround(id) && (11..=14).contains(&tick.value()),
        format!("it leaves the ground, not {event:?} at {tick:?}"),
    )?;
    let rises = scene.place()?.y;
    ensure(
        rises > STANDING + 0.3,
        format!("it rises, and is not at {rises} m"),
    )?;
    // In the air this one has no effect.
    scene.member.must(jump(JumpFrom::Ground))?;
    scene.advance(90)?;
    let (tick, event) = scene.event()?;
    ensure(
        event == BodyEvent::ReachedGround(id) && (50..=70).contains(&tick.value()),
        format!("it lands after 0.8 s, not {event:?} at {tick:?}"),
    )
}

fn is_put_elsewhere(trial: &mut Trial<'_>) -> CaseResult {
    let mut scene = OnFloor::character(trial)?;
    scene.advance(5)?;
    scene.member.must(Command::SetPose {
        id: scene.body,
        position: Vec3::new(3.0, 5.0, 0.0),
        rotation: glam::Quat::IDENTITY,
    })?;
    scene.advance(6)?;
    let place = scene.place()?;
    ensure(
        (place - glam::DVec3::new(3.0, 5.0, 0.0)).length() <= 0.01,
        format!("where it was put, not at {place}"),
    )?;
    scene.advance(30)?;
    let fallen = scene.place()?.y;
    ensure(
        fallen < 4.8,
        format!("it falls from there, and is not at {fallen} m"),
    )
}

fn ceases(trial: &mut Trial<'_>) -> CaseResult {
    let mut scene = OnFloor::character(trial)?;
    let id = scene.body;
    let desc = scene.member.replica()?.body(id);
    let desc = desc.ok_or_else(|| Stop::Fail("the body does not exist".into()))?;
    for kind in [BodyKind::Fixed, BodyKind::Kinematic] {
        let desc = BodyDesc { kind, ..desc };
        scene.member.must(Command::ChangeBody { desc })?;
    }
    let jump = Command::Jump {
        id,
        speed: 1.0,
        from: JumpFrom::Anywhere,
    };
    let outcome = scene.member.command(jump)?;
    ensure(
        outcome == Err(CommandError::NotCharacter(id)),
        format!("it is no character, not {outcome:?}"),
    )
}

fn refuses_bodies(trial: &mut Trial<'_>) -> CaseResult {
    let mut client: RawClient = trial.client()?;
    client.enter(lockstep(), StreamChoice::Full)?;
    let (ground, round) = (body(client.granted, 0)?, body(client.granted, 1)?);
    client.must(floor_shape())?;
    client.must(floor(ground))?;
    let sheet = Shape::HalfSpace { normal: Vec3::Y };
    client.must(Command::AddShape {
        id: CHASSIS,
        shape: sheet,
    })?;
    client.must(Command::AddBody {
        desc: BodyDesc::plain(round, BodyKind::Kinematic, CHASSIS),
        motion: moving(Vec3::Y, Vec3::ZERO),
    })?;
    let unknown = body(client.granted, 9)?;
    let character = || Locomotion::Character(Character::default());
    for (id, locomotion, error) in [
        (unknown, character(), CommandError::UnknownBody(unknown)),
        (ground, character(), CommandError::NotKinematic(ground)),
        (round, character(), CommandError::NotConvex(CHASSIS)),
        (
            round,
            Locomotion::Vehicle(four_wheels()),
            CommandError::NotPushable(round),
        ),
    ] {
        let locomotion = Box::new(locomotion);
        let command = Command::SetLocomotion { id, locomotion };
        let outcome = client.command(command.clone())?;
        if let Err(refused @ CommandError::Unsupported) = &outcome {
            return Err(Stop::refused(&command, refused));
        }
        ensure(outcome == Err(error), format!("{error:?}, not {outcome:?}"))?;
    }
    Ok(())
}

fn rolls(trial: &mut Trial<'_>) -> CaseResult {
    let mut scene = OnFloor::vehicle(trial)?;
    scene.advance(60)?;
    let rests = scene.place()?;
    ensure(
        (0.4..=0.8).contains(&rests.y),
        format!("its springs carry it, and it is not at {rests}"),
    )?;
    scene.member.must(inputs(scene.body, 4, 2_000.0, 0.0))?;
    scene.advance(120)?;
    let rolled = scene.place()?;
    ensure(
        rolled.z < rests.z - 0.2,
        format!("it rolls forward, and is not at {rolled}"),
    )?;
    scene.member.must(inputs(scene.body, 4, 0.0, 20_000.0))?;
    scene.advance(240)?;
    let stopped = scene.place()?;
    scene.advance(270)?;
    let later = scene.place()?;
    ensure(
        (later - stopped).length() <= 0.1,
        format!("its brakes hold it at {stopped}, and it is not at {later}"),
    )
}

fn refuses_inputs(trial: &mut Trial<'_>) -> CaseResult {
    let mut scene = OnFloor::vehicle(trial)?;
    let id = scene.body;
    let outcome = scene.member.command(inputs(id, 3, 0.0, 0.0))?;
    let wrong = CommandError::Invalid(Invalid::out_of_range(Quantity::Wheels));
    ensure(
        outcome == Err(wrong),
        format!("too few inputs, not {outcome:?}"),
    )?;
    scene.member.must(Command::SetLocomotion {
        id,
        locomotion: Box::new(Locomotion::None),
    })?;
    let outcome = scene.member.command(inputs(id, 4, 0.0, 0.0))?;
    ensure(
        outcome == Err(CommandError::NotVehicle(id)),
        format!("it is no vehicle, not {outcome:?}"),
    )
}
