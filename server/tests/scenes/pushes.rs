//! A push acts whole, or is refused with the limit that it would break.
//!
//! Proved by small scenes without gravity, unless it says otherwise. A push is a force, a torque or an impulse.

use glam::Vec3;
use rhumb_protocol::limits::{ANGULAR_MAX, FORCE_MAX, LINEAR_MAX};
use rhumb_protocol::scene::{
    BodyBuilder, BodyDesc, Character, Command, CommandError, Invalid, LockedAxes, Locomotion,
    Quantity, SceneConfig, Shape, ShapeId, Sleep, Vehicle, Wheel,
};
use rhumb_protocol::stream::Activity;
use rhumb_reckoning::BodyId;
use rhumb_scene::Scene;

const VALID: &str = "the test makes it valid";
const BODY: BodyId = BodyId::new(0, 0);
const TICKS: f32 = 60.0;
/// Greatest speed and spin of any body, m/s and rad/s: those of a command with all components at their limits.
const GREATEST: [f32; 2] = [1_732.1, 173.21];

/// A scene with a cube of 0.4 m and one kilogram, whose moments are 0.0267 kg·m².
fn cube() -> Scene {
    scene(Vec3::ZERO, &cube_body())
}

fn cube_body() -> BodyBuilder {
    BodyDesc::dynamic(Shape::cuboid(0.2, 0.2, 0.2))
        .mass(1.0)
        .sleep(Sleep::Never)
}

fn scene(gravity: Vec3, body: &BodyBuilder) -> Scene {
    let config = SceneConfig {
        gravity,
        ..SceneConfig::default()
    };
    let mut scene = Scene::new(config).expect(VALID);
    let id = ShapeId(0);
    let shape = body.shape().clone();
    scene.apply(&Command::AddShape { id, shape }).expect(VALID);
    let (desc, motion) = (body.desc(BODY, id), body.state().expect(VALID));
    scene
        .apply(&Command::AddBody { desc, motion })
        .expect(VALID);
    scene
}

fn steps(scene: &mut Scene, count: u32) {
    for _ in 0..count {
        let stepped = scene.step().expect(VALID);
        assert_eq!(stepped.removed, [], "nothing is lost");
    }
}

fn velocities(scene: &Scene) -> [Vec3; 2] {
    let [.., vx, vy, vz, wx, wy, wz] = scene.observation(BODY).expect(VALID).motion.parts();
    [Vec3::new(vx, vy, vz), Vec3::new(wx, wy, wz)]
}

fn set_velocity(linear: Vec3, angular: Vec3) -> Command {
    let id = BODY;
    Command::SetVelocity {
        id,
        linear,
        angular,
    }
}

fn impulse(impulse: Vec3) -> Command {
    Command::Impulse { id: BODY, impulse }
}

fn force(force: Vec3) -> Command {
    Command::Force { id: BODY, force }
}

fn torque(torque: Vec3) -> Command {
    Command::Torque { id: BODY, torque }
}

fn torque_impulse(impulse: Vec3) -> Command {
    Command::TorqueImpulse { id: BODY, impulse }
}

fn too_fast(quantity: Quantity) -> Result<(), CommandError> {
    Err(CommandError::Invalid(Invalid::out_of_range(quantity)))
}

/// True if two vectors differ by at most a ten-thousandth, or by so much of a unit.
fn are_near(one: Vec3, other: Vec3) -> bool {
    (one - other).length() <= 1e-4 * other.length().max(1.0)
}

#[test]
fn a_push_beyond_the_limits_of_velocities_is_refused_and_changes_nothing() {
    let (linear, angular) = (too_fast(Quantity::Linear), too_fast(Quantity::Angular));
    let edge = Vec3::new(0.2, 0.2, 0.2);
    let at = |impulse, point| Command::ImpulseAt {
        id: BODY,
        impulse,
        point,
    };
    let force_at = |force, point| Command::ForceAt {
        id: BODY,
        force,
        point,
    };
    let refused = [
        (impulse(Vec3::X * 1_500.0), linear),
        (impulse(Vec3::new(1_500.0, 800.0, 0.0)), linear),
        (impulse(Vec3::splat(-FORCE_MAX)), linear),
        (force(Vec3::Z * 90_000.0), linear),
        (force(Vec3::splat(FORCE_MAX)), linear),
        (torque_impulse(Vec3::Y * 5.0), angular),
        (torque_impulse(Vec3::splat(FORCE_MAX)), angular),
        (torque(Vec3::Y * 300.0), angular),
        (torque(Vec3::splat(-FORCE_MAX)), angular),
        (at(Vec3::X * 1_500.0, edge), linear),
        (at(Vec3::X * 30.0, edge), angular),
        (force_at(Vec3::X * 90_000.0, edge), linear),
        (force_at(Vec3::X * 1_800.0, edge), angular),
    ];
    for (command, expected) in refused {
        let mut scene = cube();
        let (before, spin) = (Vec3::new(3.0, 2.0, 1.0), Vec3::Y);
        scene.apply(&set_velocity(before, spin)).expect(VALID);
        assert_eq!(scene.apply(&command), expected, "{command:?}");
        steps(&mut scene, 2);
        let [now, turns] = velocities(&scene);
        assert!(
            are_near(now, before) && are_near(turns, spin),
            "{command:?}"
        );
    }
    let text = linear.expect_err(VALID).to_string();
    assert!(
        text.contains("linear velocity") && text.contains("1000"),
        "{text}"
    );
}

