//! Scenes of a server in this process are saved at any time, and forked.

use rhumb_client::scene::{ActiveEvents, BodyDesc, Command, Shape};
use rhumb_client::{Checkpoint, CheckpointError, Client, Event, LocalServer, PipelineDepth};
use rhumb_reckoning::BodyId;

fn join(server: &LocalServer, scene: &str) -> Client {
    server.connect().join(scene).expect("an open server")
}

fn advance(client: &mut Client) {
    client
        .advance(PipelineDepth::LOCKSTEP)
        .expect("a scene that steps");
}

fn truth(client: &mut Client) -> u64 {
    client.inspect().expect("an open server").truth
}

/// A floor, and a pile that falls onto it.
fn pile(client: &mut Client) -> Vec<BodyId> {
    let floor = BodyDesc::fixed(Shape::cuboid(10.0, 0.5, 10.0)).at(0.0, -0.5, 0.0);
    client.add_body(floor).expect("a valid body");
    (0..30)
        .map(|number| {
            let place = (number as f32).mul_add(0.7, 0.6);
            let cube = BodyDesc::dynamic(Shape::cuboid(0.3, 0.3, 0.3));
            let cube = cube.at(0.1 * (number % 3) as f32, place, 0.0);
            client.add_body(cube).expect("a valid body")
        })
        .collect()
}

#[test]
fn a_scene_is_saved_between_steps_with_what_was_commanded_since() {
    for server in [LocalServer::new(), LocalServer::spawn().expect("a thread")] {
        let mut client = join(&server, "first");
        let bodies = pile(&mut client);
        client.inspect().expect("an open server");
        let before = server.save("first").expect("it exists");
        server.restore("before", &before).expect("a free name");
        for _ in 0..40 {
            advance(&mut client);
        }
        let push = Command::SetVelocity {
            id: bodies[7],
            linear: glam::Vec3::new(3.0, 1.0, 0.0),
            angular: glam::Vec3::ZERO,
        };
        client.command(push).expect("a valid command");
        client.inspect().expect("an open server");
        let saved = server.save("first").expect("it exists");
        let read = Checkpoint::from_bytes(&saved.to_bytes()).expect("whole bytes");
        server.restore("second", &read).expect("a free name");
        let again = server
            .save("second")
            .expect("a fork is saved before its first step");
        assert_eq!((again.tick(), again.digest()), (read.tick(), read.digest()));
        let elsewhere = LocalServer::new();
        elsewhere.restore("first", &read).expect("a free name");

        let mut second = join(&server, "second");
        let mut third = join(&elsewhere, "first");
        assert_eq!(second.view().ids().len(), 31, "the ids stay");
        for tick in 0..200 {
            for client in [&mut client, &mut second, &mut third] {
                advance(client);
            }
            let truth_of_it = truth(&mut client);
            assert_eq!(truth(&mut second), truth_of_it, "tick {tick}");
            assert_eq!(truth(&mut third), truth_of_it, "tick {tick}");
        }
        let mut from_the_start = join(&server, "before");
        let mut anew = join(&elsewhere, "anew");
        pile(&mut anew);
        for _ in 0..60 {
            advance(&mut from_the_start);
            advance(&mut anew);
        }
        assert_eq!(truth(&mut from_the_start), truth(&mut anew));
    }
}

#[test]
fn a_fork_of_a_fork_does_not_run_again_what_its_parents_ran() {
    let server = LocalServer::new();
    let mut client = join(&server, "0");
    let ball = BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 900.0, 0.0);
    let ball = client.add_body(ball).expect("a valid body");
    let mut lengths = Vec::new();
    for generation in 1..40 {
        for _ in 0..5 {
            advance(&mut client);
        }
        let linear = glam::Vec3::X;
        let angular = glam::Vec3::ZERO;
        let push = Command::SetVelocity {
            id: ball,
            linear,
            angular,
        };
        client.command(push).expect("a valid command");
        let before = truth(&mut client);
        let parent = (generation - 1).to_string();
        let saved = server.save(&parent).expect("it exists");
        lengths.push(saved.to_bytes().len());
        let fork = generation.to_string();
        server.restore(&fork, &saved).expect("a free name");
        client = join(&server, &fork);
        assert_eq!(truth(&mut client), before);
    }
    // The entries of five steps take 45 bytes. The first scene began without a body.
    let (first, last) = (lengths[1], lengths[lengths.len() - 1]);
    assert!(last < first + 45, "{lengths:?}");
}

#[test]
fn events_of_bodies_happen_once_in_a_fork_and_new_bodies_have_ids_of_their_own() {
    let server = LocalServer::new();
    let mut client = join(&server, "first");
    let watched = BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 3.0, 0.0);
    let floor = BodyDesc::fixed(Shape::cuboid(10.0, 0.5, 10.0)).at(0.0, -0.5, 0.0);
    client.add_body(floor).expect("a valid body");
    let id = client.add_body(watched).expect("a valid body");
    let events = ActiveEvents {
        contacts: true,
        sleep: true,
        ..ActiveEvents::NONE
    };
    let reports = Command::SetEvents { id, events };
    client.command(reports).expect("a valid command");
    for _ in 0..60 {
        advance(&mut client);
    }
    let began = |client: &mut Client| {
        std::iter::from_fn(|| client.poll_event())
            .filter(|(_, event)| matches!(event, Event::Body { .. }))
            .count()
    };
    assert!(began(&mut client) > 0, "the ball has landed");
    server
        .restore("fork", &server.save("first").expect("it exists"))
        .expect("a free name");
    let mut fork = join(&server, "fork");
    fork.poll().expect("the scene runs");
    assert_eq!(began(&mut fork), 1, "a new member gets what stands");
    for _ in 0..120 {
        advance(&mut client);
        advance(&mut fork);
    }
    assert_eq!(began(&mut fork), began(&mut client));
    let known: Vec<BodyId> = fork.view().ids().to_vec();
    let new = fork.add_body(BodyDesc::dynamic(Shape::ball(0.2)).at(5.0, 2.0, 0.0));
    assert!(!known.contains(&new.expect("a valid body")));
    advance(&mut fork);
    assert_eq!(fork.view().ids().len(), 3);
}

#[test]
fn what_cannot_be_saved_or_restored_says_why() {
    let server = LocalServer::new();
    let refused = server.save("nowhere").expect_err("no such scene");
    assert!(refused.to_string().contains("\"nowhere\""), "{refused}");
    let refused = server.save("no name").expect_err("a space");
    assert!(
        matches!(refused, CheckpointError::SceneName { .. }),
        "{refused}"
    );
    let mut client = join(&server, "here");
    advance(&mut client);
    let saved = server.save("here").expect("it exists");
    let refused = server.restore("here", &saved).expect_err("it exists");
    assert!(
        matches!(refused, CheckpointError::SceneExists(_)),
        "{refused}"
    );
    let (beside, _peers) = LocalServer::beside(|| {});
    assert_eq!(beside.save("here"), Err(CheckpointError::NoServer));
}
