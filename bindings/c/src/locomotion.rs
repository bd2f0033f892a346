//! Characters and vehicles as flat structs of C.

use rhumb_bindings::rhumb_client::glam::Vec3;
use rhumb_bindings::rhumb_client::scene::{
    Character, CharacterStep, Command, JumpFrom, Locomotion, Vehicle, Wheel, WheelInput,
};
use rhumb_bindings::{BindingError, Coordinates, parse_body_word};

use crate::border::{elements, guard, one_of, value, write};
use crate::commands::send;
use crate::descriptions::RhumbBody;
use crate::kinds::{COORDINATES, JUMPS};
use crate::scene::RhumbScene;
use crate::status::RhumbCode;

/// A character: a kinematic body that walks by the velocity that was set last, as far as the world lets it, and falls.
/// Begin with `rhumb_character_init`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbCharacter {
    /// Not zero: `up` replaces the direction against the scene's gravity.
    pub has_up: u8,
    /// Not zero: it climbs steps of at most `step_height` with at least `step_width`.
    pub has_step: u8,
    /// Not zero: it also climbs onto dynamic bodies; otherwise it pushes them.
    pub steps_onto_dynamic: u8,
    /// Not zero: it follows the ground down by at most `snap` without a fall.
    pub has_snap: u8,
    /// Direction away from the ground, in world axes, of unit length.
    pub up: [f32; 3],
    /// Gap that it keeps to its surroundings, units of length.
    pub offset: f32,
    /// Steepest slope that it climbs, radians from level ground.
    pub climb_angle: f32,
    /// Slope from which on it slides down, radians from level ground.
    pub slide_angle: f32,
    /// Mass with which it pushes dynamic bodies, kilograms; at zero it pushes none.
    pub mass: f32,
    /// Greatest height of a step, units of length.
    pub step_height: f32,
    /// Free width that it needs on a step, units of length.
    pub step_width: f32,
    /// Greatest drop of the ground that it follows, units of length.
    pub snap: f32,
}

/// A wheel of a vehicle, in the axes of its chassis and from the origin of its shape: a ray with a spring. Begin with
/// `rhumb_wheel_init`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbWheel {
    /// Upper end of the suspension, units of length.
    pub position: [f32; 3],
    /// Direction of the suspension, of unit length, towards the ground.
    pub direction: [f32; 3],
    /// Axis about which the wheel turns, of unit length. It points to the right of the way forward.
    pub axle: [f32; 3],
    /// Units of length.
    pub radius: f32,
    /// Length of the suspension without load, from the position to the wheel's centre, units of length.
    pub rest_length: f32,
    /// Greatest change of that length, units of length.
    pub travel: f32,
    /// Acceleration of the chassis for a change of that length, 1/s².
    pub stiffness: f32,
    /// Damping while the spring is compressed, 1/s.
    pub compression: f32,
    /// Damping while the spring relaxes, 1/s.
    pub relaxation: f32,
    /// Greatest force of the suspension.
    pub force_max: f32,
    /// Greatest force along the ground, as a share of the suspension's force. The part along the way forward counts half.
    pub friction_slip: f32,
    /// Factor of the force along the axle that keeps the wheel from sliding sideways.
    pub side_friction: f32,
}

/// Steering, force and brake of a wheel. All zeros: it rolls freely.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbWheelInput {
    /// Turn about the axis that points up, radians: a positive one steers left, in left-handed coordinates right.
    pub steering: f32,
    /// Force forward; a negative one acts backward.
    pub force: f32,
    /// Greatest force that stops it. A wheel with a force does not brake.
    pub brake: f32,
}

/// Makes a plain character in a scene of these `RhumbCoordinates`: of 80 kg, that climbs slopes of up to 45 degrees, slides
/// down steeper ones, climbs no steps, and follows the ground down by 0.2 m.
///
/// # Safety
///
/// `character` points to memory for a `RhumbCharacter`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_character_init(
    character: *mut RhumbCharacter,
    coordinates: u32,
) -> RhumbCode {
    // SAFETY: the caller promises the memory.
    guard(|| unsafe {
        let coordinates = one_of(&COORDINATES, coordinates, "coordinates")?;
        write(character, RhumbCharacter::plain(coordinates), "character")
    })
}

