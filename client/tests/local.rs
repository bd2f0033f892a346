//! Scenes whose server is in the same process.
//!
//! They are equal to a bare engine's, shared by threads, and end without harm.

use std::sync::Arc;
use std::thread;
use std::time::Duration;

use rhumb_client::glam::Vec3;
use rhumb_client::scene::{
    BodyDesc, Command, Hull, Joint, JointFrame, JointId, JointKind, Mass, Mesh, SceneConfig, Shape,
    Stepping,
};
use rhumb_client::{
    BodyId, Client, ClientError, Denial, ErrorBound, Event, JoinMode, JoinOptions, LocalServer,
    Metres, Misuse, PipelineDepth, Refusals, RenderTime, StreamChoice, Tick, Tolerance,
};
use rhumb_scene::{Hook, Hooks, Instant, Scene, SceneRouter, SceneSettings};
use rhumb_sims::by_name;

/// Both ways to run a server.
fn servers() -> [LocalServer; 2] {
    [
        LocalServer::new(),
        LocalServer::spawn().expect("a thread can start"),
    ]
}

/// The commands of each tick of a script.
fn commands(bodies: u32, ticks: u64) -> (SceneConfig, Vec<Vec<Command>>) {
    let mut script = by_name("ball-pit", bodies, 7).expect("an existing script");
    let commands = (0..ticks).map(|tick| {
        let mut out = Vec::new();
        script.commands(Tick::new(tick), &mut out);
        out
    });
    let commands = commands.collect();
    (script.config(), commands)
}

/// The digest of a script without client or server.
fn digest_alone(config: SceneConfig, commands: &[Vec<Command>]) -> u64 {
    let mut scene = Scene::new(config).expect("a valid config");
    for tick in commands {
        for command in tick {
            scene.apply(command).expect("a valid command");
        }
        scene.step().expect("the engine is sound");
    }
    scene.digest().value()
}

/// Scenes with these hooks.
fn scenes_with(hooks: Hooks) -> SceneRouter {
    SceneRouter::new(SceneSettings {
        hooks: Some(hooks),
        ..SceneSettings::new(|| Instant::ZERO)
    })
}

#[test]
fn a_scene_is_equal_to_that_of_a_bare_engine_whichever_thread_steps() {
    let (config, commands) = commands(100, 240);
    let alone = digest_alone(config, &commands);
    for server in servers() {
        for depth in [PipelineDepth::LOCKSTEP, PipelineDepth::PIPELINED] {
            let scene = format!("pit/{depth:?}").to_lowercase();
            let options = JoinOptions {
                mode: JoinMode::Create(config),
                ..JoinOptions::default()
            };
            let scene: String = scene.chars().filter(char::is_ascii_alphanumeric).collect();
            let mut client = server
                .connect()
                .join_with(&scene, options)
                .expect("a new scene");
            client.new_ids(101).expect("enough indices");
            for tick in &commands {
                for command in tick {
                    client
                        .command(command.clone())
                        .expect("the connection is open");
                }
                client.advance(depth).expect("the scene runs");
            }
            client
                .wait(PipelineDepth::LOCKSTEP)
                .expect("the scene runs");
            let truth = client.inspect().expect("the server answers");
            assert_eq!((truth.tick, truth.truth), (Tick::new(240), alone));
            assert_eq!(client.statistics().stream.mismatches, 0);
            client.delete().expect("the scene exists");
        }
    }
}

#[test]
fn clients_on_two_threads_share_a_scene() {
    for server in servers() {
        let mut driver = server.connect().join("shared").expect("a new scene");
        let ball = BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 10.0, 0.0);
        let ball = driver.add_body(ball).expect("room for a body");
        driver.advance(PipelineDepth::LOCKSTEP).expect("it steps");
        let observing = thread::spawn(move || {
            let mut observer = server.connect().join("shared").expect("a scene");
            while observer
                .view()
                .time()
                .is_none_or(|at| at.tick < Tick::new(60))
            {
                observer
                    .idle(Duration::from_millis(1))
                    .expect("the scene runs");
                observer
                    .wait(PipelineDepth::LOCKSTEP)
                    .expect("the scene runs");
            }
            observer.view().position(ball).expect("a body of the scene")
        });
        for _ in 1..60 {
            driver.advance(PipelineDepth::LOCKSTEP).expect("it steps");
        }
        let seen = observing.join().expect("the observer ends");
        assert_eq!(driver.view().position(ball), Some(seen));
    }
}

