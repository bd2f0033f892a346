//! Commands of a project change the bodies of the scene.

use rhumb_bindings::parse_packed_id;
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
    let body = parse_packed_id(id).expect("a body");
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

#[test]
fn a_character_walks_and_jumps_and_a_vehicle_drives() {
    let server = Server::start();
    let Some(mut agent) = Agent::start(&server, "locomotion", "lockstep", 0) else {
        return;
    };
    agent.join();
    agent.number("agent.add_box(0, Vector3(100, 1, 100), Vector3(0, -0.5, 0))");
    let walker = agent.number("agent.add_walker(Vector3(0, 0.8, 0))");
    let car = agent.number("agent.add_box(1, Vector3(1.5, 0.5, 3), Vector3(10, 1, 0))");
    agent.step();
    for call in [
        format!("agent.make_character({walker})"),
        format!("agent.body({walker}).set_velocity(Vector3(2, 0, 0))"),
        format!("agent.make_vehicle({car})"),
    ] {
        assert_eq!(agent.eval(&call), "0", "{call}");
    }
    agent.run_until("the character walks", |_, frame| {
        frame.body(walker).is_some_and(|body| body.position.x > 1.0)
    });
    // It stands on the floor, and does not fall through it.
    let walked = agent.step().body(walker).expect("the body has a node");
    assert!((0.7..0.9).contains(&walked.position.y), "{walked:?}");
    assert_eq!(agent.eval(&format!("agent.body({walker}).jump(4)")), "0");
    agent.run_until("the character jumps", |_, frame| {
        frame.body(walker).is_some_and(|body| body.position.y > 1.3)
    });
    assert_eq!(agent.eval(&format!("agent.drive({car}, 2000)")), "0");
    agent.run_until("the vehicle drives forward", |_, frame| {
        frame.body(car).is_some_and(|body| body.position.z < -1.0)
    });
    let clear = format!("agent.body({walker}).clear_locomotion()");
    assert_eq!(agent.eval(&clear), "0");
    agent.step();
    assert_eq!(agent.eval("agent.counted.get('command refused', 0)"), "0");
    assert_eq!(
        agent.errors().matches("ERROR").count(),
        0,
        "{}",
        agent.errors()
    );
}

#[test]
fn forces_sleep_and_gravity_are_commands_of_nodes() {
    let server = Server::start();
    let Some(mut agent) = Agent::start(&server, "forces", "lockstep", 0) else {
        return;
    };
    agent.join();
    let ball = agent.number("agent.add_ball(0, 50, 0)");
    agent.step();
    for call in [
        "scene.change_gravity(Vector3(0, 0, 0))".to_owned(),
        format!("agent.body({ball}).set_velocity(Vector3(0, 0, 0))"),
        format!("agent.body({ball}).apply_force(Vector3(0, 500000, 0))"),
        format!("agent.body({ball}).apply_torque(Vector3(0, 1, 0))"),
    ] {
        assert_eq!(agent.eval(&call), "0", "{call}");
    }
    agent.run_until("the ball rises without gravity", |_, frame| {
        frame.body(ball).is_some_and(|body| body.position.y > 55.0)
    });
    let sleep = format!("agent.body({ball}).put_to_sleep()");
    assert_eq!(agent.eval(&sleep), "0");
    agent.run_until("the ball rests", |agent, _| {
        agent.eval(&format!("agent.body({ball}).is_resting()")) == "true"
    });
    let at = "Vector3(0.5, 60, 0)";
    let push = format!("agent.body({ball}).apply_impulse_at(Vector3(0, 0, 500), {at})");
    assert_eq!(agent.eval(&push), "0");
    agent.run_until("the push wakes the ball and turns it", |_, frame| {
        let body = frame.body(ball);
        body.is_some_and(|body| (body.rotation * Vec3::X).distance(Vec3::X) > 0.1)
    });
    // A wrong number is an error at once, with its range.
    let wrong = format!("agent.body({ball}).apply_force(Vector3(INF, 0, 0))");
    assert_ne!(agent.eval(&wrong), "0");
    assert!(
        agent.errors().contains("force is inf"),
        "{}",
        agent.errors()
    );
}

#[test]
fn resources_begin_with_the_defaults_of_the_table() {
    let server = Server::start();
    let Some(mut agent) = Agent::start(&server, "resources", "lockstep", 0) else {
        return;
    };
    agent.join();
    for (expression, value) in [
        (
            "is_equal_approx(agent.plain_wheel().rest_length, 0.3)",
            "true",
        ),
        ("agent.plain_wheel().direction == Vector3(0, -1, 0)", "true"),
        ("agent.plain_wheel().force_max", "1000000000.0"),
        (
            "is_equal_approx(agent.plain_character().climb_angle, PI / 4)",
            "true",
        ),
        ("agent.plain_character().step_height", "0.0"),
    ] {
        assert_eq!(agent.eval(expression), value, "{expression}");
    }
}

#[test]
fn a_hinge_with_a_motor_turns_a_body_as_far_as_its_limit() {
    let server = Server::start();
    let Some(mut agent) = Agent::start(&server, "hinges", "lockstep", 0) else {
        return;
    };
    agent.join();
    let post = agent.number("agent.add_box(0, Vector3(0.5, 0.5, 0.5), Vector3(0, 4, 0))");
    let arm = agent.number("agent.add_box(1, Vector3(0.5, 2, 0.5), Vector3(0, 2.5, 0))");
    agent.step();
    let hinge = format!("agent.add_hinge(7, {post}, {arm}, 2)");
    assert_eq!(agent.eval(&hinge), "0");
    agent.run_until("the motor turns the arm", |_, frame| {
        let down = frame.body(arm).map(|body| body.rotation * Vec3::NEG_Y);
        down.is_some_and(|down| down.x.abs() > 0.7 && down.z.abs() < 0.05)
    });
    let turned = agent.step().body(arm).expect("the body has a node");
    let anchor = turned.position + turned.rotation * Vec3::Y;
    assert!(
        anchor.distance(Vec3::new(0.0, 3.5, 0.0)) < 0.15,
        "{turned:?}"
    );
    assert_eq!(agent.eval("scene.remove_joint(7)"), "0");
    agent.run_until("the arm falls", |_, frame| {
        frame.body(arm).is_some_and(|body| body.position.y < 1.0)
    });
    assert_eq!(agent.eval("agent.counted.get('command refused', 0)"), "0");
    let wrong = format!("agent.add_wrong_hinge({post}, {arm})");
    assert_ne!(agent.eval(&wrong), "0");
    assert!(
        agent.errors().contains("limits is of axis 0"),
        "{}",
        agent.errors()
    );
}
