//! Properties of bodies, joints and shapes over the wire, each as its documentation says.
//!
//! One session sends commands, and a local scene gets the same ones: it is the truth. After every tick the session's copy
//! is within its bounds of the truth, whatever was changed, and both scenes have had the same states to the bit.

use glam::{Quat, Vec3};
use rhumb_protocol::Peer;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{
    BodyBuilder, BodyDesc, CollisionGroups, Command, CommandError, Invalid, Joint, JointFrame,
    JointId, JointKind, JointLimits, JointStrength, LockedAxes, Mass, Material, Motor, Quantity,
    SceneConfig, Shape, ShapeId, Spring,
};
use rhumb_protocol::session::Event;
use rhumb_protocol::stream::ErrorBound;
use rhumb_reckoning::{BodyId, Damping, Tick, Tolerance};
use rhumb_server::Scene;
use rhumb_tests::fuzzing::random_commands;
use rhumb_tests::{Dice, Table, seed};

const VALID: &str = "the test makes it valid";
const MEMBER: &str = "the session is a member";
const G: f32 = 10.0;

/// A scene on a server, its member, and the same scene here.
struct Remote {
    table: Table,
    peer: Peer,
    truth: Scene,
    bodies: u32,
}

impl Remote {
    fn new() -> Self {
        let config = SceneConfig {
            gravity: Vec3::new(0.0, -G, 0.0),
            ..SceneConfig::default()
        };
        let mut table = Table::default();
        let peer = table.connect("physics");
        let session = table.session(peer);
        session.create(config).expect("the session is in the lobby");
        session
            .join(StreamChoice::Within(Tolerance::FINE))
            .expect("the session is in the lobby");
        table.run_until_idle();
        Self {
            table,
            peer,
            truth: Scene::new(config).expect(VALID),
            bodies: 0,
        }
    }

    /// Sends a command, which both scenes must answer alike.
    fn send(&mut self, command: &Command) -> Result<(), CommandError> {
        let answer = self.truth.apply(command);
        self.events();
        let session = self.table.session(self.peer);
        session.command(command.clone()).expect(MEMBER);
        self.table.run_until_idle();
        let refused = self.events().into_iter().find_map(|event| match event {
            Event::Refused { error, .. } => Some(error),
            _ => None,
        });
        assert_eq!(refused, answer.err(), "{command:?}");
        answer
    }

    fn done(&mut self, command: &Command) {
        self.send(command).expect(VALID);
    }

    fn events(&mut self) -> Vec<Event> {
        let session = self.table.session(self.peer);
        core::iter::from_fn(|| session.poll_event()).collect()
    }

    /// Adds a body with a shape of its own.
    fn add(&mut self, body: &BodyBuilder) -> BodyId {
        let (id, shape) = (BodyId::new(self.bodies, 0), ShapeId(self.bodies));
        self.bodies += 1;
        self.done(&Command::AddShape {
            id: shape,
            shape: body.shape().clone(),
        });
        self.done(&Command::AddBody {
            desc: body.desc(id, shape),
            motion: body.state().expect(VALID),
        });
        id
    }

    /// Replaces the description of a body.
    fn change(&mut self, id: BodyId, change: impl FnOnce(&mut BodyDesc)) {
        let mut desc = *self.truth.body(id).expect("it lives");
        change(&mut desc);
        self.done(&Command::ChangeBody { desc });
        let copy = self.table.session(self.peer).replica().expect(MEMBER);
        assert_eq!(copy.body(id), Some(desc), "the copy knows the change");
    }

    fn join(&mut self, id: u32, joint: Joint) {
        let id = JointId(id);
        self.done(&Command::AddJoint { id, joint });
    }

    /// Steps both scenes; after each tick every body of the copy is within its bound of the truth.
    fn steps(&mut self, ticks: u64) {
        for _ in 0..ticks {
            let next = Tick::new(self.truth.tick().value() + 1);
            self.truth.step().expect("the engine does not fail");
            let now = self.table.now();
            let session = self.table.session(self.peer);
            session.advance(now, next).expect(MEMBER);
            self.table.run_until_idle();
            self.check(next);
        }
    }

