//! Motors follow the protocol's law with any lever, mass and load.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{
    BodyKind, Joint, JointFrame, JointKind, JointLimits, LockedAxes, Motor, Shape,
};
use rhumb_reckoning::BodyId;

use super::tests::TestWorld;

/// The law by itself: where a motor is after each tick.
fn law(motor: &Motor, ticks: usize) -> Vec<f64> {
    const STEPS: usize = 64;
    let step = 1.0 / 60.0 / STEPS as f64;
    let (mut at, mut speed) = (0.0, 0.0);
    let mut places = Vec::new();
    for _ in 0..ticks {
        for _ in 0..STEPS {
            let lack = f64::from(motor.position) - at;
            let slow = f64::from(motor.velocity) - speed;
            speed += (f64::from(motor.stiffness) * lack + f64::from(motor.damping) * slow) * step;
            at += speed * step;
        }
        places.push(at);
    }
    places
}

/// The angle of a rotation about x, radians.
fn angle(rotation: Quat) -> f64 {
    let angle = 2.0 * f64::from(rotation.x).atan2(f64::from(rotation.w));
    (angle + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI
}

fn hinge(bodies: [BodyId; 2], anchors: [Vec3; 2], motor: Motor) -> Joint {
    let frames = anchors.map(JointFrame::at);
    let mut joint = Joint::plain(JointKind::Revolute(None), bodies, frames);
    joint.motors[3] = Some(motor);
    joint
}

/// The greatest distance from the law in 90 ticks.
fn off(motor: &Motor, mut measured: impl FnMut() -> f64) -> f64 {
    let right = law(motor, 90);
    let distances = right.into_iter().map(|right| (measured() - right).abs());
    distances.fold(0.0, f64::max)
}

#[test]
fn a_hinge_follows_the_law_with_any_lever_and_body() {
    let bodies = [
        Shape::cuboid(0.5, 0.1, 0.1),
        Shape::cuboid(0.05, 0.8, 0.3),
        Shape::ball(0.1),
        Shape::capsule(0.5, 0.05),
    ];
    for shape in &bodies {
        for lever in [
            Vec3::ZERO,
            Vec3::Y * 0.3,
            Vec3::new(0.4, -1.0, 0.2),
            Vec3::Z * 3.0,
        ] {
            for motor in [
                Motor::at_position(1.0, 100.0, 20.0),
                Motor::at_position(-0.7, 400.0, 24.0),
                Motor::at_position(0.5, 20.0, 3.0),
                Motor::with_velocity(1.0, 8.0),
                Motor::with_velocity(-0.8, 60.0),
            ] {
                let mut world = TestWorld::new(Vec3::ZERO);
                let post = world.add(BodyKind::Fixed, Shape::ball(0.05), Vec3::ZERO, |_| ());
                let door = world.add(BodyKind::Dynamic, shape.clone(), lever, |_| ());
                world.join(&hinge([post, door], [Vec3::ZERO, -lever], motor));
                let off = off(&motor, || {
                    world.step();
                    angle(world.rotation(door))
                });
                assert!(off < 0.03, "{shape:?} at {lever}, {motor:?}: {off} rad");
            }
        }
    }
}

#[test]
fn a_hinge_between_free_bodies_follows_the_law() {
    for (first, second) in [(0.3, 0.3), (0.1, 0.6), (0.6, 0.1)] {
        for motor in [
            Motor::at_position(0.8, 100.0, 20.0),
            Motor::with_velocity(-1.0, 20.0),
        ] {
            let mut world = TestWorld::new(Vec3::ZERO);
            let sizes = [first, second].map(|size| Shape::cuboid(0.1, size, 0.2));
            let [one, other] = sizes;
            let arm = world.add(BodyKind::Dynamic, one, Vec3::Y, |_| ());
            let leg = world.add(BodyKind::Dynamic, other, -Vec3::Y, |_| ());
            world.join(&hinge([arm, leg], [-Vec3::Y, Vec3::Y], motor));
            let off = off(&motor, || {
                world.step();
                angle(world.rotation(arm).inverse() * world.rotation(leg))
            });
            assert!(off < 0.07, "{first} and {second}, {motor:?}: {off} rad");
        }
    }
}

#[test]
fn a_slide_off_the_centre_of_mass_follows_the_law() {
    for lever in [Vec3::ZERO, Vec3::Y, Vec3::new(0.0, 0.5, -1.5)] {
        for motor in [
            Motor::at_position(1.0, 100.0, 20.0),
            Motor::at_position(0.5, 30.0, 4.0),
            Motor::with_velocity(1.0, 10.0),
        ] {
            let mut world = TestWorld::new(Vec3::ZERO);
            let rail = world.add(BodyKind::Fixed, Shape::ball(0.05), Vec3::ZERO, |_| ());
            let cart = world.add(
                BodyKind::Dynamic,
                Shape::cuboid(0.2, 0.1, 0.1),
                lever,
                |_| (),
            );
            let frames = [Vec3::ZERO, -lever].map(JointFrame::at);
            let mut joint = Joint::plain(JointKind::Prismatic(None), [rail, cart], frames);
            joint.motors[0] = Some(motor);
            world.join(&joint);
            let off = off(&motor, || {
                world.step();
                f64::from(world.position(cart).x)
            });
            assert!(off < 0.02, "{lever}, {motor:?}: {off} m");
        }
    }
}

#[test]
fn a_generic_joint_with_one_free_turn_follows_the_law() {
    let motor = Motor::at_position(1.0, 100.0, 20.0);
    for axis in 3..6 {
        let mut world = TestWorld::new(Vec3::ZERO);
        let post = world.add(BodyKind::Fixed, Shape::ball(0.05), Vec3::ZERO, |_| ());
        let lever = Vec3::new(0.6, 0.5, 0.7);
        let door = world.add(
            BodyKind::Dynamic,
            Shape::cuboid(0.3, 0.2, 0.1),
            lever,
            |_| (),
        );
        let all = LockedAxes::TRANSLATIONS | LockedAxes::ROTATIONS;
        let locked = LockedAxes::new(all.bits() & !LockedAxes::EACH[axis].bits());
        let kind = JointKind::Generic(locked.expect("five axes"), [None; 6]);
        let frames = [Vec3::ZERO, -lever].map(JointFrame::at);
        let mut joint = Joint::plain(kind, [post, door], frames);
        joint.motors[axis] = Some(motor);
        world.join(&joint);
        let off = off(&motor, || {
            world.step();
            let rotation = world.rotation(door);
            let part = [rotation.x, rotation.y, rotation.z][axis - 3];
            2.0 * f64::from(part).atan2(f64::from(rotation.w))
        });
        assert!(off < 0.03, "axis {axis}: {off} rad");
    }
}

/// The greatest angle of a hinge in a chain, and how far each is from its target after five seconds.
fn chain(links: u32, motor: Motor) -> (f64, f64) {
    let mut world = TestWorld::new(Vec3::ZERO);
    let mut before = world.add(BodyKind::Fixed, Shape::ball(0.05), Vec3::ZERO, |_| ());
    let mut anchor = Vec3::ZERO;
    let mut chain = Vec::new();
    for link in 0..links {
        let at = Vec3::Y * (link as f32 + 0.5);
        let shape = Shape::cuboid(0.05, 0.45, 0.05);
        let body = world.add(BodyKind::Dynamic, shape, at, |_| ());
        world.join(&hinge([before, body], [anchor, -Vec3::Y * 0.5], motor));
        chain.push((before, body));
        (before, anchor) = (body, Vec3::Y * 0.5);
    }
    let (mut most, mut end) = (0.0_f64, 0.0);
    for _ in 0..300 {
        world.step();
        let turns = chain
            .iter()
            .map(|(before, body)| angle(world.rotation(*before).inverse() * world.rotation(*body)));
        let turns: Vec<_> = turns.collect();
        most = turns.iter().copied().fold(most, f64::max);
        let off = turns
            .iter()
            .map(|turn| (turn - f64::from(motor.position)).abs());
        end = off.fold(0.0, f64::max);
    }
    (most, end)
}

#[test]
fn each_hinge_of_a_chain_comes_to_rest_at_its_target() {
    let motors = [
        (100.0, 20.0),
        (400.0, 40.0),
        (25.0, 10.0),
        (1e4, 200.0),
        (1e6, 2e3),
    ];
    for (stiffness, damping) in motors {
        let motor = Motor::at_position(0.4, stiffness, damping);
        for (links, end_off) in [(2, 1e-3), (3, 1e-3), (4, 0.02), (5, 0.08)] {
            let (most, end) = chain(links, motor);
            assert!(
                end < end_off && most < 0.48,
                "{links}, {motor:?}: {most}, {end}"
            );
        }
    }
    let (most, _) = chain(2, Motor::at_position(0.4, 100.0, 20.0));
    assert!(most < 0.41, "two links without overshoot: {most}");
}

#[test]
fn a_motor_moves_what_is_fixed_to_its_body() {
    let motor = Motor::at_position(1.0, 100.0, 20.0);
    let mut world = TestWorld::new(Vec3::ZERO);
    let post = world.add(BodyKind::Fixed, Shape::ball(0.05), Vec3::ZERO, |_| ());
    let boom = world.add(
        BodyKind::Dynamic,
        Shape::cuboid(0.05, 0.5, 0.05),
        Vec3::Y * 0.5,
        |_| (),
    );
    let load = world.add(BodyKind::Dynamic, Shape::ball(0.2), Vec3::Y * 1.2, |_| ());
    world.join(&hinge([post, boom], [Vec3::ZERO, -Vec3::Y * 0.5], motor));
    let frames = [Vec3::Y * 0.7, Vec3::ZERO].map(JointFrame::at);
    world.join(&Joint::plain(JointKind::Fixed, [boom, load], frames));
    let off = off(&motor, || {
        world.step();
        angle(world.rotation(boom))
    });
    assert!(off < 0.1, "{off} rad");
}

#[test]
fn a_motor_beyond_the_engine_keeps_its_damping() {
    for (stiffness, damping) in [(1e4, 200.0), (1e6, 2e3)] {
        let mut world = TestWorld::new(Vec3::ZERO);
        let post = world.add(BodyKind::Fixed, Shape::ball(0.05), Vec3::ZERO, |_| ());
        let bob = world.add(BodyKind::Dynamic, Shape::ball(0.1), Vec3::Y * 2.0, |_| ());
        let motor = Motor::at_position(1.0, stiffness, damping);
        world.join(&hinge([post, bob], [Vec3::ZERO, -Vec3::Y * 2.0], motor));
        let mut most = 0.0_f64;
        for _ in 0..120 {
            world.step();
            most = most.max(angle(world.rotation(bob)));
        }
        let end = angle(world.rotation(bob));
        assert!((end - 1.0).abs() < 0.01 && most < 1.2, "{end}, {most}");
    }
}

#[test]
fn a_motor_gives_no_more_than_its_torque() {
    let mut world = TestWorld::new(Vec3::ZERO);
    let post = world.add(BodyKind::Fixed, Shape::ball(0.05), Vec3::ZERO, |_| ());
    let bob = world.add(BodyKind::Dynamic, Shape::ball(0.1), Vec3::Y, |desc| {
        desc.mass = Some(rhumb_protocol::scene::Mass {
            mass: 2.0,
            moments: None,
        });
    });
    let motor = Motor {
        force: 3.0,
        ..Motor::with_velocity(50.0, 1e4)
    };
    world.join(&hinge([post, bob], [Vec3::ZERO, -Vec3::Y], motor));
    for _ in 0..60 {
        world.step();
    }
    let spin = world.spin(bob).length();
    let inertia = 2.0 * (1.0 + 0.4 * 0.01);
    assert!((spin - 3.0 / inertia).abs() < 0.05, "{spin}");
}

/// A joint that leaves these axes free, with this motor on each of them, about the second body's own `lever` behind its
/// centre.
fn driven(
    world: &mut TestWorld,
    shape: Shape,
    lever: Vec3,
    kind: JointKind,
    motors: [Option<Motor>; 6],
) -> [BodyId; 2] {
    let post = world.add(BodyKind::Fixed, Shape::ball(0.05), Vec3::ZERO, |_| ());
    let arm = world.add(BodyKind::Dynamic, shape, lever, |_| ());
    let mut joint = Joint::plain(kind, [post, arm], [Vec3::ZERO, -lever].map(JointFrame::at));
    joint.motors = motors;
    world.join(&joint);
    [post, arm]
}

/// The law about three axes at once: the rotation after each tick, as a turn about a line that stands still.
fn about(rotation: Quat, line: Vec3) -> f64 {
    let along = Vec3::new(rotation.x, rotation.y, rotation.z).dot(line);
    2.0 * f64::from(along).atan2(f64::from(rotation.w))
}

#[test]
fn three_motors_of_a_ball_joint_follow_the_law_with_any_lever_and_body() {
    let bodies = [
        Shape::cuboid(0.5, 0.1, 0.2),
        Shape::ball(0.2),
        Shape::capsule(0.4, 0.1),
    ];
    let levers = [
        Vec3::ZERO,
        Vec3::X,
        Vec3::Y,
        Vec3::Z * 0.1,
        Vec3::new(0.3, -0.5, 0.2),
    ];
    let laws = [(100.0, 20.0), (10.0, 6.0), (400.0, 24.0)];
    for shape in &bodies {
        for lever in levers {
            for (stiffness, damping) in laws {
                for axis in 0..3 {
                    let mut world = TestWorld::new(Vec3::ZERO);
                    let motor = |to| Some(Motor::at_position(to, stiffness, damping));
                    let mut motors = [None, None, None, motor(0.0), motor(0.0), motor(0.0)];
                    motors[3 + axis] = motor(0.8);
                    let kind = JointKind::Spherical(None);
                    let [_, arm] = driven(&mut world, shape.clone(), lever, kind, motors);
                    let motor = Motor::at_position(0.8, stiffness, damping);
                    let off = off(&motor, || {
                        world.step();
                        about(world.rotation(arm), Vec3::AXES[axis])
                    });
                    let spin = world.spin(arm).length();
                    assert!(
                        off < 0.1,
                        "{shape:?} at {lever}, {motor:?} about {axis}: {off} rad, {spin}"
                    );
                }
            }
        }
    }
}

#[test]
fn a_shoulder_holds_its_arm_still_against_gravity() {
    for force in [rhumb_protocol::limits::FORCE_MAX, 1e4] {
        for targets in [
            [0.5, 0.0, 0.0],
            [0.4, 0.0, 0.4],
            [0.3, 0.6, 0.5],
            [1.0, 1.0, 1.0],
        ] {
            for damping in [20.0, 10.0, 5.0] {
                let mut world = TestWorld::new(Vec3::Y * -9.81);
                let mut motors = [None; 6];
                for (axis, to) in targets.into_iter().enumerate() {
                    let motor = Motor::at_position(to, 100.0, damping);
                    motors[3 + axis] = Some(Motor { force, ..motor });
                }
                let kind = JointKind::Spherical(None);
                let shape = Shape::capsule(0.4, 0.1);
                let [_, arm] = driven(&mut world, shape, Vec3::Y * -0.5, kind, motors);
                for _ in 0..300 {
                    world.step();
                }
                let rotation = world.rotation(arm);
                let parts = [rotation.x, rotation.y, rotation.z];
                // Gravity accelerates the arm by less than 9.81 / 0.5 rad/s², a stiffness of 100/s² gives way by as
                // much less.
                for (part, to) in parts.into_iter().zip(targets) {
                    let turn = 2.0 * part.asin();
                    assert!(
                        (turn - to).abs() < 0.2,
                        "{targets:?} with {damping}: {rotation}"
                    );
                }
                let spin = world.spin(arm).length();
                assert!(spin < 0.01, "{targets:?} with {damping}: {spin} rad/s");
            }
        }
    }
}

#[test]
fn motors_of_all_six_axes_follow_the_law() {
    for lever in [
        Vec3::ZERO,
        Vec3::Z * 0.1,
        Vec3::Z,
        Vec3::new(0.5, -1.0, 0.3),
    ] {
        for (stiffness, damping) in [(100.0, 20.0), (10.0, 6.0)] {
            for axis in 0..6 {
                let mut world = TestWorld::new(Vec3::ZERO);
                let motor = |to| Motor::at_position(to, stiffness, damping);
                let mut motors = [Some(motor(0.0)); 6];
                motors[axis] = Some(motor(0.5));
                let kind = JointKind::Generic(LockedAxes::default(), [None; 6]);
                let shape = Shape::cuboid(0.5, 0.1, 0.2);
                let [_, arm] = driven(&mut world, shape, lever, kind, motors);
                let off = off(&motor(0.5), || {
                    world.step();
                    let rotation = world.rotation(arm);
                    let anchor = world.position(arm) - rotation * lever;
                    match axis < 3 {
                        true => f64::from(anchor[axis]),
                        false => about(rotation, Vec3::AXES[axis - 3]),
                    }
                });
                let spin = world.spin(arm).length();
                assert!(
                    off < 0.1,
                    "{lever}, {stiffness}, axis {axis}: {off}, {spin} rad/s"
                );
            }
        }
    }
}

const LIMITED: [(f32, f32, Motor); 8] = [
    (-1.0, 1.0, Motor::with_velocity(2.0, 100.0)),
    (-1.0, 1.0, Motor::with_velocity(20.0, 10.0)),
    (-1.0, 1.0, Motor::with_velocity(20.0, 100.0)),
    (0.0, 4.7, Motor::with_velocity(8.0, 100.0)),
    (-1.0, 1.0, Motor::at_position(2.5, 1e4, 200.0)),
    (-1.0, 1.0, Motor::at_position(2.5, 400.0, 40.0)),
    (-0.5, 0.5, Motor::with_velocity(5.0, 1000.0)),
    (-0.3, 1.2, Motor::with_velocity(-6.0, 1e5)),
];

#[test]
fn a_limit_of_a_hinge_stops_its_motor() {
    for (least, most, motor) in LIMITED {
        for lever in [Vec3::ZERO, Vec3::Z * 0.5, Vec3::new(0.2, -1.0, 0.3)] {
            for kind in [BodyKind::Fixed, BodyKind::Dynamic] {
                let mut world = TestWorld::new(Vec3::ZERO);
                let post = world.add(kind, Shape::ball(0.3), Vec3::ZERO, |_| ());
                let door = world.add(
                    BodyKind::Dynamic,
                    Shape::cuboid(0.5, 0.1, 0.1),
                    lever,
                    |_| (),
                );
                let mut joint = hinge([post, door], [Vec3::ZERO, -lever], motor);
                joint.kind = JointKind::Revolute(Some(JointLimits { least, most }));
                world.join(&joint);
                let (mut turn, mut before) = (0.0, 0.0);
                let (mut low, mut high) = (0.0_f64, 0.0_f64);
                for _ in 0..240 {
                    world.step();
                    let now = angle(world.rotation(post).inverse() * world.rotation(door));
                    turn += (now - before + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU)
                        - std::f64::consts::PI;
                    before = now;
                    (low, high) = (low.min(turn), high.max(turn));
                }
                let over = (high - f64::from(most)).max(f64::from(least) - low);
                let end = (turn - f64::from(most)).max(f64::from(least) - turn);
                assert!(
                    over < 0.1 && end.abs() < 0.02,
                    "{least} to {most}, {lever}, {kind:?}, {motor:?}: {low} to {high}, at last {turn}"
                );
            }
        }
    }
}

#[test]
fn a_limit_of_a_slide_stops_its_motor() {
    let motors = [
        Motor::with_velocity(5.0, 100.0),
        Motor::with_velocity(20.0, 1000.0),
        Motor::with_velocity(-20.0, 50.0),
        Motor::at_position(3.0, 1e4, 200.0),
        Motor {
            force: 500.0,
            ..Motor::at_position(3.0, 1e4, 200.0)
        },
    ];
    for motor in motors {
        for lever in [Vec3::ZERO, Vec3::new(0.0, 0.5, -1.0)] {
            for kind in [BodyKind::Fixed, BodyKind::Dynamic] {
                let mut world = TestWorld::new(Vec3::ZERO);
                let rail = world.add(kind, Shape::ball(0.5), Vec3::ZERO, |_| ());
                let cart = world.add(BodyKind::Dynamic, Shape::ball(0.2), lever, |_| ());
                let limits = JointLimits {
                    least: -1.0,
                    most: 1.0,
                };
                let kind_of_joint = JointKind::Prismatic(Some(limits));
                let frames = [Vec3::ZERO, -lever].map(JointFrame::at);
                let mut joint = Joint::plain(kind_of_joint, [rail, cart], frames);
                joint.motors[0] = Some(motor);
                world.join(&joint);
                let mut far = 0.0_f32;
                let way = |world: &TestWorld| {
                    let apart = world.position(cart) - world.position(rail);
                    (world.rotation(rail).inverse() * apart).x
                };
                for _ in 0..240 {
                    world.step();
                    far = far.max(way(&world).abs());
                }
                let end = way(&world).abs();
                assert!(
                    far < 1.1 && (end - 1.0).abs() < 0.02,
                    "{motor:?}, {lever}, {kind:?}: {far}, {end}"
                );
            }
        }
    }
}

#[test]
fn limits_of_a_ball_joint_stop_its_three_motors() {
    let limits = JointLimits {
        least: -0.5,
        most: 0.5,
    };
    for lever in [Vec3::ZERO, Vec3::Y * -0.5, Vec3::new(0.3, -0.4, 0.2)] {
        for motor in [
            Motor::at_position(1.2, 400.0, 40.0),
            Motor::with_velocity(4.0, 100.0),
            Motor::at_position(1.0, 1e4, 200.0),
        ] {
            for axis in 0..3 {
                let mut world = TestWorld::new(Vec3::ZERO);
                let still = Motor {
                    position: 0.0,
                    velocity: 0.0,
                    ..motor
                };
                let mut motors = [None, None, None, Some(still), Some(still), Some(still)];
                motors[3 + axis] = Some(motor);
                let kind = JointKind::Spherical(Some([limits; 3]));
                let [_, arm] = driven(&mut world, Shape::capsule(0.4, 0.1), lever, kind, motors);
                let (mut most, mut turn) = (0.0_f64, 0.0);
                for _ in 0..240 {
                    world.step();
                    turn = about(world.rotation(arm), Vec3::AXES[axis]);
                    most = most.max(turn);
                }
                assert!(
                    most < 0.6 && (turn - 0.5).abs() < 0.03,
                    "{lever}, {motor:?}, axis {axis}: {most}, {turn}"
                );
            }
        }
    }
}

#[test]
fn a_motor_at_its_limit_carries_a_load() {
    let mut world = TestWorld::new(Vec3::Y * -9.81);
    let motor = Motor::at_position(1.5, 100.0, 20.0);
    let post = world.add(BodyKind::Fixed, Shape::ball(0.05), Vec3::ZERO, |_| ());
    let arm = world.add(
        BodyKind::Dynamic,
        Shape::cuboid(0.1, 0.1, 0.5),
        Vec3::Z * -0.5,
        |_| (),
    );
    let mut joint = hinge([post, arm], [Vec3::ZERO, Vec3::Z * 0.5], motor);
    let limits = JointLimits {
        least: -1.0,
        most: 1.0,
    };
    joint.kind = JointKind::Revolute(Some(limits));
    world.join(&joint);
    for _ in 0..300 {
        world.step();
    }
    let turn = angle(world.rotation(arm));
    assert!((turn - 1.0).abs() < 0.01, "{turn}");
}

#[test]
fn motors_with_different_settings_share_a_ball_joint() {
    let lever = Vec3::new(0.2, -0.5, 0.1);
    for axis in 0..3 {
        for damping in [20.0, 600.0] {
            let mut world = TestWorld::new(Vec3::ZERO);
            let mut motors = [
                None,
                None,
                None,
                Some(Motor::at_position(0.0, 400.0, 40.0)),
                Some(Motor::with_velocity(0.0, damping)),
                Some(Motor::at_position(0.0, 25.0, 10.0)),
            ];
            let motor = Motor::at_position(0.6, 100.0, 20.0);
            motors[3 + axis] = Some(motor);
            let shape = Shape::capsule(0.4, 0.1);
            let [_, arm] = driven(&mut world, shape, lever, JointKind::Spherical(None), motors);
            let off = off(&motor, || {
                world.step();
                about(world.rotation(arm), Vec3::AXES[axis])
            });
            let spin = world.spin(arm).length();
            assert!(
                off < 0.15 && spin < 0.1,
                "axis {axis}, {damping}: {off} rad, {spin} rad/s"
            );
        }
    }
}

#[test]
fn the_motors_of_a_ball_joint_give_no_more_than_their_torques() {
    let mut world = TestWorld::new(Vec3::ZERO);
    let force = 2.0;
    let still = Some(Motor {
        force,
        ..Motor::at_position(0.0, 100.0, 20.0)
    });
    let run = Some(Motor {
        force,
        ..Motor::with_velocity(50.0, 1e4)
    });
    let motors = [None, None, None, run, still, still];
    let lever = Vec3::Y * -0.5;
    let [_, arm] = driven(
        &mut world,
        Shape::ball(0.1),
        lever,
        JointKind::Spherical(None),
        motors,
    );
    for _ in 0..60 {
        world.step();
    }
    let mass = 1_000.0 * 4.0 / 3.0 * std::f32::consts::PI * 1e-3;
    let inertia = mass * (0.25 + 0.4 * 0.01);
    let spin = world.spin(arm).length();
    assert!(
        (spin - force / inertia).abs() < 0.1,
        "{spin}, right: {}",
        force / inertia
    );
}

#[test]
fn two_arms_of_ball_joints_come_to_rest_at_their_targets() {
    for (stiffness, damping) in [(100.0, 20.0), (400.0, 24.0), (25.0, 5.0), (1e4, 200.0)] {
        for gravity in [0.0, -9.81] {
            let mut world = TestWorld::new(Vec3::Y * gravity);
            let mut before = world.add(BodyKind::Fixed, Shape::ball(0.05), Vec3::ZERO, |_| ());
            let mut anchor = Vec3::ZERO;
            let mut arms = Vec::new();
            for link in 0..2 {
                let at = Vec3::Y * -(link as f32 + 0.5);
                let arm = world.add(BodyKind::Dynamic, Shape::capsule(0.35, 0.1), at, |_| ());
                let frames = [anchor, Vec3::Y * 0.5].map(JointFrame::at);
                let mut joint = Joint::plain(JointKind::Spherical(None), [before, arm], frames);
                for (axis, to) in [(3, 0.4), (4, 0.2), (5, 0.3)] {
                    joint.motors[axis] = Some(Motor::at_position(to, stiffness, damping));
                }
                world.join(&joint);
                arms.push([before, arm]);
                (before, anchor) = (arm, Vec3::Y * -0.5);
            }
            for _ in 0..360 {
                world.step();
            }
            let spins = arms.iter().map(|[_, arm]| world.spin(*arm).length());
            let spin = spins.fold(0.0, f32::max);
            let turns = arms
                .iter()
                .map(|[before, arm]| world.rotation(*before).inverse() * world.rotation(*arm));
            let off = turns.map(|turn| {
                (2.0 * Vec3::new(turn.x.asin(), turn.y.asin(), turn.z.asin())
                    - Vec3::new(0.4, 0.2, 0.3))
                .abs()
                .max_element()
            });
            let off = off.fold(0.0, f32::max);
            // A load takes the solver longer than it has, through two joints.
            let (most_spin, most) = match gravity == 0.0 {
                true => (0.01, 0.01),
                false => (0.2, 0.05 + 30.0 / stiffness),
            };
            assert!(
                spin < most_spin && off < most,
                "{stiffness} and {damping}, {gravity}: {spin} rad/s, {off} rad"
            );
        }
    }
}

#[test]
fn a_hinge_of_three_quarters_of_a_turn_is_driven_all_the_way() {
    // Limits, start and target.
    let hinges = [
        (-2.356, 2.356, -2.0, 2.0),
        (-2.356, 2.356, 2.0, -2.2),
        (0.0, 4.7, 0.0, 4.5),
        (0.0, 4.7, 4.5, 0.2),
        (-4.7, 0.0, -0.1, -4.4),
        (0.0, 4.7, 1.0, -1.9),
        (2.0, 6.2, 6.0, 2.2),
    ];
    for (least, most, start, to) in hinges {
        for lever in [Vec3::ZERO, Vec3::Z * 0.5] {
            let mut world = TestWorld::new(Vec3::ZERO);
            let post = world.add(BodyKind::Fixed, Shape::ball(0.05), Vec3::ZERO, |_| ());
            let door = world.add(
                BodyKind::Dynamic,
                Shape::cuboid(0.5, 0.1, 0.1),
                lever,
                |_| (),
            );
            let mut joint = hinge(
                [post, door],
                [Vec3::ZERO, -lever],
                Motor::at_position(to, 100.0, 20.0),
            );
            joint.kind = JointKind::Revolute(Some(JointLimits { least, most }));
            // The frame of the second body is turned, so that the hinge starts there.
            joint.frames[1].rotation = Quat::from_rotation_x(start);
            assert_eq!(joint.check(), Ok(()), "{least} to {most}");
            world.join(&joint);
            for _ in 0..180 {
                world.step();
            }
            let turn = angle(world.rotation(door)) + f64::from(start - to);
            let off = turn - (turn / std::f64::consts::TAU).round() * std::f64::consts::TAU;
            assert!(
                off.abs() < 0.02,
                "{least} to {most}, from {start} to {to}: {off} off"
            );
        }
    }
}