/// Makes a plain wheel in a scene of these `RhumbCoordinates`: of radius 0.3 m at the chassis' origin, on a suspension
/// of 0.3 m that points down. Its axle is along x, in Unreal's coordinates along y.
///
/// A vehicle of such wheels rolls forward along -z in Rhumb's coordinates, z in Unity's, x in Unreal's, and y where z is up.
/// Four of them let a chassis sink by 5 cm.
///
/// # Safety
///
/// `wheel` points to memory for a `RhumbWheel`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_wheel_init(wheel: *mut RhumbWheel, coordinates: u32) -> RhumbCode {
    // SAFETY: the caller promises the memory.
    guard(|| unsafe {
        let coordinates = one_of(&COORDINATES, coordinates, "coordinates")?;
        write(wheel, RhumbWheel::plain(coordinates), "wheel")
    })
}

/// Queues that a kinematic body becomes a character, or that a character gets other settings.
///
/// Its velocity, which `RHUMB_COMMAND_KIND_SET_VELOCITY` sets, is the one by which it walks. `last` may be null; otherwise it
/// receives the number of the command, which events name.
///
/// # Safety
///
/// `character` points to a character; `last` is null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_set_character(
    scene: RhumbScene,
    body: RhumbBody,
    character: *const RhumbCharacter,
    last: *mut u64,
) -> RhumbCode {
    // SAFETY: the caller promises the character and the memory.
    guard(|| unsafe {
        let character = value(character, "character")?.character();
        send(scene, set(body, character.into())?, last)
    })
}

/// Queues that a dynamic body becomes a vehicle on 1 to 16 wheels, which begin without inputs.
///
/// # Safety
///
/// `wheels` points to `count` wheels; `last` is null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_set_vehicle(
    scene: RhumbScene,
    body: RhumbBody,
    wheels: *const RhumbWheel,
    count: usize,
    last: *mut u64,
) -> RhumbCode {
    // SAFETY: the caller promises the wheels and the memory.
    guard(|| unsafe {
        let wheels = elements(wheels, count, "wheels")?;
        let wheels = wheels.iter().map(RhumbWheel::wheel).collect();
        send(scene, set(body, Vehicle { wheels }.into())?, last)
    })
}

/// Queues that a character or a vehicle becomes an ordinary body again.
///
/// # Safety
///
/// `last` is null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_clear_locomotion(
    scene: RhumbScene,
    body: RhumbBody,
    last: *mut u64,
) -> RhumbCode {
    // SAFETY: the caller promises the memory.
    guard(|| unsafe { send(scene, set(body, Locomotion::None)?, last) })
}

/// Queues that a character rises with this speed along its direction up, in units of length per second.
///
/// `from` is a `RhumbJumpFrom`: a jump from the ground changes nothing in the air.
///
/// # Safety
///
/// `last` is null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_jump(
    scene: RhumbScene,
    body: RhumbBody,
    speed: f32,
    from: u32,
    last: *mut u64,
) -> RhumbCode {
    // SAFETY: the caller promises the memory.
    guard(|| unsafe {
        let from: JumpFrom = one_of(&JUMPS, from, "from")?;
        let id = parse_body_word(body.0)?;
        send(scene, Command::Jump { id, speed, from }, last)
    })
}

/// Queues the inputs of all wheels of a vehicle, in the order of its wheels. It keeps them until the next ones.
///
/// # Safety
///
/// `inputs` points to `count` inputs; `last` is null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_set_wheels(
    scene: RhumbScene,
    body: RhumbBody,
    inputs: *const RhumbWheelInput,
    count: usize,
    last: *mut u64,
) -> RhumbCode {
    // SAFETY: the caller promises the inputs and the memory.
    guard(|| unsafe {
        let inputs = elements(inputs, count, "inputs")?;
        let inputs = inputs.iter().map(RhumbWheelInput::input).collect();
        let id = parse_body_word(body.0)?;
        send(scene, Command::SetWheels { id, inputs }, last)
    })
}

/// The command that gives a body a locomotion.
fn set(body: RhumbBody, locomotion: Locomotion) -> Result<Command, BindingError> {
    Ok(Command::SetLocomotion {
        id: parse_body_word(body.0)?,
        locomotion: Box::new(locomotion),
    })
}

impl RhumbCharacter {
    fn plain(coordinates: Coordinates) -> Self {
        let plain = coordinates.plain_character();
        let (up, step) = (plain.up, plain.step);
        Self {
            has_up: u8::from(up.is_some()),
            has_step: u8::from(step.is_some()),
            steps_onto_dynamic: u8::from(step.is_some_and(|step| step.onto_dynamic)),
            has_snap: u8::from(plain.snap.is_some()),
            up: up.unwrap_or_default().to_array(),
            offset: plain.offset,
            climb_angle: plain.climb_angle,
            slide_angle: plain.slide_angle,
            mass: plain.mass,
            step_height: step.map_or(0.0, |step| step.height),
            step_width: step.map_or(0.0, |step| step.width),
            snap: plain.snap.unwrap_or_default(),
        }
    }