#[test]
fn a_free_running_scene_steps_in_real_time() {
    let config = SceneConfig {
        stepping: Stepping::FreeRunning,
        ..SceneConfig::default()
    };
    let options = JoinOptions {
        mode: JoinMode::Create(config),
        ..JoinOptions::default()
    };
    for server in servers() {
        let mut client = server
            .connect()
            .join_with("free", options)
            .expect("a new scene");
        let ball = BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 10.0, 0.0);
        let ball = client.add_body(ball).expect("room for a body");
        client.flush();
        let falls = |client: &Client| client.view().position(ball).is_some_and(|at| at.y < 9.0);
        while !falls(&client) {
            client
                .idle(Duration::from_millis(5))
                .expect("the scene runs");
            client.poll().expect("the scene runs");
        }
    }
}

#[test]
fn a_large_scene_can_be_joined() {
    for server in servers() {
        let mut first = server.connect().join("large").expect("a new scene");
        let at = |place: u32| [(place % 100) as f32 * 3.0, 1.0, (place / 100) as f32 * 3.0];
        let body = |place| {
            let [x, y, z] = at(place);
            BodyDesc::fixed(Shape::ball(0.5)).at(x, y, z)
        };
        let ids = first
            .add_bodies((0..20_000).map(body))
            .expect("room for bodies");
        first.advance(PipelineDepth::LOCKSTEP).expect("it steps");
        let second = server.connect().join("large").expect("the scene exists");
        for (place, id) in (0..).zip(&ids) {
            let position = second.view().position(*id).expect("a body of the scene");
            assert!((position.to_array()[0] - at(place)[0]).abs() < 0.1);
        }
    }
}

#[test]
fn a_server_that_panics_ends_its_clients_with_an_error() {
    let hooks = || {
        Hooks::new(|_, _| {
            Some(Hook::new(|scene: &Scene, _: &mut Vec<Command>| {
                assert!(scene.tick() < Tick::new(3), "a hook of the test");
            }))
        })
    };
    let scenes = || scenes_with(hooks());
    let spawned = LocalServer::spawn_of(scenes()).expect("a thread can start");
    for server in [LocalServer::of(scenes()), spawned] {
        let mut client = server.connect().join("hooked").expect("a new scene");
        let failed = (0..10).find_map(|_| client.advance(PipelineDepth::LOCKSTEP).err());
        assert!(failed.is_some());
        assert!(client.advance(PipelineDepth::LOCKSTEP).is_err());
    }
}

#[test]
fn the_thread_ends_with_the_last_client() {
    let (held, gone) = (Arc::new(()), Arc::new(()));
    let alive = Arc::downgrade(&gone);
    drop(held);
    let scenes = scenes_with(Hooks::new(move |_, _| {
        let _kept = &gone;
        None
    }));
    let server = LocalServer::spawn_of(scenes).expect("a thread can start");
    let client = server.connect().join("last").expect("a new scene");
    drop(server);
    assert!(alive.upgrade().is_some());
    client.close();
    while alive.upgrade().is_some() {
        thread::yield_now();
    }
}

#[test]
fn the_interface_is_that_of_a_remote_client() {
    let options = JoinOptions {
        stream: StreamChoice::Within(Tolerance::FINE),
        refusals: Refusals::Events,
        ..JoinOptions::default()
    };
    let mut client = Client::local()
        .join_with("own", options)
        .expect("a new scene");
    assert_eq!(client.tolerance(), Some(Tolerance::FINE));
    let error = client.command(Command::RemoveBody {
        id: BodyId::new(9, 0),
    });
    let number = error.expect("it is queued");
    client.advance(PipelineDepth::LOCKSTEP).expect("it steps");
    let events = std::iter::from_fn(|| client.poll_event());
    let refused = |(_, event)| matches!(event, Event::Refused { number: of, .. } if of == number);
    assert!(events.into_iter().any(refused));
    client.delete().expect("the scene exists");
    let late = client.advance(PipelineDepth::LOCKSTEP);
    assert!(
        matches!(late, Err(ClientError::SceneDeleted | ClientError::Ended(_))),
        "{late:?}"
    );
}

#[test]
fn what_the_server_refuses_is_an_error_of_the_next_advance_and_the_one_after_goes_on() {
    let mut client = Client::local().join("own").expect("a new scene");
    let gone = BodyId::new(9, 0);
    let first = client.command(Command::RemoveBody { id: gone });
    let ball = BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 9.0, 0.0);
    let ball = client.add_body(ball).expect("it is queued");
    client
        .command(Command::RemoveJoint { id: JointId(7) })
        .expect("it is queued");
    let refused = match client.advance(PipelineDepth::LOCKSTEP) {
        Err(ClientError::Refused(refused)) => refused,
        other => panic!("{other:?}"),
    };
    let [one, other] = refused.refusals() else {
        panic!("{refused}");
    };
    assert_eq!((one.number, one.body), (first.ok(), Some(gone)));
    assert_eq!(one.reason.word(), "unknown body");
    assert_eq!((other.body, other.reason.word()), (None, "unknown joint"));
    assert!(refused.to_string().contains("and 1 more"), "{refused}");
    // The tick is done, its view is complete, and no refusal is left.
    let shown = client.view().time().expect("a view").tick;
    assert_eq!(shown, Tick::new(1));
    assert!(client.view().position(ball).is_some());
    let next = client
        .advance(PipelineDepth::LOCKSTEP)
        .expect("the scene runs");
    assert_eq!(next, Tick::new(2));
    let events = std::iter::from_fn(|| client.poll_event());
    let refusals = events.filter(|(_, event)| matches!(event, Event::Refused { .. }));
    assert_eq!(refusals.count(), 2);
}

