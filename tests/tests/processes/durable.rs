//! Servers with a data directory that are killed under load.
//!
//! A client resumes its session, under the certificate that the directory keeps. Its run is a function of the tick,
//! so that the same run can be made without a server: equal digests mean that no command was lost, doubled or moved to
//! another tick. `KILLS` sets how often the server is killed, `BODIES` the size of the scene, `SEED` the moments.

use std::fs;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use glam::Vec3;
use rhumb_client::scene::{
    Answer, BodyDesc, BodyKind, Command, CommandError, Heights, Mesh, Query, SceneConfig, Shape,
    ShapeId, Stepping,
};
use rhumb_client::{
    Client, ClientError, Event, JoinMode, JoinOptions, PipelineDepth, Refusals, Tick, Tolerance,
    Trust,
};
use rhumb_protocol::message::Inspection;
use rhumb_reckoning::{BodyId, BodyState, Damping};
use rhumb_scene::Scene;
use rhumb_tests::{Ended, ServerProcess};

use crate::SERVER;

const SCENE: &str = "pit";
/// Half the floor's width, metres: no ball leaves it in some hundred thousand ticks. A command to one that left the world
/// would be refused.
const FLOOR: f32 = 4_000.0;
/// Time for an answer of a server that starts on a loaded machine.
pub(crate) const LONG: Duration = Duration::from_secs(60);
/// Bodies that are added one by one, every tenth tick.
const LATER: u64 = 200;

/// A number of the environment.
pub(crate) fn variable(name: &str, default: u64) -> u64 {
    let text = std::env::var(name).ok();
    text.and_then(|text| text.parse().ok()).unwrap_or(default)
}

/// Bodies at first.
fn bodies() -> u64 {
    variable("BODIES", 40)
}