    fn check(&mut self, tick: Tick) {
        let mut truth = Vec::new();
        self.truth.observe_all(&mut truth);
        let copy = self.table.session(self.peer).replica().expect(MEMBER);
        for observation in truth {
            let id = observation.id;
            let Some(ErrorBound::Within(bound)) = copy.stream().bound_at(id, tick) else {
                panic!("{id} has no bound at {tick:?}");
            };
            let motion = copy.stream().predicted_motion(id, tick).expect("a body");
            let away = motion.pose().position - observation.motion.motion().pose().position;
            assert!(
                away.length() <= bound.metres(),
                "{id} is {away} from the truth at {tick:?}"
            );
        }
        assert_eq!(copy.stream().statistics().mismatches, 0);
        let local: Vec<_> = self.truth.joints().iter().collect();
        let copied: Vec<_> = copy.joints().iter().collect();
        assert_eq!(copied, local, "the copy has the joints of the scene");
    }

    fn position(&self, id: BodyId) -> Vec3 {
        let observation = self.truth.observation(id).expect("it lives");
        Vec3::from_array(observation.motion.position())
    }

    fn velocity(&self, id: BodyId) -> Vec3 {
        let parts = self.truth.observation(id).expect("it lives").motion.parts();
        Vec3::new(parts[7], parts[8], parts[9])
    }

    fn spin(&self, id: BodyId) -> Vec3 {
        let parts = self.truth.observation(id).expect("it lives").motion.parts();
        Vec3::new(parts[10], parts[11], parts[12])
    }
}

/// At the end the server has had the same states as the local scene, to the bit.
impl Drop for Remote {
    fn drop(&mut self) {
        if std::thread::panicking() {
            return;
        }
        let session = self.table.session(self.peer);
        session.inspect().expect(MEMBER);
        self.table.run_until_idle();
        let truth = self.events().into_iter().find_map(|event| match event {
            Event::Inspected(inspection) => Some(inspection.truth),
            _ => None,
        });
        assert_eq!(truth, Some(self.truth.digest().value()));
    }
}

fn ball() -> BodyBuilder {
    BodyDesc::dynamic(Shape::ball(0.5))
}

fn floor() -> BodyBuilder {
    BodyDesc::fixed(Shape::HalfSpace { normal: Vec3::Y })
}

fn near(value: f32, expected: f32, slack: f32) {
    assert!((value - expected).abs() <= slack, "{value}, not {expected}");
}

#[test]
fn damping_and_gravity_scale_change_in_flight() {
    let mut remote = Remote::new();
    let ball = remote.add(&ball().linear_velocity([8.0, 0.0, 0.0]));
    remote.steps(30);
    near(remote.velocity(ball).y, -G * 0.5, 0.1);
    remote.change(ball, |desc| desc.gravity_scale = 0.0);
    remote.steps(30);
    near(remote.velocity(ball).y, -G * 0.5, 0.1);
    remote.change(ball, |desc| {
        desc.damping = Some(Damping {
            linear: 20.0,
            angular: 0.0,
        });
    });
    remote.steps(60);
    assert!(remote.velocity(ball).length() < 0.01);
}

#[test]
fn a_locked_axis_takes_no_motion() {
    let mut remote = Remote::new();
    let height = LockedAxes::EACH[1];
    let ball = remote.add(&ball().locked_axes(height | LockedAxes::ROTATIONS));
    remote.done(&Command::ImpulseAt {
        id: ball,
        impulse: Vec3::new(500.0, 500.0, 0.0),
        point: Vec3::new(0.0, 0.5, 0.0),
    });
    remote.steps(60);
    assert_eq!(remote.position(ball).y, 0.0);
    assert_eq!(remote.spin(ball), Vec3::ZERO);
    assert!(remote.position(ball).x > 0.5);
    remote.change(ball, |desc| desc.locked = LockedAxes::NONE);
    remote.steps(60);
    assert!(remote.position(ball).y < -4.0);
}