#[test]
fn refusals_that_no_call_reports_are_kept_up_to_a_number_and_counted() {
    let mut client = Client::local().join("own").expect("a new scene");
    let gone = BodyId::new(9, 0);
    let numbers: Vec<_> = (0..3_000)
        .map(|_| client.command(Command::RemoveBody { id: gone }))
        .map(|number| number.expect("it is queued"))
        .collect();
    let refused = match client.advance(PipelineDepth::LOCKSTEP) {
        Err(ClientError::Refused(refused)) => refused,
        other => panic!("{other:?}"),
    };
    assert_eq!(refused.first().number, Some(numbers[0]));
    assert_eq!(
        (refused.refusals().len(), refused.left_out()),
        (1_024, 1_976)
    );
    assert!(refused.to_string().contains("and 2999 more"), "{refused}");
    client
        .advance(PipelineDepth::LOCKSTEP)
        .expect("it continues");
}

#[test]
fn events_that_no_call_reads_are_kept_up_to_a_number_and_counted() {
    let mut client = Client::local().join("own").expect("a new scene");
    let gone = BodyId::new(9, 0);
    for _ in 0..22 {
        for _ in 0..3_000 {
            let queued = client.command(Command::RemoveBody { id: gone });
            queued.expect("it is queued");
        }
        let advanced = client.advance(PipelineDepth::LOCKSTEP);
        assert!(matches!(advanced, Err(ClientError::Refused(_))));
    }
    let left_out = client.statistics().events_left_out;
    let read = std::iter::from_fn(|| client.poll_event()).count();
    assert_eq!(read, 65_536);
    assert!(left_out >= 22 * 3_000 - 65_536, "{left_out}");
    assert_eq!(client.statistics().events_left_out, left_out);
}

#[test]
fn what_can_be_known_at_once_is_refused_at_once() {
    let mut client = Client::local().join("own").expect("a new scene");
    let sheet = Mesh::new(&[Vec3::ZERO, Vec3::X, Vec3::Y], &[[0, 1, 2]]);
    let sheet = Shape::Mesh(sheet.expect("a triangle"));
    let added = client.add_body(BodyDesc::dynamic(sheet.clone()));
    assert!(matches!(added, Err(ClientError::Misuse(Misuse::NoInside))));
    let added = client.add_body(BodyDesc::fixed(sheet));
    let id = added.expect("a fixed body may be a sheet");
    let joint = Joint::plain(JointKind::Fixed, [id; 2], [JointFrame::at(Vec3::ZERO); 2]);
    let joined = client.command(Command::AddJoint {
        id: JointId(0),
        joint: Box::new(joint),
    });
    let to_itself = Misuse::JoinedToItself(id);
    assert!(matches!(joined, Err(ClientError::Misuse(misuse)) if misuse == to_itself));
    client.advance(PipelineDepth::LOCKSTEP).expect("it steps");
}

#[test]
fn a_dynamic_body_off_its_centre_of_mass_is_refused_and_a_centred_one_is_not() {
    let mut client = Client::local().join("off-centre").expect("a scene");
    let corner = |place: u8| [place & 1, place >> 1 & 1, place >> 2].map(f32::from);
    let corners: Vec<_> = (0..8).map(|place| corner(place).into()).collect();
    let cube = Shape::Hull(Hull::new(&corners).expect("a cube"));
    let dynamic = || BodyDesc::dynamic(cube.clone());
    let refused = client.add_body(dynamic());
    assert!(matches!(refused, Err(ClientError::OffCentre(centre)) if centre == Vec3::splat(0.5)));
    let several = [dynamic().centred().0, dynamic()];
    let refused = client.add_bodies(several);
    let text = refused.expect_err("one of them is off").to_string();
    assert!(
        text.contains("(0.5, 0.5, 0.5)") || text.contains("[0.5, 0.5, 0.5]"),
        "{text}"
    );
    // No engine turns the first two, and the third says how it turns.
    let own = Mass {
        mass: 1.0,
        moments: Some(Vec3::ONE),
    };
    let fixed = BodyDesc::fixed(cube.clone());
    let kinematic = BodyDesc::kinematic(cube.clone());
    client
        .add_bodies([
            fixed,
            kinematic,
            dynamic().mass_of(own),
            dynamic().centred().0,
        ])
        .expect("none of them is off");
    client.advance(PipelineDepth::LOCKSTEP).expect("a step");
    assert_eq!(client.view().ids().len(), 4);
}

