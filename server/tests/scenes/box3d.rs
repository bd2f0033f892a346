//! Box3D behind the server's engine trait.
//!
//! Proved by small scenes with known outcome, by the parts that it lacks, and by the ball pit through a server and two
//! sessions: the copy is within its tolerance at every tick.

use glam::{Quat, Vec3};
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{
    ActiveEvents, Answer, BodyDesc, BodyEvent, BodyKind, Command, CommandError, Compound, Heights,
    Invalid, Joint, JointFrame, JointId, JointKind, JointStrength, Mass, Mesh, Part, Quantity,
    Query, SceneConfig, Shape, ShapeId, Sleep, SleepThresholds, Spring,
};
use rhumb_protocol::session::{ClientSession, Event};
use rhumb_protocol::{Endpoint, Instant, Peer, Transmit};
use rhumb_reckoning::{BodyId, BodyState, Divergence, Tick, Tolerance};
use rhumb_scene::engine::{Box3dEngine, EngineKind, Engines};
use rhumb_scene::{Activity, Scene, SceneRouter, SceneSettings};
use rhumb_sims::{BallPit, Script};

const VALID: &str = "the test makes it valid";
const GROUND: BodyId = BodyId::new(0, 0);
const BALL: BodyId = BodyId::new(1, 0);

fn scene() -> Scene {
    let config = SceneConfig {
        sleep: Sleep::Below(SleepThresholds::by_speed(0.1, 0.5)),
        ..SceneConfig::default()
    };
    let engine = Box3dEngine::new(&config).expect(VALID);
    Scene::with_engine(config, Box::new(engine)).expect(VALID)
}

fn add_shape(scene: &mut Scene, id: u32, shape: Shape) -> Result<(), CommandError> {
    let id = ShapeId(id);
    scene.apply(&Command::AddShape { id, shape })
}

fn at(position: Vec3) -> BodyState {
    let upright = [0.0, 0.0, 0.0, 1.0];
    BodyState::new(position.to_array(), upright, [0.0; 3], [0.0; 3]).expect(VALID)
}

fn add(scene: &mut Scene, desc: BodyDesc, position: Vec3) -> Result<(), CommandError> {
    let motion = at(position);
    scene.apply(&Command::AddBody { desc, motion })
}

/// A scene with a fixed body of a shape at the origin, and a body of another shape above it.
fn above(ground: Shape, falling: Shape, height: f32) -> Scene {
    let mut scene = scene();
    add_shape(&mut scene, 0, ground).expect(VALID);
    add_shape(&mut scene, 1, falling).expect(VALID);
    let under = BodyDesc::plain(GROUND, BodyKind::Fixed, ShapeId(0));
    add(&mut scene, under, Vec3::ZERO).expect(VALID);
    let ball = BodyDesc::plain(BALL, BodyKind::Dynamic, ShapeId(1));
    add(&mut scene, ball, Vec3::Y * height).expect(VALID);
    scene
}

fn floor() -> Shape {
    Shape::cuboid(10.0, 1.0, 10.0)
}

fn step(scene: &mut Scene, steps: u32) {
    for _ in 0..steps {
        scene.step().expect(VALID);
    }
}

fn position(scene: &Scene, id: BodyId) -> Vec3 {
    let motion = scene.observation(id).expect(VALID).motion;
    Vec3::from_array(motion.position())
}

/// The field between −4 and 4 m, level at height zero.
fn level() -> Shape {
    let heights = Heights::new(9, 1.0, 1.0, &[0.0; 81]).expect(VALID);
    let part = Part {
        position: Vec3::new(-4.0, 0.0, -4.0),
        rotation: Quat::IDENTITY,
        shape: Shape::Heights(heights),
    };
    Shape::Compound(Compound::new(vec![part]).expect(VALID))
}

/// A square of 10 m around the origin, of two triangles that face up.
fn square() -> Shape {
    let corners = [[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]];
    let points = corners.map(|[x, z]| Vec3::new(x, 0.0, z));
    Shape::Mesh(Mesh::new(&points, &[[0, 2, 1], [0, 3, 2]]).expect(VALID))
}

