//! Scenes in worker processes, which are stopped, killed, and broken.
//!
//! Every wait is for an event, with a time limit.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use rhumb_client::scene::{BodyDesc, SceneConfig, Shape, Stepping};
use rhumb_client::{
    Client, ClientError, Event, JoinMode, JoinOptions, OpenError, PipelineDepth, Refusals, Tick,
    Trust,
};
use rhumb_protocol::Ending;
use rhumb_protocol::message::Denial;
use rhumb_protocol::scene::CommandError;
use rhumb_protocol::session::CloseCode;
use rhumb_tests::{ServerProcess, signal};

use crate::SERVER;
use crate::durable::{
    EndedRun, LONG, Run, Seen, check, commands, create, digest_without_server, step, take_events,
    until, variable,
};
use crate::hostile_load::{free_address, requested, uncrowded};

/// Bodies at one point: their first step does not end in the time that it has.
const CROWD: usize = 5_000;

fn serve(more: &[&str]) -> ServerProcess {
    SERVER.serve_with("127.0.0.1:0", &[&["--workers", "processes"], more].concat())
}

fn join(server: &ServerProcess, scene: &str, stepping: Stepping) -> Client {
    let config = SceneConfig {
        stepping,
        ..SceneConfig::default()
    };
    let options = JoinOptions {
        mode: JoinMode::CreateOrJoin(config),
        refusals: Refusals::Events,
        ..JoinOptions::default()
    };
    let trust = Trust::Fingerprint(server.fingerprint);
    let connection = Client::connect_within(&server.address.to_string(), trust, LONG);
    let joined = connection.and_then(|connection| connection.join_with(scene, options));
    joined.unwrap_or_else(|error| panic!("{scene}: {error}"))
}

/// Steps a scene so often.
fn advance(client: &mut Client, ticks: u64) {
    for _ in 0..ticks {
        client.advance(PipelineDepth::LOCKSTEP).expect("it steps");
    }
}

/// The worker processes of a server.
fn workers(server: &ServerProcess) -> BTreeSet<u32> {
    let tasks = format!("/proc/{}/task", server.id());
    let tasks = fs::read_dir(tasks).expect("the server runs");
    let children =
        tasks.filter_map(|task| fs::read_to_string(task.ok()?.path().join("children")).ok());
    let children: Vec<String> = children.collect();
    let numbers = children.iter().flat_map(|text| text.split_whitespace());
    numbers
        .map(|number| number.parse().expect("a number"))
        .collect()
}

/// Waits until every command of a client is durable, and hands over the events until then.
fn until_durable(client: &mut Client, mut take: impl FnMut(&Event)) {
    let all = client.last_command().map_or(0, |last| last + 1);
    let (end, mut durable) = (Instant::now() + LONG, 0);
    while durable < all {
        assert!(
            Instant::now() < end,
            "{durable} of {all} commands are durable"
        );
        client
            .idle(Duration::from_millis(10))
            .expect("it continues");
        while let Some((_, event)) = client.poll_event() {
            take(&event);
            if let Event::Durable { commands, .. } = event {
                durable = commands;
            }
        }
    }
}

/// The one worker process that a server has beside these.
fn new_worker(server: &ServerProcess, before: &BTreeSet<u32>) -> u32 {
    let now = workers(server);
    let mut new = now.difference(before);
    let worker = *new.next().expect("a new process");
    assert_eq!(new.next(), None);
    worker
}

/// True if a process runs; one that was not waited for does not.
fn runs(process: u32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{process}/stat"));
    stat.is_ok_and(|stat| {
        !stat
            .rsplit_once(')')
            .is_some_and(|(_, rest)| rest.starts_with(" Z"))
    })
}

/// The end of a client's connection, while another client's scene steps.
fn end_beside(victim: &mut Client, ended: &mut Client) -> ClientError {
    let end = Instant::now() + LONG;
    loop {
        advance(victim, 1);
        if let Err(error) = ended.idle(Duration::from_millis(1)) {
            return error;
        }
        assert!(Instant::now() < end, "the connection does not end");
    }
}

fn assert_lost(error: &ClientError) {
    let lost = Ending::Closed(CloseCode::SCENE_LOST.0);
    assert!(
        matches!(error, ClientError::Ended(ending) if *ending == lost),
        "{error}"
    );
}

