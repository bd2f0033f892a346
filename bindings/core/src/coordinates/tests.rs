//! Tests of the conversions: each is proved by what must hold in any axes.

use proptest::prelude::*;
use rhumb_client::BodyId;
use rhumb_client::scene::Command;

use super::*;

fn vectors() -> impl Strategy<Value = Vec3> {
    let part = || -100.0_f32..100.0;
    (part(), part(), part()).prop_map(|(x, y, z)| Vec3::new(x, y, z))
}

fn rotations() -> impl Strategy<Value = Quat> {
    (vectors(), -3.0_f32..3.0).prop_filter_map("an axis has a length", |(axis, angle)| {
        let axis = axis.try_normalize()?;
        Some(Quat::from_axis_angle(axis, angle))
    })
}

fn each() -> impl Strategy<Value = Coordinates> {
    proptest::sample::select(&Coordinates::EACH[..])
}

/// The triple product: positive for a right-handed set of vectors in right-handed axes.
fn triple(a: Vec3, b: Vec3, c: Vec3) -> f32 {
    a.cross(b).dot(c)
}

proptest! {
    #[test]
    fn what_goes_in_comes_out(coordinates in each(), vector in vectors(), rotation in rotations()) {
        let back = coordinates.vector_out(coordinates.vector_in(vector));
        prop_assert!(back.distance(vector) <= 1e-4 * vector.length(), "{back} {vector}");
        prop_assert_eq!(coordinates.direction_out(coordinates.direction_in(vector)), vector);
        prop_assert_eq!(coordinates.angular_out(coordinates.angular_in(vector)), vector);
        prop_assert_eq!(coordinates.rotation_out(coordinates.rotation_in(rotation)), rotation);
    }

    #[test]
    fn a_rotated_vector_is_the_same_vector_in_any_axes(
        coordinates in each(),
        vector in vectors(),
        rotation in rotations(),
    ) {
        let outside = rotation * vector;
        let inside = coordinates.rotation_in(rotation) * coordinates.vector_in(vector);
        let off = coordinates.vector_out(inside).distance(outside);
        prop_assert!(off <= 1e-4 * (1.0 + vector.length()), "{off}");
    }

    #[test]
    fn a_spin_moves_the_points_of_a_body_alike_in_any_axes(
        coordinates in each(),
        spin in vectors(),
        arm in vectors(),
    ) {
        // Over a short time, a point moves along spin × arm. Each set of axes has its own rotations for that.
        let turn = 1e-3 / (1.0 + spin.length());
        let small = |spin: Vec3| Quat::from_scaled_axis(spin * turn);
        let outside = small(spin) * arm;
        let inside = small(coordinates.angular_in(spin)) * coordinates.vector_in(arm);
        let off = coordinates.vector_out(inside).distance(outside);
        prop_assert!(off <= 1e-4 * (1.0 + arm.length()), "{off}");
    }

    #[test]
    fn left_handed_axes_are_mirrored_and_right_handed_ones_are_not(
        coordinates in each(),
        a in vectors(),
        b in vectors(),
        c in vectors(),
    ) {
        let turned = |v| coordinates.direction_in(v);
        let (outside, inside) = (triple(a, b, c), triple(turned(a), turned(b), turned(c)));
        let expected = if coordinates.is_left_handed() { -outside } else { outside };
        prop_assert!((inside - expected).abs() <= 1e-3 * (1.0 + a.length() * b.length() * c.length()));
    }

    #[test]
    fn a_torque_does_the_same_work_in_any_axes(coordinates in each(), torque in vectors(), spin in vectors()) {
        // Power is torque · spin, and its unit has the unit of length twice.
        let outside = torque.dot(spin);
        let inside = coordinates.torque_in(torque).dot(coordinates.angular_in(spin));
        let scale = coordinates.metres_per_unit() * coordinates.metres_per_unit();
        let slack = 1e-4 * scale * (1.0 + torque.length() * spin.length());
        prop_assert!((inside - outside * scale).abs() <= slack, "{inside} {outside}");
    }
}

