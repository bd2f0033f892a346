//! Sensors report each body that goes through them, once, however it is moved.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyKind, Compound, Part, Shape};
use rhumb_reckoning::BodyId;

use super::tests::TestWorld;
use crate::engine::interface::Engine;

/// Ticks a second.
const TICKS: f32 = 60.0;

/// Counts how often a body enters a sensor.
struct Gate {
    world: TestWorld,
    sensor: BodyId,
    body: BodyId,
    entered: usize,
    is_inside: bool,
}

impl Gate {
    fn new(sensor: (BodyKind, Shape, Vec3), body: (BodyKind, Shape, Vec3)) -> Self {
        let mut world = TestWorld::new(Vec3::ZERO);
        let sensor = world.add(sensor.0, sensor.1, sensor.2, |desc| desc.sensor = true);
        let body = world.add(body.0, body.1, body.2, |_| ());
        Self {
            world,
            sensor,
            body,
            entered: 0,
            is_inside: false,
        }
    }

    fn step(&mut self) {
        self.world.step();
        let sees = |of: BodyId| {
            let mut pairs = Vec::new();
            self.world.engine.sensed(of, &mut pairs);
            pairs.contains(&(self.sensor, self.body))
        };
        let is_inside = sees(self.sensor);
        assert_eq!(is_inside, sees(self.body), "both tell the same");
        self.entered += usize::from(is_inside && !self.is_inside);
        self.is_inside = is_inside;
    }

    fn steps(&mut self, count: u32) {
        for _ in 0..count {
            self.step();
        }
    }

    /// Puts a kinematic body at a pose of each of these ticks.
    fn follow(&mut self, count: u32, pose: impl Fn(u32) -> (Vec3, Quat)) {
        for tick in 1..=count {
            let (position, rotation) = pose(tick);
            self.world.engine.set_pose(self.body, position, rotation);
            self.step();
        }
    }

    /// The number of times that the body was in the sensor, which it has left.
    fn passes(&self) -> usize {
        assert!(!self.is_inside, "it has left");
        self.entered
    }
}

/// A plate across x at 10 m, moved by these metres.
fn plate(offset: f32) -> (BodyKind, Shape, Vec3) {
    let plate = Shape::cuboid(0.05, 3.0, 3.0);
    (BodyKind::Fixed, plate, Vec3::X * (10.0 + offset))
}

#[test]
fn a_fixed_sensor_sees_a_kinematic_body_that_keeps_its_velocity() {
    for speed in [5.0, 40.0, 150.0, 900.0] {
        for phase in 0..20 {
            let sensor = plate(phase as f32 * 0.05 * speed / TICKS);
            let body = (BodyKind::Kinematic, Shape::ball(0.1), Vec3::ZERO);
            let mut gate = Gate::new(sensor, body);
            let body = gate.body;
            gate.world.set_velocity(body, Vec3::X * speed, Vec3::ZERO);
            gate.steps((15.0 * TICKS / speed) as u32 + 5);
            assert_eq!(gate.passes(), 1, "{speed} m/s, phase {phase}");
        }
    }
}

#[test]
fn a_fixed_sensor_sees_a_kinematic_body_that_follows_poses() {
    for speed in [5.0, 40.0, 90.0] {
        for phase in 0..20 {
            let sensor = plate(phase as f32 * 0.05 * speed / TICKS);
            let body = (BodyKind::Kinematic, Shape::ball(0.1), Vec3::ZERO);
            let mut gate = Gate::new(sensor, body);
            let ticks = (15.0 * TICKS / speed) as u32 + 5;
            gate.follow(ticks, |tick| {
                (Vec3::X * speed * tick as f32 / TICKS, Quat::IDENTITY)
            });
            assert_eq!(gate.passes(), 1, "{speed} m/s, phase {phase}");
        }
    }
}

#[test]
fn a_sensor_sees_a_body_in_the_first_step_in_which_it_moves() {
    let thin = || Shape::cuboid(0.01, 3.0, 3.0);
    for kind in [BodyKind::Dynamic, BodyKind::Kinematic] {
        for of_sensor in [BodyKind::Fixed, BodyKind::Kinematic] {
            let sensor = (of_sensor, thin(), Vec3::X);
            let mut gate = Gate::new(sensor, (kind, Shape::ball(0.1), Vec3::ZERO));
            gate.steps(100);
            let body = gate.body;
            gate.world.set_velocity(body, Vec3::X * 120.0, Vec3::ZERO);
            gate.steps(5);
            assert_eq!(gate.passes(), 1, "{kind:?}, {of_sensor:?}");
        }
    }
}

/// Shapes two metres long along x, and thin.
fn rods() -> [Shape; 4] {
    let tip = |x: f32| Part {
        position: Vec3::X * x,
        rotation: Quat::IDENTITY,
        shape: Shape::cuboid(0.5, 0.02, 0.02),
    };
    let two = Compound::new(vec![tip(-0.5), tip(0.5)]).expect("the test makes it valid");
    [
        Shape::cuboid(1.0, 0.02, 0.02),
        Shape::capsule(0.98, 0.02),
        Shape::cylinder(1.0, 0.02),
        Shape::Compound(two),
    ]
}

