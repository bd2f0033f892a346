//! Members of edges over zenoh's routers, killed ones and frozen ones.
//!
//! Owner, routers, hub and edge are processes or threads of this machine. The commander is a member of the edge, in lockstep: its
//! run is a function of the tick, so that equal digests mean that each command was applied exactly once, and no tick comes without
//! its packets. Times are printed, not asserted.

use std::io::{BufRead, BufReader};
use std::net::{SocketAddr, UdpSocket};
use std::process::{Child, Command as Program, Stdio};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use glam::Vec3;
use rhumb_client::scene::{BodyDesc, BodyKind, Command, SceneConfig, Shape, ShapeId};
use rhumb_client::{
    Client, ClientError, JoinMode, JoinOptions, PipelineDepth, StreamChoice, Tick, Tolerance, Trust,
};
use rhumb_reckoning::{BodyId, BodyState};
use rhumb_server::{Access, Identity, Scene, Server, Stop};
use rhumb_transport::{DevelopmentPem, Fingerprint};
use tempfile::TempDir;

const PROGRAM: &str = env!("CARGO_BIN_EXE_rhumb-edge-zenoh");
const BODIES: u32 = 40;
/// Time for an answer on a loaded machine.
const LONG: Duration = Duration::from_secs(60);

/// The server of the scenes, in this process.
struct Owner {
    address: SocketAddr,
    fingerprint: Fingerprint,
    stop: Stop,
    running: Option<JoinHandle<()>>,
}

impl Owner {
    fn start() -> Self {
        let listen = "127.0.0.1:0".parse().expect("an address");
        let server = Server::bind(listen, &Identity::Development, Access::OpenOnLoopback);
        let server = server.expect("a free port");
        let (address, fingerprint) = (server.address(), server.fingerprint());
        let stop = Stop::new();
        let stopped = stop.clone();
        let running = thread::spawn(move || {
            server.run(&stopped).expect("it serves");
        });
        Self {
            address,
            fingerprint,
            stop,
            running: Some(running),
        }
    }
}

impl Drop for Owner {
    fn drop(&mut self) {
        self.stop.stop();
        // A server that has failed has said so.
        let _ = self.running.take().map(JoinHandle::join);
    }
}

/// A process, killed when dropped.
struct Process {
    child: Child,
    /// Where members connect, and what they pin; none for a router.
    place: Option<(SocketAddr, Fingerprint)>,
}

impl Process {
    fn start(arguments: &[&str]) -> Self {
        let mut command = Program::new(PROGRAM);
        command.args(arguments).stdout(Stdio::piped());
        let mut child = command.spawn().expect("the program is there");
        let out = child.stdout.take().expect("standard output is piped");
        let (mut address, mut place) = (None, None);
        for line in BufReader::new(out).lines() {
            let line = line.expect("text");
            if let Some(text) = line.strip_prefix("listening on ") {
                address = Some(text.parse().expect("an address"));
            }
            if let Some(text) = line.strip_prefix("fingerprint ") {
                place = address.zip(Some(text.parse().expect("a fingerprint")));
            }
            if place.is_some() || line.starts_with("forwarding") {
                return Self { child, place };
            }
        }
        panic!("{arguments:?}: the program ended");
    }

    /// A hub or an edge of an owner.
    fn edge(
        task: &str,
        owner: (SocketAddr, Fingerprint),
        routers: [&str; 2],
        more: &[&str],
    ) -> Self {
        let (address, fingerprint) = (owner.0.to_string(), owner.1.to_string());
        let [first, second] = routers;
        let plain = [
            task,
            "--owner",
            &address,
            "--fingerprint",
            &fingerprint,
            "--listen",
            "127.0.0.1:0",
            "--log",
            "warn",
            "--router",
            first,
            "--router",
            second,
        ];
        Self::start(&[&plain[..], more].concat())
    }

    fn place(&self) -> (SocketAddr, Fingerprint) {
        self.place.expect("it has members")
    }