#[test]
fn bevys_coordinates_leave_every_number_as_it_is() {
    let (vector, turn) = (Vec3::new(1.5, -2.0, 3.0), Quat::from_rotation_x(0.7));
    let bevy = Coordinates::BEVY;
    assert_eq!(
        (bevy.vector_in(vector), bevy.vector_out(vector)),
        (vector, vector)
    );
    assert_eq!(
        (bevy.angular_in(vector), bevy.torque_in(vector)),
        (vector, vector)
    );
    assert_eq!(
        (bevy.rotation_in(turn), bevy.rotation_out(turn)),
        (turn, turn)
    );
}

#[test]
fn up_is_up_and_a_metre_is_a_metre() {
    let up = Vec3::Y * 2.0;
    for (coordinates, outside) in [
        (Coordinates::Rhumb, Vec3::Y * 2.0),
        (Coordinates::Unity, Vec3::Y * 2.0),
        (Coordinates::Unreal, Vec3::Z * 200.0),
        (Coordinates::ZUp, Vec3::Z * 2.0),
    ] {
        assert_eq!(coordinates.vector_in(outside), up, "{coordinates:?}");
        assert_eq!(coordinates.vector_out(up), outside, "{coordinates:?}");
    }
}

#[test]
fn a_quarter_turn_about_up_is_the_other_way_round_in_left_handed_axes() {
    let quarter = Quat::from_rotation_y(std::f32::consts::FRAC_PI_2);
    // In Unity, a turn of +90° about y takes z (forward) to x (right).
    let inside = Coordinates::Unity.rotation_in(quarter);
    let forward = Coordinates::Unity.direction_in(Vec3::Z);
    let right = Coordinates::Unity.direction_in(Vec3::X);
    assert!((inside * forward).distance(right) < 1e-6);
}

#[test]
fn the_extents_and_locks_of_a_body_follow_its_axes() {
    let cuboid = Shape::cuboid(100.0, 200.0, 300.0);
    let inside = Coordinates::Unreal.shape_in(cuboid).unwrap();
    assert_eq!(inside, Shape::cuboid(1.0, 3.0, 2.0));
    let upright = LockedAxes::new(0b100_100).unwrap();
    let inside = Coordinates::ZUp.locked_axes_in(upright);
    assert_eq!(inside.bits(), 0b010_010);
    let negative = Coordinates::ZUp.shape_in(Shape::cuboid(1.0, -2.0, 3.0));
    assert!(negative.unwrap().check().is_err());
}

#[test]
fn a_mesh_keeps_its_front() {
    let points = [Vec3::ZERO, Vec3::X, Vec3::Z];
    let mesh = Mesh::new(&points, &[[0, 1, 2]]).unwrap();
    let front = |mesh: &Mesh| {
        let [a, b, c] = mesh.triangles()[0].map(|place| mesh.points()[place as usize]);
        (b - a).cross(c - a)
    };
    let outside = Coordinates::Unity.direction_in(front(&mesh));
    let Shape::Mesh(inside) = Coordinates::Unity
        .shape_in(Shape::Mesh(mesh.clone()))
        .unwrap()
    else {
        panic!("a mesh stays a mesh");
    };
    assert_eq!(front(&inside), outside);
}

/// The places of the posts of a shape in Rhumb's coordinates (PROTOCOL 2.6-7), for each part.
fn posts(shape: &Shape, at: Vec3, into: &mut Vec<Vec3>) {
    match shape {
        Shape::Heights(field) => {
            for (row, heights) in field.heights().chunks(field.columns() as usize).enumerate() {
                for (column, height) in heights.iter().enumerate() {
                    let x = row as f32 * field.row_spacing();
                    let z = column as f32 * field.column_spacing();
                    into.push(at + Vec3::new(x, *height, z));
                }
            }
        }
        Shape::Compound(compound) => {
            for part in compound.parts() {
                assert_eq!(part.rotation, Quat::IDENTITY);
                posts(&part.shape, at + part.position, into);
            }
        }
        _ => panic!("a field, alone or in a compound"),
    }
}

/// True if both have the same posts in some order, to a tenth of a millimetre.
fn same_posts(left: &[Vec3], right: &[Vec3]) -> bool {
    let in_order = |posts: &[Vec3]| {
        let mut posts = posts.to_vec();
        posts.sort_by_key(|post| post.to_array().map(|number| (number * 1e4).round() as i64));
        posts
    };
    let (left, right) = (in_order(left), in_order(right));
    let near = |(left, right): (&Vec3, &Vec3)| left.distance(*right) < 1e-4;
    left.len() == right.len() && left.iter().zip(&right).all(near)
}

