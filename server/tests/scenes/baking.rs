//! Solids of large shapes are made beside the steps of a scene.
//!
//! The jobs are held here, and run when a test wants it: ticks and other clients continue meanwhile, and the client's own
//! messages keep their order. Caught: large meshes stopped the steps for 40 to 98 ms each.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use glam::Vec3;
use rhumb_protocol::limits::TRIANGLES_MAX;
use rhumb_protocol::message::{
    ClientMessage, Extensions, Frames, Role, SceneEvent, ServerMessage, StreamChoice, VERSIONS,
};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, CommandError, IdRange, Mesh, SceneConfig, Shape, ShapeId, Stepping,
};
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit};
use rhumb_reckoning::{BodyId, BodyState, Tick, Tolerance};
use rhumb_scene::{BakeJob, Bakers, Permit, Scene, SceneRouter, SceneSettings};

const OWNER: Peer = Peer(1);
const OTHER: Peer = Peer(2);
const THIRD: Peer = Peer(3);

/// A server whose solids are made when the test says so.
struct Bench {
    server: SceneRouter,
    now: Instant,
    jobs: Arc<Mutex<Vec<BakeJob>>>,
    received: BTreeMap<Peer, (Frames, Vec<ServerMessage>)>,
}

impl Bench {
    fn new() -> Self {
        let jobs: Arc<Mutex<Vec<BakeJob>>> = Arc::default();
        let taken = Arc::clone(&jobs);
        let bakers = Bakers::new(move |job| {
            taken.lock().expect("no test panics here").push(job);
        });
        let server = SceneRouter::new(SceneSettings {
            bakers,
            ..SceneSettings::new(|| Instant::ZERO)
        });
        Self {
            server,
            now: Instant::ZERO,
            jobs,
            received: BTreeMap::new(),
        }
    }

    /// A scene that the owner has created, with these members.
    fn with_scene(stepping: Stepping, members: &[Peer]) -> Self {
        let mut bench = Self::new();
        let config = SceneConfig {
            stepping,
            ..SceneConfig::default()
        };
        for peer in members {
            let create = (*peer == OWNER).then_some(ClientMessage::Create(config));
            bench.open(*peer, Permit::OPEN, create);
        }
        bench
    }

    /// Opens the connection of a client, which joins the scene.
    fn open(&mut self, peer: Peer, permit: Permit, create: Option<ClientMessage>) {
        self.received.insert(peer, Default::default());
        self.server.handle_opened(self.now, peer);
        self.server.admit(peer, Arc::new(permit));
        // The driver reports what the link takes, as the real one does.
        self.server.handle_control_taken(self.now, peer, 0);
        let hello = ClientMessage::Hello {
            versions: VERSIONS.to_vec(),
            scene: "baked".parse().expect("a good name"),
            extensions: Extensions::NONE,
        };
        let join = ClientMessage::Join(StreamChoice::Within(Tolerance::NORMAL));
        let messages: Vec<_> = [Some(hello), create, Some(join)]
            .into_iter()
            .flatten()
            .collect();
        self.send(peer, &messages);
    }

    fn send(&mut self, peer: Peer, messages: &[ClientMessage]) {
        let mut bytes = Vec::new();
        for message in messages {
            message.encode(&mut bytes);
        }
        self.server.handle_control(self.now, peer, &bytes);
        self.collect();
    }

    fn command(&mut self, peer: Peer, commands: impl IntoIterator<Item = Command>) {
        let messages: Vec<_> = commands.into_iter().map(ClientMessage::Command).collect();
        self.send(peer, &messages);
    }

    fn collect(&mut self) {
        while let Some(transmit) = self.server.poll_transmit() {
            if let Transmit::Control { to, bytes } = transmit {
                self.server.handle_control_taken(self.now, to, bytes.len());
                let (frames, messages) = self.received.get_mut(&to).expect("a connection");
                frames.push(&bytes);
                while let Some(frame) = frames.next_frame().expect("whole messages") {
                    let message = ServerMessage::decode(&frame).expect("the server's own");
                    messages.extend(message);
                }
            }
        }
    }

    /// Lets time pass, a millisecond at a time.
    fn pass(&mut self, ms: u64) {
        for _ in 0..ms {
            self.now = self.now + Span::from_millis(1);
            while self
                .server
                .poll_timeout()
                .is_some_and(|wake| wake.at <= self.now)
            {
                self.server.handle_timeout(self.now);
                self.collect();
            }
        }
    }

