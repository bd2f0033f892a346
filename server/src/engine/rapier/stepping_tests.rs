//! Fast bodies meet, sensors see them, and platforms carry.

use core::f32::consts::PI;

use glam::{Quat, Vec3};
use rapier3d::prelude::{
    ActiveEvents, ChannelEventCollector, ColliderBuilder, CollisionEvent, PhysicsWorld,
    RigidBodyBuilder,
};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, CollisionGroups, Edges, Heights, SceneConfig, Shape, Sleep,
};
use rhumb_protocol::stream::Activity;
use rhumb_reckoning::BodyId;

use super::tests::TestWorld;
use crate::engine::interface::Engine;

/// Two bodies that fly at each other along x, and where each is after the meeting.
struct Meeting {
    world: TestWorld,
    bodies: [BodyId; 2],
}

impl Meeting {
    /// `swept`: of each; `speeds`: of each towards the other, m/s.
    fn new(shapes: [Shape; 2], swept: [bool; 2], speeds: [f32; 2], offset: f32) -> Self {
        let mut world = TestWorld::new(Vec3::ZERO);
        world.material.restitution = 1.0;
        let starts = [
            Vec3::new(-speeds[0] * 0.5 - offset, 0.0, 0.0),
            Vec3::X * speeds[1] * 0.5,
        ];
        let [first, second] = shapes;
        let bodies = [(first, swept[0], starts[0]), (second, swept[1], starts[1])];
        let bodies = bodies.map(|(shape, swept, at)| {
            world.add(BodyKind::Dynamic, shape, at, |desc| desc.swept = swept)
        });
        world.set_velocity(bodies[0], Vec3::X * speeds[0], Vec3::ZERO);
        world.set_velocity(bodies[1], -Vec3::X * speeds[1], Vec3::ZERO);
        Self { world, bodies }
    }

    /// Their speeds along x after they must have met.
    fn speeds_after(mut self) -> [f32; 2] {
        for _ in 0..45 {
            self.world.step();
        }
        self.bodies.map(|body| self.world.velocity(body).x)
    }
}

#[test]
fn two_swept_bodies_bounce_off_each_other_at_any_speed_and_phase() {
    let ball = || Shape::ball(0.05);
    let others = [
        Shape::ball(0.05),
        Shape::cuboid(0.02, 0.3, 0.3),
        Shape::cylinder(0.1, 0.05),
    ];
    for other in others {
        for speed in [60.0, 150.0, 260.0, 390.0] {
            for phase in 0..8 {
                let offset = phase as f32 * 0.137 * speed / 60.0;
                let shapes = [ball(), other.clone()];
                let met = Meeting::new(shapes, [true; 2], [speed; 2], offset).speeds_after();
                let has_met = met[0] < speed * 0.9 && met[1] > -speed * 0.9;
                assert!(has_met, "{other:?} at {speed} m/s, phase {phase}: {met:?}");
            }
        }
    }
}

#[test]
fn equal_balls_exchange_their_velocities_to_a_thousandth() {
    for speeds in [[390.0, 390.0], [300.0, 100.0], [200.0, 10.0]] {
        for phase in 0..10 {
            let shapes = [Shape::ball(0.05), Shape::ball(0.05)];
            let offset = phase as f32 * 0.1 * speeds[0] / 60.0;
            let after = Meeting::new(shapes, [true; 2], speeds, offset).speeds_after();
            let expected = [-speeds[1], speeds[0]];
            for (after, expected) in after.into_iter().zip(expected) {
                assert!(
                    (after - expected).abs() < speeds[0] * 1e-3,
                    "{speeds:?}: {after}"
                );
            }
        }
    }
}

#[test]
fn a_swept_body_meets_a_fast_one_that_is_not_swept() {
    for phase in 0..10 {
        let shapes = [Shape::ball(0.05), Shape::ball(0.05)];
        let offset = phase as f32 * 0.6;
        let met = Meeting::new(shapes, [true, false], [300.0, 350.0], offset).speeds_after();
        assert!(met[0] < 0.0 && met[1] > 0.0, "phase {phase}: {met:?}");
    }
}

