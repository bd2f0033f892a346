//! Two servers that share their scenes by a directory.
//!
//! The directory is an etcd of the test's own; a test is left out where etcd is not installed, unless `RHUMB_TEST_LANGUAGES` is
//! `all`. The run is that of `durable`: equal digests mean that no command was lost, doubled or moved to another tick. `KILLS`
//! and `MOVES` say how often the scene's server ends, `BODIES` the size of the scene, `SEED` the moments.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rhumb_client::{Client, JoinMode, JoinOptions, Tick, Trust};
use rhumb_reckoning::BodyId;
use rhumb_tests::ServerProcess;
use tempfile::TempDir;

use crate::SERVER;
use crate::durable::{
    LONG, Seen, chance, commands, create_at_address, digest_without_server, step, take_events,
    variable,
};
use crate::hostile_load::{free_address, requested};

/// An etcd of its own; killed when it is dropped.
struct Etcd {
    child: Child,
    endpoint: String,
    _files: TempDir,
}

impl Etcd {
    /// `None` where it is not installed and need not be.
    fn start() -> Option<Self> {
        let files = tempfile::tempdir().expect("a temporary directory");
        let endpoint = format!("http://{}", free_address());
        let child = Command::new("etcd")
            .arg("--data-dir")
            .arg(files.path())
            .args(["--listen-client-urls", &endpoint])
            .args(["--advertise-client-urls", &endpoint])
            .args(["--listen-peer-urls", "http://127.0.0.1:0"])
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn();
        let Ok(mut child) = child else {
            let all = std::env::var("RHUMB_TEST_LANGUAGES").is_ok_and(|which| which == "all");
            assert!(!all, "etcd is not installed");
            eprintln!("left out: etcd is not installed");
            return None;
        };
        let log = child.stderr.take().expect("it is piped");
        let mut lines = BufReader::new(log).lines();
        let ready = lines.find(|line| {
            let line = line.as_ref().expect("its log is text");
            line.contains("ready to serve client requests")
        });
        assert!(ready.is_some(), "etcd does not start");
        thread::spawn(move || lines.for_each(drop));
        Some(Self {
            child,
            endpoint,
            _files: files,
        })
    }

    /// Stops it without its end, or lets it go on.
    fn signal(&self, name: &str) {
        signal(self.child.id(), name);
    }
}

impl Drop for Etcd {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn signal(process: u32, name: &str) {
    let mut kill = Command::new("kill");
    let status = kill
        .arg(format!("-{name}"))
        .arg(process.to_string())
        .status();
    assert!(status.expect("the kill command runs").success());
}

/// A server of the directory, and the address of its figures.
struct Placed {
    server: ServerProcess,
    metrics: String,
}

impl Placed {
    fn start(listen: &str, data: &Path, etcd: &Etcd) -> Self {
        let (metrics, data) = (free_address(), data.to_str().expect("text"));
        let more = [
            "--data",
            data,
            "--directory",
            &etcd.endpoint,
            "--metrics",
            &metrics,
        ];
        let server = SERVER.serve_with(listen, &more);
        Self { server, metrics }
    }

    fn has_the_scene(&self) -> bool {
        let figures = requested(&self.metrics, "/metrics");
        figures.lines().any(|line| line == "rhumb_scenes 1")
    }
}

/// Two servers of one directory.
fn pair(data: &Path, etcd: &Etcd) -> [Placed; 2] {
    [(); 2].map(|()| Placed::start("127.0.0.1:0", data, etcd))
}

fn addresses(servers: &[Placed; 2]) -> String {
    let [one, other] = servers;
    format!("{},{}", one.server.address, other.server.address)
}

/// Ticks of a client that steps its scene until it is stopped.
struct Run {
    stop: Arc<AtomicBool>,
    ticks: Arc<AtomicU64>,
    thread: JoinHandle<(u64, u64, Seen)>,
    ids: Vec<BodyId>,
}

impl Run {
    fn start(mut client: Client, ids: Vec<BodyId>) -> Self {
        let (stop, ticks) = (Arc::<AtomicBool>::default(), Arc::<AtomicU64>::default());
        let (ended, shown, of_client) = (Arc::clone(&stop), Arc::clone(&ticks), ids.clone());
        let thread = thread::spawn(move || {
            let (mut seen, mut tick) = (Seen::default(), 0);
            while !ended.load(Ordering::Relaxed) {
                for command in commands(tick, &of_client) {
                    client.command(command).expect("the session continues");
                }
                step(&mut client);
                take_events(&mut client, &mut seen);
                tick += 1;
                shown.store(tick, Ordering::Relaxed);
            }
            let truth = client.inspect().expect("the server answers");
            assert_eq!(truth.tick, Tick::new(tick));
            (tick, truth.truth, seen)
        });
        Self {
            stop,
            ticks,
            thread,
            ids,
        }
    }