#[test]
fn a_refused_push_does_not_wake_a_body() {
    let body = BodyDesc::dynamic(Shape::ball(0.5)).mass(1.0);
    let mut scene = scene(Vec3::ZERO, &body);
    steps(&mut scene, 1);
    scene.apply(&Command::Sleep { id: BODY }).expect(VALID);
    steps(&mut scene, 1);
    for command in [
        impulse(Vec3::X * 1_001.0),
        force(Vec3::X * 60_100.0),
        torque_impulse(Vec3::X * 11.0),
    ] {
        assert!(scene.apply(&command).is_err(), "{command:?}");
    }
    steps(&mut scene, 2);
    let observed = scene.observation(BODY).expect(VALID);
    assert_eq!(observed.activity, Activity::Asleep);
}

#[test]
fn a_push_within_the_limits_of_velocities_acts_whole() {
    let most = Vec3::splat(LINEAR_MAX);
    let pushed = [
        (Vec3::ZERO, impulse(Vec3::X * 1_000.0), Vec3::X * 1_000.0),
        (Vec3::ZERO, impulse(most), most),
        (
            most,
            impulse(Vec3::Z * -500.0),
            Vec3::new(1_000.0, 1_000.0, 500.0),
        ),
        (
            Vec3::X * 999.0,
            impulse(Vec3::Y * 900.0),
            Vec3::new(999.0, 900.0, 0.0),
        ),
        (
            most,
            force(Vec3::Y * -60_000.0),
            Vec3::new(1_000.0, 0.0, 1_000.0),
        ),
        (-most, impulse(Vec3::splat(2_000.0)), most),
    ];
    for (before, command, after) in pushed {
        let mut scene = cube();
        scene.apply(&set_velocity(before, Vec3::ZERO)).expect(VALID);
        assert_eq!(scene.apply(&command), Ok(()), "{command:?}");
        steps(&mut scene, 2);
        let [now, _] = velocities(&scene);
        assert!(are_near(now, after), "{command:?}: {now}");
    }
    let most = Vec3::splat(ANGULAR_MAX);
    let moment = 0.4 * 0.4 / 6.0;
    let turned = [
        (
            Vec3::ZERO,
            torque_impulse(most * 0.999 * moment),
            most * 0.999,
        ),
        (
            most,
            torque(Vec3::Y * -100.0 * moment * TICKS),
            Vec3::new(100.0, 0.0, 100.0),
        ),
    ];
    for (before, command, after) in turned {
        let mut scene = cube();
        scene.apply(&set_velocity(Vec3::ZERO, before)).expect(VALID);
        assert_eq!(scene.apply(&command), Ok(()), "{command:?}");
        steps(&mut scene, 2);
        let [_, now] = velocities(&scene);
        assert!((now - after).length() < 0.05, "{command:?}: {now}");
    }
}

#[test]
fn the_pushes_of_a_tick_count_together() {
    let linear = too_fast(Quantity::Linear);
    let nine = [
        impulse(Vec3::X * 900.0),
        force(Vec3::X * 54_000.0),
        set_velocity(Vec3::X * 900.0, Vec3::ZERO),
    ];
    let again = [impulse(Vec3::X * 900.0), force(Vec3::X * 54_000.0)];
    for first in &nine {
        for second in &again {
            let mut scene = cube();
            assert_eq!(scene.apply(first), Ok(()), "{first:?}");
            assert_eq!(scene.apply(second), linear, "{first:?}, then {second:?}");
            steps(&mut scene, 1);
            let [now, _] = velocities(&scene);
            assert!(are_near(now, Vec3::X * 900.0), "{first:?}: {now}");
        }
    }
    // A velocity that is set, too.
    let mut scene = cube();
    scene.apply(&force(Vec3::X * 54_000.0)).expect(VALID);
    let set = set_velocity(Vec3::X * 900.0, Vec3::ZERO);
    assert_eq!(scene.apply(&set), linear);
    let [back, _] = [-Vec3::X * 900.0, Vec3::ZERO];
    assert_eq!(scene.apply(&set_velocity(back, Vec3::ZERO)), Ok(()));
    // The forces of a tick end with it.
    steps(&mut scene, 1);
    assert_eq!(scene.apply(&force(Vec3::X * 54_000.0)), Ok(()));
}

