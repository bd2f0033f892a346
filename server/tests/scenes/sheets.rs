//! Ground, meshes, compounds, and bodies without rotation.
//!
//! Proved by small scenes with known outcome, and by random shapes under falling balls: every shape within the limits
//! steps without a fault, and every state is finite.

use glam::{Quat, Vec3};
use proptest::prelude::*;
use rhumb_protocol::limits::SHAPE_BYTES_PER_SCENE_MAX;
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, CommandError, Compound, Heights, LockedAxes, Mesh, Part,
    SceneConfig, Shape, ShapeId,
};
use rhumb_reckoning::{BodyId, BodyState, Damping};
use rhumb_scene::Scene;

const VALID: &str = "the test makes it valid";
const GROUND: BodyId = BodyId::new(0, 0);
const FALLING: BodyId = BodyId::new(1, 0);

fn scene() -> Scene {
    Scene::new(SceneConfig {
        gravity: Vec3::new(0.0, -10.0, 0.0),
        damping: Damping {
            linear: 0.0,
            angular: 0.5,
        },
        ..SceneConfig::default()
    })
    .expect(VALID)
}

fn add_shape(scene: &mut Scene, id: u32, shape: Shape) -> Result<(), CommandError> {
    let id = ShapeId(id);
    scene.apply(&Command::AddShape { id, shape })
}

fn add(scene: &mut Scene, desc: BodyDesc, at: Vec3) -> Result<(), CommandError> {
    let upright = [0.0, 0.0, 0.0, 1.0];
    let motion = BodyState::new(at.to_array(), upright, [0.0; 3], [0.0; 3]).expect(VALID);
    scene.apply(&Command::AddBody { desc, motion })
}

/// A scene with a fixed body of the first shape, in which bodies of the second one may fall.
fn on_ground(ground: Shape, falling: Shape) -> Scene {
    let mut scene = scene();
    add_shape(&mut scene, 0, ground).expect(VALID);
    add_shape(&mut scene, 1, falling).expect(VALID);
    let ground = BodyDesc::plain(GROUND, BodyKind::Fixed, ShapeId(0));
    add(&mut scene, ground, Vec3::ZERO).expect(VALID);
    scene
}

/// Drops a body on a static one; returns its pose two seconds later.
fn drop_on(ground: Shape, falling: Shape, turns: bool, from: Vec3) -> (Vec3, Quat) {
    let mut scene = on_ground(ground, falling);
    let mut desc = BodyDesc::plain(FALLING, BodyKind::Dynamic, ShapeId(1));
    if !turns {
        desc.locked = LockedAxes::ROTATIONS;
    }
    add(&mut scene, desc, from).expect(VALID);
    for _ in 0..120 {
        scene.step().expect(VALID);
    }
    let motion = scene.observation(FALLING).expect(VALID).motion;
    let rotation = Quat::from_array(motion.rotation());
    (Vec3::from_array(motion.position()), rotation)
}

/// A terrace: 2 m high where x is 8 m or more.
fn terrace() -> Shape {
    let heights: Vec<f32> = (0..16)
        .flat_map(|row| [if row < 8 { 0.0 } else { 2.0 }; 16])
        .collect();
    Shape::Heights(Heights::new(16, 1.0, 1.0, &heights).expect(VALID))
}

/// A square of 10 m around the origin, of two triangles that face up.
fn square() -> Shape {
    let corners = [[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]];
    let points = corners.map(|[x, z]| Vec3::new(x, 0.0, z));
    Shape::Mesh(Mesh::new(&points, &[[0, 2, 1], [0, 3, 2]]).expect(VALID))
}

const BALL: Shape = Shape::Ball { radius: 0.5 };

#[test]
fn rows_of_heights_lie_along_x_and_stop_falling_bodies() {
    let (low, _) = drop_on(terrace(), BALL, true, Vec3::new(3.5, 3.0, 12.2));
    assert!((low.y - 0.5).abs() < 0.02, "{low}");
    let (high, _) = drop_on(terrace(), BALL, true, Vec3::new(12.2, 4.0, 3.5));
    assert!((high.y - 2.5).abs() < 0.02, "{high}");
    let (beside, _) = drop_on(terrace(), BALL, true, Vec3::new(-2.0, 3.0, 3.5));
    assert!(beside.y < -10.0, "{beside}");
}