    /// Makes the solids that wait; returns their number.
    fn bake(&mut self) -> usize {
        let jobs = std::mem::take(&mut *self.jobs.lock().expect("no test panics here"));
        let count = jobs.len();
        jobs.into_iter().for_each(BakeJob::run);
        count
    }

    fn waiting(&self) -> usize {
        self.jobs.lock().expect("no test panics here").len()
    }

    /// The messages that a client has received since the last call.
    fn take(&mut self, peer: Peer) -> Vec<ServerMessage> {
        std::mem::take(&mut self.received.get_mut(&peer).expect("a connection").1)
    }

    fn granted(&mut self, peer: Peer) -> IdRange {
        let granted = self
            .take(peer)
            .into_iter()
            .find_map(|message| match message {
                ServerMessage::Joined(joined) => Some(joined.granted),
                _ => None,
            });
        granted.expect("a member")
    }

    /// The newest tick, as a client that asks for it learns it.
    fn tick(&mut self, peer: Peer) -> Tick {
        let sent = self.now;
        self.send(peer, &[ClientMessage::Ping { sent }]);
        let pong = self
            .take(peer)
            .into_iter()
            .find_map(|message| match message {
                ServerMessage::Pong { tick, .. } => Some(tick),
                _ => None,
            });
        pong.expect("an answer")
    }
}

/// A rolling sheet of the greatest number of triangles.
fn largest() -> Shape {
    let mesh = sheet(181);
    let triangles = mesh.triangles().len();
    assert!(triangles > TRIANGLES_MAX - 100 && triangles <= TRIANGLES_MAX);
    Shape::Mesh(mesh)
}

/// A rolling sheet of so many squares on a side, each of two triangles.
fn sheet(side: u32) -> Mesh {
    let points: Vec<_> = (0..=side)
        .flat_map(|x| (0..=side).map(move |z| (x as f32, z as f32)))
        .map(|(x, z)| Vec3::new(x - 90.0, (x * 0.3).sin() + (z * 0.2).cos(), z - 90.0))
        .collect();
    let corner = |x: u32, z: u32| x * (side + 1) + z;
    let triangles: Vec<_> = (0..side)
        .flat_map(|x| (0..side).map(move |z| (x, z)))
        .flat_map(|(x, z)| {
            let [a, b] = [corner(x, z), corner(x + 1, z)];
            [[a, a + 1, b], [b, a + 1, b + 1]]
        })
        .collect();
    Mesh::new(&points, &triangles).expect("within the limits")
}

fn add(id: u32, shape: Shape) -> Command {
    let id = ShapeId(id);
    Command::AddShape { id, shape }
}

fn body(index: u32, kind: BodyKind, shape: u32, height: f32) -> Command {
    let at = [0.3, height, 0.2];
    let motion = BodyState::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
    Command::AddBody {
        desc: BodyDesc::plain(BodyId::new(index, 0), kind, ShapeId(shape)),
        motion: motion.expect("finite"),
    }
}

/// The scene events of some messages, in short.
fn events(messages: &[ServerMessage]) -> Vec<String> {
    let events = messages.iter().filter_map(|message| match message {
        ServerMessage::SceneEvent(SceneEvent::ShapeAdded { id, .. }) => {
            Some(format!("shape {}", id.0))
        }
        ServerMessage::SceneEvent(SceneEvent::BodyPlaced { desc, .. }) => {
            Some(format!("body of shape {}", desc.shape.0))
        }
        ServerMessage::SceneEvent(SceneEvent::GravityChanged { .. }) => Some("gravity".to_owned()),
        _ => None,
    });
    events.collect()
}

#[test]
fn ticks_and_other_clients_go_on_while_a_mesh_is_made_and_its_client_keeps_its_order() {
    let mut bench = Bench::with_scene(Stepping::FreeRunning, &[OWNER, OTHER]);
    let first = bench.granted(OWNER).first();
    let before = bench.tick(OTHER);
    let gravity = Vec3::new(0.0, -5.0, 0.0);
    let later = [
        add(1, largest()),
        body(first, BodyKind::Fixed, 1, 0.0),
        Command::SetGravity { gravity },
    ];
    bench.command(OWNER, later);
    for _ in 0..9 {
        bench.pass(100);
        assert_eq!(bench.waiting(), 1);
    }
    let during = bench.tick(OTHER);
    assert_eq!(during.value() - before.value(), 54, "0.9 s at 60 Hz");
    bench.command(OTHER, [add(2, Shape::ball(0.5))]);
    assert_eq!(
        events(&bench.take(OTHER)),
        ["shape 2"],
        "another client does not wait"
    );
    assert_eq!(events(&bench.take(OWNER)), ["shape 2"]);
    assert_eq!(bench.bake(), 1);
    bench.pass(30);
    let order = ["shape 1", "body of shape 1", "gravity"];
    assert_eq!(events(&bench.take(OTHER)), order);
    let answers = bench.take(OWNER);
    assert_eq!(events(&answers), order);
    let applied = answers.iter().rev().find_map(|message| match message {
        ServerMessage::Applied { through, tick } => Some((*through, *tick)),
        _ => None,
    });
    let (through, tick) = applied.expect("the client learns when its commands act");
    assert_eq!(through, 2);
    assert!(tick >= during);
}