    /// Waits for so many ticks more; the time that they took.
    fn go(&self, ticks: u64) -> Duration {
        let (begun, from) = (Instant::now(), self.ticks.load(Ordering::Relaxed));
        while self.ticks.load(Ordering::Relaxed) < from + ticks {
            assert!(!self.thread.is_finished(), "the client failed");
            assert!(begun.elapsed() < LONG, "the scene stands still");
            thread::yield_now();
        }
        begun.elapsed()
    }

    /// Ends, and compares the scene with the run without a server; how often the client resumed its session.
    fn end(self) -> u64 {
        self.stop.store(true, Ordering::Relaxed);
        let (tick, truth, seen) = self.thread.join().expect("the client's thread");
        assert_eq!(truth, digest_without_server(tick, &self.ids));
        seen.resumed
    }
}

/// The scene's server ends so often, and begins again without the scene.
fn ends_often(times: u64, end: impl Fn(ServerProcess)) {
    let Some(etcd) = Etcd::start() else { return };
    let data = tempfile::tempdir().expect("a temporary directory");
    let mut servers = pair(data.path(), &etcd);
    let (client, ids) = create_at_address(&addresses(&servers), &servers[0].server);
    let run = Run::start(client, ids);
    let mut chance = chance(variable("SEED", 1));
    let mut pauses = Vec::new();
    for _ in 0..times {
        run.go(1 + chance(100));
        let place = servers.iter().position(Placed::has_the_scene);
        let place = place.expect("one of them has the scene");
        let [one, other] = servers;
        let (victim, rest) = if place == 0 {
            (one, other)
        } else {
            (other, one)
        };
        let listen = victim.server.address.to_string();
        let ended = Instant::now();
        end(victim.server);
        run.go(2);
        pauses.push(ended.elapsed());
        servers = [rest, Placed::start(&listen, data.path(), &etcd)];
    }
    let resumed = run.end();
    pauses.sort();
    eprintln!("{resumed} resumptions; pauses {pauses:?}");
    assert!(resumed >= times);
}

#[test]
fn the_scene_of_a_killed_server_goes_on_at_another_and_no_command_is_lost_or_doubled() {
    ends_often(variable("KILLS", 2), ServerProcess::kill);
}

#[test]
fn another_server_has_the_scene_of_a_killed_one_soon_after_its_lease() {
    let Some(etcd) = Etcd::start() else { return };
    let data = tempfile::tempdir().expect("a temporary directory");
    let [one, other] = pair(data.path(), &etcd);
    let (mut client, ids) = create_at_address(&one.server.address.to_string(), &one.server);
    for command in commands(0, &ids) {
        client.command(command).expect("it is sent");
    }
    step(&mut client);
    let (mut seen, begun) = (Seen::default(), Instant::now());
    while seen.durable < commands(0, &ids).len() as u64 {
        assert!(begun.elapsed() < LONG, "nothing becomes durable");
        client.idle(Duration::from_millis(1)).expect("it is there");
        take_events(&mut client, &mut seen);
    }
    let truth = client.inspect().expect("an answer").truth;
    one.server.kill();
    let killed = Instant::now();
    let address = other.server.address.to_string();
    let mut late = loop {
        let trust = Trust::Fingerprint(other.server.fingerprint);
        let connection = Client::connect_within(&address, trust, Duration::from_secs(10));
        let options = JoinOptions {
            mode: JoinMode::Join,
            ..JoinOptions::default()
        };
        match connection.expect("it answers").join_with("pit", options) {
            Ok(client) => break client,
            Err(error) => assert!(killed.elapsed() < LONG, "{error}"),
        }
    };
    eprintln!("there after {:?}", killed.elapsed());
    assert_eq!(late.inspect().expect("an answer").truth, truth);
}

#[test]
fn a_stopped_server_leaves_its_scene_to_another_at_once() {
    let stop = |server: ServerProcess| {
        server.signal("TERM");
        assert_eq!(server.wait().code, Some(0));
    };
    ends_often(variable("MOVES", 3), stop);
}

#[test]
fn a_client_of_any_server_reaches_the_scene() {
    let Some(etcd) = Etcd::start() else { return };
    let data = tempfile::tempdir().expect("a temporary directory");
    let servers = pair(data.path(), &etcd);
    let [one, other] = servers.each_ref().map(|placed| &placed.server);
    assert_eq!(
        one.fingerprint, other.fingerprint,
        "they show one certificate"
    );
    let (mut client, ids) = create_at_address(&one.address.to_string(), one);
    for command in commands(0, &ids) {
        client.command(command).expect("it is sent");
    }
    step(&mut client);
    let trust = Trust::Fingerprint(other.fingerprint);
    let connection = Client::connect(&other.address.to_string(), trust).expect("it answers");
    let options = JoinOptions {
        mode: JoinMode::Join,
        ..JoinOptions::default()
    };
    let mut follower = connection.join_with("pit", options).expect("it is sent on");
    let truth = |client: &mut Client| client.inspect().expect("an answer").truth;
    assert_eq!(truth(&mut follower), truth(&mut client));
    assert!(servers[0].has_the_scene() && !servers[1].has_the_scene());
}

#[test]
fn without_its_directory_a_server_ends_its_scenes_and_goes_on_with_it() {
    let Some(etcd) = Etcd::start() else { return };
    let data = tempfile::tempdir().expect("a temporary directory");
    let servers = pair(data.path(), &etcd);
    let (client, ids) = create_at_address(&addresses(&servers), &servers[0].server);
    let run = Run::start(client, ids);
    run.go(50);
    etcd.signal("STOP");
    let stopped = Instant::now();
    while servers.iter().any(Placed::has_the_scene) {
        assert!(stopped.elapsed() < LONG, "its lease is over");
        thread::yield_now();
    }
    etcd.signal("CONT");
    run.go(50);
    assert!(run.end() >= 1);
}

#[test]
fn a_server_that_was_frozen_does_not_go_on_with_what_another_one_has() {
    let Some(etcd) = Etcd::start() else { return };
    let data = tempfile::tempdir().expect("a temporary directory");
    let servers = pair(data.path(), &etcd);
    let (client, ids) = create_at_address(&addresses(&servers), &servers[0].server);
    let run = Run::start(client, ids);
    run.go(50);
    let owner = servers.iter().position(Placed::has_the_scene);
    let owner = &servers[owner.expect("one of them has the scene")];
    owner.server.signal("STOP");
    run.go(50);
    owner.server.signal("CONT");
    let woken = Instant::now();
    while owner.has_the_scene() {
        assert!(woken.elapsed() < LONG, "its lease is over");
        thread::yield_now();
    }
    run.go(50);
    assert!(run.end() >= 1);
}

#[test]
fn a_server_says_what_its_directory_lacks() {
    let refused = |more: &[&str]| {
        let ended = SERVER.run(&[&["--open", "--check-config", "--directory"], more].concat());
        assert_eq!(ended.code, Some(1), "{}", ended.out);
        ended.log
    };
    let lacks_data = refused(&["http://127.0.0.1:1"]);
    assert!(lacks_data.contains("--data DIR"), "{lacks_data}");
    let data = tempfile::tempdir().expect("a temporary directory");
    let data = data.path().to_str().expect("text");
    let wrong = refused(&["etcd:2379", "--data", data]);
    assert!(wrong.contains("http://host:port"), "{wrong}");
}