#[test]
fn a_swept_body_meets_a_fast_platform() {
    for phase in 0..10 {
        let mut world = TestWorld::new(Vec3::ZERO);
        let at = Vec3::new(-100.0 - phase as f32 * 0.3, 0.0, 0.0);
        let ball = world.add(BodyKind::Dynamic, Shape::ball(0.05), at, |desc| {
            desc.swept = true;
        });
        let plate = Shape::cuboid(0.02, 1.0, 1.0);
        let plate = world.add(BodyKind::Kinematic, plate, Vec3::X * 20.0, |_| ());
        world.set_velocity(ball, Vec3::X * 200.0, Vec3::ZERO);
        world.set_velocity(plate, -Vec3::X * 40.0, Vec3::ZERO);
        for _ in 0..45 {
            world.step();
        }
        assert!(world.velocity(ball).x < 1.0, "{}", world.velocity(ball));
        let plate_at = world.position(plate).x;
        assert!(
            (plate_at - (20.0 - 40.0 * 0.75)).abs() < 1e-3,
            "it goes its way: {plate_at}"
        );
        assert!(world.position(ball).x < plate_at);
    }
}

#[test]
fn swept_bodies_that_touch_nothing_of_each_other_pass() {
    for speed in [100.0, 390.0] {
        let mut apart = Meeting::new(
            [Shape::ball(0.05), Shape::ball(0.05)],
            [true; 2],
            [speed; 2],
            0.0,
        );
        let aside = Vec3::new(speed * 0.5, 0.11, 0.0);
        apart
            .world
            .engine
            .set_pose(apart.bodies[1], aside, Quat::IDENTITY);
        assert_eq!(apart.speeds_after(), [speed, -speed]);
        let mut world = TestWorld::new(Vec3::ZERO);
        let mut group = |at: f32, groups: CollisionGroups| {
            world.add(BodyKind::Dynamic, Shape::ball(0.05), Vec3::X * at, |desc| {
                (desc.swept, desc.groups) = (true, groups);
            })
        };
        let one = group(
            -10.0,
            CollisionGroups {
                members: 1,
                touches: 1,
            },
        );
        let other = group(
            10.0,
            CollisionGroups {
                members: 2,
                touches: 2,
            },
        );
        world.set_velocity(one, Vec3::X * speed, Vec3::ZERO);
        world.set_velocity(other, -Vec3::X * speed, Vec3::ZERO);
        for _ in 0..30 {
            world.step();
        }
        assert_eq!(world.velocity(one).x, speed);
    }
}

/// Ticks at which a plain Rapier reports that a body is in a sensor or goes through it.
fn seen_by_rapier(speed: f32, thickness: f32, offset: f32, swept: bool) -> usize {
    let (sender, events) = std::sync::mpsc::channel();
    let collector = ChannelEventCollector::new(
        sender,
        std::sync::mpsc::channel().0,
        std::sync::mpsc::channel().0,
    );
    let mut world = PhysicsWorld::new();
    world.gravity = Vec3::ZERO;
    let sensor = ColliderBuilder::cuboid(thickness * 0.5, 2.0, 2.0)
        .sensor(true)
        .active_events(ActiveEvents::COLLISION_EVENTS);
    let gate = world.insert_body(RigidBodyBuilder::fixed());
    world.insert_collider(sensor, Some(gate));
    let ball = RigidBodyBuilder::dynamic()
        .translation(Vec3::X * offset)
        .linvel(Vec3::X * speed)
        .ccd_enabled(swept);
    let ball = world.insert_body(ball);
    world.insert_collider(ColliderBuilder::ball(0.05), Some(ball));
    for _ in 0..60 {
        world.step_with_events(&(), &collector);
    }
    let started = events
        .try_iter()
        .filter(|event| matches!(event, CollisionEvent::Started(..)));
    started.count()
}

#[test]
fn a_thin_sensor_sees_a_fast_body_as_an_integrated_rapier_does() {
    for speed in [2.0, 20.0, 100.0, 300.0] {
        for thickness in [0.01, 0.1, 1.0] {
            for (phase, swept) in (0..6).flat_map(|phase| [(phase, false), (phase, true)]) {
                let offset = -speed * 0.5 - phase as f32 * 0.17 * speed / 60.0;
                let mut world = TestWorld::new(Vec3::ZERO);
                let gate = Shape::cuboid(thickness * 0.5, 2.0, 2.0);
                let gate = world.add(BodyKind::Fixed, gate, Vec3::ZERO, |desc| desc.sensor = true);
                let ball = world.add(
                    BodyKind::Dynamic,
                    Shape::ball(0.05),
                    Vec3::X * offset,
                    |desc| {
                        desc.swept = swept;
                    },
                );
                world.set_velocity(ball, Vec3::X * speed, Vec3::ZERO);
                let (mut entered, mut was_inside) = (0, false);
                for _ in 0..60 {
                    world.step();
                    for body in [gate, ball] {
                        let mut pairs = Vec::new();
                        world.engine.sensed(body, &mut pairs);
                        let is_inside = pairs.contains(&(gate, ball));
                        if body == gate {
                            entered += usize::from(is_inside && !was_inside);
                            was_inside = is_inside;
                        }
                        assert_eq!(is_inside, was_inside, "both tell the same");
                    }
                }
                assert!(!was_inside, "it has left");
                assert_eq!(entered, 1, "{speed} m/s, {thickness} m, phase {phase}");
                assert_eq!(entered, seen_by_rapier(speed, thickness, offset, swept));
            }
        }
    }
}