#[test]
fn a_solid_that_takes_too_long_is_refused_with_the_limit() {
    let mut bench = Bench::with_scene(Stepping::FreeRunning, &[OWNER, OTHER]);
    let first = bench.granted(OWNER).first();
    bench.command(
        OWNER,
        [add(1, largest()), body(first, BodyKind::Fixed, 1, 0.0)],
    );
    bench.pass(990);
    assert_eq!(bench.take(OWNER), []);
    bench.pass(40);
    let refused: Vec<_> = bench
        .take(OWNER)
        .into_iter()
        .filter_map(|message| match message {
            ServerMessage::Refused { number, error } => Some((number, error)),
            _ => None,
        })
        .collect();
    let too_slow = CommandError::ShapeTooSlow { limit_ms: 1_000 };
    let unknown = CommandError::UnknownShape(ShapeId(1));
    assert_eq!(refused, [(0, too_slow), (1, unknown)]);
    // The solid comes after all: it belongs to no shape.
    assert_eq!(bench.bake(), 1);
    bench.pass(30);
    assert_eq!(events(&bench.take(OTHER)), [] as [&str; 0]);
    bench.command(OWNER, [add(1, largest())]);
    assert_eq!(bench.bake(), 1);
    bench.pass(30);
    assert_eq!(events(&bench.take(OTHER)), ["shape 1"]);
}

#[test]
fn a_solid_that_waits_for_two_that_never_end_is_refused_too() {
    let mut bench = Bench::with_scene(Stepping::FreeRunning, &[OWNER, OTHER, THIRD]);
    for (id, peer) in [OWNER, OTHER, THIRD].into_iter().enumerate() {
        bench.command(peer, [add(id as u32, largest())]);
    }
    let refused = |messages: Vec<ServerMessage>| {
        let error = messages.into_iter().find_map(|message| match message {
            ServerMessage::Refused { error, .. } => Some(error),
            _ => None,
        });
        error.is_some_and(|error| error == CommandError::ShapeTooSlow { limit_ms: 1_000 })
    };
    bench.pass(1_040);
    let waiting = bench.take(THIRD);
    assert!(refused(waiting), "it waited as long as it might have taken");
    // The next one waits anew, and is made when the two have ended after all.
    bench.command(THIRD, [add(7, largest())]);
    bench.pass(500);
    assert_eq!(bench.waiting(), 2);
    assert_eq!(bench.bake(), 2);
    bench.pass(100);
    assert_eq!(bench.bake(), 1);
    bench.pass(30);
    assert!(events(&bench.take(THIRD)).contains(&"shape 7".to_owned()));
}

#[test]
fn two_solids_are_made_at_one_time_and_a_third_waits() {
    let mut bench = Bench::with_scene(Stepping::FreeRunning, &[OWNER, OTHER, THIRD]);
    for (id, peer) in [OWNER, OTHER, THIRD].into_iter().enumerate() {
        bench.command(peer, [add(id as u32, largest())]);
    }
    bench.pass(100);
    assert_eq!(bench.bake(), 2);
    bench.pass(100);
    assert_eq!(bench.bake(), 1);
    bench.pass(30);
    assert_eq!(
        events(&bench.take(OWNER)),
        ["shape 0", "shape 1", "shape 2"]
    );
}

#[test]
fn the_solid_that_waits_longest_is_begun_next() {
    let mut bench = Bench::with_scene(Stepping::FreeRunning, &[OWNER, OTHER, THIRD]);
    // The least that is made beside the steps: 1,152 triangles.
    let small = |id| add(id, Shape::Mesh(sheet(24)));
    bench.command(OWNER, [small(0), small(1), small(2)]);
    bench.command(OTHER, [small(10), small(11), small(12)]);
    bench.command(THIRD, [small(20)]);
    bench.pass(30);
    assert_eq!(bench.bake(), 2);
    bench.pass(30);
    assert_eq!(bench.bake(), 2, "the third one's is among them");
    bench.pass(30);
    assert!(events(&bench.take(THIRD)).contains(&"shape 20".to_owned()));
}