#[test]
fn shapes_come_to_rest_on_grounds_of_each_kind_and_fall_asleep() {
    for (ground, top) in [(floor(), 1.0), (level(), 0.0), (square(), 0.0)] {
        for (falling, half) in [
            (Shape::ball(0.5), 0.5),
            (Shape::cuboid(0.5, 0.25, 0.5), 0.25),
            (Shape::cylinder(0.3, 0.5), 0.3),
            (Shape::cone(0.4, 0.5), 0.2),
        ] {
            let name = format!("{falling:?} on {ground:?}");
            let mut scene = above(ground.clone(), falling, top + half + 0.2);
            step(&mut scene, 300);
            let height = position(&scene, BALL).y - top;
            assert!((height - half).abs() < 0.02, "{name}: {height}");
            let observed = scene.observation(BALL).expect(VALID);
            assert_eq!(observed.activity, Activity::Asleep, "{name}");
            assert_eq!(scene.awake_count(), 0, "{name}");
        }
    }
}

#[test]
fn a_body_that_falls_asleep_with_another_is_observed_where_it_stays() {
    let mut scene = above(floor(), Shape::cuboid(0.5, 0.25, 0.5), 1.25);
    let upper = BodyId::new(2, 0);
    let desc = BodyDesc::plain(upper, BodyKind::Dynamic, ShapeId(1));
    add(&mut scene, desc, Vec3::Y * 1.75).expect(VALID);
    for id in [BALL, upper] {
        let (linear, angular) = (Vec3::X * 3.0, Vec3::ZERO);
        let moves = Command::SetVelocity {
            id,
            linear,
            angular,
        };
        scene.apply(&moves).expect(VALID);
    }
    step(&mut scene, 5);
    assert_eq!(scene.awake_count(), 2, "both slide");
    scene.apply(&Command::Sleep { id: BALL }).expect(VALID);
    step(&mut scene, 1);
    assert_eq!(scene.awake_count(), 0);
    for id in [BALL, upper] {
        let observed = scene.observations().iter().find(|seen| seen.id == id);
        assert_eq!(
            observed.map(|seen| seen.activity),
            Some(Activity::Asleep),
            "{id}"
        );
    }
}

#[test]
fn parts_that_it_lacks_are_refused_and_change_nothing() {
    let mut scene = above(floor(), Shape::ball(0.5), 3.0);
    let rounded = Shape::RoundedCuboid {
        half_extents: Vec3::ONE,
        radius: 0.1,
    };
    let part = Part {
        position: Vec3::ZERO,
        rotation: Quat::IDENTITY,
        shape: rounded.clone(),
    };
    let compound = Compound::new(vec![part]).expect(VALID);
    let plane = Shape::HalfSpace { normal: Vec3::Y };
    for shape in [rounded, plane, Shape::Compound(compound)] {
        let refused = add_shape(&mut scene, 2, shape);
        assert_eq!(refused, Err(CommandError::Unsupported));
    }
    let plain = BodyDesc::plain(BodyId::new(2, 0), BodyKind::Dynamic, ShapeId(1));
    let heavy = BodyDesc {
        dominance: 1,
        ..plain
    };
    let still = BodyDesc {
        gyroscopic: false,
        ..plain
    };
    for desc in [heavy, still] {
        let refused = add(&mut scene, desc, Vec3::Y * 9.0);
        assert_eq!(refused, Err(CommandError::Unsupported));
    }
    let spring = Spring {
        length: 1.0,
        stiffness: 10.0,
        damping: 1.0,
    };
    let frames = [JointFrame::at(Vec3::ZERO); 2];
    let joint = Joint::plain(JointKind::Spring(spring), [GROUND, BALL], frames);
    let refused = scene.apply(&Command::AddJoint {
        id: JointId(0),
        joint: joint.into(),
    });
    assert_eq!(refused, Err(CommandError::Unsupported));
    assert_eq!(scene.bodies().count(), 2);
    // The number is still free.
    assert_eq!(add_shape(&mut scene, 2, Shape::ball(1.0)), Ok(()));
}

