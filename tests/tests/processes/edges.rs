//! Edges as processes, between a server and its members.
//!
//! The commander's run is a function of the tick, as in `durable`: equal digests mean that each of its commands was applied
//! exactly once, whichever process was killed. `KILLS` sets how often, `SEED` the moments.

use std::fs;
use std::net::SocketAddr;
use std::path::Path;
use std::time::{Duration, Instant};

use glam::Vec3;
use rhumb_client::scene::{BodyDesc, Command, CommandError, SceneConfig, Shape, Stepping};
use rhumb_client::{
    Client, CloseCode, JoinMode, JoinOptions, PipelineDepth, StreamChoice, Tick, Tolerance, Trust,
};
use rhumb_netsim::{LinkConfig, UdpRelay};
use rhumb_reckoning::{BodyId, BodyState};
use rhumb_tests::ServerProcess;
use rhumb_transport::DevelopmentPem;

use crate::SERVER;
use crate::access::{Guarded, answer, close_code};
use crate::durable::{
    LONG, Seen, chance, commands, create, create_at, digest_without_server, serve, step,
    take_events, variable,
};

const ANYWHERE: &str = "127.0.0.1:0";

/// The certificate of an edge that is started again.
fn certificate(folder: &Path) -> [String; 4] {
    let made = DevelopmentPem::new(["localhost"]).expect("a valid name");
    let file = |name: &str, text: &str| {
        let path = folder.join(name);
        fs::write(&path, text).expect("it can be written");
        path.display().to_string()
    };
    let (cert, key) = (
        file("cert.pem", &made.certificate),
        file("key.pem", &made.key),
    );
    ["--cert".to_owned(), cert, "--key".to_owned(), key]
}

fn edge(owner: &ServerProcess, listen: &str, more: &[String]) -> ServerProcess {
    let more: Vec<_> = more.iter().map(String::as_str).collect();
    SERVER.edge(owner, listen, &more)
}

/// A way to an edge. As a name does, it may lead elsewhere later.
fn lead(listen: &str, edge: &ServerProcess) -> UdpRelay {
    let listen = listen.parse().expect("an address");
    let relay = UdpRelay::start(listen, edge.address, LinkConfig::PERFECT, 1);
    relay.expect("the address is free")
}

fn observers() -> Vec<String> {
    vec!["--observers".to_owned()]
}

fn observe(place: &ServerProcess, stream: StreamChoice) -> Client {
    let trust = Trust::Fingerprint(place.fingerprint);
    let options = JoinOptions {
        mode: JoinMode::Join,
        stream,
        ..JoinOptions::default()
    };
    let connection = Client::connect(&place.address.to_string(), trust);
    let connection = connection.expect("it is there");
    connection.join_with("pit", options).expect("a scene")
}

/// Waits until a member has all of a tick.
fn reach(client: &mut Client, tick: Tick) {
    let begun = Instant::now();
    while client.statistics().complete < tick {
        let complete = client.statistics().complete;
        assert!(
            begun.elapsed() < LONG,
            "at {complete} instead of {tick} after {LONG:?}"
        );
        client
            .idle(Duration::from_millis(1))
            .expect("the connection is open");
        while client.poll_event().is_some() {}
    }
    client
        .wait(PipelineDepth::LOCKSTEP)
        .expect("a complete tick");
}

/// The greatest distance of a body's centre in two views, metres.
fn apart(one: &Client, other: &Client, ids: &[BodyId]) -> f32 {
    let at = |client: &Client, id: BodyId| {
        let view = client.view();
        view.position(id)
    };
    let distances = ids.iter().filter_map(|id| {
        let (one, other) = (at(one, *id), at(other, *id));
        assert_eq!(one.is_some(), other.is_some(), "{id}");
        Some(one?.distance(other?))
    });
    distances.fold(0.0, f32::max)
}