#[test]
fn tenants_have_processes_of_their_own_which_end_with_their_scenes() {
    let server = serve(&[]);
    let none = BTreeSet::new();
    assert_eq!(workers(&server), none, "a server without scenes has none");
    let team = join(&server, "team/1", Stepping::Lockstep);
    let of_team = workers(&server);
    assert_eq!(of_team.len(), 1);
    let second = join(&server, "team/2", Stepping::Lockstep);
    assert_eq!(workers(&server), of_team);
    let other = join(&server, "other/1", Stepping::Lockstep);
    let alone = join(&server, "alone", Stepping::Lockstep);
    let apart = join(&server, "apart", Stepping::Lockstep);
    assert_eq!(workers(&server).len(), 4);
    for mut client in [team, second, other, alone, apart] {
        client.delete().expect("an owner may");
    }
    until("processes without scenes end", || {
        workers(&server).is_empty()
    });
}

#[test]
fn scenes_without_a_tenant_share_a_process_if_the_operator_says_so() {
    let server = serve(&["--share-worker"]);
    let mut clients =
        ["alone", "apart", "team/1"].map(|scene| join(&server, scene, Stepping::Lockstep));
    assert_eq!(workers(&server).len(), 2);
    clients.iter_mut().for_each(|client| advance(client, 5));
}

#[test]
fn a_step_that_does_not_end_ends_its_process_and_no_other() {
    let metrics = free_address();
    let directory = tempfile::tempdir().expect("a temporary directory");
    let flights = directory.path().join("flights");
    let flight = flights.to_str().expect("text");
    let config = uncrowded(directory.path());
    let server = serve(&[
        "--config",
        &config,
        "--metrics",
        &metrics,
        "--flight",
        flight,
    ]);
    let mut victim = join(&server, "victim/1", Stepping::Lockstep);
    advance(&mut victim, 10);
    let before = workers(&server);
    let mut attacker = join(&server, "attacker/1", Stepping::FreeRunning);
    let process = new_worker(&server, &before);
    let balls = (0..CROWD).map(|_| BodyDesc::dynamic(Shape::ball(0.5)));
    attacker.add_bodies(balls).expect("they are bodies");
    attacker.flush();
    assert_lost(&end_beside(&mut victim, &mut attacker));
    assert!(!runs(process), "it takes no more processor time");
    assert_eq!(workers(&server), before);
    // The name is free at once.
    let mut again = join(&server, "attacker/1", Stepping::Lockstep);
    advance(&mut again, 10);
    assert!(requested(&metrics, "/health").starts_with("HTTP/1.1 200 OK"));
    for line in [
        "rhumb_worker_deaths_total 1",
        "rhumb_workers 2",
        "rhumb_scenes_quarantined 0",
        "rhumb_scene_members{scene=\"victim/1\"} 1",
        "rhumb_scene_tick{scene=\"attacker/1\"} 10",
    ] {
        // A process hands over its figures four times a second.
        until(line, || {
            requested(&metrics, "/metrics")
                .lines()
                .any(|have| have == line)
        });
    }
    assert_flight(&flights);
}

/// The flight recorder has the commands, and the step that did not end.
fn assert_flight(flights: &Path) {
    let file = || {
        fs::read_dir(flights).ok()?.find_map(|entry| {
            let path = entry.ok()?.path();
            path.to_string_lossy().ends_with(".flight").then_some(path)
        })
    };
    until("a flight recorder is written", || file().is_some());
    let file = file().expect("a file");
    let printed = SERVER.run(&["flight", file.to_str().expect("text")]);
    assert_eq!(printed.code, Some(0), "{}", printed.log);
    let lines: Vec<&str> = printed.out.lines().collect();
    assert_eq!(lines[0], "scene attacker/1");
    assert_eq!(
        lines[1],
        "cause the scene did not answer and its process was killed"
    );
    assert!(lines.iter().any(|line| line.contains("AddBody")));
    let last = lines.last().expect("it has lines");
    assert!(last.contains("step from tick"), "{last}");
}