#[test]
fn an_impulse_at_a_point_turns_a_body_as_its_mass_properties_say() {
    let mut remote = Remote::new();
    let body = remote.add(&ball().gravity_scale(0.0).mass(4.0));
    remote.change(body, |desc| {
        desc.mass = Some(Mass {
            mass: 2.0,
            moments: Some(Vec3::splat(0.5)),
        });
    });
    remote.done(&Command::ImpulseAt {
        id: body,
        impulse: Vec3::new(0.0, 0.0, 3.0),
        point: Vec3::new(0.5, 0.0, 0.0),
    });
    remote.steps(1);
    near(remote.velocity(body).z, 3.0 / 2.0, 1e-4);
    near(remote.spin(body).y, -3.0 * 0.5 / 0.5, 1e-3);
    remote.done(&Command::ForceAt {
        id: body,
        force: Vec3::new(0.0, 0.0, -6.0),
        point: Vec3::ZERO,
    });
    remote.steps(1);
    near(remote.velocity(body).z, 1.5 - 6.0 / 2.0 / 60.0, 1e-4);
}

#[test]
fn a_body_of_its_own_mass_has_the_moments_of_its_shape_in_proportion() {
    let mut remote = Remote::new();
    for (number, own) in [None, Some(8.0)].into_iter().enumerate() {
        let cube = BodyDesc::dynamic(Shape::cuboid(0.5, 0.5, 0.5)).gravity_scale(0.0);
        let cube = cube.at(number as f32 * 10.0, 0.0, 0.0);
        let cube = remote.add(&own.map_or(cube.clone(), |mass| cube.clone().mass(mass)));
        remote.done(&Command::TorqueImpulse {
            id: cube,
            impulse: Vec3::new(0.0, 2.0, 0.0),
        });
        remote.steps(1);
        // A cube of one metre: a sixth of its mass.
        near(
            remote.spin(cube).y,
            2.0 * 6.0 / own.unwrap_or(1_000.0),
            1e-3,
        );
    }
}

#[test]
fn a_body_becomes_kinematic_static_and_dynamic_again() {
    let mut remote = Remote::new();
    let body = remote.add(&ball().linear_velocity([3.0, 0.0, 0.0]));
    remote.steps(10);
    let there = remote.position(body);
    for (kind, moves) in [
        (rhumb_protocol::scene::BodyKind::Kinematic, true),
        (rhumb_protocol::scene::BodyKind::Static, false),
    ] {
        remote.change(body, |desc| desc.kind = kind);
        remote.steps(10);
        assert_eq!(remote.position(body), there);
        let answer = remote.send(&Command::SetVelocity {
            id: body,
            linear: Vec3::X,
            angular: Vec3::ZERO,
        });
        let stands = CommandError::NotPushable(body);
        assert_eq!(answer, if moves { Ok(()) } else { Err(stands) });
        remote.done(&Command::SetPose {
            id: body,
            position: there,
            rotation: Quat::IDENTITY,
        });
        remote.steps(2);
    }
    remote.change(body, |desc| {
        desc.kind = rhumb_protocol::scene::BodyKind::Dynamic;
    });
    remote.steps(30);
    assert!(remote.position(body).y < there.y - 0.5);
}

#[test]
fn a_disabled_body_stays_and_touches_nothing_until_it_is_enabled() {
    let mut remote = Remote::new();
    let shelf = remote.add(&BodyDesc::fixed(Shape::cuboid(2.0, 0.5, 2.0)).at(0.0, -1.0, 0.0));
    let ball = remote.add(&ball());
    remote.steps(240);
    near(remote.position(ball).y, 0.0, 0.02);
    // The sleeping ball wakes and falls when its support is disabled.
    remote.change(shelf, |desc| desc.enabled = false);
    remote.steps(60);
    let fallen = remote.position(ball);
    assert!(fallen.y < -4.0, "{fallen}");
    remote.change(ball, |desc| desc.enabled = false);
    let answer = remote.send(&Command::Impulse {
        id: ball,
        impulse: Vec3::X,
    });
    assert_eq!(answer, Err(CommandError::BodyDisabled(ball)));
    remote.steps(60);
    assert_eq!(remote.position(ball), fallen);
    remote.done(&Command::SetPose {
        id: ball,
        position: Vec3::new(0.0, 3.0, 0.0),
        rotation: Quat::IDENTITY,
    });
    remote.change(shelf, |desc| desc.enabled = true);
    remote.steps(2);
    assert_eq!(remote.position(ball).y, 3.0);
    remote.change(ball, |desc| desc.enabled = true);
    remote.steps(120);
    near(remote.position(ball).y, 0.0, 0.02);
}

