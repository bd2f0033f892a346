//! Commands out of JSON, in the words of `rhumb.d.ts`.
//!
//! Made by `bindings/table` from `spec/tables/protocol.json`; do not edit.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{
    ActiveEvents, Character, CharacterStep, Command, JumpFrom, Locomotion, Vehicle, Wheel,
    WheelInput,
};

use crate::argument::{Argument, Failure};

/// A command of a kind; `None` for a kind that is not one of these.
pub(crate) fn command(from: &Argument<'_>, kind: &str) -> Result<Option<Command>, Failure> {
    Ok(Some(match kind {
        "removeBody" => Command::RemoveBody { id: from.id()? },
        "setPose" => Command::SetPose {
            id: from.id()?,
            position: from.vector_of("position")?,
            rotation: from.rotation_or("rotation", Quat::IDENTITY)?,
        },
        "setVelocity" => Command::SetVelocity {
            id: from.id()?,
            linear: from.vector_of("linear")?,
            angular: from.vector_or("angular", Vec3::ZERO)?,
        },
        "force" => match from.optional("point") {
            Some(point) => Command::ForceAt {
                id: from.id()?,
                force: from.vector_of("force")?,
                point: point.vector()?,
            },
            None => Command::Force {
                id: from.id()?,
                force: from.vector_of("force")?,
            },
        },
        "torque" => Command::Torque {
            id: from.id()?,
            torque: from.vector_of("torque")?,
        },
        "impulse" => match from.optional("point") {
            Some(point) => Command::ImpulseAt {
                id: from.id()?,
                impulse: from.vector_of("impulse")?,
                point: point.vector()?,
            },
            None => Command::Impulse {
                id: from.id()?,
                impulse: from.vector_of("impulse")?,
            },
        },
        "torqueImpulse" => Command::TorqueImpulse {
            id: from.id()?,
            impulse: from.vector_of("impulse")?,
        },
        "sleep" => Command::Sleep { id: from.id()? },
        "wake" => Command::Wake { id: from.id()? },
        "setEvents" => Command::SetEvents {
            id: from.id()?,
            events: active_events(&from.field("events")?)?,
        },
        "jump" => Command::Jump {
            id: from.id()?,
            speed: from.number_of("speed")?,
            from: jump_from(from)?,
        },
        "setGravity" => Command::SetGravity {
            gravity: from.vector_of("gravity")?,
        },
        _ => return command_of_records(from, kind),
    }))
}

/// The same of commands that have records.
fn command_of_records(from: &Argument<'_>, kind: &str) -> Result<Option<Command>, Failure> {
    Ok(Some(match kind {
        "clearLocomotion" => Command::SetLocomotion {
            id: from.id()?,
            locomotion: Box::new(Locomotion::None),
        },
        "setCharacter" => Command::SetLocomotion {
            id: from.id()?,
            locomotion: Box::new(character(&from.field("character")?)?.into()),
        },
        "setVehicle" => Command::SetLocomotion {
            id: from.id()?,
            locomotion: Box::new(
                Vehicle {
                    wheels: from.field("wheels")?.each(wheel)?,
                }
                .into(),
            ),
        },
        "setWheels" => Command::SetWheels {
            id: from.id()?,
            inputs: from.field("inputs")?.each(wheel_input)?,
        },
        _ => return Ok(None),
    }))
}

fn jump_from(from: &Argument<'_>) -> Result<JumpFrom, Failure> {
    let Some(from) = from.optional("from") else {
        return Ok(JumpFrom::Ground);
    };
    Ok(match from.as_text() {
        Some("ground") => JumpFrom::Ground,
        Some("anywhere") => JumpFrom::Anywhere,
        _ => return Err(from.wrong("ground or anywhere")),
    })
}

fn character(from: &Argument<'_>) -> Result<Character, Failure> {
    let plain = Character::default();
    let [offset, climb_angle, slide_angle, mass] = from.numbers([
        ("offset", plain.offset),
        ("climbAngle", plain.climb_angle),
        ("slideAngle", plain.slide_angle),
        ("mass", plain.mass),
    ])?;
    Ok(Character {
        offset,
        climb_angle,
        slide_angle,
        mass,
        up: from.optional("up").map(|from| from.vector()).transpose()?,
        step: from
            .optional("step")
            .map(|from| {
                Ok::<_, Failure>(CharacterStep {
                    height: from.number_of("height")?,
                    width: from.number_of("width")?,
                    onto_dynamic: from.flag_or("ontoDynamic", false)?,
                })
            })
            .transpose()?,
        snap: Some(from.number_or("snap", plain.snap.unwrap_or_default())?)
            .filter(|snap| *snap != 0.0),
    })
}

fn wheel(from: &Argument<'_>) -> Result<Wheel, Failure> {
    let plain = Wheel::at(from.vector_of("position")?, from.number_of("radius")?);
    let [
        rest_length,
        travel,
        stiffness,
        compression,
        relaxation,
        force_max,
        friction_slip,
        side_friction,
    ] = from.numbers([
        ("restLength", plain.rest_length),
        ("travel", plain.travel),
        ("stiffness", plain.stiffness),
        ("compression", plain.compression),
        ("relaxation", plain.relaxation),
        ("forceMax", plain.force_max),
        ("frictionSlip", plain.friction_slip),
        ("sideFriction", plain.side_friction),
    ])?;
    Ok(Wheel {
        rest_length,
        travel,
        stiffness,
        compression,
        relaxation,
        force_max,
        friction_slip,
        side_friction,
        direction: from.vector_or("direction", plain.direction)?,
        axle: from.vector_or("axle", plain.axle)?,
        ..plain
    })
}

fn wheel_input(from: &Argument<'_>) -> Result<WheelInput, Failure> {
    let plain = WheelInput::default();
    let [steering, force, brake] = from.numbers([
        ("steering", plain.steering),
        ("force", plain.force),
        ("brake", plain.brake),
    ])?;
    Ok(WheelInput {
        steering,
        force,
        brake,
    })
}

fn active_events(from: &Argument<'_>) -> Result<ActiveEvents, Failure> {
    let plain = ActiveEvents::NONE;
    Ok(ActiveEvents {
        contacts: from.flag_or("contacts", plain.contacts)?,
        sensors: from.flag_or("sensors", plain.sensors)?,
        sleep: from.flag_or("sleep", plain.sleep)?,
        force: from
            .optional("force")
            .map(|from| from.single())
            .transpose()?,
    })
}
