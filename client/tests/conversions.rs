//! Conversion of `mint` and `nalgebra` vectors into bodies and out of views.
//!
//! Needs the feature `nalgebra`, which `rhumb-tests` turns on for the workspace.

use rhumb_client::glam::{Quat, Vec3};
use rhumb_client::scene::{BodyDesc, Shape};

#[test]
fn a_body_starts_at_a_mint_vector() {
    let start = mint::Vector3::from([1.0_f32, 2.0, 3.0]);
    let turn = mint::Quaternion::from([0.0_f32, 1.0, 0.0, 0.0]);
    let body = BodyDesc::dynamic(Shape::ball(0.5))
        .position(start)
        .rotation(turn);
    let state = body.state().unwrap();
    assert_eq!(state.position(), [1.0, 2.0, 3.0]);
    assert_eq!(state.rotation(), [0.0, 1.0, 0.0, 0.0]);
    let shown: mint::Vector3<f32> = Vec3::new(1.0, 2.0, 3.0).into();
    assert_eq!(shown, start);
}

#[test]
fn a_body_starts_at_a_nalgebra_vector() {
    let start = nalgebra::Vector3::new(1.0_f32, 2.0, 3.0);
    let turn = nalgebra::UnitQuaternion::<f32>::identity();
    let body = BodyDesc::dynamic(Shape::ball(0.5))
        .position(start)
        .rotation(turn)
        .linear_velocity(nalgebra::Vector3::new(0.0_f32, 0.0, 4.0));
    let state = body.state().unwrap();
    assert_eq!(state.position(), [1.0, 2.0, 3.0]);
    assert_eq!(state.parts()[7..10], [0.0, 0.0, 4.0]);
    let shown: nalgebra::Isometry3<f32> = (Vec3::new(1.0, 2.0, 3.0), Quat::IDENTITY).into();
    assert_eq!(shown.translation.vector, start);
}