#[test]
fn a_stream_that_is_denied_fails_no_step() {
    let server = LocalServer::new();
    let within = |micrometres| {
        let tolerance = Tolerance::from_micrometres(micrometres).expect("within the range");
        StreamChoice::Within(tolerance)
    };
    let mut clients: Vec<_> = (0..8)
        .map(|place| {
            let options = JoinOptions {
                stream: within(10_000 + place),
                ..JoinOptions::default()
            };
            let joined = server.connect().join_with("crowded", options);
            joined.expect("half of the streams of a scene are one client's")
        })
        .collect();
    let first = &mut clients[0];
    first.change_stream(within(90_000)).expect("it is asked");
    for _ in 0..3 {
        first.advance(PipelineDepth::LOCKSTEP).expect("it steps");
    }
    let denied = Event::Denied(Denial::TooManyStreams);
    let mut events = std::iter::from_fn(|| first.poll_event());
    assert!(events.any(|(_, event)| event == denied));
}

#[test]
fn the_error_bound_is_that_of_the_pose_that_is_shown() {
    let server = LocalServer::new();
    let mut client = server.connect().join("shown").expect("a new scene");
    let ball = client.add_body(BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 9.0, 0.0));
    let ball = ball.expect("a body");
    client.advance(PipelineDepth::LOCKSTEP).expect("it steps");
    let bound = |client: &Client| {
        client
            .error_bound(ball)
            .expect("a body of the view")
            .metres()
    };
    assert_eq!(bound(&client), 0.05);
    // The server steps and sends an update, which is read without a new view: the view still shows the tick before,
    // whose track is known. A view of an earlier tick than the update's stays right.
    let jump = client.command(Command::SetVelocity {
        id: ball,
        linear: Vec3::X * 40.0,
        angular: Vec3::ZERO,
    });
    jump.expect("it is queued");
    let requested = client.request_tick().expect("it is asked");
    client
        .idle(Duration::from_millis(50))
        .expect("the scene runs");
    assert_eq!(bound(&client), 0.05);
    let of_track = client.tick_error_bound(ball, requested.next());
    assert!(matches!(of_track, Some(ErrorBound::Unknown { .. })));
    client.wait(PipelineDepth::LOCKSTEP).expect("it steps");
    assert_eq!(bound(&client), 0.05);
    assert!(
        client
            .error_bounds()
            .eq([ErrorBound::Within(Metres::new(0.05))])
    );
}

#[test]
fn a_lockstep_scene_stands_still_while_it_is_polled() {
    for server in servers() {
        let mut client = server.connect().join("still").expect("a new scene");
        let ball = BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 100.0, 0.0);
        let ball = client.add_body(ball).expect("a body");
        for _ in 0..30 {
            client.advance(PipelineDepth::LOCKSTEP).expect("it steps");
        }
        let at = client.view().position(ball);
        for _ in 0..20 {
            client
                .idle(Duration::from_millis(5))
                .expect("the scene runs");
            let shown = client.poll().expect("the scene runs");
            assert_eq!(shown, RenderTime::at(Tick::new(30)));
            assert_eq!(client.view().position(ball), at);
            let bound = client.error_bound(ball).expect("a body of the view");
            assert_eq!(bound.metres(), 0.05);
        }
    }
}

#[test]
fn a_member_that_is_not_called_for_100_seconds_shows_the_present_at_its_first_call() {
    const TICKS: u64 = 6_000;
    // Each way of a call to read what waits, and the tick that it shows at once.
    let calls: [fn(&mut Client) -> Tick; 3] = [
        |client| client.poll().expect("the scene runs").tick,
        |client| {
            let shown = client.try_wait(PipelineDepth::LOCKSTEP);
            shown.expect("the scene runs").expect("nothing is awaited")
        },
        |client| {
            client.idle(Duration::ZERO).expect("the scene runs");
            client.statistics().complete
        },
    ];
    for server in servers() {
        let mut first = server.connect().join("long").expect("a new scene");
        let others = calls.map(|call| {
            let joined = server.connect().join("long");
            (joined.expect("the scene is there"), call)
        });
        let ball = BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 100.0, 0.0);
        let ball = first.add_body(ball).expect("a body");
        for _ in 0..TICKS {
            first.advance(PipelineDepth::LOCKSTEP).expect("it steps");
        }
        // It is answered once the tick is handed to all members.
        first.inspect().expect("an answer");
        for (mut other, call) in others {
            assert_eq!(call(&mut other), Tick::new(TICKS));
            other.poll().expect("the scene runs");
            assert_eq!(other.view().position(ball), first.view().position(ball));
        }
    }
}
