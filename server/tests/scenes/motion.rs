//! Slow, fast and spinning bodies move as commanded; settled ones sleep.
//!
//! Proved by small scenes on the engine of the server. The motion of a body is compared with its closed form.

use std::f32::consts::{FRAC_PI_2, PI};

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{
    BodyBuilder, BodyDesc, Command, Edges, Heights, Joint, JointFrame, JointId, JointKind,
    Material, Mesh, Motor, SceneConfig, Shape, ShapeId, Sleep, SleepThresholds,
};
use rhumb_protocol::stream::Activity;
use rhumb_reckoning::{BodyId, Damping};
use rhumb_scene::Scene;

const VALID: &str = "the test makes it valid";
const EARTH: Vec3 = Vec3::new(0.0, -9.81, 0.0);
const TEN_SECONDS: u32 = 600;

/// A scene whose bodies are numbered as they are added.
struct World {
    scene: Scene,
    count: u32,
}

impl World {
    fn new(gravity: Vec3) -> Self {
        Self::of(SceneConfig {
            gravity,
            ..SceneConfig::default()
        })
    }

    fn of(config: SceneConfig) -> Self {
        let scene = Scene::new(config).expect(VALID);
        Self { scene, count: 0 }
    }

    fn apply(&mut self, command: &Command) {
        self.scene.apply(command).expect(VALID);
    }

    fn add(&mut self, body: &BodyBuilder) -> BodyId {
        let (id, shape) = (BodyId::new(self.count, 0), ShapeId(self.count));
        self.count += 1;
        self.apply(&Command::AddShape {
            id: shape,
            shape: body.shape().clone(),
        });
        self.apply(&Command::AddBody {
            desc: body.desc(id, shape),
            motion: body.state().expect(VALID),
        });
        id
    }

    fn join(
        &mut self,
        kind: JointKind,
        bodies: [BodyId; 2],
        anchors: [Vec3; 2],
        motor: Option<Motor>,
    ) {
        let frames = anchors.map(|anchor| JointFrame {
            anchor,
            rotation: Quat::IDENTITY,
        });
        let mut joint = Joint::plain(kind, bodies, frames);
        joint.motors[3] = motor;
        let id = JointId(self.count);
        let joint = Box::new(joint);
        self.apply(&Command::AddJoint { id, joint });
    }

    fn floor(&mut self) {
        self.add(&BodyDesc::fixed(Shape::cuboid(500.0, 0.5, 500.0)).at(0.0, -0.5, 0.0));
    }

    fn steps(&mut self, count: u32) {
        for _ in 0..count {
            self.scene.step().expect(VALID);
        }
    }

    fn position(&self, id: BodyId) -> Vec3 {
        let motion = self.scene.observation(id).expect(VALID).motion;
        Vec3::from_array(motion.position())
    }

    fn rotation(&self, id: BodyId) -> Quat {
        let motion = self.scene.observation(id).expect(VALID).motion;
        Quat::from_array(motion.rotation())
    }

    fn velocities(&self, id: BodyId) -> (Vec3, Vec3) {
        let parts = self.scene.observation(id).expect(VALID).motion.parts();
        let [.., vx, vy, vz, wx, wy, wz] = parts;
        (Vec3::new(vx, vy, vz), Vec3::new(wx, wy, wz))
    }

    fn is_awake(&self, id: BodyId) -> bool {
        self.scene.observation(id).expect(VALID).activity == Activity::Awake
    }
}

fn ball(radius: f32) -> BodyBuilder {
    BodyDesc::dynamic(Shape::ball(radius))
}

#[test]
fn a_body_drifts_on_in_empty_space_however_slowly() {
    for speed in [0.09, 0.05, 0.005, 0.0005] {
        let mut world = World::new(Vec3::ZERO);
        let body = world.add(&ball(0.1).linear_velocity(Vec3::new(speed, 0.0, 0.0)));
        let turning = world.add(
            &ball(0.1)
                .at(0.0, 5.0, 0.0)
                .angular_velocity(Vec3::Y * speed),
        );
        world.steps(TEN_SECONDS);
        let went = world.position(body).x / (10.0 * speed);
        assert!((0.99..1.01).contains(&went), "{speed} m/s: {went}");
        assert!(world.is_awake(turning), "{speed} rad/s");
    }
}