/// Number of times that a ball is in a sensor's events, of a plate and of a ball that move by these metres a second.
fn crossings(kind: BodyKind, thickness: f32, speeds: [f32; 2], offset: f32) -> usize {
    let mut world = TestWorld::new(Vec3::ZERO);
    let gate = Shape::cuboid(thickness * 0.5, 2.0, 2.0);
    let gate = world.add(kind, gate, Vec3::ZERO, |desc| desc.sensor = true);
    let ball = world.add(
        BodyKind::Dynamic,
        Shape::ball(0.05),
        Vec3::X * offset,
        |_| (),
    );
    for (body, speed) in [(gate, speeds[0]), (ball, speeds[1])] {
        if speed != 0.0 {
            world.set_velocity(body, Vec3::X * speed, Vec3::ZERO);
        }
    }
    let (mut entered, mut was_inside) = (0, false);
    for _ in 0..60 {
        world.step();
        let mut pairs = Vec::new();
        world.engine.sensed(gate, &mut pairs);
        let is_inside = pairs.contains(&(gate, ball));
        entered += usize::from(is_inside && !was_inside);
        was_inside = is_inside;
    }
    assert!(!was_inside, "it has left");
    entered
}

#[test]
fn a_sensor_that_may_move_sees_what_passes_it() {
    for kind in [BodyKind::Kinematic, BodyKind::Dynamic] {
        for speed in [2.0, 30.0, 100.0, 300.0, 900.0_f32] {
            for thickness in [0.002, 0.01, 0.1] {
                for phase in 0..6 {
                    let offset = speed * 0.5 + phase as f32 * 0.17 * speed / 60.0;
                    let about = format!("{kind:?}, {speed} m/s, {thickness} m, phase {phase}");
                    let passes = [
                        ([0.0, speed], -offset),
                        ([speed, 0.0], offset),
                        ([-speed, speed], -2.0 * offset),
                    ];
                    for (speeds, offset) in passes {
                        let seen = crossings(kind, thickness, speeds, offset);
                        assert_eq!(seen, 1, "{about}, {speeds:?}");
                    }
                    // One that moves beside the sensor, or before it, is never in it.
                    assert_eq!(
                        crossings(kind, thickness, [speed, speed], 0.5),
                        0,
                        "{about}"
                    );
                }
            }
        }
    }
}

#[test]
fn swept_bodies_meet_in_the_first_step_after_they_were_added() {
    for others_speed in [0.0, 100.0] {
        let mut world = TestWorld::new(Vec3::ZERO);
        world.material.restitution = 1.0;
        let swept = |desc: &mut BodyDesc| desc.swept = true;
        let first = world.add(BodyKind::Dynamic, Shape::ball(0.05), -Vec3::X * 0.8, swept);
        let second = world.add(BodyKind::Dynamic, Shape::ball(0.05), Vec3::X * 0.8, |_| ());
        world.set_velocity(first, Vec3::X * 200.0, Vec3::ZERO);
        world.set_velocity(second, -Vec3::X * others_speed, Vec3::ZERO);
        for _ in 0..3 {
            world.step();
        }
        let after = [first, second].map(|body| world.velocity(body).x);
        assert!(after[0] < 100.0 && after[1] > 100.0, "{after:?}");
    }
}