/// The commands before a tick's step.
pub(crate) fn commands(tick: u64, ids: &[BodyId]) -> Vec<Command> {
    let bodies = bodies();
    let mut commands = Vec::new();
    let body = |place: u64, kind, shape| {
        let id = ids[place as usize];
        let height = if place == 0 {
            0.0
        } else {
            1.5 + (place % 30) as f32 * 1.1
        };
        let column = place / 30;
        let position = [
            (column % 8) as f32 * 1.5 + (place % 3) as f32 * 0.3 - 6.0,
            height,
            (column / 8) as f32 * 1.5 + (place % 2) as f32 * 0.3 - 4.0,
        ];
        let motion = BodyState::new(position, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        // A ball that has rolled off the pile comes to rest.
        let damping = Damping {
            linear: 0.0,
            angular: 1.0,
        };
        Command::AddBody {
            desc: BodyDesc {
                damping: Some(damping),
                ..BodyDesc::plain(id, kind, ShapeId(shape))
            },
            motion: motion.expect("finite"),
        }
    };
    if tick == 0 {
        for (id, shape) in [Shape::cuboid(FLOOR, 1.0, FLOOR), Shape::ball(0.5)]
            .into_iter()
            .enumerate()
        {
            let id = ShapeId(id as u32);
            commands.push(Command::AddShape { id, shape });
        }
        commands.push(body(0, BodyKind::Fixed, 0));
        commands.extend((1..bodies).map(|place| body(place, BodyKind::Dynamic, 1)));
    }
    if tick % 10 == 9 && tick / 10 < LATER {
        commands.push(body(bodies + tick / 10, BodyKind::Dynamic, 1));
    }
    let id = ids[(1 + tick % (bodies - 1)) as usize];
    let impulse = Vec3::new((tick % 7) as f32 - 3.0, 4.0, (tick % 5) as f32 - 2.0) * 90.0;
    commands.push(Command::Impulse { id, impulse });
    commands
}

/// The digest of the same run without a server.
pub(crate) fn digest_without_server(ticks: u64, ids: &[BodyId]) -> u64 {
    let mut scene = Scene::new(SceneConfig::default()).expect("the default is valid");
    for tick in 0..ticks {
        for command in commands(tick, ids) {
            scene.apply(&command).expect("a valid command");
        }
        scene.step().expect("the engine is sound");
    }
    scene.digest().value()
}

/// Answers of the server to a client.
#[derive(Default)]
pub(crate) struct Seen {
    pub(crate) resumed: u64,
    /// Commands that are durable.
    pub(crate) durable: u64,
}

pub(crate) fn take_events(client: &mut Client, seen: &mut Seen) {
    while let Some((_, event)) = client.poll_event() {
        match event {
            Event::Resumed(_) => seen.resumed += 1,
            Event::Durable { commands, .. } => seen.durable = seen.durable.max(commands),
            Event::Refused { number, error } => panic!("command {number}: {error}"),
            Event::SessionLost(state) => panic!("the session is lost: {state:?}"),
            _ => {}
        }
    }
}

/// Steps once, however often the server is gone meanwhile.
pub(crate) fn step(client: &mut Client) {
    let begun = Instant::now();
    let mut stepped = client.advance(PipelineDepth::LOCKSTEP);
    while let Err(ClientError::Timeout { .. }) = stepped
        && begun.elapsed() < LONG
    {
        stepped = client.wait(PipelineDepth::LOCKSTEP);
    }
    if let Err(error) = stepped {
        let events: Vec<_> = std::iter::from_fn(|| client.poll_event()).collect();
        panic!("the scene continues: {error}; {events:?}");
    }
}

/// A server with a data directory.
pub(crate) fn serve(listen: &str, data: &Path) -> ServerProcess {
    SERVER.serve_with(listen, &["--data", data.to_str().expect("text")])
}

/// A client that creates the scene, and the ids of all bodies that it will have.
pub(crate) fn create(server: &ServerProcess) -> (Client, Vec<BodyId>) {
    create_at(server.address, server)
}

/// The same by another way to the server.
pub(crate) fn create_at(address: SocketAddr, server: &ServerProcess) -> (Client, Vec<BodyId>) {
    create_at_address(&address.to_string(), server)
}

/// The same by an address in text.
pub(crate) fn create_at_address(address: &str, server: &ServerProcess) -> (Client, Vec<BodyId>) {
    let trust = Trust::Fingerprint(server.fingerprint);
    let options = JoinOptions {
        mode: JoinMode::Create(SceneConfig::default()),
        ..JoinOptions::default()
    };
    let connection = Client::connect(address, trust);
    let connection = connection.expect("the server is there");
    let mut client = connection.join_with(SCENE, options).expect("a new scene");
    let ids = ids_of_the_run(&mut client);
    (client, ids)
}

/// The ids of all bodies that a client's scene will have.
pub(crate) fn ids_of_the_run(client: &mut Client) -> Vec<BodyId> {
    let count = u32::try_from(bodies() + LATER).expect("a number of bodies");
    client.new_ids(count).expect("enough indices")
}

/// Numbers below a limit, from a seed (Knuth's generator).
pub(crate) fn chance(seed: u64) -> impl FnMut(u64) -> u64 {
    let mut state = seed;
    move |below| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % below
    }
}

/// Waits until a condition holds.
pub(crate) fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let end = Instant::now() + LONG;
    while !holds() {
        assert!(Instant::now() < end, "{what}");
        thread::yield_now();
    }
}

/// A client that steps its scene on a thread, with the commands of each tick, until it is stopped.
pub(crate) struct Run {
    stop: Arc<AtomicBool>,
    ticks: Arc<AtomicU64>,
    /// The longest step, nanoseconds.
    slowest: Arc<AtomicU64>,
    thread: JoinHandle<EndedRun>,
    ids: Vec<BodyId>,
}

/// The end of a [`Run`]: its last answer, and its events.
pub(crate) struct EndedRun {
    pub(crate) tick: u64,
    pub(crate) truth: Inspection,
    pub(crate) seen: Seen,
}

impl Run {
    pub(crate) fn start(client: Client, ids: Vec<BodyId>) -> Self {
        Self::counting(client, ids, |_| true)
    }

