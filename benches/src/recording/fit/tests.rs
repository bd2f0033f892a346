//! Tests of parameters that poses tell.

use super::*;
use crate::recording::{ReadOptions, read_bytes};

/// A body that falls, and one that rests, for some frames.
fn recording(frames: u32) -> Recording {
    let mut text = "time,body,x,y,z,qx,qy,qz,qw,vx,vy,vz,wx,wy,wz\n".to_owned();
    for frame in 0..frames {
        let y = f64::from(frame) * 0.1;
        let x = 0.01 * f64::from(frame % 2);
        text += &format!("{y},a,{y},0,0,0,0,0,1,1,0,0,0,0,0\n{y},b,{x},5,0,0,0,0,1,0,0,0,0,0,0\n");
    }
    read_bytes("r", text.as_bytes(), &ReadOptions::default()).expect("sound")
}

#[test]
fn the_states_of_paths_are_bounded_by_frames_from_the_first() {
    let recording = recording(100);
    let all = paths(&recording);
    assert_eq!((all.frames, all.bodies.len()), (100, 2));
    let few = paths_within(&recording, 60);
    assert_eq!((few.frames, few.bodies.len()), (31, 2));
    assert!(few.bodies.iter().all(|path| path.states.len() == 31));
}

#[test]
fn what_no_scene_can_have_is_not_taken_and_said() {
    let before = recording(20);
    let id = before.truth.placed[0].desc.id;
    let wild = [
        Found {
            gravity: Some(DVec3::new(0.0, -2e3, 0.0)),
            ..Found::default()
        },
        Found {
            gravity: Some(DVec3::NAN),
            ..Found::default()
        },
        Found {
            kept: Some([1.0, 0.0]),
            ..Found::default()
        },
        Found {
            kept: Some([f64::NAN, 1.0]),
            ..Found::default()
        },
        Found {
            centres: BTreeMap::from([(id, DVec3::splat(1e300))]),
            ..Found::default()
        },
    ];
    for found in wild {
        let mut recording = before.clone();
        apply(&mut recording, &found);
        assert_eq!(recording.gravity, before.gravity, "{found:?}");
        assert_eq!(recording.damping, before.damping, "{found:?}");
        assert_eq!(recording.truth.digest, before.truth.digest, "{found:?}");
        let notes = recording.notes.len() - before.notes.len();
        assert_eq!(notes, 1, "{found:?}");
    }
}

#[test]
fn equations_are_solved_and_singular_ones_are_not() {
    let x = solve([[0.0, 2.0], [4.0, 1.0]], [6.0, 7.0]).expect("one solution");
    assert!((x[0] - 1.0).abs() < 1e-12 && (x[1] - 3.0).abs() < 1e-12);
    assert_eq!(solve([[1.0, 2.0], [2.0, 4.0]], [1.0, 2.0]), None);
}

#[test]
fn principal_axes_give_the_tensor_back() {
    let turn = DMat3::from_quat(DQuat::from_rotation_y(0.4) * DQuat::from_rotation_x(1.1));
    let tensor = turn * DMat3::from_diagonal(DVec3::new(1.0, 2.0, 2.5)) * turn.transpose();
    let rows = [0, 1, 2].map(|row| tensor.row(row).to_array());
    let (moments, axes) = principal_axes(rows);
    let axes = DMat3::from_quat(axes);
    let again = axes * DMat3::from_diagonal(DVec3::from_array(moments)) * axes.transpose();
    assert!(again.abs_diff_eq(tensor, 1e-12), "{again}");
    assert_eq!(
        least_eigenvector([[3.0, 0.0], [0.0, 1.0]]).map(f64::abs),
        [0.0, 1.0]
    );
}
