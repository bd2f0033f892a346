//! A server process, an app that follows its scene, and the truth beside it.
//!
//! The truth is another client, whose stream has every exact state.

use std::io::{BufRead as _, BufReader};
use std::path::PathBuf;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;

use bevy_app::{App, Last, TaskPoolPlugin};
use bevy_ecs::prelude::*;
use bevy_time::{Fixed, Time, TimePlugin, TimeUpdateStrategy};
use bevy_transform::TransformPlugin;
use rhumb_bevy::{
    RhumbBodyId, RhumbClient, RhumbEnded, RhumbJoinFailed, RhumbMessage, RhumbPlugin,
};
use rhumb_client::scene::{SceneConfig, Stepping};
use rhumb_client::{
    BodyId, Client, Event, JoinMode, JoinOptions, PipelineDepth, ServerConnection, StreamChoice,
    Tick, Trust,
};

/// Frames after which a test gives up; each may take a hundredth of a second.
const FRAMES_MAX: u32 = 3_000;
/// Time between two frames of an app that follows the server's clock.
const FRAME: Duration = Duration::from_millis(10);

/// A server process, which ends when dropped.
pub(crate) struct Server {
    child: Child,
    address: String,
    fingerprint: String,
    /// Open, so that what the server prints has a reader.
    _out: BufReader<ChildStdout>,
}

impl Server {
    pub(crate) fn start() -> Self {
        let built =
            PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../target/debug/rhumb-test-server");
        let path = std::env::var_os("RHUMB_TEST_SERVER").map_or(built, PathBuf::from);
        let mut child = Command::new(&path)
            .args(["--open", "--listen", "127.0.0.1:0", "--log", "off"])
            .stdout(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| {
                panic!(
                    "the server {} does not start: {error}. Build it with `cargo build -p rhumb-tests --bin \
                     rhumb-test-server` in the main workspace, or name one in RHUMB_TEST_SERVER",
                    path.display()
                )
            });
        let mut out = BufReader::new(child.stdout.take().expect("standard output is piped"));
        let (mut address, mut fingerprint) = (None, None);
        while address.is_none() || fingerprint.is_none() {
            let mut line = String::new();
            let read = out.read_line(&mut line).expect("the output is text");
            assert!(
                read > 0,
                "the server ended before it printed its address and its fingerprint"
            );
            let line = line.trim_end();
            address = address.or(line.strip_prefix("listening on ").map(str::to_owned));
            fingerprint = fingerprint.or(line.strip_prefix("fingerprint ").map(str::to_owned));
        }
        Self {
            child,
            address: address.expect("read above"),
            fingerprint: fingerprint.expect("read above"),
            _out: out,
        }
    }

    pub(crate) fn connect(&self) -> ServerConnection {
        let fingerprint = self.fingerprint.parse().expect("a fingerprint");
        Client::connect(&self.address, Trust::Fingerprint(fingerprint)).expect("the server answers")
    }

    /// Joins a scene, which is created with this stepping unless it exists.
    pub(crate) fn join(&self, scene: &str, stepping: Stepping, stream: StreamChoice) -> Client {
        let config = SceneConfig {
            stepping,
            ..SceneConfig::default()
        };
        let options = JoinOptions {
            mode: JoinMode::CreateOrJoin(config),
            stream,
            whole_ticks: true,
            smooth: false,
            ..JoinOptions::default()
        };
        self.connect()
            .join_with(scene, options)
            .expect("the scene is joined")
    }

    /// Ends the process at once, as a crash would.
    pub(crate) fn kill(&mut self) {
        self.child.kill().expect("the process is ours");
        self.child.wait().expect("the process has ended");
    }

    /// Sends a signal by its name.
    pub(crate) fn signal(&self, name: &str) {
        let sent = Command::new("kill")
            .args([name, &self.child.id().to_string()])
            .status();
        assert!(sent.expect("the command `kill`").success());
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // It may have ended already.
        let _ended = self.child.kill();
        let _ended = self.child.wait();
    }
}

/// Messages that an app has read.
#[derive(Default, Resource)]
pub(crate) struct Read {
    pub(crate) events: Vec<Event>,
    pub(crate) endings: Vec<String>,
    pub(crate) failures: Vec<String>,
}

fn read(
    mut read: ResMut<Read>,
    mut events: MessageReader<RhumbMessage>,
    mut endings: MessageReader<RhumbEnded>,
    mut failures: MessageReader<RhumbJoinFailed>,
) {
    read.events
        .extend(events.read().map(|message| message.event.clone()));
    read.endings
        .extend(endings.read().map(|message| message.error.to_string()));
    read.failures
        .extend(failures.read().map(|message| message.error.to_string()));
}

/// An app without a window that has the plug-in. Each update of it takes one fixed step, a sixtieth of a second.
pub(crate) fn app(depth: PipelineDepth) -> App {
    let mut app = App::new();
    let step = Duration::from_secs_f64(1.0 / 60.0);
    app.add_plugins((
        TaskPoolPlugin::default(),
        TimePlugin,
        TransformPlugin,
        RhumbPlugin { depth },
    ))
    .insert_resource(Time::<Fixed>::from_duration(step))
    .insert_resource(TimeUpdateStrategy::ManualDuration(step))
    .init_resource::<Read>()
    .add_systems(Last, read);
    // The first update has no time in it.
    app.update();
    app
}

/// The app's scene.
pub(crate) fn rhumb(app: &mut App) -> Mut<'_, RhumbClient> {
    app.world_mut().resource_mut::<RhumbClient>()
}

pub(crate) fn messages(app: &App) -> &Read {
    app.world().resource::<Read>()
}

/// The entity of a body, if it has one.
pub(crate) fn entity(app: &mut App, id: BodyId) -> Option<Entity> {
    let mut bodies = app.world_mut().query::<(Entity, &RhumbBodyId)>();
    let mut found = bodies.iter(app.world()).filter(|(_, body)| body.id() == id);
    let entity = found.next().map(|(entity, _)| entity);
    assert!(found.next().is_none(), "one entity for a body");
    entity
}

/// The value of a component of a body's entity.
pub(crate) fn component<T: Component + Copy>(app: &mut App, id: BodyId) -> T {
    let entity = entity(app, id).expect("the body has an entity");
    *app.world()
        .get::<T>(entity)
        .expect("the entity has the component")
}

/// Updates an app, with time for the server between its frames, until something holds.
pub(crate) fn run_until(app: &mut App, what: &str, mut holds: impl FnMut(&mut App) -> bool) {
    for _ in 0..FRAMES_MAX {
        app.update();
        if holds(app) {
            return;
        }
        pass(app);
    }
    panic!("not in {FRAMES_MAX} frames: {what}");
}

/// Passes the time of a frame.
fn pass(app: &mut App) {
    match app.world_mut().get_resource_mut::<RhumbClient>() {
        // A client that has ended returns at once, and has nothing to wait for.
        Some(mut rhumb) if !rhumb.is_ended() => {
            let _ended = rhumb.inner().idle(FRAME);
        }
        _ => std::thread::yield_now(),
    }
}

/// Lets the client of the truth show a tick.
pub(crate) fn show_tick(truth: &mut Client, tick: Tick) {
    while truth.statistics().complete < tick {
        truth
            .idle(Duration::from_millis(1))
            .expect("the server goes on");
    }
    let shown = truth
        .wait(PipelineDepth::LOCKSTEP)
        .expect("the server goes on");
    assert_eq!(shown, tick, "the truth is at the tick of the copy");
}