#[test]
fn a_durable_scene_whose_step_does_not_end_goes_on_without_the_commands_before_it() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let data = directory.path().join("data");
    let config = uncrowded(directory.path());
    let server = serve(&["--config", &config, "--data", data.to_str().expect("text")]);
    let mut client = join(&server, "crowd/1", Stepping::Lockstep);
    let first = client.add_body(BodyDesc::dynamic(Shape::ball(0.5)));
    let first = first.expect("a body");
    advance(&mut client, 10);
    let before = client.inspect().expect("the server answers");
    let balls = (0..CROWD).map(|_| BodyDesc::dynamic(Shape::ball(0.5)).at(50.0, 0.0, 0.0));
    client.add_bodies(balls).expect("they are bodies");
    step(&mut client);
    let (mut refused, mut resumed) = (0, 0);
    until_durable(&mut client, |event| match event {
        Event::Refused { error, .. } => {
            assert_eq!(*error, CommandError::EngineFailed);
            refused += 1;
        }
        Event::Resumed(_) => resumed += 1,
        _ => {}
    });
    // On a machine with other work, the process may be killed once more while it restores the scene.
    assert!(resumed >= 1);
    assert!(
        refused > 0,
        "the client learns that its bodies are not there"
    );
    let after = client.inspect().expect("the server answers");
    assert_eq!(after.bodies, before.bodies);
    assert_eq!(after.tick, before.tick.next());
    advance(&mut client, 10);
    assert!(client.view().position(first).is_some());
    let last = client.add_body(BodyDesc::dynamic(Shape::ball(0.5)).at(9.0, 0.0, 0.0));
    last.expect("another body");
    let truth = client.inspect().expect("the server answers").truth;
    until_durable(&mut client, |_| ());
    server.signal("TERM");
    assert_eq!(server.wait().code, Some(0));
    let checked = check(&data);
    assert_eq!(checked.code, Some(0), "{}{}", checked.out, checked.log);
    let line = format!("tick 21 digest {truth:016x}");
    assert!(checked.out.contains(&line), "{line}: {}", checked.out);
}

#[test]
fn a_crowd_is_refused_and_its_scene_and_process_continue() {
    let server = serve(&[]);
    let mut client = join(&server, "crowd/1", Stepping::Lockstep);
    let process = new_worker(&server, &BTreeSet::new());
    let balls = (0..CROWD).map(|_| BodyDesc::dynamic(Shape::ball(0.5)));
    client.add_bodies(balls).expect("they are bodies");
    advance(&mut client, 3);
    let mut refused = 0;
    while let Some((_, event)) = client.poll_event() {
        if let Event::Refused { error, .. } = event {
            assert_eq!(error, CommandError::TooCrowded);
            refused += 1;
        }
    }
    let inspection = client.inspect().expect("the server answers");
    assert_eq!(inspection.tick, Tick::new(3));
    assert_eq!(inspection.bodies as usize + refused, CROWD);
    assert!(runs(process) && refused > CROWD / 2, "{refused}");
}

#[test]
fn scenes_that_begin_at_once_in_many_processes_keep_to_the_limit_of_the_server() {
    const SCENES: usize = 3;
    let directory = tempfile::tempdir().expect("a temporary directory");
    let file = directory.path().join("few.toml");
    fs::write(&file, format!("[limits]\nscenes = {SCENES}\n")).expect("a temporary file");
    let server = serve(&["--config", file.to_str().expect("text")]);
    let options = || JoinOptions {
        mode: JoinMode::Create(SceneConfig::default()),
        ..JoinOptions::default()
    };
    let trust = Trust::Fingerprint(server.fingerprint);
    let address = server.address.to_string();
    let joins = (0..2 * SCENES).map(|tenant| {
        let connection = Client::connect_within(&address, trust.clone(), LONG);
        let connection = connection.expect("it is there");
        thread::spawn(move || connection.join_with(&format!("tenant{tenant}/1"), options()))
    });
    let joins: Vec<_> = joins.collect();
    let joined = joins.into_iter().map(|join| join.join().expect("it ends"));
    let (joined, denied): (Vec<_>, Vec<_>) = joined.partition(Result::is_ok);
    assert!(
        joined.len() <= SCENES && !joined.is_empty(),
        "{}",
        joined.len()
    );
    for denied in denied {
        let denied = denied.err();
        let is_full = matches!(&denied, Some(OpenError::Denied { denial, .. }) if *denial == Denial::TooManyScenes);
        assert!(is_full, "{denied:?}");
    }
}

#[test]
fn a_process_that_is_stopped_is_killed() {
    let server = serve(&[]);
    let mut victim = join(&server, "victim/1", Stepping::Lockstep);
    let before = workers(&server);
    let mut client = join(&server, "stopped/1", Stepping::FreeRunning);
    let process = new_worker(&server, &before);
    signal(process, "STOP");
    assert_lost(&end_beside(&mut victim, &mut client));
    assert!(!runs(process));
}

#[test]
fn a_process_that_needs_too_much_memory_ends_alone() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let config = directory.path().join("server.toml");
    fs::write(&config, "[limits]\nworker_memory_mib = 64\n").expect("it can be written");
    let server = serve(&["--config", config.to_str().expect("text")]);
    let mut victim = join(&server, "victim/1", Stepping::Lockstep);
    advance(&mut victim, 1);
    let mut client = join(&server, "large/1", Stepping::Lockstep);
    let balls = (0..100_000_u32).map(|place| {
        let (row, column) = ((place / 300) as f32, (place % 300) as f32);
        BodyDesc::dynamic(Shape::ball(0.5)).at(row * 2.0, 0.0, column * 2.0)
    });
    client.add_bodies(balls).expect("they are bodies");
    client.flush();
    assert_lost(&end_beside(&mut victim, &mut client));
    advance(&mut victim, 10);
}

