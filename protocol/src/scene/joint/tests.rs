//! Joints: which are sound, their bytes, and what is refused.

use glam::Vec3;
use proptest::prelude::*;

use super::*;

fn number() -> impl Strategy<Value = f32> {
    prop_oneof![
        any::<f32>().prop_filter("NaN equals nothing", |x| !x.is_nan()),
        Just(0.0)
    ]
}

fn limits() -> impl Strategy<Value = JointLimits> {
    (number(), number()).prop_map(|(least, most)| JointLimits { least, most })
}

fn frame() -> impl Strategy<Value = JointFrame> {
    let rotation = prop_oneof![
        Just(Quat::IDENTITY),
        (number(), number()).prop_map(|(x, w)| Quat::from_xyzw(x, 0.0, 1.0, w)),
    ];
    let anchor = (number(), number()).prop_map(|(x, z)| Vec3::new(x, 1.0, z));
    (anchor, rotation).prop_map(|(anchor, rotation)| JointFrame { anchor, rotation })
}

fn joint() -> impl Strategy<Value = Joint> {
    let kind = prop_oneof![
        Just(JointKind::Fixed),
        prop::option::of([limits(), limits(), limits()]).prop_map(JointKind::Spherical),
        prop::option::of(limits()).prop_map(JointKind::Revolute),
        prop::option::of(limits()).prop_map(JointKind::Prismatic),
        number().prop_map(JointKind::Rope),
        (number(), number()).prop_map(|(length, stiffness)| {
            JointKind::Spring(Spring {
                length,
                stiffness,
                damping: 1.0,
            })
        }),
        (0..64_u8, axes(limits())).prop_map(|(locked, limits)| {
            JointKind::Generic(LockedAxes::new(locked).unwrap(), limits)
        }),
    ];
    let motor = (number(), number()).prop_map(|(position, force)| Motor {
        force,
        ..Motor::at_position(position, 1.0, 2.0)
    });
    let strength = (number(), number()).prop_map(|(force, torque)| JointStrength { force, torque });
    let more = (axes(motor), prop::option::of(strength));
    let body = || (0..1_u32 << 20, any::<u16>()).prop_map(|(i, g)| BodyId::new(i, g));
    (
        kind,
        [body(), body()],
        [frame(), frame()],
        any::<bool>(),
        more,
    )
        .prop_map(
            |(kind, bodies, frames, collide, (motors, strength))| Joint {
                collide,
                motors,
                strength,
                ..Joint::plain(kind, bodies, frames)
            },
        )
}

fn axes<T: Clone + fmt::Debug>(
    value: impl Strategy<Value = T>,
) -> impl Strategy<Value = [Option<T>; 6]> {
    prop::array::uniform6(prop::option::of(value))
}

#[test]
fn a_limit_or_motor_of_a_locked_axis_is_refused_by_the_name_of_the_axis() {
    use alloc::string::ToString;

    let frames = [JointFrame::at(Vec3::ZERO); 2];
    let bodies = [BodyId::new(0, 0), BodyId::new(1, 0)];
    let mut limits = [None; 6];
    limits[4] = Some(JointLimits {
        least: 0.0,
        most: 1.0,
    });
    let kind = JointKind::Generic(LockedAxes::ROTATIONS, limits);
    let limited = Joint::plain(kind, bodies, frames).check();
    let text = limited.expect_err("it is locked").to_string();
    assert!(
        text.starts_with("limit of axis 4, the rotation about y: "),
        "{text}"
    );
    let mut driven = Joint::plain(JointKind::Revolute(None), bodies, frames);
    driven.motors[2] = Some(Motor {
        position: 0.0,
        velocity: 1.0,
        stiffness: 0.0,
        damping: 1.0,
        force: 9.0,
    });
    let text = driven.check().expect_err("it is locked").to_string();
    assert!(
        text.starts_with("motor of axis 2, the translation along z: "),
        "{text}"
    );
}

proptest! {
    #[test]
    fn a_joint_round_trips_and_truncations_are_refused(joint in joint()) {
        let mut writer = Writer::new();
        joint.encode(&mut writer);
        let bytes = writer.into_bytes();
        let mut reader = Reader::new(&bytes);
        prop_assert_eq!(Joint::decode(&mut reader), Ok(joint));
        prop_assert_eq!(reader.finish(), Ok(()));
        for cut in 0..bytes.len() {
            let cut = Joint::decode(&mut Reader::new(&bytes[..cut]));
            prop_assert_eq!(cut, Err(Malformed::Truncated));
        }
    }

    #[test]
    fn a_decoded_joint_encodes_to_the_same_bytes(bytes in prop::collection::vec(any::<u8>(), 0..120)) {
        let mut reader = Reader::new(&bytes);
        if let Ok(joint) = Joint::decode(&mut reader) {
            let mut writer = Writer::new();
            joint.encode(&mut writer);
            prop_assert_eq!(&writer.into_bytes()[..], &bytes[..bytes.len() - reader.rest().len()]);
        }
    }
}

