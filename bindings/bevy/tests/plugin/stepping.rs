//! Frames between ticks, and frames that wait for no server.

use std::time::Duration;

use bevy_time::TimeUpdateStrategy;
use bevy_transform::components::Transform;
use rhumb_bevy::{RhumbClient, RhumbState};
use rhumb_client::scene::{BodyDesc, Shape, Stepping};
use rhumb_client::{PipelineDepth, StreamChoice, Tolerance};

use crate::arena::{app, component, entity, messages, rhumb, run_until};
use crate::server::Server;

const COPY: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);

#[test]
fn a_frame_between_two_steps_draws_bodies_between_two_ticks() {
    let server = Server::start();
    let mut app = app(PipelineDepth::LOCKSTEP);
    app.insert_resource(RhumbClient::new(server.join(
        "between",
        Stepping::Lockstep,
        COPY,
    )));
    let thrown = BodyDesc::dynamic(Shape::ball(0.5))
        .linear_velocity([6.0, 0.0, 0.0])
        .gravity_scale(0.0);
    let id = rhumb(&mut app).add_body(thrown).unwrap();
    app.update();
    let drawn_x = |app: &mut bevy_app::App| component::<Transform>(app, id).translation.x;
    let state_x = |app: &mut bevy_app::App| component::<RhumbState>(app, id).position.x;
    (0..5).for_each(|_| app.update());
    let before = state_x(&mut app);
    // Half a fixed step, then one and a half: a step falls due in the second frame, with half a step over.
    let step = rhumb(&mut app).fixed_step();
    app.insert_resource(TimeUpdateStrategy::ManualDuration(step / 2));
    app.update();
    assert_eq!(state_x(&mut app), before, "no step is due");
    app.insert_resource(TimeUpdateStrategy::ManualDuration(step));
    app.update();
    let after = state_x(&mut app);
    assert!(
        (after - before - 0.1).abs() < 0.01,
        "6 m/s for a sixtieth of a second: {before} {after}"
    );
    let share = (drawn_x(&mut app) - before) / (after - before);
    assert!((share - 0.5).abs() < 0.02, "{share}");
}

#[test]
fn frames_go_on_while_a_lockstep_server_stands_still() {
    let server = Server::start();
    let mut app = app(PipelineDepth::PIPELINED);
    app.insert_resource(RhumbClient::new(server.join(
        "still",
        Stepping::Lockstep,
        COPY,
    )));
    let id = rhumb(&mut app)
        .add_body(BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 50.0, 0.0))
        .unwrap();
    run_until(&mut app, "the ball falls", |app| {
        entity(app, id).is_some() && component::<RhumbState>(app, id).linear_velocity.y < -1.0
    });
    signal(&server, "-STOP");
    // Ticks that the server has sent before may still arrive.
    let mut late = 0;
    run_until(&mut app, "twenty steps are late", |app| {
        let before = rhumb(app).late_steps();
        app.update();
        if rhumb(app).late_steps() > before {
            late += 1;
            let state = component::<RhumbState>(app, id);
            let drawn = component::<Transform>(app, id).translation;
            assert!(
                drawn.distance(state.position) < 1e-4,
                "it hangs where it was: {drawn} {state:?}"
            );
        }
        late >= 20
    });
    let height = component::<RhumbState>(&mut app, id).position.y;
    signal(&server, "-CONT");
    run_until(&mut app, "the ball falls on", |app| {
        component::<RhumbState>(app, id).position.y < height - 1.0
    });
    assert!(messages(&app).endings.is_empty());
}

#[test]
fn a_step_that_times_out_is_waited_for_once_alone() {
    let server = Server::start();
    let mut app = app(PipelineDepth::LOCKSTEP);
    let connection = server.connect().timeout(Duration::from_millis(200));
    app.insert_resource(RhumbClient::new(connection.join("slow").unwrap()));
    let id = rhumb(&mut app)
        .add_body(BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 50.0, 0.0))
        .unwrap();
    // On a machine that is busy, the first steps may be late, too.
    run_until(&mut app, "the ball is there", |app| {
        entity(app, id).is_some()
    });
    let before = rhumb(&mut app).late_steps();
    signal(&server, "-STOP");
    (0..5).for_each(|_| app.update());
    assert_eq!(
        rhumb(&mut app).late_steps() - before,
        5,
        "one time-out, and four frames that only looked"
    );
    signal(&server, "-CONT");
    run_until(&mut app, "the tick arrives", |app| {
        component::<RhumbState>(app, id).position.y < 49.5
    });
    assert!(
        messages(&app).endings.is_empty(),
        "{:?}",
        messages(&app).endings
    );
}

/// Sends a signal to the server's process, by its name.
fn signal(server: &Server, name: &str) {
    let sent = std::process::Command::new("kill")
        .args([name, &server.child.id().to_string()])
        .status();
    assert!(sent.expect("the command `kill`").success());
}