#[test]
fn the_solid_of_a_refused_shape_is_not_given_to_the_next_one() {
    let mut bench = Bench::with_scene(Stepping::FreeRunning, &[OWNER, OTHER]);
    bench.command(OWNER, [add(5, largest())]);
    bench.command(OTHER, [add(5, Shape::ball(0.5))]);
    assert_eq!(bench.bake(), 1);
    bench.pass(30);
    let refused = bench
        .take(OWNER)
        .into_iter()
        .find_map(|message| match message {
            ServerMessage::Refused { error, .. } => Some(error),
            _ => None,
        });
    assert_eq!(refused, Some(CommandError::ShapeIdTaken(ShapeId(5))));
    bench.command(OWNER, [add(6, largest())]);
    assert_eq!(bench.waiting(), 1, "a solid of its own is made");
}

#[test]
fn no_solid_is_made_for_a_client_that_has_its_share_of_shapes() {
    let mut bench = Bench::with_scene(Stepping::FreeRunning, &[OWNER]);
    let permit = Permit {
        client: Some("anna".into()),
        role: Role::Controller,
        ..Permit::OPEN
    };
    bench.open(OTHER, permit, None);
    // Three of them fit in half of a scene's bytes.
    for id in 0..3 {
        bench.command(OTHER, [add(id, largest())]);
        assert_eq!(bench.bake(), 1);
        bench.pass(30);
    }
    bench.take(OTHER);
    bench.command(OTHER, [add(3, largest())]);
    assert_eq!(bench.waiting(), 0, "it is refused anyway");
    bench.pass(30);
    let refused = bench
        .take(OTHER)
        .into_iter()
        .find_map(|message| match message {
            ServerMessage::Refused { error, .. } => Some(error),
            _ => None,
        });
    assert_eq!(refused, Some(CommandError::OverQuota));
}

#[test]
fn what_follows_an_unmade_solid_ends_with_its_connection() {
    let mut bench = Bench::with_scene(Stepping::FreeRunning, &[OWNER, OTHER]);
    let first = bench.granted(OWNER).first();
    let ball = add(0, Shape::ball(0.5));
    let rest = [
        ball,
        add(1, largest()),
        body(first, BodyKind::Dynamic, 0, 3.0),
    ];
    bench.command(OWNER, rest);
    bench
        .server
        .handle_ended(bench.now, OWNER, Ending::TimedOut);
    bench.collect();
    bench.bake();
    bench.pass(100);
    assert_eq!(events(&bench.take(OTHER)), ["shape 0"]);
    assert!(bench.tick(OTHER) >= Tick::new(5), "the scene continues");
}

#[test]
fn a_solid_that_was_made_beside_the_steps_changes_no_bit() {
    let mut bench = Bench::with_scene(Stepping::Lockstep, &[OWNER, OTHER]);
    let first = bench.granted(OWNER).first();
    let mut truth = Scene::new(SceneConfig::default()).expect("valid");
    let before = [
        add(0, Shape::ball(0.5)),
        body(first, BodyKind::Dynamic, 0, 30.0),
    ];
    let after = [add(1, largest()), body(first + 1, BodyKind::Fixed, 1, 0.0)];
    bench.command(OWNER, before.clone());
    before
        .iter()
        .for_each(|command| truth.apply(command).expect("valid"));
    let advance = |to: u64| ClientMessage::Advance { to: Tick::new(to) };
    bench.send(OWNER, &[advance(10)]);
    bench.pass(10);
    (0..10).for_each(|_| drop(truth.step().expect("it steps")));
    bench.command(OWNER, after.clone());
    bench.send(OWNER, &[advance(200)]);
    bench.pass(100);
    assert_eq!(
        bench.tick(OTHER),
        Tick::new(10),
        "the client's advance waits for its mesh"
    );
    assert_eq!(bench.bake(), 1);
    bench.pass(300);
    after
        .iter()
        .for_each(|command| truth.apply(command).expect("valid"));
    (10..200).for_each(|_| drop(truth.step().expect("it steps")));
    bench.send(OWNER, &[ClientMessage::Inspect]);
    let inspection = bench
        .take(OWNER)
        .into_iter()
        .find_map(|message| match message {
            ServerMessage::Inspection(inspection) => Some(inspection),
            _ => None,
        });
    let inspection = inspection.expect("an answer");
    assert_eq!(inspection.tick, Tick::new(200));
    assert_eq!(inspection.truth, truth.digest().value());
}