#[test]
fn limits_that_cross_are_refused() {
    let limits = |least, most| JointLimits { least, most };
    let wrong = Err(Invalid::out_of_range(Quantity::JointLimit));
    assert_eq!(limits(0.5, 0.4).check(3), wrong);
    assert_eq!(limits(-7.0, -6.0).check(3), wrong);
    assert_eq!(limits(0.5, 0.5).check(3), Ok(()));
    // Three quarters of a turn, and more than a whole one.
    assert_eq!(limits(0.0, 1.5 * PI).check(3), Ok(()));
    assert_eq!(limits(-PI, PI).check(4), Ok(()));
    assert_eq!(limits(-1.5 * PI, 1.5 * PI).check(3), wrong);
    assert_eq!(limits(-7.0, 7.0).check(0), Ok(()));
}

#[test]
fn a_motor_reaches_as_far_as_limits_of_a_turn() {
    let ends = [BodyId::new(0, 0), BodyId::new(1, 0)];
    let frames = [JointFrame::at(Vec3::ZERO); 2];
    let check = |limits, to| {
        let mut joint = Joint::plain(JointKind::Revolute(limits), ends, frames);
        joint.motors[3] = Some(Motor::at_position(to, 1.0, 1.0));
        joint.check().is_ok()
    };
    let limits = Some(JointLimits {
        least: 0.0,
        most: 4.7,
    });
    assert!(check(limits, 4.5) && check(limits, -TAU));
    assert!(!check(limits, 6.5) && !check(None, 4.5) && check(None, PI));
}

#[test]
fn only_free_axes_have_limits_and_motors() {
    let bodies = [BodyId::new(0, 0), BodyId::new(1, 0)];
    let of = |kind| Joint::plain(kind, bodies, [JointFrame::at(Vec3::ZERO); 2]);
    let mut hinge = of(JointKind::Revolute(None));
    hinge.motors[3] = Some(Motor::with_velocity(2.0, 1.0));
    assert_eq!(hinge.check(), Ok(()));
    hinge.motors[0] = hinge.motors[3];
    let wrong = Err(Invalid::out_of_range(Quantity::Motor));
    assert_eq!(hinge.check(), wrong);
    let mut rope = of(JointKind::Rope(2.0));
    assert_eq!(rope.check(), Ok(()));
    rope.motors[0] = Some(Motor::with_velocity(2.0, 1.0));
    assert_eq!(rope.check(), wrong);
    let mut limits = [None; 6];
    limits[1] = Some(JointLimits {
        least: -1.0,
        most: 1.0,
    });
    let generic = |locked| of(JointKind::Generic(locked, limits)).check();
    assert_eq!(generic(LockedAxes::ROTATIONS), Ok(()));
    let wrong = Err(Invalid::out_of_range(Quantity::JointLimit));
    assert_eq!(generic(LockedAxes::TRANSLATIONS), wrong);
}

#[test]
fn a_joint_goes_with_either_of_its_bodies() {
    let body = |index| BodyId::new(index, 0);
    let frames = [JointFrame::at(Vec3::ZERO); 2];
    let between = |bodies| Joint::plain(JointKind::Fixed, bodies, frames);
    let mut joints = Joints::default();
    for first in 0..3 {
        let joint = between([body(first), body(first + 1)]);
        let id = JointId(first);
        assert_eq!(joints.insert(id, between([body(8), body(9)])), None);
        assert_eq!(
            joints.insert(id, joint).map(|joint| joint.bodies),
            Some([body(8), body(9)])
        );
    }
    assert_eq!(joints.remove_body(body(1)), [JointId(0), JointId(1)]);
    assert_eq!(joints.remove_body(body(1)), []);
    assert_eq!(joints.iter().count(), 1);
    assert_eq!(joints.remove_body(body(3)), [JointId(2)]);
    assert_eq!(joints.remove(JointId(2)), None);
    assert!(joints.by_body.is_empty());
}