#[test]
fn what_slows_a_body_is_never_refused() {
    // Gravity makes 1,500 m/s of it.
    let mut scene = scene(Vec3::X * 1_000.0, &cube_body());
    steps(&mut scene, 90);
    let none = Command::SetGravity {
        gravity: Vec3::ZERO,
    };
    scene.apply(&none).expect(VALID);
    steps(&mut scene, 1);
    let [fast, _] = velocities(&scene);
    assert!(are_near(fast, Vec3::X * 1_500.0), "{fast}");
    assert_eq!(scene.apply(&impulse(Vec3::X)), too_fast(Quantity::Linear));
    assert_eq!(scene.apply(&impulse(Vec3::new(-100.0, 50.0, 0.0))), Ok(()));
    assert_eq!(scene.apply(&force(Vec3::X * -6_000.0)), Ok(()));
    steps(&mut scene, 1);
    let [now, _] = velocities(&scene);
    assert!(are_near(now, Vec3::new(1_300.0, 50.0, 0.0)), "{now}");
    // And beyond rest to as much the other way.
    assert_eq!(scene.apply(&impulse(Vec3::X * -2_300.0)), Ok(()));
    assert_eq!(scene.apply(&impulse(-Vec3::X)), too_fast(Quantity::Linear));
}

#[test]
fn a_push_along_a_locked_axis_does_nothing_however_great() {
    let locked = LockedAxes::new(0b01_0001).expect(VALID);
    let mut scene = scene(Vec3::ZERO, &cube_body().locked_axes(locked));
    for command in [impulse(Vec3::X * FORCE_MAX), torque(Vec3::Y * FORCE_MAX)] {
        assert_eq!(scene.apply(&command), Ok(()), "{command:?}");
    }
    steps(&mut scene, 2);
    assert_eq!(velocities(&scene), [Vec3::ZERO; 2]);
}

#[test]
fn a_body_at_the_greatest_speed_says_so_and_keeps_its_direction() {
    let gravity = Vec3::new(800.0, 600.0, 0.0);
    let mut scene = scene(gravity, &cube_body());
    steps(&mut scene, 150);
    let [now, _] = velocities(&scene);
    let greatest = Vec3::new(0.8, 0.6, 0.0) * GREATEST[0];
    assert!(are_near(now, greatest), "{now}");
    let at = scene.observation(BODY).expect(VALID).motion.position();
    steps(&mut scene, 1);
    let then = scene.observation(BODY).expect(VALID).motion.position();
    let moved = (Vec3::from_array(then) - Vec3::from_array(at)) * TICKS;
    assert!((moved - greatest).length() < 1.0, "{moved}");
}

#[test]
fn a_vehicle_is_as_fast_as_other_bodies() {
    let most = Vec3::splat(LINEAR_MAX);
    let mut scene = scene(Vec3::ZERO, &cube_body());
    let wheels = vec![Wheel::at(Vec3::ZERO, 0.1)];
    let locomotion = Box::new(Locomotion::Vehicle(Vehicle { wheels }));
    let id = BODY;
    scene
        .apply(&Command::SetLocomotion { id, locomotion })
        .expect(VALID);
    scene.apply(&set_velocity(most, Vec3::ZERO)).expect(VALID);
    steps(&mut scene, 3);
    let [now, _] = velocities(&scene);
    assert!(are_near(now, most), "{now}");
}

#[test]
fn a_character_falls_as_fast_as_other_bodies() {
    let body = BodyDesc::kinematic(Shape::capsule(0.5, 0.3)).at(0.0, 5_000.0, 0.0);
    let mut scene = scene(Vec3::Y * -1_000.0, &body);
    let locomotion = Box::new(Locomotion::Character(Character::default()));
    let id = BODY;
    scene
        .apply(&Command::SetLocomotion { id, locomotion })
        .expect(VALID);
    steps(&mut scene, 150);
    let height = |scene: &Scene| scene.observation(BODY).expect(VALID).motion.position()[1];
    let before = height(&scene);
    steps(&mut scene, 1);
    let speed = (before - height(&scene)) * TICKS;
    assert!((speed - GREATEST[0]).abs() < 2.0, "{speed} m/s");
}