#[test]
fn what_touches_drifts_on_in_empty_space() {
    let mut world = World::new(Vec3::ZERO);
    let cube = || BodyDesc::dynamic(Shape::cuboid(0.5, 0.5, 0.5));
    let drifting = Vec3::new(0.04, 0.0, 0.0);
    let first = world.add(&cube().linear_velocity(drifting));
    world.add(&cube().at(0.0, 1.0, 0.0).linear_velocity(drifting));
    world.steps(TEN_SECONDS);
    assert!(
        (world.position(first).x - 0.4).abs() < 0.02,
        "{}",
        world.position(first)
    );
}

#[test]
fn a_body_falls_in_the_least_gravity() {
    let mut world = World::new(Vec3::new(0.0, -0.01, 0.0));
    let body = world.add(&ball(0.1));
    world.steps(TEN_SECONDS);
    assert!(
        (world.position(body).y + 0.5).abs() < 0.01,
        "{}",
        world.position(body)
    );
}

#[test]
fn pendulums_swing_on_whatever_their_length_and_swing() {
    for (length, swing) in [
        (5.0_f32, 0.05_f32),
        (5.0, 0.01),
        (1.0, 0.01),
        (0.3, 0.02),
        (20.0, 0.05),
    ] {
        let mut world = World::new(EARTH);
        let hook = world.add(&BodyDesc::fixed(Shape::ball(0.1)));
        let bob = world.add(&ball(0.1).at(swing, -length, 0.0));
        let anchors = [Vec3::ZERO, Vec3::new(-swing, length, 0.0)];
        world.join(JointKind::Spherical(None), [hook, bob], anchors, None);
        let (mut least, mut most) = (f32::MAX, f32::MIN);
        for tick in 0..TEN_SECONDS {
            world.steps(1);
            if tick >= 300 {
                let x = world.position(bob).x;
                (least, most) = (least.min(x), most.max(x));
            }
        }
        // Of a swing of twenty metres, half a period is 4.5 s.
        assert!(most - least > swing * 1.5, "{length} m: {least} to {most}");
    }
}

#[test]
fn a_slow_motor_turns_what_it_drives() {
    for speed in [0.1_f32, 0.02, 0.002] {
        let mut world = World::new(EARTH);
        let base = world.add(&BodyDesc::fixed(Shape::ball(0.1)));
        let arm = world.add(&BodyDesc::dynamic(Shape::cuboid(0.1, 0.5, 0.1)));
        let motor = Motor {
            position: 0.0,
            velocity: speed,
            stiffness: 0.0,
            damping: 1e5,
            force: 1e6,
        };
        world.join(
            JointKind::Revolute(None),
            [base, arm],
            [Vec3::ZERO; 2],
            Some(motor),
        );
        world.steps(TEN_SECONDS);
        let turned = world.rotation(arm).to_axis_angle().1 / (10.0 * speed);
        assert!((0.95..1.05).contains(&turned), "{speed} rad/s: {turned}");
    }
}

#[test]
fn a_ball_rolls_down_a_gentle_slope_from_rest() {
    for degrees in [1.5_f32, 0.5, 0.1] {
        let mut world = World::new(EARTH);
        let tilt = Quat::from_rotation_z(-degrees.to_radians());
        let slope = BodyDesc::fixed(Shape::cuboid(100.0, 0.5, 5.0)).rotation(tilt);
        world.add(&slope.position(tilt * Vec3::new(0.0, -0.5, 0.0)));
        let ball = world.add(&ball(0.3).position(tilt * Vec3::new(0.0, 0.3, 0.0)));
        world.steps(TEN_SECONDS);
        // A rolling ball accelerates by five sevenths of the slope's part of gravity.
        let way = 0.5 * 100.0 * 9.81 * degrees.to_radians().sin() * 5.0 / 7.0;
        let went = world.position(ball).x / way;
        assert!((0.8..1.1).contains(&went), "{degrees} degrees: {went}");
    }
}

#[test]
fn settled_bodies_sleep() {
    let mut world = World::new(EARTH);
    world.floor();
    for place in 0..5 {
        let shape = Shape::cuboid(0.5, 0.5, 0.5);
        world.add(&BodyDesc::dynamic(shape).at(0.0, 0.5 + place as f32, 0.0));
        world.add(&ball(0.5).at(5.0 + 2.0 * place as f32, 0.6, 0.0));
    }
    let still = world.add(&ball(0.1).at(0.0, 50.0, 0.0).gravity_scale(0.0));
    world.steps(180);
    assert_eq!(world.scene.awake_count(), 0);
    assert!(!world.is_awake(still));
}

