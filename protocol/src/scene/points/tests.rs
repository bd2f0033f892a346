//! Hulls, meshes and height fields: their bounds, corners, volumes and bytes.

use alloc::vec;

use super::*;

const CORNERS: [Vec3; 4] = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];

fn refused(points: &[Vec3]) -> Invalid {
    Hull::new(points).expect_err("the test makes it wrong")
}

#[test]
fn a_hull_without_volume_is_refused_as_too_thin() {
    let thin = Invalid::out_of_range(Quantity::HullThickness);
    assert_eq!(refused(&[Vec3::ONE; 4]), thin);
    assert_eq!(refused(&[0.0, 1.0, 2.0, 3.0].map(Vec3::splat)), thin);
    assert_eq!(
        refused(&[Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::ONE - Vec3::Z]),
        thin
    );
    assert_eq!(refused(&CORNERS.map(|point| point * 1e-3 * 0.5)), thin);
    // A sheet of a kilometre, half a metre thick.
    let sheet = CORNERS.map(|point| point * Vec3::new(1e3, 1e3, 0.5));
    assert_eq!(refused(&sheet), thin);
    assert!(Hull::new(&CORNERS.map(|point| point * 1e-2)).is_ok());
    assert!(Hull::new(&CORNERS.map(|point| point * 1e4)).is_ok());
}

#[test]
fn an_invalid_hull_error_names_the_fault() {
    for (wrong, invalid) in [
        (f32::NAN, Invalid::not_finite(Quantity::Extent)),
        (f32::INFINITY, Invalid::not_finite(Quantity::Extent)),
        (2e4, Invalid::out_of_range(Quantity::Extent)),
        (-f32::MAX, Invalid::out_of_range(Quantity::Extent)),
    ] {
        let mut points = CORNERS;
        points[2].y = wrong;
        assert_eq!(refused(&points), invalid);
    }
    let many = Invalid::out_of_range(Quantity::HullPoints);
    assert_eq!(refused(&CORNERS[..3]), many);
    assert_eq!(refused(&[Vec3::X; 256]), many);
}

#[test]
fn a_hull_round_trips_and_truncations_are_refused() {
    let hull = Hull::new(&CORNERS).expect("a tetrahedron");
    let mut writer = Writer::new();
    hull.encode(&mut writer);
    let bytes = writer.into_bytes();
    assert_eq!(bytes.len(), 1 + 4 * 12);
    assert_eq!(Hull::decode(&mut Reader::new(&bytes)), Ok(hull));
    for cut in 0..bytes.len() {
        let cut = Hull::decode(&mut Reader::new(&bytes[..cut]));
        assert_eq!(cut, Err(Malformed::Truncated));
    }
    let three = Hull::decode(&mut Reader::new(&[3; 64]));
    assert_eq!(three, Err(Malformed::OutOfRange));
}

#[test]
fn the_bounding_ball_reaches_the_farthest_point() {
    let hull = Hull::new(&[Vec3::X, Vec3::Y, Vec3::Z, Vec3::splat(-2.0)]);
    let radius = hull.expect("a tetrahedron").bounding_radius().metres();
    assert_eq!(radius, libm::sqrt(12.0));
}

/// Pseudo-random numbers from −1 to 1.
fn numbers(mut state: u64) -> impl FnMut() -> f32 {
    move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 40) as f32 / (1_u64 << 23) as f32 - 1.0
    }
}

fn cube(size: f32, corner: Vec3) -> Vec<Vec3> {
    let bit = |place: usize, axis: usize| (place >> axis & 1) as f32;
    let at = |place| Vec3::new(bit(place, 0), bit(place, 1), bit(place, 2));
    (0..8).map(|place| corner + at(place) * size).collect()
}

#[test]
fn the_corners_of_a_cube_are_found_among_points_inside_and_on_it() {
    for seed in 1..20 {
        let mut number = numbers(seed);
        let corner = Vec3::new(number(), number(), number()) * 5.0;
        let mut points = Vec::new();
        for place in 0..3_000 {
            let mut inside = Vec3::new(number(), number(), number()) * 0.5 + 0.5;
            if place % 3 == 0 {
                inside[place % 9 / 3] = (place % 2) as f32;
            }
            points.push(corner + inside * 2.0);
        }
        points.splice(1_000..1_000, cube(2.0, corner));
        let convex = Convex::of(&points).expect("a solid");
        assert_eq!(convex.corners(), (1_000..1_008).collect::<Vec<_>>());
        let (volume, centre) = convex.volume();
        assert!((volume - 8.0).abs() < 1e-4, "{volume}");
        assert!(
            (centre - (corner + 1.0).as_dvec3()).length() < 1e-5,
            "{centre}"
        );
    }
}

#[test]
fn every_point_is_inside_of_every_face() {
    for seed in 1..30 {
        let mut number = numbers(seed * 977);
        let count = 20 + seed as usize * 40;
        let points: Vec<_> = (0..count)
            .map(|_| Vec3::new(number(), number() * 0.2, number() * 3.0).normalize() * 3.0)
            .collect();
        let convex = Convex::of(&points).expect("a solid");
        assert!(convex.is_complete());
        assert!(convex.corners().len() > count * 9 / 10, "a ball's surface");
        for face in &convex.faces {
            let highest = (0..count).map(|point| convex.height(face, point));
            assert!(highest.fold(0.0, f64::max) < 1e-5, "seed {seed}");
        }
        let euler = convex.faces.len() + 4;
        assert_eq!(euler, 2 * convex.corners().len(), "closed: seed {seed}");
    }
}