#[test]
fn a_capsule_stands_on_flat_ground_just_above_a_post() {
    let capsule = Shape::Capsule {
        half_height: 0.7,
        radius: 0.2,
    };
    let (at, _) = drop_on(terrace(), capsule, false, Vec3::new(3.0, 2.0, 3.0));
    assert!((at.y - 0.9).abs() < 0.02, "{at}");
}

#[test]
fn a_fast_body_does_not_pass_through_a_sheet() {
    let small = Shape::Ball { radius: 0.05 };
    for ground in [square(), terrace()] {
        let (at, _) = drop_on(ground, small.clone(), true, Vec3::new(2.3, 14.0, 2.7));
        assert!((0.0..0.3).contains(&at.y), "{at}");
    }
}

#[test]
fn a_compound_falls_and_rests_as_one_body() {
    let part = |x: f32| Part {
        position: Vec3::new(x, 0.0, 0.0),
        rotation: Quat::IDENTITY,
        shape: BALL,
    };
    let dumbbell = Shape::Compound(Compound::new(vec![part(-1.0), part(1.0)]).expect(VALID));
    let (at, turned) = drop_on(square(), dumbbell, true, Vec3::new(0.0, 2.0, 0.0));
    assert!((at.y - 0.5).abs() < 0.02, "{at}");
    assert!((turned * Vec3::X).y.abs() < 0.02, "it lies on both ends");
}

#[test]
fn a_body_without_parts_falls_through_everything() {
    let nothing = Shape::Compound(Compound::nothing());
    let (at, _) = drop_on(square(), nothing, true, Vec3::new(0.0, 1.0, 0.0));
    assert!(
        (at.y - 1.0 + 20.0).abs() < 0.2,
        "two seconds of 10 m/s²: {at}"
    );
}

#[test]
fn a_body_without_rotation_stands_on_its_edge() {
    let plank = Shape::Cuboid {
        half_extents: Vec3::new(0.1, 1.0, 0.1),
    };
    // Half of the body beyond the edge.
    let edge = Vec3::new(5.05, 1.2, 0.0);
    let (stands, turned) = drop_on(square(), plank.clone(), false, edge);
    assert_eq!(turned, Quat::IDENTITY);
    assert!((stands.y - 1.0).abs() < 0.02, "{stands}");
    let (falls, _) = drop_on(square(), plank, true, edge);
    assert!(falls.y < 0.0, "{falls}");
}

#[test]
fn dynamic_bodies_refuse_sheets_and_scenes_limit_their_bytes() {
    let mut scene = scene();
    add_shape(&mut scene, 0, square()).expect(VALID);
    let holed = Compound::new(vec![Part {
        position: Vec3::ZERO,
        rotation: Quat::IDENTITY,
        shape: terrace(),
    }]);
    add_shape(&mut scene, 1, Shape::Compound(holed.expect(VALID))).expect(VALID);
    for shape in [ShapeId(0), ShapeId(1)] {
        let desc = BodyDesc::plain(FALLING, BodyKind::Dynamic, shape);
        let refused = add(&mut scene, desc, Vec3::ZERO);
        assert_eq!(refused, Err(CommandError::NoInside(shape)));
    }
    let moved = BodyDesc::plain(FALLING, BodyKind::Kinematic, ShapeId(0));
    assert_eq!(add(&mut scene, moved, Vec3::ZERO), Ok(()));
    let large = || Shape::Heights(Heights::new(500, 1.0, 1.0, &[0.0; 250_000]).expect(VALID));
    let fit = SHAPE_BYTES_PER_SCENE_MAX as u32 / 1_000_200;
    for id in 10..10 + fit {
        assert_eq!(add_shape(&mut scene, id, large()), Ok(()));
    }
    let full = Err(CommandError::TooManyShapeBytes);
    assert_eq!(add_shape(&mut scene, 100, large()), full);
    scene
        .apply(&Command::RemoveShape { id: ShapeId(10) })
        .expect(VALID);
    assert_eq!(add_shape(&mut scene, 100, large()), Ok(()));
}