    /// Counts only the ticks after events of which `counts` is true.
    pub(crate) fn counting(
        mut client: Client,
        ids: Vec<BodyId>,
        counts: impl Fn(&Seen) -> bool + Send + 'static,
    ) -> Self {
        let (stop, ticks) = (Arc::<AtomicBool>::default(), Arc::<AtomicU64>::default());
        let (ended, shown, of_client) = (Arc::clone(&stop), Arc::clone(&ticks), ids.clone());
        let slowest = Arc::<AtomicU64>::default();
        let longest = Arc::clone(&slowest);
        let thread = thread::spawn(move || {
            let (mut seen, mut tick) = (Seen::default(), 0);
            while !ended.load(Ordering::Relaxed) {
                for command in commands(tick, &of_client) {
                    client.command(command).expect("the session continues");
                }
                let begun = Instant::now();
                step(&mut client);
                longest.fetch_max(begun.elapsed().as_nanos() as u64, Ordering::Relaxed);
                take_events(&mut client, &mut seen);
                tick += 1;
                if counts(&seen) {
                    shown.store(tick, Ordering::Relaxed);
                }
            }
            let truth = client.inspect().expect("the server answers");
            EndedRun { tick, truth, seen }
        });
        Self {
            stop,
            ticks,
            slowest,
            thread,
            ids,
        }
    }

    /// Ticks so far.
    pub(crate) fn ticks(&self) -> u64 {
        self.ticks.load(Ordering::Relaxed)
    }

    /// Waits for so many ticks more; the time that they took.
    pub(crate) fn go(&self, ticks: u64) -> Duration {
        let (begun, from) = (Instant::now(), self.ticks());
        until("the scene continues", || {
            assert!(!self.thread.is_finished(), "the client failed");
            self.ticks() >= from + ticks
        });
        begun.elapsed()
    }

    /// The longest step since the last call.
    pub(crate) fn slowest(&self) -> Duration {
        Duration::from_nanos(self.slowest.swap(0, Ordering::Relaxed))
    }

    /// Ends, and compares the scene with the run without a server.
    pub(crate) fn end(self) -> EndedRun {
        self.stop.store(true, Ordering::Relaxed);
        let ended = self.thread.join().expect("the client's thread");
        assert_eq!(ended.truth.tick, Tick::new(ended.tick));
        let without = digest_without_server(ended.tick, &self.ids);
        assert_eq!(ended.truth.truth, without);
        ended
    }
}

/// Verifies a data directory.
pub(crate) fn check(data: &Path) -> Ended {
    SERVER.run(&["check", data.to_str().expect("text")])
}

#[test]
fn a_server_killed_at_any_moment_loses_and_doubles_no_command() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let data = directory.path().join("data");
    let (kills, seed) = (variable("KILLS", 3), variable("SEED", 1));
    let mut chance = chance(seed);
    let mut server = serve("127.0.0.1:0", &data);
    let (listen, fingerprint) = (server.address.to_string(), server.fingerprint);
    let (client, ids) = create(&server);
    let run = Run::start(client, ids);
    let mut slowest = Duration::ZERO;
    for _ in 0..kills {
        run.go(1 + chance(100));
        // Somewhere within a tick.
        for _ in 0..chance(2_000) {
            thread::yield_now();
        }
        server.kill();
        let killed = Instant::now();
        server = serve(&listen, &data);
        assert_eq!(
            server.fingerprint, fingerprint,
            "clients pin the certificate"
        );
        run.go(2);
        slowest = slowest.max(killed.elapsed());
    }
    let EndedRun { tick, truth, seen } = run.end();
    println!(
        "seed {seed}: {tick} ticks, {} bodies, {kills} kills, {} resumptions, the slowest after {slowest:?}",
        truth.bodies, seen.resumed
    );
    assert!(seen.resumed >= kills.min(1) && seen.durable > 0);
    server.kill();
    let checked = check(&data);
    assert_eq!(checked.code, Some(0), "{}{}", checked.out, checked.log);
    assert!(checked.out.starts_with("pit: tick "), "{}", checked.out);
    let data = data.to_str().expect("text");
    let replayed = SERVER.run(&["replay", data, SCENE]);
    assert_eq!(replayed.code, Some(0), "{}{}", replayed.out, replayed.log);
}