#[test]
fn equal_commands_give_equal_bits_beside_another_world() {
    let run = |beside: bool| {
        let mut script = BallPit::new(60, 1, 7);
        let config = script.config();
        let engine = Box3dEngine::new(&config).expect(VALID);
        let mut scene = Scene::with_engine(config, Box::new(engine)).expect(VALID);
        let mut other = beside.then(|| above(floor(), Shape::ball(0.5), 5.0));
        let mut commands = Vec::new();
        for _ in 0..240 {
            commands.clear();
            script.commands(scene.tick(), &mut commands);
            for command in &commands {
                scene.apply(command).expect("the engine has such a part");
            }
            scene.step().expect(VALID);
            if let Some(other) = &mut other {
                step(other, 1);
            }
        }
        scene.digest()
    };
    assert_eq!(run(false), run(true));
}

#[test]
fn a_kinematic_body_keeps_its_velocity_and_carries_what_lies_on_it() {
    let mut scene = above(floor(), Shape::ball(0.5), 30.0);
    let lift = BodyId::new(2, 0);
    add_shape(&mut scene, 2, Shape::cuboid(2.0, 0.5, 2.0)).expect(VALID);
    let desc = BodyDesc::plain(lift, BodyKind::Kinematic, ShapeId(2));
    add(&mut scene, desc, Vec3::Y * 3.0).expect(VALID);
    scene
        .apply(&Command::SetPose {
            id: BALL,
            position: Vec3::Y * 4.05,
            rotation: Quat::IDENTITY,
        })
        .expect(VALID);
    scene
        .apply(&Command::SetVelocity {
            id: lift,
            linear: Vec3::Y,
            angular: Vec3::ZERO,
        })
        .expect(VALID);
    step(&mut scene, 120);
    let (carried, carrier) = (position(&scene, BALL).y, position(&scene, lift).y);
    assert!((carrier - 5.0).abs() < 1e-4, "{carrier}");
    assert!((carried - carrier - 1.0).abs() < 0.05, "{carried}");
    let velocity = scene.observation(lift).expect(VALID).motion.parts()[8];
    assert_eq!(velocity, 1.0);
}

#[test]
fn joints_hold_break_and_let_go() {
    let mut scene = above(Shape::ball(0.5), Shape::ball(0.5), -2.0);
    let frames = [JointFrame::at(Vec3::Y * -2.0), JointFrame::at(Vec3::ZERO)];
    let mut joint = Joint::plain(JointKind::Fixed, [GROUND, BALL], frames);
    let id = JointId(0);
    scene
        .apply(&Command::AddJoint {
            id,
            joint: joint.into(),
        })
        .expect(VALID);
    step(&mut scene, 60);
    let held = position(&scene, BALL).y;
    assert!((held + 2.0).abs() < 0.05, "{held}");
    joint.strength = Some(JointStrength {
        force: 100.0,
        torque: 1e9,
    });
    scene
        .apply(&Command::ChangeJoint {
            id,
            joint: joint.into(),
        })
        .expect(VALID);
    step(&mut scene, 60);
    assert_eq!(scene.joints().len(), 0, "half a ton is more than 100 N");
    assert!(position(&scene, BALL).y < -5.0);
}

#[test]
fn queries_contacts_and_sensors_find_bodies() {
    let mut scene = above(floor(), Shape::ball(0.5), 1.6);
    let zone = BodyId::new(2, 0);
    let desc = BodyDesc {
        sensor: true,
        ..BodyDesc::plain(zone, BodyKind::Fixed, ShapeId(0))
    };
    add(&mut scene, desc, Vec3::Y * 2.0).expect(VALID);
    let events = ActiveEvents {
        contacts: true,
        sensors: true,
        ..ActiveEvents::NONE
    };
    let id = BALL;
    scene
        .apply(&Command::SetEvents { id, events })
        .expect(VALID);
    let mut happened = Vec::new();
    for _ in 0..60 {
        happened.extend(scene.step().expect(VALID).happened.events);
    }
    let began = |event: &&BodyEvent| matches!(event, BodyEvent::ContactBegan { .. });
    let entered = |event: &&BodyEvent| !began(event);
    assert_eq!(happened.iter().filter(began).count(), 1, "{happened:?}");
    assert_eq!(happened.iter().filter(entered).count(), 1, "{happened:?}");
    let down = Query::ray(Vec3::Y * 10.0, Vec3::Y * -20.0).finding(8);
    let answers = scene.query(&[down]).expect(VALID);
    let [Answer::Hits(hits)] = &answers[..] else {
        panic!("{answers:?}");
    };
    let found: Vec<_> = hits.iter().map(|hit| hit.body).collect();
    assert_eq!(found, [BALL, GROUND]);
    assert!((hits[0].distance - 8.0).abs() < 0.02, "{hits:?}");
}