#[test]
fn what_hangs_still_sleeps() {
    let mut world = World::new(EARTH);
    let hook = world.add(&BodyDesc::fixed(Shape::ball(0.1)));
    let mut above = hook;
    for link in 1..5 {
        let next = world.add(&ball(0.1).at(0.0, -(link as f32), 0.0));
        let anchors = [Vec3::new(0.0, -0.5, 0.0), Vec3::new(0.0, 0.5, 0.0)];
        let anchors = if link == 1 {
            [Vec3::ZERO, Vec3::Y]
        } else {
            anchors
        };
        world.join(JointKind::Spherical(None), [above, next], anchors, None);
        above = next;
    }
    world.steps(TEN_SECONDS);
    assert_eq!(world.scene.awake_count(), 0);
}

#[test]
fn a_body_sleeps_by_its_own_rule_and_not_by_the_scenes() {
    let fast = Vec3::new(0.3, 0.0, 0.0);
    let below = |speed, angular_speed, seconds| {
        Sleep::Below(SleepThresholds {
            speed,
            angular_speed,
            seconds,
        })
    };
    for (scene, own, awake) in [
        (Sleep::Settled, None, true),
        (below(0.5, 100.0, 0.5), None, false),
        (below(0.5, 100.0, 0.5), Some(Sleep::Never), true),
        (below(0.5, 100.0, 0.5), Some(Sleep::Settled), true),
        (Sleep::Never, Some(below(0.5, 100.0, 0.5)), false),
        (Sleep::Never, Some(below(0.2, 100.0, 0.5)), true),
        (Sleep::Never, Some(below(0.5, 0.2, 0.5)), true),
        (Sleep::Never, Some(below(0.5, 0.4, 0.5)), false),
        (Sleep::Never, Some(below(0.5, 0.4, 5.0)), true),
    ] {
        let mut world = World::of(SceneConfig {
            gravity: Vec3::ZERO,
            sleep: scene,
            ..SceneConfig::default()
        });
        let mut body = ball(0.1)
            .linear_velocity(fast)
            .angular_velocity(Vec3::Y * 0.3);
        if let Some(own) = own {
            body = body.sleep(own);
        }
        let body = world.add(&body);
        world.steps(120);
        assert_eq!(world.is_awake(body), awake, "{scene:?}, {own:?}");
    }
}

#[test]
fn a_body_that_never_sleeps_rests_awake_and_a_command_puts_it_to_sleep() {
    let mut world = World::new(EARTH);
    world.floor();
    let body = world.add(&ball(0.5).at(0.0, 0.5, 0.0).sleep(Sleep::Never));
    world.steps(300);
    assert!(world.is_awake(body));
    world.apply(&Command::Sleep { id: body });
    world.steps(60);
    assert!(!world.is_awake(body));
}

#[test]
fn a_changed_rule_of_sleep_holds_from_then_on() {
    let mut world = World::new(EARTH);
    world.floor();
    let builder = ball(0.5).at(0.0, 0.5, 0.0);
    let body = world.add(&builder);
    world.steps(120);
    assert!(!world.is_awake(body));
    let mut desc = builder.desc(body, ShapeId(body.index()));
    desc.sleep = Some(Sleep::Never);
    world.apply(&Command::ChangeBody { desc });
    world.steps(120);
    assert!(world.is_awake(body));
}

#[test]
fn bodies_have_every_speed_that_a_command_may_set() {
    let mut world = World::new(Vec3::ZERO);
    let fast = world.add(&ball(0.1).linear_velocity(Vec3::new(600.0, 0.0, 0.0)));
    let fastest = world.add(
        &ball(0.1)
            .at(0.0, 9.0, 0.0)
            .linear_velocity(Vec3::splat(1000.0)),
    );
    let turning = world.add(
        &ball(0.1)
            .at(0.0, 19.0, 0.0)
            .angular_velocity(Vec3::splat(100.0)),
    );
    let box_ = BodyDesc::dynamic(Shape::cuboid(0.1, 0.2, 0.1)).at(0.0, 29.0, 0.0);
    let tumbling = world.add(&box_.angular_velocity(Vec3::new(0.0, 100.0, 0.0)));
    world.steps(60);
    assert!(
        (world.position(fast).x - 600.0).abs() < 0.1,
        "{}",
        world.position(fast)
    );
    assert!(
        world.position(fastest).x > 999.0,
        "{}",
        world.position(fastest)
    );
    assert!(world.velocities(turning).1.min_element() > 99.9);
    assert!(world.velocities(tumbling).1.y > 99.9);
}