#[test]
fn a_mesh_whose_solid_was_made_beside_the_steps_is_restored_to_the_bit() {
    const SIDE: u32 = 100;
    let directory = tempfile::tempdir().expect("a temporary directory");
    let data = directory.path().join("data");
    let server = serve("127.0.0.1:0", &data);
    let (mut client, _) = create(&server);
    let ball = BodyDesc::dynamic(Shape::ball(0.5)).at(0.2, 6.0, 0.1);
    client.add_body(ball).expect("a body");
    for _ in 0..5 {
        step(&mut client);
    }
    let points: Vec<Vec3> = (0..=SIDE)
        .flat_map(|x| (0..=SIDE).map(move |z| (x as f32, z as f32)))
        .map(|(x, z)| Vec3::new(x - 50.0, (x * 0.4).sin() + (z * 0.3).cos(), z - 50.0))
        .collect();
    let corner = |x: u32, z: u32| x * (SIDE + 1) + z;
    let triangles: Vec<[u32; 3]> = (0..SIDE)
        .flat_map(|x| (0..SIDE).map(move |z| (x, z)))
        .flat_map(|(x, z)| {
            let [a, b] = [corner(x, z), corner(x + 1, z)];
            [[a, a + 1, b], [b, a + 1, b + 1]]
        })
        .collect();
    let mesh = Mesh::new(&points, &triangles).expect("within the limits");
    let ground = client.add_body(BodyDesc::fixed(Shape::Mesh(mesh)));
    ground.expect("a body");
    for _ in 0..150 {
        step(&mut client);
    }
    take_events(&mut client, &mut Seen::default());
    let truth = client.inspect().expect("the server answers");
    assert_eq!(
        (truth.tick, truth.bodies),
        (Tick::new(155), 2),
        "the ball lies on the mesh"
    );
    server.signal("TERM");
    assert_eq!(server.wait().code, Some(0));
    let checked = check(&data);
    let line = format!("tick 155 digest {:016x} bodies 2", truth.truth);
    assert_eq!(checked.code, Some(0), "{}{}", checked.out, checked.log);
    assert!(checked.out.contains(&line), "{line}: {}", checked.out);
}

/// A client with authority over an avatar in a free-running scene, which is durable.
fn walker(server: &ServerProcess) -> (Client, (BodyId, BodyState)) {
    let trust = Trust::Fingerprint(server.fingerprint);
    let connection = Client::connect_within(&server.address.to_string(), trust, LONG);
    let config = SceneConfig {
        stepping: Stepping::FreeRunning,
        ..SceneConfig::default()
    };
    let options = JoinOptions {
        mode: JoinMode::Create(config),
        ..JoinOptions::default()
    };
    let connection = connection.expect("the server is there");
    let mut client = connection.join_with(SCENE, options).expect("a new scene");
    let avatar = BodyDesc::kinematic(Shape::capsule(0.6, 0.3));
    let state = avatar.state().expect("finite");
    let avatar = client.add_body(avatar).expect("a body");
    let taken = client.take_authority(&[avatar], Tolerance::FINE);
    taken.expect("a member may");
    let mut seen = Seen::default();
    while seen.durable < 2 || client.authority_bodies().next().is_none() {
        client.idle(Duration::from_millis(2)).expect("it continues");
        take_events(&mut client, &mut seen);
    }
    (client, (avatar, state))
}

/// Stops a server, and waits until its client has noticed.
fn stop(server: ServerProcess, client: &mut Client) {
    server.signal("TERM");
    assert_eq!(server.wait().code, Some(0));
    let interrupted = |event: &Event| matches!(event, Event::Interrupted(_));
    while !std::iter::from_fn(|| client.poll_event()).any(|(_, event)| interrupted(&event)) {
        client.idle(Duration::from_millis(2)).expect("it tries on");
    }
    // The view stands still, and no bound of what it shows is known.
    let bounds: Vec<_> = client.error_bounds().collect();
    assert_eq!(bounds.len(), client.view().ids().len());
    assert!(bounds.iter().all(|bound| bound.metres().is_infinite()));
    let alone = client.view().ids().iter().map(|id| client.error_bound(*id));
    assert!(alone.eq(bounds.into_iter().map(Some)));
}

#[test]
fn an_avatar_walks_on_when_its_server_comes_back() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let data = directory.path().join("data");
    let server = serve("127.0.0.1:0", &data);
    let listen = server.address.to_string();
    let (mut client, (avatar, state)) = walker(&server);
    stop(server, &mut client);
    let publish = |client: &mut Client| {
        let published = client.publish(&[(avatar, state)]);
        published.expect("the authority is regained")
    };
    assert_eq!(publish(&mut client), None, "no server is there");
    let _server = serve(&listen, &data);
    let end = Instant::now() + LONG;
    while publish(&mut client).is_none() {
        assert!(Instant::now() < end, "the avatar stands");
        client.idle(Duration::from_millis(2)).expect("it continues");
    }
    assert_eq!(client.authority_bodies().collect::<Vec<_>>(), [avatar]);
}