#[test]
fn a_body_is_put_to_sleep_and_woken() {
    let mut remote = Remote::new();
    let body = remote.add(&ball());
    remote.steps(10);
    remote.done(&Command::Sleep { id: body });
    remote.steps(1);
    let there = remote.position(body);
    assert_eq!(remote.truth.awake_count(), 0);
    remote.steps(30);
    assert_eq!(remote.position(body), there);
    remote.done(&Command::Wake { id: body });
    remote.steps(30);
    assert!(remote.position(body).y < there.y - 1.0);
}

#[test]
fn sensors_and_collision_groups_let_bodies_pass() {
    let mut remote = Remote::new();
    let shelf = remote.add(&BodyDesc::fixed(Shape::cuboid(2.0, 0.5, 2.0)).as_sensor());
    let [first, second] = [1.0, 2.0].map(|x| remote.add(&ball().at(x, 1.1, 0.0)));
    remote.steps(60);
    assert!(remote.position(first).y < -2.0 && remote.position(second).y < -2.0);
    remote.change(shelf, |desc| desc.sensor = false);
    remote.change(first, |desc| {
        desc.groups = CollisionGroups {
            members: 2,
            touches: 2,
        };
    });
    remote.change(shelf, |desc| {
        desc.groups = CollisionGroups {
            members: 1,
            touches: 1,
        };
    });
    for (x, id) in [(-1.0, first), (1.0, second)] {
        remote.done(&Command::SetPose {
            id,
            position: Vec3::new(x, 1.5, 0.0),
            rotation: Quat::IDENTITY,
        });
        remote.done(&Command::SetVelocity {
            id,
            linear: Vec3::ZERO,
            angular: Vec3::ZERO,
        });
    }
    remote.steps(60);
    assert!(remote.position(first).y < -1.0);
    near(remote.position(second).y, 1.0, 0.05);
}

#[test]
fn friction_restitution_and_dominance_change() {
    let mut remote = Remote::new();
    let ice = Material {
        friction: 0.0,
        restitution: 0.0,
        density: 100.0,
    };
    remote.add(&floor().material(ice));
    let cube = BodyDesc::dynamic(Shape::cuboid(0.5, 0.5, 0.5)).at(0.0, 0.5, 0.0);
    let cube = remote.add(&cube.material(ice).linear_velocity([4.0, 0.0, 0.0]));
    remote.steps(60);
    near(remote.velocity(cube).x, 4.0, 0.05);
    remote.change(cube, |desc| {
        desc.material = Some(Material {
            friction: 2.0,
            ..ice
        });
    });
    remote.steps(120);
    near(remote.velocity(cube).x, 0.0, 0.01);
    // A light body of greater dominance pushes a heavy one as if that had no mass.
    let pusher = ball().at(remote.position(cube).x - 3.0, 0.5, 0.0).mass(0.1);
    let pusher = remote.add(&pusher.gravity_scale(0.0).linear_velocity([5.0, 0.0, 0.0]));
    remote.change(pusher, |desc| desc.dominance = 5);
    // A body of greater dominance does not wake another one.
    remote.done(&Command::Wake { id: cube });
    remote.steps(90);
    near(remote.velocity(pusher).x, 5.0, 0.01);
    near(remote.velocity(cube).x, 5.0, 0.2);
}

#[test]
fn a_swept_body_does_not_pass_through_a_moving_wall() {
    for swept in [false, true] {
        let mut remote = Remote::new();
        let wall = BodyDesc::dynamic(Shape::cuboid(0.01, 2.0, 2.0)).gravity_scale(0.0);
        let wall = remote.add(&wall);
        let bullet = BodyDesc::dynamic(Shape::ball(0.05)).gravity_scale(0.0);
        let bullet = remote.add(&bullet.at(-3.1, 0.0, 0.0).linear_velocity([200.0, 0.0, 0.0]));
        remote.change(bullet, |desc| desc.swept = swept);
        remote.steps(4);
        let passed = remote.position(bullet).x > remote.position(wall).x + 1.0;
        assert_eq!(passed, !swept, "swept: {swept}");
    }
}

