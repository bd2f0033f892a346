//! Vehicles over the wire: they roll, steer, brake and stand on springs.
//!
//! The helpers of the parent check after every tick that the copy keeps its promise.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{
    Answer, BodyDesc, Command, CommandError, Invalid, Locomotion, Quantity, Query, QueryFilter,
    Shape, Vehicle, Wheel, WheelInput,
};
use rhumb_reckoning::BodyId;

use super::{Remote, floor, near};

/// Radius of a wheel, and its height below the centre of the chassis, metres.
const RADIUS: f32 = 0.3;

/// Four wheels: front left, front right, rear left, rear right. Forward is −z.
fn wheels() -> Vec<Wheel> {
    let place = |x, z| Wheel::at(Vec3::new(x, -0.1, z), RADIUS);
    vec![
        place(-0.8, -1.2),
        place(0.8, -1.2),
        place(-0.8, 1.2),
        place(0.8, 1.2),
    ]
}

fn set(id: BodyId, wheels: Vec<Wheel>) -> Command {
    Command::SetLocomotion {
        id,
        locomotion: Locomotion::Vehicle(Vehicle { wheels }).into(),
    }
}

impl Remote {
    /// A car of a ton on the floor.
    fn add_car(&mut self) -> BodyId {
        let chassis = BodyDesc::dynamic(Shape::cuboid(0.8, 0.2, 1.6)).mass(1_000.0);
        let id = self.add(&chassis.at(0.0, 0.7, 0.0));
        self.done(&set(id, wheels()));
        id
    }

    /// The front wheels steer, the rear ones push, all of them brake.
    fn set_wheels(&mut self, id: BodyId, steering: f32, force: f32, brake: f32) {
        let input = |steering, force| WheelInput {
            steering,
            force,
            brake,
        };
        let inputs = [
            input(steering, 0.0),
            input(steering, 0.0),
            input(0.0, force),
            input(0.0, force),
        ];
        self.done(&Command::SetWheels {
            id,
            inputs: inputs.to_vec(),
        });
    }

    fn rotation(&self, id: BodyId) -> Quat {
        let motion = self.truth.observation(id).expect("it lives").motion;
        Quat::from_slice(&motion.parts()[3..7])
    }
}

fn with_floor() -> Remote {
    let mut remote = Remote::new();
    remote.add(&floor());
    remote
}

#[test]
fn a_car_rests_on_its_springs_and_falls_asleep() {
    let mut remote = with_floor();
    let car = remote.add_car();
    remote.steps(300);
    // Four springs of 50/s² carry 10 m/s² at 5 cm.
    near(remote.position(car).y, 0.1 + 0.3 - 0.05 + RADIUS, 0.01);
    near(remote.velocity(car).length(), 0.0, 0.02);
    assert_eq!(remote.truth.awake_count(), 0, "it sleeps");
}

#[test]
fn a_car_speeds_up_and_brakes() {
    let mut remote = with_floor();
    let car = remote.add_car();
    remote.steps(60);
    remote.set_wheels(car, 0.0, 1_000.0, 0.0);
    remote.steps(120);
    // Two kilonewtons give a ton 2 m/s².
    near(remote.velocity(car).z, -4.0, 0.4);
    near(remote.position(car).x, 0.0, 0.05);
    remote.set_wheels(car, 0.0, -1_000.0, 0.0);
    remote.steps(30);
    near(remote.velocity(car).z, -3.0, 0.4);
    remote.set_wheels(car, 0.0, 0.0, 3_000.0);
    remote.steps(120);
    near(remote.velocity(car).length(), 0.0, 0.1);
}

#[test]
fn a_positive_steering_turns_a_car_left() {
    for (steering, sign) in [(0.3, -1.0), (-0.3, 1.0)] {
        let mut remote = with_floor();
        let car = remote.add_car();
        remote.steps(30);
        remote.set_wheels(car, steering, 1_000.0, 0.0);
        remote.steps(120);
        let forward = remote.rotation(car) * Vec3::NEG_Z;
        assert!(forward.x * sign > 0.2, "{forward}");
    }
}

#[test]
fn the_inputs_of_a_car_wake_it() {
    let mut remote = with_floor();
    let car = remote.add_car();
    remote.steps(300);
    assert_eq!(remote.truth.awake_count(), 0);
    remote.set_wheels(car, 0.0, -1_000.0, 0.0);
    remote.steps(60);
    near(remote.velocity(car).z, 2.0, 0.3);
}

#[test]
fn a_car_falls_when_its_ground_goes() {
    let mut remote = with_floor();
    let bridge = BodyDesc::fixed(Shape::cuboid(3.0, 0.5, 3.0)).at(0.0, 2.0, 0.0);
    let bridge = remote.add(&bridge);
    let chassis = BodyDesc::dynamic(Shape::cuboid(0.8, 0.2, 1.6)).mass(1_000.0);
    let car = remote.add(&chassis.at(0.0, 3.2, 0.0));
    remote.done(&set(car, wheels()));
    remote.steps(300);
    assert_eq!(remote.truth.awake_count(), 0);
    remote.done(&Command::RemoveBody { id: bridge });
    remote.steps(120);
    near(remote.position(car).y, 0.65, 0.05);
}

