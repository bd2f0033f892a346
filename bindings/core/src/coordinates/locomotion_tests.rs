//! Tests of the conversion of characters and vehicles: one motion in any axes.

use glam::{Quat, Vec3};
use proptest::prelude::*;
use rhumb_client::BodyId;
use rhumb_client::scene::{
    Character, CharacterStep, Command, JumpFrom, Locomotion, Vehicle, Wheel, WheelInput,
};

use rhumb_table::table::Table;

use super::Coordinates;

const BODY: BodyId = BodyId::new(3, 0);

fn each() -> impl Strategy<Value = Coordinates> {
    proptest::sample::select(&Coordinates::EACH[..])
}

fn vectors() -> impl Strategy<Value = Vec3> {
    let part = || -10.0_f32..10.0;
    (part(), part(), part()).prop_map(|(x, y, z)| Vec3::new(x, y, z))
}

fn directions() -> impl Strategy<Value = Vec3> {
    vectors().prop_filter_map("a direction has a length", Vec3::try_normalize)
}

fn wheels() -> impl Strategy<Value = Wheel> {
    let places = (vectors(), directions(), directions());
    let lengths = (0.1_f32..1.0, 0.1_f32..1.0, 0.1_f32..1.0);
    let loads = (1.0_f32..100.0, 1.0_f32..10.0, 1.0_f32..1e6);
    (places, lengths, loads).prop_map(|(places, lengths, loads)| Wheel {
        direction: places.1,
        axle: places.2,
        rest_length: lengths.1,
        travel: lengths.2,
        stiffness: loads.0,
        compression: loads.1,
        force_max: loads.2,
        ..Wheel::at(places.0, lengths.0)
    })
}

/// Axes and lengths, turned here by hand.
fn by_hand(coordinates: Coordinates, v: Vec3) -> (Vec3, f32) {
    match coordinates {
        Coordinates::Rhumb => (v, 1.0),
        Coordinates::Unity => (Vec3::new(v.x, v.y, -v.z), 1.0),
        Coordinates::Unreal => (Vec3::new(v.x, v.z, v.y), 0.01),
        Coordinates::ZUp => (Vec3::new(v.x, v.z, -v.y), 1.0),
    }
}

/// The way forward of a wheel, in the axes of an application: left-handed ones have the other cross product.
fn forward(coordinates: Coordinates, up: Vec3, axle: Vec3) -> Vec3 {
    match coordinates.is_left_handed() {
        true => axle.cross(up),
        false => up.cross(axle),
    }
}

proptest! {
    #[test]
    fn a_vehicle_is_the_one_that_is_converted_by_hand(
        coordinates in each(),
        wheels in proptest::collection::vec(wheels(), 1..5),
    ) {
        let expected = wheels.iter().map(|wheel| {
            let turned = |v| by_hand(coordinates, v).0;
            let (position, unit) = by_hand(coordinates, wheel.position);
            Wheel {
                position: position * unit,
                direction: turned(wheel.direction),
                axle: turned(wheel.axle),
                radius: wheel.radius * unit,
                rest_length: wheel.rest_length * unit,
                travel: wheel.travel * unit,
                force_max: wheel.force_max * unit,
                ..*wheel
            }
        });
        let expected = Vehicle { wheels: expected.collect() };
        let locomotion = Box::new(Vehicle { wheels }.into());
        let inside = coordinates.command_in(Command::SetLocomotion { id: BODY, locomotion });
        let locomotion = Box::new(expected.into());
        prop_assert_eq!(inside, Command::SetLocomotion { id: BODY, locomotion });
    }

    #[test]
    fn a_character_is_the_one_that_is_converted_by_hand(
        coordinates in each(),
        up in directions(),
        height in 0.1_f32..1.0,
        speed in -10.0_f32..10.0,
    ) {
        let (turned, unit) = by_hand(coordinates, up);
        let character = Character { offset: 0.5 * height, snap: Some(height), ..Character::default() };
        let step = CharacterStep { onto_dynamic: true, ..CharacterStep::new(height, 2.0 * height) };
        let inside = coordinates.character_in(character.up(up).step(step));
        let expected = Character {
            offset: 0.5 * height * unit,
            snap: Some(height * unit),
            ..character.up(turned)
        };
        let step = CharacterStep { height: height * unit, width: 2.0 * height * unit, ..step };
        prop_assert_eq!(inside, expected.step(step));
        let jump = |speed| Command::Jump { id: BODY, speed, from: JumpFrom::Ground };
        prop_assert_eq!(coordinates.command_in(jump(speed)), jump(speed * unit));
    }

    #[test]
    fn a_wheel_rolls_the_same_way_in_any_axes(
        coordinates in each(),
        up in directions(),
        axle in directions(),
    ) {
        let wheel = Wheel { axle, ..Wheel::at(Vec3::ZERO, 0.3) };
        let inside = coordinates.direction_in(up).cross(coordinates.wheel_in(wheel).axle);
        let off = inside.distance(coordinates.direction_in(forward(coordinates, up, axle)));
        prop_assert!(off < 1e-6, "{off}");
    }

    #[test]
    fn a_steering_is_the_turn_of_its_axes(
        coordinates in each(),
        direction in directions(),
        steering in -3.0_f32..3.0,
    ) {
        let wheel = Wheel { direction, ..Wheel::at(Vec3::ZERO, 0.3) };
        let input = WheelInput { steering, ..WheelInput::default() };
        let outside = Quat::from_axis_angle(-direction, steering);
        let axis = -coordinates.wheel_in(wheel).direction;
        let inside = Quat::from_axis_angle(axis, coordinates.wheel_input_in(input).steering);
        let off = inside * Vec3::X - coordinates.rotation_in(outside) * Vec3::X;
        prop_assert!(off.length() < 1e-5, "{off}");
    }
}