#[test]
fn a_body_takes_another_shape() {
    let mut remote = Remote::new();
    remote.add(&floor());
    let body = remote.add(&ball().at(0.0, 0.5, 0.0));
    let shape = ShapeId(99);
    remote.done(&Command::AddShape {
        id: shape,
        shape: Shape::cuboid(0.5, 1.5, 0.5),
    });
    remote.change(body, |desc| desc.shape = shape);
    remote.steps(240);
    near(remote.position(body).y, 1.5, 0.05);
    // The old shape has no users any more.
    remote.done(&Command::RemoveShape { id: ShapeId(1) });
    let answer = remote.send(&Command::RemoveShape { id: shape });
    assert_eq!(answer, Err(CommandError::ShapeInUse(shape)));
}

#[test]
fn round_cuboids_cones_and_balls_come_to_rest_on_a_half_space() {
    let mut remote = Remote::new();
    remote.add(&floor());
    let round = Shape::RoundedCuboid {
        half_extents: Vec3::splat(0.4),
        radius: 0.1,
    };
    for (place, (shape, height)) in [
        (Shape::ball(0.5), 0.5),
        (round, 0.5),
        (Shape::cone(0.5, 0.5), 0.25),
        (Shape::cylinder(0.5, 0.3), 0.5),
    ]
    .into_iter()
    .enumerate()
    {
        let body = BodyDesc::dynamic(shape).at(place as f32 * 3.0, height + 0.2, 0.0);
        let body = remote.add(&body);
        remote.steps(180);
        near(remote.position(body).y, height, 0.02);
    }
    let normal = Vec3::ZERO;
    let invalid = Err(Invalid::NotFinite(Quantity::Rotation));
    assert_eq!(Shape::HalfSpace { normal }.check(), invalid);
}

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
        joint: Joint::plain(spring, bodies, centres),
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
        joint: hinge,
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
fn a_joint_breaks_above_its_strength_and_the_copy_is_told() {
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
        match remote.send(&Command::AddJoint { id, joint }) {
            Ok(()) => joints += 1,
            Err(error) => break error,
        }
    };
    assert_eq!((joints, refused), (72, CommandError::TooManyJoints));
    remote.steps(10);
}

#[test]
fn dampings_of_removed_bodies_can_be_used_again() {
    let mut remote = Remote::new();
    let shape = ShapeId(0);
    remote.done(&Command::AddShape {
        id: shape,
        shape: Shape::ball(0.5),
    });
    let mut refused = 0;
    for round in 0..200_u16 {
        let id = BodyId::new(u32::from(round % 70), round / 70);
        if lives(&remote, id.index()) {
            let before = BodyId::new(id.index(), round / 70 - 1);
            remote.done(&Command::RemoveBody { id: before });
        }
        let ball = ball().damping(Damping {
            linear: f32::from(round) * 0.01,
            angular: 0.0,
        });
        let answer = remote.send(&Command::AddBody {
            desc: ball.desc(id, shape),
            motion: ball.state().expect(VALID),
        });
        refused += u32::from(answer == Err(CommandError::TooManyDampings));
        if round % 20 == 0 {
            remote.steps(1);
        }
    }
    // Of each seventy bodies six find no place beside the other dampings.
    assert!((1..=18).contains(&refused), "{refused}");
}

fn lives(remote: &Remote, index: u32) -> bool {
    remote.truth.bodies().any(|desc| desc.id.index() == index)
}

#[test]
fn random_commands_have_the_same_effect_over_the_wire() {
    let mut dice = Dice::new(seed(7));
    let bodies: Vec<_> = (0..6).map(|index| BodyId::new(index, 0)).collect();
    let mut sent = 0;
    for _ in 0..60 {
        let data: Vec<u8> = (0..3_000).map(|_| dice.below(256) as u8).collect();
        let mut remote = Remote::new();
        for command in random_commands(&data, &bodies) {
            // A session sends no command with an invalid number.
            if command.check().is_ok() {
                sent += u32::from(remote.send(&command).is_ok());
                if dice.below(3) == 0 {
                    remote.steps(1);
                }
            }
        }
        remote.steps(30);
    }
    assert!(sent > 2_000, "{sent}");
}