#[test]
fn a_swept_kinematic_body_passes_no_other() {
    for speed in [20.0, 60.0] {
        for sleep in [Sleep::Never, SceneConfig::default().sleep] {
            let mut world = TestWorld::new(Vec3::ZERO);
            world.sleep = sleep;
            let plate = Shape::cuboid(0.02, 20.0, 1.0);
            let plate = world.add(BodyKind::Kinematic, plate, Vec3::X * -3.0, |desc| {
                desc.swept = true;
            });
            let balls = [0, 1, 2, 3, 4, 5, 6, 7].map(|place| {
                let at = Vec3::new(0.13 * place as f32, 2.0 * place as f32 - 8.0, 0.0);
                world.add(BodyKind::Dynamic, Shape::ball(0.05), at, |_| ())
            });
            for _ in 0..100 {
                world.step();
            }
            world.set_velocity(plate, Vec3::X * speed, Vec3::ZERO);
            for _ in 0..(6.0 / speed * 60.0) as u32 + 2 {
                world.step();
            }
            let front = world.position(plate).x;
            let passed = balls.map(|ball| world.position(ball).x < front - 0.3);
            assert_eq!(passed, [false; 8], "{speed} m/s, {sleep:?}");
        }
    }
}

#[test]
fn a_bat_that_turns_hits_a_swept_ball() {
    for spin in [5.0, 20.0, 50.0, 100.0] {
        let mut world = TestWorld::new(Vec3::ZERO);
        let bat = Shape::cuboid(2.0, 0.02, 0.5);
        let bat = world.add(BodyKind::Kinematic, bat, Vec3::ZERO, |_| ());
        let at = Vec3::new(1.5, 1.0, 0.0);
        let ball = world.add(BodyKind::Dynamic, Shape::ball(0.05), at, |desc| {
            desc.swept = true;
        });
        for _ in 0..5 {
            world.step();
        }
        world.set_velocity(bat, Vec3::ZERO, Vec3::Z * spin);
        for _ in 0..(60.0 * PI / spin) as u32 + 3 {
            world.step();
        }
        assert!(world.velocity(ball).length() > 0.1, "{spin} rad/s");
    }
}

#[test]
fn fast_bodies_stop_at_half_spaces_as_at_slabs() {
    let tilted = Vec3::new(0.3, 0.9, -0.2).normalize();
    let shapes = [
        Shape::ball(0.05),
        Shape::cuboid(0.05, 0.05, 0.05),
        Shape::cylinder(0.1, 0.05),
        Shape::ball(0.5),
    ];
    for normal in [Vec3::Y, tilted, -Vec3::X] {
        for shape in &shapes {
            for speed in [10.0, 40.0, 150.0, 390.0] {
                for phase in 0..6 {
                    let mut world = TestWorld::new(Vec3::ZERO);
                    let ground = Shape::HalfSpace { normal };
                    world.add(BodyKind::Fixed, ground, Vec3::splat(2.0), |_| ());
                    let height = 3.0 + phase as f32 * 0.137 * speed / 60.0;
                    let at = Vec3::splat(2.0) + normal * height;
                    let body = world.add(BodyKind::Dynamic, shape.clone(), at, |_| ());
                    world.set_velocity(body, -normal * speed, Vec3::new(3.0, -2.0, 4.0));
                    let mut lowest = f32::MAX;
                    for _ in 0..120 {
                        world.step();
                        lowest = lowest.min((world.position(body) - Vec3::splat(2.0)).dot(normal));
                    }
                    // A ball of five centimetres keeps its centre outside.
                    assert!(
                        lowest > 0.0,
                        "{shape:?} at {speed} m/s, phase {phase}: {lowest} m along {normal}"
                    );
                }
            }
        }
    }
}

#[test]
fn a_sleeper_that_a_swept_body_hits_stops_at_a_half_space_too() {
    let mut world = TestWorld::new(Vec3::ZERO);
    world.material.restitution = 1.0;
    let ground = Shape::HalfSpace { normal: Vec3::Y };
    world.add(BodyKind::Fixed, ground, Vec3::ZERO, |_| ());
    world.sleep = SceneConfig::default().sleep;
    let ball = || Shape::ball(0.1);
    let sleeper = world.add(BodyKind::Dynamic, ball(), Vec3::Y * 0.5, |_| ());
    world.step();
    world.engine.set_activity(sleeper, Activity::Asleep);
    let bullet = world.add(BodyKind::Dynamic, ball(), Vec3::Y * 3.0, |desc| {
        desc.swept = true;
    });
    world.set_velocity(bullet, Vec3::Y * -200.0, Vec3::ZERO);
    for step in 0..3 {
        world.step();
        let at = world.position(sleeper).y;
        assert!(at > -0.01, "step {step}: its middle is at {at} m");
    }
    let speed = world.velocity(sleeper).y;
    assert!(speed > 150.0, "it bounces: {speed} m/s");
}