#[test]
fn a_wheel_rolls_on_at_thirty_metres_a_second() {
    let mut world = World::new(EARTH);
    world.floor();
    let rolling = ball(0.3).at(-400.0, 0.3, 0.0);
    let rolling = rolling.linear_velocity(Vec3::new(30.0, 0.0, 0.0));
    let rolling = world.add(&rolling.angular_velocity(Vec3::new(0.0, 0.0, -100.0)));
    world.steps(180);
    let speed = world.velocities(rolling).0.x;
    assert!(speed > 29.0, "{speed}");
}

/// Half extents, spin, greatest tilt in degrees.
const SPINNING: [(&str, [f32; 3], [f32; 3], f32); 4] = [
    ("disc", [0.3, 0.01, 0.3], [0.0, 20.0, 0.5], 3.0),
    ("rod", [0.05, 0.5, 0.05], [0.03, 30.0, 0.0], 7.0),
    ("book", [0.1, 0.02, 0.15], [0.3, 12.0, 0.3], 6.0),
    ("plate at 90 rad/s", [0.3, 0.01, 0.3], [0.0, 90.0, 1.0], 3.0),
];

/// Angular momentum and energy of a cuboid, per kilogram.
fn momentum_and_energy([x, y, z]: [f32; 3], rotation: Quat, spin: Vec3) -> (Vec3, f32) {
    let moments = Vec3::new(y * y + z * z, z * z + x * x, x * x + y * y) / 3.0;
    let own = rotation.inverse() * spin;
    (rotation * (own * moments), 0.5 * own.dot(own * moments))
}

#[test]
fn a_free_body_keeps_its_axis_its_energy_and_its_angular_momentum() {
    for (name, half, spin, most) in SPINNING {
        let mut world = World::new(Vec3::ZERO);
        let body = BodyDesc::dynamic(Shape::cuboid(half[0], half[1], half[2]));
        let spin = Vec3::from_array(spin);
        let body = world.add(&body.angular_velocity(spin));
        let (momentum, energy) = momentum_and_energy(half, Quat::IDENTITY, spin);
        for tick in 0..TEN_SECONDS {
            world.steps(1);
            let rotation = world.rotation(body);
            let tilt = (rotation * Vec3::Y).angle_between(Vec3::Y).to_degrees();
            assert!(tilt < most, "{name}: {tilt} degrees at {tick}");
            let (now, left) = momentum_and_energy(half, rotation, world.velocities(body).1);
            assert!(
                (left / energy - 1.0).abs() < 0.01,
                "{name}: energy {left}, not {energy}"
            );
            let off = (now - momentum).length() / momentum.length();
            assert!(off < 0.05, "{name}: {off} of its momentum at {tick}");
        }
    }
}

#[test]
fn a_wobbling_disc_on_a_joint_keeps_its_axis_too() {
    let (name, half, spin, _) = SPINNING[0];
    let mut world = World::new(Vec3::ZERO);
    let base = world.add(&BodyDesc::fixed(Shape::ball(0.01)));
    let disc = BodyDesc::dynamic(Shape::cuboid(half[0], half[1], half[2]));
    let disc = world.add(&disc.angular_velocity(Vec3::from_array(spin)));
    world.join(
        JointKind::Spherical(None),
        [base, disc],
        [Vec3::ZERO; 2],
        None,
    );
    for tick in 0..TEN_SECONDS {
        world.steps(1);
        let tilt = (world.rotation(disc) * Vec3::Y)
            .angle_between(Vec3::Y)
            .to_degrees();
        assert!(tilt < 5.0, "{name}: {tilt} degrees at {tick}");
    }
}

#[test]
fn a_body_without_gyroscopic_forces_keeps_its_spin_to_the_bit() {
    let mut world = World::new(Vec3::ZERO);
    let body = BodyDesc::dynamic(Shape::cuboid(0.1, 0.3, 0.5)).without_gyroscopic_forces();
    let spin = Vec3::new(3.0, 5.0, -2.0);
    let body = world.add(&body.angular_velocity(spin));
    world.steps(TEN_SECONDS);
    assert_eq!(world.velocities(body).1, spin);
}

