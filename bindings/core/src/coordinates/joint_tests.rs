//! Tests of the conversion of joints: the same motions in any axes.

use glam::{Quat, Vec3};
use proptest::prelude::*;
use rhumb_client::BodyId;
use rhumb_client::scene::{
    Joint, JointFrame, JointKind, JointLimits, JointStrength, LockedAxes, Motor, Spring,
};

use super::Coordinates;

fn each() -> impl Strategy<Value = Coordinates> {
    proptest::sample::select(&Coordinates::EACH[..])
}

fn plain(kind: JointKind) -> Joint {
    let bodies = [BodyId::new(0, 0), BodyId::new(1, 0)];
    Joint::plain(kind, bodies, [JointFrame::at(Vec3::ZERO); 2])
}

fn only(limits: JointLimits, axis: usize) -> Joint {
    let mut all = [None; 6];
    all[axis] = Some(limits);
    plain(JointKind::Generic(LockedAxes::NONE, all))
}

/// True if a turn and a displacement of the second frame in the first are within all limits of a joint.
fn allows(joint: &Joint, displacement: Vec3, turn: Quat) -> bool {
    let angle = |part: f32| 2.0 * part.asin();
    let angles = [angle(turn.x), angle(turn.y), angle(turn.z)];
    let positions = displacement.to_array().into_iter().chain(angles);
    let limits = joint.kind.limits();
    positions.zip(limits).all(|(position, limits)| {
        limits.is_none_or(|limits| (limits.least..=limits.most).contains(&position))
    })
}

proptest! {
    #[test]
    fn a_limit_allows_the_same_motions_in_any_axes(
        coordinates in each(),
        axis in 0_usize..6,
        least in -1.0_f32..0.5,
        length in 0.1_f32..1.0,
        at in -1.5_f32..1.5,
    ) {
        let limits = JointLimits { least, most: least + length };
        // Rounding decides what lies on a limit.
        prop_assume!((at - limits.least).abs() > 1e-3 && (at - limits.most).abs() > 1e-3);
        let (mut displacement, mut turn) = (Vec3::ZERO, Quat::IDENTITY);
        match axis {
            0..3 => displacement = Vec3::AXES[axis] * at,
            _ => turn = Quat::from_axis_angle(Vec3::AXES[axis - 3], at),
        }
        let joint = only(limits, axis);
        let inside = coordinates.joint_in(&joint);
        prop_assert_eq!(
            allows(&inside, coordinates.vector_in(displacement), coordinates.rotation_in(turn)),
            allows(&joint, displacement, turn)
        );
    }

    #[test]
    fn a_motor_drives_the_same_way_in_any_axes(
        coordinates in each(),
        axis in 0_usize..6,
        velocity in -2.0_f32..2.0,
    ) {
        let mut joint = plain(JointKind::Generic(LockedAxes::NONE, [None; 6]));
        joint.motors[axis] = Some(Motor::with_velocity(velocity, 1.0));
        let inside = coordinates.joint_in(&joint);
        let speeds = inside.motors.map(|motor| motor.map_or(0.0, |motor| motor.velocity));
        let [x, y, z, about_x, about_y, about_z] = speeds;
        let (linear, angular) = match axis {
            0..3 => (Vec3::AXES[axis] * velocity, Vec3::ZERO),
            _ => (Vec3::ZERO, Vec3::AXES[axis - 3] * velocity),
        };
        let linear_off = Vec3::new(x, y, z).distance(coordinates.vector_in(linear));
        let turned = Vec3::new(about_x, about_y, about_z);
        let angular_off = turned.distance(coordinates.angular_in(angular));
        prop_assert!(linear_off < 1e-6 && angular_off < 1e-6);
    }
}

#[test]
fn a_hinge_stays_a_hinge_and_a_left_handed_one_turns_the_other_way() {
    let limits = JointLimits {
        least: -0.5,
        most: 1.0,
    };
    let hinge = plain(JointKind::Revolute(Some(limits)));
    let turned = JointLimits {
        least: -1.0,
        most: 0.5,
    };
    for (coordinates, expected) in [
        (Coordinates::Rhumb, limits),
        (Coordinates::Unity, turned),
        (Coordinates::Unreal, turned),
        (Coordinates::ZUp, limits),
    ] {
        let inside = coordinates.joint_in(&hinge);
        assert_eq!(inside.kind, JointKind::Revolute(Some(expected)));
    }
}

#[test]
fn lengths_forces_and_torques_of_a_joint_are_in_the_applications_units() {
    let spring = Spring {
        length: 100.0,
        stiffness: 7.0,
        damping: 3.0,
    };
    let mut joint = plain(JointKind::Spring(spring));
    joint.frames[1].anchor = Vec3::new(100.0, 200.0, 300.0);
    joint.strength = Some(JointStrength {
        force: 100.0,
        torque: 10_000.0,
    });
    let inside = Coordinates::Unreal.joint_in(&joint);
    assert_eq!(
        inside.kind,
        JointKind::Spring(Spring {
            length: 1.0,
            ..spring
        })
    );
    assert_eq!(inside.frames[1].anchor, Vec3::new(1.0, 3.0, 2.0));
    let strength = inside.strength.expect("it breaks");
    assert!((strength.force - 1.0).abs() < 1e-6 && (strength.torque - 1.0).abs() < 1e-6);
}