#[test]
fn a_sensor_sees_a_rod_that_turns_through_it() {
    let spin = 17.0;
    let count = 120;
    for of_sensor in [BodyKind::Fixed, BodyKind::Kinematic] {
        for shape in rods() {
            // Capsules and cylinders lie along y.
            let lies_along_y = matches!(shape, Shape::Capsule { .. } | Shape::Cylinder { .. });
            let start = if lies_along_y { 0.25 } else { 0.75 };
            for (kind, follows) in [
                (BodyKind::Dynamic, false),
                (BodyKind::Kinematic, false),
                (BodyKind::Kinematic, true),
            ] {
                let angle = 0.3 + start * std::f32::consts::TAU;
                let at = Vec3::new(angle.cos(), angle.sin(), 0.0) * 0.85;
                let sensor = (of_sensor, Shape::ball(0.02), at);
                let mut gate = Gate::new(sensor, (kind, shape.clone(), Vec3::ZERO));
                if follows {
                    gate.follow(count, |tick| {
                        let turned = spin * tick as f32 / TICKS;
                        (Vec3::ZERO, Quat::from_rotation_z(turned))
                    });
                } else {
                    let body = gate.body;
                    gate.world.set_velocity(body, Vec3::ZERO, Vec3::Z * spin);
                    gate.steps(count);
                }
                let turns = spin * count as f32 / TICKS / std::f32::consts::PI;
                let passes = turns.round() as usize;
                let about = format!("{kind:?}, {follows}, {of_sensor:?}, {shape:?}");
                assert!(
                    gate.entered.abs_diff(passes) <= 1,
                    "{about}: {} of {turns}",
                    gate.entered
                );
            }
        }
    }
}

#[test]
fn a_sensor_of_several_parts_sees_a_fast_body_once() {
    let part = |x: f32| Part {
        position: Vec3::X * x,
        rotation: Quat::IDENTITY,
        shape: Shape::cuboid(0.01, 3.0, 3.0),
    };
    for kind in [BodyKind::Dynamic, BodyKind::Kinematic] {
        for phase in 0..20 {
            let parts =
                Compound::new(vec![part(-0.1), part(0.1)]).expect("the test makes it valid");
            let at = Vec3::X * (10.0 + phase as f32 * 0.1);
            let sensor = (BodyKind::Fixed, Shape::Compound(parts), at);
            let mut gate = Gate::new(sensor, (kind, Shape::ball(0.15), Vec3::ZERO));
            let body = gate.body;
            gate.world.set_velocity(body, Vec3::X * 120.0, Vec3::ZERO);
            gate.steps(30);
            assert_eq!(gate.passes(), 1, "{kind:?}, phase {phase}");
        }
    }
}

#[test]
fn a_moving_sensor_sees_kinematic_and_fixed_bodies_that_it_passes() {
    for kind in [BodyKind::Fixed, BodyKind::Kinematic] {
        for phase in 0..20 {
            let plate = Shape::cuboid(0.01, 3.0, 3.0);
            let sensor = (BodyKind::Kinematic, plate, Vec3::ZERO);
            let at = Vec3::X * (10.0 + phase as f32 * 0.1);
            let mut gate = Gate::new(sensor, (kind, Shape::ball(0.1), at));
            let sensor = gate.sensor;
            gate.world.set_velocity(sensor, Vec3::X * 120.0, Vec3::ZERO);
            gate.steps(30);
            assert_eq!(gate.passes(), 1, "{kind:?}, phase {phase}");
        }
    }
}

#[test]
fn what_jumps_over_a_sensor_or_passes_beside_it_is_not_in_it() {
    for kind in [BodyKind::Dynamic, BodyKind::Kinematic] {
        let mut gate = Gate::new(plate(0.0), (kind, Shape::ball(0.1), Vec3::ZERO));
        let body = gate.body;
        gate.steps(3);
        let far = Vec3::X * 20.0;
        gate.world.engine.set_pose(body, far, Quat::IDENTITY);
        gate.steps(10);
        assert_eq!(gate.passes(), 0, "{kind:?} jumps");
        let mut gate = Gate::new(plate(0.0), (kind, Shape::ball(0.1), Vec3::Y * 3.2));
        let body = gate.body;
        gate.world.set_velocity(body, Vec3::X * 120.0, Vec3::ZERO);
        gate.steps(10);
        assert_eq!(gate.passes(), 0, "{kind:?} passes beside");
        // Beyond its end is not beyond the sensor.
        let mut gate = Gate::new(plate(0.0), (kind, Shape::ball(0.1), Vec3::ZERO));
        let body = gate.body;
        gate.world.set_velocity(body, Vec3::X * 58.0, Vec3::ZERO);
        gate.steps(10);
        gate.world.set_velocity(body, Vec3::ZERO, Vec3::ZERO);
        gate.steps(10);
        assert_eq!(gate.passes(), 0, "{kind:?} stops before it");
    }
}