/// A server, a session that commands the pit, and one that has the truth.
struct Served {
    server: SceneRouter,
    sessions: Vec<ClientSession>,
    /// Of all packets to the first session.
    bytes: u64,
}

impl Served {
    fn new(kind: EngineKind) -> Self {
        let server = SceneRouter::new(SceneSettings {
            engines: Engines::of(kind),
            ..SceneSettings::new(|| Instant::ZERO)
        });
        Self {
            server,
            sessions: Vec::new(),
            bytes: 0,
        }
    }

    fn join(&mut self, config: Option<SceneConfig>, choice: StreamChoice) {
        let place = self.sessions.len();
        let mut session = ClientSession::new("pit".parse().expect(VALID));
        self.server.handle_opened(Instant::ZERO, Peer(place as u64));
        session.handle_opened(Instant::ZERO, Peer(0));
        self.sessions.push(session);
        self.deliver();
        if let Some(config) = config {
            self.sessions[place].create(config).expect(VALID);
        }
        self.sessions[place].join(choice).expect(VALID);
        self.deliver();
    }

    /// Delivers until nothing is left to send.
    fn deliver(&mut self) {
        let now = Instant::ZERO;
        let mut quiet = false;
        while !quiet {
            quiet = true;
            while let Some(transmit) = self.server.poll_transmit() {
                quiet = false;
                match transmit {
                    Transmit::Control { to, bytes } => {
                        self.sessions[to.0 as usize].handle_control(now, Peer(0), &bytes);
                    }
                    Transmit::State { to, bytes } => {
                        if to == Peer(0) {
                            self.bytes += bytes.len() as u64;
                        }
                        self.sessions[to.0 as usize].handle_datagram(now, Peer(0), &bytes);
                    }
                    Transmit::Close { code, .. } => panic!("the server closes with {code}"),
                }
            }
            for (place, session) in self.sessions.iter_mut().enumerate() {
                let from = Peer(place as u64);
                while let Some(transmit) = session.poll_transmit() {
                    quiet = false;
                    match transmit {
                        Transmit::Control { bytes, .. } => {
                            self.server.handle_control(now, from, &bytes);
                        }
                        Transmit::State { bytes, .. } => {
                            self.server.handle_datagram(now, from, &bytes);
                        }
                        Transmit::Close { code, .. } => panic!("a session closes with {code}"),
                    }
                }
            }
            self.server.handle_timeout(now);
        }
    }

    /// The worst error of the first session at a tick, as a share of its tolerance.
    fn worst(&self, tick: Tick) -> f64 {
        let [copy, truth] = [0, 1].map(|place| self.sessions[place].replica().expect(VALID));
        let shares = truth.bodies().map(|desc| {
            let [is, shown] = [truth, copy].map(|replica| {
                let motion = replica.stream().predicted_motion(desc.id, tick);
                motion.expect("both have the body").pose()
            });
            let shape = truth.shape(desc.shape).expect(VALID);
            let tolerance = copy.stream().tolerance_of(desc.id).expect(VALID);
            tolerance.share(&Divergence::between(&is, &shown), shape.bounding_radius())
        });
        shares.fold(0.0, f64::max)
    }
}