#[test]
fn balls_that_fall_onto_the_lines_of_a_height_field_stay_on_it() {
    let corners = [Edges::Smooth, Edges::Plain];
    for (posts, spacing) in [(11, 1.0), (51, 0.3), (101, 1.0), (101, 0.37), (74, 2.5)] {
        for edges in corners {
            let flat = vec![0.0; posts * posts];
            let heights = Heights::new(posts as u32, spacing, spacing, &flat)
                .expect("a flat field")
                .with_edges(edges);
            let mut world = TestWorld::new(Vec3::Y * -9.81);
            world.add(BodyKind::Fixed, Shape::Heights(heights), Vec3::ZERO, |_| ());
            let radius = 0.2 * spacing;
            let across = (posts / 2) as f32 * spacing;
            let mut balls = Vec::new();
            for line in 1..posts - 1 {
                let along = line as f32 * spacing;
                let height = radius + 0.3 + 0.05 * (line % 7) as f32;
                for (x, z) in [(along, across + 0.37 * spacing), (along, along)] {
                    let at = Vec3::new(x, height, z);
                    let apart = |desc: &mut BodyDesc| {
                        desc.groups = CollisionGroups {
                            members: 1,
                            touches: 2,
                        };
                    };
                    balls.push(world.add(BodyKind::Dynamic, Shape::ball(radius), at, apart));
                }
            }
            for _ in 0..90 {
                world.step();
            }
            let lost: Vec<_> = balls
                .iter()
                .map(|ball| world.position(*ball))
                .filter(|at| at.y < 0.0)
                .collect();
            assert_eq!(lost, [], "{posts} posts, {spacing} m apart, {edges:?}");
        }
    }
}

/// The end of a box that rides on a platform for two seconds at one metre a second, and the least speed of the platform.
fn ride(commands: impl Fn(u32) -> bool) -> (f32, f32) {
    let mut world = TestWorld::new(Vec3::new(0.0, -9.81, 0.0));
    world.material.friction = 0.5;
    let platform = Shape::cuboid(3.0, 0.25, 3.0);
    let platform = world.add(BodyKind::Kinematic, platform, Vec3::Y, |_| ());
    let load = Shape::cuboid(0.25, 0.25, 0.25);
    let load = world.add(BodyKind::Dynamic, load, Vec3::Y * 1.5, |_| ());
    let mut slowest = f32::MAX;
    for tick in 0..30 + 120 + 30 {
        let ticks = (tick as f32 - 30.0 + 1.0).clamp(0.0, 120.0);
        if (30..150).contains(&tick) && commands(tick) {
            let to = Vec3::new(ticks / 60.0, 1.0, 0.0);
            world.engine.set_pose(platform, to, Quat::IDENTITY);
        }
        let before = world.position(platform).x;
        world.step();
        if (90..130).contains(&tick) {
            slowest = slowest.min((world.position(platform).x - before) * 60.0);
        }
    }
    (world.position(load).x, slowest)
}

#[test]
fn a_platform_carries_its_load_at_any_rate_of_poses() {
    let (each, _) = ride(|_| true);
    assert!(each > 1.8, "{each}");
    for every in [2, 3, 4, 6, 10] {
        let (there, slowest) = ride(|tick| tick % every == 0);
        assert!(there > 1.7, "every {every}: {there}, {each} with all poses");
        assert!(slowest > 0.99, "every {every}: {slowest}");
    }
    let (there, slowest) = ride(|tick| [0, 1, 4, 6].contains(&(tick % 8)));
    assert!(there > 1.7 && slowest > 0.2, "{there}, {slowest}");
}

#[test]
fn a_pose_far_away_shoves_nothing() {
    let mut world = TestWorld::new(Vec3::ZERO);
    let ram = Shape::cuboid(0.5, 0.5, 0.5);
    let ram = world.add(BodyKind::Kinematic, ram, Vec3::ZERO, |_| ());
    let ball = world.add(BodyKind::Dynamic, Shape::ball(0.2), Vec3::X * 5.0, |desc| {
        desc.swept = true;
    });
    world.step();
    world.engine.set_pose(ram, Vec3::X * 10.0, Quat::IDENTITY);
    for _ in 0..30 {
        world.step();
    }
    assert_eq!(world.position(ram), Vec3::X * 10.0);
    assert_eq!(world.velocity(ram), Vec3::ZERO);
    assert!(
        (world.position(ball) - Vec3::X * 5.0).length() < 1e-3,
        "{}",
        world.position(ball)
    );
}