#[test]
fn members_of_two_edges_have_each_body_within_its_tolerance() {
    let owner = SERVER.serve(ANYWHERE);
    let acting = edge(&owner, ANYWHERE, &[]);
    let watching = edge(&owner, ANYWHERE, &observers());
    let (mut commander, ids) = create(&acting);
    let mut tick = 0;
    let mut run = |commander: &mut Client, ticks: u64| {
        for _ in 0..ticks {
            for command in commands(tick, &ids) {
                commander.command(command).expect("a member");
            }
            step(commander);
            take_events(commander, &mut Seen::default());
            tick += 1;
        }
        Tick::new(tick)
    };
    run(&mut commander, 40);
    let mut exact = observe(&owner, StreamChoice::Full);
    let tolerance = Tolerance::NORMAL;
    let normal = StreamChoice::Within(tolerance);
    let mut members = [
        observe(&watching, normal),
        observe(&watching, StreamChoice::Full),
        observe(&acting, normal),
    ];
    for _ in 0..40 {
        let at = run(&mut commander, 3);
        reach(&mut exact, at);
        for member in &mut members {
            reach(member, at);
            let worst = apart(&exact, member, &ids);
            // Positions are f32.
            assert!(worst <= 0.050_1, "{worst} m at {at}");
        }
    }
    let truth = commander.inspect().expect("the owner answers");
    assert_eq!(truth.truth, digest_without_server(tick, &ids));
}

/// The process that is killed again and again.
#[derive(Clone, Copy, PartialEq)]
enum Victim {
    Owner,
    /// It comes back at its address.
    Edge,
    /// Another edge takes its place.
    EdgeForGood,
}

/// Kills processes under a commander of an edge, while an observer of another edge watches.
fn survives_kills(victim: Victim) {
    let folder = tempfile::tempdir().expect("a temporary directory");
    let data = folder.path().join("data");
    let (kills, seed) = (variable("KILLS", 3), variable("SEED", 1));
    let mut chance = chance(seed);
    let certificate = certificate(folder.path());
    let mut owner = serve(ANYWHERE, &data);
    let owner_at = owner.address.to_string();
    let mut acting = edge(&owner, ANYWHERE, &certificate);
    let mut way = (victim == Victim::EdgeForGood).then(|| lead(ANYWHERE, &acting));
    let address = way.as_ref().map_or(acting.address, UdpRelay::local_addr);
    let watching = edge(&owner, ANYWHERE, &observers());
    let (mut commander, ids) = create_at(address, &acting);
    let (mut seen, mut tick, mut slowest) = (Seen::default(), 0, Duration::ZERO);
    let mut run = |seen: &mut Seen, ticks: u64| {
        for _ in 0..ticks {
            for command in commands(tick, &ids) {
                commander.command(command).expect("the session continues");
            }
            step(&mut commander);
            take_events(&mut commander, seen);
            tick += 1;
        }
        Tick::new(tick)
    };
    run(&mut seen, 20);
    let mut observer = observe(&watching, StreamChoice::Within(Tolerance::NORMAL));
    for _ in 0..kills {
        run(&mut seen, 1 + chance(60));
        let killed = Instant::now();
        match victim {
            Victim::Owner => {
                owner.kill();
                owner = serve(&owner_at, &data);
            }
            Victim::Edge => {
                acting.kill();
                acting = edge(&owner, &address.to_string(), &certificate);
            }
            Victim::EdgeForGood => {
                let other = edge(&owner, ANYWHERE, &certificate);
                acting.kill();
                drop(way.take());
                way = Some(lead(&address.to_string(), &other));
                acting = other;
            }
        }
        let at = run(&mut seen, 2);
        slowest = slowest.max(killed.elapsed());
        reach(&mut observer, at);
    }
    let end = run(&mut seen, 20);
    reach(&mut observer, end);
    assert!(
        seen.resumed >= kills.min(1),
        "seed {seed}: {kills} kills, {} resumptions, back after {slowest:?}",
        seen.resumed
    );
    let truth = commander.inspect().expect("the owner answers");
    assert_eq!(truth.truth, digest_without_server(tick, &ids));
    let mut exact = observe(&owner, StreamChoice::Full);
    reach(&mut exact, end);
    let worst = apart(&exact, &observer, &ids);
    assert!(worst <= 0.050_1, "{worst} m at {end}");
    drop((acting, watching, way));
}

#[test]
fn a_killed_edge_loses_and_doubles_no_command_of_its_members() {
    survives_kills(Victim::Edge);
}

#[test]
fn a_session_goes_on_at_another_edge() {
    survives_kills(Victim::EdgeForGood);
}

#[test]
fn members_of_edges_outlive_a_killed_owner() {
    survives_kills(Victim::Owner);
}

