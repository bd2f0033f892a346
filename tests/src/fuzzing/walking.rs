//! Random commands about characters and vehicles.

use glam::Vec3;
use rhumb_protocol::limits::{FORCE_MAX, LINEAR_MAX};
use rhumb_protocol::scene::{
    Character, CharacterStep, Command, JumpFrom, Locomotion, Vehicle, Wheel, WheelInput,
};
use rhumb_reckoning::BodyId;

use super::script::Script;

/// A random command about the locomotion of a body.
pub(super) fn walking(script: &mut Script<'_>, id: BodyId) -> Command {
    match script.below(6) {
        0 => Command::SetLocomotion {
            id,
            locomotion: Locomotion::None.into(),
        },
        1 => Command::SetLocomotion {
            id,
            locomotion: Locomotion::Character(character(script)).into(),
        },
        2 => Command::SetLocomotion {
            id,
            locomotion: Locomotion::Vehicle(vehicle(script)).into(),
        },
        3 => Command::Jump {
            id,
            speed: script.number(LINEAR_MAX),
            from: script.one_of(&[JumpFrom::Ground, JumpFrom::Anywhere]),
        },
        _ => Command::SetWheels {
            id,
            inputs: (0..script.below(4)).map(|_| input(script)).collect(),
        },
    }
}

fn character(script: &mut Script<'_>) -> Character {
    let up = script.one_of(&[Vec3::Y, Vec3::X, Vec3::NEG_Y, Vec3::ONE]);
    Character {
        up: script.any::<bool>().then_some(up),
        offset: script.one_of(&[0.02, 0.001, 1.0, 0.0, 1e4]),
        climb_angle: script.one_of(&[0.8, 0.0, 1.5, 1.7]),
        slide_angle: script.one_of(&[0.8, 0.0, 1.5]),
        mass: script.one_of(&[80.0, 0.0, 1e6, f32::NAN]),
        step: script.any::<bool>().then(|| CharacterStep {
            height: script.one_of(&[0.3, 0.001, 1e4]),
            width: script.one_of(&[0.1, 0.001, 1e4]),
            onto_dynamic: script.any(),
        }),
        snap: script
            .any::<bool>()
            .then(|| script.one_of(&[0.2, 0.001, 1e4])),
    }
}

fn vehicle(script: &mut Script<'_>) -> Vehicle {
    let wheels = (0..script.below(4)).map(|_| wheel(script)).collect();
    Vehicle { wheels }
}

fn wheel(script: &mut Script<'_>) -> Wheel {
    let direction = script.one_of(&[Vec3::NEG_Y, Vec3::X, Vec3::Z, Vec3::ZERO]);
    let axle = script.one_of(&[Vec3::X, Vec3::NEG_Y, Vec3::Z]);
    Wheel {
        direction,
        axle,
        rest_length: script.one_of(&[0.3, 0.0, 1e4]),
        travel: script.one_of(&[0.2, 0.0, 1e4]),
        stiffness: script.one_of(&[50.0, 0.0, 1e6]),
        compression: script.one_of(&[4.0, 0.0, 1e6]),
        relaxation: script.one_of(&[4.0, 0.0, 1e6]),
        force_max: script.one_of(&[1e5, 0.0, FORCE_MAX]),
        friction_slip: script.one_of(&[2.0, 0.0, 100.0]),
        side_friction: script.one_of(&[1.0, 0.0, 100.0]),
        ..Wheel::at(script.vector(3.0), script.one_of(&[0.3, 0.001, 1e4]))
    }
}

fn input(script: &mut Script<'_>) -> WheelInput {
    WheelInput {
        steering: script.number(4.0),
        force: script.number(FORCE_MAX),
        brake: script.number(1e4).abs(),
    }
}
