//! Two servers that share their scenes by a directory.
//!
//! The directory is an etcd of the test's own; a test is left out where etcd is not installed, unless
//! `RHUMB_TEST_LANGUAGES` is `all`. The run is that of `durable`: equal digests mean that no command was lost, doubled or
//! moved to another tick. `KILLS`, `STOPS` and `MOVES` say how often the scene's server ends or the scene moves, `BODIES`
//! the size of the scene, `SEED` the moments, `LEASE` the seconds of the servers' leases.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use rhumb_client::scene::SceneConfig;
use rhumb_client::{Client, JoinMode, JoinOptions, Tick, Trust};
use rhumb_tests::{ServerProcess, signal};
use rhumb_transport::conditioner::{LinkConfig, UdpRelay};
use tempfile::TempDir;

use crate::SERVER;
use crate::app_process::falling_plugin;
use crate::durable::{
    LONG, Run, Seen, chance, commands, create_at_address, step, take_events, until, variable,
};
use crate::hostile_load::{free_address, requested};

/// An etcd of its own; killed when it is dropped.
pub(crate) struct Etcd {
    child: Child,
    pub(crate) endpoint: String,
    _files: TempDir,
}

impl Etcd {
    /// `None` where it is not installed and need not be.
    pub(crate) fn start() -> Option<Self> {
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

    /// Stops it without its end, or lets it run again.
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

/// A server of the directory, and the address of its figures.
struct Placed {
    server: ServerProcess,
    metrics: String,
}

impl Placed {
    fn start(listen: &str, data: &Path, etcd: &Etcd) -> Self {
        Self::start_with(listen, data, etcd, &[])
    }

    fn start_with(listen: &str, data: &Path, etcd: &Etcd, settings: &[&str]) -> Self {
        let (metrics, data) = (free_address(), data.to_str().expect("text"));
        let lease = variable("LEASE", 5).to_string();
        let own = [
            "--data",
            data,
            "--directory",
            &etcd.endpoint,
            "--metrics",
            &metrics,
            "--lease",
            &lease,
        ];
        let server = SERVER.serve_with(listen, &[&own, settings].concat());
        Self { server, metrics }
    }

    fn has_the_scene(&self) -> bool {
        let figures = requested(&self.metrics, "/metrics");
        figures.lines().any(|line| line == "rhumb_scenes 1")
    }
}

/// The place of the server that has the scene, once its figures show it.
fn owner_of(servers: &[Placed; 2]) -> usize {
    let begun = Instant::now();
    loop {
        if let Some(place) = servers.iter().position(Placed::has_the_scene) {
            return place;
        }
        assert!(begun.elapsed() < LONG, "one of them has the scene");
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

/// Two servers of one directory whose scenes run in worker processes.
fn pair_of_processes(data: &Path, etcd: &Etcd) -> [Placed; 2] {
    let settings = ["--workers", "processes"];
    [(); 2].map(|()| Placed::start_with("127.0.0.1:0", data, etcd, &settings))
}

/// Moves the scene to a server, by the operator's command.
fn move_to(server: &ServerProcess, etcd: &Etcd) {
    let to = server.address.to_string();
    let order = ["move", "pit", "--to", &to, "--directory", &etcd.endpoint];
    let moved = SERVER.run(&order);
    assert_eq!(moved.code, Some(0), "{}{}", moved.out, moved.log);
}

/// The place of a share of all values in their order.
fn share(sorted: &[Duration], percent: usize) -> Duration {
    sorted[(sorted.len() * percent / 100).min(sorted.len() - 1)]
}

/// The scene of a client that steps it goes from server to server so often.
fn moves_often(times: u64, pair: impl Fn(&Path, &Etcd) -> [Placed; 2]) {
    let Some(etcd) = Etcd::start() else { return };
    let data = tempfile::tempdir().expect("a temporary directory");
    let servers = pair(data.path(), &etcd);
    let (client, ids) = create_at_address(&addresses(&servers), &servers[0].server);
    let run = Run::start(client, ids);
    let mut chance = chance(variable("SEED", 1));
    let mut pauses = Vec::new();
    for time in 0..times {
        run.go(1 + chance(100));
        let to = (1 + time as usize) % 2;
        run.slowest();
        move_to(&servers[to].server, &etcd);
        run.go(2);
        pauses.push(run.slowest());
        until("the scene has moved", || owner_of(&servers) == to);
    }
    let resumed = run.end().seen.resumed;
    pauses.sort();
    let [p50, p90, p99] = [50, 90, 99].map(|percent| share(&pauses, percent));
    eprintln!("{resumed} resumptions; pauses p50 {p50:?}, p90 {p90:?}, p99 {p99:?}; {pauses:?}");
    assert_eq!(resumed, times);
}

#[test]
fn a_scene_moves_by_command_while_it_is_stepped_and_no_command_is_lost_or_doubled() {
    moves_often(variable("MOVES", 4), pair);
}

#[test]
fn a_scene_of_a_worker_process_moves_too() {
    moves_often(variable("MOVES", 2), pair_of_processes);
}

#[test]
fn a_drained_server_has_no_scenes_and_takes_none() {
    let Some(etcd) = Etcd::start() else { return };
    let data = tempfile::tempdir().expect("a temporary directory");
    let servers = pair(data.path(), &etcd);
    let [one, other] = servers.each_ref().map(|placed| &placed.server);
    let (client, ids) = create_at_address(&one.address.to_string(), one);
    let run = Run::start(client, ids);
    run.go(20);
    let address = one.address.to_string();
    let drain = ["drain", &address, "--directory", &etcd.endpoint];
    let drained = SERVER.run(&drain);
    assert_eq!(drained.code, Some(0), "{}{}", drained.out, drained.log);
    assert!(drained.out.contains("1 moved"), "{}", drained.out);
    until("the other server has the scene", || {
        !servers[0].has_the_scene() && servers[1].has_the_scene()
    });
    run.go(20);
    let connection = Client::connect(&address, Trust::Fingerprint(one.fingerprint));
    let another = connection.expect("it answers").join("another");
    let mut another = another.expect("it is sent on");
    step(&mut another);
    until("the other server has both scenes", || {
        let figures = requested(&servers[1].metrics, "/metrics");
        figures.lines().any(|line| line == "rhumb_scenes 2")
    });
    assert_eq!(run.end().seen.resumed, 1);
    let alone = SERVER.run(&[
        "drain",
        &other.address.to_string(),
        "--directory",
        &etcd.endpoint,
    ]);
    assert!(alone.log.contains("no other server"), "{}", alone.log);
}

#[test]
fn an_order_that_cannot_be_says_why() {
    let Some(etcd) = Etcd::start() else { return };
    let data = tempfile::tempdir().expect("a temporary directory");
    let servers = pair(data.path(), &etcd);
    let refused = |order: &[&str]| {
        let ended = SERVER.run(&[order, &["--directory", &etcd.endpoint]].concat());
        assert_eq!(ended.code, Some(1), "{}", ended.out);
        ended.log
    };
    let address = servers[0].server.address.to_string();
    // A server is on the board a moment after its start.
    let begun = Instant::now();
    while !refused(&["move", "pit", "--to", &address]).contains("no server has the scene") {
        assert!(begun.elapsed() < LONG, "the server is on the board");
    }
    let nowhere = refused(&["move", "pit", "--to", "127.0.0.1:1"]);
    assert!(nowhere.contains(&address), "{nowhere}");
}

#[test]
fn an_order_for_a_scene_without_a_log_is_refused_at_once() {
    let Some(etcd) = Etcd::start() else { return };
    let data = tempfile::tempdir().expect("a temporary directory");
    let [one, other] = [(); 2].map(|()| {
        let settings = ["--app-listen", "127.0.0.1:0"];
        Placed::start_with("127.0.0.1:0", data.path(), &etcd, &settings)
    });
    // A client that owns its scene. A server that has just started may have no lease yet, and closes then.
    let begun = Instant::now();
    let _owner = loop {
        let owner = falling_plugin(&one.server, 7);
        let asked = Instant::now();
        while !one.has_the_scene() && asked.elapsed() < Duration::from_secs(3) {
            thread::yield_now();
        }
        if one.has_the_scene() {
            break owner;
        }
        assert!(begun.elapsed() < LONG, "the scene is there");
    };
    let to = other.server.address.to_string();
    let order = ["move", "app/7", "--to", &to, "--directory", &etcd.endpoint];
    // A server is on the board a moment after its start.
    let begun = Instant::now();
    while SERVER.run(&order).log.contains("has no server at") {
        assert!(begun.elapsed() < LONG, "the other server is on the board");
    }
    let begun = Instant::now();
    for _ in 0..2 {
        let ended = SERVER.run(&order);
        assert_eq!(ended.code, Some(1), "{}", ended.out);
        assert!(ended.log.contains("has no files"), "{}", ended.log);
    }
    let took = begun.elapsed();
    assert!(took < Duration::from_secs(20), "{took:?}");
    assert!(one.has_the_scene());
}

#[test]
fn a_server_that_is_frozen_for_two_seconds_is_not_taken_for_dead() {
    let Some(etcd) = Etcd::start() else { return };
    let data = tempfile::tempdir().expect("a temporary directory");
    let servers = pair(data.path(), &etcd);
    let (client, ids) = create_at_address(&addresses(&servers), &servers[0].server);
    let run = Run::start(client, ids);
    run.go(50);
    servers[0].server.signal("STOP");
    let frozen = Instant::now();
    while frozen.elapsed() < Duration::from_secs(2) {
        thread::yield_now();
    }
    servers[0].server.signal("CONT");
    run.go(50);
    assert_eq!(run.end().seen.resumed, 0, "nothing was resumed");
}

/// How often clients behind links of this condition resume, when each steps its scene for some seconds and is silent for as
/// long.
fn resumptions_behind(condition: &str, server: &ServerProcess) -> u64 {
    let (clients, seconds) = (variable("CLIENTS", 4), variable("SECONDS", 8));
    let condition: LinkConfig = condition.parse().expect("a condition");
    let behind = |seed: u64| {
        let any = "127.0.0.1:0".parse().expect("an address");
        let relay = UdpRelay::start(any, server.address, condition, seed).expect("a relay");
        let trust = Trust::Fingerprint(server.fingerprint);
        let address = relay.local_addr().to_string();
        let options = JoinOptions {
            mode: JoinMode::CreateOrJoin(SceneConfig::default()),
            ..JoinOptions::default()
        };
        let scene = format!("lossy-{seed}-{condition}").replace([',', '=', '%', '.'], "-");
        let join = || {
            let connection = Client::connect_within(&address, trust.clone(), LONG)?;
            connection.join_with(&scene, options)
        };
        // A server gives a connection five seconds to be set up.
        let begun = Instant::now();
        let mut client = loop {
            match join() {
                Ok(client) => break client,
                Err(error) => assert!(begun.elapsed() < LONG, "{error}"),
            }
        };
        let (mut seen, span) = (Seen::default(), Duration::from_secs(seconds));
        let begun = Instant::now();
        while begun.elapsed() < span {
            step(&mut client);
            take_events(&mut client, &mut seen);
        }
        let begun = Instant::now();
        while begun.elapsed() < span {
            client.idle(Duration::from_millis(50)).expect("it is there");
            take_events(&mut client, &mut seen);
        }
        // The last message may have come over another connection.
        step(&mut client);
        take_events(&mut client, &mut seen);
        seen.resumed
    };
    let first = variable("SEED", 1);
    thread::scope(|scope| {
        let running: Vec<_> = (first..first + clients)
            .map(|seed| scope.spawn(move || behind(seed)))
            .collect();
        let resumed = running
            .into_iter()
            .map(|client| client.join().expect("a client"));
        resumed.sum()
    })
}

#[test]
fn a_server_behind_a_bad_link_is_not_taken_for_dead() {
    let Some(etcd) = Etcd::start() else { return };
    let data = tempfile::tempdir().expect("a temporary directory");
    let placed = Placed::start("127.0.0.1:0", data.path(), &etcd);
    for condition in ["delay=300ms,loss=10%", "delay=300ms,loss=30%"] {
        let resumed = resumptions_behind(condition, &placed.server);
        eprintln!("{condition}: {resumed} resumptions");
        assert_eq!(resumed, 0, "{condition}");
    }
}

#[test]
fn an_edge_follows_a_scene_that_moves() {
    let Some(etcd) = Etcd::start() else { return };
    let data = tempfile::tempdir().expect("a temporary directory");
    let servers = pair(data.path(), &etcd);
    let [one, other] = servers.each_ref().map(|placed| &placed.server);
    let watching = SERVER.edge(one, "127.0.0.1:0", &["--observers"]);
    let acting = SERVER.edge(one, "127.0.0.1:0", &[]);
    let (client, ids) = create_at_address(&acting.address.to_string(), &acting);
    let run = Run::start(client, ids);
    run.go(20);
    let options = JoinOptions {
        mode: JoinMode::Join,
        ..JoinOptions::default()
    };
    let trust = Trust::Fingerprint(watching.fingerprint);
    let connection = Client::connect(&watching.address.to_string(), trust);
    let mut observer = (connection.expect("it answers"))
        .join_with("pit", options)
        .expect("the scene is there");
    for to in [other, one] {
        move_to(to, &etcd);
        run.go(20);
        let (tick, begun) = (run.ticks(), Instant::now());
        while observer.statistics().complete < Tick::new(tick) {
            assert!(begun.elapsed() < LONG, "the observer sees the scene");
            observer
                .idle(Duration::from_millis(1))
                .expect("it is there");
            while observer.poll_event().is_some() {}
        }
    }
    assert_eq!(run.end().seen.resumed, 2);
    // An edge whose server has never had the scene finds it too.
    move_to(other, &etcd);
    let late = SERVER.edge(one, "127.0.0.1:0", &[]);
    let trust = Trust::Fingerprint(late.fingerprint);
    let connection = Client::connect(&late.address.to_string(), trust);
    let joined = (connection.expect("it answers")).join_with("pit", options);
    joined.expect("the scene is found");
}

/// The scene's server ends so often, and begins again without the scene.
fn ends_often(times: u64, pair: impl Fn(&Path, &Etcd) -> [Placed; 2], end: impl Fn(ServerProcess)) {
    let Some(etcd) = Etcd::start() else { return };
    let data = tempfile::tempdir().expect("a temporary directory");
    let mut servers = pair(data.path(), &etcd);
    let (client, ids) = create_at_address(&addresses(&servers), &servers[0].server);
    let run = Run::start(client, ids);
    let mut chance = chance(variable("SEED", 1));
    let mut pauses = Vec::new();
    for _ in 0..times {
        run.go(1 + chance(100));
        let place = owner_of(&servers);
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
    let resumed = run.end().seen.resumed;
    pauses.sort();
    eprintln!("{resumed} resumptions; pauses {pauses:?}");
    assert!(resumed >= times);
}

#[test]
fn the_scene_of_a_killed_server_goes_on_at_another_and_no_command_is_lost_or_doubled() {
    ends_often(variable("KILLS", 2), pair, ServerProcess::kill);
}

#[test]
fn so_does_that_of_a_worker_process() {
    ends_often(variable("KILLS", 1), pair_of_processes, ServerProcess::kill);
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
    // The other one first names the server that was killed, for as long as its lease lasts.
    let address = other.server.address.to_string();
    let trust = Trust::Fingerprint(other.server.fingerprint);
    let connection = Client::connect_within(&address, trust, LONG).expect("it answers");
    let options = JoinOptions {
        mode: JoinMode::Join,
        ..JoinOptions::default()
    };
    let mut late = connection.join_with("pit", options).expect("it is there");
    eprintln!("there after {:?}", killed.elapsed());
    assert_eq!(late.inspect().expect("an answer").truth, truth);
}

#[test]
fn a_stopped_server_leaves_its_scene_to_another_at_once() {
    let stop = |server: ServerProcess| {
        server.signal("TERM");
        assert_eq!(server.wait().code, Some(0));
    };
    ends_often(variable("STOPS", 3), pair, stop);
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
    until("the first server alone has the scene", || {
        servers[0].has_the_scene() && !servers[1].has_the_scene()
    });
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
    until("its lease is over", || {
        !servers.iter().any(Placed::has_the_scene)
    });
    etcd.signal("CONT");
    run.go(50);
    assert!(run.end().seen.resumed >= 1);
}

#[test]
fn a_server_that_was_frozen_does_not_go_on_with_what_another_one_has() {
    let Some(etcd) = Etcd::start() else { return };
    let data = tempfile::tempdir().expect("a temporary directory");
    let servers = pair(data.path(), &etcd);
    let (client, ids) = create_at_address(&addresses(&servers), &servers[0].server);
    let run = Run::start(client, ids);
    run.go(50);
    let owner = &servers[owner_of(&servers)];
    owner.server.signal("STOP");
    run.go(50);
    owner.server.signal("CONT");
    until("its lease is over", || !owner.has_the_scene());
    run.go(50);
    assert!(run.end().seen.resumed >= 1);
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
    let long = format!("{}:1", "a".repeat(300));
    for advertised in [
        "",
        ":",
        "a",
        "a b:1",
        "größe:1",
        "h:0",
        "h:99999",
        "rhumb://h:1",
        "u@h:1",
        &long,
    ] {
        let wrong = refused(&[
            "http://127.0.0.1:1",
            "--data",
            data,
            "--advertise",
            advertised,
        ]);
        assert!(wrong.contains("give host:port"), "{advertised}: {wrong}");
    }
    for advertised in ["physics.example:4433", "10.0.0.1:1", "[::1]:4433"] {
        let more = ["--directory", "http://127.0.0.1:1", "--data", data];
        let advertise = ["--open", "--check-config", "--advertise", advertised];
        let ended = SERVER.run(&[&advertise[..], &more].concat());
        assert_eq!(ended.code, Some(0), "{}", ended.log);
    }
    let alone = SERVER.run(&["--open", "--check-config", "--advertise", "a:1"]);
    assert_eq!(alone.code, Some(1));
    assert!(alone.log.contains("give --directory too"), "{}", alone.log);
}