#[test]
fn a_question_waits_for_the_server_to_come_back() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let data = directory.path().join("data");
    let server = serve("127.0.0.1:0", &data);
    let listen = server.address.to_string();
    let (mut client, (avatar, _)) = walker(&server);
    stop(server, &mut client);
    let _server = serve(&listen, &data);
    let ray = Query::ray(Vec3::Y * 10.0, Vec3::Y * -20.0);
    // A restored body is found from the first step on.
    let finds_the_avatar = |_| {
        let result = client
            .ask(vec![ray.clone()])
            .expect("the server is there again");
        client.idle(Duration::from_millis(10)).expect("it stays");
        let answers = result.answers.expect("the scene has time");
        matches!(&answers[..], [Answer::Hits(hits)] if hits.iter().any(|hit| hit.body == avatar))
    };
    assert!((0..500).any(finds_the_avatar));
}

/// Bytes of all files below a directory.
fn bytes_below(directory: &Path) -> u64 {
    let Ok(entries) = fs::read_dir(directory) else {
        return 0;
    };
    let each = entries.filter_map(Result::ok).map(|entry| {
        // A file may be removed meanwhile.
        match entry.metadata() {
            Ok(found) if found.is_dir() => bytes_below(&entry.path()),
            found => found.map_or(0, |found| found.len()),
        }
    });
    each.sum()
}

/// A height field of some 64 kB, which is added and removed.
fn add_and_remove(client: &mut Client, rounds: u32) -> usize {
    let posts: Vec<f32> = (0..128 * 128).map(|post| (post % 7) as f32).collect();
    let field = Heights::new(128, 1.0, 1.0, &posts).expect("within the limits");
    let id = ShapeId(900);
    let mut refused = 0;
    for round in 0..rounds {
        let shape = Shape::Heights(field.clone());
        for command in [Command::AddShape { id, shape }, Command::RemoveShape { id }] {
            client.command(command).expect("the connection is open");
        }
        if round % 16 == 15 {
            client.inspect().expect("the server answers");
        }
        while let Some((_, event)) = client.poll_event() {
            let is_full = CommandError::Overloaded { retry_seconds: 5 };
            refused +=
                usize::from(matches!(event, Event::Refused { error, .. } if error == is_full));
        }
    }
    refused
}

#[test]
fn the_log_of_a_scene_that_never_steps_stays_within_its_bound() {
    const MIB: u64 = 1 << 20;
    let directory = tempfile::tempdir().expect("a temporary directory");
    let (data, config) = (
        directory.path().join("data"),
        directory.path().join("rhumb.toml"),
    );
    fs::write(&config, "[limits]\nscene_log_mib = 8\n").expect("it can be written");
    let flags = [
        "--data",
        data.to_str().expect("text"),
        "--config",
        config.to_str().expect("text"),
    ];
    let server = SERVER.serve_with("127.0.0.1:0", &flags);
    let trust = Trust::Fingerprint(server.fingerprint);
    let connection = Client::connect(&server.address.to_string(), trust);
    let options = JoinOptions {
        refusals: Refusals::Events,
        ..JoinOptions::default()
    };
    let connection = connection.expect("the server is there");
    let mut client = connection.join_with("still", options).expect("a new scene");
    client.advance(PipelineDepth::LOCKSTEP).expect("it steps");
    // Some 64 MB of shapes: snapshots between steps cut the log.
    add_and_remove(&mut client, 1_024);
    let bytes = bytes_below(&data);
    assert!(bytes < 40 * MIB, "{bytes} bytes of shapes");
    // Gravity forbids a snapshot before the next step: the log takes no more than its bound.
    let gravity = Vec3::Y;
    client
        .command(Command::SetGravity { gravity })
        .expect("the connection is open");
    let refused = add_and_remove(&mut client, 512);
    assert!(refused > 0, "some 32 MB are beyond the bound");
    let bytes = bytes_below(&data);
    assert!(bytes < 60 * MIB, "{bytes} bytes that no snapshot cuts");
    // A step lets a snapshot cut it, and the scene takes commands again.
    client.advance(PipelineDepth::LOCKSTEP).expect("it steps");
    assert_eq!(add_and_remove(&mut client, 16), 0);
}