/// Flat ground of many triangles: as heights and as a mesh, wound both ways.
fn flat_grounds(edges: Edges) -> [Shape; 3] {
    let side = 81_u32;
    let heights = vec![0.0; (side * side) as usize];
    let heights = Heights::new(side, 0.5, 0.5, &heights).expect(VALID);
    let point = |place: u32| {
        Vec3::new(
            (place / side) as f32 * 0.5,
            0.0,
            (place % side) as f32 * 0.5,
        )
    };
    let points: Vec<Vec3> = (0..side * side).map(point).collect();
    let cells = (0..side * side).filter(|place| place / side + 1 < side && place % side + 1 < side);
    let halves = cells.flat_map(|a| [[a, a + 1, a + side], [a + 1, a + side + 1, a + side]]);
    let up: Vec<[u32; 3]> = halves.collect();
    let down: Vec<[u32; 3]> = up.iter().map(|[a, b, c]| [*a, *c, *b]).collect();
    let mesh = |triangles: &[[u32; 3]]| {
        let mesh = Mesh::new(&points, triangles).expect(VALID);
        Shape::Mesh(mesh.with_edges(edges))
    };
    [
        Shape::Heights(heights.with_edges(edges)),
        mesh(&up),
        mesh(&down),
    ]
}

/// Greatest speed up or down, and the turn of its way, rad, of what slides or rolls over a ground for three seconds.
fn slides_over(ground: Shape, shape: Shape, above: f32) -> (f32, f32) {
    let plain = SceneConfig::default();
    let material = Material {
        friction: 0.0,
        ..plain.material
    };
    let mut world = World::of(SceneConfig { material, ..plain });
    world.add(&BodyDesc::fixed(ground).at(-20.0, 0.0, -20.0));
    let sliding = BodyDesc::dynamic(shape).at(-9.13, above, -0.83);
    let velocity = Vec3::new(4.0, 0.0, 1.24);
    let body = world.add(&sliding.linear_velocity(velocity));
    let mut most = 0.0_f32;
    for tick in 0..180 {
        world.steps(1);
        if tick > 20 {
            most = most.max(world.velocities(body).0.y.abs());
        }
    }
    let (end, _) = world.velocities(body);
    let way = Vec3::new(end.x, 0.0, end.z).normalize();
    (most, way.cross(velocity.normalize()).length())
}

#[test]
fn bodies_slide_over_smooth_edges_as_over_one_face() {
    for (place, ground) in flat_grounds(Edges::Smooth).into_iter().enumerate() {
        for shape in [
            Shape::ball(0.3),
            Shape::cuboid(0.3, 0.3, 0.3),
            Shape::cylinder(0.3, 0.3),
        ] {
            let (up, off) = slides_over(ground.clone(), shape.clone(), 0.3);
            assert!(
                up < 0.1 && off < 0.02,
                "ground {place}, {shape:?}: {up} m/s, {off} rad"
            );
        }
    }
}

#[test]
fn bodies_catch_on_plain_edges() {
    let [heights, mesh, _] = flat_grounds(Edges::Plain);
    for ground in [heights, mesh] {
        let (up, _) = slides_over(ground, Shape::cuboid(0.3, 0.3, 0.3), 0.3);
        assert!(up > 0.3, "{up} m/s");
    }
}

#[test]
fn bodies_stand_on_smooth_ground_wherever_they_are_put() {
    let damping = Damping {
        linear: 0.0,
        angular: 0.5,
    };
    for ground in flat_grounds(Edges::Smooth) {
        let mut world = World::new(EARTH);
        world.add(&BodyDesc::fixed(ground).at(-20.0, 0.0, -20.0));
        let mut bodies = Vec::new();
        for (row, shape) in [
            Shape::capsule(0.3, 0.2),
            Shape::ball(0.05),
            Shape::cuboid(0.2, 0.5, 0.2),
            Shape::cone(0.3, 0.2),
        ]
        .into_iter()
        .enumerate()
        {
            let high = if row == 0 || row == 2 { 0.5 } else { 0.2 };
            for column in 0..8 {
                // On posts, on edges and between them.
                let (x, z) = (column as f32 * 1.0625 - 4.0, row as f32 * 2.0 - 4.0);
                let turned = Quat::from_rotation_y(column as f32 * PI / 8.0);
                let body = BodyDesc::dynamic(shape.clone()).at(x, high, z);
                let turned = if row == 3 {
                    Quat::from_rotation_x(FRAC_PI_2)
                } else {
                    turned
                };
                bodies.push(world.add(&body.rotation(turned).damping(damping)));
            }
        }
        world.steps(300);
        for body in bodies {
            assert!(world.position(body).y > 0.0, "{}", world.position(body));
        }
    }
}