#[test]
fn a_car_that_sleeps_wakes_on_ground_that_moves_and_its_brakes_hold_it() {
    let mut remote = with_floor();
    let ferry = BodyDesc::kinematic(Shape::cuboid(30.0, 0.5, 30.0)).at(0.0, 2.0, 0.0);
    let ferry = remote.add(&ferry);
    let chassis = BodyDesc::dynamic(Shape::cuboid(0.8, 0.2, 1.6)).mass(1_000.0);
    let car = remote.add(&chassis.at(0.0, 3.2, 0.0));
    remote.done(&set(car, wheels()));
    remote.set_wheels(car, 0.0, 0.0, 5_000.0);
    remote.steps(300);
    assert_eq!(remote.truth.awake_count(), 0);
    remote.done(&Command::SetVelocity {
        id: ferry,
        linear: Vec3::Z,
        angular: Vec3::ZERO,
    });
    remote.steps(180);
    near(remote.position(car).z, 3.0, 0.4);
}

/// A client draws a wheel by a ray on its own copy: here on the scene itself.
#[test]
fn a_wheel_is_drawn_by_a_ray() {
    let mut remote = with_floor();
    let car = remote.add_car();
    remote.steps(200);
    let (position, rotation) = (remote.position(car), remote.rotation(car));
    for wheel in wheels() {
        let but_the_car = QueryFilter {
            except: Some(car),
            ..QueryFilter::DEFAULT
        };
        let ray: Query = wheel.ray(position, rotation).among(but_the_car);
        let answers = remote.truth.query(&[ray]).expect("a valid ray");
        let Answer::Hits(hits) = &answers[0] else {
            panic!("{answers:?}");
        };
        let length = wheel.length(hits.first().map(|hit| hit.distance));
        let top = position + rotation * wheel.position;
        let centre = top + rotation * wheel.direction * length;
        near(centre.y, RADIUS, 1e-3);
    }
    assert_eq!(wheels()[0].length(None), 0.3, "no ground, no load");
}

#[test]
fn inputs_need_a_vehicle_with_so_many_wheels() {
    let mut remote = with_floor();
    let car = remote.add_car();
    let inputs = |id, count| Command::SetWheels {
        id,
        inputs: vec![WheelInput::default(); count],
    };
    let wheels_wrong = CommandError::Invalid(Invalid::out_of_range(Quantity::Wheels));
    assert_eq!(remote.send(&inputs(car, 3)), Err(wheels_wrong));
    remote.done(&inputs(car, 4));
    let ball = remote.add(&BodyDesc::dynamic(Shape::ball(0.5)).at(9.0, 1.0, 0.0));
    let answer = remote.send(&inputs(ball, 4));
    assert_eq!(answer, Err(CommandError::NotVehicle(ball)));
    let floor = BodyId::new(0, 0);
    let answer = remote.send(&set(floor, wheels()));
    assert_eq!(answer, Err(CommandError::NotPushable(floor)));
    remote.change(car, |desc| desc.enabled = false);
    let answer = remote.send(&inputs(car, 4));
    assert_eq!(answer, Err(CommandError::BodyDisabled(car)));
    remote.done(&Command::RemoveBody { id: car });
    let answer = remote.send(&inputs(car, 4));
    assert_eq!(answer, Err(CommandError::UnknownBody(car)));
    remote.steps(3);
}

#[test]
fn numbers_that_no_wheel_can_have_are_named() {
    let with = |change: fn(&mut Wheel)| {
        let mut wheels = wheels();
        change(&mut wheels[2]);
        Vehicle { wheels }.check()
    };
    let wrong = Err(Invalid::out_of_range(Quantity::Wheel));
    assert_eq!(with(|_| {}), Ok(()));
    assert_eq!(with(|wheel| wheel.radius = 0.0), wrong);
    assert_eq!(with(|wheel| wheel.stiffness = -1.0), wrong);
    assert_eq!(with(|wheel| wheel.friction_slip = 101.0), wrong);
    let not_finite = Err(Invalid::not_finite(Quantity::Wheel));
    assert_eq!(with(|wheel| wheel.travel = f32::NAN), not_finite);
    let not_unit = Err(Invalid::not_finite(Quantity::Rotation));
    assert_eq!(with(|wheel| wheel.axle = Vec3::ZERO), not_unit);
    for count in [0, 17] {
        let wheels = vec![wheels()[0]; count];
        let answer = Vehicle { wheels }.check();
        assert_eq!(answer, Err(Invalid::out_of_range(Quantity::Wheels)));
    }
}