#[test]
fn points_in_a_plane_and_too_many_corners_are_noticed() {
    let mut number = numbers(5);
    let mut plane: Vec<_> = (0..50)
        .map(|_| Vec3::new(number(), 0.5, number()))
        .collect();
    assert!(Convex::of(&plane).is_none());
    plane.push(Vec3::NAN);
    assert!(Convex::of(&plane).is_none());
    assert!(Convex::of(&[]).is_none());
    let ball: Vec<_> = (0..6_000)
        .map(|_| Vec3::new(number(), number(), number()).normalize())
        .collect();
    let convex = Convex::of(&ball).expect("a solid");
    assert!(!convex.is_complete());
    assert_eq!(convex.corners().len(), CORNERS_MAX);
}

const TRIANGLE: [Vec3; 3] = [Vec3::ZERO, Vec3::X, Vec3::Y];

#[test]
fn a_mesh_round_trips_and_truncations_are_refused() {
    let mesh = Mesh::new(&TRIANGLE, &[[0, 1, 2], [2, 1, 0]]).expect("a mesh");
    let mut writer = Writer::new();
    mesh.encode(&mut writer);
    let bytes = writer.into_bytes();
    assert_eq!(bytes.len(), 3 + 36 + 6);
    assert_eq!(Mesh::decode(&mut Reader::new(&bytes)), Ok(mesh));
    for cut in 0..bytes.len() {
        let cut = Mesh::decode(&mut Reader::new(&bytes[..cut]));
        assert_eq!(cut, Err(Malformed::Truncated));
    }
}

#[test]
fn an_invalid_mesh_error_names_the_fault() {
    let wrong = |points: &[Vec3], triangles: &[[u32; 3]]| {
        Mesh::new(points, triangles).expect_err("the test makes it wrong")
    };
    let range = Invalid::out_of_range;
    assert_eq!(
        wrong(&TRIANGLE[..2], &[[0, 1, 1]]),
        range(Quantity::MeshPoints)
    );
    assert_eq!(wrong(&TRIANGLE, &[]), range(Quantity::Triangles));
    assert_eq!(
        wrong(&TRIANGLE, &[[0, 1, 3]]),
        range(Quantity::TrianglePoint)
    );
    let far = [Vec3::ZERO, Vec3::X * 2e4, Vec3::Y];
    assert_eq!(wrong(&far, &[[0, 1, 2]]), range(Quantity::Extent));
    let none = [Vec3::ZERO, Vec3::NAN, Vec3::Y];
    assert_eq!(
        wrong(&none, &[[0, 1, 2]]),
        Invalid::not_finite(Quantity::Extent)
    );
}

#[test]
fn a_height_field_round_trips_and_truncations_are_refused() {
    let field = Heights::new(2, 1.0, 2.0, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]).expect("a field");
    assert_eq!((field.rows(), field.columns()), (2, 3));
    let last = field.posts().last();
    assert_eq!(last, Some(DVec3::new(1.0, 5.0, 4.0)));
    assert_eq!(field.bounding_radius().metres(), libm::sqrt(42.0));
    let mut writer = Writer::new();
    field.encode(&mut writer);
    let bytes = writer.into_bytes();
    assert_eq!(Heights::decode(&mut Reader::new(&bytes)), Ok(field));
    for cut in 0..bytes.len() {
        let cut = Heights::decode(&mut Reader::new(&bytes[..cut]));
        assert_eq!(cut, Err(Malformed::Truncated));
    }
}

#[test]
fn an_invalid_height_field_error_names_the_fault() {
    let posts = Err(Invalid::out_of_range(Quantity::Posts));
    let extent = Err(Invalid::out_of_range(Quantity::Extent));
    assert_eq!(Heights::new(0, 1.0, 1.0, &[]), posts);
    assert_eq!(Heights::new(1, 1.0, 1.0, &[0.0; 4]), posts);
    assert_eq!(Heights::new(4, 1.0, 1.0, &[0.0; 4]), posts);
    assert_eq!(Heights::new(2, 1.0, 1.0, &[0.0; 5]), posts);
    assert_eq!(Heights::new(2, 1.0, 1.0, &vec![0.0; POSTS_MAX + 2]), posts);
    assert_eq!(Heights::new(2, 0.0, 1.0, &[0.0; 4]), extent);
    assert_eq!(Heights::new(2, 1.0, 1.0, &[0.0, 0.0, 2e4, 0.0]), extent);
    assert_eq!(Heights::new(4, 9e3, 1.0, &[0.0; 8]), extent);
    let nan = Heights::new(2, 1.0, 1.0, &[0.0, f32::NAN, 0.0, 0.0]);
    assert_eq!(nan, Err(Invalid::not_finite(Quantity::Extent)));
}