    fn character(&self) -> Character {
        Character {
            up: (self.has_up != 0).then_some(Vec3::from_array(self.up)),
            offset: self.offset,
            climb_angle: self.climb_angle,
            slide_angle: self.slide_angle,
            mass: self.mass,
            step: (self.has_step != 0).then_some(CharacterStep {
                height: self.step_height,
                width: self.step_width,
                onto_dynamic: self.steps_onto_dynamic != 0,
            }),
            snap: (self.has_snap != 0).then_some(self.snap),
        }
    }
}

impl RhumbWheel {
    /// Radius of a plain wheel, metres: that of a small car.
    const RADIUS: f32 = 0.3;

    fn plain(coordinates: Coordinates) -> Self {
        let radius = coordinates.length_out(Self::RADIUS);
        let plain = coordinates.plain_wheel(Vec3::ZERO, radius);
        Self {
            position: plain.position.to_array(),
            direction: plain.direction.to_array(),
            axle: plain.axle.to_array(),
            radius: plain.radius,
            rest_length: plain.rest_length,
            travel: plain.travel,
            stiffness: plain.stiffness,
            compression: plain.compression,
            relaxation: plain.relaxation,
            force_max: plain.force_max,
            friction_slip: plain.friction_slip,
            side_friction: plain.side_friction,
        }
    }

    fn wheel(&self) -> Wheel {
        Wheel {
            position: Vec3::from_array(self.position),
            direction: Vec3::from_array(self.direction),
            axle: Vec3::from_array(self.axle),
            radius: self.radius,
            rest_length: self.rest_length,
            travel: self.travel,
            stiffness: self.stiffness,
            compression: self.compression,
            relaxation: self.relaxation,
            force_max: self.force_max,
            friction_slip: self.friction_slip,
            side_friction: self.side_friction,
        }
    }
}

impl RhumbWheelInput {
    fn input(&self) -> WheelInput {
        WheelInput {
            steering: self.steering,
            force: self.force,
            brake: self.brake,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_structs_are_the_defaults_of_rust() {
        let character = RhumbCharacter::plain(Coordinates::Rhumb);
        assert_eq!(character.character(), Character::default());
        let wheel = RhumbWheel::plain(Coordinates::Rhumb);
        assert_eq!(wheel.wheel(), Wheel::at(Vec3::ZERO, 0.3));
        let in_centimetres = RhumbWheel::plain(Coordinates::Unreal);
        assert!((in_centimetres.radius - 30.0).abs() < 1e-4);
        assert_eq!(in_centimetres.direction, [0.0, 0.0, -1.0]);
    }

    #[test]
    fn a_step_a_snap_and_a_direction_are_read_where_their_flags_are() {
        let mut character = RhumbCharacter::plain(Coordinates::Rhumb);
        // Without their flags, these mean nothing.
        (character.step_height, character.step_width) = (0.3, 0.1);
        character.up = [1.0, 0.0, 0.0];
        assert_eq!(character.character(), Character::default());
        (character.has_step, character.has_up) = (1, 1);
        (character.steps_onto_dynamic, character.has_snap) = (1, 0);
        let step = CharacterStep {
            onto_dynamic: true,
            ..CharacterStep::new(0.3, 0.1)
        };
        let expected = Character {
            snap: None,
            ..Character::default()
        };
        assert_eq!(character.character(), expected.up(Vec3::X).step(step));
    }

    #[test]
    fn unknown_coordinates_and_null_pointers_are_errors() {
        let mut wheel = RhumbWheel::plain(Coordinates::Rhumb);
        // SAFETY: each pointer is null or points to the wheel.
        unsafe {
            assert_eq!(rhumb_wheel_init(&raw mut wheel, 3), RhumbCode::Ok);
            assert_eq!(rhumb_wheel_init(&raw mut wheel, 4), RhumbCode::Invalid);
            let null = std::ptr::null_mut();
            assert_eq!(rhumb_wheel_init(null, 0), RhumbCode::Null);
            assert_eq!(
                rhumb_character_init(std::ptr::null_mut(), 0),
                RhumbCode::Null
            );
        }
        assert_eq!(wheel.direction, [0.0, 0.0, -1.0]);
    }
}
