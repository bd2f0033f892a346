//! Commands of a project change the bodies of the scene.

use rhumb_bindings::parse_body_word;
use rhumb_client::glam::{Quat, Vec3};
use rhumb_client::scene::Stepping;
use rhumb_client::{PipelineDepth, StreamChoice};

use crate::agent::Agent;
use crate::server::Server;

#[test]
fn commands_move_turn_and_remove_bodies() {
    let server = Server::start();
    let Some(mut agent) = Agent::start(&server, "commands", "lockstep", 0) else {
        return;
    };
    agent.join();
    let id = agent.number("agent.add_ball(0, 50, 0)");
    agent.step();
    assert_eq!(
        agent.eval(&format!(
            "agent.body({id}).apply_impulse(Vector3(0, 5000, 0))"
        )),
        "0"
    );
    let risen = agent.run_until("the ball rises", |_, frame| {
        frame.body(id).is_some_and(|body| body.rising > 1.0)
    });
    assert!(risen.body(id).is_some_and(|body| body.position.y < 60.0));
    let call = format!("agent.body({id}).set_velocity(Vector3(0, 0, 0), Vector3(0, 2, 0))");
    assert_eq!(agent.eval(&call), "0");
    // A quarter turn about y.
    let pose = "Transform3D(Basis(Vector3(0, 1, 0), PI / 2), Vector3(7, 8, 9))";
    assert_eq!(
        agent.eval(&format!("agent.body({id}).teleport({pose})")),
        "0"
    );
    let body = agent.step().body(id).expect("the body has a node");
    assert!(
        body.position.distance(Vec3::new(7.0, 8.0, 9.0)) < 0.06,
        "{body:?}"
    );
    let turned = body.rotation * Vec3::X;
    assert!(turned.distance(Vec3::NEG_Z) < 0.1, "{turned}");
    let torque = format!("agent.body({id}).apply_torque_impulse(Vector3(0, 0, 1))");
    assert_eq!(agent.eval(&torque), "0");
    assert_eq!(agent.eval(&format!("agent.body({id}).remove()")), "0");
    assert!(agent.step().body(id).is_none());
    assert_eq!(agent.eval("agent.counted.get('command refused', 0)"), "0");
    assert_eq!(
        agent.errors().matches("ERROR").count(),
        0,
        "{}",
        agent.errors()
    );
}

#[test]
fn contacts_are_events_with_the_nodes_that_touch() {
    let server = Server::start();
    let Some(mut agent) = Agent::start(&server, "contacts", "lockstep", 0) else {
        return;
    };
    agent.join();
    let floor = agent.number("agent.add_box(0, Vector3(40, 1, 40), Vector3(0, -0.5, 0))");
    let ball = agent.number("agent.add_ball(0, 1, 0)");
    agent.step();
    assert_eq!(
        agent.eval(&format!("agent.body({ball}).report_events(true)")),
        "0"
    );
    agent.run_until("the ball touches the floor", |agent, _| {
        agent.eval("agent.counted.get('contact began', 0)") != "0"
    });
    let bodies = agent.eval("[agent.last_event['contact began']['body'].get_id(), agent.last_event['contact began']['other'].get_id()]");
    assert!(
        bodies == format!("[{ball}, {floor}]") || bodies == format!("[{floor}, {ball}]"),
        "{bodies}"
    );
    let upwards = agent.eval("absf(agent.last_event['contact began']['normal'].y) > 0.99");
    assert_eq!(upwards, "true");
}

#[test]
fn a_ray_finds_the_nearest_body() {
    let server = Server::start();
    let Some(mut agent) = Agent::start(&server, "rays", "lockstep", 0) else {
        return;
    };
    agent.join();
    let low = agent.number("agent.add_box(0, Vector3(2, 2, 2), Vector3(0, 0, 0))");
    let high = agent.number("agent.add_box(0, Vector3(2, 2, 2), Vector3(0, 5, 0))");
    agent.step();
    let hit = agent.number("scene.cast_ray(Vector3(0, 20, 0), Vector3(0, -20, 0))");
    let none = agent.number("scene.cast_ray(Vector3(9, 20, 0), Vector3(9, -20, 0))");
    agent.run_until("both rays are answered", |agent, _| {
        agent.eval("agent.answers.size()") == "2"
    });
    assert_eq!(
        agent.eval(&format!("agent.answers[{hit}]['body_id']")),
        high.to_string()
    );
    assert_ne!(low, high);
    assert_eq!(
        agent.eval(&format!(
            "is_equal_approx(agent.answers[{hit}]['distance'], 14.0)"
        )),
        "true"
    );
    assert_eq!(
        agent.eval(&format!("agent.answers[{hit}]['normal'].y > 0.99")),
        "true"
    );
    assert_eq!(agent.eval(&format!("agent.answers[{none}].size()")), "0");
}

#[test]
fn a_pose_of_the_project_is_the_pose_of_the_truth() {
    let server = Server::start();
    let Some(mut agent) = Agent::start(&server, "poses", "lockstep", 0) else {
        return;
    };
    agent.join();
    let id = agent.number("agent.add_box(2, Vector3(1, 2, 3), Vector3(4, 5, 6))");
    agent.step();
    let pose = "Transform3D(Basis(Vector3(1, 2, 3).normalized(), 0.7), Vector3(-1, -2, -3))";
    agent.eval(&format!("agent.body({id}).teleport({pose})"));
    agent.step();
    let mut truth = server.join("poses", Stepping::Lockstep, StreamChoice::Full);
    truth.advance(PipelineDepth::LOCKSTEP).expect("a tick");
    let body = parse_body_word(id).expect("a body");
    let (at, turned) = (truth.view().position(body), truth.view().rotation(body));
    let expected = Quat::from_axis_angle(Vec3::new(1.0, 2.0, 3.0).normalize(), 0.7);
    assert!(
        at.expect("a pose").distance(Vec3::new(-1.0, -2.0, -3.0)) < 1e-4,
        "{at:?}"
    );
    assert!(
        turned.expect("a pose").dot(expected).abs() > 0.9999,
        "{turned:?}"
    );
}