#[test]
fn contacts_name_the_other_body_and_point_away_from_it() {
    let mut scene = on_ground(terrace(), BALL);
    let ball = BodyDesc::plain(FALLING, BodyKind::Dynamic, ShapeId(1));
    add(&mut scene, ball, Vec3::new(3.5, 0.55, 3.4)).expect(VALID);
    let mut contacts = Vec::new();
    scene.contacts(FALLING, &mut contacts);
    assert_eq!(contacts, []);
    for _ in 0..60 {
        scene.step().expect(VALID);
    }
    scene.contacts(FALLING, &mut contacts);
    scene.contacts(GROUND, &mut contacts);
    let [up, down] = contacts.as_slice() else {
        panic!("one of each: {contacts:?}");
    };
    assert_eq!((up.with, down.with), (GROUND, FALLING));
    assert!(up.normal.y > 0.999 && down.normal.y < -0.999);
    assert!(up.point.y.abs() < 0.02 && up.separation.abs() < 0.02);
}

fn corner() -> impl Strategy<Value = Vec3> {
    let part = || prop_oneof![4 => -1.0_f32..1.0, 1 => Just(0.0), 1 => Just(1.0)];
    (part(), part(), part()).prop_map(|(x, y, z)| Vec3::new(x, y, z))
}

/// Triangles anywhere; some degenerate to lines or points, some coincide.
fn mesh() -> impl Strategy<Value = Shape> {
    let points = prop::collection::vec(corner(), 3..=8);
    let size = prop::sample::select(vec![0.0_f32, 1e-3, 1.0, 30.0, 9e3]);
    let triangles = prop::collection::vec([0..8_u32, 0..8, 0..8], 1..=12);
    (points, size, triangles).prop_map(|(points, size, triangles)| {
        let points: Vec<_> = points.into_iter().map(|point| point * size).collect();
        let count = points.len() as u32;
        let places = triangles.into_iter().map(|t| t.map(|place| place % count));
        Shape::Mesh(Mesh::new(&points, &places.collect::<Vec<_>>()).expect(VALID))
    })
}

/// Ground with posts as near and as steep as allowed.
fn heights() -> impl Strategy<Value = Shape> {
    let spacing = prop::sample::select(vec![1e-3_f32, 0.5, 3.0, 3e3]);
    let steep = prop::sample::select(vec![0.0_f32, 1.0, 9e3]);
    let posts = prop::collection::vec(-1.0_f32..1.0, 9);
    (spacing, steep, posts).prop_map(|(spacing, steep, posts)| {
        let posts: Vec<_> = posts.into_iter().map(|post| post * steep).collect();
        Shape::Heights(Heights::new(3, spacing, spacing, &posts).expect(VALID))
    })
}

fn compound() -> impl Strategy<Value = Shape> {
    let ball = (1e-3_f32..1.0).prop_map(|radius| Shape::Ball { radius });
    let part = (
        corner(),
        -3.0_f32..3.0,
        prop_oneof![4 => ball, 1 => mesh(), 1 => heights()],
    );
    prop::collection::vec(part, 0..=5).prop_map(|parts| {
        let parts = parts.into_iter().map(|(position, angle, shape)| Part {
            position,
            rotation: Quat::from_rotation_z(angle),
            shape,
        });
        Shape::Compound(Compound::new(parts.collect()).expect(VALID))
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn shapes_within_the_limits_step_and_stay_finite(
        ground in prop_oneof![mesh(), heights(), compound()],
        falling in prop_oneof![compound(), Just(BALL)],
        places in prop::collection::vec(corner(), 1..6),
        kind in prop::sample::select(vec![BodyKind::Fixed, BodyKind::Kinematic]),
    ) {
        let mut scene = scene();
        // A shape without a solid is refused, and nothing has changed.
        let made = [(0, ground), (1, falling)].map(|(id, shape)| add_shape(&mut scene, id, shape));
        let _ = add(&mut scene, BodyDesc::plain(GROUND, kind, ShapeId(0)), Vec3::ZERO);
        for (number, place) in places.into_iter().enumerate() {
            let id = BodyId::new(number as u32 + 1, 0);
            let desc = BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(1));
            let added = add(&mut scene, desc, place * 3.0 + Vec3::Y);
            let sound = added.is_ok() || matches!(added, Err(CommandError::NoInside(_)));
            prop_assert!(sound || made[1].is_err(), "{added:?}");
        }
        for _ in 0..30 {
            prop_assert!(scene.step().is_ok());
            for observation in scene.observations() {
                prop_assert!(observation.motion.parts().iter().all(|part| part.is_finite()));
            }
        }
    }
}