#[test]
fn the_posts_of_heights_stand_where_the_axes_of_the_application_put_them() {
    let field = Heights::new(2, 3.0, 7.0, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
    let place = Vec3::new(10.0, 20.0, 30.0);
    let part = Part {
        position: place,
        rotation: Quat::IDENTITY,
        shape: Shape::Heights(field.clone()),
    };
    let compound = Shape::Compound(Compound::new(vec![part]).unwrap());
    for coordinates in Coordinates::EACH {
        // Rows go along the first of the application's axes on the ground, columns along the other.
        let post = |number: u8| {
            let (row, column) = (f32::from(number / 3) * 3.0, f32::from(number % 3) * 7.0);
            let height = f32::from(number);
            match coordinates {
                Coordinates::Rhumb | Coordinates::Unity => Vec3::new(row, height, column),
                Coordinates::Unreal | Coordinates::ZUp => Vec3::new(row, column, height),
            }
        };
        let shapes = [
            (Shape::Heights(field.clone()), Vec3::ZERO),
            (compound.clone(), place),
        ];
        for (shape, at) in shapes {
            let expected: Vec<Vec3> = (0..6)
                .map(|number| coordinates.vector_in(at + post(number)))
                .collect();
            let mut standing = Vec::new();
            posts(
                &coordinates.shape_in(shape).unwrap(),
                Vec3::ZERO,
                &mut standing,
            );
            assert!(
                same_posts(&standing, &expected),
                "{coordinates:?}: {standing:?}"
            );
        }
    }
}

#[test]
fn commands_and_queries_are_converted_as_a_whole() {
    let id = BodyId::new(1, 0);
    let command = Command::ImpulseAt {
        id,
        impulse: Vec3::new(1.0, 2.0, 3.0),
        point: Vec3::new(4.0, 5.0, 6.0),
    };
    let expected = Command::ImpulseAt {
        id,
        impulse: Vec3::new(1.0, 3.0, -2.0),
        point: Vec3::new(4.0, 6.0, -5.0),
    };
    assert_eq!(Coordinates::ZUp.command_in(command), expected);
    let query = Query::shape_cast(
        Shape::cuboid(1.0, 2.0, 3.0),
        Vec3::Z,
        Quat::IDENTITY,
        Vec3::Y,
    );
    let expected = Query::shape_cast(
        Shape::cuboid(1.0, 3.0, 2.0),
        Vec3::Y,
        Quat::IDENTITY,
        -Vec3::Z,
    );
    assert_eq!(Coordinates::ZUp.query_in(query).unwrap(), expected);
}

#[test]
fn a_bound_counts_what_the_handed_out_position_is_rounded_by_far_out() {
    let turn = Quat::from_axis_angle(Vec3::new(0.6, 0.0, 0.8), 1.1);
    for coordinates in Coordinates::EACH {
        let scale = f64::from(1.0 / coordinates.metres_per_unit());
        for centre in [
            Vec3::ZERO,
            Vec3::new(1.2345, 0.37, 0.11),
            Vec3::splat(900.0),
        ] {
            for step in 0..200 {
                let step = step as f32;
                let position = Vec3::new(98_765.2 + step, -99_000.3 - step, 3.1 * step);
                let exact = position.as_dvec3() - turn.as_dquat() * centre.as_dvec3();
                let origin = position - turn * centre;
                let shown = coordinates.vector_out(origin).as_dvec3();
                let back = coordinates.direction_in(shown.as_vec3()).as_dvec3();
                let error = (back - exact * scale).length();
                let bound = rounding(position, centre, coordinates);
                assert!(
                    error <= bound,
                    "{coordinates:?}, {centre}: {error} > {bound}"
                );
            }
        }
    }
    let near = rounding(
        Vec3::new(99_000.0, 1.0, 1.0),
        Vec3::ZERO,
        Coordinates::Rhumb,
    );
    assert_eq!(near, 0.0, "what is handed out as it is");
}
