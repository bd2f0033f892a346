//! Joints of every kind: limits, motors, strength, and disabled bodies.
//!
//! The helpers of the parent check after every tick that the copy keeps its promise and has the joints of the scene.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{
    BodyDesc, Command, CommandError, Joint, JointFrame, JointId, JointKind, JointLimits,
    JointStrength, LockedAxes, Motor, Shape, Spring,
};
use rhumb_reckoning::{BodyId, Damping};

use super::{Remote, near};

/// A static post at the origin and a ball that hangs on it, two metres to the side.
fn hung(remote: &mut Remote) -> [BodyId; 2] {
    let post = remote.add(&BodyDesc::fixed(Shape::ball(0.1)));
    let bob = remote.add(
        &BodyDesc::dynamic(Shape::ball(0.5))
            .at(2.0, 0.0, 0.0)
            .mass(3.0),
    );
    [post, bob]
}

fn joint(kind: JointKind, bodies: [BodyId; 2]) -> Joint {
    let frames = [
        JointFrame::at(Vec3::ZERO),
        JointFrame::at(Vec3::new(-2.0, 0.0, 0.0)),
    ];
    Joint::plain(kind, bodies, frames)
}

#[test]
fn a_rope_keeps_its_length_and_a_spring_stretches_by_its_load() {
    let mut remote = Remote::new();
    let bodies = hung(&mut remote);
    let centres = [JointFrame::at(Vec3::ZERO); 2];
    remote.change(bodies[1], |desc| {
        desc.damping = Some(Damping {
            linear: 2.0,
            angular: 2.0,
        });
    });
    remote.join(0, Joint::plain(JointKind::Rope(2.5), bodies, centres));
    remote.steps(600);
    near(remote.position(bodies[1]).length(), 2.5, 0.03);
    let spring = JointKind::Spring(Spring {
        length: 1.0,
        stiffness: 30.0,
        damping: 1.0,
    });
    remote.done(&Command::ChangeJoint {
        id: JointId(0),
        joint: Joint::plain(spring, bodies, centres).into(),
    });
    remote.steps(600);
    // 3 kg · 10 m/s² / 30 N/m
    near(remote.position(bodies[1]).length(), 2.0, 0.03);
}

#[test]
fn a_motor_turns_a_hinge_and_its_target_changes_later() {
    let mut remote = Remote::new();
    let bodies = hung(&mut remote);
    remote.done(&Command::SetGravity {
        gravity: Vec3::ZERO,
    });
    let mut hinge = joint(JointKind::Revolute(None), bodies);
    hinge.motors[3] = Some(Motor::with_velocity(2.0, 100.0));
    remote.join(0, hinge);
    remote.steps(60);
    near(remote.spin(bodies[1]).x, 2.0, 0.05);
    hinge.motors[3] = Some(Motor::at_position(1.0, 100.0, 20.0));
    remote.done(&Command::ChangeJoint {
        id: JointId(0),
        joint: hinge.into(),
    });
    remote.steps(300);
    let parts = remote
        .truth
        .observation(bodies[1])
        .expect("it lives")
        .motion
        .parts();
    let angle = 2.0 * parts[3].atan2(parts[6]);
    near(angle.sin(), 1.0_f32.sin(), 0.03);
}

#[test]
fn a_generic_joint_leaves_its_free_axes_within_their_limits() {
    let mut remote = Remote::new();
    let bodies = hung(&mut remote);
    let mut limits = [None; 6];
    limits[1] = Some(JointLimits {
        least: -0.75,
        most: 0.25,
    });
    let locked = LockedAxes::EACH[0] | LockedAxes::EACH[2] | LockedAxes::ROTATIONS;
    remote.join(0, joint(JointKind::Generic(locked, limits), bodies));
    remote.steps(240);
    let hangs = remote.position(bodies[1]);
    assert!(
        (hangs - Vec3::new(2.0, -0.75, 0.0)).length() < 0.03,
        "{hangs}"
    );
}

#[test]
fn a_joint_breaks_above_its_strength_in_the_copy_too() {
    for (force, breaks) in [(200.0, false), (15.0, true)] {
        let mut remote = Remote::new();
        let [post, bob] = hung(&mut remote);
        let frames = [
            JointFrame::at(Vec3::new(2.0, 0.0, 0.0)),
            JointFrame::at(Vec3::ZERO),
        ];
        let mut fixed = Joint::plain(JointKind::Fixed, [post, bob], frames);
        fixed.strength = Some(JointStrength { force, torque: 1e6 });
        // The bob weighs 30 N.
        remote.join(0, fixed);
        remote.steps(60);
        let is_there = remote.truth.joints().get(JointId(0)).is_some();
        assert_eq!(is_there, !breaks, "{force} N");
        assert_eq!(remote.position(bob).y < -2.0, breaks, "{force} N");
    }
}

#[test]
fn a_joint_acts_while_both_of_its_bodies_are_enabled() {
    let mut remote = Remote::new();
    let [post, bob] = hung(&mut remote);
    for id in [post, bob] {
        remote.change(id, |desc| desc.enabled = false);
    }
    remote.join(0, joint(JointKind::Spherical(None), [post, bob]));
    remote.steps(10);
    remote.change(bob, |desc| desc.enabled = true);
    remote.steps(60);
    assert!(remote.position(bob).y < -4.0, "it falls free");
    remote.done(&Command::SetPose {
        id: bob,
        position: Vec3::new(2.0, 0.0, 0.0),
        rotation: Quat::IDENTITY,
    });
    remote.change(post, |desc| desc.enabled = true);
    remote.steps(120);
    near(remote.position(bob).length(), 2.0, 0.1);
}

#[test]
fn joints_are_limited_by_the_number_of_bodies() {
    let mut remote = Remote::new();
    let bodies = hung(&mut remote);
    let kind = JointKind::Spherical(None);
    let mut joints = 0;
    let refused = loop {
        let id = JointId(joints);
        let joint = joint(kind, bodies);
        match remote.send(&Command::AddJoint {
            id,
            joint: joint.into(),
        }) {
            Ok(()) => joints += 1,
            Err(error) => break error,
        }
    };
    assert_eq!((joints, refused), (72, CommandError::TooManyJoints));
    remote.steps(10);
}