#[test]
fn a_plain_wheel_points_down_rolls_forward_and_a_positive_steering_is_a_positive_turn() {
    for (coordinates, ahead, left) in [
        (Coordinates::Rhumb, Vec3::NEG_Z, Vec3::NEG_X),
        (Coordinates::Unity, Vec3::Z, Vec3::NEG_X),
        (Coordinates::Unreal, Vec3::X, Vec3::NEG_Y),
        (Coordinates::ZUp, Vec3::Y, Vec3::NEG_X),
    ] {
        let wheel = coordinates.wheel_in(coordinates.plain_wheel(Vec3::ZERO, 0.3));
        assert_eq!(wheel.direction, Vec3::NEG_Y, "{coordinates:?}");
        let rolls = Vec3::Y.cross(wheel.axle);
        assert_eq!(coordinates.direction_out(rolls), ahead, "{coordinates:?}");
        // In Rhumb's axes, a positive one steers left.
        let input = WheelInput {
            steering: 0.5,
            ..WheelInput::default()
        };
        let steered = Quat::from_rotation_y(coordinates.wheel_input_in(input).steering) * rolls;
        let is_left = coordinates.direction_out(steered).dot(left) > 0.0;
        assert_eq!(is_left, !coordinates.is_left_handed(), "{coordinates:?}");
    }
}

#[test]
fn plain_characters_and_wheels_are_the_defaults_of_rust_in_any_units() {
    // A hundred times a length and a hundredth of that round.
    let near = |a: f32, b: f32| (a - b).abs() < 1e-6;
    for coordinates in Coordinates::EACH {
        let plain = Character::default();
        let inside = coordinates.character_in(coordinates.plain_character());
        assert!(near(inside.offset, plain.offset), "{coordinates:?}");
        let snaps = [inside.snap, plain.snap].map(Option::unwrap_or_default);
        assert!(near(snaps[0], snaps[1]), "{coordinates:?}");
        let (offset, snap) = (inside.offset, inside.snap);
        let expected = Character {
            offset,
            snap,
            ..plain
        };
        assert_eq!(inside, expected, "{coordinates:?}");

        let (plain, unit) = (Wheel::at(Vec3::ZERO, 0.3), coordinates.metres_per_unit());
        let inside = coordinates.wheel_in(coordinates.plain_wheel(Vec3::ZERO, 0.3 / unit));
        let lengths = |wheel: Wheel| [wheel.radius, wheel.rest_length, wheel.travel];
        let mut pairs = lengths(inside).into_iter().zip(lengths(plain));
        assert!(pairs.all(|(a, b)| near(a, b)), "{coordinates:?}");
        let expected = Wheel {
            axle: inside.axle,
            radius: inside.radius,
            rest_length: inside.rest_length,
            travel: inside.travel,
            force_max: plain.force_max * unit,
            ..plain
        };
        assert_eq!(inside, expected, "{coordinates:?}");
    }
}

#[test]
fn forces_have_the_applications_unit_and_no_locomotion_stays_none() {
    let input = WheelInput {
        steering: 0.25,
        force: 100_000.0,
        brake: 200_000.0,
    };
    let set = |input| Command::SetWheels {
        id: BODY,
        inputs: vec![input; 2],
    };
    let expected = WheelInput {
        steering: -0.25,
        force: 1_000.0,
        brake: 2_000.0,
    };
    let inside = Coordinates::Unreal.command_in(set(input));
    assert_eq!(inside, set(expected));
    let none = Command::SetLocomotion {
        id: BODY,
        locomotion: Box::new(Locomotion::None),
    };
    assert_eq!(Coordinates::Unity.command_in(none.clone()), none);
}

/// The default that the table has for a field.
fn default(record: &str, field: &str) -> Vec<f32> {
    let table = Table::load();
    let fields = table.record(record).fields();
    let found = fields.into_iter().find(|known| known.name == field);
    let default = found.expect("a field").default.clone();
    let numbers = default.expect("a default").into_iter();
    numbers.map(|number| number as f32).collect()
}

#[test]
fn the_defaults_of_the_table_are_those_of_rust() {
    let plain = Character::default();
    assert_eq!(plain.up, None);
    assert_eq!(plain.step, None);
    for (field, value) in [
        ("offset", plain.offset),
        ("climb angle", plain.climb_angle),
        ("slide angle", plain.slide_angle),
        ("mass", plain.mass),
        ("snap", plain.snap.expect("a snap")),
    ] {
        assert_eq!(default("character", field), [value], "{field}");
    }
    let plain = Wheel::at(Vec3::ZERO, 1.0);
    assert_eq!(default("wheel", "direction"), plain.direction.to_array());
    assert_eq!(default("wheel", "axle"), plain.axle.to_array());
    for (field, value) in [
        ("rest length", plain.rest_length),
        ("travel", plain.travel),
        ("stiffness", plain.stiffness),
        ("compression", plain.compression),
        ("relaxation", plain.relaxation),
        ("force max", plain.force_max),
        ("friction slip", plain.friction_slip),
        ("side friction", plain.side_friction),
    ] {
        assert_eq!(default("wheel", field), [value], "{field}");
    }
    let plain = WheelInput::default();
    for (field, value) in [
        ("steering", plain.steering),
        ("force", plain.force),
        ("brake", plain.brake),
    ] {
        assert_eq!(default("wheel input", field), [value], "{field}");
    }
}
