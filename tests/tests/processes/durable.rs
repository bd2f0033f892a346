//! Servers with a data directory that are killed under load.
//!
//! A client goes on with its session. Its run is a function of the tick, so that the same run can be made without a server: equal digests mean
//! that no command was lost, doubled or moved to another tick. `KILLS` sets how often the server is killed.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use glam::Vec3;
use rhumb_client::scene::{BodyDesc, BodyKind, Command, SceneConfig, Shape, ShapeId};
use rhumb_client::{Client, ClientError, Event, JoinMode, JoinOptions, PipelineDepth, Tick, Trust};
use rhumb_reckoning::{BodyId, BodyState};
use rhumb_server::Scene;
use rhumb_tests::ServerProcess;

use crate::SERVER;

const SCENE: &str = "pit";
/// Bodies at first; one more every tenth tick.
const BODIES: u64 = 40;

fn kills() -> u64 {
    let kills = std::env::var("KILLS").ok();
    kills.and_then(|kills| kills.parse().ok()).unwrap_or(3)
}

/// The commands before a tick's step.
fn commands(tick: u64, ids: &[BodyId]) -> Vec<Command> {
    let mut commands = Vec::new();
    let body = |place: u64, kind, shape| {
        let id = ids[place as usize];
        let height = if place == 0 {
            0.0
        } else {
            1.5 + (place % 30) as f32 * 1.1
        };
        let position = [(place % 3) as f32 * 0.3, height, (place % 2) as f32 * 0.3];
        let motion = BodyState::new(position, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        Command::AddBody {
            desc: BodyDesc::plain(id, kind, ShapeId(shape)),
            motion: motion.expect("finite"),
        }
    };
    if tick == 0 {
        for (id, shape) in [Shape::cuboid(40.0, 1.0, 40.0), Shape::ball(0.5)]
            .into_iter()
            .enumerate()
        {
            let id = ShapeId(id as u32);
            commands.push(Command::AddShape { id, shape });
        }
        commands.push(body(0, BodyKind::Static, 0));
        commands.extend((1..BODIES).map(|place| body(place, BodyKind::Dynamic, 1)));
    }
    if tick % 10 == 9 && BODIES + tick / 10 < ids.len() as u64 {
        commands.push(body(BODIES + tick / 10, BodyKind::Dynamic, 1));
    }
    let id = ids[(1 + tick % (BODIES - 1)) as usize];
    let impulse = Vec3::new((tick % 7) as f32 - 3.0, 4.0, (tick % 5) as f32 - 2.0) * 90.0;
    commands.push(Command::Impulse { id, impulse });
    commands
}

/// The digest of the same run without a server.
fn digest_without_server(ticks: u64, ids: &[BodyId]) -> u64 {
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
struct Seen {
    resumed: u64,
    durable: u64,
}

fn take_events(client: &mut Client, seen: &mut Seen) {
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
fn step(client: &mut Client) {
    let mut stepped = client.advance(PipelineDepth::LOCKSTEP);
    while let Err(ClientError::Timeout { .. }) = stepped {
        stepped = client.wait(PipelineDepth::LOCKSTEP);
    }
    stepped.expect("the scene goes on");
}

fn serve(listen: &str, data: &Path, identity: &Path) -> ServerProcess {
    let text = |path: &Path| path.to_str().expect("text").to_owned();
    let (data, cert, key) = (
        text(data),
        text(&identity.join("cert.pem")),
        text(&identity.join("key.pem")),
    );
    SERVER.serve_with(listen, &["--data", &data, "--cert", &cert, "--key", &key])
}

fn write_identity(directory: &Path) {
    let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).expect("a certificate");
    std::fs::write(directory.join("cert.pem"), made.cert.pem()).expect("a writable directory");
    let key = made.signing_key.serialize_pem();
    std::fs::write(directory.join("key.pem"), key).expect("a writable directory");
}

#[test]
fn a_server_killed_at_any_moment_loses_and_doubles_no_command() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    write_identity(directory.path());
    let data = directory.path().join("data");
    let mut server = serve("127.0.0.1:0", &data, directory.path());
    let listen = server.address.to_string();
    let trust = Trust::Fingerprint(server.fingerprint);
    let options = JoinOptions {
        mode: JoinMode::Create(SceneConfig::default()),
        resume_within: Duration::from_secs(60),
        ..JoinOptions::default()
    };
    let connection = Client::connect(&listen, trust).expect("the server is there");
    let mut client = connection.join_with(SCENE, options).expect("a new scene");
    let ids = client.new_ids(4_000).expect("enough indices");
    let (stop, ticks) = (
        Arc::new(AtomicBool::new(false)),
        Arc::new(AtomicU64::new(0)),
    );
    let (ended, shown, of_client) = (Arc::clone(&stop), Arc::clone(&ticks), ids.clone());
    let running = thread::spawn(move || {
        let mut seen = Seen::default();
        let mut tick = 0;
        while !ended.load(Ordering::Relaxed) {
            for command in commands(tick, &of_client) {
                client.command(command).expect("the session goes on");
            }
            step(&mut client);
            take_events(&mut client, &mut seen);
            tick += 1;
            shown.store(tick, Ordering::Relaxed);
        }
        let truth = client.inspect().expect("the server answers");
        (tick, truth, seen)
    });
    let mut slowest = Duration::ZERO;
    for kill in 0..kills() {
        let before = ticks.load(Ordering::Relaxed);
        while ticks.load(Ordering::Relaxed) < before + 20 + kill * 37 % 90 {
            assert!(!running.is_finished(), "the client failed");
            thread::yield_now();
        }
        server.kill();
        let killed = Instant::now();
        let at = ticks.load(Ordering::Relaxed);
        server = serve(&listen, &data, directory.path());
        while ticks.load(Ordering::Relaxed) < at + 2 {
            assert!(!running.is_finished(), "the client failed");
            thread::yield_now();
        }
        slowest = slowest.max(killed.elapsed());
    }
    stop.store(true, Ordering::Relaxed);
    let (tick, truth, seen) = running.join().expect("the client's thread");
    println!(
        "{tick} ticks, {} resumptions, the slowest after {slowest:?}",
        seen.resumed
    );
    assert_eq!(truth.tick, Tick::new(tick));
    assert_eq!(truth.truth, digest_without_server(tick, &ids));
    assert!(seen.resumed >= kills().min(1) && seen.durable > 0);
    server.kill();
    let data = data.to_str().expect("text");
    let checked = SERVER.run(&["check", data]);
    assert_eq!(checked.code, Some(0), "{}{}", checked.out, checked.log);
    assert!(checked.out.starts_with("pit: tick "), "{}", checked.out);
    let replayed = SERVER.run(&["replay", data, SCENE]);
    assert_eq!(replayed.code, Some(0), "{}{}", replayed.out, replayed.log);
}