/// A frozen edge hands on unread bytes when it continues, while its member has gone elsewhere.
#[test]
fn an_edge_that_was_frozen_doubles_no_command_when_it_goes_on() {
    let folder = tempfile::tempdir().expect("a temporary directory");
    let certificate = certificate(folder.path());
    let owner = serve(ANYWHERE, &folder.path().join("data"));
    let [frozen, other] = [(); 2].map(|()| edge(&owner, ANYWHERE, &certificate));
    let way = lead(ANYWHERE, &frozen);
    let address = way.local_addr();
    let (mut commander, ids) = create_at(address, &frozen);
    let (mut seen, mut ticks) = (Seen::default(), 0..);
    let mut order = |commander: &mut Client| {
        let tick = ticks.next().expect("there is always another tick");
        for command in commands(tick, &ids) {
            commander.command(command).expect("the session continues");
        }
        tick + 1
    };
    let mut run = |commander: &mut Client, order: &mut dyn FnMut(&mut Client) -> u64| {
        let mut last = 0;
        for _ in 0..20 {
            last = order(commander);
            step(commander);
            take_events(commander, &mut seen);
        }
        last
    };
    run(&mut commander, &mut order);
    frozen.signal("STOP");
    order(&mut commander);
    commander.request_tick().expect("the session continues");
    // The edge has it before the way leads elsewhere.
    let sent = commander.idle(Duration::from_millis(50));
    sent.expect("the session continues");
    drop(way);
    let _way = lead(&address.to_string(), &other);
    run(&mut commander, &mut order);
    frozen.signal("CONT");
    let ticks = run(&mut commander, &mut order);
    assert_eq!(seen.resumed, 1);
    let truth = commander.inspect().expect("the owner answers");
    assert_eq!(
        (truth.tick, truth.truth),
        (Tick::new(ticks), digest_without_server(ticks, &ids))
    );
}

/// A body that its member publishes, in a free-running scene of an edge.
fn publisher(address: SocketAddr, edge: &ServerProcess) -> (Client, BodyId, BodyState) {
    let trust = Trust::Fingerprint(edge.fingerprint);
    let config = SceneConfig {
        stepping: Stepping::FreeRunning,
        ..SceneConfig::default()
    };
    let options = JoinOptions {
        mode: JoinMode::Create(config),
        resume_within: Some(LONG),
        ..JoinOptions::default()
    };
    let connection = Client::connect(&address.to_string(), trust);
    let connection = connection.expect("the edge is there");
    let mut client = connection.join_with("pit", options).expect("a new scene");
    let avatar = BodyDesc::kinematic(Shape::capsule(0.6, 0.3));
    let state = avatar.state().expect("finite");
    let avatar = client.add_body(avatar).expect("a body");
    let taken = client.take_authority(&[avatar], Tolerance::FINE);
    taken.expect("a member may");
    (client, avatar, state)
}

/// Publishes a body at a place until a member of the owner sees it there.
fn publish_to(
    client: &mut Client,
    watcher: &mut Client,
    (avatar, state): (BodyId, BodyState),
) -> Seen {
    let (begun, mut seen) = (Instant::now(), Seen::default());
    let at = Vec3::from_array(state.position());
    loop {
        client
            .publish(&[(avatar, state)])
            .expect("the authority is regained");
        client
            .idle(Duration::from_millis(2))
            .expect("the session continues");
        take_events(client, &mut seen);
        watcher.poll().expect("the owner is there");
        while watcher.poll_event().is_some() {}
        let view = watcher.view();
        if view
            .position(avatar)
            .is_some_and(|had| had.distance(at) <= 0.020_01)
        {
            return seen;
        }
        assert!(begun.elapsed() < LONG, "it stands elsewhere");
    }
}