#[test]
fn a_process_killed_under_load_loses_and_doubles_no_command() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let data = directory.path().join("data");
    let config = directory.path().join("server.toml");
    fs::write(&config, "[limits]\nworker_restarts = 1000\n").expect("it can be written");
    let server = serve(&[
        "--data",
        data.to_str().expect("text"),
        "--config",
        config.to_str().expect("text"),
    ]);
    let kills = variable("KILLS", 3);
    let (client, ids) = create(&server);
    // Before its creation is durable, a scene can be lost.
    let run = Run::counting(client, ids, |seen| seen.durable > 0);
    let mut slowest = Duration::ZERO;
    for kill in 0..kills {
        run.go(2 + kill * 37 % 100);
        let process = workers(&server).first().copied().expect("a process");
        signal(process, "KILL");
        let killed = Instant::now();
        until("the process ends", || !runs(process));
        run.go(2);
        slowest = slowest.max(killed.elapsed());
    }
    let EndedRun { tick, seen, .. } = run.end();
    println!(
        "{tick} ticks, {kills} kills, {} resumptions, the slowest after {slowest:?}",
        seen.resumed
    );
    assert!(seen.resumed >= kills.min(1) && seen.durable > 0);
    server.signal("TERM");
    assert_eq!(server.wait().code, Some(0));
    let checked = check(&data);
    assert_eq!(checked.code, Some(0), "{}{}", checked.out, checked.log);
}

#[test]
fn a_tenant_whose_process_dies_again_and_again_is_refused() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let config = directory.path().join("server.toml");
    fs::write(&config, "[limits]\nworker_restarts = 1\n").expect("it can be written");
    let server = serve(&["--config", config.to_str().expect("text")]);
    for _ in 0..2 {
        let mut client = join(&server, "frail/1", Stepping::FreeRunning);
        let process = workers(&server).first().copied().expect("a process");
        signal(process, "ABRT");
        let ended = loop {
            if let Err(error) = client.idle(Duration::from_millis(1)) {
                break error;
            }
        };
        assert_lost(&ended);
    }
    let trust = Trust::Fingerprint(server.fingerprint);
    let connection = Client::connect(&server.address.to_string(), trust);
    let refused = connection
        .and_then(|connection| connection.join("frail/1"))
        .err();
    let quarantined = Ending::Closed(CloseCode::SCENE_QUARANTINED.0);
    assert!(
        matches!(refused, Some(OpenError::Client(ClientError::Ended(ending))) if ending == quarantined),
        "{refused:?}"
    );
    advance(&mut join(&server, "other/1", Stepping::Lockstep), 5);
}

#[test]
fn a_server_that_stops_leaves_no_process() {
    for name in ["TERM", "INT", "KILL"] {
        let server = serve(&[]);
        let mut clients = ["a", "b/1", "b/2"].map(|scene| join(&server, scene, Stepping::Lockstep));
        clients.iter_mut().for_each(|client| advance(client, 3));
        let workers = workers(&server);
        assert_eq!(workers.len(), 2);
        server.signal(name);
        let ended = server.wait();
        assert_eq!(ended.code, (name != "KILL").then_some(0), "{}", ended.log);
        until("no process stays", || {
            workers.iter().all(|worker| !runs(*worker))
        });
    }
}

#[test]
fn a_server_killed_with_its_processes_starts_again_in_their_directory() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let data = directory.path().join("data");
    let more = [
        "--data",
        data.to_str().expect("text"),
        "--workers",
        "processes",
    ];
    let server = SERVER.serve_with("127.0.0.1:0", &more);
    let listen = server.address.to_string();
    let (mut client, ids) = create(&server);
    let mut seen = Seen::default();
    let mut tick = 0;
    let mut play = |client: &mut Client, ticks: u64| {
        let until = tick + ticks;
        // Before its creation is durable, a scene can be lost.
        while tick < until || seen.durable == 0 {
            for command in commands(tick, &ids) {
                client.command(command).expect("the session continues");
            }
            step(client);
            take_events(client, &mut seen);
            tick += 1;
        }
        tick
    };
    play(&mut client, 50);
    server.kill();
    let server = SERVER.serve_with(&listen, &more);
    let tick = play(&mut client, 50);
    let truth = client.inspect().expect("the server answers");
    assert_eq!(
        (truth.tick, truth.truth),
        (Tick::new(tick), digest_without_server(tick, &ids))
    );
    drop(server);
}