    fn signal(&self, name: &str) {
        let id = self.child.id().to_string();
        let sent = Program::new("kill")
            .arg(format!("-{name}"))
            .arg(id)
            .status();
        assert!(sent.expect("a kill command").success());
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // One that has ended needs nothing.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// An endpoint that is free.
fn endpoint(kind: &str) -> String {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    let port = socket.local_addr().expect("it is bound").port();
    format!("{kind}/localhost:{port}")
}

/// The commands before a tick's step.
fn commands(tick: u64, ids: &[BodyId]) -> Vec<Command> {
    let mut commands = Vec::new();
    if tick == 0 {
        let shapes = [Shape::cuboid(1_000.0, 1.0, 1_000.0), Shape::ball(0.5)];
        for (id, shape) in (0..).map(ShapeId).zip(shapes) {
            commands.push(Command::AddShape { id, shape });
        }
        for (place, id) in ids.iter().enumerate() {
            let (kind, shape, height) = match place {
                0 => (BodyKind::Fixed, 0, 0.0),
                _ => (BodyKind::Dynamic, 1, 1.5 + (place % 8) as f32 * 1.1),
            };
            let position = [(place / 8) as f32 * 1.5, height, (place % 3) as f32 * 0.3];
            let motion = BodyState::new(position, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
            let desc = BodyDesc::plain(*id, kind, ShapeId(shape));
            let motion = motion.expect("finite");
            commands.push(Command::AddBody { desc, motion });
        }
    }
    let id = ids[1 + tick as usize % (ids.len() - 1)];
    let impulse = Vec3::new((tick % 7) as f32 - 3.0, 4.0, (tick % 5) as f32 - 2.0) * 90.0;
    commands.push(Command::Impulse { id, impulse });
    commands
}

fn join((address, fingerprint): (SocketAddr, Fingerprint), options: JoinOptions) -> Client {
    let connection = Client::connect(&address.to_string(), Trust::Fingerprint(fingerprint));
    let connection = connection.expect("it is there");
    connection.join_with("pit", options).expect("a scene")
}

/// Waits until a member has everything up to a tick.
fn until_complete(client: &mut Client, end: Tick) {
    let begun = Instant::now();
    while client.statistics().complete < end {
        let at = client.statistics().complete;
        assert!(begun.elapsed() < LONG, "at {at}");
        client.idle(Duration::from_millis(1)).expect("a member");
    }
}

/// A member of the edge that commands, and how far it is.
struct Run {
    commander: Client,
    ids: Vec<BodyId>,
    tick: u64,
    slowest: Duration,
}

impl Run {
    fn new(place: (SocketAddr, Fingerprint)) -> Self {
        let options = JoinOptions {
            mode: JoinMode::Create(SceneConfig::default()),
            resume_within: Some(LONG),
            ..JoinOptions::default()
        };
        let mut commander = join(place, options);
        let ids = commander.new_ids(BODIES).expect("enough indices");
        Self {
            commander,
            ids,
            tick: 0,
            slowest: Duration::ZERO,
        }
    }

    fn steps(&mut self, ticks: u64) {
        for _ in 0..ticks {
            for command in commands(self.tick, &self.ids) {
                self.commander.command(command).expect("a member");
            }
            let begun = Instant::now();
            let mut stepped = self.commander.advance(PipelineDepth::LOCKSTEP);
            while let Err(ClientError::Timeout { .. }) = stepped
                && begun.elapsed() < LONG
            {
                stepped = self.commander.wait(PipelineDepth::LOCKSTEP);
            }
            stepped.expect("the scene steps");
            self.slowest = self.slowest.max(begun.elapsed());
            while self.commander.poll_event().is_some() {}
            self.tick += 1;
        }
    }

    fn slowest_since(&mut self) -> Duration {
        std::mem::take(&mut self.slowest)
    }

    /// Each command was applied once, and members have the bodies where they are.
    fn check(mut self, owner: (SocketAddr, Fingerprint), observer: &mut Client) {
        let mut scene = Scene::new(SceneConfig::default()).expect("valid");
        for tick in 0..self.tick {
            for command in commands(tick, &self.ids) {
                scene.apply(&command).expect("a valid command");
            }
            scene.step().expect("the engine is sound");
        }
        let truth = self.commander.inspect().expect("the owner answers");
        assert_eq!(truth.truth, scene.digest().value());
        let exact = JoinOptions {
            mode: JoinMode::Join,
            stream: StreamChoice::Full,
            ..JoinOptions::default()
        };
        let mut exact = join(owner, exact);
        let end = Tick::new(self.tick);
        for client in [&mut exact, observer] {
            until_complete(client, end);
            client.wait(PipelineDepth::LOCKSTEP).expect("a tick");
        }
        for id in &self.ids {
            let [true_at, shown_at] =
                [&exact, &*observer].map(|client| client.view().position(*id));
            let apart = true_at.expect("a body").distance(shown_at.expect("a body"));
            assert!(apart <= 0.050_1, "{id}: {apart} m");
        }
    }
}

/// Two routers, a hub at the first, an edge at the second, a commander and an observer of the edge.
struct Stage {
    owner: Owner,
    routers: [Process; 2],
    _hub: Process,
    _edge: Process,
    run: Run,
    observer: Client,
}

fn stage() -> Stage {
    stage_with("udp", &[])
}

/// The same with a kind of endpoint, and more arguments of every process.
fn stage_with(kind: &str, more: &[&str]) -> Stage {
    let owner = Owner::start();
    let [first, second] = [endpoint(kind), endpoint(kind)];
    let [before, behind] = [
        &["router", "--listen", &first][..],
        &["router", "--listen", &second, "--connect", &first],
    ];
    let routers = [before, behind].map(|router| Process::start(&[router, more].concat()));
    let of = (owner.address, owner.fingerprint);
    let hub = Process::edge("hub", of, [&first, &second], more);
    let edge = Process::edge("edge", hub.place(), [&second, &first], more);
    let mut run = Run::new(edge.place());
    run.steps(40);
    let options = JoinOptions {
        mode: JoinMode::Join,
        stream: StreamChoice::Within(Tolerance::NORMAL),
        ..JoinOptions::default()
    };
    let observer = join(edge.place(), options);
    Stage {
        owner,
        routers,
        _hub: hub,
        _edge: edge,
        run,
        observer,
    }
}

#[test]
fn packets_come_by_the_routers_and_not_as_answers() {
    packets_come(stage());
}

/// Files with a certificate of its own, and the arguments that name them: it knows itself alone.
fn own_certificate() -> (TempDir, [String; 6]) {
    let files = tempfile::tempdir().expect("a temporary directory");
    let pem = DevelopmentPem::new(["localhost"]).expect("a valid name");
    let [cert, key] = [("cert", &pem.certificate), ("key", &pem.key)].map(|(name, text)| {
        let path = files.path().join(name);
        std::fs::write(&path, text).expect("the directory takes files");
        path.to_str().expect("text").to_owned()
    });
    let roots = cert.clone();
    let named = ["--link-cert", "--link-key", "--link-roots"].map(str::to_owned);
    let [of_cert, of_key, of_roots] = named;
    (files, [of_cert, cert, of_key, key, of_roots, roots])
}

#[test]
fn packets_come_over_tls_between_ends_that_know_each_other() {
    let (_files, own) = own_certificate();
    packets_come(stage_with("tls", &own.each_ref().map(String::as_str)));
}

#[test]
fn a_router_of_tls_takes_no_end_that_it_does_not_know() {
    let (_files, own) = own_certificate();
    let (_others, other) = own_certificate();
    let owner = Owner::start();
    let place = endpoint("tls");
    let listen = ["router", "--listen", &place];
    let _router = Process::start(&[&listen[..], &own.each_ref().map(String::as_str)].concat());
    // The stranger trusts the router, and shows a certificate that the router does not know.
    let [of_cert, cert, of_key, key, of_roots, _] = other;
    let roots = own[5].clone();
    let (address, print) = (owner.address.to_string(), owner.fingerprint.to_string());
    let mut stranger = Program::new(PROGRAM);
    stranger.args(["hub", "--owner", &address, "--fingerprint", &print]);
    stranger.args(["--listen", "127.0.0.1:0", "--router", &place]);
    stranger.args([of_cert, cert, of_key, key, of_roots, roots]);
    let ended = stranger.output().expect("the program is there");
    let text = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(1), "{text}");
    assert!(text.contains("Unable to connect"), "{text}");
}

#[test]
fn an_endpoint_of_tls_needs_certificates() {
    let mut router = Program::new(PROGRAM);
    router.args(["router", "--listen", "tls/localhost:0"]);
    let ended = router.output().expect("the program is there");
    assert_eq!(ended.status.code(), Some(1));
    let text = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(
        text,
        "error: tls/localhost:0: give --link-cert, --link-key and --link-roots\n"
    );
}

fn packets_come(mut stage: Stage) {
    let before = stage.observer.statistics().stream;
    stage.run.steps(60);
    let end = Tick::new(stage.run.tick);
    stage
        .observer
        .wait(PipelineDepth::LOCKSTEP)
        .expect("a tick");
    until_complete(&mut stage.observer, end);
    let after = stage.observer.statistics().stream;
    // The hub sends no packet to its edges but answers, which a subscriber counts as refreshes.
    assert!(
        after.packets >= before.packets + 60,
        "{before:?}, {after:?}"
    );
    let owner = (stage.owner.address, stage.owner.fingerprint);
    stage.run.check(owner, &mut stage.observer);
}

#[test]
fn members_are_served_when_a_router_is_killed() {
    let mut stage = stage();
    let before = stage.run.slowest_since();
    stage.routers[1].signal("KILL");
    stage.run.steps(60);
    println!(
        "slowest tick: {before:?}, with a killed router {:?}",
        stage.run.slowest
    );
    let owner = (stage.owner.address, stage.owner.fingerprint);
    stage.run.check(owner, &mut stage.observer);
}

#[test]
fn members_are_served_when_a_router_is_frozen() {
    let mut stage = stage();
    let before = stage.run.slowest_since();
    stage.routers[1].signal("STOP");
    stage.run.steps(60);
    println!(
        "slowest tick: {before:?}, with a frozen router {:?}",
        stage.run.slowest_since()
    );
    stage.routers[1].signal("CONT");
    stage.run.steps(20);
    let owner = (stage.owner.address, stage.owner.fingerprint);
    stage.run.check(owner, &mut stage.observer);
}
