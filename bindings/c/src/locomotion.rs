//! Characters and wheels with the defaults of some coordinates.

use rhumb_bindings::Coordinates;
use rhumb_bindings::rhumb_client::glam::Vec3;

use crate::border::{guard, one_of, write};
use crate::generated::{RhumbCharacter, RhumbWheel};
use crate::kinds::COORDINATES;
use crate::status::RhumbCode;

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
        write(
            character,
            RhumbCharacter::from(coordinates.plain_character()),
            "character",
        )
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
        write(wheel, plain_wheel(coordinates), "wheel")
    })
}

/// A plain wheel at the chassis' origin.
fn plain_wheel(coordinates: Coordinates) -> RhumbWheel {
    let radius = coordinates.length_out(RADIUS);
    coordinates.plain_wheel(Vec3::ZERO, radius).into()
}

/// Radius of a plain wheel, metres: that of a small car.
const RADIUS: f32 = 0.3;

#[cfg(test)]
mod tests {
    use rhumb_bindings::rhumb_client::scene::{Character, CharacterStep, Wheel};

    use super::*;

    #[test]
    fn plain_structs_are_the_defaults_of_rust() {
        let character = RhumbCharacter::from(Coordinates::Rhumb.plain_character());
        assert_eq!(Character::from(&character), Character::default());
        let wheel = plain_wheel(Coordinates::Rhumb);
        assert_eq!(Wheel::from(&wheel), Wheel::at(Vec3::ZERO, 0.3));
        let in_centimetres = plain_wheel(Coordinates::Unreal);
        assert!((in_centimetres.radius - 30.0).abs() < 1e-4);
        assert_eq!(in_centimetres.direction, [0.0, 0.0, -1.0]);
    }

    #[test]
    fn a_step_a_snap_and_a_direction_are_read_where_their_flags_are() {
        let mut character = RhumbCharacter::from(Coordinates::Rhumb.plain_character());
        // Without their flags, these mean nothing.
        (character.step_height, character.step_width) = (0.3, 0.1);
        character.up = [1.0, 0.0, 0.0];
        assert_eq!(Character::from(&character), Character::default());
        (character.has_step, character.has_up) = (1, 1);
        (character.onto_dynamic, character.has_snap) = (1, 0);
        let step = CharacterStep {
            onto_dynamic: true,
            ..CharacterStep::new(0.3, 0.1)
        };
        let expected = Character {
            snap: None,
            ..Character::default()
        };
        assert_eq!(Character::from(&character), expected.up(Vec3::X).step(step));
    }

    #[test]
    fn unknown_coordinates_and_null_pointers_are_errors() {
        let mut wheel = plain_wheel(Coordinates::Rhumb);
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