#[test]
fn a_member_publishes_on_at_another_edge() {
    let folder = tempfile::tempdir().expect("a temporary directory");
    let certificate = certificate(folder.path());
    let owner = SERVER.serve(ANYWHERE);
    let [first, second] = [(); 2].map(|()| edge(&owner, ANYWHERE, &certificate));
    let way = lead(ANYWHERE, &first);
    let address = way.local_addr();
    let (mut client, avatar, state) = publisher(address, &first);
    let mut watcher = observe(&owner, StreamChoice::Full);
    let moved = |metres: f32| {
        let [x, y, z, ..] = state.parts();
        let place = BodyState::new([x + metres, y, z], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        (avatar, place.expect("finite"))
    };
    let seen = publish_to(&mut client, &mut watcher, moved(1.0));
    assert_eq!(seen.resumed, 0);
    first.kill();
    drop(way);
    let _way = lead(&address.to_string(), &second);
    let seen = publish_to(&mut client, &mut watcher, moved(2.0));
    assert_eq!(seen.resumed, 1);
    let held: Vec<_> = client.authority_bodies().collect();
    assert_eq!(held, [avatar]);
    // No command was doubled on the way.
    assert_eq!(client.inspect().expect("the owner answers").bodies, 1);
}

#[test]
fn the_owner_judges_the_tokens_of_an_edge_s_members() {
    let guarded = Guarded::start("edge-tokens");
    let own = guarded.folder.join("edge.token");
    let token = guarded.token("edge", "*", "observer", &[]);
    fs::write(&own, token).expect("it can be written");
    let own = own.display().to_string();
    let edge = SERVER.edge(&guarded.server, ANYWHERE, &["--token", &own]);
    let join = |token: Option<&str>, mode| {
        let trust = Trust::Fingerprint(edge.fingerprint);
        let mut connection = Client::connect(&edge.address.to_string(), trust)?;
        if let Some(token) = token {
            connection = connection.token(token);
        }
        let options = JoinOptions {
            mode,
            ..JoinOptions::default()
        };
        connection.join_with("lobby", options)
    };
    let none = join(None, JoinMode::Join);
    assert_eq!(close_code(none), CloseCode::TOKEN_MISSING);
    let elsewhere = guarded.token("anna", "cellar", "owner", &[]);
    let elsewhere = join(Some(&elsewhere), JoinMode::Join);
    assert_eq!(close_code(elsewhere), CloseCode::TOKEN_SCENE);
    let mut altered = guarded.token("anna", "lobby", "owner", &[]);
    let last = if altered.ends_with('A') { "B" } else { "A" };
    altered.replace_range(altered.len() - 1.., last);
    let altered = join(Some(&altered), JoinMode::Join);
    assert_eq!(close_code(altered), CloseCode::TOKEN_INVALID);
    let owner = guarded.token("anna", "lobby", "owner", &[]);
    let created = join(Some(&owner), JoinMode::CreateOrJoin(Default::default()));
    let mut owner = created.expect("an owner may");
    let observer = guarded.token("bea", "lobby", "observer", &[]);
    let mut observer = join(Some(&observer), JoinMode::Join).expect("an observer may");
    let gravity = || Command::SetGravity { gravity: Vec3::X };
    let refused = answer(&mut observer, gravity());
    assert_eq!(refused, Some(CommandError::NotAllowed));
    assert_eq!(answer(&mut owner, gravity()), None);
    observer.inspect().expect("an observer may");
}

#[test]
fn an_edge_says_what_is_wrong_before_it_starts() {
    let print = "ab".repeat(32);
    let owner = ["edge", "--owner", "127.0.0.1:4433"];
    let known = [&owner[..], &["--fingerprint", &print]].concat();
    for (arguments, reason) in [
        (&owner[..], "--fingerprint"),
        (
            &["edge", "--owner", "nowhere", "--fingerprint", &print],
            "give it as host:port",
        ),
        (
            &[&known[..], &["--token", "/nowhere/token"]].concat(),
            "/nowhere/token",
        ),
        (
            &[&known[..], &["--observers", "--listen", "0.0.0.0:0"]].concat(),
            "--open-to-network",
        ),
        (
            &[&known[..], &["--metrics", "0.0.0.0:0"]].concat(),
            "--open-to-network",
        ),
    ] {
        let ended = SERVER.run(arguments);
        assert_ne!(ended.code, Some(0), "{arguments:?}");
        assert!(ended.log.contains(reason), "{arguments:?}: {}", ended.log);
    }
}

#[test]
fn a_stopped_edge_ends_in_order() {
    let owner = SERVER.serve(ANYWHERE);
    let edge = SERVER.edge(&owner, ANYWHERE, &["--metrics", "127.0.0.1:0"]);
    let (commander, _) = create(&edge);
    edge.signal("TERM");
    let ended = edge.wait();
    assert_eq!(ended.code, Some(0), "{}", ended.log);
    drop(commander);
}
