//! Servers that go away, and scenes that cannot be joined, without a panic.

use bevy_app::App;
use rhumb_bevy::{RhumbBodyId, RhumbClient, RhumbJoin, RhumbState};
use rhumb_client::scene::{BodyDesc, Shape, Stepping};
use rhumb_client::{Client, ClientError, Event, PipelineDepth, StreamChoice, Tolerance, Trust};

use crate::arena::{app, component, entity, messages, rhumb, run_until};
use crate::server::Server;

const COPY: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);

/// Follows a scene whose server is killed.
fn follow_until_the_server_dies(stepping: Stepping, depth: PipelineDepth) {
    let mut server = Server::start();
    let mut app = app(depth);
    app.insert_resource(RhumbClient::new(server.join("killed", stepping, COPY)));
    let ball = BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 5.0, 0.0);
    let id = rhumb(&mut app).add_body(ball).expect("a valid body");
    run_until(&mut app, "the ball falls", |app| {
        entity(app, id).is_some() && component::<RhumbState>(app, id).linear_velocity.y < -0.5
    });
    server.kill();
    run_until(&mut app, "the end is noticed", |app| {
        !messages(app).endings.is_empty()
    });
    let at = component::<RhumbState>(&mut app, id).position;
    (0..10).for_each(|_| app.update());
    assert_eq!(
        messages(&app).endings.len(),
        1,
        "{:?}",
        messages(&app).endings
    );
    assert!(
        messages(&app).endings[0].starts_with("the connection "),
        "{:?}",
        messages(&app).endings
    );
    assert!(
        messages(&app)
            .events
            .iter()
            .any(|event| matches!(event, Event::Ended(_)))
    );
    assert!(rhumb(&mut app).is_ended());
    assert_eq!(
        component::<RhumbState>(&mut app, id).position,
        at,
        "the body stays where it was"
    );
    let refused = rhumb(&mut app).remove_body(id);
    assert!(matches!(refused, Err(ClientError::Ended(_))), "{refused:?}");
    app.world_mut().remove_resource::<RhumbClient>();
    app.update();
    assert_eq!(
        app.world_mut()
            .query::<&RhumbBodyId>()
            .iter(app.world())
            .count(),
        0
    );
}

#[test]
fn a_free_running_scene_whose_server_dies_ends_by_a_message() {
    follow_until_the_server_dies(Stepping::FreeRunning, PipelineDepth::PIPELINED);
}

#[test]
fn a_lockstep_scene_whose_server_dies_ends_by_a_message() {
    follow_until_the_server_dies(Stepping::Lockstep, PipelineDepth::PIPELINED);
}

#[test]
fn a_deleted_scene_ends_by_a_message() {
    let server = Server::start();
    let mut app = app(PipelineDepth::LOCKSTEP);
    app.insert_resource(RhumbClient::new(server.join(
        "deleted",
        Stepping::Lockstep,
        COPY,
    )));
    app.update();
    let mut other = server.join("deleted", Stepping::Lockstep, COPY);
    other.delete().unwrap();
    run_until(&mut app, "the end is noticed", |app| {
        !messages(app).endings.is_empty()
    });
    assert_eq!(messages(&app).endings, ["the scene was deleted"]);
}

/// Waits for the thread that joins.
fn finish(app: &mut App) {
    run_until_gone(app);
    app.update();
}

fn run_until_gone(app: &mut App) {
    while app.world().contains_resource::<RhumbJoin>() {
        app.update();
        std::thread::yield_now();
    }
}

#[test]
fn a_scene_is_joined_beside_the_frames() {
    let server = Server::start();
    let mut app = app(PipelineDepth::LOCKSTEP);
    let connection = server.connect();
    let join = RhumbJoin::start(move || {
        let mut client = connection.join("beside")?;
        client.add_body(BodyDesc::dynamic(Shape::ball(0.5)))?;
        Ok(client)
    });
    app.insert_resource(join.unwrap());
    finish(&mut app);
    assert!(messages(&app).failures.is_empty());
    assert_eq!(
        app.world_mut()
            .query::<&RhumbBodyId>()
            .iter(app.world())
            .count(),
        1
    );
}

#[test]
fn a_scene_that_cannot_be_joined_ends_the_join_by_a_message() {
    let server = Server::start();
    let connection = server.connect();
    let mut app = app(PipelineDepth::LOCKSTEP);
    app.insert_resource(
        RhumbJoin::start(move || Ok(connection.join("a name with blanks")?)).unwrap(),
    );
    finish(&mut app);
    let wrong =
        || Ok(Client::connect("no port here", Trust::Fingerprint("ab".parse()?))?.join("x")?);
    app.insert_resource(RhumbJoin::start(wrong).unwrap());
    finish(&mut app);
    let failures = &messages(&app).failures;
    assert_eq!(failures.len(), 2, "{failures:?}");
    assert!(
        failures[0].starts_with("\"a name with blanks\" cannot name a scene"),
        "{failures:?}"
    );
    assert!(!app.world().contains_resource::<RhumbClient>());
}

#[test]
fn a_join_that_panics_ends_by_a_message() {
    let mut app = app(PipelineDepth::LOCKSTEP);
    app.insert_resource(RhumbJoin::start(|| panic!("as the test wants it")).unwrap());
    finish(&mut app);
    let failures = &messages(&app).failures;
    assert_eq!(failures.len(), 1);
    assert!(failures[0].contains("panicked"), "{failures:?}");
}