/// The pit after 30 s: bytes of packets to the copy, the worst error as a share of the tolerance, and the balls that
/// rest and that there are.
fn run_pit(kind: EngineKind) -> (u64, f64, usize, usize) {
    let mut script = BallPit::new(500, 1, 1);
    let mut served = Served::new(kind);
    let within = StreamChoice::Within(Tolerance::NORMAL);
    served.join(Some(script.config()), within);
    served.join(None, StreamChoice::Full);
    let (mut commands, mut worst) = (Vec::new(), 0.0_f64);
    for tick in 0..1_800 {
        script.commands(Tick::new(tick), &mut commands);
        for command in commands.drain(..) {
            served.sessions[0].command(command).expect(VALID);
        }
        let to = Tick::new(tick + 1);
        served.sessions[0].advance(Instant::ZERO, to).expect(VALID);
        served.deliver();
        while let Some(event) = served.sessions[0].poll_event() {
            assert!(!matches!(event, Event::Refused { .. }), "{event:?}");
        }
        worst = worst.max(served.worst(to));
    }
    let replica = served.sessions[0].replica().expect(VALID);
    let stream = replica.stream();
    assert_eq!(stream.statistics().mismatches, 0);
    let is_ball = |desc: &BodyDesc| desc.kind == BodyKind::Dynamic;
    let rests = |desc: &BodyDesc| {
        let track = stream.track(desc.id);
        track.is_some_and(|track| track.is_exact_rest())
    };
    let balls = replica.bodies().filter(is_ball);
    let resting = replica.bodies().filter(is_ball).filter(rests);
    (served.bytes, worst, resting.count(), balls.count())
}

#[test]
fn the_pit_of_500_balls_is_within_its_tolerance_at_every_tick_and_falls_asleep() {
    for kind in [EngineKind::Rapier, EngineKind::Box3d] {
        let (bytes, worst, resting, balls) = run_pit(kind);
        println!(
            "{kind}: {bytes} B in 30 s, {worst:.3} of the tolerance, {resting} of {balls} rest"
        );
        assert!(worst > 0.1 && worst <= 1.0, "{kind}: {worst}");
        assert!(balls > 300, "{kind}: {balls}");
        assert!(resting * 2 > balls, "{kind}: {resting} of {balls}");
    }
}

#[test]
fn a_push_acts_whole_or_is_refused() {
    let mut scene = scene();
    scene
        .apply(&Command::SetGravity {
            gravity: Vec3::ZERO,
        })
        .expect(VALID);
    add_shape(&mut scene, 0, Shape::cuboid(0.2, 0.2, 0.2)).expect(VALID);
    let mut desc = BodyDesc::plain(BALL, BodyKind::Dynamic, ShapeId(0));
    let moments = None;
    desc.mass = Some(Mass { mass: 1.0, moments });
    add(&mut scene, desc, Vec3::ZERO).expect(VALID);
    let id = BALL;
    let impulse = |x: f32| Command::Impulse {
        id,
        impulse: Vec3::X * x,
    };
    let force = |x: f32| Command::Force {
        id,
        force: Vec3::X * x * 60.0,
    };
    let twist = |y: f32| Command::TorqueImpulse {
        id,
        impulse: Vec3::Y * y,
    };
    let refused = |quantity| Err(CommandError::Invalid(Invalid::out_of_range(quantity)));
    let linear = refused(Quantity::Linear);
    assert_eq!(scene.apply(&impulse(500.0)), Ok(()));
    assert_eq!(scene.apply(&force(450.0)), Ok(()));
    assert_eq!(scene.apply(&force(450.0)), linear);
    assert_eq!(scene.apply(&impulse(450.0)), linear);
    assert_eq!(scene.apply(&twist(5.0)), refused(Quantity::Angular));
    assert_eq!(scene.apply(&twist(2.5)), Ok(()));
    step(&mut scene, 1);
    let parts = scene.observation(BALL).expect(VALID).motion.parts();
    let (speed, spin) = (parts[7], parts[11]);
    assert!((speed - 950.0).abs() < 0.1, "{speed} m/s");
    assert!((spin - 2.5 / (0.16 / 6.0)).abs() < 0.1, "{spin} rad/s");
    assert_eq!(scene.apply(&force(450.0)), linear);
    assert_eq!(scene.apply(&impulse(-1_900.0)), Ok(()));
}
