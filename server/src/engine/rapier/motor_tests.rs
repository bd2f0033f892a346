//! Motors follow the protocol's law with any lever, mass and load.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyKind, Joint, JointFrame, JointKind, LockedAxes, Motor, Shape};
use rhumb_reckoning::BodyId;

use super::test_world::TestWorld;

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
