//! Scripts of a project: they replace methods, and do anything in a handler.

use rhumb_client::scene::{BodyDesc, Command, Shape, Stepping};
use rhumb_client::{PipelineDepth, StreamChoice};

use crate::agent::Agent;
use crate::server::{Server, advance_beyond};

fn assert_no_error(agent: &Agent) {
    assert_eq!(
        agent.errors().matches("ERROR").count(),
        0,
        "{}",
        agent.errors()
    );
}

#[test]
fn a_script_that_replaces_every_method_changes_nothing() {
    for stepping in ["lockstep", "free"] {
        let server = Server::start();
        let Some(mut agent) = Agent::start(&server, "scripted", stepping, 0) else {
            return;
        };
        agent.join();
        let id = agent.number("agent.add_scripted()");
        agent.run_until("the ball falls", |_, frame| {
            frame.body(id).is_some_and(|body| body.position.y < 49.5)
        });
        for call in ["enter", "ready", "process", "physics"] {
            assert_eq!(
                agent.eval(&format!("scene.calls.has('{call}')")),
                "true",
                "{call}"
            );
        }
        agent.eval("agent.move_scene()");
        assert_eq!(agent.eval("scene.calls.has('exit')"), "true");
        assert_eq!(
            agent.eval("scene.is_joined()"),
            "false",
            "a node out of the tree leaves"
        );
        assert_no_error(&agent);
    }
}

#[test]
fn nodes_of_the_project_stand_for_new_bodies_in_a_scene_that_is_joined_again() {
    let server = Server::start();
    let Some(mut agent) = Agent::start(&server, "again", "lockstep", 0) else {
        return;
    };
    agent.join();
    agent.number("agent.add_ball(0, 50, 0)");
    let first = agent.step();
    assert_eq!(agent.eval("scene.delete()"), "0");
    agent.run_until("the end is noticed", |agent, _| agent.has_said("ended: "));
    agent.eval("scene.leave()");
    agent.said.clear();
    assert_eq!(agent.eval("scene.join()"), "0");
    let second = agent.run_until("it is joined again", |agent, frame| {
        agent.has_said("joined") && !frame.bodies.is_empty()
    });
    assert_eq!((first.bodies.len(), second.bodies.len()), (1, 1));
    assert_eq!(
        agent.eval("agent.appeared"),
        "[]",
        "the node is the project's own"
    );
}

#[test]
fn a_handler_may_leave_the_scene_or_free_a_node() {
    let server = Server::start();
    let mut other = server.join("handlers", Stepping::Lockstep, StreamChoice::Full);
    let add = |client: &mut rhumb_client::Client, x: f32| {
        let ball = BodyDesc::dynamic(Shape::ball(0.5)).at(x, 50.0, 0.0);
        client.add_body(ball).expect("a body")
    };
    let ids = [0.0, 2.0, 4.0].map(|x| add(&mut other, x));
    other.advance(PipelineDepth::LOCKSTEP).expect("a tick");
    let Some(mut agent) = Agent::start(&server, "handlers", "lockstep", 0) else {
        return;
    };
    let frame = agent.join();
    agent.eval("agent.set_option('frees_when_removed', true)");
    for id in &ids[..2] {
        other
            .command(Command::RemoveBody { id: *id })
            .expect("a command");
    }
    advance_beyond(&mut other, frame.shown());
    let frame = agent.step();
    assert_eq!(frame.bodies.len(), 1, "{frame:?}");
    assert_eq!(
        agent.eval("agent.removed.size()"),
        "2",
        "the first handler keeps none back"
    );
    agent.eval("agent.set_option('leaves_when_appeared', true)");
    for x in [6.0, 8.0] {
        add(&mut other, x);
    }
    advance_beyond(&mut other, frame.shown());
    agent.step();
    assert_eq!(agent.eval("scene.is_joined()"), "false");
    assert_eq!(
        agent.eval("agent.appeared.size()"),
        "4",
        "of five: it has left by then"
    );
    assert_no_error(&agent);
}

#[test]
fn a_transform_without_a_rotation_is_an_error_and_a_small_one_is_not() {
    let server = Server::start();
    let Some(mut agent) = Agent::start(&server, "scales", "lockstep", 0) else {
        return;
    };
    agent.join();
    let good = [
        "Vector3(0.001, 0.001, 0.001)",
        "Vector3(1, 2, 3)",
        "Vector3(1, 1, -1)",
    ];
    for scale in good {
        assert_ne!(
            agent.eval(&format!("agent.add_scaled({scale})")),
            "0",
            "{scale}"
        );
    }
    assert_no_error(&agent);
    assert_eq!(agent.eval("agent.add_scaled(Vector3(0, 0, 0))"), "0");
    assert!(
        agent.errors().contains("its transform has no rotation"),
        "{}",
        agent.errors()
    );
    agent.step();
    assert_eq!(agent.step().bodies.len(), good.len());
}
